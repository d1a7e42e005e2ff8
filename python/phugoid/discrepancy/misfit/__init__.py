"""The residuals of one output: their size, colour, spectrum, and what they depend on."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ...renamed import Renamed
from ...residual_noise import WITHIN, Series, autocorrelation_of, same_rate
from ...residual_noise.autoregression import (
    Autoregression,
    CorrelatedNoise,
    Spectrum,
    Tone,
    burg,
    spectrum_of,
    tones_of,
)
from ...time_unit import TimeUnit, time_unit_of
from .phrases import channel_phrases, number
from .regimes import Dependence, Regime, Running, Span, correlations_of, regimes_of, spans_of

__all__ = [
    "ChannelMisfit",
    "channel_misfit",
]


_Array = NDArray[np.float64]

# What is claimed is not chance at this level, of each kind of claim for each channel. Few claims can be false where
# a report makes dozens of them.
_ALPHA = 1e-3
_ENOUGH = 30  # samples below which only the size of residuals is reported
_ENOUGH_FOR_REGIMES = 60
_LJUNG_BOX = 20  # lags
_WORTH = 0.15  # correlation
_ROUNDING = 1e-6  # of the RMS: less is no noise


def _none() -> _Array:
    return np.empty(0)


@dataclass(frozen=True, eq=False, repr=False)
class ChannelMisfit:
    """Hold what is left of one output over all experiments, in its ``unit``.

    n            samples, without outliers (which are in ``notes``).
    rms          of the residuals.
    noise        standard deviation of what in them cannot be predicted from their own past: the innovations of an AR
                 model of ``order`` lags (12 at most, by BIC). NaN where there are too few samples to say.
    mean, mean_error  of the residuals, with standard error for residuals so coloured.
    lags, autocorrelation, band   (L,) s, (L,), and the half-width of the band that holds 95 % of white residuals.
    white        p-value of Ljung and Box's test that they are white (20 lags), whether or not their size changes.
    running, usual, spans   running RMS by experiment, its usual level, and the spans that stand out.
    regimes, correlations   against states, inputs and their rates; the least likely chance first.
    spectrum, tones         power by frequency, and lines in it.
    units        of states and inputs, and of time where it is not s.
    notes        what could not be determined, and why.
    resolution   of the sensor, where its samples lie on a grid; 0 elsewhere.

    Claims have a chance of 0.001 each of being false where residuals are noise of the colour found.
    """

    name: str
    unit: str
    n: int
    rms: float
    noise: float = math.nan
    order: int = 0
    mean: float = math.nan
    mean_error: float = math.nan
    lags: _Array = field(default_factory=_none)
    autocorrelation: _Array = field(default_factory=_none)
    band: float = math.nan
    white: float = math.nan
    running: Mapping[str, Running] | None = None
    usual: float = math.nan
    spans: tuple[Span, ...] = ()
    regimes: tuple[Regime, ...] = ()
    correlations: tuple[Dependence, ...] = ()
    spectrum: Spectrum | None = None
    tones: tuple[Tone, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    resolution: float = 0.0

    @property
    def within_resolution(self) -> bool:
        """Return whether the residuals are what rounding to the steps of the sensor explains."""
        return self.rms <= WITHIN * self.resolution

    @property
    def ratio(self) -> float:
        """RMS of the residuals over their noise: 1 where nothing can be predicted, infinite where all is, NaN where
        unknown."""
        if self.noise == 0.0 and self.rms > 0.0:
            return math.inf
        return self.rms / self.noise

    @property
    def predictable(self) -> float:
        """Share of the residuals' power that their own past predicts, 0 to 1."""
        return max(0.0, 1.0 - (self.noise / self.rms) ** 2) if self.rms > 0.0 else math.nan

    @property
    def coloured(self) -> bool:
        """Return whether the residuals are not white."""
        return self.white < _ALPHA

    @property
    def biased(self) -> bool:
        """Return whether their mean is off zero."""
        from scipy.special import stdtr

        if not self.mean_error > 0.0:
            return self.mean_error == 0.0 and self.mean != 0.0  # the same throughout
        effective = max((self.rms / self.mean_error) ** 2 - 1.0, 1.0)  # samples that coloured ones are worth
        return bool(2.0 * stdtr(effective, -abs(self.mean / self.mean_error)) < _ALPHA)

    @property
    def regime(self) -> Regime | None:
        """The clearest dependence on a variable, where there is one."""
        first = self.regimes[0] if self.regimes else None
        return first if first is not None and first.p_value < _ALPHA else None

    @property
    def follows(self) -> Dependence | None:
        """The clearest correlation, where one is large enough to be reported."""
        # A fast part of residuals may be correlated with a variable beyond chance, and yet be a negligible part of
        # them.
        clear = (c for c in self.correlations if c.p_value < _ALPHA and abs(c.r) >= _WORTH)
        return next(clear, None)

    @property
    def main_regime(self) -> Regime | None:
        """The regime to look at: the clear one, else that of the variable followed, else that with the most power."""
        if self.regime is not None:
            return self.regime
        followed = [r for r in self.regimes if self.follows is not None and r.variable == self.follows.variable]
        return max(followed or self.regimes, key=lambda r: r.share, default=None)

    telling = Renamed("main_regime")

    @property
    def structured(self) -> bool:
        """Return whether anything stands out from white noise."""
        return bool(self.coloured or self.biased or self.spans or self.tones or self.regime or self.follows)

    def summary(self) -> str:
        """Return one sentence."""
        return channel_phrases(self)


