"""What the simulation gets wrong: the residuals of a fit, channel by channel."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ...errors import DataError
from ...fit_result import FitResult
from ...notebook import Html, bullets, notebook_page, sparkline, table
from ...residual_noise.autoregression import Autoregression, CorrelatedNoise, burg
from ...residual_noise.series import WITHIN, Series, autocorrelation_of, channel_series, resolution_of, same_rate
from ...residual_noise.spectrum import Spectrum, Tone, spectrum_of, tones_of
from .phrases import channel_phrases, number, what_stands_out
from .regimes import Dependence, Regime, Running, Span, correlations_of, regimes_of, spans_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["ChannelMisfit", "Misfit", "misfit"]

_Array = NDArray[np.float64]

# What is claimed is not chance at this level, of each kind of claim for each channel. Few claims can be false where
# a report makes dozens of them.
_ALPHA = 1e-3
_ENOUGH = 30  # samples below which only the size of residuals is told
_ENOUGH_FOR_REGIMES = 60
_LJUNG_BOX = 20  # lags
_WORTH = 0.15  # correlation
_ROUNDING = 1e-6  # of the RMS: less is no noise


def _none() -> _Array:
    return np.empty(0)


@dataclass(frozen=True, eq=False, repr=False)
class ChannelMisfit:
    """What is left of one output over all experiments, in its ``unit``.

    n            samples, without outliers (which ``notes`` tell of).
    rms          of the residuals.
    noise        standard deviation of what in them cannot be predicted from their own past: the innovations of an AR
                 model of ``order`` lags (12 at most, by BIC). NaN where there are too few samples to say.
    mean, mean_error  of the residuals, with standard error for residuals so coloured.
    lags, autocorrelation, band   (L,) s, (L,), and the half-width of the band that holds 95 % of white residuals.
    white        p-value of Ljung and Box's test that they are white (20 lags), whether or not their size changes.
    running, usual, spans   running RMS by experiment, its usual level, and the spans that stand out.
    regimes, correlations   against states, inputs and their rates; the least likely chance first.
    spectrum, tones         power by frequency, and lines in it.
    units        of states and inputs.
    notes        what could not be told, and why.
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
        """Whether the residuals are what rounding to the steps of the sensor explains."""
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
        """Whether the residuals are not white."""
        return self.white < _ALPHA

    @property
    def biased(self) -> bool:
        """Whether their mean is off zero."""
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
        """The clearest correlation, where there is one that is worth a word."""
        # A quick part of residuals may follow a variable beyond chance, and yet be next to nothing of the whole.
        clear = (c for c in self.correlations if c.p_value < _ALPHA and abs(c.r) >= _WORTH)
        return next(clear, None)

    @property
    def telling(self) -> Regime | None:
        """The regime to look at: the clear one, else that of the variable followed, else that with the most power."""
        if self.regime is not None:
            return self.regime
        followed = [r for r in self.regimes if self.follows is not None and r.variable == self.follows.variable]
        return max(followed or self.regimes, key=lambda r: r.share, default=None)

    @property
    def structured(self) -> bool:
        """Whether anything stands out from white noise."""
        return bool(self.coloured or self.biased or self.spans or self.tones or self.regime or self.follows)

    def summary(self) -> str:
        """Return one sentence."""
        return channel_phrases(self)


