"""Fits by collocation, and the exact information on the tangent space of their constraints."""

from __future__ import annotations

import math
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

import phugoid._core as _core

from .._core import Expr
from ..errors import EvaluationError, OptionError
from ..estimation import estimate
from ..filter_error import FilterError
from ..fit_result import ENDED_WELL, FitResult, dataset
from ..modelling.densities import Density, Huber, Laplace, PerExperiment, PerOutput, StudentT
from ..modelling.noise import Gaussian, Noise
from ..transcription import Collocation
from .linearised import Linearised

__all__ = ["Scores", "Tangents", "cheap", "collocated", "collocated_for", "noise_values", "parameter_sensitivities"]

# Numbers in tangents that take about as long as an estimation, and that fill some 400 MB.
_SOME, _MANY = 3_000_000, 50_000_000
# Elsewhere curvature says nothing about the data.
_ENDS = (*ENDED_WELL, "unidentifiable")


def collocated(fit: FitResult) -> FitResult:
    """Return the fit by collocation with its solution: re-estimated from the given fit where that is another."""
    inner = fit._moved or fit
    if isinstance(inner.transcription, Collocation) and inner.solution is not None:
        return fit
    return estimate(fit.model, dataset(fit), noise=fit.noise, start=fit)


def cheap(fit: FitResult, again: bool = False) -> bool:
    """Return whether a fit can be linearised in about the time of an estimation, and without an estimation unless
    ``again``: the tangents of large systems are large."""
    inner = fit._moved or fit
    at_hand = bool(fit.experiments) and isinstance(inner.transcription, Collocation) and inner.solution is not None
    samples, n_x = sum(r.n for r in fit.records), len(fit.model.state_names)
    columns = len(fit.parameters) + 2 * n_x * len(fit.records)
    small = samples * (n_x + len(fit.model.output_names)) * columns <= (_MANY if again else _SOME)
    return small and (at_hand or again)


def collocated_for(fit: FitResult, caller: str) -> FitResult:
    """Return the fit by collocation, for a caller that linearises it.

    Raises OptionError for a fit with process noise, and for one that has not converged.
    """
    if isinstance(fit.transcription, FilterError):
        raise OptionError(
            f"{caller}: is not offered for fits with process noise (FilterError): their innovations are white where "
            "the model is right, and their standard errors need no correction"
        )
    if fit.status not in _ENDS:
        raise OptionError(f"{caller}: the fit has not converged ({fit.status}): {fit.message or 'see its summary'}")
    return collocated(fit)


_Array: TypeAlias = NDArray[np.float64]

# Tangents whose singular value, in units of the noise, is below this part of the greatest are rounding.
_NOTHING = 1e-9
# Where variables determine the space to less than this, others are taken.
_TOLD = 1e-5
# A variable is at a bound within this fraction of its size, as `make_fit` has it.
_AT_BOUND = 1e-6


