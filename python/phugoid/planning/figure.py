"""Figure of planned manoeuvres: time histories with their limits, and the standard errors to expect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..figures.style import LIMIT, SERIES, STYLE, WIDTH, labelled, plain
from .plan import Plan, relative_errors

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["plot_plans"]

# Inches: height of a channel's panel, of the margins around all panels, and the least of the figure.
_CHANNEL, _AROUND, _LEAST = 0.8, 0.9, 3.0


def plot_plans(plans: Sequence[Plan]) -> tuple[Figure, dict[str, Axes]]:
    """Plot time histories on the left, relative errors of all parameters on the right; axes by channel, and
    "errors"."""
    from matplotlib import pyplot as plt
    from matplotlib import rc_context

    first = plans[0].records[0]
    channels = [*first.inputs, *first.outputs]
    excursions = plans[0].excursions[first.name]
    channels += [n for n, e in excursions.items() if e.limit is not None and n not in channels]
    with rc_context(STYLE):
        height = max(_CHANNEL * len(channels) + _AROUND, _LEAST)
        figure = plt.figure(figsize=(WIDTH, height), layout="constrained")
        left, right = figure.subfigures(1, 2, width_ratios=(1.25, 1.0), squeeze=False)[0]
        rows = left.subplots(len(channels), 1, sharex=True, squeeze=False)[:, 0]
        axes: dict[str, Axes] = dict(zip(channels, rows, strict=True))
        for i, p in enumerate(plans):
            _histories(axes, p, SERIES[i % len(SERIES)][0])
        for n, a in axes.items():
            _limits(a, excursions[n].limit)
            a.set_ylabel(plain(labelled(n, {n: excursions[n].unit})))
            a.margins(x=0.01)
        rows[-1].set_xlabel("time, s")
        left.align_ylabels(list(rows))
        axes["errors"] = _errors(right.subplots(), plans)
    return figure, axes


def _histories(axes: Mapping[str, Axes], p: Plan, colour: str) -> None:
    """Draw the time histories, one record after another."""
    offset = 0.0
    for r in p.records:
        t = offset + r.t - r.t[0]
        for n, values in {**r.states, **r.outputs, **r.inputs}.items():
            if n in axes:
                axes[n].plot(t, values, color=colour, linewidth=0.9)
        offset = float(t[-1])


def _limits(a: Axes, limit: tuple[float, float] | None) -> None:
    if limit is None:
        return
    low, high = a.get_ylim()
    for bound in limit:
        if np.isfinite(bound) and low - (high - low) < bound < high + (high - low):
            a.axhline(bound, color=LIMIT, linestyle="--", linewidth=0.8)


def _errors(a: Axes, plans: Sequence[Plan]) -> Axes:
    names = list(dict.fromkeys(n for p in plans for n, v in relative_errors(p).items() if not np.isnan(v)))
    y = np.arange(len(names))[::-1]
    for i, p in enumerate(plans):
        found = relative_errors(p)
        x = 100.0 * np.array([found.get(n, np.nan) for n in names])
        shift = 0.0 if len(plans) == 1 else 0.36 * (0.5 - i / (len(plans) - 1))
        colour, mark = SERIES[i % len(SERIES)]
        finite = np.where(np.isfinite(x), x, np.nan)
        a.plot(finite, y + shift, color=colour, linestyle="", marker=mark, markersize=4, label=plain(p.name))
        for at, value in zip((y + shift).tolist(), x.tolist(), strict=True):
            if np.isinf(value):
                axis = a.get_yaxis_transform()
                a.text(0.98, at, "not determined", color=colour, fontsize=6.5, transform=axis, ha="right", va="center")
    a.grid(axis="both", linewidth=0.3)
    a.set_xscale("log")
    a.xaxis.set_major_formatter("{x:g}")
    a.set_yticks(y, [plain(n) for n in names])
    a.set_ylim(-0.6, len(names) - 0.4)
    a.set_xlabel("expected standard error, % of size")
    a.legend(fontsize=7.0, frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    return a