def channel_misfit(name: str, units: Mapping[str, str], every: Sequence[Series], resolution: float) -> ChannelMisfit:
    """Return the misfit of a channel with ``units`` by name, from its residuals of all experiments, with a note where
    they are no larger than the ``resolution`` of its sensor."""
    channel = replace(_of_channel(name, units, every), resolution=resolution)
    if not channel.within_resolution:
        return channel
    note = f"{channel.name} is measured in steps of {number(resolution, 3)}: its residuals are within that resolution"
    return replace(channel, notes=(*channel.notes, note))


def _of_channel(name: str, units: Mapping[str, str], every: Sequence[Series]) -> ChannelMisfit:
    r = np.concatenate([s.r for s in every])
    unit = units.get(name, "")
    n, rms = r.size, float(np.sqrt(np.mean(r**2)))
    if rms == 0.0:
        return ChannelMisfit(
            name, unit, n, rms, notes=(f"{name} is matched exactly: there are no residuals to analyse",)
        )
    if float(np.ptp(r)) <= _ROUNDING * rms:
        return ChannelMisfit(name, unit, n, rms, noise=0.0, mean=float(r.mean()), mean_error=0.0)
    if n < _ENOUGH:
        note = f"{name} has {n} samples: too few to distinguish noise from misfit ({_ENOUGH} are needed)"
        return ChannelMisfit(name, unit, n, rms, notes=(note,))
    series, others = same_rate(every)
    notes = [_on_outliers(name, every, time_unit_of(units))] if any(s.outliers.size for s in every) else []
    notes += [
        f"{name} is sampled at another rate in '{s.experiment}', which is used for spans of large residuals only"
        for s in others
    ]
    colour = burg([s.r[run] for s in series for run in s.segment.runs])
    own = np.concatenate([s.r for s in series])
    own_rms = float(np.sqrt(np.mean(own**2)))
    longest = max(s.segment.size for s in series)
    memory = CorrelatedNoise(colour.autocorrelation(longest))
    mean_error = own_rms * memory.spread(
        [np.nan_to_num(s.segment.on_grid(np.full(s.r.size, 1.0 / own.size))) for s in series]
    )
    lags, correlation, scatter = autocorrelation_of(series)
    running, usual, spans = spans_of(every, _ALPHA)
    regimes: list[Regime] = []
    correlations: list[Dependence] = []
    if own.size >= _ENOUGH_FOR_REGIMES:
        regimes = regimes_of(series, colour, memory, own_rms, _ALPHA)
        correlations = correlations_of(series, colour, memory)
    else:
        notes.append(f"{name} has {own.size} samples: too few for regimes ({_ENOUGH_FOR_REGIMES} are needed)")
    return ChannelMisfit(
        name,
        unit,
        n,
        rms,
        noise=_noise(colour, series, rms, own_rms),
        order=colour.order,
        mean=float(own.mean()),
        mean_error=mean_error,
        lags=lags,
        autocorrelation=correlation,
        band=1.96 / math.sqrt(own.size),
        white=_ljung_box(correlation, scatter, own.size),
        running=running,
        usual=usual,
        spans=tuple(spans),
        regimes=tuple(regimes),
        correlations=tuple(correlations),
        spectrum=spectrum_of(series, _ALPHA),
        tones=tuple(tones_of(series, _ALPHA)),
        units=units,
        notes=tuple(notes),
    )


def _on_outliers(name: str, every: Sequence[Series], time: TimeUnit) -> str:
    count = sum(s.outliers.size for s in every)
    first = next(s for s in every if s.outliers.size)
    where = f"{first.outliers[0]:g} {time} of '{first.experiment}'"
    if count == 1:
        return f"{name} has an outlier, at {where}, which is left out here"
    return f"{name} has {count} outliers, the first at {where}, which are left out here"


def _noise(colour: Autoregression, series: Sequence[Series], rms: float, own_rms: float) -> float:
    """Return the standard deviation of the noise; of white residuals all is noise, but for the degrees of freedom."""
    if colour.order == 0:
        return rms
    noise = min(rms, colour.deviation([s.segment.on_grid(s.r) for s in series]) * rms / own_rms)
    return noise if noise > _ROUNDING * rms else 0.0


def _ljung_box(rho: _Array, scatter: _Array, n: int) -> float:
    """P-value; with gaps the pairs that there are stand for n - k (Dunsmuir and Robinson 1981)."""
    from scipy.special import chdtrc

    # With more lags than a twelfth of the samples the statistic exceeds its distribution.
    last = min(_LJUNG_BOX, max(n // 12, 2), rho.size - 1)
    statistic = (n + 2.0) / n * float(np.sum(rho[1 : last + 1] ** 2 / scatter[1 : last + 1]))
    return float(chdtrc(last, statistic))
