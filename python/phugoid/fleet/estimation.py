"""The estimate from many records: Newton's method in the shared parameters, with the records on workers."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, EvaluationError, ModelError, OptionError, check_progress, counted, some, whole
from ..fit_result import FitResult
from ..modelling.model import Model
from ..modelling.noise import Noise, not_noise
from ..parameters import Estimate, Estimates, Parameter
from ..solvers import HINTS, Deadline, Iteration, Progress, interrupts
from ..solvers.newton import Newton
from ..transcription import Collocation
from .crew import FleetCrew, Stopped, of_executors, workers_of
from .newton import Quadratic
from .population import Population
from .result import FleetFit, FlightResult
from .runs import as_runs
from .sums import Sums
from .worker import Part, Spec, Trial

__all__ = ["divided", "estimate_fleet"]

_Array = NDArray[np.float64]

# Parts for each worker, so that none waits long for the last one; and most records of a part.
_PARTS, _RECORDS = 4, 250
# Parts of its promise that a step must keep: to be taken, not to shrink the radius, and to let it grow.
_TAKEN, _POOR, _GOOD = 1e-3, 0.25, 0.75
# Relative rounding of the sums, and the least radius, in standard errors.
_ROUNDING, _LEAST = 1e-13, 1e-6
# Steps that promise less log-likelihood than the first are taken unless it falls by more than the second. The end is
# where promises below the third no longer fall, for the paths of the records leave as much.
_NEAR, _SLACK, _SPENT = 0.1, 0.01, 1e-5
# Turns of populations and shared parameters, and by how much of its standard error a population may still move.
_TURNS, _STILL = 20, 0.02


def estimate_fleet(
    model: Model,
    runs: Sequence[Any],
    executor: Any,
    *,
    transcription: Collocation | None = None,
    noise: Noise | None = None,
    start: Mapping[str, Any] | FitResult | None = None,
    solver: Newton | None = None,
    progress: bool | Callable[[Iteration], None] = False,
    leave_out: bool = False,
    first: int = 8,
    memory: float = 1e9,
    populations: Sequence[str] = (),
) -> FleetFit:
    """Estimate the parameters that many records share, with the records on workers: the estimate of `phugoid.estimate`.

    Each worker keeps its records and the paths of their states. For trial values of the shared parameters, those of the
    noise among them, it eliminates the states, initial states and parameters of each record's own, and returns sums of
    the log-likelihood, its gradient and its Hessian: p + p² numbers, whatever the number of records. The driver takes
    the steps of Newton's method, in a trust region, from the estimate of a few records.

    runs        `Experiment` objects, `Run` objects, paths and URLs, each with a name of its own; paths, URLs and runs
                are read on the worker.
    executor    a `concurrent.futures` executor, such as ``ProcessPoolExecutor(8)``; a list of executors, of which each
                keeps its part of the records; or a client of Dask. Workers may be lost and may join.
    start       values by name, or a fit; None: the estimate from a few records.
    leave_out   leave out records that cannot be read, do not fit the model or have no finite likelihood; they are named
                in ``left_out``. Otherwise each of them is an error.
    first       number of records of the first estimate.
    memory      bytes of records that all workers keep together; others are read again at each iteration.
    populations names of parameters of each record's own that are drawn from a normal distribution, whose mean and
                standard deviation are estimated, too (a hierarchical model, by Laplace's approximation).

    Ctrl-C and ``Newton(time_limit=...)`` end the work with the best point so far.

    Raises ModelError for models with delays, OptionError for options that a fleet does not have and for workers that do
    not serve, DataError for records that cannot be used, EvaluationError where records have no likelihood at the start.
    """
    began = time.monotonic()
    solver = Newton() if solver is None else solver
    transcription = Collocation() if transcription is None else transcription
    noise = noise or (model.noise_model if isinstance(model, Model) else None)
    _check(model, transcription, noise, start, solver, progress, first)
    assert noise is not None
    if noise.expressions and noise is not model.noise_model:
        model = model.with_noise(noise)
    named = as_runs(runs)
    executors = of_executors(executor)
    workers = workers_of(executors)
    parts = divided(named, workers)
    given = dict(start.as_start(noise) if isinstance(start, FitResult) else start or {})
    spec = Spec(model, noise, transcription, given, (), int(memory / max(workers, 1)))
    with interrupts() as pressed, Deadline(solver.time_limit).in_force() as deadline:
        crew = FleetCrew(executors, spec, parts, pressed)
        try:
            few = named[:: max(len(named) // first, 1)][:first]
            found = crew.first(few, given if isinstance(start, FitResult) else None)
            warnings = _first_warnings(found)
            if found["unread"] and (not leave_out or "spreads" not in found):
                raise DataError(_unusable(found["unread"]))
            prior = _populations(populations, model, found)
            if prior:
                declared = model.declared_parameters
                changed = {p.name: replace(declared[p.name], prior=(p.mean, p.std)) for p in prior}
                model = model.with_parameters(changed)
            spec = replace(spec, model=model, start=found["start"], spreads=found["spreads"])
            crew.close()
            crew = FleetCrew(executors, spec, parts, pressed)
            fleet = _Fleet(crew, leave_out, prior, model.declared_parameters)
            with Progress.of(progress, f"{model.name}: {counted(len(named), 'record')}") as watch:
                fleet.prepare()
                fleet.minimise(solver, watch, deadline)
                fleet.minimise_with_populations(solver, watch, deadline)
            return _fit(fleet, spec, warnings, time.monotonic() - began)
        except Stopped:
            if deadline.passed():
                raise OptionError("estimate: time_limit passed before there was a first estimate; allow more") from None
            raise KeyboardInterrupt("estimate: stopped before there was a first estimate") from None
        finally:
            crew.close()


def divided(runs: Sequence[Any], workers: int) -> list[Part]:
    """Return the records in parts. Records one after the other belong to different ones: long ones often stand
    together."""
    count = min(len(runs), max(_PARTS * workers, math.ceil(len(runs) / _RECORDS)))
    return [Part(k, tuple(runs[k::count])) for k in range(count)]


def _check(model: Any, transcription: Any, noise: Any, start: Any, solver: Any, progress: Any, first: Any) -> None:
    """Raise errors for what a fleet cannot do."""
    if not isinstance(model, Model):
        raise ModelError(f"estimate: the first argument is a Model, not a {type(model).__name__}")
    model.check()
    if model.delays:
        raise ModelError("estimate: a model with delays is not estimated on an executor; give the records alone")
    if not isinstance(noise, Noise):
        raise OptionError(f"estimate: {not_noise(noise)}")
    if not isinstance(transcription, Collocation):
        raise OptionError(f"estimate: with an executor the transcription is a Collocation, not {transcription!r}")
    if transcription.refine or not (transcription.segments is None or isinstance(transcription.segments, int)):
        raise OptionError(
            "estimate: with an executor all records have one mesh: order and substeps, or a number of segments; "
            "leave out refine"
        )
    if type(solver) is not Newton:
        raise OptionError(f"estimate: with an executor the solver is Newton(...), not {solver!r}")
    if not isinstance(start, (Mapping, FitResult, type(None))):
        raise OptionError(f"estimate: start holds values by name, or is a fit, not {start!r}")
    check_progress("estimate", progress)
    whole("estimate: first", first, 1)


def _populations(names: Sequence[str], model: Model, found: Mapping[str, Any]) -> list[Population]:
    """Return the populations as the first estimate shows them. Raises OptionError for a name that is not that of a
    parameter of each record's own."""
    own = [n for n, p in model.declared_parameters.items() if p.per_experiment]
    populations = []
    for name in [names] if isinstance(names, str) else names:
        if name not in own:
            raise OptionError(f"estimate: populations names parameters of each record's own, not '{name}'; {some(own)}")
        values = found.get("own", {}).get(name, [])
        if len(values) < 2:
            raise OptionError(
                f"estimate: the population of '{name}' begins at a first estimate from records; leave out start, "
                "and let first be 2 or more"
            )
        spread = float(np.std(values, ddof=1))
        size = max(abs(float(np.mean(values))), 1e-6)
        populations.append(Population(name, float(np.mean(values)), spread if spread > 0.0 else size))
    return populations


def _first_warnings(found: Mapping[str, Any]) -> list[str]:
    if found["status"] in ("given", "converged", "acceptable"):
        return []
    return [f"the first estimate, from a few records, ended as '{found['status']}': {found['message']}"]


def _unusable(failures: Mapping[str, str]) -> str:
    each = "; ".join(f"'{name}': {text}" for name, text in list(failures.items())[:5])
    more = f"; and {len(failures) - 5} more" if len(failures) > 5 else ""
    return f"estimate: {counted(len(failures), 'record')} cannot be used ({each}{more}); leave_out=True leaves them out"


@dataclass
class _Fleet:
    """The search for the optimum: the best point so far, and the records that are left out."""

    crew: FleetCrew
    leave_out: bool
    populations: list[Population]
    declared: Mapping[str, Parameter]
    left_out: dict[str, str] = field(default_factory=dict)
    best: Sums | None = None
    names: list[str] = field(default_factory=list)
    lower: _Array = field(default_factory=lambda: np.zeros(0))
    upper: _Array = field(default_factory=lambda: np.zeros(0))
    start: _Array = field(default_factory=lambda: np.zeros(0))
    status: str = "failed"
    history: list[Iteration] = field(default_factory=list)
    factorizations: int = 0
    evaluations: int = 0

    def prepare(self) -> None:
        """Ask for the shared variables, and evaluate the start."""
        variables: list[Any] = []
        for answer in self.crew.evaluate(Trial(), [0]):
            variables = answer["variables"]
        if not variables:  # not one record of the first part can be read
            for answer in self.crew.evaluate(Trial()):
                variables = variables or answer["variables"]
        if not variables:
            raise DataError("estimate: no record of the fleet can be used")
        self.names = [name for name, *_ in variables]
        self.start = np.array([value for _, value, _ in variables])
        self.lower, self.upper = (np.array([b[k] for *_, b in variables]) for k in (0, 1))
        found = self.sums(self.start)
        if found.failures:
            self._leave_out(found.failures)
        if not found.records:
            reason = next((text for text, _ in found.failures.values()), "")
            raise EvaluationError(f"estimate: no record has a likelihood at the start: {reason}")
        self.best = found

    def _leave_out(self, failures: Mapping[str, tuple[str, bool]]) -> None:
        if not self.leave_out:
            kind = DataError if any(of_data for _, of_data in failures.values()) else EvaluationError
            raise kind(_unusable({name: text for name, (text, _) in failures.items()}))
        self.left_out |= {name: text for name, (text, _) in failures.items()}

    def sums(self, at: _Array, detailed: bool = False) -> Sums:
        """Return the sums over all records that are not left out."""
        populations = tuple((p.name, p.mean, p.std) for p in self.populations)
        trial = Trial(at, frozenset(self.left_out), detailed, populations=populations)
        found = Sums.of(at, sorted(self.crew.evaluate(trial), key=lambda answer: answer["part"]))
        self.factorizations += found.factorizations
        self.evaluations += 1
        return found

    def minimise_with_populations(
        self, solver: Newton, watch: Callable[[Iteration], None] | None, deadline: Deadline
    ) -> None:
        """Estimate populations and shared parameters in turn, until the populations stand still."""
        own = [n for n, p in self.declared.items() if p.per_experiment]
        for _ in range(_TURNS if self.populations else 0):
            if self.status != "converged" or self.best is None:
                return
            try:
                described = self.sums(self.best.at, detailed=True)
                moved = 0.0
                for k, before in enumerate(self.populations):
                    i = own.index(before.name)
                    values, errors = (np.array([r[key][i] for r in described.results]) for key in ("own", "own_errors"))
                    self.populations[k] = before.fitted(values, errors)
                    moved = max(moved, before.moved(self.populations[k]))
                if moved < _STILL:
                    return
                self.best = self.sums(self.best.at)
            except Stopped:
                self.status = deadline.ended()
                return
            self.minimise(solver, watch, deadline)

    def minimise(self, solver: Newton, watch: Callable[[Iteration], None] | None, deadline: Deadline) -> None:
        """Take steps of Newton's method in a trust region until the next one promises nothing."""
        assert self.best is not None
        radius, step, trials, before = math.inf, 0.0, 0, math.inf
        try:
            while True:
                best = self.best
                model = Quadratic(best.at, best.gradient, best.hessian, self.lower, self.upper)
                _, promise = model.step(math.inf)
                line = Iteration(len(self.history), -best.value, 0.0, promise, step, trials)
                self.history.append(line)
                if watch is not None:
                    watch(line)
                spent = promise <= _SPENT and promise > 0.1 * before
                if promise <= max(solver.tolerance**2, _ROUNDING * abs(best.value)) or spent:
                    self.status = "converged"
                    return
                if line.number >= solver.max_iterations:
                    self.status = "iteration limit"
                    return
                before, trials = promise, 0
                while True:
                    d, promised = model.step(radius)
                    trials += 1
                    found = self.sums(np.clip(best.at + d, self.lower, self.upper))
                    kept = (best.value - found.value) / promised if not found.failures else -math.inf
                    if not found.failures and promised <= _NEAR and found.value - best.value <= _SLACK:
                        kept = 1.0  # the next promise tells more than the values, which hold what the paths left
                    length = model.length(d)
                    if kept < _POOR:
                        radius = 0.25 * min(length, radius)
                    elif kept > _GOOD and length > 0.9 * radius:
                        radius *= 3.0
                    if kept > _TAKEN:
                        self.best, step = found, 1.0 if math.isinf(radius) else min(1.0, radius / length)
                        break
                    if radius < _LEAST:
                        self.status = "acceptable" if promise < 1e-2 else "failed"
                        return
        except Stopped:
            self.status = deadline.ended()


def _fit(fleet: _Fleet, spec: Spec, warnings: list[str], seconds: float) -> FleetFit:
    """Return the fit at the best point, with the covariance there and a description of each record."""
    assert fleet.best is not None
    best, model = fleet.best, spec.model
    results: list[Mapping[str, Any]] = []
    if fleet.status not in ("interrupted", "time limit"):
        # Once more at the end: the Hessian of a trial is that of a step before.
        detailed = fleet.sums(best.at, detailed=True)
        if not detailed.failures:
            best = detailed
        results = detailed.results
    else:
        warnings.append("records are not described one by one, since the work was ended early")
    free = Quadratic(best.at, best.gradient, best.hessian, fleet.lower, fleet.upper).free()
    n = best.at.size
    covariance = np.full((n, n), math.nan)
    status, message = fleet.status, HINTS[fleet.status]
    inner, weak = _inverse(best.hessian[np.ix_(free, free)])
    if weak is not None:
        names = [name for name, f in zip(fleet.names, free, strict=True) if f]
        open_names = [names[k] for k in np.argsort(-np.abs(weak))[:4] if abs(weak[k]) > 0.1 * np.abs(weak).max()]
        if status == "converged":
            status, message = "unidentifiable", f"{HINTS['unidentifiable']} ({', '.join(open_names)})"
    else:
        covariance[np.ix_(free, free)] = inner
    ended = fleet.status in ("interrupted", "time limit")
    estimates, reported = _reported(fleet, best.at, covariance) if not ended else ([], covariance)
    parameters = _estimates(model, estimates)
    own = [p for p, declared in model.declared_parameters.items() if declared.per_experiment]
    flights = {r["name"]: FlightResult.of(r, model, own) for r in results}
    if fleet.left_out:
        warnings.append(f"records left out: {some(list(fleet.left_out), 5)}; `left_out` says why")
    return FleetFit(
        model=model,
        noise=spec.noise,
        transcription=spec.transcription,
        parameters=parameters,
        covariance=reported,
        log_likelihood=sum(f.log_likelihood for f in flights.values()) if flights else -best.value,
        flights=flights,
        left_out=dict(fleet.left_out),
        populations={p.name: p for p in fleet.populations},
        status=status,
        message=message,
        iterations=len(fleet.history) - 1,
        evaluations=fleet.evaluations,
        factorizations=fleet.factorizations,
        samples=best.samples,
        time=seconds,
        warnings=(*warnings, *fleet.crew.warnings),
        history=tuple(fleet.history),
    )


def _inverse(matrix: _Array) -> tuple[_Array, _Array | None]:
    """Return the inverse of a positive definite matrix; else a direction in which it has no curvature, too."""
    scale = np.sqrt(np.maximum(np.abs(np.diag(matrix)), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    if values.size and values[0] <= 1e-14:
        return np.full_like(matrix, math.nan), np.asarray(vectors[:, 0])
    return np.asarray((vectors / values) @ vectors.T / np.outer(scale, scale)), None


def _reported(fleet: _Fleet, at: _Array, covariance: _Array) -> tuple[list[Any], _Array]:
    """Return estimates and covariance in the user's terms, from a worker."""
    trial = Trial(at, frozenset(fleet.left_out), covariance=covariance)
    for answer in fleet.crew.evaluate(trial, [0]):
        if "report" in answer:
            estimates, found = answer["report"]
            return estimates, np.asarray(found)
    return [], covariance


def _estimates(model: Model, estimates: Sequence[Any]) -> Estimates:
    declared, found = model.declared_parameters, []
    for name, value, error, unit, bounds, kept in estimates:
        p = declared.get(name)
        start, bounds, fixed = (p.start, p.bounds, p.fixed) if p else (0.0, bounds, False)
        active = cast(Literal["lower", "upper"] | None, kept if kept in ("lower", "upper") else None)
        found.append(Estimate(name, value, error, unit, start, bounds, fixed, active))
    return Estimates(found)
