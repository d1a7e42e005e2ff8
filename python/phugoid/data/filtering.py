"""Digital filters on evenly sampled channels, and on each channel of a record, with scipy.signal."""

from __future__ import annotations

import math
import warnings
from abc import abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Literal, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, OptionError, listing, whole

__all__ = [
    "EVEN",
    "Channelled",
    "Columns",
    "Signal",
    "anti_alias",
    "even_rate",
    "intervals",
    "mapped",
    "polyphase",
    "power_above",
    "through",
    "through_butterworth",
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


Signal: TypeAlias = tuple[_Array, _Array, float, int]
"""An input sampled at times of its own: times (s), samples, delay (s), order of the derivative taken."""
Columns: TypeAlias = Mapping[str, Mapping[str, _Array]]
"""Group ("input", "output" or "channel") -> name -> (N,)."""
_Step: TypeAlias = Callable[[str, _Array, _Array], _Array]
"""Takes the channel's name in messages, its times (s) and its values; returns new values at these times."""
_Self = TypeVar("_Self", bound="Channelled")


class Channelled:
    """The part of a record that the preprocessing steps need."""

    @abstractmethod
    def _columns_of(self) -> Columns:
        """Return the columns by group."""

    @abstractmethod
    def _signals_of(self) -> Mapping[str, Signal]:
        """Return the inputs that have samples of their own."""

    @abstractmethod
    def _times(self) -> tuple[str, _Array]:
        """Return the name of the record and its sample times, (N,)."""

    @abstractmethod
    def _between(self, name: str, signal: Signal) -> _Array:
        """Return the samples of an input that has its own, interpolated at the times of the record."""

    @abstractmethod
    def _is_held(self, name: str) -> bool:
        """Tell whether the input of a name is held between its samples."""

    @abstractmethod
    def _stepped(
        self: _Self,
        step: str,
        columns: Columns,
        signals: Mapping[str, Signal],
        t: _Array | None = None,
        cubic: bool = False,
    ) -> _Self:
        """Return the record with other columns and signals, at other times where given, and a sentence for its
        history."""


def mapped(record: _Self, method: str, channels: Sequence[str] | None, step: _Step, said: Callable[[], str]) -> _Self:
    """Apply ``step`` to each of the channels; an input with samples of its own is processed at these.

    ``said`` gives the sentence for the history, once all is done.
    """
    columns = record._columns_of()
    present = list(dict.fromkeys(channel for group in columns.values() for channel in group))
    name, t = record._times()
    chosen = _chosen(name, method, channels, present)
    signals = dict(record._signals_of())
    made: dict[str, dict[str, _Array]] = {kind: dict(group) for kind, group in columns.items()}
    for kind, group in columns.items():
        for channel, values in group.items():
            if channel not in chosen:
                continue
            where = f"experiment '{name}', {kind} '{channel}'"
            if kind != "output" and channel in signals:
                own, at_own, delay, derivative = record._signals_of()[channel]
                signals[channel] = own, step(where, own, at_own), delay, derivative
                made[kind][channel] = record._between(channel, signals[channel])
            else:
                made[kind][channel] = step(where, t, values)
    return record._stepped(f"{said()}: {', '.join(n for n in present if n in chosen)}", made, signals)


def _chosen(name: str, method: str, channels: Sequence[str] | None, present: Sequence[str]) -> Collection[str]:
    if channels is None:
        if not present:
            raise DataError(f"{method}: experiment '{name}' has no channels")
        return present
    if isinstance(channels, str):
        raise DataError(f"{method}: channels='{channels}' is text: give a list, such as channels=['{channels}']")
    if not channels:
        raise DataError(f"{method}: channels is empty; leave it away for all")
    for channel in channels:
        if channel not in present:
            raise DataError(f"{method}: experiment '{name}' has no channel '{channel}'.{listing(channel, present)}")
    return channels


def through_butterworth(
    record: _Self,
    method: str,
    kinds: list[tuple[Kind, float]],
    order: int,
    channels: Sequence[str] | None,
    zero_phase: bool,
    what: str,
) -> _Self:
    """Filter the channels with Butterworth filters in cascade."""
    order = whole(f"{method}: order", order, 1)

    def sections(rate: float) -> _Array:
        highest = max(corner for _, corner in kinds)
        if highest >= 0.5 * rate * (1.0 - 1e-9):
            raise OptionError(
                f"{method}: {highest:g} Hz is not below the Nyquist frequency {0.5 * rate:g} Hz of a record sampled "
                f"at {rate:g} Hz"
            )
        return butterworth(kinds, order, rate)

    return through(record, method, sections, channels, zero_phase, what)


def through(
    record: _Self,
    method: str,
    sections: Callable[[float], _Array],
    channels: Sequence[str] | None,
    zero_phase: bool,
    what: str,
) -> _Self:
    """Filter the channels; the filter is designed for the sampling rate of each."""
    rates: dict[str, float] = {}
    times: list[float] = []  # s, in which the filter settles

    def step(where: str, t: _Array, values: _Array) -> _Array:
        rate = even_rate(t, values, where, method)
        sos = sections(rate)
        wait, length = settling(sos, rate), (values.size - 1) / rate
        # sosfiltfilt continues the record by so much at either end.
        beyond = 3 * (2 * len(sos) + 1) if zero_phase else 0
        if wait > length or values.size <= beyond:
            raise DataError(
                f"{where}: the record is {length:.3g} s long ({values.size} samples), but this filter needs "
                f"{max(wait, beyond / rate):.3g} s to settle: take a longer record, a wider band or a lower order, "
                "or .detrend in place of a slow high-pass"
            )
        rates[where] = rate
        times.append(wait)
        return filtered(sos, values, zero_phase)

    def said() -> str:
        how = "zero phase (forward and backward)" if zero_phase else f"causal, settles in {max(times):.2g} s"
        return f"{what}, {how}"

    done = mapped(record, method, channels, step, said)
    slowest, fastest = min(rates, key=rates.__getitem__), max(rates, key=rates.__getitem__)
    if rates[fastest] > 1.001 * rates[slowest]:
        warnings.warn(
            f"{slowest} is sampled at {rates[slowest]:g} Hz and {fastest} at {rates[fastest]:g} Hz: digital filters of "
            "two rates differ towards the lower Nyquist frequency, and so would the dynamics; filter before .decimate",
            UserWarning,
            stacklevel=4,
        )
    return done
