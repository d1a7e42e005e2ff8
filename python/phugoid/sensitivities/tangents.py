"""What a fit can still move in, and how well the data hold it there: the information, exact, on the tangent space."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..errors import EvaluationError
from ..fit_result import FitResult
from .collocated import collocated_for
from .linearised import Linearised
from .scores import Scores

__all__ = ["Tangents"]

_Array: TypeAlias = NDArray[np.float64]

# Tangents whose singular value, in units of the noise, is below this part of the greatest are rounding.
_NOTHING = 1e-9
# Where variables tell of the space to less than this, others are taken.
_TOLD = 1e-5
# A variable is at a bound within this fraction of its size, as `make_fit` has it.
_AT_BOUND = 1e-6


class Tangents:
    """The space in which the estimates scatter: free parameters and first states, and unknowns of the noise.

    Coordinates c (k,) are such that the outputs change by ``basis`` c, in units of the noise; those of the noise stand
    behind.

    basis        (n_rows, k) orthonormal columns: rows as of `Linearised`.
    moves        (n_theta, k + j) changes of the variables, j those of the noise.
    inverse      (k + j, k + j) of the second derivatives of minus the log-likelihood, exact, with priors.
    priors       (k + j, k + j) the part that priors have in the second derivatives.
    """

    @classmethod
    def of(cls, fit: FitResult, caller: str) -> Tangents:
        """Those of a fit; one by shooting, or from a file, is estimated again by collocation, from where it is. Raises
        OptionError for one with process noise, or that has not come to an end."""
        return cls(Linearised(collocated_for(fit, caller)))

    def __init__(self, linear: Linearised) -> None:
        self.linear = linear
        self.scores = Scores(linear)
        problem = linear._problem
        columns, directions = linear.directions()
        if not columns.size or not np.isfinite(columns).all():
            raise EvaluationError("the outputs depend on nothing that is free, or not in a finite way")
        u, values, vt = np.linalg.svd(columns, full_matrices=False)
        kept = values > _NOTHING * values[:1]
        self.basis = u[:, kept]
        self.k = self.basis.shape[1]
        self._noise = self._free_noise()
        j = len(self._noise)
        changes = np.zeros((len(directions), self.k + j))
        changes[:, : self.k] = directions @ (vt[kept].T / values[kept])
        changes[self._noise, range(self.k, self.k + j)] = 1.0
        self.states = changes[problem.n_theta :]
        """(n_samples n_x, k + j) changes of the states at all samples, experiment by experiment."""
        self.moves = changes[: problem.n_theta]
        self.priors = self._priors()
        exact = self._exact()
        if exact is None:
            # Beside an optimum curvature may be negative; what data say on average never is.
            information = self.priors + np.eye(self.k + j)
            information[: self.k, : self.k] += self.basis.T @ self.scores.weighted(self.basis) - np.eye(self.k)
            exact = np.asarray(np.linalg.inv(information), dtype=np.float64)
        self.inverse: _Array = exact

    def _free_noise(self) -> list[int]:
        """Variables of the noise that are neither known nor at a bound."""
        problem = self.linear._problem
        lower, upper = problem.bounds()
        found = []
        for i in range(len(problem.estimands), problem.n_theta):
            v, near = self.linear._xi[i], _AT_BOUND * max(abs(self.linear._xi[i]), min(upper[i] - lower[i], 1.0))
            if lower[i] + near < v < upper[i] - near:
                found.append(i)
        return found

    def _exact(self, ends: tuple[int, ...] = (0,)) -> _Array | None:
        """From the covariance of variables that tell where in the space one is: parameters and first states. In an
        unstable motion first states alone hardly tell, so last ones take part; they take more time."""
        linear, problem = self.linear, self.linear._problem
        assert linear.inner.solution is not None
        n_theta, n_x, n = problem.n_theta, problem.n_states, len(problem.estimands)
        held = [i for i in linear._held() if i < n] + [i for i in range(n, n_theta) if i not in self._noise]
        wanted = [i for i in range(n_theta) if i not in held]
        rows = [self.moves[wanted]]
        first = 0
        for e, at in enumerate(linear.sample_points):
            points = problem.sample_points(e)
            for end in ends:
                sample = end % at.size
                variable = n_theta + n_x * (problem.first_point[e] + points[sample])
                wanted += range(variable, variable + n_x)
                rows.append(self.states[n_x * (first + sample) : n_x * (first + sample + 1)])
            first += at.size
        try:
            found = _core.information(problem, linear._xi, linear.inner.solution.multipliers, wanted, held)
        except EvaluationError:
            return None
        if found[3] or not np.isfinite(found[0]).all():
            return None
        covariance, which = found[0], np.vstack(rows)
        size = np.sqrt(np.abs(np.diag(covariance)))
        there = size > 0.0  # conditions leave some states where they are
        u, values, vt = np.linalg.svd(which[there] / size[there, None], full_matrices=False)
        if values.size < which.shape[1] or values[-1] < _TOLD * values[0]:
            return self._exact((0, -1)) if ends == (0,) else None
        back = vt.T / values @ u.T
        inverse = back @ (covariance[np.ix_(there, there)] / np.outer(size[there], size[there])) @ back.T
        inverse = 0.5 * (inverse + inverse.T)
        return np.asarray(inverse) if np.linalg.eigvalsh(inverse)[0] > 0.0 else None

    def _priors(self) -> _Array:
        declared = list(self.linear.model.declared_parameters.values())
        weights = np.zeros(len(self.moves))
        for i, (_, p, _) in enumerate(self.linear._problem.estimands):
            prior = declared[p].prior
            if prior is not None:
                weights[i] = (self.slopes[i] / prior[1]) ** 2
        return np.asarray(self.moves.T @ (weights[:, None] * self.moves))

    @property
    def slopes(self) -> _Array:
        """(n,) of the model's parameters by the variables that the solver sees: 1 but for logarithms and scales."""
        problem = self.linear._problem
        n = len(problem.estimands)
        return np.array([slope for _, slope in problem.values(self.linear._xi[:n].tolist())])

    @property
    def names(self) -> list[str]:
        """Of the model's parameters, as estimated."""
        return [name for name, *_ in self.linear._problem.estimands]

    def of_parameters(self, coordinates: _Array) -> _Array:
        """(n, n) covariance of the model's parameters from that of the coordinates (k + j, k + j)."""
        root = self.slopes[:, None] * self.moves[: len(self.slopes)]
        return np.asarray(root @ coordinates @ root.T)

    def outputs(self) -> list[_Array]:
        """For each experiment (n_y, N, k + j) changes of the outputs at all samples, measured or not."""
        by_state, by_variable, _ = self.linear._derivatives
        states = self.states.reshape(len(by_state), -1, self.states.shape[1])
        changes = (by_state @ states + by_variable @ self.moves).transpose(1, 0, 2)
        ends = np.cumsum([at.size for at in self.linear.sample_points])[:-1]
        return np.split(changes, ends, axis=1)
