"""The misfit of a fit: its residuals, channel by channel, with their figure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import DataError, UnknownName, listing
from ...figures import (
    BAND,
    GREY,
    INPUT,
    MEASURED,
    MODEL,
    RESIDUAL,
    SPAN,
    WIDTH,
    Panels,
    labelled,
    plain,
    squared,
    styled,
    with_gaps,
)
from ...figures.ticks import label_decades, log_ticks, make_ticks_in_view
from ...fit_result import FitResult
from ...notebook import Html, bullets, notebook_page, sparkline, table
from ...records import Record
from ...residual_noise import channel_series, residual_of, resolution_of
from ...time_unit import time_unit_of
from . import ChannelMisfit, channel_misfit
from .phrases import number, what_stands_out

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "Misfit",
    "misfit",
    "misfit_figure",
]


@dataclass(frozen=True, eq=False, repr=False)
class Misfit:
    """The misfit of a model: the structured part of its residuals, by output.

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
        """Return whether anything stands out from white noise, in any channel."""
        return any(c.structured for c in self.channels.values())

    def summary(self) -> str:
        """Return a line for each channel, the worst first, and what could not be determined."""
        lines = [self.channels[name].summary() for name in self.worst]
        notes = list(dict.fromkeys(note for name in self.worst for note in self.channels[name].notes))
        if not self.fit.converged:
            notes.append(f"the fit is not at an optimum ({self.fit.status}): the residuals may differ at one")
        return "\n".join([*lines, *(f"Note: {note}." for note in notes)])

    def plot(self, channels: Sequence[str] | None = None) -> tuple[Figure, dict[str, Axes]]:
        """Plot per channel: residuals over time, with spans that stand out; autocorrelation; spectrum; the clearest
        regime.

        channels  names; None: the three worst.

        Returns the figure and the axes by ``"<channel> time"`` (``"<channel> time <experiment>"`` where there are
        several), ``"<channel> autocorrelation"``, ``"<channel> spectrum"`` and ``"<channel> regime"``. Raises
        UnknownName for a channel that is not there.
        """
        return misfit_figure(self, channels)

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
    """Return the misfit of a fitted model, from its residuals; with process noise (`FilterError`), from its
    innovations.

    There may be any number of records, with gaps and of several rates; of short ones less is computed, and ``notes``
    says so.

    Raises DataError for what is not a fit, or where there are no residuals at all.
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
            found[name] = channel_misfit(name, units, series, step)
    if not found:
        raise DataError("misfit: no output has two residuals or more; give a fit to measured data")
    return Misfit(found, fit)


_PER_CHANNEL, _PER_CHANNEL_NARROW = 3.1, 4.4  # inches
_EXPERIMENTS = 4  # side by side
_NAME = 90  # characters across the figure


def misfit_figure(
    misfit: Misfit, channels: Sequence[str] | None, width: float = WIDTH
) -> tuple[Figure, dict[str, Axes]]:
    """Draw `Misfit.plot`; in a narrow figure the regime stands below the spectrum."""
    names = list(misfit.worst[:3] if channels is None else channels)
    for name in names:
        if name not in misfit.channels:
            raise UnknownName(f"the misfit has no channel '{name}'.{listing(name, misfit.channels)}")
    if not names:
        raise DataError("Misfit.plot: there is no channel to draw")
    panels: dict[str, Any] = {}
    with styled() as plt:
        narrow = width < WIDTH
        height = (_PER_CHANNEL_NARROW if narrow else _PER_CHANNEL) * len(names) + 0.25
        figure = plt.figure(figsize=(width, height), layout="constrained")
        parts = figure.subfigures(len(names), 1, squeeze=False)[:, 0]
        for part, name in zip(parts, names, strict=True):
            channel = misfit.channels[name]
            records = [r for r in misfit.fit.records if residual_of(r, name) is not None]
            shown = _most_telling(channel, records)
            _key(part, misfit, names, narrow) if name == names[0] else None
            part.suptitle(plain(_heading(channel)), x=0.01, ha="left", fontsize=9.0)
            grid = part.add_gridspec(3, 2) if narrow else part.add_gridspec(2, 3, height_ratios=(1.15, 1.0))
            cells = (grid[1, 0], grid[1, 1], grid[2, :]) if narrow else (grid[1, 0], grid[1, 1], grid[1, 2])
            spans = np.array([r.t[-1] - r.t[0] for r in shown])
            shares = np.maximum(spans / spans.sum(), 0.12)  # so that a short one still can be read
            times = grid[0, :].subgridspec(1, len(shown), width_ratios=shares / shares.sum(), wspace=0.04)
            share = None
            for i, record in enumerate(shown):
                axis = share = part.add_subplot(times[0, i], sharey=share)
                make_ticks_in_view(axis)
                key = f"{name} time" if len(records) == 1 else f"{name} time {record.name}"
                panels[key] = axis
                room = int(_NAME * shares[i] / shares.sum()) if len(records) > 1 else 0
                _draw_time(axis, channel, record, first=i == 0, room=room)
            for what, cell in zip(("autocorrelation", "spectrum", "regime"), cells, strict=True):
                panels[f"{name} {what}"] = part.add_subplot(cell)
                make_ticks_in_view(panels[f"{name} {what}"])
            _draw_autocorrelation(panels[f"{name} autocorrelation"], channel)
            _draw_spectrum(panels[f"{name} spectrum"], channel)
            _draw_regime(panels[f"{name} regime"], channel)
    return figure, Panels(panels)


def _key(part: Any, misfit: Misfit, names: Sequence[str], narrow: bool) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = [
        Line2D([], [], color=RESIDUAL, linewidth=0.8, label="residual"),
        Line2D([], [], color=MODEL, linewidth=0.9, label="running RMS"),
        Patch(color=BAND, label="±2 noise"),
    ]
    if any(misfit.channels[name].spans for name in names):
        handles.append(Patch(color=SPAN, label="stands out"))
    if narrow:  # no room beside the heading
        part.legend(handles=handles, loc="outside lower right", ncols=4, frameon=False, fontsize=7.0)
        return
    key = part.legend(handles=handles, loc="upper right", ncols=4, frameon=False, fontsize=7.0, borderaxespad=0.2)
    key.set_in_layout(False)


def _heading(c: ChannelMisfit) -> str:
    size = labelled(f"{c.name}: RMS {number(c.rms)}", {f"{c.name}: RMS {number(c.rms)}": c.unit}).replace(", ", " ")
    return size if np.isnan(c.ratio) else f"{size}, noise {number(c.noise)}, ratio {number(c.ratio)}"


def _most_telling(c: ChannelMisfit, records: Sequence[Record]) -> list[Record]:
    """Return all experiments, or of many those with the largest residuals, in their order."""
    if len(records) <= _EXPERIMENTS:
        return list(records)

    def size(record: Record) -> float:
        r: Any = residual_of(record, c.name)
        return float(np.nanmean(r**2)) if np.isfinite(r).any() else 0.0

    chosen = sorted(records, key=size, reverse=True)[:_EXPERIMENTS]
    return [r for r in records if any(r is other for other in chosen)]


def _draw_time(axis: Axes, c: ChannelMisfit, record: Record, *, first: bool, room: int) -> None:
    """Draw the time histories; ``room`` is for so many letters of the experiment's name, 0 where there is but one."""
    r: Any = residual_of(record, c.name)
    if np.isfinite(c.noise):
        axis.axhspan(-2.0 * c.noise, 2.0 * c.noise, color=BAND, linewidth=0.0)
    for span in c.spans:
        if span.experiment == record.name:
            axis.axvspan(span.start, span.end, color=SPAN, linewidth=0.0, zorder=0.5)
    axis.axhline(0.0, color=INPUT, linewidth=0.5)
    axis.plot(*with_gaps(record.t, r), color=RESIDUAL, linewidth=0.6, rasterized=record.n > 5000)
    running = (c.running or {}).get(record.name)
    if running is not None:
        axis.plot(running.t, running.rms, color=MODEL, linewidth=0.9)
    axis.margins(x=0.01)
    axis.set_xlabel(plain(time_unit_of(c.units).axis()), labelpad=1.0)
    if room:
        name = record.name if len(record.name) <= room else f"{record.name[: max(room - 1, 1)]}…"
        axis.set_title(plain(name), fontsize=6.5, loc="left", pad=2.0)
        axis.locator_params(axis="x", nbins=max(2, room // 9))
    if first:
        axis.set_ylabel(plain(labelled("residual", {"residual": c.unit})), fontsize=7.0)
    else:
        axis.tick_params(labelleft=False)


def _empty(axis: Axes, text: str) -> None:
    axis.set_axis_off()
    axis.text(0.5, 0.5, text, ha="center", va="center", fontsize=7.0, color=RESIDUAL, transform=axis.transAxes)


def _draw_autocorrelation(axis: Axes, c: ChannelMisfit) -> None:
    if c.lags.size < 2:
        _empty(axis, "too few samples\nfor an autocorrelation")
        return
    axis.axhspan(-c.band, c.band, color=BAND, linewidth=0.0)
    axis.axhline(0.0, color=INPUT, linewidth=0.5)
    axis.fill_between(c.lags, c.autocorrelation, color=MEASURED, alpha=0.25, linewidth=0.0)
    axis.plot(c.lags, c.autocorrelation, color=MEASURED, linewidth=1.1)
    axis.set_ylim(min(-0.3, 1.1 * float(c.autocorrelation.min())), 1.05)
    axis.set_xlabel(plain(time_unit_of(c.units).axis("lag")), labelpad=1.0)
    axis.set_title(f"autocorrelation ({'not white' if c.coloured else 'white'})", fontsize=7.5)


def _draw_spectrum(axis: Axes, c: ChannelMisfit) -> None:
    if c.spectrum is None:
        _empty(axis, "too few samples\nfor a spectrum")
        return
    s = c.spectrum
    for band in s.bands:
        axis.axvspan(max(band.low, 0.7 * s.frequency[0]), band.high, color=SPAN, linewidth=0.0)
    axis.axhline(s.level, color=GREY, linewidth=0.8, linestyle="--")
    axis.loglog(s.frequency, s.density, color=MEASURED, linewidth=1.0)
    for tone in c.tones:
        axis.axvline(tone.frequency, color=MODEL, linewidth=0.9, linestyle=":")
    axis.set_xlim(0.7 * s.frequency[0], s.frequency[-1])
    # A flat spectrum shall look flat.
    axis.set_ylim(min(s.level / 20.0, float(s.density.min())), max(s.level * 20.0, 1.5 * float(s.density.max())))
    for part in (axis.xaxis, axis.yaxis):
        part.set_major_locator(log_ticks(numticks=6))
        label_decades(part)
    time = time_unit_of(c.units)
    axis.set_xlabel(plain(f"frequency, {time.frequency}"), labelpad=1.0)
    tones = ", tones dotted" if c.tones else ""
    axis.set_title(plain(f"power, {squared(c.unit, time)}{tones}"), fontsize=7.5, y=1.0)


def _draw_regime(axis: Axes, c: ChannelMisfit) -> None:
    regime = c.main_regime
    if regime is None:
        _empty(axis, "no regimes:\ntoo few samples, or nothing moves")
        return
    middle = [0.5 * (b.low + b.high) for b in regime.bins]
    half = [0.5 * (b.high - b.low) for b in regime.bins]
    mean = np.array([b.mean for b in regime.bins])
    error = np.array([2.0 * b.std_error for b in regime.bins])
    axis.axhline(0.0, color=INPUT, linewidth=0.5)
    axis.bar(middle, 2.0 * error, 1.9 * np.array(half), -error, color=BAND, linewidth=0.0)
    marked = [b.stands_out for b in regime.bins]
    for value, x, h, out in zip(mean, middle, half, marked, strict=True):
        axis.plot([x - h, x + h], [value, value], color=MODEL if out else MEASURED, linewidth=2.0 if out else 1.4)
    name, bare = regime.variable, regime.variable.removesuffix("'")
    unit = c.units.get(bare, "")
    unit = time_unit_of(c.units).rate(unit) if name.endswith("'") else unit
    axis.set_xlabel(plain(labelled(name, {name: unit})), labelpad=1.0)
    clear = c.regime is not None or (c.follows is not None and c.follows.variable == name)
    axis.set_title(plain(f"mean over {name}{'' if clear else ' (not significant)'}"), fontsize=7.5)
    axis.locator_params(axis="x", nbins=5)
