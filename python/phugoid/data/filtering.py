"""Signals: how they behave between samples, and digital filters for evenly sampled ones, with scipy.signal."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

import phugoid._core as _core

from ..errors import DataError, listing

__all__ = [
    "EVEN",
    "Columns",
    "Interpolation",
    "Interpolations",
    "Signal",
    "anti_alias",
    "butterworth",
    "checked_kinds",
    "even_rate",
    "filtered",
    "interpolated",
    "intervals",
    "kind_of",
    "kinds_for",
    "polyphase",
    "power_above",
    "settling",
]

_Array: TypeAlias = NDArray[np.float64]
Signal: TypeAlias = tuple[_Array, _Array, float, int]
"""An input sampled at times of its own: times (s), samples, delay (s), order of the derivative taken."""
Columns: TypeAlias = Mapping[str, Mapping[str, _Array]]
"""Group ("input", "output" or "channel") -> name -> (N,)."""
Kind: TypeAlias = Literal["highpass", "lowpass"]

# Sampling counts as even when no interval is further than this part from the median.
EVEN = 0.01
# A filter has settled when its slowest mode has fallen to this.
_SETTLED = 0.01
# Half the length of the filter that resamples, in samples at the lower rate.
_REACH = 20


def intervals(t: _Array) -> tuple[float, _Array, NDArray[np.intp]]:
    """Return the median interval (s), all intervals, and the indices of those too far from it for even sampling."""
    steps = np.diff(t)
    step = float(np.median(steps))
    return step, steps, np.flatnonzero(np.abs(steps - step) > EVEN * step)


def even_rate(t: _Array, values: _Array, where: str, purpose: str) -> float:
    """Return the sampling rate (Hz) of a complete, evenly sampled channel.

    Raises DataError, which begins with ``where`` and names the first gap: a missing sample, or an interval that is
    more than 1 % off the median one. ``purpose`` names the method that needs it, such as "band_pass".
    """
    step, steps, uneven = intervals(t)
    missing = np.flatnonzero(~np.isfinite(values))
    gap = missing[0] if missing.size else t.size
    if uneven.size and uneven[0] < gap:
        i = int(uneven[0])
        raise DataError(
            f"{where}: {purpose} needs evenly spaced samples, but the interval after t = {t[i]:.6g} is "
            f"{steps[i]:.6g} and others are {step:.6g} ({uneven.size} interval(s) differ): cut there with .window, "
            "or give evenly spaced times if only the time stamps are rough"
        )
    if missing.size:
        raise DataError(
            f"{where}: {purpose} needs a complete channel, but sample {gap} (t = {t[gap]:.6g}) is missing "
            f"({missing.size} of {t.size} are): fill the gaps, cut with .window, or leave the channel out"
        )
    return float((t.size - 1) / (t[-1] - t[0]))


def butterworth(kinds: list[tuple[Kind, float]], order: int, rate: float) -> _Array:
    """Return Butterworth filters in cascade as second-order sections, (n, 6): each of that order, with its corner in
    Hz."""
    from scipy.signal import butter

    return np.vstack([butter(order, corner, kind, fs=rate, output="sos") for kind, corner in kinds])


def anti_alias(edge: float, rate: float) -> _Array:
    """Return the low-pass of `scipy.signal.decimate`: Chebyshev, order 8, 0.05 dB ripple up to its edge (Hz)."""
    from scipy.signal import cheby1

    return np.asarray(cheby1(8, 0.05, edge, fs=rate, output="sos"))


def settling(sections: _Array, rate: float) -> float:
    """Return the time in s in which the slowest mode of a filter falls to 1 %."""
    slowest = max(float(np.abs(np.roots(section[3:])).max(initial=0.0)) for section in sections)
    return math.log(_SETTLED) / math.log(slowest) / rate if slowest > 0.0 else 0.0


def filtered(sections: _Array, values: _Array, zero_phase: bool) -> _Array:
    """Return a channel (N,) passed through second-order sections.

    Causal: it starts as if the channel had stood at its first value for ever, so that a record which begins at rest
    has no transient. Zero phase: forward and backward, which doubles the attenuation in dB.
    """
    from scipy.signal import sosfilt, sosfilt_zi, sosfiltfilt

    if zero_phase:
        return np.asarray(sosfiltfilt(sections, values))
    return np.asarray(sosfilt(sections, values, zi=sosfilt_zi(sections) * values[0])[0])


def power_above(values: _Array, share_of_nyquist: float) -> float:
    """Return the part (0 to 1) of a detrended channel's power above a part of its Nyquist frequency.

    NaN is filled linearly. 0 for a channel that does not move.
    """
    from scipy.signal import periodogram

    there = np.flatnonzero(np.isfinite(values))
    if there.size < 4:
        return 0.0
    whole = np.interp(np.arange(values.size), there, values[there])
    # The window limits leakage from low to high frequencies where records do not begin and end alike.
    f, power = periodogram(whole, fs=2.0, window="hann", detrend="linear")
    size = float(np.abs(whole).max())
    if power.sum() <= (1e-12 * size) ** 2:
        return 0.0
    return float(power[f > share_of_nyquist].sum() / power.sum())


def polyphase(values: _Array, up: int, down: int, where: str) -> _Array:
    """Return a channel (N,) resampled to up/down times its rate, (ceil(N up/down),), starting at the same time.

    Band-limited: `scipy.signal.resample_poly` with a filter that is true to 0.1 % up to 0.44 of the lower rate and
    falls by 70 dB from there to 0.56. The channel is continued beyond its ends by its image turned about them, so
    that neither value nor slope jumps there. Raises DataError where it is shorter than the filter.
    """
    from scipy.signal import firwin, resample_poly

    longer = max(up, down)
    half = _REACH * longer
    beyond = -(-half // (up * down)) * down
    if values.size <= beyond:
        raise DataError(f"{where}: has {values.size} samples, too few to resample: at least {beyond + 1} are needed")
    wide = np.pad(values, beyond, mode="reflect", reflect_type="odd")
    fir = firwin(2 * half + 1, 1.0 / longer, window=("kaiser", 7.0))
    first = beyond // down * up
    return np.asarray(resample_poly(wide, up, down, window=fir)[first : first + -(-values.size * up // down)])


Interpolation = Literal["linear", "cubic", "hold"]
"""Straight lines, a cubic spline, or each sample held until the next (zero-order hold)."""
Interpolations: TypeAlias = "Interpolation | Mapping[str, Interpolation]"
"""One for all inputs, or by name; ``"linear"`` for inputs that are not named."""

_KINDS = "take 'linear', 'cubic' or 'hold', or a mapping such as {'de': 'hold'}"


def checked_kinds(experiment: str, kinds: object, names: Iterable[str]) -> Interpolations:
    """Return a declaration for channels of these names, as a copy of its own.

    Raises DataError for unknown kinds and unknown names.
    """
    if isinstance(kinds, str):
        _check(f"experiment '{experiment}'", kinds)
        return kinds  # type: ignore[return-value]
    if not isinstance(kinds, Mapping):
        raise DataError(f"experiment '{experiment}': interpolation {kinds!r} is not known; {_KINDS}")
    there = list(names)
    for name, kind in kinds.items():
        if name not in there:
            raise DataError(
                f"experiment '{experiment}': interpolation names the input '{name}', which is not there."
                f"{listing(str(name), there)}"
            )
        _check(f"experiment '{experiment}', input '{name}'", kind)
    return dict(kinds)


def _check(where: str, kind: object) -> None:
    if not isinstance(kind, str) or kind not in get_args(Interpolation):
        raise DataError(f"{where}: interpolation {kind!r} is not known; {_KINDS}")


def kind_of(kinds: Interpolations, name: str) -> Interpolation:
    """Return how the input of a name behaves between its samples."""
    return kinds if isinstance(kinds, str) else kinds.get(name, "linear")


def kinds_for(kinds: Interpolations, names: Iterable[str]) -> Interpolations:
    """Return the declaration for these inputs alone: one for all where they agree."""
    by_name = {name: kind_of(kinds, name) for name in names}
    if isinstance(kinds, str) or not by_name:
        return kinds if isinstance(kinds, str) else "linear"
    first, *others = set(by_name.values())
    return by_name if others else first


def interpolated(kind: Interpolation, t: _Array, values: _Array, at: _Array) -> _Array:
    """Return the values at the times ``at`` (s, any shape) of a signal sampled at the times ``t`` (s)."""
    found = _core.interpolate(kind, t.tolist(), values.tolist(), at.ravel().tolist())
    return np.array(found, dtype=np.float64).reshape(at.shape)