class Tangents:
    """The space in which the estimates scatter: free parameters and initial states, and unknowns of the noise.

    Coordinates c (k,) are such that the outputs change by ``basis`` c, in units of the noise; those of the noise stand
    behind.

    basis        (n_rows, k) orthonormal columns: rows as of `Linearised`.
    moves        (n_theta, k + j) changes of the variables, j those of the noise.
    inverse      (k + j, k + j) of the second derivatives of minus the log-likelihood, exact, with priors.
    priors       (k + j, k + j) the part that priors have in the second derivatives.
    """

    @classmethod
    def of(cls, fit: FitResult, caller: str) -> Tangents:
        """Return the tangents of a fit. A fit by shooting, or from a file, is first re-estimated by collocation.

        Raises OptionError for a fit with process noise, and for one that has not converged.
        """
        return cls(Linearised(collocated_for(fit, caller)))

    def __init__(self, linear: Linearised) -> None:
        self.linear = linear
        self.scores = Scores(linear)
        problem = linear._problem
        columns, directions = linear.directions()
        if not columns.size or not np.isfinite(columns).all():
            raise EvaluationError("no free parameter or initial state has a finite effect on the outputs")
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
        """Compute the tangents from the covariance of variables that determine a point of the space: parameters and
        initial states.

        In an unstable motion initial states alone hardly determine it, so the last states are added; that takes longer.
        """
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
        """Return those of the model's parameters, as estimated."""
        return [name for name, *_ in self.linear._problem.estimands]

    def of_parameters(self, coordinates: _Array) -> _Array:
        """Return the covariance (n, n) of the model's parameters from that of the coordinates (k + j, k + j)."""
        root = self.slopes[:, None] * self.moves[: len(self.slopes)]
        return np.asarray(root @ coordinates @ root.T)

    def outputs(self) -> list[_Array]:
        """Return for each experiment the changes of the outputs at all samples, measured or not, (n_y, N, k + j)."""
        by_state, by_variable, _ = self.linear._derivatives
        states = self.states.reshape(len(by_state), -1, self.states.shape[1])
        changes = (by_state @ states + by_variable @ self.moves).transpose(1, 0, 2)
        ends = np.cumsum([at.size for at in self.linear.sample_points])[:-1]
        return np.split(changes, ends, axis=1)


def parameter_sensitivities(linear: Linearised) -> tuple[list[str], _Array]:
    """Names of the free parameters (n) and J (rows, n): changes of the outputs by them, in units of the noise, less
    what initial states could make up for.

    In a form that has an answer where the information is singular too:

        J = (1 - Q Q') D P^+,    information = J' J,

    with D (rows, k) changes of the outputs in units of the noise, P (n, k) the changes of the parameters that go with
    them, and Q a basis of those changes that initial states make alone.
    """
    columns, moves = linear.moves
    names = [name for name, *_ in linear._problem.estimands]
    free = np.flatnonzero([not (p.fixed or p.bounds_active) for p in (linear.fit.parameters[n] for n in names)])
    slopes = np.array([slope for _, slope in linear._problem.values(linear._xi[: len(names)].tolist())])
    by_parameter = (slopes[:, None] * moves[: len(names)])[free]  # of the parameter, not of its logarithm
    inverse, basis = linear.beside_states(by_parameter)
    return [names[i] for i in free], np.asarray((columns - basis @ (basis.T @ columns)) @ inverse)


def noise_values(fit: FitResult, experiment: str) -> dict[str, float]:
    """Return the numbers of a fit's noise as they are in an experiment: ``sigma_<output>``, ..."""
    found = {}
    for name in fit.noise_parameters:
        base, _, own = name.partition("[")
        if not own or own[:-1] == experiment:
            found[base] = fit.parameters[name].value
    return found