@dataclass(frozen=True, eq=False, repr=False)
class Misfit:
    """What the simulation gets wrong.

    channels  by name, as the model declares them.
    fit       whose residuals they are.
    """

    channels: Mapping[str, ChannelMisfit]
    fit: FitResult

    @property
    def worst(self) -> tuple[str, ...]:
        """Names of the channels, those first whose residuals exceed their noise the most."""

        def excess(name: str) -> tuple[bool, float]:
            c = self.channels[name]
            return c.structured, 0.0 if math.isnan(c.ratio) else c.ratio

        return tuple(sorted(self.channels, key=excess, reverse=True))

    @property
    def structured(self) -> bool:
        """Whether anything stands out from white noise, in any channel."""
        return any(c.structured for c in self.channels.values())

    def summary(self) -> str:
        """Return a line for each channel, the worst first, and what could not be told."""
        lines = [self.channels[name].summary() for name in self.worst]
        notes = list(dict.fromkeys(note for name in self.worst for note in self.channels[name].notes))
        if not self.fit.converged:
            notes.append(f"the fit is no optimum ({self.fit.status}): another one may leave other residuals")
        return "\n".join([*lines, *(f"Note: {note}." for note in notes)])

    def plot(self, channels: Sequence[str] | None = None) -> tuple[Figure, dict[str, Axes]]:
        """Return the figure of the channels given, or of the three worst; see `misfit_figure`."""
        from .figure import misfit_figure

        return misfit_figure(self, self.fit, channels)

    def table_html(self, most: int | None = None) -> Html:
        """Return a row for each channel, or for the ``most`` worst of them, for notebooks."""
        rows = []
        for name in self.worst[:most]:
            c = self.channels[name]
            record = next(r for r in self.fit.records if name in r.residuals)
            picture = sparkline((record.innovations or record.residuals)[name], t=record.t)
            noise, ratio = (number(x) if math.isfinite(x) else "" for x in (c.noise, c.ratio))
            rows.append([name, c.unit, number(c.rms), noise, ratio, picture, what_stands_out(c)])
        return table(["output", "unit", "RMS", "noise", "RMS/noise", "residual", ""], rows, "llrrrll")

    def _repr_html_(self) -> str:
        notes = dict.fromkeys(note for name in self.worst for note in self.channels[name].notes)
        return notebook_page(
            "Misfit", self.table_html(), bullets(notes), note=f"of '{self.fit.model.name}', worst first"
        )

    def __str__(self) -> str:
        return self.summary()

    def __repr__(self) -> str:
        return f"<Misfit of {len(self.channels)} channels, the worst first: {', '.join(self.worst)}>"


def misfit(fit: FitResult) -> Misfit:
    """Return what a fitted model gets wrong, from its residuals; with process noise (`FilterError`), from its
    innovations.

    Records with gaps, of several rates and of any number are taken; what is too short gets fewer answers, and
    ``notes`` says so.

    Raises DataError for what is no fit, or where there are no residuals at all.
    """
    if not hasattr(fit, "records") or not hasattr(fit, "model"):
        raise DataError(f"misfit: give a fit, as estimate returns it, not a {type(fit).__name__}")
    outputs = list(fit.model.output_names)
    units = dict(fit.model.units)
    for record in fit.records:
        units = {**units, **record.units}
    found = {}
    for name in outputs:
        series = channel_series(fit.records, name)
        if series:
            step = resolution_of([r.measured[name] for r in fit.records if name in r.measured])
            found[name] = _with_resolution(_of_channel(name, units, series), step)
    if not found:
        raise DataError("misfit: no output has two residuals or more; give a fit to measured data")
    return Misfit(found, fit)


def _with_resolution(channel: ChannelMisfit, step: float) -> ChannelMisfit:
    """Return the same with the resolution of its sensor, and a note where the residuals are no larger."""
    channel = replace(channel, resolution=step)
    if not channel.within_resolution:
        return channel
    note = f"{channel.name} is measured in steps of {number(step, 3)}: its residuals are within that resolution"
    return replace(channel, notes=(*channel.notes, note))


def _of_channel(name: str, units: Mapping[str, str], every: Sequence[Series]) -> ChannelMisfit:
    r = np.concatenate([s.r for s in every])
    unit = units.get(name, "")
    n, rms = r.size, float(np.sqrt(np.mean(r**2)))
    if rms == 0.0:
        return ChannelMisfit(name, unit, n, rms, notes=(f"{name} is matched exactly: there is no residual to look at",))
    if float(np.ptp(r)) <= _ROUNDING * rms:
        return ChannelMisfit(name, unit, n, rms, noise=0.0, mean=float(r.mean()), mean_error=0.0)
    if n < _ENOUGH:
        note = f"{name} has {n} samples: too few to tell noise from misfit ({_ENOUGH} are needed)"
        return ChannelMisfit(name, unit, n, rms, notes=(note,))
    series, others = same_rate(every)
    notes = [_on_outliers(name, every)] if any(s.outliers.size for s in every) else []
    notes += [
        f"{name} is sampled at another rate in '{s.experiment}', which only its spans of large residuals look at"
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


def _on_outliers(name: str, every: Sequence[Series]) -> str:
    count = sum(s.outliers.size for s in every)
    first = next(s for s in every if s.outliers.size)
    where = f"{first.outliers[0]:g} s of '{first.experiment}'"
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
