"""A `Fit` from the solution of an estimation: estimates, standard errors, records, and what to beware of."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..data.experiment import Experiment
from ..data.interpolation import kinds_for
from ..errors import EvaluationError
from ..fit_result import FitResult
from ..match import chi_square_warning, no_match, r_squared
from ..modelling.kinks import kink_advice
from ..modelling.model import Model
from ..modelling.scaling import ScalingSymmetry
from ..noise.kinds import PerExperiment
from ..noise.noise import Gaussian, Noise
from ..parameters import Estimate, Estimates, Parameter, correlation_matrix
from ..records import Record
from ..repeated_outputs import repeated_outputs
from ..solvers import HINTS, Solution
from ..solvers.limits import Deadline
from ..transcription.collocation import records_of
from ..transcription.shooting import Transcription

__all__ = ["make_fit"]

_Array = NDArray[np.float64]

_Activity: TypeAlias = Literal["lower", "upper", "fixed"] | None  # of the bounds of a parameter
# A bound is active where the variable lies within this part of it: for Newton's method, which ends exactly on bounds,
# and for an interior-point method.
_AT_BOUND, _NEAR_BOUND = 1e-9, 1e-6
# Parts of the total variation and of the range of a state that its defects may sum to.
_VARIATION, _ROUNDING = 1e-2, 1e-6
# Parameters are confounded where their correlation matrix has an eigenvalue below this.
_SINGULAR = 1e-12
# A point is the optimum when the Newton step left is this small a part of every standard error.
_CLOSE = 1e-3
# Ends that kinks of the state equations explain.
_KINKED = ("infeasible", "iteration limit", "failed", "diverging", "acceptable")
_BOUND: dict[_Activity, Literal["lower", "upper"] | None] = {
    "lower": "lower",
    "upper": "upper",
    "fixed": None,
    None: None,
}
_FLIPPED: dict[_Activity, Literal["lower", "upper"] | None] = {**_BOUND, "lower": "upper", "upper": "lower"}


def make_fit(
    model: Model,
    experiments: Sequence[Experiment],
    noise: Noise,
    transcription: Transcription,
    problem: _core.Problem,
    solution: Solution,
    free: Sequence[ScalingSymmetry] = (),
    stop: Callable[[], bool] | None = None,
    deadline: Deadline | None = None,
) -> FitResult:
    """The fit at a solution; without standard errors, which take long in large problems, where ``stop`` says so or
    there is no time left.

    ``free`` are scalings that no output can tell, of which the solver held one parameter each.
    """
    xi = solution.xi
    n_theta, n_x, n_model = problem.n_theta, len(model.state_names), len(problem.estimands)
    lower, upper = problem.bounds()
    active = _active(xi[:n_theta], lower[:n_theta], upper[:n_theta], solution)
    held = np.flatnonzero([a is not None for a in active])
    firsts = [n_theta + n_x * point for point in problem.first_point[:-1]]
    wanted = np.concatenate([np.setdiff1d(np.arange(n_theta), held), *(np.arange(f, f + n_x) for f in firsts)])

    defects = _total_defects(model, problem, xi)
    feasible = _feasible(model, problem, xi, defects)
    records = [_record(model, e, problem, xi, i, feasible) for i, e in enumerate(experiments)]
    warnings: list[str] = []
    full = np.full((problem.n, 1), np.nan)[:, 0]  # standard errors by variable
    cov = np.full((n_theta, n_theta), np.nan)
    status, message = solution.status, solution.message
    found = None
    limit = None if deadline is None else deadline.with_grace()
    try:
        if feasible:
            multipliers = solution.multipliers
            found = _core.information(problem, xi, multipliers, wanted.tolist(), held.tolist(), limit, stop)
        else:
            warnings.append(
                "the states do not satisfy the equations where the run ended: there is no log-likelihood, no standard "
                "error, and nothing is said of how well the outputs match"
            )
    except TimeoutError:
        warnings.append("time limit: there are no standard errors; allow more time, or go on with start=fit")
    except KeyboardInterrupt:
        warnings.append("interrupted: there are no standard errors; estimate with start=fit goes on from here")
    except EvaluationError as why:
        warnings.append(f"the standard errors could not be computed: {why}")
    if found is not None:
        covariance, step, undetermined, saddle = found
        variance = np.diag(covariance)
        proper = variance > 0
        # Elsewhere than at an end, curvature says nothing about the data.
        at_end = status in ("converged", "acceptable", "unidentifiable")
        if undetermined and at_end:
            names = [", ".join(problem.variable_name(i) for i in group) for group in undetermined]
            warnings += [_undetermined(group.split(", ")) for group in names]
            status, message = "unidentifiable", f"{HINTS['unidentifiable']} ({'; '.join(names)})"
        full[wanted] = np.sqrt(np.where(proper, variance, np.nan))
        inner = wanted < n_theta
        cov[np.ix_(wanted[inner], wanted[inner])] = covariance[np.ix_(inner, inner)]
        if saddle and at_end:
            warnings.append(
                "not a proper maximum: the log-likelihood grows from here in some direction; start from "
                "elsewhere, above all with factors that are not 0"
            )
        elif status == "acceptable" and np.all(np.abs(step[proper]) < _CLOSE * np.sqrt(variance[proper])):
            # Rounding kept the solver from its tolerance, but there is nowhere left to go.
            status, message = "converged", HINTS["converged"]
        names = [name for name, *_ in problem.estimands]
        warnings += _confounded([*names, *problem.noise_parameters], cov)

    status, message = _scaled(model, free, problem, firsts, (full, cov), (status, message), warnings)
    kinks = kink_advice(model._core) if status in _KINKED else ""
    if kinks:
        warnings.insert(0, kinks)
        message = f"{message}; above all, the state equations have kinks or jumps (see the warning)"
    values = problem.values(xi[:n_model].tolist())
    parameters = _model_estimates(model, problem, values, full, active)
    slopes = np.ones(n_theta)
    slopes[:n_model] = [slope for _, slope in values]
    cov *= np.outer(slopes, slopes)
    reported = problem.noise_report(xi)
    cov = _delta(cov, n_model, np.array([gradient for _, _, _, gradient, *_ in reported]))
    for i, (name, output, value, gradient, bounded_by, low, high) in enumerate(reported, start=n_model):
        side = None
        if bounded_by is not None:
            activity = active[n_model + bounded_by]
            # A lower bound of 1/sigma is an upper bound of sigma.
            side = _FLIPPED[activity] if gradient[bounded_by] < 0 else _BOUND[activity]
        unit = "" if output is None else model.units.get(model.output_names[output], "")
        error = float(np.sqrt(cov[i, i])) if cov[i, i] > 0 else np.nan
        parameters.append(Estimate(name, value, error, unit, bounds=(low, high), bounds_active=side))
        if side == "lower" and output is not None:
            warnings.append(
                f"{name} sits at its lower bound {value:.3g}: the fit of this output is exact for all we know"
            )

    initial = {}
    for experiment, first in zip(experiments, firsts, strict=True):
        units = model.units
        each = (Estimate(s, xi[first + i], full[first + i], units.get(s, "")) for i, s in enumerate(model.state_names))
        initial[experiment.name] = Estimates(each)
    estimates = Estimates(parameters)
    if feasible:
        warnings += _defect_warning(model, problem, xi, defects)
    of_each = noise.noise if isinstance(noise, PerExperiment) else noise
    if not (isinstance(of_each, Gaussian) and (of_each.correlated or of_each.covariance is not None)):
        warnings += repeated_outputs(records, model.output_names)
    warnings += _core.gap_warnings(model.input_names, records_of(model, experiments))
    unknowns = _unknowns(problem, int((held < n_model).sum()))
    warnings += _few_samples(unknowns, records, model.declared_parameters.values())
    explained = {name: r_squared(records, name) for name in model.output_names}
    beware = [chi_square_warning(noise, model.output_names, records, unknowns), no_match(explained)]
    warnings = [*filter(None, beware), *warnings]
    return FitResult(
        model=model,
        noise=noise,
        transcription=transcription,
        parameters=estimates,
        initial_states=initial,
        covariance=cov,
        log_likelihood=problem.prior_terms(xi) - problem.objective(xi) if feasible else np.nan,
        records=records,
        status=status,
        message=message,
        iterations=solution.iterations,
        time=solution.time,
        warnings=tuple(warnings),
        history=solution.history,
        solution=solution,
        experiments=tuple(experiments),
    )


def _delta(cov: _Array, n_model: int, gradients: _Array) -> _Array:
    """The covariance with the unknowns of the noise replaced by what is reported of it: the delta method.

    ``gradients`` (k, k): row i holds the derivatives of the i-th reported value. An unknown without covariance (NaN)
    leaves those values without that depend on it.
    """
    if np.isnan(np.diag(cov)).all():
        return cov
    jacobian = np.eye(cov.shape[0])
    if gradients.size:
        jacobian[n_model:, n_model:] = gradients
    unknown = np.isnan(np.diag(cov))
    result = jacobian @ np.where(np.isnan(cov), 0.0, cov) @ jacobian.T
    lost = (jacobian != 0) @ unknown
    result[lost], result[:, lost] = np.nan, np.nan
    return np.asarray(result)


def _undetermined(names: Sequence[str]) -> str:
    """What to say of variables in a direction without curvature."""
    if len(names) == 1:
        return f"{names[0]} has no influence on the outputs with these data: fix it, or give it a prior"
    return f"{', '.join(names)} cannot be told apart with these data: fix one of them, or give it a prior"


def _unknowns(problem: _core.Problem, held: int) -> int:
    """Return the number of parameters of the model and initial states that are estimated; ``held`` are not."""
    # Each constraint, of the path or on its ends, takes one away.
    return problem.n - problem.m - held - (problem.n_theta - len(problem.estimands))


def _scaled(
    model: Model,
    free: Sequence[ScalingSymmetry],
    problem: _core.Problem,
    firsts: Sequence[int],
    errors: tuple[_Array, _Array],
    end: tuple[str, str],
    warnings: list[str],
) -> tuple[str, str]:
    """Status and message where scales are free; what is scaled loses its standard errors."""
    full, cov = errors
    for scaling in free:
        local = [i for i, (name, *_) in enumerate(problem.estimands) if name.partition("[")[0] in scaling.exponents]
        full[local] = np.nan
        cov[local], cov[:, local] = np.nan, np.nan
        for first in firsts:
            full[[first + i for i, name in enumerate(model.state_names) if name in scaling.exponents]] = np.nan
        warnings.append(scaling.advice(model.state_names))
    if not free or end[0] not in ("converged", "acceptable", "unidentifiable"):
        return end
    said = end[1] if end[0] == "unidentifiable" else HINTS["unidentifiable"]
    return "unidentifiable", f"{said} ({'; '.join(', '.join(s.exponents) + ': one scale is free' for s in free)})"


def _few_samples(unknowns: int, records: Sequence[Record], declared: Iterable[Parameter]) -> list[str]:
    """A path with as many unknowns as there are measurements passes through them, whatever the truth is."""
    measured = sum(int(np.isfinite(z).sum()) for record in records for z in record.measured.values())
    measured += sum(p.prior is not None for p in declared)  # a prior counts as a measurement
    if measured > unknowns:
        return []
    return [
        f"{measured} measured values are no more than the {unknowns} parameters and initial states that they should "
        "tell: the fit passes through the noise, and its standard errors say nothing"
    ]


def _confounded(names: Sequence[str], cov: _Array) -> list[str]:
    """Parameters of which the data determine a combination only: their correlation matrix is singular."""
    known = np.flatnonzero(np.diag(cov) > 0)
    correlation = correlation_matrix(cov[np.ix_(known, known)])
    found = []
    for value, vector in zip(*_eigen(correlation), strict=True):
        if value < _SINGULAR:
            involved = ", ".join(names[int(k)] for k, part in zip(known, vector, strict=True) if abs(part) > 0.1)
            found.append(_undetermined(involved.split(", ")))
    return found


def _eigen(symmetric: _Array) -> tuple[_Array, _Array]:
    """Eigenvalues, and eigenvectors as rows."""
    values, vectors = np.linalg.eigh(symmetric)
    return values, vectors.T


def _active(theta: _Array, lower: _Array, upper: _Array, solution: Solution) -> list[_Activity]:
    """Return for each parameter "fixed", "lower" or "upper" for the bound that it is at, or None.

    A bound other than zero is its own measure, so that units do not matter. An interior-point method, which is known by
    its multipliers of bounds, ends short of a bound of zero by some part of its scale.
    """
    interior = any(np.any(z) for z in solution.bound_multipliers)
    part = _NEAR_BOUND if interior else _AT_BOUND

    def at(value: float, bound: float, other: float) -> bool:
        if not np.isfinite(bound):
            return False
        slack = part * abs(bound)
        if interior and bound == 0.0:
            slack = part * min(abs(other), 1.0)
        return abs(value - bound) <= slack

    found: list[_Activity] = []
    for value, low, high in zip(theta, lower, upper, strict=True):
        if low == high:
            found.append("fixed")
        elif at(value, low, high):
            found.append("lower")
        elif at(value, high, low):
            found.append("upper")
        else:
            found.append(None)
    return found


def _model_estimates(
    model: Model,
    problem: _core.Problem,
    values: Sequence[tuple[float, float]],
    errors: _Array,
    active: Sequence[_Activity],
) -> list[Estimate]:
    """``values`` holds those of the parameters, and their slopes with respect to what the solver sees."""
    declared = list(model.declared_parameters.values())
    return [
        Estimate(
            name,
            value,
            float(errors[i] * abs(slope)),
            declared[p].unit,
            declared[p].start,
            declared[p].bounds,
            declared[p].fixed,
            _BOUND[active[i]],
        )
        for i, ((name, p, _), (value, slope)) in enumerate(zip(problem.estimands, values, strict=True))
    ]


def _record(
    model: Model, experiment: Experiment, problem: _core.Problem, xi: _Array, index: int, feasible: bool
) -> Record:
    mesh_t, path = problem.path(xi, index)
    outputs = dict(zip(model.output_names, problem.outputs(xi, index), strict=True))
    measured = {name: experiment.output(name) for name in model.output_names}
    return Record(
        name=experiment.name,
        t=experiment.t,
        inputs={name: experiment.input(name) for name in model.input_names},
        outputs=outputs,
        states=dict(zip(model.state_names, problem.states(xi, index), strict=True)),
        measured=measured,
        residuals={name: measured[name] - outputs[name] for name in model.output_names},
        mesh_t=mesh_t,
        mesh_states=dict(zip(model.state_names, path, strict=True)),
        units=model.units,
        interpolation=kinds_for(experiment.interpolation, model.input_names),
        input_samples=experiment.own_samples(model.input_names),
        feasible=feasible,
    )


def _total_defects(model: Model, problem: _core.Problem, xi: _Array) -> _Array:
    """Return the sum of the absolute defects of each state, shape (n_x,); NaN where they are not finite."""
    defects = problem.constraints(xi)
    if defects is None:
        return np.full(len(model.state_names), np.nan)
    along = defects[: defects.size - len(problem.boundary_states)]
    return np.asarray(np.abs(along.reshape(-1, len(model.state_names))).sum(axis=0))


def _feasible(model: Model, problem: _core.Problem, xi: _Array, total: _Array) -> bool:
    """Return whether the states satisfy the equations, from the total defects.

    Defects add up along the path. They may do so to a hundredth of the way that a state goes (its total variation), and
    no further than the noise of the output of the same name; far below the range of the state they are rounding,
    whatever the noise is.
    """
    states = xi[problem.n_theta :].reshape(-1, len(model.state_names))
    size = np.abs(states).max(axis=0)
    span = np.ptp(states, axis=0)
    span = np.where(span > 1e-12 * size, span, size)
    variation = np.abs(np.diff(states, axis=0)).sum(axis=0)
    sigmas = dict(zip(model.output_names, problem.sigmas(xi), strict=True))
    noise = np.array([sigmas.get(name, np.inf) for name in model.state_names])
    limit = np.maximum(_ROUNDING * span, np.minimum(_VARIATION * variation, noise))
    return bool(np.all(total <= limit))


def _defect_warning(model: Model, problem: _core.Problem, xi: _Array, total: _Array) -> list[str]:
    """Unless defects stay far below sigma, the likelihood is not that of a solution."""
    found = []
    sigmas = problem.sigmas(xi)
    for i, name in enumerate(model.state_names):
        if name not in model.output_names:
            continue
        sigma = sigmas[model.output_names.index(name)]
        if total[i] > 0.01 * sigma:
            found.append(
                f"the defects of {name} sum to {total[i]:.1e}, not far below sigma_{name} = {sigma:.1e}: "
                "the state path is not a solution to that accuracy; tighten the solver's tolerance"
            )
    return found