class Scores:
    """Scores of a linearised fit's rows, in units of its noise.

    values   (n_rows,) scale times the derivative of the log-density by the output: of independent Gaussian noise the
             residual over its standard deviation.
    """

    def __init__(self, linear: Linearised) -> None:
        self.linear = linear
        self._noise = linear.inner.noise
        self._scale = linear.scale()
        self._numbers = [noise_values(linear.inner, e.name) for e in linear.experiments]
        self._joint: list[tuple[NDArray[np.intp], _Array]] = []  # rows (times, outputs) and their weights
        self._curvature = np.ones(linear.n_rows)
        noise = self._noise.noise if isinstance(self._noise, PerExperiment) else self._noise
        if isinstance(noise, Gaussian) and (noise.correlated or noise.covariance is not None):
            self._jointly(noise)
            self.values = self.weighted(linear.residuals[:, None] / self._scale[:, None])[:, 0]
        else:
            self.values = np.empty(linear.n_rows)
            self._each(noise)

    @property
    def own(self) -> bool:
        """Return whether each experiment has noise of its own size."""
        return isinstance(self._noise, PerExperiment) and len(self.linear.experiments) > 1

    @property
    def gaussian(self) -> bool:
        """Return whether the noise is Gaussian."""
        noise = self._noise.noise if isinstance(self._noise, PerExperiment) else self._noise
        kinds = list(noise.outputs.values()) if isinstance(noise, PerOutput) else [noise]
        return all(isinstance(kind, Gaussian) for kind in kinds)

    def weighted(self, columns: _Array) -> _Array:
        """Return by how much scores fall where the outputs change by columns (n_rows, k), in units of the noise."""
        if not self._joint:
            return np.asarray(self._curvature[:, None] * columns)
        out = np.zeros_like(columns)
        for rows, weight in self._joint:
            out[rows] = np.einsum("ij,tjk->tik", weight, columns[rows])
        return out

    def _jointly(self, noise: Gaussian) -> None:
        """Return the weights of correlated noise: inverses of its covariance, for the outputs that are measured."""
        linear = self.linear
        outputs = linear.model.output_names
        first = np.concatenate([np.full(r.stop - r.start, e) for line in linear.rows for e, r in enumerate(line)])
        for e in range(len(linear.experiments)):
            covariance = noise.matrix(outputs, self._numbers[e])
            for which, at in linear.structure.together:
                mine = at[first[at[:, 0]] == e]
                sizes = self._scale[[linear.rows[i][e].start for i in which]] if mine.size else np.empty(0)
                if mine.size:
                    inverse = np.linalg.inv(covariance[np.ix_(which, which)])
                    self._joint.append((mine, inverse * np.outer(sizes, sizes)))

    def _each(self, noise: Noise) -> None:
        """Return the weights of independent noise, output by output."""
        linear = self.linear
        for i, name in enumerate(linear.model.output_names):
            kind = noise.of(name) if isinstance(noise, PerOutput) else noise
            known = noise.known_sigmas(linear.model.output_names)
            for e, rows in enumerate(linear.rows[i]):
                if name in noise.expressions:
                    sigma = float(linear.sigmas[i])
                else:
                    sigma = known[name] if name in known else self._numbers[e][f"sigma_{name}"]
                r, scale = linear.residuals[rows] / sigma, self._scale[rows] / sigma
                psi, slope = self._influence(kind, name, e, r, sigma)
                self.values[rows], self._curvature[rows] = scale * psi, scale**2 * slope

    def _influence(self, kind: Noise, output: str, e: int, r: _Array, sigma: float) -> tuple[_Array, _Array]:
        """Minus the first and second derivative of the log-density by residuals in units of sigma."""
        if isinstance(kind, StudentT):
            known = kind._dof(output)
            dof = self._numbers[e][f"dof_{output}"] if known is None else known
            below = dof + r**2
            return (dof + 1) * r / below, (dof + 1) * (dof - r**2) / below**2
        if isinstance(kind, Huber):
            return np.clip(r, -kind.k, kind.k), (np.abs(r) <= kind.k).astype(np.float64)
        if isinstance(kind, Laplace):
            size = np.sqrt(r**2 + kind.smoothing**2)
            return r / size, kind.smoothing**2 / size**3
        if isinstance(kind, Density):
            return self._custom(kind, output, e, r, sigma)
        return r, np.ones_like(r)

    def _custom(self, kind: Density, output: str, e: int, r: _Array, sigma: float) -> tuple[_Array, _Array]:
        numbers: dict[str, Any] = {"sigma": sigma}
        for name, p in kind.parameters.items():
            fixed = float(getattr(p, "start", math.nan))
            numbers[name] = self._numbers[e][f"{name}_{output}"] if name in kind._free() else fixed
        first = Expr(kind.log_density).diff("residual")

        def at(e: Expr) -> _Array:
            known = {n: numbers[n] for n in e.symbols if n != "residual"}
            return np.array([e.evaluate({**known, **({"residual": v} if "residual" in e.symbols else {})}) for v in z])

        z = (r * sigma).tolist()
        return -sigma * at(first), -(sigma**2) * at(Expr(first).diff("residual"))
