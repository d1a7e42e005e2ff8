"""Figures of profile likelihoods and of prediction bands."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..figures.style import BAND, GREY, MEASURED, MODEL, ORANGE, SPAN, STYLE, WIDTH, labelled, plain

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from .profile import Profile

__all__ = ["plot_bands", "plot_profiles"]

# Columns of panels, and the height of each in inches, of profiles and of bands.
_COLUMNS, _HEIGHT = 3, 1.95
_BAND_COLUMNS, _BAND_HEIGHT = 2, 1.8
# Shown length of an infinite interval, in halves of a finite one.
_BEYOND = 4.0


def plot_profiles(profiles: Sequence[Profile], level: float) -> tuple[Figure, dict[str, Axes]]:
    """Plot one panel for each parameter: the drop of log-likelihood, the parabola of the Cramér-Rao standard error
    (dashed), the threshold and the interval."""
    import matplotlib.pyplot as plt
    from matplotlib import rc_context
    from matplotlib.lines import Line2D

    columns = min(_COLUMNS, max(len(profiles), 1))
    rows = math.ceil(len(profiles) / columns)
    with rc_context(STYLE):
        figure, grid = plt.subplots(
            rows, columns, figsize=(max(WIDTH * columns / _COLUMNS + 0.3, 3.9), _HEIGHT * rows + 0.4), squeeze=False
        )
        panels = list(grid.ravel())
        axes = {p.name: axis for p, axis in zip(profiles, panels, strict=False)}
        for axis in panels[len(profiles) :]:
            axis.set_visible(False)
        for i, p in enumerate(profiles):
            _draw_profile(axes[p.name], p)
            if i % columns == 0:
                axes[p.name].set_ylabel("Δ log-likelihood")
        handles = [
            Line2D([], [], color=MEASURED, marker="o", markersize=3, label="profile"),
            Line2D([], [], color=ORANGE, linestyle="--", label="standard error"),
            Line2D([], [], color=GREY, linewidth=0.8, label=f"{100 * level:g} %"),
        ]
        height = figure.get_figheight()
        figure.legend(handles=handles, loc="upper right", ncols=3, frameon=False, fontsize=8)
        figure.tight_layout(rect=(0, 0, 1, 1 - 0.28 / height))
    return figure, axes


def _draw_profile(axis: Any, p: Profile) -> None:
    at, roots = p.values, np.sign(p.values - p.value) * np.sqrt(2.0 * np.maximum(p.drops, 0.0))
    reach = 1.35 * math.sqrt(2.0 * p.threshold)
    shown = np.abs(roots) <= 2.0 * reach
    at, roots = at[shown], roots[shown]
    if at.size > 1:
        # Roots are nearly straight, so what lies between the points is known.
        from scipy.interpolate import PchipInterpolator

        half = [abs(e - p.value) for e in p.interval if math.isfinite(e)] or [2.0 * p.std_error]
        beyond = _BEYOND * max(half) if math.isfinite(max(half)) else math.inf
        low = p.interval[0] if math.isfinite(p.interval[0]) else max(float(at[0]), p.value - beyond)
        high = p.interval[1] if math.isfinite(p.interval[1]) else min(float(at[-1]), p.value + beyond)
        fine = np.linspace(max(at[0], low - half[0]), min(at[-1], high + half[-1]), 200)
        smooth = PchipInterpolator(at, roots)(fine)
        axis.plot(fine, -0.5 * smooth**2, color=MEASURED, linewidth=1.3)
        margin = 0.12 * (high - low)
        axis.set_xlim(low - margin, high + margin)
    axis.plot(at, -0.5 * roots**2, "o", color=MEASURED, markersize=3)
    if math.isfinite(p.std_error):
        wide = np.linspace(axis.get_xlim()[0], axis.get_xlim()[1], 200)
        axis.plot(wide, -0.5 * ((wide - p.value) / p.std_error) ** 2, "--", color=ORANGE, linewidth=1.1, zorder=1)
    axis.axhline(-p.threshold, color=GREY, linewidth=0.8, zorder=0)
    for end in p.interval:
        if math.isfinite(end):
            axis.plot([end, end], [-p.threshold, -2.0 * p.threshold], color=GREY, linewidth=0.8, zorder=0)
    axis.set_ylim(-1.6 * p.threshold, 0.12 * p.threshold)
    axis.locator_params(axis="x", nbins=4)
    axis.tick_params(labelsize=7)
    axis.set_xlabel(plain(labelled(p.name, {p.name: p.unit})))


def plot_bands(bands: Any, title: str) -> tuple[Figure, dict[str, Axes]]:
    """Plot one panel for each output: measured points, the model's line, and both bands."""
    import matplotlib.pyplot as plt
    from matplotlib import rc_context

    names = list(bands.model)
    columns = min(_BAND_COLUMNS, len(names)) if len(names) > 2 else 1
    rows = math.ceil(len(names) / columns)
    with rc_context(STYLE):
        figure, grid = plt.subplots(
            rows, columns, figsize=(WIDTH, _BAND_HEIGHT * rows + 0.7), squeeze=False, sharex=True
        )
        panels = list(grid.T.ravel())
        for axis in panels[len(names) :]:
            axis.set_visible(False)
        axes: dict[str, Axes] = dict(zip(names, panels, strict=False))
        for name, axis in axes.items():
            _draw_bands(axis, bands, name)
        for axis in grid[-1]:
            axis.set_xlabel("time, s")
        if len(names) < len(panels):  # the panel above an empty one has the axis of time
            last = axes[names[-1]]
            last.tick_params(labelbottom=True)
            last.set_xlabel("time, s")
        handles, labels = axes[names[0]].get_legend_handles_labels()
        height = figure.get_figheight()
        figure.legend(handles, labels, loc="upper right", ncols=4, frameon=False, fontsize=8, columnspacing=1.2)
        what = "coloured" if bands.coloured else "white"
        figure.suptitle(
            plain(f"{title}, {100 * bands.level:g} % for {what} noise"),
            x=0.01,
            y=1 - 0.3 / height,
            ha="left",
            fontsize=9,
        )
        figure.tight_layout(rect=(0, 0, 1, 1 - 0.42 / height), h_pad=0.4)
        figure.align_ylabels()
    return figure, axes


def _draw_bands(axis: Any, bands: Any, name: str) -> None:
    record = bands.record
    t = record.t
    axis.fill_between(t, *bands.measurement[name], color=BAND, linewidth=0, label="measurement")
    axis.fill_between(t, *bands.model[name], color=SPAN, linewidth=0, label="model")
    axis.plot(t, record.outputs[name], color=MODEL, linewidth=0.9, label="estimate")
    if name in record.measured:
        there = np.isfinite(record.measured[name])
        size = 2.0 if t.size <= 1000 else 1.0
        axis.plot(
            t[there], record.measured[name][there], ".", color=MEASURED, markersize=size, label="measured", zorder=1.5
        )
    axis.set_ylabel(plain(labelled(name, record.units)))
    axis.margins(x=0.01)
