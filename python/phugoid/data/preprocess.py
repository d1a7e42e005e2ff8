"""Preprocessing of measured records: filters, trends, sampling rates; the methods are inherited by `Experiment`.

Each step returns a new record, and adds one sentence to its ``history``.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from fractions import Fraction
from functools import partial
from typing import Literal, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, OptionError, positive, whole
from .filtering import (
    Channelled,
    Signal,
    anti_alias,
    even_rate,
    mapped,
    polyphase,
    power_above,
    through,
    through_butterworth,
)

__all__ = ["Preprocessing", "Signal"]

_Array: TypeAlias = NDArray[np.float64]
_Self = TypeVar("_Self", bound="Preprocessing")

# More than this part of a channel's power above the new Nyquist frequency is worth a warning.
_RELEVANT = 0.01


class Preprocessing(Channelled):
    """The preprocessing steps of a record.

    Filters are linear. The same one on all inputs and outputs leaves the dynamics of a **linear** model as they are,
    since filters commute with it: y = G u means F y = G F u. This is not so for a nonlinear model: its outputs respond
    to the whole input, not to its pass-band; filter such records only to drop what lies far above the motion.
    """

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
        low, high = positive("band_pass: low (Hz)", low), positive("band_pass: high (Hz)", high)
        if low >= high:
            raise OptionError(f"band_pass: low ({low:g} Hz) must lie below high ({high:g} Hz)")
        what = f"band-pass {low:g} to {high:g} Hz, Butterworth of order {order} twice (high-pass, low-pass)"
        return through_butterworth(
            self, "band_pass", [("highpass", low), ("lowpass", high)], order, channels, zero_phase, what
        )

    def low_pass(
        self: _Self, corner: float, order: int = 5, channels: Sequence[str] | None = None, zero_phase: bool = False
    ) -> _Self:
        """Pass frequencies below ``corner`` (Hz, where 3 dB are lost): a Butterworth filter; else as `band_pass`."""
        corner = positive("low_pass: the corner frequency (Hz)", corner)
        what = f"low-pass {corner:g} Hz, Butterworth of order {order}"
        return through_butterworth(self, "low_pass", [("lowpass", corner)], order, channels, zero_phase, what)

    def high_pass(
        self: _Self, corner: float, order: int = 5, channels: Sequence[str] | None = None, zero_phase: bool = False
    ) -> _Self:
        """Pass frequencies above ``corner`` (Hz, where 3 dB are lost): a Butterworth filter; else as `band_pass`."""
        corner = positive("high_pass: the corner frequency (Hz)", corner)
        what = f"high-pass {corner:g} Hz, Butterworth of order {order}"
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
        _, span = self._times()

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
        name, t = self._times()
        factor = whole("decimate: factor", factor, 1)
        fine = None if inputs is None else whole("decimate: inputs", inputs, 1)
        if fine is not None and factor % fine:
            raise OptionError(f"decimate: inputs={fine} must divide the factor {factor}, so that samples coincide")
        if (t.size - 1) // factor < 1:
            raise OptionError(
                f"decimate: of the {t.size} samples of experiment '{name}' a factor of {factor} leaves one"
            )
        rate = even_rate(t, t, f"experiment '{name}'", "decimate")
        if fine is not None and self._signals_of():
            raise OptionError(
                f"decimate: the input '{next(iter(self._signals_of()))}' of experiment '{name}' has samples of its own "
                "already and keeps them: leave inputs away"
            )
        if filter:
            edge = 0.4 * rate / factor
            what = f"anti-alias low-pass {edge:g} Hz, Chebyshev of order 8"
            return through(self, "decimate", partial(anti_alias, edge), None, False, what).decimate(factor, inputs)
        signals = dict(self._signals_of())
        columns: dict[str, dict[str, _Array]] = {}
        aliased = []
        for kind, group in self._columns_of().items():
            columns[kind] = {channel: values[::factor] for channel, values in group.items()}
            for channel, values in group.items():
                keeps = fine if fine is not None and kind == "input" else factor
                stays = kind != "output" and (channel in signals or self._is_held(channel))
                share = 0.0 if stays else power_above(values, 1.0 / keeps)
                if share > _RELEVANT:
                    aliased.append(f"{100 * share:.2g} % of the power of {channel} above {0.5 * rate / keeps:g} Hz")
        for channel, values in {**self._columns_of()["channel"], **self._columns_of()["input"]}.items():
            if self._is_held(channel):
                if np.isfinite(values).all():  # or it is no input
                    signals.setdefault(channel, (t, values, 0.0, 0))
            elif fine is not None:
                signals[channel] = t[::fine], values[::fine], 0.0, 0
        step = f"decimated by {factor} to {rate / factor:g} Hz"
        if fine is not None:
            step += f", inputs by {fine} to {rate / fine:g} Hz with cubic splines between"
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
        name, t = self._times()
        for channel in {**self._columns_of()["input"], **self._columns_of()["channel"]}:
            if self._is_held(channel):
                raise OptionError(
                    f"resample: the input '{channel}' of experiment '{name}' is held between its samples, and its "
                    "steps have no limit of frequency: take .low_pass and .decimate, which keep it exact"
                )
        rate = positive("resample: rate (Hz)", rate)
        old = even_rate(t, t, f"experiment '{name}'", "resample")
        if rate > old * (1.0 + 1e-9):
            raise OptionError(
                f"resample: experiment '{name}' was sampled at {old:g} Hz, and {rate:g} Hz would make outputs that "
                "nobody measured; for finer inputs take .upsample_inputs(factor)"
            )
        if self._signals_of():
            raise OptionError(
                f"resample: the input '{next(iter(self._signals_of()))}' of experiment '{name}' has samples of its "
                "own: resample before inputs and outputs are given different rates"
            )
        ratio = Fraction(rate / old).limit_denominator(1000)
        if abs(float(ratio) * old / rate - 1.0) > 1e-6:
            raise OptionError(f"resample: {rate:g} Hz is no simple fraction of {old:g} Hz (a denominator up to 1000)")
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
        return self._stepped(f"resampled from {old:g} to {rate:g} Hz, band-limited", columns, {}, times)

    def upsample_inputs(self: _Self, factor: int) -> _Self:
        """Resample the inputs to a ``factor`` times higher rate, band-limited, with cubic splines between; outputs are
        unchanged.

        For an input whose content reaches far up to its Nyquist frequency, where lines and splines through the
        samples lose amplitude (lines 3 dB at 0.32 of the sampling rate): with a factor of 4 the input is true to
        0.1 % up to 0.44 of it, except over some 20 samples at either end. Not for inputs that jump or were held
        between samples: these are not band-limited. Columns that are not yet assigned are upsampled as well,
        unless samples are missing; inputs that are held between their samples are left alone.
        """
        name, t = self._times()
        factor = whole("upsample_inputs: factor", factor, 2)
        signals = dict(self._signals_of())
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
