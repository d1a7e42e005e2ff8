"""Correlations of estimates, and directions in which the data determine the parameters weakly."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..errors import UnknownName, did_you_mean
from ..fit_result import FitResult
from ..notebook import bullets, notebook_page, table
from ..parameters import correlation_matrix, text_table

__all__ = ["Correlation", "WeakDirection", "correlation"]

_Array: TypeAlias = NDArray[np.float64]

# Pairs are named from this on (Klein & Morelli 2006, section 5.4).
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
        names = list(self.steps)
        listed = names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
        moves = ", ".join(f"{name} by {step:+.2g}" for name, step in self.steps.items())
        return (
            f"{listed} are hardly distinguishable: {moves} together is only one standard error (condition index "
            f"{self.index:.0f}); fix one of them, give it a prior, or fly a manoeuvre that moves them separately"
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
        note = f"{len(self.names)} parameters, {len(pairs)} pairs above {_STRONG:g}"
        weak = bullets(f"Weakly identified: {w}." for w in self.weak)
        return notebook_page("Correlation", table(["", "", "correlation"], pairs, "llr"), weak, note=note)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> _Array:
        return np.array(self.matrix, dtype=dtype)

    def __str__(self) -> str:
        return self.summary()

    def __repr__(self) -> str:
        return f"<Correlation of {len(self.names)} parameters: {len(self.pairs())} pairs above {_STRONG:g}>"


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
