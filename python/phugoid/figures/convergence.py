"""Figure of a solver's convergence: log-likelihood, defects, distance from the optimum and step of every iteration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from ..fit_result import FitResult
from .style import MEASURED, MODEL, RESIDUAL, RULE, STATE, STYLE, WIDTH, plain

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["plot_convergence"]

_Array = NDArray[np.float64]

_PANEL, _HEAD = 1.15, 0.5  # inches
_SMALLEST = 1e-16  # of what is drawn; a zero has no logarithm


def plot_convergence(fit: FitResult) -> tuple[Figure, dict[str, Axes]]:
    """Plot each column of the iteration table over the iterations, on a logarithmic scale where it changes much.

    Log-likelihood: the distance from that of the last iteration; hollow where it was above, which a point can be that
    does not meet the equations yet. Defect: the largest scaled violation of the equations; zero with shooting, which
    has none. Distance from the optimum: what `Newton` expects the next step to gain in log-likelihood; with Ipopt the
    largest scaled entry of the gradient. Step: as a part of the full one; a ring where shorter ones had to be tried.

    Where iterations start again, as with mesh refinement, they are counted on, and a line marks the place.

    Returns the figure and the axes by ``"log-likelihood"``, ``"defect"``, ``"optimum"`` and ``"step"``. Raises
    DataError for a fit without iterations, such as one whose solver keeps no table.
    """
    from matplotlib import pyplot as plt
    from matplotlib import rc_context
    from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

    history = list(fit.history)
    if not history:
        raise DataError("plot_convergence: the fit has no history of iterations")
    number = _consecutive([line.number for line in history])
    anew = [number[i] - 0.5 for i in range(1, len(history)) if history[i].number <= history[i - 1].number]
    likelihood = np.array([line.log_likelihood for line in history], dtype=float)
    names = ("log-likelihood", "defect", "optimum", "step")
    with rc_context(STYLE):
        figure, panels = plt.subplots(
            2, 2, sharex=True, figsize=(WIDTH, 2.0 * _PANEL + _HEAD + 0.45), layout="constrained"
        )
        axes: dict[str, Any] = dict(zip(names, panels.flat, strict=True))
        below = likelihood[-1] - likelihood
        _draw(axes["log-likelihood"], number[:-1], np.abs(below[:-1]), MEASURED, hollow=below[:-1] < 0.0)
        _draw(axes["defect"], number, np.array([line.defect for line in history]), MODEL)
        _draw(axes["optimum"], number, np.array([line.dual for line in history]), STATE)
        taken = np.array([line.trials for line in history])
        steps = np.array([line.step for line in history])
        moved = taken > 0  # at the start there is no step
        _draw(axes["step"], number[moved], steps[moved], RESIDUAL)
        again = moved & (taken > 1)
        if again.any():
            axes["step"].plot(number[again], steps[again], "o", mfc="none", mec=MODEL, ms=7.0, mew=0.9, label="retried")
            axes["step"].legend(frameon=False, fontsize=7.0, loc="best")
        titles = (
            f"log-likelihood, distance from the last, {likelihood[-1]:.8g}",
            "defect, largest scaled",
            "distance from the optimum",
            "step, part of the full one",
        )
        for axis, title in zip(axes.values(), titles, strict=True):
            axis.set_title(title, fontsize=8.0, loc="left")
            axis.xaxis.set_major_locator(MaxNLocator(integer=True))
            if axis.get_yscale() == "log":
                axis.yaxis.set_major_locator(LogLocator(numticks=6))
                axis.yaxis.set_minor_formatter(NullFormatter())
            for place in anew:
                axis.axvline(place, color=RULE, linewidth=0.8, linestyle="--", zorder=0.5)
        for axis in panels[1]:
            axis.set_xlabel("iteration")
        status = f"{fit.model.name}: {fit.status} after {fit.iterations} iterations, {fit.time:.2g} s"
        figure.suptitle(plain(status), x=0.01, ha="left", fontsize=9.5)
    return figure, axes


def _consecutive(numbers: Sequence[int]) -> _Array:
    """Return the numbers, counted on where the table starts again."""
    found: list[int] = []
    offset = 0
    for i, number in enumerate(numbers):
        if i and number <= numbers[i - 1]:
            offset = found[-1] + 1 - number
        found.append(number + offset)
    return np.array(found, dtype=float)


def _draw(axis: Axes, number: _Array, values: _Array, colour: str, hollow: NDArray[np.bool_] | None = None) -> None:
    values = np.where(np.isfinite(values), values, np.nan)
    axis.set_yscale("log")
    shown = values > _SMALLEST
    if not shown.any():
        axis.text(
            0.5, 0.5, "zero, or none, throughout", transform=axis.transAxes, ha="center", va="center", fontsize=7.0
        )
        axis.set_yscale("linear")
        axis.set_yticks([])
        return
    axis.plot(number, np.where(shown, values, np.nan), color=colour, linewidth=0.9)
    hollow = np.zeros(number.size, dtype=bool) if hollow is None else hollow
    for which, face in ((~hollow, colour), (hollow, "white")):
        chosen = which & shown
        axis.plot(number[chosen], values[chosen], "o", ms=3.5, mfc=face, mec=colour, mew=0.9)
    low, high = float(np.nanmin(values[shown])), float(np.nanmax(values[shown]))
    if high < 10.0 * low:
        axis.set_yscale("linear")
        axis.set_ylim(0.0, 1.15 * high)
