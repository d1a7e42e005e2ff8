"""Correlations of estimates, directions in which the data determine the parameters weakly, and their heat map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, UnknownName, counted, did_you_mean, joined, listing
from ..figures import WIDTH, Panels, headline, plain, styled
from ..fit_result import FitResult
from ..notebook import bullets, notebook_page, table
from ..parameters import correlation_matrix, text_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Correlation", "WeakDirection", "correlation", "plot_correlation"]


_Array: TypeAlias = NDArray[np.float64]

# Pairs are named, and written bold, from this on (Klein & Morelli 2006, section 5.4).
_STRONG = 0.9
# Collinear from this condition index on (Belsley, Kuh & Welsch 1980), and reported where one standard error is this
# part of a value.
_INDEX, _LARGE = 30.0, 0.1
# Parts of a direction below this, of the greatest, are not named.
_PART = 0.2


@dataclass(frozen=True)
class WeakDirection:
    """A combination of parameters that the data determine less well than each of them alone.

    steps      name -> change by one standard error along the direction; the greatest parts only.
    index      condition index: by how much less well than the best one (Belsley, Kuh & Welsch 1980).
    """

    steps: Mapping[str, float]
    index: float

    def __str__(self) -> str:
        moves = ", ".join(f"{name} by {step:+.2g}" for name, step in self.steps.items())
        return (
            f"{joined(list(self.steps))} are hardly distinguishable: {moves} together is only one standard error "
            f"(condition index {self.index:.0f}); fix one of them, give it a prior, or fly a manoeuvre that moves them "
            "separately"
        )


@dataclass(frozen=True, eq=False, repr=False)
class Correlation:
    """Correlations of a fit's estimates; ``correlation["Cm0", "Cma"]`` is that of a pair.

    names   of the parameters, in the order of the fit.
    matrix  (n, n); NaN where a parameter has no standard error: fixed, at a bound, not identifiable.
    weak    directions in which the data hardly determine the model's parameters; none where data are good.
    """

    names: tuple[str, ...]
    matrix: _Array
    weak: tuple[WeakDirection, ...] = ()

    def __getitem__(self, pair: tuple[str, str]) -> float:
        for name in pair:
            if name not in self.names:
                raise UnknownName(f"there is no parameter '{name}'.{did_you_mean(str(name), self.names)}")
        i, j = (self.names.index(name) for name in pair)
        return float(self.matrix[i, j])

    def pairs(self, above: float = _STRONG) -> list[tuple[str, str, float]]:
        """Return pairs of parameters with a correlation of at least this size, the strongest first."""
        found = [
            (self.names[i], self.names[j], float(self.matrix[i, j]))
            for i in range(len(self.names))
            for j in range(i + 1, len(self.names))
            if abs(self.matrix[i, j]) > above
        ]
        return sorted(found, key=lambda pair: -abs(pair[2]))

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """Remarks on strong correlations and weak directions, in words."""
        said = []
        pairs = self.pairs()
        if pairs:
            shown = ", ".join(f"{a} and {b} {rho:+.3f}" for a, b, rho in pairs[:_SHOWN])
            more = f", and {len(pairs) - _SHOWN} more pairs" if len(pairs) > _SHOWN else ""
            said.append(f"Correlated above {_STRONG:g}: {shown}{more}.")
        return (*said, *(f"Weakly identified: {w}." for w in self.weak))

    def summary(self) -> str:
        """Return the matrix as a table, and the remarks."""
        rows = [
            [name, *("" if not np.isfinite(v) else f"{v:+.2f}" for v in line[: i + 1])]
            + [""] * (len(self.names) - i - 1)
            for i, (name, line) in enumerate(zip(self.names, self.matrix, strict=True))
        ]
        table = text_table(["", *self.names], rows, "l" + "r" * len(self.names))
        return "\n\n".join([table, *self.notes])

    def _repr_html_(self) -> str:
        pairs = [[a, b, f"{rho:+.3f}"] for a, b, rho in self.pairs()]
        note = f"{counted(len(self.names), 'parameter')}, {counted(len(pairs), 'pair')} above {_STRONG:g}"
        weak = bullets(f"Weakly identified: {w}." for w in self.weak)
        return notebook_page("Correlation", table(["", "", "correlation"], pairs, "ssr"), weak, note=note)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> _Array:
        return np.array(self.matrix, dtype=dtype)

    def __str__(self) -> str:
        return self.summary()

    def __repr__(self) -> str:
        pairs = counted(len(self.pairs()), "pair")
        return f"<Correlation of {counted(len(self.names), 'parameter')}: {pairs} above {_STRONG:g}>"


_SHOWN = 5


def correlation(fit: FitResult) -> Correlation:
    """Return the correlations of a fit's estimates; weak directions are looked for among parameters of the model."""
    names, noise, matrix = list(fit.parameters), fit.noise_parameters, correlation_matrix(fit.covariance)
    known = [i for i, name in enumerate(names) if name not in noise and np.isfinite(matrix[i, i])]
    values, deviation = fit.parameters.values_array[known], np.sqrt(np.diag(fit.covariance)[known])
    weak = _weak([names[i] for i in known], values, deviation, matrix[np.ix_(known, known)])
    return Correlation(tuple(names), matrix, tuple(weak))


