"""The filter-error method: a fit with process noise, from a model and data."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

import phugoid._core as _core

from ..data.experiment import Experiment
from ..errors import EvaluationError, OptionError, PhugoidError
from ..filter_error import FilterError
from ..fit_result import FitResult
from ..initialisation import check_names, parameter_start, spread, state_start
from ..modelling.model import Model
from ..modelling.noise import Gaussian, Noise
from ..solvers import Deadline, Iteration, Progress, TimeUp
from ..solvers.newton import Minimum, bounded_step, minimise
from .filter_variables import Objective, Separated, intensity_start, make_filter_fit, split

__all__ = ["better", "doubtful", "filter_error"]

_Array = NDArray[np.float64]

# Least predicted gain of a step in log-likelihood: 1e-4 of a standard error, as for the other solver.
_TOLERANCE = 0.5e-8
# Least standard deviation, as a part of the spread of an output.
_FLOOR = 1e-4
# Estimates that would move by less, in standard errors, stay where they are.
_STILL = 0.1
# Log-likelihoods of one optimum, with two treatments of the noise that move the estimates no more than that, differ by
# less than this.
_SAME = _STILL**2
# Ends of fits that were stopped.
_STOPPED = ("interrupted", "time limit")
# How often the exact Hessian replaces the quasi-Newton one.
_ROUNDS = 6


def filter_error(
    model: Model,
    experiments: Sequence[Experiment],
    options: FilterError,
    noise: Noise,
    start: Mapping[str, Any] | FitResult | None,
    progress: bool | Callable[[Iteration], None],
    ordinary: FitResult | None = None,
) -> FitResult:
    """Return the fit by the filter-error method; arguments as those of `estimate`, which has checked them, and an
    output-error fit to start from."""
    begin = time.perf_counter()
    _check(model, noise)
    if len(experiments) > 1 and any(p.per_experiment for p in model.declared_parameters.values()):
        apart = Separated(model, experiments)
        begun = apart.fit(start) if isinstance(start, FitResult) else apart.start(start or {})
        ordinary = None if ordinary is None else apart.fit(ordinary)
        return apart.restored(filter_error(apart.model, apart.experiments, options, noise, begun, progress, ordinary))
    warm = start if isinstance(start, FitResult) else ordinary
    known_q = options.intensities or {}
    of_q, rest = split(options, {} if start is None or isinstance(start, FitResult) else start)
    if warm is not None:
        rest = warm.as_start(noise)
        of_q = of_q or {
            n: warm.parameters[n].value
            for n in warm.noise_parameters & {f"q_{s}" for s in options.states if s not in known_q}
            if warm.parameters[n].value > 0
        }
    check_names(model, rest, experiments)
    parameters = parameter_start(model, rest)
    spreads = {name: spread(experiments, name) for name in model.output_names}
    sigmas = noise.resolve(model.output_names, spreads, rest).sigmas
    sigmas = [_floored(s, n in noise.sigma, spreads[n]) for n, s in zip(model.output_names, sigmas, strict=True)]
    problem = options.problem(model, experiments, sigmas)

    states = [_states(model, e, parameters, rest, warm, i) for i, e in enumerate(experiments)]
    intensities = intensity_start(options, model, [e.t for e in experiments], states, of_q)
    unknown = [s for s in sigmas if not s[0]]
    declared = model.declared_parameters.values()
    low_q = np.array([known_q.get(name, -np.inf) for name in options.states])
    high_q = np.array([known_q.get(name, np.inf) for name in options.states])
    lower = np.array([p.start if p.fixed else p.bounds[0] for p in declared])
    upper = np.array([p.start if p.fixed else p.bounds[1] for p in declared])
    bounds = (
        np.concatenate([lower, np.log([s[2] for s in unknown]), low_q]),
        np.concatenate([upper, np.log([s[3] for s in unknown]), high_q]),
    )
    path = problem.start(np.concatenate([x.T.ravel() for x in states]))
    objective = Objective(model, problem, path, bounds, len(intensities))
    z = np.array([*parameters.values(), *np.log([s[1] for s in unknown]), *intensities])

    counts = [
        sum(int(np.isfinite(e.output(name)).sum()) for e in experiments)
        for name, s in zip(model.output_names, sigmas, strict=True)
        if not s[0]
    ]
    at, *finer = options.meshes()
    first: tuple[float, _Array] | None = math.nan, np.full(z.size, np.nan)
    try:
        first = objective(z)
        if first is None:
            raise EvaluationError(
                f"FilterError: at the starting point, {objective.reason}; give other start values, or output_error=True"
            )
        metric = objective.metric(z, counts, sum(e.n - 1 for e in experiments))
    except TimeUp:  # the start is all that is known, perhaps with its likelihood
        value, gradient = first or (math.nan, np.full(z.size, np.nan))
        end = Minimum(z, value, gradient, np.eye(z.size), Deadline(None).ended(), 0)
        seconds = time.perf_counter() - begin
        return make_filter_fit(model, experiments, noise, at, objective, end, None, seconds)
    moved = 0.0
    with Progress.of(progress, model.name) as watch:
        end, hessian = _maximise(objective, z, first, metric, options.max_iterations, watch)
        for next_at in finer:
            if hessian is None or end.status != "converged":
                break
            fine = objective.on(next_at.problem(model, experiments, sigmas))
            curvature = _positive(hessian, end.metric, _held(objective.bounds, end))[0]
            try:
                moved, first = _refinement_step(fine, end, curvature)
            except KeyboardInterrupt:
                end.status = Deadline(None).ended()
                break
            if moved < _STILL or first is None:
                break
            at, objective, before = next_at, fine, end
            end, hessian = _maximise(fine, end.x, first, curvature, options.max_iterations, watch, end.iterations)
            end.history = [*before.history, *end.history]
    seconds = time.perf_counter() - begin
    fit = make_filter_fit(model, experiments, noise, at, objective, end, hessian, seconds)
    if finer and at == finer[-1] and moved >= _STILL:
        text = (
            f"the last refinement of the noise between samples ({at.terms} terms, {at.substeps} steps) still moved the "
            f"estimates, by {moved:.1f} standard errors: samples are far apart for such fast motion; take more terms "
            "and steps, FilterError(terms=..., substeps=...)"
        )
        fit = replace(fit, warnings=(*fit.warnings, text))
    return fit


def doubtful(fit: FitResult, options: FilterError) -> bool:
    """Return whether a fit from distant start values may be a spurious optimum: it did not converge, or only once the
    noise between samples was refined. Coarse steps have optima of their own, with motions too fast for them."""
    if fit.status in _STOPPED:
        return False
    return not fit.converged or fit.transcription != options.meshes()[0]


def better(fit: FitResult, other: Callable[[], FitResult]) -> FitResult:
    """Return, of a doubtful fit and one from another start, the one that converged, or is likelier; the latter where
    both are at the same optimum, with a treatment of the noise that need not be as fine."""
    try:
        second = other()
    except PhugoidError:  # no ordinary fit, or no likelihood there
        return fit
    if second.status in _STOPPED:
        return fit
    if fit.converged and second.converged and abs(fit.log_likelihood - second.log_likelihood) < _SAME:
        return second
    return max((fit, second), key=lambda f: (f.converged, f.log_likelihood))


def _refinement_step(fine: Objective, end: Minimum, curvature: _Array) -> tuple[float, tuple[float, _Array] | None]:
    """Return the length of the next Newton step with a finer treatment of the noise between samples, in standard errors
    of the parameter that moves most; and value and gradient there."""
    first = fine(end.x)
    if first is None:
        return math.inf, None
    lower, upper = fine.bounds
    step = bounded_step(first[1], curvature, lower - end.x, upper - end.x)
    return math.sqrt(max(float(step @ curvature @ step), 0.0)), first


def _held(bounds: tuple[_Array, _Array], end: Minimum) -> NDArray[np.bool_]:
    """Return which variables are fixed, or at an active bound."""
    lower, upper = bounds
    held: NDArray[np.bool_] = (
        (lower == upper) | ((end.x <= lower) & (end.gradient > 0)) | ((end.x >= upper) & (end.gradient < 0))
    )
    return held


def _check(model: Model, noise: Noise) -> None:
    """Raise OptionError for options and models that this method does not support."""
    if not isinstance(noise, Gaussian) or noise.correlated or noise.covariance is not None:
        raise OptionError("FilterError: measurement noise is independent and Gaussian here")
    if noise.expressions:
        name, expression = next(iter(noise.expressions.items()))
        raise OptionError(
            f"FilterError: the standard deviation of '{name}' is an expression ({expression}); this method takes "
            "numbers and unknown ones"
        )
    if model._core.conditions:
        raise OptionError("FilterError: initial, final and periodic conditions are not supported; use initial=...")


def _floored(sigma: tuple[bool, float, float, float], given: bool, scale: float) -> tuple[bool, float, float, float]:
    """Return sigma with a higher lower bound than that of the output-error method, unless the user gave one: process
    noise can explain an output exactly, and then the likelihood is flat below that bound."""
    known, value, low, high = sigma
    low = low if known or given else max(low, _FLOOR * scale)
    return known, max(value, low), low, high


def _states(
    model: Model,
    e: Experiment,
    parameters: Mapping[str, float],
    given: Mapping[str, Any],
    warm: FitResult | None,
    i: int,
) -> _Array:
    """Return the states to start from, (n_x, N)."""
    states = state_start(model, e, e.t, parameters, given)
    if warm is not None and i < len(warm.records):
        record = warm.records[i]
        for k, name in enumerate(model.state_names):
            if name in record.states:
                states[k] = _core.interpolate("linear", record.t.tolist(), record.states[name].tolist(), e.t.tolist())
    return states


def _maximise(
    objective: Objective,
    z: _Array,
    first: tuple[float, _Array],
    metric: _Array,
    max_iterations: int,
    watch: Callable[[Iteration], None] | None,
    number: int = 0,
) -> tuple[Minimum, _Array | None]:
    """Maximise by quasi-Newton steps, then check with the exact Hessian, which confirms the optimum or restarts the
    search from there. ``number`` iterations were made before.

    ``number`` iterations are behind it."""
    history: list[Iteration] = []
    hessian = None
    for _ in range(_ROUNDS):
        end = minimise(
            objective, z, first, metric, objective.bounds,
            tolerance=_TOLERANCE, max_iterations=max_iterations - number, watch=watch, number=number,
        )  # fmt: skip
        number = end.iterations
        history += end.history
        end.history = history
        z, first = end.x, (end.value, end.gradient)
        if end.status not in ("converged", "failed"):
            break
        try:
            objective(z)  # the path there
            lower, upper = objective.bounds
            held = _held(objective.bounds, end)
            hessian = objective.hessian(z, end.metric, held)
            if hessian is None:
                break
            metric, saddle = _positive(hessian, end.metric, held)
            if saddle is not None and end.status == "converged":
                # A saddle, as q = 0 is where there is noise: one standard error down the slope there.
                found = objective(z + saddle)
                if found is not None and found[0] < end.value:
                    z, first = z + saddle, found
                    continue
        except KeyboardInterrupt:
            end.status = Deadline(None).ended()
            break
        step = bounded_step(end.gradient, metric, lower - z, upper - z)
        if -0.5 * float(end.gradient @ step) < _TOLERANCE:
            end.status = "converged"
            break
        end.status = "iteration limit"
    return end, hessian


def _positive(hessian: _Array, metric: _Array, held: NDArray[np.bool_]) -> tuple[_Array, _Array | None]:
    """Return a positive definite matrix near the Hessian, and a step along its most negative direction, if there is
    one."""
    scale = 1 / np.sqrt(np.where(held, 1.0, np.maximum(np.abs(np.diag(hessian)), 1e-6 * np.diag(metric))))
    scaled = hessian * np.outer(scale, scale)
    scaled[held, held] = 1.0
    values, vectors = np.linalg.eigh(scaled)
    step = scale * vectors[:, 0] if values[0] < -1e-6 else None
    near = (vectors * np.maximum(np.abs(values), 1e-10)) @ vectors.T
    return near / np.outer(scale, scale), step
