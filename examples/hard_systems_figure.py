"""The figure of hard_systems.py: a column for each system; records, the cost along one parameter, errors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter

if TYPE_CHECKING:
    from hard_systems import Result

# Okabe and Ito's palette, which colour-blind readers tell apart; shapes and dashes also differ.
DATA, OURS, SHOT, LINE = "#999999", "#0072B2", "#D55E00", "#000000"
STYLE: dict[Any, Any] = {
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.7,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
}
SYMBOLS = {
    "alpha": r"$\alpha$", "x": "$x$", "angle": r"angle $\varphi$", "Za": r"$Z_\alpha$", "Zde": r"$Z_{\delta_e}$",
    "Ma": r"$M_\alpha$", "Mq": "$M_q$", "Mde": r"$M_{\delta_e}$", "sigma": r"$\sigma$", "rho": r"$\rho$",
    "beta": r"$\beta$", "mu": r"$\mu$", "a": "$a$", "b": "$b$", "f": "$f$",
}  # fmt: skip
WINDOW = {"oscillating": (100.0, 120.0)}
"""Part of a record that is shown, where the whole would be a blur."""


def draw(results: Sequence[Result]) -> Figure:
    """Three rows of panels, a column for each system."""
    with plt.rc_context(STYLE):
        figure, panels = plt.subplots(3, len(results), figsize=(13.0, 8.4), height_ratios=(1.1, 1.1, 1.0))
        figure.subplots_adjust(left=0.07, right=0.985, top=0.885, bottom=0.05, hspace=0.35, wspace=0.33)
        for result, (top, middle, bottom) in zip(results, panels.T, strict=True):
            _record(top, result)
            _slice(middle, result)
            _errors(bottom, result)
        panels[1, 0].set_ylabel("RMS residual / noise\nof a simulation")
        panels[2, 0].set_ylabel("error of the estimate,\nstandard errors")
        _legend(figure)
    return figure


def _label(name: str, unit: str) -> str:
    return f"{SYMBOLS.get(name, name)}, {unit}" if unit else SYMBOLS.get(name, name)


def _record(axis: Axes, result: Result) -> None:
    """Measurements and both fits."""
    system, name = result.system, result.system.shown
    t, z = result.data.t, result.data.outputs[name]
    axis.plot(t, z, ".", color=DATA, ms=2.2)
    axis.plot(t, result.fit.outputs[name], color=OURS, lw=1.3)
    axis.plot(t, result.shot_outputs[name], "--", color=SHOT, lw=1.2)
    margin = 0.12 * np.ptp(z)
    axis.set_ylim(z.min() - margin, z.max() + margin)
    axis.set_xlim(WINDOW.get(system.name, (t[0], t[-1])))
    axis.set_xlabel("time, s")
    axis.set_ylabel(_label(name, system.units.get(name, "")))
    axis.set_title(system.title, loc="left", pad=19, fontsize=10.5, fontweight="bold")
    axis.annotate(system.why, (0, 1), (0, 5), xycoords="axes fraction", textcoords="offset points")


def _power(value: float) -> str:
    """A number to two digits, or a power of ten."""
    return f"{value:.2g}" if value < 1e4 else f"$10^{{{np.log10(value):.0f}}}$"


def _slice(axis: Axes, result: Result) -> None:
    """What single shooting sees along one parameter, everything else at the optimum."""
    system = result.system
    name, low, high = system.slice
    values, cost = result.line
    axis.plot(values, cost, color=LINE, lw=0.8)
    axis.plot(result.fit.parameters[name].value, result.rms, "o", color=OURS, ms=6, zorder=3, clip_on=False)
    axis.plot(result.shot_values[name], result.shot.rms, "s", color=SHOT, ms=6, zorder=3, clip_on=False)
    axis.axvline(system.start[name], color=DATA, ls=":", lw=1.4)
    axis.set_yscale("log")
    highest = cost[np.isfinite(cost)].max()
    axis.set_ylim(0.6 if highest < 1e3 else 1e-2, 2 * highest)
    if highest < 1e3:
        axis.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.yaxis.set_major_formatter("{x:g}")
        axis.yaxis.set_minor_formatter(NullFormatter())
    if result.rms_again > 1.5 * result.rms:
        axis.annotate(
            f"simulated\nfrom here: {_power(result.rms_again)}",
            (result.fit.parameters[name].value, result.rms), (-7, 0), textcoords="offset points",
            ha="right", va="center", fontsize=8, color=OURS,
        )  # fmt: skip
    axis.set_xlim(low, high)
    axis.set_xlabel(_label(name, system.units.get(name, "")))


def _errors(axis: Axes, result: Result) -> None:
    """Errors of both estimates, in standard errors of collocation's."""
    axis.axhspan(-2, 2, color="#E6E6E6", lw=0)
    axis.axhline(0, color=LINE, lw=0.6)
    for shift, errors, shape, colour in (
        (-0.12, result.collocation_errors, "o", OURS),
        (0.12, result.shot_errors, "s", SHOT),
    ):
        axis.plot(np.arange(len(errors)) + shift, list(errors.values()), shape, color=colour, ms=6)
    axis.set_yscale("symlog", linthresh=4, linscale=1.2)
    axis.set_ylim(-1e4, 1e4)
    axis.set_yticks([-1e4, -100, -2, 0, 2, 100, 1e4], ["−10⁴", "−100", "−2", "0", "2", "100", "10⁴"])
    axis.minorticks_off()
    axis.set_xlim(-0.6, len(result.system.truth) - 0.4)
    axis.set_xticks(range(len(result.system.truth)), [SYMBOLS.get(n, n) for n in result.system.truth])


def _legend(figure: Figure) -> None:
    """One for all panels."""
    handles = [
        Line2D([], [], color=DATA, marker=".", ls="", label="measured"),
        Line2D([], [], color=OURS, marker="o", label="collocation"),
        Line2D([], [], color=SHOT, marker="s", ls="--", label="single shooting, where it ended"),
        Line2D([], [], color=DATA, ls=":", label="start of both"),
        Line2D([], [], color=LINE, lw=0.8, label="cost of single shooting, all else at the optimum"),
    ]
    figure.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 0.995), ncols=len(handles), frameon=False)
