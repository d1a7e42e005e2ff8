"""The core's estimation, called with what Python holds, and the `FitResult` made of its solution."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

import phugoid._core as _core

from ..data.experiment import Experiment
from ..data.filtering import kinds_for
from ..errors import EvaluationError
from ..fit_result import FitResult, Refinement, Smoothing, SmoothingStep, Step
from ..goodness_of_fit import no_match, r_squared
from ..modelling.declared import Delays, kink_advice
from ..modelling.densities import PerExperiment
from ..modelling.model import Model
from ..modelling.noise import Gaussian, Noise
from ..parameters import Estimate, Estimates
from ..records import Record, record_of, repeated_outputs
from ..solvers import Iteration, Progress, Solution
from ..solvers.newton import Newton, solution_of
from ..transcription import Collocation, Transcription, records_of

if TYPE_CHECKING:
    from ..regression.equation_error import EquationError
    from ..solvers.ipopt import Ipopt

__all__ = ["Earlier", "estimated", "make_fit"]

_Array: TypeAlias = NDArray[np.float64]
_Watch: TypeAlias = Callable[[Iteration], None]


@dataclass(frozen=True)
class Earlier:
    """Knowledge of an earlier fit: values of parameters, paths of states (times and, by name, values) in each
    experiment, its solution, and whether all that is near the optimum."""

    values: dict[str, float]
    paths: Sequence[tuple[_Array, dict[str, _Array]]]
    solution: Solution | None = None
    shooting: bool = False
    near: bool = False
    smoothed: tuple[list[tuple[str, float]], int, list[list[float]], list[tuple[str, float]]] | None = None

    @staticmethod
    def of(fit: FitResult | EquationError, noise: Noise) -> Earlier:
        """Return what a fit or a regression gives for an estimation with this noise."""
        paths = [(r.mesh_t, dict(r.mesh_states)) for r in fit.records]
        if not isinstance(fit, FitResult):
            return Earlier(fit.as_start(), paths)
        shooting = not isinstance(fit.transcription, Collocation)
        return Earlier(fit.as_start(noise), paths, fit.solution, shooting, near=True, smoothed=_smoothed(fit))

    def _spec(self) -> dict[str, Any]:
        s = self.solution
        paths = [
            (np.ascontiguousarray(t), [(n, np.ascontiguousarray(x)) for n, x in states.items()])
            for t, states in self.paths
        ]
        multipliers = None if s is None else (s.xi.size, s.multipliers, s.bound_multipliers, self.shooting)
        return {
            "values": list(self.values.items()),
            "paths": paths,
            "multipliers": multipliers,
            "near": self.near,
            "smoothed": self.smoothed,
        }


def _smoothed(fit: FitResult) -> tuple[list[tuple[str, float]], int, list[list[float]], list[tuple[str, float]]] | None:
    """Return how kinks were smoothed in the last pass: widths, the mesh of that pass, and what it left in error."""
    s, mesh = fit.smoothing, fit.transcription
    if s is None or not isinstance(mesh, Collocation):
        return None
    grids = mesh.grids(fit.experiments)
    edges = [e for _, _, e in grids if e is not None]
    if len(edges) < len(grids):
        return None
    widths = [(kink, width) for kink, (width, _) in s.widths.items()]
    return widths, mesh.order, edges, [(name, change) for name, (change, _) in s.left.items()]


def estimated(
    model: Model,
    experiments: Sequence[Experiment],
    transcription: Transcription,
    noise: Noise,
    start: Sequence[tuple[str, Any]],
    earlier: Earlier | None,
    solver: Newton | Ipopt,
    progress: bool | _Watch,
    pressed: Callable[[], int],
    ways: Mapping[str, Any],
) -> _core.Fit:
    """Return the core's estimate. ``ways``: what else may be tried for a fit: moving meshes, restarts, smoothed kinks.

    ``pressed`` is how often the user asked for an end: once gives the best point so far, twice leaves out its
    standard errors.
    """
    options: dict[str, Any] = {
        "order": transcription.order if isinstance(transcription, Collocation) else 4,
        "grids": transcription.grids(experiments),
        "threads": transcription.threads,
        "shooting": None,
        "noise": noise.saved(model.output_names),
        "start": start,
        "earlier": None if earlier is None else earlier._spec(),
        "max_iterations": int(solver.max_iterations),
        "tolerance": float(solver.tolerance),
        "time_limit": None if solver.time_limit is None else float(solver.time_limit),
        "gauss_newton": solver.gauss_newton,
        "regression": solver.regression if isinstance(solver, Newton) else None,
        "paths": solver.paths if isinstance(solver, Newton) else None,
        "delays": (model.delays.settled, model.delays.passes),
        "refine": transcription.tolerance if isinstance(transcription, Collocation) and transcription.refine else None,
        **ways,
    }
    if not isinstance(transcription, Collocation):
        options["shooting"] = transcription.integrator, transcription.step_spec
    records = records_of(model, experiments)
    with Progress.of(progress, model.name) as watch:

        def each(*line: Any) -> None:
            assert watch is not None
            watch(Iteration(*line[:6]))

        # Newton's method is the core's own; a class derived from it may solve otherwise.
        own = None if type(solver) is Newton else _solving(solver, watch, pressed)
        return _core.estimate(
            model._core, model.delays.spec, records, options, own, None if watch is None else each, pressed
        )


def _solving(solver: Newton | Ipopt, watch: _Watch | None, pressed: Callable[[], int]) -> Callable[..., Any]:
    """Return what solves a problem for the core by ``solver``."""

    def each(line: Iteration) -> None:
        if watch is not None:
            watch(line)
        if pressed():
            raise KeyboardInterrupt

    def solve(
        problem: _core.Problem,
        xi: _Array,
        multipliers: tuple[_Array, _Array, _Array] | None,
        how: tuple[bool, bool, bool, int, float | None],
    ) -> tuple[Any, ...] | None:
        known, near, sparse, most, left = how
        warm = None
        if multipliers is not None:
            of_constraints, low, high = multipliers
            warm = Solution(xi, of_constraints, (low, high), "", "", 0, 0.0)
        try:
            s = replace(solver, time_limit=left, max_iterations=most).solve(
                problem,
                xi,
                warm,
                None if watch is None else each,
                states_known=known,
                near=near,
                sparse=sparse,
                stop=lambda: pressed() > 0,
            )
        except EvaluationError:
            return None
        history = [(i.number, i.log_likelihood, i.defect, i.dual, i.step, i.trials) for i in s.history]
        counts = list(s.evaluations.values())
        ended = (s.status, s.message, s.iterations, s.time)
        return s.xi, s.multipliers, s.bound_multipliers, ended, history, counts, s.flops

    return solve


# Ends that kinks of the state equations explain.
_KINKED = ("infeasible", "iteration limit", "failed", "diverging", "acceptable")


def make_fit(
    model: Model,
    experiments: Sequence[Experiment],
    noise: Noise,
    transcription: Transcription,
    found: _core.Fit,
) -> FitResult:
    """Return the fit that the core found. Where it has delays, that at fixed delays is within; where kinks were
    smoothed, that of the smooth model."""
    transcription = _on_final_mesh(transcription, experiments, found)
    inner = _within(model, experiments, noise, transcription, found)
    records = [_record(model, e, found, i) for i, e in enumerate(experiments)]
    warnings, message = found.warnings, found.message
    kinks = kink_advice(model._core) if found.status in _KINKED else ""
    # First that residuals are not those of noise that is known.
    known = int(found.unlike_noise)
    if kinks:
        warnings.insert(known, kinks)
        message = f"{message}; above all, the state equations have kinks or jumps (see the warning)"
    of_each = noise.noise if isinstance(noise, PerExperiment) else noise
    together = isinstance(of_each, Gaussian) and (of_each.correlated or of_each.covariance is not None)
    if found.feasible and not together:
        warnings += repeated_outputs(records, model.output_names)
    explained = {name: r_squared(records, name) for name in model.output_names}
    initial = {
        e.name: Estimates(Estimate(name, value, error, unit) for name, value, error, unit, *_ in states)
        for e, states in zip(experiments, found.initial, strict=True)
    }
    solution = solution_of(found.solution)
    parameters = _estimates(model, found)
    return FitResult(
        model=model,
        noise=noise,
        transcription=transcription,
        parameters=parameters,
        initial_states=initial,
        covariance=found.covariance,
        log_likelihood=found.log_likelihood,
        records=records,
        status=found.status,
        message=message,
        iterations=found.iterations,
        time=solution.time,
        warnings=tuple(filter(None, [*warnings[:known], no_match(explained), *warnings[known:]])),
        history=solution.history,
        solution=solution if inner is None else None,
        refinement=_refinement(found, parameters),
        smoothing=_smoothing(found),
        experiments=tuple(experiments),
        integrated_log_likelihood=found.integrated,
        _moved=inner,
    )


def _within(
    model: Model,
    experiments: Sequence[Experiment],
    noise: Noise,
    transcription: Transcription,
    found: _core.Fit,
) -> FitResult | None:
    """Return the fit of the model without delays to the records that were moved by them, or of the smooth model."""
    if found.moved is None:
        return None
    inner, records = found.moved
    slim = model._around(inner.model, Delays())
    if not model.delays:
        return make_fit(slim, experiments, noise, transcription, inner)
    moved = []
    for e, (t, inputs, outputs, kinds, signals) in zip(experiments, records, strict=True):
        alike = kinds_for(dict(zip(slim.input_names, kinds, strict=True)), slim.input_names)
        u, z = (dict(zip(n, x, strict=True)) for n, x in ((slim.input_names, inputs), (slim.output_names, outputs)))
        record = Experiment(t, u, z, e.name, alike, units=e._units_of(u, z))
        of_input = dict(zip(slim.input_names, signals, strict=True))
        moved.append(record._sampled(of_input, e.t if e.mesh_times is None else e.mesh_times))
    return make_fit(slim, moved, noise, transcription, inner)


def _on_final_mesh(transcription: Transcription, experiments: Sequence[Experiment], found: _core.Fit) -> Transcription:
    """Return the transcription with the mesh on which the fit ended."""
    if not isinstance(transcription, Collocation):
        return transcription
    asked = [edges for _, _, edges in transcription.grids(experiments)]
    if (
        found.edges is not None
        and found.order is not None
        and (found.edges != asked or found.order != transcription.order)
    ):
        edges = tuple(tuple(e) for e in found.edges)
        transcription = replace(transcription, order=found.order, substeps=1, segments=edges)
    return replace(transcription, refine=False)


def _refinement(found: _core.Fit, parameters: Estimates) -> Refinement | None:
    if found.refinement is None:
        return None
    tolerance, steps, first = found.refinement
    return Refinement.of(dict(first), parameters, [Step(*step) for step in steps], tolerance)


def _smoothing(found: _core.Fit) -> Smoothing | None:
    if found.smoothing is None:
        return None
    widths, steps, left = found.smoothing
    return Smoothing(
        {kink: (width, unit) for kink, width, unit in widths},
        tuple(SmoothingStep(*step) for step in steps),
        {name: (change, error) for name, change, error in left},
    )


def _estimates(model: Model, found: _core.Fit) -> Estimates:
    """Return the parameters of the model with start and bounds as declared, then those of the noise."""
    declared, estimates = model.declared_parameters, []
    for name, value, error, unit, bounds, kept in found.parameters:
        p = declared.get(name.partition("[")[0])
        start, bounds, fixed = (p.start, p.bounds, p.fixed) if p else (0.0, bounds, False)
        active = cast(Literal["lower", "upper"] | None, kept if kept in ("lower", "upper") else None)
        estimates.append(Estimate(name, value, error, unit, start, bounds, fixed, active))
    return Estimates(estimates)


def _record(model: Model, experiment: Experiment, found: _core.Fit, index: int) -> Record:
    states, outputs, residuals, mesh_t, path = found.record(index)
    return record_of(
        model,
        experiment,
        outputs,
        states,
        measured={name: experiment.output(name) for name in model.output_names},
        residuals=dict(zip(model.output_names, residuals, strict=True)),
        mesh_t=mesh_t,
        mesh_states=dict(zip(model.state_names, path, strict=True)),
        feasible=found.feasible,
    )
