"""Figures of a diagnosis: what the extension changes, the ranking of the candidates, and the gain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import DataError, UnknownName, listing
from ...figures import GREY, INPUT, MEASURED, MODEL, RESIDUAL, STATE, WIDTH, Panels, labelled, plain, styled
from ...fit_result import FitResult
from ...records import Record
from ...time_unit import SECONDS
from ..misfit.phrases import number
from ..search.finding import DiagnosisResult, ExtensionResult, Finding, Gain, Scored

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ...modelling.model import Model

__all__ = [
    "curve_figure",
    "diagnosis_figure",
    "diagnosis_figures",
    "explained_figure",
    "findings_figure",
    "gain_figure",
    "ranking_figure",
]

_BARS = 12
# Height of the picture in those of the bars that show how many samples there are; area of the largest dot, points².
_BARS_BENEATH, _DOT = 4.0, 30.0


def diagnosis_figure(diagnosis: DiagnosisResult) -> tuple[Figure, dict[str, Axes]]:
    """Return the figure of `Diagnosis.plot` and its axes by name; see there."""
    if any(np.isfinite(f.explained) for f in diagnosis.findings):
        return explained_figure(diagnosis.findings)
    if diagnosis.ranking:
        return ranking_figure(diagnosis.ranking, diagnosis.threshold)
    return diagnosis.misfit.plot()


def diagnosis_figures(diagnosis: DiagnosisResult) -> list[Figure]:
    """Return the figures of `Diagnosis.figures`; see there."""
    figures = []  # as they are made, so they are shown in a notebook
    if any(np.isfinite(f.explained) for f in diagnosis.findings):
        figures.append(explained_figure(diagnosis.findings)[0])
    figures.append(diagnosis.misfit.plot()[0])
    figures += [curve_figure(f, diagnosis.fit.model)[0] for f in diagnosis.findings if f.is_drawn]
    if diagnosis.ranking:
        figures.append(ranking_figure(diagnosis.ranking, diagnosis.threshold)[0])
    extension = diagnosis._extension
    if extension is not None and extension.added:
        figures.append(findings_figure(diagnosis.fit, extension)[0])
        figures.append(gain_figure(extension.gain, diagnosis.fit.model.units)[0])
    return figures


# Half-width of an interval of 95 % of a normal distribution.
_NORMAL = 1.959963984540054
# Other candidates that are drawn below a finding.
_OTHERS = 3


def explained_figure(findings: Sequence[Finding], width: float = WIDTH) -> tuple[Figure, dict[str, Axes]]:
    """Return what findings explain of the misfit in free simulation of data held out, with 95 % intervals; other
    candidates beneath, and beside it by how much the mean square of each output falls.

    Named causes are dark, minor findings and surrogates pale. Hatched is what differs from record to record, which
    explains a part of the misfit of the fitted records. Returns the figure and the axes by ``"explained"`` and
    ``"outputs"``. Raises DataError where no finding has a part that it explains.
    """
    shown = [f for f in findings if np.isfinite(f.explained)]
    if not shown:
        raise DataError("explained_figure: no finding has a part of the misfit that it explains")
    alternatives = [[n for n in f.aliases if n in f.alternatives_explained][:_OTHERS] for f in shown]
    outputs = list(dict.fromkeys(name for f in shown for name in f.explained_outputs))
    rows = sum(1 + len(each) for each in alternatives)
    with styled({"hatch.linewidth": 0.6}) as plt:
        narrow = width < WIDTH  # the panels stand one below the other
        figure, (left, right) = plt.subplots(
            2 if narrow else 1,
            1 if narrow else 2,
            figsize=(width, (0.64 if narrow else 0.32) * rows + (1.7 if narrow else 1.1)),
            layout="constrained",
            sharey=True,
            gridspec_kw={} if narrow else {"width_ratios": [1.7, 1.0]},
        )
        row, labels = 0, []
        for f, others in zip(shown, alternatives, strict=True):
            color = MODEL if f.status == "named" else "#B5CFE0"
            fitted = f.explained_in == "the fitted records"
            hatch = "////" if fitted else None
            left.barh(row, 100.0 * f.explained, 0.62, color=color, hatch=hatch, edgecolor="white", linewidth=0.0)
            left.plot([100.0 * x for x in f.explained_interval], [row, row], color=RESIDUAL, linewidth=1.4)
            right.plot([0.0, 100.0], [row, row], color="#E5E5E5", linewidth=0.6, zorder=0)
            for k, name in enumerate(outputs):
                right.plot(100.0 * f.explained_outputs.get(name, 0.0), row, "o", color=f"C{k}", ms=5.0)
            name = f.cause or next(iter(f.aliases), "?")
            remarks = [*([f.status] if f.status != "named" else []), *(["fitted records"] if fitted else [])]
            labels.append(f"{name} ({', '.join(remarks)})" if remarks else name)
            for name in others:
                row += 1
                left.plot(100.0 * f.alternatives_explained[name], row, "D", ms=4.0, mfc="white", mec=RESIDUAL, mew=0.9)
                labels.append(f"or {name}")
            row += 1
        left.axvline(0.0, color=INPUT, linewidth=0.6)
        left.set_yticks(range(rows), [plain(text) for text in labels])
        for text, label in zip(left.get_yticklabels(), labels, strict=True):
            text.set_color(GREY if label.startswith("or ") else "black")
        left.tick_params(axis="y", length=0.0)
        left.invert_yaxis()
        left.set_xlabel("part of the misfit explained, %")
        right.set_xlabel("reduction of mean square, %")
        right.tick_params(axis="y", length=0.0)
        for k, name in enumerate(outputs):  # for the key
            right.plot([], [], linestyle="", marker="o", color=f"C{k}", ms=5.0, label=plain(name))
        figure.legend(
            loc="outside upper right",
            ncols=min(len(outputs), 9),
            frameon=False,
            fontsize=7.0,
            handletextpad=0.1,
            columnspacing=1.0,
        )
    return figure, Panels({"explained": left, "outputs": right})


def curve_figure(finding: Finding, model: Model | None = None, width: float = WIDTH) -> tuple[Figure, dict[str, Axes]]:
    """Return what a disturbance or an unknown function adds to its place: with a band of 95 % over time or over its
    variable, or over its two variables, where there are samples. Grey bars or dots show how many samples there are.

    Returns the figure and the axes by ``"curve"``. Raises DataError for a finding without a curve.
    """
    if not finding.is_drawn:
        raise DataError("curve_figure: the finding has no curve: it is neither a disturbance nor an unknown function")
    name = finding.cause or next(iter(finding.aliases), "")
    where, _, what = name.partition(":")
    of = what[2:-1].split(", ") if what.startswith("f(") else []
    time = SECONDS if model is None else model.time_unit
    added = f"added to {_with_unit(where, model)}" if where else "missing term"
    with styled() as plt:
        figure, axes = plt.subplots(figsize=(width, 3.0 if finding.surface else 2.0), layout="constrained")
        if finding.surface:
            _draw_surface(figure, axes, finding.surface, added)
        else:
            _draw_curve(axes, finding.curve)
            axes.set_ylabel(added)
        axes.set_xlabel(_with_unit(of[0], model) if of else time.axis())
        if len(of) > 1:
            axes.set_ylabel(_with_unit(of[1], model))
    return figure, Panels({"curve": axes})


def _with_unit(name: str, model: Model | None) -> str:
    """Return a name with its unit, that of the rate for a state equation, as axes show it."""
    state = name.removesuffix("'")
    unit = "" if model is None else model.variable_units.get(state, "")
    if model is None or unit in ("", "1", "-"):
        return plain(name)
    return plain(f"{name}, {unit if state == name else model.time_unit.rate(unit)}")


def _draw_curve(axes: Axes, curve: Mapping[str, Sequence[float]]) -> None:
    at, value, error = (np.array(curve[key]) for key in ("at", "value", "error"))
    # Knots of several records stand one after the other.
    pieces = np.split(np.arange(at.size), np.flatnonzero(np.diff(at) <= 0.0) + 1)
    for piece in pieces:
        low, high = value[piece] - _NORMAL * error[piece], value[piece] + _NORMAL * error[piece]
        axes.fill_between(at[piece], low, high, color=MODEL, alpha=0.2, linewidth=0.0)
        axes.plot(at[piece], value[piece], color=MODEL, linewidth=1.2)
    axes.axhline(0.0, color=INPUT, linewidth=0.6)
    if "samples" in curve:
        samples = np.array(curve["samples"])
        density = axes.twinx()
        density.bar(at, samples, width=at[1] - at[0], color=GREY, alpha=0.35)
        density.set_ylim(0.0, _BARS_BENEATH * max(float(samples.max()), 1.0))
        density.set_axis_off()
        axes.set_zorder(density.get_zorder() + 1)
        axes.patch.set_visible(False)


def _draw_surface(figure: Figure, axes: Axes, surface: Mapping[str, Sequence[float]], added: str) -> None:
    first, second = (np.array(surface[key]) for key in ("first", "second"))
    value, samples = (np.array(surface[key]).reshape(first.size, second.size) for key in ("value", "samples"))
    there = np.ma.masked_where(samples == 0, value)
    largest = float(np.abs(there).max()) or 1.0
    drawn = axes.pcolormesh(first, second, there.T, cmap="RdBu_r", vmin=-largest, vmax=largest, shading="nearest")
    x, y = np.meshgrid(first, second, indexing="ij")
    axes.scatter(x, y, s=_DOT * samples / max(float(samples.max()), 1.0), color=GREY, linewidth=0.0)
    figure.colorbar(drawn, ax=axes, label=added)


def findings_figure(
    fit: FitResult, extension: ExtensionResult, channels: Sequence[str] | None = None, width: float = WIDTH
) -> tuple[Figure, dict[str, Axes]]:
    """Per channel of the experiment where residuals fall most, in parts of what they were: residuals before and after,
    and beneath what the extension changes in the model's output.

    channels  names; None: the three of which the RMS falls most.

    The change is the output of the extended model minus that of the base model, each at its own estimates: the added
    effect together with the changes of the other parameters. Returns the figure and the axes by ``"<channel>"`` and
    ``"<channel> change"``. Raises UnknownName for a channel that is not there.
    """
    falls = [_fall(b, a) for b, a in zip(fit.records, extension.fit.records, strict=True)]
    record = int(np.argmin(falls))
    before, after = fit.records[record], extension.fit.records[record]
    known = [name for name in before.residuals if name in after.residuals]
    if channels is None:
        channels = sorted(known, key=lambda name: _finite(extension.gain.change(name)))[:3]
    for name in channels:
        if name not in known:
            raise UnknownName(f"the fit has no channel '{name}'.{listing(name, known)}")
    if not channels:
        raise DataError("findings_figure: there is no channel to draw")
    panels: dict[str, Any] = {}
    with styled() as plt:
        figure, axes = plt.subplots(
            2 * len(channels),
            1,
            sharex=True,
            figsize=(width, 1.9 * len(channels) + 0.6),
            layout="constrained",
            gridspec_kw={"height_ratios": [1.5, 1.0] * len(channels)},
            squeeze=False,
        )
        for i, name in enumerate(channels):
            top, bottom = axes[2 * i, 0], axes[2 * i + 1, 0]
            panels[name], panels[f"{name} change"] = top, bottom
            for axis in (top, bottom):
                axis.axhline(0.0, color=INPUT, linewidth=0.5)
            many = before.n > 5000
            top.plot(before.t, before.residuals[name], color=GREY, linewidth=1.1, label="before", rasterized=many)
            top.plot(after.t, after.residuals[name], color=MODEL, linewidth=0.8, label="after", rasterized=many)
            change = after.outputs[name] - before.outputs[name]
            bottom.plot(after.t, change, color=STATE, linewidth=1.0, label="change of the model's output")
            unit = before.units.get(name, "")
            top.set_ylabel(plain(labelled("residual", {"residual": unit})))
            bottom.set_ylabel("change")
            old, now = before.rms()[name], after.rms()[name]
            title = f"{name}: RMS {number(old, 3)} to {number(now, 3)} {unit}"
            top.set_title(plain(title), loc="left", fontsize=8.5)
        handles = [*panels[channels[0]].get_lines()[1:], panels[f"{channels[0]} change"].get_lines()[1]]
        figure.legend(handles=handles, loc="outside upper right", ncols=3, frameon=False, fontsize=7.5)
        shown = f"time in '{before.name}'" if len(fit.records) > 1 else "time"
        axes[-1, 0].set_xlabel(plain(fit.model.time_unit.axis(shown)))
        axes[-1, 0].margins(x=0.01)
        figure.align_ylabels()
    return figure, Panels(panels)


def _fall(before: Record, after: Record) -> float:
    """Mean over the channels of the RMS after over that before."""
    old, now = before.rms(), after.rms()
    ratios = [now[name] / old[name] for name in old if old[name] > 0.0 and np.isfinite(now.get(name, np.nan))]
    return float(np.mean(ratios)) if ratios else np.inf


def _finite(value: float) -> float:
    return value if np.isfinite(value) else np.inf


def ranking_figure(ranking: Sequence[Scored], threshold: float, width: float = WIDTH) -> tuple[Figure, dict[str, Axes]]:
    """Bars of the best candidates: the expected gain in log-likelihood, against the threshold.

    ``ranking`` and ``threshold`` are in twice the log-likelihood.

    Bars: with noise that has the autocorrelation of the residuals. Ticks: with the autocorrelation of what the best few
    terms leave of them, by which candidates are ranked. Circles: with white noise, which overrates slow effects.
    Hatched are candidates with a remark, which are hard to distinguish from parameters of the model.

    Returns the figure and the axes by ``"ranking"``. Raises DataError where there is none.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    if not ranking:
        raise DataError("ranking_figure: there are no candidates")
    shown = sorted(ranking, key=lambda s: s.ranking, reverse=True)[:_BARS]
    least = threshold / 2
    with styled({"hatch.linewidth": 0.4}) as plt:
        figure, axis = plt.subplots(figsize=(width, 0.24 * len(shown) + 0.9), layout="constrained")
        low = max(0.5, 0.3 * min(least, *(s.statistic / 2 for s in shown)))
        for row, scored in enumerate(shown):
            passed = scored.statistic > threshold
            axis.barh(
                row,
                max(scored.statistic / 2, 0.0),
                0.66,
                color=MEASURED if passed else "#B5CFE0",
                hatch="////" if scored.remark else None,
                edgecolor="white",
                linewidth=0.0,
                label=None,
            )
            axis.plot(scored.ranking / 2, row, "|", ms=9.0, mec=RESIDUAL, mew=1.6)
            axis.plot(scored.white / 2, row, "o", ms=3.6, mfc="white", mec=RESIDUAL, mew=0.9)
        axis.axvline(least, color=MODEL, linewidth=1.1)
        axis.set_xscale("log")
        axis.set_xlim(left=low)
        low, high = axis.get_xlim()
        if high < 100.0 * low:  # less than two decades
            axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.set_yticks(range(len(shown)), [plain(s.name) for s in shown])
        axis.tick_params(axis="y", length=0.0)
        axis.invert_yaxis()
        axis.set_xlabel("expected gain in log-likelihood")
        handles = _ranking_key(least, any(s.remark for s in shown))
        columns = len(handles) if width == WIDTH else 2
        figure.legend(handles=handles, loc="outside upper right", ncols=columns, frameon=False, fontsize=7.0)
    return figure, Panels({"ranking": axis})


