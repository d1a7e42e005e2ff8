"""An information matrix, and what follows from it: standard errors, correlations, directions that are not told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..parameters import correlation_matrix

__all__ = ["Information", "WeakDirection"]

_Array = NDArray[np.float64]

# Of the correlation form, an eigenvalue below this is a direction that the data do not tell.
_SINGULAR = 1e-11
# Parts of a direction below this are not worth naming.
_PART = 0.1


@dataclass(frozen=True)
class WeakDirection:
    """A combination of parameters.

    parts      name -> share of the unit vector, each parameter in units of its size; those above 0.1.
    std_error  of a move along it, in these units; infinite where the manoeuvre does not tell it.
    """

    parts: dict[str, float]
    std_error: float

    def __str__(self) -> str:
        text = " ".join(f"{share:+.2f} {name}" for name, share in self.parts.items())
        return f"{text}: {'not told' if not np.isfinite(self.std_error) else f'± {100 * self.std_error:.3g} %'}"


@dataclass(frozen=True, eq=False)
class Information:
    """Fisher information about parameters.

    names   (n) of the parameters.
    matrix  (n, n), in the units of the parameters, inverse.
    """

    names: Sequence[str]
    matrix: _Array

    @cached_property
    def _directions(self) -> tuple[_Array, _Array, _Array]:
        """Scales (n,), eigenvalues of the matrix with a diagonal of ones, eigenvectors as columns."""
        scale = np.sqrt(np.diag(self.matrix))
        safe = np.where(scale > 0.0, scale, 1.0)
        values, vectors = np.linalg.eigh(self.matrix / np.outer(safe, safe))
        return safe, values, vectors

    @cached_property
    def covariance(self) -> _Array:
        """(n, n); infinite variance, and NaN beside it, for parameters that are not told (also in combinations)."""
        scale, values, vectors = self._directions
        told = values > _SINGULAR
        part = vectors[:, told]
        cov = (part / values[told]) @ part.T / np.outer(scale, scale)
        lost = (np.abs(vectors[:, ~told]) > 1e-4).any(axis=1)
        cov[lost], cov[:, lost] = np.nan, np.nan
        cov[lost, lost] = np.inf
        return np.asarray(cov)

    @property
    def std_errors(self) -> _Array:
        """(n,), infinite for what is not told."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> _Array:
        """(n, n), NaN for what is not told."""
        return correlation_matrix(self.covariance)

    def weak(self, sizes: _Array, n: int = 3) -> tuple[WeakDirection, ...]:
        """The directions that are told least, worst first, parameters in units of ``sizes`` (n,)."""
        values, vectors = np.linalg.eigh(self.matrix * np.outer(sizes, sizes))
        scale, eigen, own = self._directions
        found = []
        for column in own[:, eigen <= _SINGULAR].T:  # not told at all
            direction = column / scale / sizes
            found.append(self._named(direction / np.linalg.norm(direction), np.inf))
        for value, vector in list(zip(values, vectors.T, strict=True))[len(found) :][:n]:
            found.append(self._named(vector, float(1.0 / np.sqrt(value)) if value > 0.0 else np.inf))
        return tuple(found[:n])

    def _named(self, vector: _Array, error: float) -> WeakDirection:
        order = np.argsort(-np.abs(vector))
        vector = vector * np.sign(vector[order[0]])
        return WeakDirection({self.names[i]: float(vector[i]) for i in order if abs(vector[i]) > _PART}, error)

    def log_determinant(self) -> float:
        """Natural logarithm of the determinant; -inf where it is singular."""
        scale, values, _ = self._directions
        if not values.size or (values <= _SINGULAR).any():
            return -np.inf
        return float(np.log(values).sum() + 2.0 * np.log(scale).sum())
