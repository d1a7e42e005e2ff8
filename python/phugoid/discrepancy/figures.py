"""Figures of a diagnosis: the misfit, what the extension changes, the ranking of the candidates, and the gain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import DataError, UnknownName, listing
from ..plot import _BAND, _INPUT, _MEASURED, _MODEL, _RESIDUAL, _STATE, _STYLE, _label, _plain
from ..records import Record
from .extension import Extension, Gain
from .finding import Scored
from .misfit import ChannelMisfit, Misfit
from .phrases import number
from .regimes import Regime

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["findings_figure", "gain_figure", "misfit_figure", "ranking_figure"]

# Of Okabe and Ito's palette, as in `plot`; spans are paler than anything drawn on them.
_SPAN = "#F6D5A8"
_GREY = "#999999"
_WIDTH, _PER_CHANNEL = 7.2, 3.1  # inches
_EXPERIMENTS = 4  # side by side
_BARS = 12

_Panels = dict[str, Any]


def misfit_figure(misfit: Misfit, fit: Any, channels: Sequence[str] | None = None) -> tuple[Figure, dict[str, Axes]]:
    """Per channel: residuals over time, with spans that stand out; autocorrelation; spectrum; the clearest regime.

    channels  names; None: the three worst.

    Returns the figure and the axes by ``"<channel> time"`` (``"<channel> time <experiment>"`` where there are several),
    ``"<channel> autocorrelation"``, ``"<channel> spectrum"`` and ``"<channel> regime"``. Raises UnknownName for a
    channel that is not there.
    """
    import matplotlib.pyplot as plt
    from matplotlib import rc_context

    names = list(misfit.worst[:3] if channels is None else channels)
    for name in names:
        if name not in misfit.channels:
            raise UnknownName(f"the misfit has no channel '{name}'.{listing(name, misfit.channels)}")
    if not names:
        raise DataError("misfit_figure: there is no channel to draw")
    panels: _Panels = {}
    with rc_context(_STYLE):
        figure = plt.figure(figsize=(_WIDTH, _PER_CHANNEL * len(names) + 0.25), layout="constrained")
        parts = figure.subfigures(len(names), 1, squeeze=False)[:, 0]
        for part, name in zip(parts, names, strict=True):
            channel = misfit.channels[name]
            records = [r for r in fit.records if _residual(r, name) is not None]
            shown = _most_telling(channel, records)
            _key(part, misfit, names) if name == names[0] else None
            part.suptitle(_plain(_heading(channel)), x=0.01, ha="left", fontsize=9.0)
            grid = part.add_gridspec(2, 3, height_ratios=(1.15, 1.0))
            times = grid[0, :].subgridspec(1, len(shown), width_ratios=[r.t[-1] - r.t[0] for r in shown], wspace=0.04)
            share = None
            for i, record in enumerate(shown):
                axis = share = part.add_subplot(times[0, i], sharey=share)
                key = f"{name} time" if len(records) == 1 else f"{name} time {record.name}"
                panels[key] = axis
                _draw_time(axis, channel, record, first=i == 0, several=len(records) > 1)
            for i, what in enumerate(("autocorrelation", "spectrum", "regime")):
                panels[f"{name} {what}"] = part.add_subplot(grid[1, i])
            _draw_autocorrelation(panels[f"{name} autocorrelation"], channel)
            _draw_spectrum(panels[f"{name} spectrum"], channel)
            _draw_regime(panels[f"{name} regime"], channel, records)
    return figure, panels


def _key(part: Any, misfit: Misfit, names: Sequence[str]) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = [
        Line2D([], [], color=_RESIDUAL, linewidth=0.8, label="residual"),
        Line2D([], [], color=_MODEL, linewidth=0.9, label="running RMS"),
        Patch(color=_BAND, label="±2 noise"),
    ]
    if any(misfit.channels[name].spans for name in names):
        handles.append(Patch(color=_SPAN, label="stands out"))
    key = part.legend(handles=handles, loc="upper right", ncols=4, frameon=False, fontsize=7.0, borderaxespad=0.2)
    key.set_in_layout(False)


def _heading(c: ChannelMisfit) -> str:
    size = _label(f"{c.name}: RMS {number(c.rms)}", {f"{c.name}: RMS {number(c.rms)}": c.unit}).replace(", ", " ")
    return size if np.isnan(c.ratio) else f"{size}, noise {number(c.noise)}, ratio {c.ratio:.2g}"


def _residual(record: Record, name: str) -> Any:
    return record.innovations.get(name, record.residuals.get(name))


def _most_telling(c: ChannelMisfit, records: Sequence[Record]) -> list[Record]:
    """All experiments, or of many those with the largest residuals, in their order."""
    if len(records) <= _EXPERIMENTS:
        return list(records)

    def size(record: Record) -> float:
        r = _residual(record, c.name)
        return float(np.nanmean(r**2)) if np.isfinite(r).any() else 0.0

    chosen = sorted(records, key=size, reverse=True)[:_EXPERIMENTS]
    return [r for r in records if any(r is other for other in chosen)]


def _draw_time(axis: Axes, c: ChannelMisfit, record: Record, *, first: bool, several: bool) -> None:
    r = _residual(record, c.name)
    there = np.isfinite(r)
    if np.isfinite(c.noise):
        axis.axhspan(-2.0 * c.noise, 2.0 * c.noise, color=_BAND, linewidth=0.0)
    for span in c.spans:
        if span.experiment == record.name:
            axis.axvspan(span.start, span.end, color=_SPAN, linewidth=0.0, zorder=0.5)
    axis.axhline(0.0, color=_INPUT, linewidth=0.5)
    many = record.n > 5000
    # A slow channel among fast ones has a value at few of the times: a line through those that there are.
    dense = there.mean() > 0.5
    t, values = (record.t, r) if dense else (record.t[there], r[there])
    axis.plot(t, values, color=_RESIDUAL, linewidth=0.6, rasterized=many)
    running = (c.running or {}).get(record.name)
    if running is not None:
        axis.plot(running.t, running.rms, color=_MODEL, linewidth=0.9)
    axis.margins(x=0.01)
    axis.set_xlabel(_plain(f"time of {record.name}, s" if several else "time, s"), labelpad=1.0)
    if first:
        axis.set_ylabel(_plain(_label("residual", {"residual": c.unit})))
    else:
        axis.tick_params(labelleft=False)


def _empty(axis: Axes, text: str) -> None:
    axis.set_axis_off()
    axis.text(0.5, 0.5, text, ha="center", va="center", fontsize=7.0, color=_RESIDUAL, transform=axis.transAxes)


def _draw_autocorrelation(axis: Axes, c: ChannelMisfit) -> None:
    if c.lags.size < 2:
        _empty(axis, "too few samples\nfor an autocorrelation")
        return
    axis.axhspan(-c.band, c.band, color=_BAND, linewidth=0.0)
    axis.axhline(0.0, color=_INPUT, linewidth=0.5)
    axis.fill_between(c.lags, c.autocorrelation, color=_MEASURED, alpha=0.25, linewidth=0.0)
    axis.plot(c.lags, c.autocorrelation, color=_MEASURED, linewidth=1.1)
    axis.set_ylim(min(-0.3, 1.1 * float(c.autocorrelation.min())), 1.05)
    axis.set_xlabel("lag, s", labelpad=1.0)
    axis.set_title(f"autocorrelation ({'not white' if c.coloured else 'white'})", fontsize=7.5)


def _draw_spectrum(axis: Axes, c: ChannelMisfit) -> None:
    if c.spectrum is None:
        _empty(axis, "too few samples\nfor a spectrum")
        return
    s = c.spectrum
    for band in s.bands:
        axis.axvspan(max(band.low, 0.7 * s.frequency[0]), band.high, color=_SPAN, linewidth=0.0)
    axis.axhline(s.level, color=_GREY, linewidth=0.8, linestyle="--")
    axis.loglog(s.frequency, s.density, color=_MEASURED, linewidth=1.0)
    for tone in c.tones:
        axis.axvline(tone.frequency, color=_MODEL, linewidth=0.9, linestyle=":")
    axis.set_xlim(0.7 * s.frequency[0], s.frequency[-1])
    axis.set_xlabel("frequency, Hz", labelpad=1.0)
    square = f"({c.unit})²/Hz" if c.unit not in ("", "1", "-") else "1/Hz"
    tones = ", tones dotted" if c.tones else ""
    axis.set_title(_plain(f"power, {square}{tones}"), fontsize=7.5)


def _draw_regime(axis: Axes, c: ChannelMisfit, records: Sequence[Record]) -> None:
    if not c.regimes:
        _empty(axis, "no regimes:\ntoo few samples, or nothing moves")
        return
    regime: Regime = c.regimes[0]
    middle = [0.5 * (b.low + b.high) for b in regime.bins]
    half = [0.5 * (b.high - b.low) for b in regime.bins]
    mean = np.array([b.mean for b in regime.bins])
    error = np.array([2.0 * b.std_error for b in regime.bins])
    axis.axhline(0.0, color=_INPUT, linewidth=0.5)
    axis.bar(middle, 2.0 * error, 1.9 * np.array(half), -error, color=_BAND, linewidth=0.0)
    marked = [b.stands_out for b in regime.bins]
    for value, x, h, out in zip(mean, middle, half, marked, strict=True):
        axis.plot([x - h, x + h], [value, value], color=_MODEL if out else _MEASURED, linewidth=2.0 if out else 1.4)
    name, bare = regime.variable, regime.variable.removesuffix("'")
    unit = c.units.get(bare, "")
    unit = (f"{unit}/s" if unit else "1/s") if name.endswith("'") else unit
    axis.set_xlabel(_plain(_label(name, {name: unit})), labelpad=1.0)
    axis.set_title(_plain(f"mean over {name}{'' if c.regime is not None else ' (chance?)'}"), fontsize=7.5)
    axis.locator_params(axis="x", nbins=5)


def findings_figure(
    fit: Any, extension: Extension, channels: Sequence[str] | None = None, record: int = 0
) -> tuple[Figure, dict[str, Axes]]:
    """Per channel: residuals before and after, and beneath what the extension changes in the model's output.

    channels  names; None: the three of which the RMS falls most. ``record``: index of the experiment.

    The change is the output of the extended model minus that of the base model, each at its own estimates: the added
    effect with what the other parameters made of it. Returns the figure and the axes by ``"<channel>"`` and
    ``"<channel> change"``. Raises UnknownName for a channel that is not there.
    """
    import matplotlib.pyplot as plt
    from matplotlib import rc_context

    before, after = fit.records[record], extension.fit.records[record]
    known = [name for name in before.residuals if name in after.residuals]
    if channels is None:
        channels = sorted(known, key=lambda name: _finite(extension.gain.change(name)))[:3]
    for name in channels:
        if name not in known:
            raise UnknownName(f"the fit has no channel '{name}'.{listing(name, known)}")
    if not channels:
        raise DataError("findings_figure: there is no channel to draw")
    panels: _Panels = {}
    with rc_context(_STYLE):
        figure, axes = plt.subplots(
            2 * len(channels),
            1,
            sharex=True,
            figsize=(_WIDTH, 1.9 * len(channels) + 0.6),
            layout="constrained",
            gridspec_kw={"height_ratios": [1.5, 1.0] * len(channels)},
            squeeze=False,
        )
        for i, name in enumerate(channels):
            top, bottom = axes[2 * i, 0], axes[2 * i + 1, 0]
            panels[name], panels[f"{name} change"] = top, bottom
            for axis in (top, bottom):
                axis.axhline(0.0, color=_INPUT, linewidth=0.5)
            many = before.n > 5000
            top.plot(before.t, before.residuals[name], color=_GREY, linewidth=1.1, label="before", rasterized=many)
            top.plot(after.t, after.residuals[name], color=_MODEL, linewidth=0.8, label="after", rasterized=many)
            change = after.outputs[name] - before.outputs[name]
            bottom.plot(after.t, change, color=_STATE, linewidth=1.0, label="change of the model's output")
            unit = before.units.get(name, "")
            top.set_ylabel(_plain(_label("residual", {"residual": unit})))
            bottom.set_ylabel("change")
            old, now = before.rms()[name], after.rms()[name]
            title = f"{name}: RMS {number(old, 3)} to {number(now, 3)} {unit}"
            top.set_title(_plain(title), loc="left", fontsize=8.5)
        handles = [*panels[channels[0]].get_lines()[1:], panels[f"{channels[0]} change"].get_lines()[1]]
        figure.legend(handles=handles, loc="outside upper right", ncols=3, frameon=False, fontsize=7.5)
        axes[-1, 0].set_xlabel(_plain(f"time of {before.name}, s" if len(fit.records) > 1 else "time, s"))
        axes[-1, 0].margins(x=0.01)
        figure.align_ylabels()
    return figure, panels


def _finite(value: float) -> float:
    return value if np.isfinite(value) else np.inf


def ranking_figure(ranking: Sequence[Scored], threshold: float, best: int = _BARS) -> tuple[Figure, dict[str, Axes]]:
    """Bars of the best candidates: twice the expected gain in log-likelihood, against the threshold.

    Filled bars use residuals whitened, circles residuals taken as white, which would have one believe too much. Hatched
    are candidates with a remark: hard to tell from the parameters there. Returns the figure and the axes by
    ``"ranking"``. Raises DataError where there is none.
    """
    import matplotlib.pyplot as plt
    from matplotlib import rc_context
    from matplotlib.ticker import FuncFormatter

    if not ranking:
        raise DataError("ranking_figure: there are no candidates")
    shown = sorted(ranking, key=lambda s: s.statistic, reverse=True)[:best]
    with rc_context({**_STYLE, "hatch.linewidth": 0.4}):
        figure, axis = plt.subplots(figsize=(_WIDTH, 0.24 * len(shown) + 0.9), layout="constrained")
        low = max(1.0, 0.3 * min(threshold, *(s.statistic for s in shown)))
        for row, scored in enumerate(shown):
            passed = scored.statistic > threshold
            axis.barh(
                row,
                max(scored.statistic, 0.0),
                0.66,
                color=_MEASURED if passed else "#B5CFE0",
                hatch="////" if scored.remark else None,
                edgecolor="white",
                linewidth=0.0,
                label=None,
            )
            axis.plot(scored.white, row, "o", ms=3.2, mfc="none", mec=_RESIDUAL, mew=0.8)
        axis.axvline(threshold, color=_MODEL, linewidth=1.1)
        axis.set_xscale("log")
        axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_xlim(left=low)
        axis.set_yticks(range(len(shown)), [_plain(s.name) for s in shown])
        axis.tick_params(axis="y", length=0.0)
        axis.invert_yaxis()
        axis.set_xlabel("expected 2 Δ log-likelihood")
        handles = _ranking_key(threshold, any(s.remark for s in shown))
        figure.legend(handles=handles, loc="outside upper right", ncols=len(handles), frameon=False, fontsize=7.0)
    return figure, {"ranking": axis}


def _ranking_key(threshold: float, remarks: bool) -> list[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    key: list[Any] = [
        Patch(color=_MEASURED, label="residuals whitened"),
        Line2D([], [], linestyle="", marker="o", ms=3.2, mfc="none", mec=_RESIDUAL, label="taken as white"),
        Line2D([], [], color=_MODEL, linewidth=1.1, label=f"threshold {threshold:.0f}"),
    ]
    if remarks:
        key.append(Patch(facecolor=_MEASURED, hatch="////", edgecolor="white", label="see its remark"))
    return key


def gain_figure(gain: Gain, units: Mapping[str, str] | None = None) -> tuple[Figure, dict[str, Axes]]:
    """RMS of the residuals after over before, per channel: fitted data (dots) and data held out (diamonds).

    Returns the figure and the axes by ``"gain"``. Raises DataError for a gain without channels.
    """
    import matplotlib.pyplot as plt
    from matplotlib import rc_context

    names = list(gain.channels)
    if not names:
        raise DataError("gain_figure: the gain has no channels")
    held_out = [gain.change(name, held_out=True) for name in names]
    with rc_context(_STYLE):
        figure, axis = plt.subplots(figsize=(_WIDTH, 0.3 * len(names) + 0.9), layout="constrained")
        axis.axvline(100.0, color=_INPUT, linewidth=0.6)
        rows = np.arange(len(names))
        fitted = np.array([100.0 * (1.0 + gain.change(name)) for name in names])
        other = np.array([100.0 * (1.0 + change) for change in held_out])
        for row, a, b in zip(rows, fitted, other, strict=True):
            axis.plot([100.0, a], [row - 0.12] * 2, color=_MEASURED, linewidth=1.4)
            axis.plot([100.0, b], [row + 0.12] * 2, color=_MODEL, linewidth=1.4)
        axis.plot(fitted, rows - 0.12, "o", color=_MEASURED, ms=4.5, label="fitted")
        if np.isfinite(other).any():
            axis.plot(other, rows + 0.12, "D", color=_MODEL, ms=4.0, label="held out")
        labels = []
        for name in names:
            unit = (units or {}).get(name, "")
            sizes = f"{number(gain.rms_before[name], 3)} to {number(gain.rms_after[name], 3)} {unit}".rstrip()
            labels.append(_plain(f"{name}: {sizes}"))
        axis.set_yticks(rows, labels)
        axis.tick_params(axis="y", length=0.0)
        axis.invert_yaxis()
        axis.margins(x=0.06, y=0.08)
        axis.set_xlabel("RMS of residuals after, % of before (left of the line is better)")
        figure.legend(loc="outside upper right", ncols=2, frameon=False, fontsize=7.5)
    return figure, {"gain": axis}
