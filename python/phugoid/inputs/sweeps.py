"""Sine sweeps."""

from __future__ import annotations

from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import OptionError, did_you_mean
from .grid import grid, number, pair, placed

__all__ = ["sweep"]

_Array = NDArray[np.float64]
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
    """A sine whose frequency goes through ``band`` (lowest, highest), Hz.

    t          (N,) times, s.
    amplitude  unit of the input.
    start      s; the first time unless given. ``duration``: s; to the last time unless given.
    pace       "log": each octave takes as long as the others; "linear": each Hz.
    fade       s over which it grows at the beginning and dies away at the end.

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
            f"sweep: {high:g} Hz is above half the sampling rate ({0.5 / np.diff(times).max():g} Hz); "
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
        raise OptionError(f"sweep: fade is from 0 to half the duration of {length:g} s, not {fade:g}")
    if ramp > 0.0:
        u *= np.clip(np.minimum(since, length - since) / ramp, 0.0, 1.0)
    u[(times < begin) | (times > begin + length)] = 0.0
    return np.asarray(u)
