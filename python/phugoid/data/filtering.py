"""Digital filters on one evenly sampled channel, and what sampling does to it. All by scipy.signal."""

from __future__ import annotations

import math
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, OptionError

__all__ = [
    "EVEN",
    "Kind",
    "anti_alias",
    "butterworth",
    "even_rate",
    "filtered",
    "intervals",
    "number",
    "polyphase",
    "power_above",
    "settling",
    "whole_from",
]

_Array: TypeAlias = NDArray[np.float64]
Kind: TypeAlias = Literal["highpass", "lowpass"]

# Sampling counts as even when no interval is further than this part from the median.
EVEN = 0.01
# A filter has settled when its slowest mode has fallen to this.
_SETTLED = 0.01
# Half the length of the filter that resamples, in samples at the lower rate.
_REACH = 20


def intervals(t: _Array) -> tuple[float, _Array, NDArray[np.intp]]:
    """The median interval (s), all of them, and which are too far from it for sampling to count as even."""
    steps = np.diff(t)
    step = float(np.median(steps))
    return step, steps, np.flatnonzero(np.abs(steps - step) > EVEN * step)


def even_rate(t: _Array, values: _Array, where: str, purpose: str) -> float:
    """Samples a second of a complete, evenly sampled channel.

    Raises DataError, which begins with ``where`` and names the first gap: a missing sample, or an interval that is
    more than 1 % off the median one. ``purpose`` is what needs it, such as "band_pass".
    """
    step, steps, uneven = intervals(t)
    missing = np.flatnonzero(~np.isfinite(values))
    gap = missing[0] if missing.size else t.size
    if uneven.size and uneven[0] < gap:
        i = int(uneven[0])
        raise DataError(
            f"{where}: {purpose} needs evenly spaced samples, but the interval after t = {t[i]:.6g} s is "
            f"{steps[i]:.6g} s and others are {step:.6g} s ({uneven.size} interval(s) differ): cut there with .window, "
            "or give evenly spaced times if only the time stamps are rough"
        )
    if missing.size:
        raise DataError(
            f"{where}: {purpose} needs a complete channel, but sample {gap} (t = {t[gap]:.6g} s) is missing "
            f"({missing.size} of {t.size} are): fill the gaps, cut with .window, or leave the channel out"
        )
    return float((t.size - 1) / (t[-1] - t[0]))


def number(value: Any, what: str) -> float:
    """A positive finite number; OptionError in the words of ``what`` for anything else."""
    try:
        real = math.nan if isinstance(value, (bool, str)) else float(value)
    except (TypeError, ValueError):
        real = math.nan
    if not (math.isfinite(real) and real > 0.0):
        raise OptionError(f"{what} is a positive number, not {value!r}")
    return real


def whole_from(low: int, value: Any, what: str) -> int:
    """A whole number not below ``low``; OptionError in the words of ``what`` for anything else."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < low:
        raise OptionError(f"{what} is a whole number from {low}, not {value!r}")
    return int(value)


def butterworth(kinds: list[tuple[Kind, float]], order: int, rate: float) -> _Array:
    """Butterworth filters in cascade as second-order sections, (n, 6): each of that order, with its corner in Hz."""
    from scipy.signal import butter

    return np.vstack([butter(order, corner, kind, fs=rate, output="sos") for kind, corner in kinds])


def anti_alias(edge: float, rate: float) -> _Array:
    """The low-pass of `scipy.signal.decimate`: Chebyshev of order 8 with 0.05 dB of ripple up to its edge (Hz)."""
    from scipy.signal import cheby1

    return np.asarray(cheby1(8, 0.05, edge, fs=rate, output="sos"))


def settling(sections: _Array, rate: float) -> float:
    """Time in s in which the slowest mode of a filter falls to 1 %."""
    slowest = max(float(np.abs(np.roots(section[3:])).max(initial=0.0)) for section in sections)
    return math.log(_SETTLED) / math.log(slowest) / rate if slowest > 0.0 else 0.0


def filtered(sections: _Array, values: _Array, zero_phase: bool) -> _Array:
    """A channel (N,) through second-order sections.

    Causal: it starts as if the channel had stood at its first value for ever, so that a record which begins at rest
    has no transient. Zero phase: forward and backward, which doubles the attenuation in dB.
    """
    from scipy.signal import sosfilt, sosfilt_zi, sosfiltfilt

    if zero_phase:
        return np.asarray(sosfiltfilt(sections, values))
    return np.asarray(sosfilt(sections, values, zi=sosfilt_zi(sections) * values[0])[0])


def power_above(values: _Array, share_of_nyquist: float) -> float:
    """Part (0 to 1) of a channel's power, trend apart, above that share of its Nyquist frequency.

    NaN is filled linearly. 0 for a channel that does not move.
    """
    from scipy.signal import periodogram

    there = np.flatnonzero(np.isfinite(values))
    if there.size < 4:
        return 0.0
    whole = np.interp(np.arange(values.size), there, values[there])
    # The window keeps what leaks from low frequencies, where records do not begin and end alike, out of the high.
    f, power = periodogram(whole, fs=2.0, window="hann", detrend="linear")
    size = float(np.abs(whole).max())
    if power.sum() <= (1e-12 * size) ** 2:
        return 0.0
    return float(power[f > share_of_nyquist].sum() / power.sum())


def polyphase(values: _Array, up: int, down: int, where: str) -> _Array:
    """A channel (N,) at up/down times its rate, (ceil(N up/down),), the first sample where it was.

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
