"""Energy spectrum of an input, and the step length that excites a mode."""

from __future__ import annotations

from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import OptionError, did_you_mean
from ..linear.mode_table import Mode
from .grid import grid, number

__all__ = ["spectrum", "step_width"]

_Array = NDArray[np.float64]
_Kind: TypeAlias = Literal["doublet", "3-2-1-1", "pulse"]

# Numbers of one block of frequencies times samples.
_BLOCK = 1_000_000


def spectrum(t: ArrayLike, u: ArrayLike, frequency_hz: ArrayLike | None = None) -> tuple[_Array, _Array]:
    """Return frequencies (Hz) and the energy spectrum |U(f)|^2, U(f) = integral of u exp(-2 pi j f t) dt, unit²·s².

    ``u`` (N,), linear between the samples, as an experiment's inputs are: the integral is exact. ``frequency_hz`` (M,):
    400 from 0 to half the sampling rate, equally spaced, unless given. Subtract the trim first, if there is one.

    >>> f, energy = spectrum([0.0, 1.0, 2.0], [0.0, 1.0, 0.0], [0.0, 0.5])
    >>> energy.round(4)
    array([1.    , 0.1643])
    """
    times = grid("spectrum", t)
    values = np.asarray(u, dtype=np.float64)
    if values.shape != times.shape or not np.isfinite(values).all():
        raise OptionError(f"spectrum: u holds a finite value for each of the {times.size} times")
    if frequency_hz is None:
        f = np.linspace(0.0, 0.5 / float(np.median(np.diff(times))), 400)
    else:
        f = np.atleast_1d(np.asarray(frequency_hz, dtype=np.float64))
    if f.ndim != 1 or not np.isfinite(f).all() or (f < 0.0).any():
        raise OptionError("spectrum: frequency_hz holds frequencies in Hz, from 0")
    step = np.diff(times)
    middle, mean, half = 0.5 * (times[1:] + times[:-1]), 0.5 * (values[1:] + values[:-1]), 0.5 * np.diff(values)
    found = np.empty(f.size)
    each = max(_BLOCK // times.size, 1)
    for begin in range(0, f.size, each):
        omega = 2.0 * np.pi * f[begin : begin + each, None]
        x = 0.5 * omega * step
        # Over one interval: of the mean sin(x)/x, of the slope -j (sin x - x cos x)/x^2, by its series for small x.
        small = np.abs(x) < 1e-3
        safe = np.where(small, 1.0, x)
        slope = np.where(small, x / 3.0, (np.sin(safe) - safe * np.cos(safe)) / safe**2)
        parts = step * np.exp(-1j * omega * middle) * (mean * np.sinc(x / np.pi) - 1j * half * slope)
        found[begin : begin + each] = np.abs(parts.sum(axis=1)) ** 2
    return f, found


def step_width(mode: Mode | float, kind: _Kind = "3-2-1-1") -> float:
    """Return the length of a step of length 1 (s) with which a pattern excites a mode.

    ``mode``: one of `phugoid.linear.modes`, or its natural frequency in Hz.

    "doublet"   its spectrum, 4 sin²(ωT/2)/ω, is highest at the mode: T = 2.331/ω_n = 0.371/f_n.
    "3-2-1-1"   the step of length 2 is half a period of the mode: T = π/(2 ω_n) = 0.25/f_n. The energy at the mode is
                then 0.78 of the greatest (0.99 where it is balanced), and above a quarter of it up to 1.8 f_n.
    "pulse"     half a period, 0.5/f_n: most energy there, 4 sin²(ωT/2)/ω², that a pulse of this height can have.

    (See Jategaonkar, ch. 2, and Klein and Morelli, ch. 9, for such rules; the numbers here are those of the spectra.)

    >>> round(step_width(0.5, "doublet"), 3)
    0.742
    """
    if kind not in get_args(_Kind):
        hint = did_you_mean(str(kind), get_args(_Kind))
        raise OptionError(f"step_width: kind is one of {', '.join(get_args(_Kind))}, not {kind!r}.{hint}")
    if isinstance(mode, Mode):
        if not mode.oscillates:
            raise OptionError("step_width: this mode does not oscillate: give the frequency that is to be excited, Hz")
        frequency = number("step_width", "the mode's frequency", mode.frequency.value, positive=True)
    else:
        frequency = number("step_width", "mode (a Mode, or its frequency in Hz)", mode, positive=True)
    return {"doublet": 0.3710, "3-2-1-1": 0.25, "pulse": 0.5}[kind] / frequency
