"""Inputs made of steps, such as doublets and 3-2-1-1, and the sampling times of manoeuvres."""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Real
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import OptionError, did_you_mean

__all__ = [
    "PATTERNS",
    "doublet",
    "grid",
    "multistep",
    "number",
    "pair",
    "placed",
    "pulse",
    "rate_limited",
    "step",
    "sweep",
    "three_two_one_one",
]

_Array = NDArray[np.float64]


def grid(caller: str, t: ArrayLike) -> _Array:
    """Return times (N,), s, checked to increase."""
    try:
        times = np.asarray(t, dtype=np.float64)
    except (TypeError, ValueError):
        raise OptionError(f"{caller}: t holds the times of the samples in s, not {t!r}") from None
    if times.ndim != 1 or times.size < 2 or not np.isfinite(times).all() or not (np.diff(times) > 0.0).all():
        raise OptionError(f"{caller}: t holds at least 2 times in s that increase, as in numpy.arange(0, 20, 0.02)")
    return times


def number(caller: str, what: str, value: Any, positive: bool = False) -> float:
    """Return a finite number, above 0 where ``positive``; raise OptionError for anything else."""
    if not isinstance(value, (Real, np.generic)) or isinstance(value, bool) or not np.isfinite(float(value)):
        raise OptionError(f"{caller}: {what} is a number, not {value!r}")
    if positive and float(value) <= 0.0:
        raise OptionError(f"{caller}: {what} is a positive number, not {value!r}")
    return float(value)


def pair(caller: str, what: str, value: Any) -> tuple[float, float]:
    """Return two positive numbers, the lower one first; raise OptionError for anything else."""
    try:
        low, high = value
    except (TypeError, ValueError):
        raise OptionError(f"{caller}: {what} is a pair such as (0.1, 2.0), not {value!r}") from None
    first, last = (number(caller, f"{what}[{i}]", v, positive=True) for i, v in enumerate((low, high)))
    if not first < last:
        raise OptionError(f"{caller}: {what} is (lowest, highest), not ({first:g}, {last:g})")
    return first, last


def placed(caller: str, t: _Array, start: float | None, end: float | None) -> None:
    """Raise OptionError unless a manoeuvre lies within the grid."""
    slack = 1e-9 * (t[-1] - t[0])
    if start is not None and not t[0] - slack <= start < t[-1]:
        raise OptionError(f"{caller}: start is {start:g}, but the times run from {t[0]:g} to {t[-1]:g}")
    if end is not None and end > t[-1] + slack:
        raise OptionError(f"{caller}: it ends at {end:g}, but the times only run to {t[-1]:g}: give more of them")


def rate_limited(t: ArrayLike, u: ArrayLike, rate: float) -> _Array:
    """Return an input that follows ``u`` (N,) with no more than ``rate`` (its unit per s) up and down.

    It starts at u[0]. Raises OptionError where sizes differ or the rate is not positive.

    >>> rate_limited([0.0, 1.0, 2.0, 3.0], [0.0, 5.0, 5.0, 5.0], rate=2.0)
    array([0., 2., 4., 5.])
    """
    times = grid("rate_limited", t)
    values = np.array(u, dtype=np.float64)
    if values.shape != times.shape:
        raise OptionError(f"rate_limited: u has shape {values.shape}, but t {times.shape}")
    return limited(times, values, number("rate_limited", "rate", rate, positive=True))


def limited(t: _Array, u: _Array, rate: float) -> _Array:
    """Return the rate-limited input, of arguments that were checked."""
    out = u.copy()
    reach = rate * np.diff(t)
    for k in range(reach.size):
        out[k + 1] = out[k] + min(max(u[k + 1] - out[k], -reach[k]), reach[k])
    return out


# Lengths of the steps in units, and their heights.
PATTERNS: dict[str, tuple[tuple[int, ...], tuple[float, ...]]] = {
    "doublet": ((1, 1), (1.0, -1.0)),
    "3-2-1-1": ((3, 2, 1, 1), (1.0, -1.0, 1.0, -1.0)),
    # The long first step lower, so that ups and downs cancel (3 * 2/3 - 2 + 1 - 1 = 0).
    "balanced 3-2-1-1": ((3, 2, 1, 1), (2.0 / 3.0, -1.0, 1.0, -1.0)),
}


