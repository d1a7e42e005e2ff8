"""Preprocessing of measured records: filters, trends, sampling rates; the methods are inherited by `Experiment`.

Each step returns a new record, and adds one sentence to its ``history``.
"""

from __future__ import annotations

import warnings
from abc import abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from typing import Literal, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, OptionError, listing, positive, whole
from ..time_unit import UNKNOWN, TimeUnit, time_unit_of
from .filtering import (
    Columns,
    Interpolations,
    Kind,
    Signal,
    anti_alias,
    butterworth,
    even_rate,
    filtered,
    interpolated,
    kind_of,
    polyphase,
    power_above,
    settling,
)

__all__ = ["Preprocessing"]

_Array: TypeAlias = NDArray[np.float64]
_Self = TypeVar("_Self", bound="Preprocessing")
_Step: TypeAlias = Callable[[str, _Array, _Array], _Array]
"""Takes the channel's name in messages, its times (s) and its values; returns new values at these times."""

# More than this part of a channel's power above the new Nyquist frequency is worth a warning.
_RELEVANT = 0.01


class Preprocessing:
    """The preprocessing steps of a record.

    Filters are linear. The same one on all inputs and outputs leaves the dynamics of a **linear** model as they are,
    since filters commute with it: y = G u means F y = G F u. This is not so for a nonlinear model: its outputs respond
    to the whole input, not to its pass-band; filter such records only to drop what lies far above the motion.
    """

    _name: str
    _t: _Array
    _inputs: dict[str, _Array]
    _outputs: dict[str, _Array]
    _channels: dict[str, _Array]
    _interpolation: Interpolations
    _signals: dict[str, Signal]
    _units: dict[str, str]

    @property
    def time_unit(self) -> TimeUnit:
        """The unit of its times, empty where it is not known."""
        return time_unit_of(self._units, UNKNOWN)

    def _columns_of(self) -> Columns:
        return {"input": self._inputs, "output": self._outputs, "channel": self._channels}

    def _signals_of(self) -> Mapping[str, Signal]:
        """Return the inputs that have samples of their own."""
        return self._signals

    def _is_held(self, name: str) -> bool:
        """Return whether the input of a name is held between its samples."""
        return kind_of(self._interpolation, name) == "hold"

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

    def band_pass(
        self: _Self,
        low: float,
        high: float,
        order: int = 5,
        channels: Sequence[str] | None = None,
        zero_phase: bool = False,
    ) -> _Self:
        """Pass the band from ``low`` to ``high`` (Hz): a Butterworth high-pass, then a low-pass, of that order.

        channels    the channels to filter; None: all, which is necessary to keep a linear model's dynamics (a nonlinear
                    model is no longer right for filtered records).
        zero_phase  forward and backward, which has no delay, doubles the attenuation (6 dB at ``low`` and ``high``
                    instead of 3), and spreads each event to earlier times.

        A causal filter starts as if each channel had been constant at its first value, which is right for a record that
        begins at rest. Otherwise the start contains a transient of the filter that no model explains: ``history`` gives
        its length, and ``.window`` cuts it. A mean or trim value does not pass: the model must be one of small motions.

        Raises OptionError for frequencies that are out of order or not below the Nyquist frequency, DataError for an
        unknown channel, one with missing samples or uneven sampling (with the time of the first gap), and a record
        shorter than the filter takes to settle. (Filters in cascade as in the paper's ground vibration test.)
        """
        low, high = positive("band_pass: low", low), positive("band_pass: high", high)
        if low >= high:
            raise OptionError(f"band_pass: low ({low:g}) must lie below high ({high:g})")
        band = self.time_unit.per(f"{low:g} to {high:g}")
        what = f"band-pass {band}, Butterworth of order {order} twice (high-pass, low-pass)"
        return through_butterworth(
            self, "band_pass", [("highpass", low), ("lowpass", high)], order, channels, zero_phase, what
        )

    def low_pass(
        self: _Self, corner: float, order: int = 5, channels: Sequence[str] | None = None, zero_phase: bool = False
    ) -> _Self:
        """Pass frequencies below ``corner`` (where 3 dB are lost): a Butterworth filter; else as `band_pass`."""
        corner = positive("low_pass: the corner frequency", corner)
        what = f"low-pass {self.time_unit.per(f'{corner:g}')}, Butterworth of order {order}"
        return through_butterworth(self, "low_pass", [("lowpass", corner)], order, channels, zero_phase, what)

    def high_pass(
        self: _Self, corner: float, order: int = 5, channels: Sequence[str] | None = None, zero_phase: bool = False
    ) -> _Self:
        """Pass frequencies above ``corner`` (where 3 dB are lost): a Butterworth filter; else as `band_pass`."""
        corner = positive("high_pass: the corner frequency", corner)
        what = f"high-pass {self.time_unit.per(f'{corner:g}')}, Butterworth of order {order}"
        return through_butterworth(self, "high_pass", [("highpass", corner)], order, channels, zero_phase, what)

    def detrend(
        self: _Self, kind: Literal["constant", "linear"] = "constant", channels: Sequence[str] | None = None
    ) -> _Self:
        """Subtract from each channel its mean, or the straight line that fits it best (least squares).

        Missing samples and uneven times do no harm. ``channels``: None for all. Raises OptionError for another kind,
        DataError for unknown channels.
        """
        if kind not in ("constant", "linear"):
            raise OptionError(f"detrend: kind is 'constant' or 'linear', not {kind!r}")
        span = self._t

        def step(where: str, t: _Array, values: _Array) -> _Array:
            # An input's own samples may reach beyond a window of the record: the trend is that of the window.
            used = np.isfinite(values) & (t >= span[0]) & (t <= span[-1])
            degree = min(int(kind == "linear"), int(used.sum()) - 1)
            if degree < 0:
                return values
            trend = np.polynomial.Polynomial.fit(t[used], values[used], degree, domain=[span[0], span[-1]])
            return np.asarray(values - trend(t))

        removed = "mean" if kind == "constant" else "straight line"
        return mapped(self, "detrend", channels, step, lambda: f"{removed} removed")

    def decimate(self: _Self, factor: int, inputs: int | None = None, *, filter: bool = False) -> _Self:
        """Keep every ``factor``-th sample.

        inputs  keep every so-many-th sample of the inputs instead (a divisor of ``factor``): the estimation then uses
                inputs finer than outputs, with cubic splines between. Straight lines lose 3 dB already at 0.32 of the
                sampling rate (the square of sin(x)/x), which makes parameters wrong. Columns that are not yet assigned
                are kept both ways. Inputs that are held between their samples keep them all in any case: their jumps
                stay where they are.
        filter  first an anti-alias filter on all channels: Chebyshev of order 8, causal, to 0.8 of the new Nyquist
                frequency, as `scipy.signal.decimate` has it. It starts like `band_pass`.

        What lies above the new Nyquist frequency is folded into the band below. Where that is more than 1 % of a
        channel's power a UserWarning says so, and ``history``: low-pass first. Inputs that already have samples of
        their own keep them. Raises OptionError for factors that are not whole or too large, DataError for uneven
        sampling.
        """
        name, t = self._name, self._t
        factor = whole("decimate: factor", factor, 1)
        fine = None if inputs is None else whole("decimate: inputs", inputs, 1)
        if fine is not None and factor % fine:
            raise OptionError(f"decimate: inputs={fine} must divide the factor {factor}, so that samples coincide")
        if (t.size - 1) // factor < 1:
            raise OptionError(
                f"decimate: of the {t.size} samples of experiment '{name}' a factor of {factor} leaves one"
            )
        rate = even_rate(t, t, f"experiment '{name}'", "decimate")
        if fine is not None and self._signals:
            raise OptionError(
                f"decimate: the input '{next(iter(self._signals))}' of experiment '{name}' has samples of its own "
                "already and keeps them: omit inputs"
            )
        if filter:
            edge = 0.4 * rate / factor
            what = f"anti-alias low-pass {self.time_unit.per(f'{edge:g}')}, Chebyshev of order 8"
            return through(self, "decimate", partial(anti_alias, edge), None, False, what).decimate(factor, inputs)
        signals = dict(self._signals)
        columns: dict[str, dict[str, _Array]] = {}
        aliased = []
        for kind, group in self._columns_of().items():
            columns[kind] = {channel: values[::factor] for channel, values in group.items()}
            for channel, values in group.items():
                keeps = fine if fine is not None and kind == "input" else factor
                stays = kind != "output" and (channel in signals or self._is_held(channel))
                share = 0.0 if stays else power_above(values, 1.0 / keeps)
                if share > _RELEVANT:
                    above = self.time_unit.per(f"{0.5 * rate / keeps:g}")
                    aliased.append(f"{100 * share:.2g} % of the power of {channel} above {above}")
        for channel, values in {**self._columns_of()["channel"], **self._columns_of()["input"]}.items():
            if self._is_held(channel):
                if np.isfinite(values).all():  # or it is not an input
                    signals.setdefault(channel, (t, values, 0.0, 0))
            elif fine is not None:
                signals[channel] = t[::fine], values[::fine], 0.0, 0
        step = f"decimated by {factor} to {self.time_unit.per(f'{rate / factor:g}')}"
        if fine is not None:
            step += f", inputs by {fine} to {self.time_unit.per(f'{rate / fine:g}')} with cubic splines between"
        if aliased:
            warnings.warn(
                f"experiment '{name}': decimate({factor}) folds {', '.join(aliased)} into the band below; remove it "
                "first, with .low_pass or with decimate(..., filter=True)",
                UserWarning,
                stacklevel=2,
            )
            step += f"; folded into the band: {', '.join(aliased)}"
        return self._stepped(step, columns, signals, t[::factor], cubic=fine is not None)

    def resample(self: _Self, rate: float) -> _Self:
        """Resample all channels to a lower ``rate`` (Hz), band-limited: content above the new Nyquist frequency is
        removed.

        The filter (`scipy.signal.resample_poly`, zero phase) is true to 0.1 % up to 0.44 of the new rate; near the
        ends of the record, over some 20 new samples, it has to extrapolate. Raises OptionError for a
        higher rate: it would give outputs that were not measured, and standard errors that are too small.
        """
        name, t = self._name, self._t
        for channel in {**self._columns_of()["input"], **self._columns_of()["channel"]}:
            if self._is_held(channel):
                raise OptionError(
                    f"resample: the input '{channel}' of experiment '{name}' is held between its samples, and its "
                    "steps have no limit of frequency: take .low_pass and .decimate, which keep it exact"
                )
        rate = positive("resample: rate", rate)
        old = even_rate(t, t, f"experiment '{name}'", "resample")
        if rate > old * (1.0 + 1e-9):
            raise OptionError(
                f"resample: experiment '{name}' was sampled at a rate of {old:g}, and {rate:g} would make outputs that "
                "were not measured; for finer inputs take .upsample_inputs(factor)"
            )
        if self._signals:
            raise OptionError(
                f"resample: the input '{next(iter(self._signals))}' of experiment '{name}' has samples of its "
                "own: resample before inputs and outputs are given different rates"
            )
        from fractions import Fraction  # not at import: it takes its time

        ratio = Fraction(rate / old).limit_denominator(1000)
        if abs(float(ratio) * old / rate - 1.0) > 1e-6:
            raise OptionError(
                f"resample: {rate:g} is not a simple fraction of the rate {old:g} (a denominator up to 1000)"
            )
        up, down = ratio.numerator, ratio.denominator
        # The last sample at or before the end of the record.
        n = (t.size - 1) * up // down + 1
        columns: dict[str, dict[str, _Array]] = {}
        for kind, group in self._columns_of().items():
            columns[kind] = {}
            for channel, values in group.items():
                where = f"experiment '{name}', {kind} '{channel}'"
                even_rate(t, values, where, "resample")
                columns[kind][channel] = polyphase(values, up, down, where)[:n]
        times = t[0] + np.arange(n) * (down / up) / old
        times[-1] = min(times[-1], t[-1])
        return self._stepped(
            f"resampled from {self.time_unit.per(f'{old:g} to {rate:g}')}, band-limited", columns, {}, times
        )

    def upsample_inputs(self: _Self, factor: int) -> _Self:
        """Resample the inputs to a ``factor`` times higher rate, band-limited, with cubic splines between; outputs are
        unchanged.

        For an input whose content reaches far up to its Nyquist frequency, where lines and splines through the
        samples lose amplitude (lines 3 dB at 0.32 of the sampling rate): with a factor of 4 the input is true to
        0.1 % up to 0.44 of it, except over some 20 samples at either end. Not for inputs that jump or were held
        between samples: these are not band-limited. Columns that are not yet assigned are upsampled as well,
        unless samples are missing; inputs that are held between their samples are left alone.
        """
        name, t = self._name, self._t
        factor = whole("upsample_inputs: factor", factor, 2)
        signals = dict(self._signals)
        columns = self._columns_of()
        done = []
        for kind in ("channel", "input"):
            for channel, values in columns[kind].items():
                if self._is_held(channel) or (kind == "channel" and not np.isfinite(values).all()):
                    continue
                where = f"experiment '{name}', {kind} '{channel}'"
                own, values = signals[channel][:2] if channel in signals else (t, values)
                even_rate(own, values, where, "upsample_inputs")
                fine = np.interp(np.arange(factor * (own.size - 1) + 1) / factor, np.arange(own.size), own)
                between = polyphase(values, factor, 1, where)[: fine.size]
                # Measured values are kept to the bit.
                between[::factor] = values
                signals[channel] = fine, between, 0.0, 0
                done.append(channel)
        if not done:
            raise DataError(f"experiment '{name}': upsample_inputs finds no inputs that are not held between samples")
        step = f"inputs upsampled by {factor}, band-limited, cubic splines between: {', '.join(dict.fromkeys(done))}"
        return self._stepped(step, columns, signals, cubic=True)


