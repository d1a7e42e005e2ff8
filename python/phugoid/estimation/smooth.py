"""Estimation with kinks in the state equations: smoothed, over widths that are reduced from pass to pass."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .._core import Expr
from ..data.interpolation import interpolated, kind_of
from ..errors import EvaluationError
from ..fit_result import FitResult
from ..integration import integration_error
from ..modelling.kinks import name_kinks, width_unit
from ..modelling.model import Model
from ..records import Record
from ..regression.equations import Equation, Evaluation
from ..smoothing import Smoothing, SmoothingStep
from ..transcription.collocation import Collocation

__all__ = ["kinks_matter", "smoothed_fit"]

_Array: TypeAlias = NDArray[np.float64]
_Solve: TypeAlias = Callable[[Model, Collocation, FitResult | None], FitResult]

# A segment over whose kink integration is wrong by more than this part of the noise does not resolve it.
_COARSE = 0.1
# The first width as a part of the standard deviation of the kink's argument, and the one that is tried after it.
_FIRST, _WIDER = 0.1, 1.0
# Each width is the last over this. Crossings of a kink move with the width, and the mesh must still resolve them.
_RATIO = 2.0
# Widths are narrow enough where the error left is below this part of every standard error and, root mean square, of the
# residuals, and most passes until then. In a validation there are no standard errors.
_SETTLED, _OF_RESIDUALS, _PASSES = 0.25, 0.1, 30
# Of the integration error of a segment, in units of the noise. With ten times more, standard errors are wrong: errors
# that change with where a kink is crossed between points bend the likelihood.
_TOLERANCE = 1e-3
_STOPPED = ("interrupted", "time limit")


def kinks_matter(fit: FitResult) -> bool:
    """Tell whether the model has kinks that may be why a fit by collocation is none, or a wrong one: it did not
    converge, or a kink is crossed within a segment that is too coarse for it."""
    if not fit.model._core.kinks() or fit.status in _STOPPED or not isinstance(fit.transcription, Collocation):
        return False
    if not fit.converged:
        return True
    try:
        errors = integration_error(fit)
    except EvaluationError:
        return False
    order = fit.transcription.order
    for error, paths in zip(errors, _arguments(fit), strict=True):
        points = (order - 1) * np.arange(error.worst.size)[:, None] + np.arange(order)
        above = paths[:, points] > 0
        crossed = (above.any(axis=2) & ~above.all(axis=2)).any(axis=0)
        if (crossed & (error.worst > _COARSE)).any():
            return True
    return False


def smoothed_fit(solve: _Solve, rough: FitResult) -> FitResult:
    """The estimate of a model with kinks by passes over smooth models, each from the last, or ``rough``, the fit
    without smoothing, where these do not converge either.

    ``solve`` estimates a model on a mesh, from a fit or the user's start. Widths are halved until what they leave in
    error is small beside the standard errors, or the mesh cannot be made to resolve narrower ones.
    """
    began = time.monotonic()
    model = rough.model
    spreads = _spreads(rough)
    assert isinstance(rough.transcription, Collocation)
    mesh = rough.transcription if rough.refinement is None else replace(rough.transcription, segments=None)
    tolerance = _TOLERANCE if rough.refinement is None else min(_TOLERANCE, rough.refinement.tolerance)

    def narrowed(part: float, before: FitResult | None) -> FitResult:
        from_mesh = mesh if before is None else before.transcription
        assert isinstance(from_mesh, Collocation)
        # The likelihood of another width is none to compare with.
        begin = None if before is None else replace(before, log_likelihood=math.nan)
        finer = replace(from_mesh, refine=True, tolerance=tolerance)
        return solve(model._smoothed((part * spreads).tolist()), finer, begin)

    def good(fit: FitResult) -> bool:
        return fit.converged and fit.refinement is not None and fit.refinement.met

    part = _FIRST
    fit = narrowed(part, None)
    if not good(fit) and fit.status not in _STOPPED:
        part = _WIDER
        fit = narrowed(part, None)
    if not good(fit):
        return replace(rough, status=fit.status, message=fit.message) if fit.status in _STOPPED else rough
    passes, ratio, stopped = [(part, fit)], _RATIO, None
    while len(passes) < _PASSES and not _settled(passes):
        part, last = passes[-1]
        fit = narrowed(part / ratio, last)
        if good(fit):
            passes.append((part / ratio, fit))
            ratio = _RATIO
        elif fit.status in _STOPPED:
            stopped = fit
            break
        elif ratio < _RATIO:
            break
        else:
            ratio = math.sqrt(_RATIO)
    fit = _told(rough, passes, spreads, rough.time + time.monotonic() - began)
    return fit if stopped is None else replace(fit, status=stopped.status, message=stopped.message)


def _told(rough: FitResult, passes: Sequence[tuple[float, FitResult]], spreads: _Array, seconds: float) -> FitResult:
    """The last pass as a fit of the model with kinks, which says how these were smoothed."""
    model, (part, last) = rough.model, passes[-1]
    kinks = model._core.kinks()
    units = (width_unit(model._core, argument) for *_, argument in kinks)
    smoothing = Smoothing(
        dict(zip(name_kinks(model._core), zip((part * spreads).tolist(), units, strict=True), strict=False)),
        tuple(SmoothingStep(p, _segments(f), _iterations(f), f.log_likelihood) for p, f in passes),
        _left(passes),
    )
    warnings = last.warnings
    if beyond := smoothing.beyond(1.0):
        each = ", ".join(f"{name} by {by:+.1f}" if math.isfinite(by) else name for name, by in beyond.items())
        warnings = (
            "kinks of the state equations were smoothed, and over narrower widths than these the fit did not converge: "
            f"with widths of zero, parameters would change, in standard errors: {each}; give more samples or a finer "
            "mesh (ph.Collocation(substeps=...))",
            *warnings,
        )
    over = f"kinks of the state equations were smoothed: {smoothing.description} (see fit.smoothing)"
    return replace(
        last,
        model=model,
        message=f"{last.message}; {over}",
        warnings=warnings,
        iterations=rough.iterations + sum(_iterations(f) for _, f in passes),
        time=seconds,
        solution=None,
        smoothing=smoothing,
        _moved=last._moved or last,
    )


def _left(passes: Sequence[tuple[float, FitResult]]) -> dict[str, tuple[float, float]]:
    """What smoothing leaves in error: by how much estimates change as widths go to zero, and standard errors."""
    part, last = passes[-1]
    found = {}
    for name, e in last.parameters.items():
        if e.fixed:
            continue
        left = math.nan
        if len(passes) > 1:
            before, earlier = passes[-2]
            left = (e.value - earlier.parameters[name].value) * part / (before - part)
        found[name] = left, e.std_error
    return found


def _settled(passes: Sequence[tuple[float, FitResult]]) -> bool:
    """Whether the error left is small beside every standard error, and was nearly so a pass before, and what it is in
    the outputs is small beside the residuals."""
    if len(passes) < 3 or not all(_alike(passes[-2:])):
        return False
    now, before = _left(passes), _left(passes[:-1])
    known = [n for n, (left, error) in now.items() if error > 0 and math.isfinite(left)]
    small = (abs(now[n][0]) <= _SETTLED * now[n][1] for n in known)
    return all(small) and all(abs(before[n][0]) <= _RATIO * _SETTLED * before[n][1] for n in known if n in before)


def _alike(passes: Sequence[tuple[float, FitResult]]) -> Iterator[bool]:
    """Whether what smoothing leaves in error of each output is small beside its residuals."""
    (before, earlier), (part, last) = passes
    for then, now in zip(earlier.records, last.records, strict=True):
        for name, residuals in now.residuals.items():
            left = (now.outputs[name] - then.outputs[name]) * part / (before - part)
            there = np.isfinite(residuals)
            yield bool((left[there] ** 2).sum() <= _OF_RESIDUALS**2 * (residuals[there] ** 2).sum())


def _segments(fit: FitResult) -> int:
    return fit.refinement.steps[-1].segments if fit.refinement else 0


def _iterations(fit: FitResult) -> int:
    return sum(step.iterations for step in fit.refinement.steps) if fit.refinement else fit.iterations


def _spreads(fit: FitResult) -> _Array:
    """The standard deviation of the argument of each kink along the path, shape (K,); its size, or 1, where it stands
    still or is not finite."""
    paths = np.concatenate(_arguments(fit), axis=1)
    paths = np.where(np.isfinite(paths), paths, 0.0)
    spread, size = paths.std(axis=1), np.abs(paths).max(axis=1)
    spread = np.where(spread > 1e-9 * size, spread, size)
    return np.where((spread > 0) & np.isfinite(spread), spread, 1.0)


def _arguments(fit: FitResult) -> list[_Array]:
    """What is zero at each kink along the path of each record, shape (K, points of the mesh)."""
    model = fit.model
    late = {name: Expr.symbol(of) for name, (of, _) in model.delays.inputs.items()}
    found = [Equation(text, argument.substitute(late), None) for _, _, text, argument in model._core.kinks()]
    evaluation = Evaluation(model, found, [])
    return [evaluation(fit._own(record.name), _columns(model, record))[0] for record in fit.records]


def _columns(model: Model, record: Record) -> _Array:
    """Time, inputs and states at the points of the mesh."""
    t = record.mesh_t
    inputs = []
    for name in model.input_names:
        samples = record.input_samples.get(name, (record.t, record.inputs[name]))
        inputs.append(interpolated(kind_of(record.interpolation, name), *samples, t))
    return np.vstack([t, *inputs, *(record.mesh_states[name] for name in model.state_names)])
