"""What bands about the outputs of a fit with process noise are made of.

The most probable path follows the measurements, so the model's outputs scatter about the true ones by what the smoother
leaves open for parameters known, and by what the errors of the parameters do to the path: both together, as J. D.
Hamilton, *A standard error for the estimated state vector of a state-space model* (J. Econometrics 33, 1986).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..data.experiment import Experiment
from ..errors import DataError, OptionError
from ..fit_result import FitResult
from ..process_noise.variables import Objective
from ..records import Record
from ..transcription.filter_error import FilterError
from ..validation.validate import found_anew
from .filtered import Filtered, of_fit

__all__ = ["elsewhere", "within"]

_Array: TypeAlias = NDArray[np.float64]


def within(fit: FitResult, e: int) -> dict[str, _Array]:
    """Output -> (N,) standard errors of the outputs in an experiment of the fit."""
    _ended(fit)
    likelihood, covariance = of_fit(fit)
    return dict(zip(fit.model.output_names, likelihood.errors(covariance, e), strict=True))


def elsewhere(
    fit: FitResult, other: Experiment, biases: Sequence[str] | None, values: Mapping[str, float]
) -> tuple[Record, dict[str, _Array], FitResult]:
    """Of an experiment that the fit was not made on: its record, the standard errors, and the fit of what was found
    anew there. Biases follow the parameters, and have the errors that the new record leaves them."""
    _ended(fit)
    found, free, held, _ = found_anew(fit, [other], biases, values)
    if not found.converged:
        raise DataError(
            f"prediction_bands: initial states and biases of '{other.name}' were not found ({found.status}): "
            f"{found.message}"
        )
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
        _follow(likelihood, covariance, own)
    return record, dict(zip(model.output_names, likelihood.errors(covariance, 0), strict=True)), found


def _ended(fit: FitResult) -> None:
    if fit.status not in ("converged", "acceptable"):
        raise OptionError(
            f"prediction_bands: the fit has not converged ({fit.status}): {fit.message or 'see its summary'}"
        )


def _follow(likelihood: Filtered, covariance: _Array, own: NDArray[np.intp]) -> None:
    """Puts biases into a covariance: each set of the other numbers has its own best biases."""
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