def mapped(record: _Self, method: str, channels: Sequence[str] | None, step: _Step, said: Callable[[], str]) -> _Self:
    """Apply ``step`` to each of the channels; an input with samples of its own is processed at these.

    ``said`` gives the sentence for the history, once all is done.
    """
    columns = record._columns_of()
    present = list(dict.fromkeys(channel for group in columns.values() for channel in group))
    name, t = record._name, record._t
    chosen = _chosen(name, method, channels, present)
    signals = dict(record._signals)
    made: dict[str, dict[str, _Array]] = {kind: dict(group) for kind, group in columns.items()}
    for kind, group in columns.items():
        for channel, values in group.items():
            if channel not in chosen:
                continue
            where = f"experiment '{name}', {kind} '{channel}'"
            if kind != "output" and channel in signals:
                own, at_own, delay, derivative = record._signals[channel]
                new = step(where, own, at_own)
                signals[channel] = own, new, delay, derivative
                made[kind][channel] = interpolated(kind_of(record._interpolation, channel), own, new, t)
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
                f"{method}: {highest:g} is not below the Nyquist frequency {0.5 * rate:g} of a record sampled "
                f"at {rate:g}"
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
    times: list[float] = []  # in which the filter settles
    in_unit = record.time_unit.of

    def step(where: str, t: _Array, values: _Array) -> _Array:
        rate = even_rate(t, values, where, method)
        sos = sections(rate)
        wait, length = settling(sos, rate), (values.size - 1) / rate
        # sosfiltfilt continues the record by so much at either end.
        beyond = 3 * (2 * len(sos) + 1) if zero_phase else 0
        if wait > length or values.size <= beyond:
            raise DataError(
                f"{where}: the record is {in_unit(f'{length:.3g}')} long ({values.size} samples), but this filter "
                f"needs {in_unit(f'{max(wait, beyond / rate):.3g}')} to settle: take a longer record, a wider band or "
                "a lower order, or .detrend in place of a slow high-pass"
            )
        rates[where] = rate
        times.append(wait)
        return filtered(sos, values, zero_phase)

    def said() -> str:
        how = (
            "zero phase (forward and backward)" if zero_phase else f"causal, settles in {in_unit(f'{max(times):.2g}')}"
        )
        return f"{what}, {how}"

    done = mapped(record, method, channels, step, said)
    slowest, fastest = min(rates, key=rates.__getitem__), max(rates, key=rates.__getitem__)
    if rates[fastest] > 1.001 * rates[slowest]:
        warnings.warn(
            f"{slowest} is sampled at a rate of {rates[slowest]:g}, {fastest} at {rates[fastest]:g}: digital filters "
            "of two rates differ towards the lower Nyquist frequency, and so would the dynamics: filter before "
            ".decimate",
            UserWarning,
            stacklevel=4,
        )
    return done