def _ranking_key(threshold: float, remarks: bool) -> list[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    key: list[Any] = [
        Patch(color=MEASURED, label="coloured noise"),
        Line2D([], [], linestyle="", marker="|", ms=7.0, mec=RESIDUAL, mew=1.6, label="ranked by"),
        Line2D([], [], linestyle="", marker="o", ms=3.6, mfc="white", mec=RESIDUAL, mew=0.9, label="white noise"),
        Line2D([], [], color=MODEL, linewidth=1.1, label=f"threshold {threshold:.1f}"),
    ]
    if remarks:
        key.append(Patch(facecolor=MEASURED, hatch="////", edgecolor="white", label="see its remark"))
    return key


def gain_figure(
    gain: Gain, units: Mapping[str, str] | None = None, width: float = WIDTH
) -> tuple[Figure, dict[str, Axes]]:
    """RMS of the residuals after over before, per channel: fitted data (dots) and data held out (diamonds).

    Returns the figure and the axes by ``"gain"``. Raises DataError for a gain without channels.
    """
    names = list(gain.channels)
    if not names:
        raise DataError("gain_figure: the gain has no channels")
    held_out = [gain.change(name, held_out=True) for name in names]
    with styled() as plt:
        figure, axis = plt.subplots(figsize=(width, 0.3 * len(names) + 0.9), layout="constrained")
        axis.axvline(100.0, color=INPUT, linewidth=0.6)
        rows = np.arange(len(names))
        apart = 0.12 if np.isfinite(held_out).any() else 0.0
        fitted = np.array([100.0 * (1.0 + gain.change(name)) for name in names])
        other = np.array([100.0 * (1.0 + change) for change in held_out])
        for row, a, b in zip(rows, fitted, other, strict=True):
            axis.plot([100.0, a], [row - apart] * 2, color=MEASURED, linewidth=1.4)
            axis.plot([100.0, b], [row + apart] * 2, color=MODEL, linewidth=1.4)
        axis.plot(fitted, rows - apart, "o", color=MEASURED, ms=4.5, label="fitted")
        if np.isfinite(other).any():
            axis.plot(other, rows + apart, "D", color=MODEL, ms=4.0, label="held out")
        labels = []
        for name in names:
            unit = (units or {}).get(name, "")
            sizes = f"{number(gain.rms_before[name], 3)} to {number(gain.rms_after[name], 3)} {unit}".rstrip()
            labels.append(plain(f"{name}: {sizes}"))
        axis.set_yticks(rows, labels)
        axis.tick_params(axis="y", length=0.0)
        axis.invert_yaxis()
        axis.margins(x=0.06, y=0.08)
        axis.set_xlabel("RMS of residuals after, % of before")
        figure.legend(loc="outside upper right", ncols=2, frameon=False, fontsize=7.5)
    return figure, Panels({"gain": axis})
