"""The marginal likelihood of a fit with process noise, at its estimate."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

import phugoid._core as _core

from ..data.experiment import Experiment
from ..errors import DataError, OptionError
from ..estimation.filter_variables import Objective, Separated
from ..filter_error import FilterError
from ..fit_result import ENDED_WELL, FitResult, dataset
from ..modelling.model import Model
from ..records import Record
from ..validation import ReEstimated

__all__ = ["Filtered", "check_ended", "elsewhere", "of_fit", "within"]

_Array: TypeAlias = NDArray[np.float64]

# Step of a parameter for differences of the outputs, in standard errors.
_PART = 0.1


class Filtered:
    """The likelihood of a model in experiments, with numbers for all that it depends on.

    names   of the model's parameters, the sigmas that are not known, and the intensities.
    values  of these, (n,).
    """

    def __init__(
        self,
        model: Model,
        experiments: Sequence[Experiment],
        options: FilterError,
        values: Mapping[str, float],
        known: Mapping[str, float],
        states: Sequence[_Array],
    ) -> None:
        """Take ``values`` by name, ``known`` sigmas by output, and the ``states`` of each experiment to start from,
        (n_x, N)."""
        self.model, self.experiments, self.options = model, list(experiments), options
        sigmas = [
            (name in known, known.get(name, values.get(f"sigma_{name}", math.nan)), 0.0, math.inf)
            for name in model.output_names
        ]
        self.problem: _core.Filter = options.problem(model, self.experiments, sigmas)
        self.names = tuple(self.problem.parameters)
        self.values = np.array([values[name] for name in self.names])
        self.path = self.problem.start(np.concatenate([x.T.ravel() for x in states]))

    def theta(self, values: _Array) -> _Array:
        """Return numbers as the core takes them: inverses of sigmas."""
        theta = values.copy()
        for i in range(len(self.model.parameter_names), theta.size - len(self.options.states)):
            theta[i] = 1.0 / theta[i]
        return theta

    def outputs(self, values: _Array) -> list[tuple[_Array, _Array]]:
        """Return the outputs of the smoothed path of each experiment, and their standard deviations for known numbers:
        each (n_y, N); [] where there is no path."""
        found = self.problem.smooth(self.theta(values), self.path)
        return [] if found is None else [pairs[1] for pairs, *_ in found]

    def errors(self, covariance: _Array, e: int) -> _Array:
        """Return (n_y, N) standard errors of the outputs in one experiment: those of the smoother, and those due to the
        errors of the numbers with this ``covariance`` (n, n), to first order. NaN where there is no path."""
        path = self.outputs(self.values)
        shape = (len(self.model.output_names), self.experiments[e].n)
        if not path:
            return np.full(shape, np.nan)
        slopes = np.zeros((self.values.size, *shape))
        for i, error in enumerate(np.sqrt(np.maximum(np.diag(covariance), 0.0))):
            if error > 0.0:
                slopes[i] = self._slope(i, _PART * error, e)
        variance = path[e][1] ** 2 + np.einsum("iyt,ij,jyt->yt", slopes, covariance, slopes)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    def _slope(self, i: int, size: float, e: int) -> _Array:
        """Return central differences of the outputs."""
        if i >= len(self.model.parameter_names):  # noise is positive
            size = min(size, 0.5 * abs(self.values[i]))
        ends = []
        for sign in (1, -1):
            there = self.values.copy()
            there[i] += sign * size
            ends.append(self.outputs(there))
        if not (ends[0] and ends[1]):
            return np.full((len(self.model.output_names), self.experiments[e].n), np.nan)
        return (ends[0][e][0] - ends[1][e][0]) / (2.0 * size)


def of_fit(fit: FitResult) -> tuple[Filtered, _Array]:
    """Return the likelihood of a fit, and the covariance of its numbers: 0 for those that are known or at a bound."""
    model, experiments, covariance = fit.model, list(dataset(fit)), np.nan_to_num(fit.covariance)
    states = [np.array([r.states[name] for name in model.state_names]) for r in fit.records]
    if len(experiments) > 1 and any(p.per_experiment for p in model.declared_parameters.values()):
        apart = Separated(model, experiments)
        model, experiments, fit = apart.model, apart.experiments, apart.fit(fit)
    options = fit.transcription
    assert isinstance(options, FilterError)
    known = fit.noise.known_sigmas(model.output_names)
    found = Filtered(model, experiments, options, fit.parameters.to_dict(), known, states)
    at = [list(fit.parameters).index(name) for name in found.names]
    return found, covariance[np.ix_(at, at)]


def within(fit: FitResult, e: int) -> dict[str, _Array]:
    """Return output -> (N,) standard errors of the outputs in an experiment of the fit."""
    likelihood, covariance = of_fit(fit)
    return dict(zip(fit.model.output_names, likelihood.errors(covariance, e), strict=True))


def elsewhere(
    fit: FitResult, other: Experiment, anew: ReEstimated, values: Mapping[str, float]
) -> tuple[Record, dict[str, _Array]]:
    """Return, for an experiment that the fit was not made on and whose states and biases were re-estimated, its record
    and the standard errors. Errors of biases follow from those of the parameters and from the new record."""
    found, free, held, _ = anew
    record, model, options = found.records[0], fit.model, found.transcription
    assert isinstance(options, FilterError)
    shared = {n: e.value for n, e in fit.parameters.items() if n in fit.noise_parameters}
    numbers = {**shared, **held, **{n.partition("[")[0]: e.value for n, e in found.parameters.items() if n in free}}
    known = fit.noise.known_sigmas(model.output_names)
    states = np.array([record.states[name] for name in model.state_names])
    likelihood = Filtered(model, [other], options, numbers, known, [states])

    own = np.array([i for i, n in enumerate(likelihood.names) if n in free], dtype=np.intp)
    given = [i for i, n in enumerate(likelihood.names) if n not in free and n in fit.parameters and n not in values]
    at = [list(fit.parameters).index(likelihood.names[i]) for i in given]
    covariance = np.zeros((likelihood.values.size,) * 2)
    covariance[np.ix_(given, given)] = np.nan_to_num(fit.covariance[np.ix_(at, at)])
    if own.size:
        _add_biases(likelihood, covariance, own)
    return record, dict(zip(model.output_names, likelihood.errors(covariance, 0), strict=True))


def check_ended(fit: FitResult) -> None:
    """Raise OptionError for a fit that has not converged."""
    if fit.status not in ENDED_WELL:
        raise OptionError(
            f"prediction_bands: the fit has not converged ({fit.status}): {fit.message or 'see its summary'}"
        )


def _add_biases(likelihood: Filtered, covariance: _Array, own: NDArray[np.intp]) -> None:
    """Add biases to a covariance: the best biases depend on the other numbers."""
    z = likelihood.values.copy()
    sigmas = slice(len(likelihood.model.parameter_names), z.size - len(likelihood.options.states))
    jacobian = np.ones(z.size)
    jacobian[sigmas] = 1.0 / z[sigmas]
    z[sigmas] = np.log(z[sigmas])
    infinite = np.full(z.size, np.inf)
    objective = Objective(
        likelihood.model, likelihood.problem, likelihood.path, (-infinite, infinite), len(likelihood.options.states)
    )
    samples = [int(np.isfinite(likelihood.experiments[0].output(n)).sum()) for n in likelihood.model.output_names]
    counts = samples[: objective.n_sigma]
    metric = objective.metric(z, counts, likelihood.experiments[0].n - 1)
    held = np.zeros(z.size, dtype=np.bool_)
    held[[i for i in range(z.size) if i not in own and covariance[i, i] == 0.0]] = True
    hessian = objective.hessian(z, metric, held)
    if hessian is None:
        raise DataError("prediction_bands: the likelihood of the new record ends too near to say how biases follow")
    hessian *= np.outer(jacobian, jacobian)
    own_inverse = np.linalg.inv(hessian[np.ix_(own, own)])
    slopes = -own_inverse @ hessian[own]
    slopes[:, own] = 0.0
    across = slopes @ covariance
    covariance[own] += across
    covariance[:, own] += across.T
    covariance[np.ix_(own, own)] += across @ slopes.T + own_inverse
