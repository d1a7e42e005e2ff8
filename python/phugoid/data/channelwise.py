"""What is done to the channels of a record one by one, each at times of its own."""

from __future__ import annotations

import warnings
from abc import abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, OptionError, listing
from .filtering import Kind, butterworth, even_rate, filtered, settling, whole_from

__all__ = ["Channelled", "Columns", "Signal", "mapped", "through", "through_butterworth"]

_Array: TypeAlias = NDArray[np.float64]
Signal: TypeAlias = tuple[_Array, _Array, float, int]
"""An input sampled at times of its own: times (s), samples, delay (s), order of the derivative taken."""
Columns: TypeAlias = Mapping[str, Mapping[str, _Array]]
"""Group ("input", "output" or "channel") -> name -> (N,)."""
_Step: TypeAlias = Callable[[str, _Array, _Array], _Array]
"""How messages call the channel, its times (s), its values -> new values at these times."""
_Self = TypeVar("_Self", bound="Channelled")


class Channelled:
    """What a step needs of a record."""

    @abstractmethod
    def _columns_of(self) -> Columns:
        """The columns by group."""

    @abstractmethod
    def _signals_of(self) -> Mapping[str, Signal]:
        """Inputs that have samples of their own."""

    @abstractmethod
    def _times(self) -> tuple[str, _Array]:
        """Name of the record and the times of its samples, (N,)."""

    @abstractmethod
    def _between(self, name: str, signal: Signal) -> _Array:
        """The own samples of the input of a name interpolated at the times of the record."""

    @abstractmethod
    def _is_held(self, name: str) -> bool:
        """Whether the input of a name is held between its samples."""

    @abstractmethod
    def _stepped(
        self: _Self,
        step: str,
        columns: Columns,
        signals: Mapping[str, Signal],
        t: _Array | None = None,
        cubic: bool = False,
    ) -> _Self:
        """The same record with other columns and signals, at other times where given, and the step's sentence."""


def mapped(record: _Self, method: str, channels: Sequence[str] | None, step: _Step, said: Callable[[], str]) -> _Self:
    """Each of the channels by itself through ``step``; an input with samples of its own at these.

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
    """Butterworth filters in cascade."""
    order = whole_from(1, order, f"{method}: order")

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
    """The channels through a filter, which is made for the rate of each."""
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
