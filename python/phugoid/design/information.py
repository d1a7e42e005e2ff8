"""Fisher information about parameters: covariance, correlation, and the directions that are determined least."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..parameters import correlation_matrix

__all__ = ["Information", "ParameterDirection"]

_Array = NDArray[np.float64]

# An eigenvalue of the correlation form below this belongs to a direction that the data do not determine.
_SINGULAR = 1e-11
# Parts of a direction below this are not worth naming.
_PART = 0.1


@dataclass(frozen=True)
class ParameterDirection:
    """A combination of parameters.

    parts      name -> share of the unit vector, each parameter in units of its size; those above 0.1.
    std_error  of a move along it, in these units; infinite where the manoeuvre does not determine it.
    """

    parts: dict[str, float]
    std_error: float

    def __str__(self) -> str:
        text = " ".join(f"{share:+.2f} {name}" for name, share in self.parts.items())
        return f"{text}: {'not determined' if not np.isfinite(self.std_error) else f'± {100 * self.std_error:.3g} %'}"


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
        """(n, n); infinite variance, and NaN beside it, for parameters that are not determined (also in
        combinations)."""
        scale, values, vectors = self._directions
        determined = values > _SINGULAR
        part = vectors[:, determined]
        cov = (part / values[determined]) @ part.T / np.outer(scale, scale)
        lost = (np.abs(vectors[:, ~determined]) > 1e-4).any(axis=1)
        cov[lost], cov[:, lost] = np.nan, np.nan
        cov[lost, lost] = np.inf
        return np.asarray(cov)

    @property
    def std_errors(self) -> _Array:
        """(n,) standard errors; infinite for parameters that are not determined."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> _Array:
        """(n, n) correlations; NaN for parameters that are not determined."""
        return correlation_matrix(self.covariance)

    def weak(self, sizes: _Array, n: int = 3) -> tuple[ParameterDirection, ...]:
        """Return the directions that are determined least, worst first, parameters in units of ``sizes`` (n,)."""
        values, vectors = np.linalg.eigh(self.matrix * np.outer(sizes, sizes))
        scale, eigen, own = self._directions
        found = []
        for column in own[:, eigen <= _SINGULAR].T:  # not determined at all
            direction = column / scale / sizes
            found.append(self._named(direction / np.linalg.norm(direction), np.inf))
        for value, vector in list(zip(values, vectors.T, strict=True))[len(found) :][:n]:
            found.append(self._named(vector, float(1.0 / np.sqrt(value)) if value > 0.0 else np.inf))
        return tuple(found[:n])

    def _named(self, vector: _Array, error: float) -> ParameterDirection:
        order = np.argsort(-np.abs(vector))
        vector = vector * np.sign(vector[order[0]])
        return ParameterDirection({self.names[i]: float(vector[i]) for i in order if abs(vector[i]) > _PART}, error)

    def log_determinant(self) -> float:
        """Return the natural logarithm of the determinant; -inf where the matrix is singular."""
        scale, values, _ = self._directions
        if not values.size or (values <= _SINGULAR).any():
            return -np.inf
        return float(np.log(values).sum() + 2.0 * np.log(scale).sum())