def multistep(
    t: ArrayLike,
    amplitude: float,
    lengths: Sequence[float],
    *,
    width: float,
    heights: Sequence[float] | None = None,
    start: float | None = None,
    rise: float | None = None,
) -> _Array:
    """Return a sequence of steps, each ``lengths[i] * width`` long, of height ``heights[i] * amplitude``.

    t          (N,) times, s.
    amplitude  unit of the input; its sign is that of the first step.
    width      of a step of length 1, s.
    heights    1, -1, 1, ... unless given.
    start      s; the first time unless given.
    rise       s that the actuator takes for a change by one amplitude: the rate is limited to amplitude/rise. None: the
               step takes one interval between samples (an experiment's inputs are linear between samples).

    Returns (N,), 0 before and after. Raises OptionError where the steps do not end within the times, or where one is
    shorter than an interval between samples.

    >>> multistep(np.arange(8.0), 2.0, (3, 2, 1), width=1.0, start=1.0)
    array([ 0.,  2.,  2.,  2., -2., -2.,  2.,  0.])
    """
    return _steps("multistep", t, amplitude, lengths, heights, width, start, rise)


def doublet(
    t: ArrayLike, amplitude: float, *, width: float, start: float | None = None, rise: float | None = None
) -> _Array:
    """Return a step up and one down, ``width`` (s) each. Much of its energy is near 0.37/width Hz. Otherwise see
    `multistep`."""
    return _steps("doublet", t, amplitude, *PATTERNS["doublet"], width, start, rise)


def three_two_one_one(
    t: ArrayLike,
    amplitude: float,
    *,
    width: float,
    balanced: bool = False,
    heights: Sequence[float] | None = None,
    start: float | None = None,
    rise: float | None = None,
) -> _Array:
    """Return the 3-2-1-1 of DLR: steps of 3, 2, 1 and 1 ``width`` (s), up and down; broader in frequency than a
    doublet.

    ``balanced``: the first step is lower by a third, so that ups and downs cancel and the vehicle drifts less from its
    trim. ``heights``: four of your own, such as (1.0, -0.9, 0.8, -0.8). For the rest see `multistep`.
    (Jategaonkar, ch. 2; Klein and Morelli, ch. 9.)
    """
    lengths, usual = PATTERNS["balanced 3-2-1-1" if balanced else "3-2-1-1"]
    if heights is not None and balanced:
        raise OptionError("three_two_one_one: balanced determines the heights; give one of the two")
    return _steps("three_two_one_one", t, amplitude, lengths, usual if heights is None else heights, width, start, rise)


def pulse(
    t: ArrayLike, amplitude: float, *, width: float, start: float | None = None, rise: float | None = None
) -> _Array:
    """Return one step of ``width`` (s), and back. Otherwise see `multistep`."""
    return _steps("pulse", t, amplitude, (1,), (1.0,), width, start, rise)


def step(t: ArrayLike, amplitude: float, *, start: float | None = None, rise: float | None = None) -> _Array:
    """Return a step at ``start`` (s) that stays. Otherwise see `multistep`."""
    times = grid("step", t)
    begin = times[0] if start is None else number("step", "start", start)
    placed("step", times, begin, None)
    height = number("step", "amplitude", amplitude)
    return _risen("step", times, np.where(times >= begin - _slack(times), height, 0.0), height, rise)


