"""The figure of prediction bands."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..figures.style import BAND, MEASURED, MODEL, SPAN, STYLE, WIDTH, labelled, plain

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["plot_bands"]

_COLUMNS, _HEIGHT = 2, 1.8


def plot_bands(bands: Any, title: str) -> tuple[Figure, dict[str, Axes]]:
    """A panel an output: measured points, the model's line, and the bands of both."""
    import matplotlib.pyplot as plt
    from matplotlib import rc_context

    names = list(bands.model)
    columns = min(_COLUMNS, len(names)) if len(names) > 2 else 1
    rows = math.ceil(len(names) / columns)
    with rc_context(STYLE):
        figure, grid = plt.subplots(rows, columns, figsize=(WIDTH, _HEIGHT * rows + 0.7), squeeze=False, sharex=True)
        panels = list(grid.T.ravel())
        for axis in panels[len(names) :]:
            axis.set_visible(False)
        axes: dict[str, Axes] = dict(zip(names, panels, strict=False))
        for name, axis in axes.items():
            _draw(axis, bands, name)
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


def _draw(axis: Any, bands: Any, name: str) -> None:
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
