"""Heat map of the correlation between estimates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, UnknownName, listing
from ..fit_result import FitResult
from ..parameters import correlation_matrix
from .style import STYLE, WIDTH, headline, plain

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["plot_correlation"]

_Array = NDArray[np.float64]

# Inches: the margins, the largest cell, and the bar of colours with its gap.
_RIGHT, _TOP, _BOTTOM, _CELL = 0.12, 0.34, 0.12, 0.55
_NARROW = 4.6  # a small matrix needs no whole page
_BAR, _BAR_LENGTH = 0.13, 2.0
_LETTER = 0.58  # mean width of a letter, in units of the font's size
_SMALLEST = 4.5  # points; a value smaller than this is left out
_STRONG = 0.9  # written bold


def plot_correlation(fit: FitResult, names: Sequence[str] | None = None) -> tuple[Figure, dict[str, Axes]]:
    """Plot the lower triangle of the correlation matrix of the estimates, from ``fit.covariance``.

    names  the parameters to show, in this order; None: all of the model that were estimated, without those of the
           noise.

    Values are written where cells have room for them, bold from 0.9 on: the data hardly distinguish such parameters.
    What is fixed or at a bound has no correlation and is left out.

    Returns the figure and the axes by ``"correlation"`` and ``"scale"``. Raises UnknownName for a parameter that is
    not there, DataError for one that was not estimated, or where fewer than two were.
    """
    from matplotlib import pyplot as plt
    from matplotlib import rc_context

    every, matrix = list(fit.parameters), correlation_matrix(np.asarray(fit.covariance))
    shown = _chosen(fit, [name for name, own in zip(every, np.diag(matrix), strict=True) if np.isfinite(own)], names)
    order = [every.index(name) for name in shown]
    matrix = matrix[np.ix_(order, order)]
    n = len(shown)
    below = max(map(len, shown[:-1])) * 7.0 * _LETTER / 72.0
    left = 0.2 + max(map(len, shown)) * 7.0 * _LETTER / 72.0
    cell = min(_CELL, (WIDTH - left - _RIGHT) / (n - 1))
    side = cell * (n - 1)
    width = WIDTH if left + side > _NARROW - 0.5 else _NARROW
    height = max(side + below, 0.9) + _TOP + _BOTTOM
    with rc_context(STYLE):
        figure = plt.figure(figsize=(width, height))
        bottom = (height - _TOP - side) / height
        axis = figure.add_axes((left / width, bottom, side / width, side / height))
        image = _draw(axis, matrix, shown, 72.0 * cell)
        # In the corner that the triangle leaves free.
        length = min(_BAR_LENGTH, 0.7 * (width - left))
        at = (width - _RIGHT - length - 0.1, height - _TOP - 0.12)
        scale = figure.add_axes((at[0] / width, at[1] / height, length / width, _BAR / height))
        figure.colorbar(image, cax=scale, orientation="horizontal", ticks=[-1, -0.5, 0, 0.5, 1])
        scale.tick_params(labelsize=6.5, length=2.0, pad=1.5)
        scale.set_xlabel("correlation", fontsize=7.0, labelpad=1.0)
        title = f"{fit.model.name}: correlation of the estimates"
        headline(figure, 0.1 / width, title)
    return figure, {"correlation": axis, "scale": scale}


def _chosen(fit: FitResult, known: Sequence[str], names: Sequence[str] | None) -> list[str]:
    if isinstance(names, str):
        raise DataError(f"plot_correlation: names='{names}' is text: give a list, such as names=['{names}']")
    if names is None:
        chosen = [name for name in known if name not in fit.noise_parameters]
    else:
        chosen = list(dict.fromkeys(names))
    for name in chosen:
        if name not in fit.parameters:
            raise UnknownName(f"plot_correlation: there is no parameter '{name}'.{listing(name, fit.parameters)}")
        if name not in known:
            why = fit.parameters[name].remark or "without a standard error"
            raise DataError(f"plot_correlation: '{name}' is {why}, so it has no correlation: leave it out")
    if len(chosen) < 2:
        raise DataError(f"plot_correlation: a correlation takes two estimates or more, and here is {len(chosen)}")
    return chosen


def _draw(axis: Axes, matrix: _Array, names: Sequence[str], cell: float) -> Any:
    """Draw the rows from the second name, the columns to the last but one; ``cell`` is their size in points."""
    n = len(names)
    lower = np.where(np.tril(np.ones((n - 1, n - 1), dtype=bool)), matrix[1:, :-1], np.nan)
    image = axis.imshow(lower, cmap="RdBu_r", vmin=-1.0, vmax=1.0, aspect="auto", interpolation="nearest")
    letters = min(7.0, 0.85 * cell)
    axis.set_xticks(range(n - 1), [plain(name) for name in names[:-1]], rotation=90, fontsize=letters)
    axis.set_yticks(range(n - 1), [plain(name) for name in names[1:]], fontsize=letters)
    axis.tick_params(length=0.0, pad=2.0)
    for spine in axis.spines.values():
        spine.set_visible(False)
    axis.set_xticks(np.arange(n) - 0.5, minor=True)
    axis.set_yticks(np.arange(n) - 0.5, minor=True)
    axis.grid(which="minor", color="white", linewidth=0.8)
    axis.tick_params(which="minor", length=0.0)
    size = min(7.0, 0.9 * cell / (4.2 * _LETTER))  # for as many letters as -.99 has
    if size < _SMALLEST:
        return image
    for row in range(n - 1):
        for column in range(row + 1):
            value = float(lower[row, column])
            axis.text(
                column,
                row,
                _two_digits(value),
                ha="center",
                va="center",
                fontsize=size,
                fontweight="bold" if abs(value) >= _STRONG else "normal",
                color="white" if abs(value) > 0.65 else "black",
            )
    return image


def _two_digits(value: float) -> str:
    """Return a correlation with two digits; ±1 stands for a value that rounds to it."""
    text = f"{abs(value):.2f}"
    if text == "0.00":
        return "0"
    return ("−" if value < 0.0 else "") + (text.lstrip("0") if text != "1.00" else "1")