def _steps(
    caller: str,
    t: ArrayLike,
    amplitude: float,
    lengths: Sequence[float],
    heights: Sequence[float] | None,
    width: float,
    start: float | None,
    rise: float | None,
) -> _Array:
    times = grid(caller, t)
    size = number(caller, "amplitude", amplitude)
    unit = number(caller, "width", width, positive=True)
    parts = [number(caller, f"lengths[{i}]", v, positive=True) for i, v in enumerate(lengths)]
    if not parts:
        raise OptionError(f"{caller}: lengths holds the lengths of the steps, such as (3, 2, 1, 1)")
    given = [(-1.0) ** i for i in range(len(parts))] if heights is None else list(heights)
    if len(given) != len(parts):
        raise OptionError(f"{caller}: {len(given)} heights for {len(parts)} steps: give one each")
    levels = np.array([number(caller, f"heights[{i}]", v) for i, v in enumerate(given)])
    begin = times[0] if start is None else number(caller, "start", start)
    ends = begin + unit * np.cumsum([0.0, *parts])
    placed(caller, times, begin, float(ends[-1]))
    if unit * min(parts) < np.diff(times).max() * (1.0 - 1e-6):
        raise OptionError(
            f"{caller}: the shortest step lasts {unit * min(parts):g}, but the samples are up to "
            f"{np.diff(times).max():g} apart: give longer steps, or more samples"
        )
    # Times such as 0.1*k carry rounding: a step begins at the sample that it means.
    which = np.searchsorted(ends, times + _slack(times), side="right")
    return _risen(caller, times, size * np.array([0.0, *levels, 0.0])[which], size, rise)


def _slack(t: _Array) -> float:
    return 1e-6 * float(np.diff(t).min())


def _risen(caller: str, t: _Array, u: _Array, size: float, rise: float | None) -> _Array:
    if rise is None or size == 0.0:
        return u
    return limited(t, u, abs(size) / number(caller, "rise", rise, positive=True))


_Pace: TypeAlias = Literal["log", "linear"]


def sweep(
    t: ArrayLike,
    amplitude: float,
    *,
    band: tuple[float, float],
    start: float | None = None,
    duration: float | None = None,
    pace: _Pace = "log",
    fade: float = 0.0,
) -> _Array:
    """Return a sine whose frequency goes through ``band`` (lowest, highest), Hz.

    t          (N,) times, s.
    amplitude  unit of the input.
    start      s; the first time unless given. ``duration``: s; to the last time unless given.
    pace       "log": each octave takes as long as the others; "linear": each Hz.
    fade       s over which the amplitude grows at the beginning and decays at the end.

    Returns (N,). Raises OptionError for a band beyond half the sampling rate, or a sweep that does not end within the
    times. (Klein and Morelli, ch. 9; M. B. Tischler and R. K. Remple, Aircraft and Rotorcraft System Identification,
    ch. 5.)

    >>> u = sweep(np.arange(0.0, 30.0, 0.02), 0.05, band=(0.1, 2.0), start=2.0, duration=25.0)
    >>> float(abs(u).max()) <= 0.05, float(u[-1])
    (True, 0.0)
    """
    times = grid("sweep", t)
    size = number("sweep", "amplitude", amplitude)
    low, high = pair("sweep", "band", band)
    if pace not in get_args(_Pace):
        raise OptionError(f"sweep: pace is 'log' or 'linear', not {pace!r}.{did_you_mean(str(pace), get_args(_Pace))}")
    begin = times[0] if start is None else number("sweep", "start", start)
    length = times[-1] - begin if duration is None else number("sweep", "duration", duration, positive=True)
    placed("sweep", times, begin, begin + length)
    if high > 0.5 / np.diff(times).max():
        raise OptionError(
            f"sweep: {high:g} is above half the sampling rate ({0.5 / np.diff(times).max():g}); "
            "take 5 samples a period at least"
        )
    since = np.clip(times - begin, 0.0, length)
    if pace == "log":
        rate = np.log(high / low) / length
        phase = low * np.expm1(rate * since) / rate
    else:
        phase = low * since + 0.5 * (high - low) / length * since**2
    u = size * np.sin(2.0 * np.pi * phase)
    ramp = number("sweep", "fade", fade)
    if ramp < 0.0 or 2.0 * ramp > length:
        raise OptionError(f"sweep: fade is from 0 to half the duration of {length:g}, not {fade:g}")
    if ramp > 0.0:
        u *= np.clip(np.minimum(since, length - since) / ramp, 0.0, 1.0)
    u[(times < begin) | (times > begin + length)] = 0.0
    return np.asarray(u)
