"""Records of channels with time stamps of their own."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from ..errors import DataError
from .experiment import Experiment, FloatArray, Signal
from .filtering import Interpolations, checked_kinds, interpolated, kind_of

__all__ = ["distinct", "multirate", "together"]

Channel = tuple[FloatArray, FloatArray]

# Times closer than this part of the shortest interval of a channel are the same: a mesh does not resolve them.
_SAME = 1e-8


def multirate(
    inputs: Mapping[str, tuple[ArrayLike, ArrayLike]] | None = None,
    outputs: Mapping[str, tuple[ArrayLike, ArrayLike]] | None = None,
    name: str = "experiment",
    interpolation: Interpolations = "linear",
    *,
    units: Mapping[str, str] | None = None,
) -> Experiment:
    """Return an experiment of channels with time stamps of their own (s), each given as ``(times, values)``.

    Its samples are those of all outputs together, in the span that all inputs cover; an output is missing (NaN) where
    it has no sample of its own. Inputs are interpolated between their own samples, as ``interpolation`` says. A mesh
    follows the output that is sampled most often. Raises DataError for what `Experiment` refuses, and for channels that
    do not overlap.

    >>> fast, slow = np.linspace(0, 1, 5), np.linspace(0, 1, 3)
    >>> multirate({"de": (slow, [0, 1, 0])}, {"q": (fast, fast**2), "alpha": (slow + 0.1, slow)})
    Experiment('experiment', 7 samples, 0 to 1, inputs: de, outputs: q alpha (7 missing))
    """
    inputs, outputs = inputs or {}, outputs or {}
    if not outputs:
        raise DataError(f"experiment '{name}': there are no outputs; give each as (times, values)")
    u = {key: _channel(name, "input", key, pair) for key, pair in inputs.items()}
    z = {key: _channel(name, "output", key, pair) for key, pair in outputs.items()}
    first = max((t[0] for t, _ in u.values()), default=-np.inf)
    last = min((t[-1] for t, _ in u.values()), default=np.inf)
    for key, (t, values) in z.items():
        inside = (t >= first) & (t <= last)
        if not inside.any():
            raise DataError(
                f"experiment '{name}', output '{key}': no sample lies between {first:g} and {last:g}, "
                "where all inputs are"
            )
        z[key] = t[inside], values[inside]
    t, columns = together(z)
    if t.size < 2:
        raise DataError(
            f"experiment '{name}': {t.size} sample(s) between {first:g} and {last:g}; at least 2 are needed"
        )
    signals: dict[str, Signal] = {key: (*pair, 0.0, 0) for key, pair in u.items()}
    kinds = checked_kinds(name, interpolation, u)
    at = {key: interpolated(kind_of(kinds, key), s, v, t) for key, (s, v) in u.items()}
    record = Experiment(t, at, columns, name, kinds, units=units)
    fastest = max(z.values(), key=lambda pair: pair[0].size)[0]
    return record._sampled(signals, fastest)


def distinct(times: FloatArray, same: float) -> FloatArray:
    """Return the times in order; of those within ``same`` (s) of each other only the first."""
    times = np.sort(times)
    return np.asarray(times[np.concatenate([[True], np.diff(times) > same])])


def together(channels: Mapping[str, Channel]) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Return the times of all channels, (N,), and each channel at these, NaN where it has no sample."""
    gaps = [np.diff(t).min() for t, _ in channels.values() if t.size > 1]
    same = _SAME * min(gaps, default=1.0)
    t = distinct(np.concatenate([t for t, _ in channels.values()]), same)
    columns = {}
    for key, (own, values) in channels.items():
        column = np.full(t.size, np.nan)
        # The time kept of a cluster is its first.
        column[np.searchsorted(t, own + 0.5 * same, side="right") - 1] = values
        columns[key] = column
    return t, columns


def _channel(name: str, kind: str, key: str, pair: tuple[ArrayLike, ArrayLike]) -> Channel:
    try:
        t, values = pair
    except (TypeError, ValueError):
        raise DataError(f"experiment '{name}', {kind} '{key}': give (times, values), not {pair!r}") from None
    # Checked as a record of its own, so that it is refused as one.
    of_input = kind == "input"
    record = Experiment(
        t, {key: values} if of_input else None, None if of_input else {key: values}, f"{name}, {kind} {key}"
    )
    return record.t, record.input(key) if of_input else record.output(key)