def _weak(names: Sequence[str], values: _Array, deviation: _Array, correlation: _Array) -> list[WeakDirection]:
    """Return directions of small information, each parameter in units of its error if all others were known."""
    if len(names) < 2 or not np.isfinite(correlation).all():
        return []
    eigenvalues = np.linalg.eigvalsh(correlation)
    if eigenvalues[0] <= 1e-12 * eigenvalues[-1]:
        return []  # singular: the fit says which are confounded
    information = np.linalg.inv(correlation)
    alone = 1.0 / np.sqrt(np.diag(information))
    sizes, vectors = np.linalg.eigh(information * np.outer(alone, alone))
    found = []
    for size, vector in zip(sizes, vectors.T, strict=True):
        index = float(np.sqrt(sizes[-1] / size))
        if index < _INDEX:
            break
        steps = vector * alone * deviation / np.sqrt(size)
        kept = np.flatnonzero(np.abs(vector) > _PART * np.abs(vector).max()).tolist()
        if len(kept) < 2 or not np.any(np.abs(steps[kept]) > _LARGE * np.abs(values[kept])):
            continue
        steps = steps * np.sign(steps[kept[0]])
        found.append(WeakDirection({names[i]: float(steps[i]) for i in kept}, index))
    return found


# Inches: the margins, the largest cell, and the bar of colours with its gap.
_RIGHT, _TOP, _BOTTOM, _CELL = 0.12, 0.34, 0.12, 0.55
_NARROW = 4.6  # a small matrix needs no whole page
_BAR, _BAR_LENGTH = 0.13, 2.0
_LETTER = 0.58  # mean width of a letter, in units of the font's size
_SMALLEST = 4.5  # points; a value smaller than this is left out


def plot_correlation(fit: FitResult, names: Sequence[str] | None = None) -> tuple[Figure, dict[str, Axes]]:
    """Plot the lower triangle of the correlation matrix of the estimates, from ``fit.covariance``.

    names  the parameters to show, in this order; None: all of the model that were estimated, without those of the
           noise.

    Values are written where cells have room for them, bold from 0.9 on: the data hardly distinguish such parameters.
    What is fixed or at a bound has no correlation and is left out.

    Returns the figure and the axes by ``"correlation"`` and ``"scale"``. Raises UnknownName for a parameter that is
    not there, DataError for one that was not estimated, or where fewer than two were.
    """
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
    with styled() as plt:
        figure = plt.figure(figsize=(width, height))
        bottom = (height - _TOP - side) / height
        axis = figure.add_axes((left / width, bottom, side / width, side / height))
        cells = _draw(axis, matrix, shown, 72.0 * cell)
        # In the corner that the triangle leaves free.
        length = min(_BAR_LENGTH, 0.7 * (width - left))
        at = (width - _RIGHT - length - 0.1, height - _TOP - 0.12)
        scale = figure.add_axes((at[0] / width, at[1] / height, length / width, _BAR / height))
        figure.colorbar(cells, cax=scale, orientation="horizontal", ticks=[-1, -0.5, 0, 0.5, 1])
        scale.tick_params(labelsize=6.5, length=2.0, pad=1.5)
        scale.set_xlabel("correlation", fontsize=7.0, labelpad=1.0)
        title = f"{fit.model.name}: correlation of the estimates"
        headline(figure, 0.1 / width, title)
    return figure, Panels({"correlation": axis, "scale": scale})


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
    edges = np.arange(n) - 0.5
    # As rectangles: in an image a colour would be looked up for each pixel.
    cells = axis.pcolormesh(edges, edges, lower, cmap="RdBu_r", vmin=-1.0, vmax=1.0, edgecolors="white", linewidth=0.5)
    axis.set_ylim(n - 1.5, -0.5)
    letters = min(7.0, 0.85 * cell)
    axis.set_xticks(range(n - 1), [plain(name) for name in names[:-1]], rotation=90, fontsize=letters)
    axis.set_yticks(range(n - 1), [plain(name) for name in names[1:]], fontsize=letters)
    axis.tick_params(length=0.0, pad=2.0)
    for spine in axis.spines.values():
        spine.set_visible(False)
    size = min(7.0, 0.9 * cell / (4.2 * _LETTER))  # for as many letters as -.99 has
    if size < _SMALLEST:
        return cells
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
    return cells


def _two_digits(value: float) -> str:
    """Return a correlation with two digits; ±1 stands for a value that rounds to it."""
    text = f"{abs(value):.2f}"
    if text == "0.00":
        return "0"
    return ("−" if value < 0.0 else "") + (text.lstrip("0") if text != "1.00" else "1")
