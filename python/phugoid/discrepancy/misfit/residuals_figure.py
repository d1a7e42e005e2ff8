"""Figure of residuals: over time, how they follow from their own past, and at which frequencies they have power."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...errors import DataError, UnknownName, listing
from ...figures import (
    BAND,
    GREY,
    INPUT,
    MEASURED,
    RESIDUAL,
    WIDTH,
    Panels,
    headline,
    labelled,
    plain,
    squared,
    styled,
    with_gaps,
    write_keys,
)
from ...figures.fit import choose_record, sigmas_of
from ...figures.ticks import label_decades, log_ticks, prepare
from ...fit_result import FitResult
from ...goodness_of_fit import chi_square_quantile
from ...records import Record
from ...residual_noise import Series, autocorrelation_of, channel_series
from ...residual_noise.autoregression import spectrum_of
from ...time_unit import time_unit_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["plot_residuals"]

_Array = NDArray[np.float64]

_ROW, _HEAD, _FOOT = 1.12, 0.62, 0.42  # inches
_LEFT, _RIGHT = 0.8, 0.12
_LABEL = 0.62  # from the axis to the middle of its label
_ENOUGH = 16  # samples for an autocorrelation and a spectrum
_LEVEL = 0.95
_UNEVEN = 0.1  # of a step: farther from the grid than this a sample's time is off it
_MANY = 0.05  # of the samples


def plot_residuals(
    fit: FitResult, record: int | str = 0, channels: Sequence[str] | None = None
) -> tuple[Figure, dict[str, Axes]]:
    """Plot, for each output of an experiment, residuals over time, their autocorrelation and their power spectrum.

    Time: measured minus model in the output's unit, with the band of ±2σ of the fit's noise. Autocorrelation: about
    zero, over lags in s, with the band that holds 95 % of white residuals, ±1.96/√n. Spectrum: one-sided power density
    by Welch's method (1967), with the level of white noise of the same power and the band that would hold 95 % of its
    values. With process noise (`FilterError`) innovations take the place of residuals, and the band is what they should
    be.

    Missing samples leave gaps, across which no products are taken; in the spectrum they count as zero, and its power is
    that of the samples present. Single samples far off their neighbours are drawn over time, but left out of the rest.
    Where times are uneven, each sample is taken to the nearest place of a grid of the median step; the panel says so.

    record    index or name of the experiment.
    channels  outputs to show; None: all that were measured.

    Returns the figure and the axes by ``"<output>"``, ``"<output> autocorrelation"``, ``"<output> spectrum"``. Raises
    UnknownName for an output or an experiment that is not there, DataError where nothing was measured.
    """
    chosen = choose_record(fit.records, record)
    names = _chosen(chosen, channels)
    sigmas = sigmas_of(fit, chosen)
    axes: dict[str, Any] = {}
    time = time_unit_of(chosen.units)
    with styled() as plt:
        height = _ROW * len(names) + _HEAD + _FOOT
        figure = plt.figure(figsize=(WIDTH, height))
        grid = figure.add_gridspec(
            len(names),
            3,
            width_ratios=(1.9, 1.0, 1.0),
            hspace=0.42,
            wspace=0.3,
            left=_LEFT / WIDTH,
            right=1.0 - _RIGHT / WIDTH,
            bottom=_FOOT / height,
            top=1.0 - _HEAD / height,
        )
        share = None
        for i, name in enumerate(names):
            panels = [share := figure.add_subplot(grid[i, 0], sharex=share)]
            panels += [figure.add_subplot(grid[i, column]) for column in (1, 2)]
            axes.update(zip((name, f"{name} autocorrelation", f"{name} spectrum"), panels, strict=True))
            for axis in panels:
                prepare(axis, _LABEL)
            _draw_time(panels[0], chosen, name, sigmas.get(name, math.nan))
            series = channel_series([chosen], name)
            if not series or series[0].r.size < _ENOUGH or not np.any(series[0].r != 0.0):
                for axis in panels[1:]:
                    _empty(axis, "too few residuals")
            else:
                _draw_autocorrelation(panels[1], series[0])
                _draw_spectrum(panels[2], series[0], squared(chosen.units.get(name, ""), time))
        labels = {"": time.axis(), " autocorrelation": time.axis("lag"), " spectrum": f"frequency, {time.frequency}"}
        for what, text in labels.items():
            axes[f"{names[-1]}{what}"].set_xlabel(plain(text))
        left = _LEFT / WIDTH
        headline(figure, left, f"{fit.model.name}: {chosen.name}, {_called(chosen)}s")
        write_keys(figure, left, _keys(chosen), fontsize=6.5)
    return figure, Panels(axes)


def _called(record: Record) -> str:
    return "innovation" if record.innovations else "residual"


def _values(record: Record, name: str) -> _Array:
    return record.innovations.get(name, record.residuals[name])


def _chosen(record: Record, channels: Sequence[str] | None) -> list[str]:
    if isinstance(channels, str):
        raise DataError(f"channels='{channels}' is text: give a list, such as channels=['{channels}']")
    measured = [name for name, r in record.residuals.items() if np.isfinite(r).any()]
    names = measured if channels is None else list(dict.fromkeys(channels))
    for name in names:
        if name not in record.residuals:
            raise UnknownName(f"record '{record.name}' has no residuals of '{name}'.{listing(name, record.residuals)}")
        if name not in measured:
            raise DataError(f"record '{record.name}': '{name}' was not measured, so it has no residuals")
    if not names:
        raise DataError(f"record '{record.name}' has no residuals: nothing was measured")
    return names


def _draw_time(axis: Axes, record: Record, name: str, sigma: float) -> None:
    r = _values(record, name)
    spread = record.innovation_std.get(name) if record.innovations else None
    if spread is not None and np.isfinite(spread).any():
        at, size = with_gaps(record.t, spread)
        axis.fill_between(at, -2.0 * size, 2.0 * size, color=BAND, linewidth=0.0)
        sigma = float(np.nanmedian(spread))
    elif sigma > 0.0:
        axis.axhspan(-2.0 * sigma, 2.0 * sigma, color=BAND, linewidth=0.0)
    axis.axhline(0.0, color=INPUT, linewidth=0.5)
    axis.plot(*with_gaps(record.t, r), color=RESIDUAL, linewidth=0.6, rasterized=record.n > 5000)
    limit = 1.08 * max(float(np.nanmax(np.abs(r), initial=0.0)), 2.0 * sigma if sigma > 0.0 else 0.0)
    if limit > 0.0:
        axis.set_ylim(-limit, limit)
    axis.margins(x=0.01)
    axis.locator_params(axis="y", nbins=5)
    axis.set_ylabel(plain(labelled(name, record.units)))


def _empty(axis: Axes, text: str) -> None:
    axis.set_xticks([])
    axis.set_yticks([])
    axis.text(0.5, 0.5, text, ha="center", va="center", fontsize=7.0, color=RESIDUAL, transform=axis.transAxes)


def _draw_autocorrelation(axis: Axes, series: Series) -> None:
    lags, rho, _ = autocorrelation_of([series])
    bound = 1.96 / math.sqrt(series.r.size)
    axis.axhspan(-bound, bound, color=BAND, linewidth=0.0)
    axis.axhline(0.0, color=INPUT, linewidth=0.5)
    axis.vlines(lags, 0.0, rho, color=MEASURED, linewidth=0.9 if lags.size < 40 else 0.5)
    axis.plot(lags, rho, ".", color=MEASURED, ms=2.5 if lags.size < 40 else 1.6)
    axis.set_ylim(min(-0.4, 1.15 * float(rho.min())), 1.08)
    axis.margins(x=0.03)
    _head(axis, "autocorrelation", f"lag 1: {rho[1]:.2f}".replace("-", "−") if rho.size > 1 else "")
    # Within the axes, which have room at large lags: beside the title of a narrow panel there is none.
    said = ["uneven times"] if _uneven(series) else []
    if series.outliers.size:
        said.append(f"{series.outliers.size} outlier{'s' * (series.outliers.size > 1)} left out")
    axis.text(1.0, 0.97, "\n".join(said), ha="right", va="top", fontsize=6.5, transform=axis.transAxes)


def _draw_spectrum(axis: Axes, series: Series, unit: str) -> None:
    from matplotlib.ticker import FuncFormatter, NullFormatter, NullLocator

    s = spectrum_of([series], 1e-3)
    low, high = (
        s.level * chi_square_quantile(s.freedom, p) / s.freedom for p in (0.5 + 0.5 * _LEVEL, 0.5 - 0.5 * _LEVEL)
    )
    axis.axhspan(low, high, color=BAND, linewidth=0.0)
    axis.axhline(s.level, color=GREY, linewidth=0.8, linestyle="--")
    axis.loglog(s.frequency, s.density, color=MEASURED, linewidth=1.0)
    # A flat spectrum shall look flat.
    axis.set_ylim(min(s.level / 20.0, 0.7 * float(s.density.min())), max(s.level * 20.0, 1.5 * float(s.density.max())))
    axis.yaxis.set_major_locator(log_ticks(numticks=5))
    label_decades(axis.yaxis)
    if s.frequency[-1] < 100.0 * s.frequency[0]:  # less than two decades
        axis.xaxis.set_major_locator(log_ticks(subs=(1.0, 2.0, 5.0), numticks=9))
        axis.xaxis.set_minor_locator(NullLocator())
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    _head(axis, "power", unit)


def _head(axis: Axes, left: str, right: str) -> None:
    """Write what a panel shows, and a number or the unit, above it; at a fixed height, which need not be looked for."""
    axis.set_title(plain(left), fontsize=6.5, loc="left", pad=1.5, y=1.0)
    axis.set_title(plain(right), fontsize=6.5, loc="right", pad=1.5, y=1.0)


def _uneven(series: Series) -> bool:
    steps = np.diff(series.t) / series.segment.step
    return bool(np.mean(np.abs(steps - np.rint(steps)) > _UNEVEN) > _MANY)


def _keys(record: Record) -> list[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    line = f"measured − {'predicted' if record.innovations else 'model'}"
    return [
        Line2D([], [], color=RESIDUAL, linewidth=0.8, label=line),
        Patch(color=BAND, label="±2σ, or 95 % if white"),
    ]
