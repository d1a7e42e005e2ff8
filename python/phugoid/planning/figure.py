"""The figure of planned manoeuvres: what moves, where the limits are, what would be told."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from .plan import Plan, relative_errors

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["plot_plans"]

# Okabe and Ito's palette, which colour-blind readers tell apart; line styles also print in grey.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#000000")
_MARKS = ("o", "s", "^", "D", "v", "x")
_LIMIT = "#A08A00"


def plot_plans(plans: Sequence[Plan]) -> tuple[Figure, dict[str, Axes]]:
    """Time histories on the left, relative errors of all parameters on the right; axes by channel, and "errors"."""
    from matplotlib import pyplot as plt

    first = plans[0].records[0]
    channels = [*first.inputs, *first.outputs]
    limited = [n for n, e in plans[0].excursions[first.name].items() if e.limit is not None and n not in channels]
    channels += limited
    figure = plt.figure(figsize=(8.6, max(0.95 * len(channels) + 0.9, 3.4)), layout="constrained")
    parts = figure.subfigures(1, 2, width_ratios=(1.25, 1.0), squeeze=False)
    left, right = parts[0]
    rows = left.subplots(len(channels), 1, sharex=True, squeeze=False)[:, 0]
    axes: dict[str, Axes] = dict(zip(channels, rows, strict=True))
    for i, p in enumerate(plans):
        colour = _COLOURS[i % len(_COLOURS)]
        offset = 0.0
        for r in p.records:
            t = offset + r.t - r.t[0]
            for n, values in {**r.states, **r.outputs, **r.inputs}.items():
                if n in axes:
                    axes[n].plot(t, values, color=colour, linewidth=0.9)
            offset = float(t[-1])
    for n, a in axes.items():
        e = plans[0].excursions[first.name][n]
        if e.limit is not None:
            low, high = a.get_ylim()
            for bound in e.limit:
                if np.isfinite(bound) and low - (high - low) < bound < high + (high - low):
                    a.axhline(bound, color=_LIMIT, linestyle="--", linewidth=0.8)
        a.set_ylabel(f"{n}, {e.unit}" if e.unit else n, fontsize="small")
        a.tick_params(labelsize="x-small")
        a.margins(x=0.01)
    rows[-1].set_xlabel("time, s", fontsize="small")
    left.align_ylabels(list(rows))
    axes["errors"] = _errors(right.subplots(), plans)
    return figure, axes


def _errors(a: Axes, plans: Sequence[Plan]) -> Axes:
    names = list(dict.fromkeys(n for p in plans for n, v in relative_errors(p).items() if not np.isnan(v)))
    y = np.arange(len(names))[::-1]
    for i, p in enumerate(plans):
        found = relative_errors(p)
        x = 100.0 * np.array([found.get(n, np.nan) for n in names])
        shift = 0.0 if len(plans) == 1 else 0.36 * (0.5 - i / (len(plans) - 1))
        colour, mark = _COLOURS[i % len(_COLOURS)], _MARKS[i % len(_MARKS)]
        told = np.where(np.isfinite(x), x, np.nan)
        a.plot(told, y + shift, color=colour, linestyle="", marker=mark, markersize=4, label=p.name)
        a.grid(axis="both", linewidth=0.3)
        for at, value in zip((y + shift).tolist(), x.tolist(), strict=True):
            if np.isinf(value):
                axis = a.get_yaxis_transform()
                a.text(0.98, at, "not told", color=colour, fontsize="x-small", transform=axis, ha="right", va="center")
    a.set_xscale("log")
    a.xaxis.set_major_formatter("{x:g}")
    a.set_yticks(y, names)
    a.set_ylim(-0.6, len(names) - 0.4)
    a.set_xlabel("standard error that would be, % of size", fontsize="small")
    a.tick_params(labelsize="small")
    a.legend(fontsize="x-small", frameon=True, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    return a
