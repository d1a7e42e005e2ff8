"""A `FitResult` from the solution of an estimation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal, cast

import numpy as np

from .. import _core
from ..data.experiment import Experiment
from ..data.interpolation import kinds_for
from ..fit_result import FitResult
from ..match import chi_square_warning, no_match, r_squared
from ..modelling.kinks import kink_advice
from ..modelling.model import Model
from ..modelling.scaling import ScalingSymmetry
from ..noise.kinds import PerExperiment
from ..noise.noise import Gaussian, Noise
from ..parameters import Estimate, Estimates
from ..records import Record
from ..repeated_outputs import repeated_outputs
from ..solvers import Solution
from ..solvers.limits import Deadline
from ..transcription.collocation import records_of
from ..transcription.shooting import Transcription

__all__ = ["make_fit"]

# Ends that kinks of the state equations explain.
_KINKED = ("infeasible", "iteration limit", "failed", "diverging", "acceptable")


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
    """Return the fit at a solution; without standard errors, which take long in large problems, where ``stop`` says so
    or there is no time left.

    ``free`` are scalings that no output can tell, of which the solver held one parameter each.
    """
    found = _core.assess(
        problem,
        model._core,
        records_of(model, experiments),
        solution.xi,
        solution.multipliers,
        solution.status,
        solution.message,
        any(np.any(z) for z in solution.bound_multipliers),
        [(list(s.exponents.items()), s.held, s.at) for s in free],
        None if deadline is None else _time_for_errors(deadline, solution),
        stop,
    )
    records = [_record(model, e, found, i) for i, e in enumerate(experiments)]
    warnings, message = found.warnings, found.message
    kinks = kink_advice(model._core) if found.status in _KINKED else ""
    if kinks:
        warnings.insert(0, kinks)
        message = f"{message}; above all, the state equations have kinks or jumps (see the warning)"
    of_each = noise.noise if isinstance(noise, PerExperiment) else noise
    together = isinstance(of_each, Gaussian) and (of_each.correlated or of_each.covariance is not None)
    if found.feasible and not together:
        warnings += repeated_outputs(records, model.output_names)
    explained = {name: r_squared(records, name) for name in model.output_names}
    beware = [chi_square_warning(noise, model.output_names, records, found.unknowns), no_match(explained)]
    initial = {
        e.name: Estimates(Estimate(name, value, error, unit) for name, value, error, unit, _ in states)
        for e, states in zip(experiments, found.initial, strict=True)
    }
    return FitResult(
        model=model,
        noise=noise,
        transcription=transcription,
        parameters=_estimates(model, problem, solution, found),
        initial_states=initial,
        covariance=found.covariance,
        log_likelihood=found.log_likelihood,
        records=records,
        status=found.status,
        message=message,
        iterations=solution.iterations,
        time=solution.time,
        warnings=(*filter(None, beware), *warnings),
        history=solution.history,
        solution=solution,
        experiments=tuple(experiments),
    )


def _time_for_errors(deadline: Deadline, solution: Solution) -> float | None:
    """Return the seconds that standard errors may take, None without a limit; 0 where they would not come to an end,
    for they take about as long as half an iteration."""
    left = deadline.with_grace()
    if left is not None and solution.iterations and left < 0.5 * solution.time / solution.iterations:
        return 0.0
    return left


def _estimates(model: Model, problem: _core.Problem, solution: Solution, found: _core.Assessment) -> Estimates:
    """Return the parameters of the model with start and bounds as declared, then those of the noise."""
    declared = list(model.declared_parameters.values())
    places = [(declared[p].start, declared[p].bounds, declared[p].fixed) for _, p, _ in problem.estimands]
    places += [(0.0, (low, high), False) for *_, low, high in problem.noise_report(solution.xi)]
    estimates = []
    for (name, value, error, unit, kept), (start, bounds, fixed) in zip(found.parameters, places, strict=True):
        active = cast(Literal["lower", "upper"] | None, kept if kept in ("lower", "upper") else None)
        estimates.append(Estimate(name, value, error, unit, start, bounds, fixed, active))
    return Estimates(estimates)


def _record(model: Model, experiment: Experiment, found: _core.Assessment, index: int) -> Record:
    states, outputs, residuals, mesh_t, path = found.record(index)
    return Record(
        name=experiment.name,
        t=experiment.t,
        inputs={name: experiment.input(name) for name in model.input_names},
        outputs=dict(zip(model.output_names, outputs, strict=True)),
        states=dict(zip(model.state_names, states, strict=True)),
        measured={name: experiment.output(name) for name in model.output_names},
        residuals=dict(zip(model.output_names, residuals, strict=True)),
        mesh_t=mesh_t,
        mesh_states=dict(zip(model.state_names, path, strict=True)),
        units=model.units,
        interpolation=kinds_for(experiment.interpolation, model.input_names),
        input_samples=experiment.own_samples(model.input_names),
        feasible=found.feasible,
    )
