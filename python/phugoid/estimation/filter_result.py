"""The result of the filter-error method as a `FitResult`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

import phugoid._core as _core

from ..data.experiment import Experiment
from ..filter_error import FilterError
from ..fit_result import FitResult
from ..modelling.model import Model
from ..modelling.noise import Noise
from ..parameters import Estimate, Estimates
from ..records import Record, record_of, repeated_outputs
from ..solvers import HINTS
from ..solvers.newton import Minimum
from ..solvers.solution import Deadline
from ..transcription import records_of
from .filter_variables import Objective

__all__ = ["make_filter_fit"]

_Array = NDArray[np.float64]

# An intensity this small a part of its standard error is none.
_NONE = 0.05


def make_filter_fit(
    model: Model,
    experiments: Sequence[Experiment],
    noise: Noise,
    options: FilterError,
    objective: Objective,
    end: Minimum,
    hessian: _Array | None,
    seconds: float,
) -> FitResult:
    """Return the fit at a maximum of the marginal likelihood.

    Standard errors are from the curvature there (``hessian``, of minus the likelihood in the variables of
    `Objective`); those of first states add to the smoother's variance what the parameters' uncertainty brings.
    """
    z, names = end.x, objective.problem.parameters
    lower, upper = objective.bounds
    sides: list[Literal["lower", "upper"] | None] = [
        None if lo == up else "lower" if v <= lo else "upper" if v >= up else None
        for v, lo, up in zip(z, lower, upper, strict=True)
    ]
    fixed = lower == upper
    warnings: list[str] = []
    status = end.status
    covariance = np.full((z.size, z.size), np.nan)
    free = np.flatnonzero([not f and s is None for f, s in zip(fixed, sides, strict=True)])
    stopped = status in ("interrupted", "time limit")
    if objective.best is None:
        warnings.append(
            "time limit: nothing was evaluated; the states are those of the start and do not satisfy the equations: "
            "there is no log-likelihood and no standard error"
        )
    elif hessian is None and stopped:
        warnings.append(f"{status}: there are no standard errors; go on with start=fit")
    elif hessian is None:
        warnings.append("there are no standard errors: the curvature of the likelihood was not computed")
    else:
        status = _invert(hessian, free, names, covariance, warnings, status)

    values = z.copy()
    values[objective.sigmas] = np.exp(z[objective.sigmas])
    values[objective.intensities] = np.abs(z[objective.intensities])
    slope = np.ones(z.size)
    slope[objective.sigmas] = values[objective.sigmas]
    slope[objective.intensities] = np.where(z[objective.intensities] < 0, -1.0, 1.0)
    covariance *= np.outer(slope, slope)
    with np.errstate(invalid="ignore"):
        errors = np.sqrt(np.diag(covariance))
    declared = list(model.declared_parameters.items())
    estimates = [
        Estimate(n, values[i], errors[i], p.unit, p.start, p.bounds, p.fixed, sides[i])
        for i, (n, p) in enumerate(declared)
    ]
    units = model.units
    for i in range(len(declared), z.size):
        name = names[i]
        if i in range(z.size)[objective.sigmas]:
            bounds = (float(np.exp(lower[i])), float(np.exp(upper[i])))
            unit = units.get(name.removeprefix("sigma_"), "")
            if sides[i] == "lower":
                warnings.append(f"{name} sits at its lower bound {values[i]:.3g}: this output is fitted exactly")
            estimates.append(Estimate(name, values[i], errors[i], unit, bounds=bounds, bounds_active=sides[i]))
            continue
        state = name.removeprefix("q_")
        unit = f"{units[state]}/√s" if state in units else ""
        if fixed[i]:
            estimates.append(Estimate(name, values[i], errors[i], unit, values[i], (0.0, np.inf), fixed=True))
            continue
        none = bool(values[i] < _NONE * errors[i])
        if none:
            warnings.append(
                f"{name} is 0: the data show no process noise in {state} (its standard error there is {errors[i]:.2g})"
            )
        active: Literal["lower"] | None = "lower" if none else None
        estimates.append(Estimate(name, values[i], errors[i], unit, bounds=(0.0, np.inf), bounds_active=active))

    warnings += _core.gap_warnings(model.input_names, records_of(model, experiments))
    smoothed, missing = _smoothed(objective, z)
    warnings += missing
    records, initial = _records(model, experiments, smoothed, covariance, feasible=objective.best is not None)
    warnings += repeated_outputs(records, model.output_names)
    message = HINTS.get(status, "")
    return FitResult(
        model=model,
        noise=noise,
        transcription=options,
        parameters=Estimates(estimates),
        initial_states=initial,
        covariance=covariance,
        log_likelihood=objective.prior(z) - end.value,
        records=records,
        status=status,
        message=message,
        iterations=end.iterations,
        time=seconds,
        warnings=tuple(warnings),
        history=end.history,
    )


def _invert(
    hessian: _Array, free: NDArray[np.intp], names: Sequence[str], out: _Array, warnings: list[str], status: str
) -> str:
    """Fill in the covariance of the free variables; return the status, which singular curvature changes."""
    block = hessian[np.ix_(free, free)]
    scale = np.sqrt(np.abs(np.diag(block)))
    none = scale == 0
    scale[none] = 1.0
    values, vectors = np.linalg.eigh(block / np.outer(scale, scale))
    weak = values < 1e-10
    if weak.any():
        involved = np.abs(vectors[:, weak]).max(axis=1) > 0.1
        listed = ", ".join(names[int(free[k])] for k in np.flatnonzero(involved))
        if (values < -1e-4).any():
            warnings.append(f"not a proper maximum: the likelihood grows from here in some direction of {listed}")
        else:
            warnings.append(f"{listed} cannot be told apart with these data: fix one of them, or give it a prior")
            status = "unidentifiable"
        keep = ~involved
        free, block = free[keep], block[np.ix_(keep, keep)]
    if free.size:
        scale = np.sqrt(np.abs(np.diag(block)))
        out[np.ix_(free, free)] = np.linalg.inv(block / np.outer(scale, scale)) / np.outer(scale, scale)
    return status


def _smoothed(objective: Objective, z: _Array) -> tuple[list[_core._Smoothed], list[str]]:
    """Return the smoothed records, and a sentence where there is no time for them: the most probable path is then what
    the last evaluation found, and what the smoother says of it is NaN."""
    problem, theta = objective.problem, objective.theta(z)
    if objective.best is None:
        return problem.unsmoothed(theta, objective.path), []
    try:
        found = problem.smooth(theta, objective.path, Deadline(None).with_grace())
        why = "not found"
    except TimeoutError:
        found, why = None, "time limit"
    except KeyboardInterrupt:
        found, why = None, "interrupted"
    if found is not None:
        return found, []
    text = f"{why}: there are no innovations, and no standard deviations of states; go on with start=fit"
    return problem.unsmoothed(theta, objective.best[1]), [text]


def _records(
    model: Model,
    experiments: Sequence[Experiment],
    smoothed: Sequence[_core._Smoothed],
    covariance: _Array,
    feasible: bool,
) -> tuple[list[Record], dict[str, Estimates]]:
    """Return the smoothed time histories, and the first states with their standard errors."""
    n, p = len(model.state_names), len(model.parameter_names)
    of_model = np.nan_to_num(covariance[:p, :p])
    records, initial = [], {}
    for e, (pairs, first, follows) in zip(experiments, smoothed, strict=True):
        (states, deviations), (outputs, _), (innovations, spreads), (predicted, _) = pairs
        measured = {name: e.output(name) for name in model.output_names}
        by_output = dict(zip(model.output_names, outputs, strict=True))
        by_state = dict(zip(model.state_names, states, strict=True))
        records.append(
            record_of(
                model,
                e,
                outputs,
                states,
                measured=measured,
                residuals={name: z - by_output[name] for name, z in measured.items()},
                mesh_t=e.t,
                mesh_states=by_state,
                feasible=feasible,
                state_std=dict(zip(model.state_names, deviations, strict=True)),
                innovations=dict(zip(model.output_names, innovations, strict=True)),
                innovation_std=dict(zip(model.output_names, spreads, strict=True)),
                predicted_states=dict(zip(model.state_names, predicted, strict=True)),
            )
        )
        moves = follows.reshape(n, p)
        variance = np.diag(first.reshape(n, n) + moves @ of_model @ moves.T)
        initial[e.name] = Estimates(
            Estimate(name, by_state[name][0], np.sqrt(np.maximum(variance[i], 0.0)), model.units.get(name, ""))
            for i, name in enumerate(model.state_names)
        )
    return records, initial
