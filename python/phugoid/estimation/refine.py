"""Mesh refinement: segments are split, or the order raised, until the integration error is small."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..data.interpolation import kind_of
from ..fit_result import FitResult
from ..integration import IntegrationError, coarse_mesh_warning, integration_error
from ..refinement import Refinement, Step
from ..transcription.collocation import Collocation

__all__ = ["refined"]

_Array: TypeAlias = NDArray[np.float64]

_PASSES = 10
# The order is raised, one by one, while more than this part of the segments is too coarse, and while that helps.
_MANY, _HIGHEST, _HELP = 0.5, 6, 4.0
# A split aims at this part of the tolerance, in no more pieces than these.
_AIM, _PIECES = 0.5, 8
_POINTS = 2_000_000
# A mesh without a solution is divided so often, each segment in so many parts, and the first in so many times less.
_DIVISIONS, _PARTS, _GRADES = 3, 4, 3
_UNKNOWN = (
    "converged on this mesh, but there was no time left to see whether it is fine enough; allow more time, or go on "
    "from here"
)


def refined(
    solve: Callable[[Collocation, FitResult | None], FitResult], transcription: Collocation, passed: Callable[[], bool]
) -> FitResult:
    """The fit on a mesh that is fine enough: ``solve`` estimates with a transcription, from a fit or the user's start.

    A first mesh on which the equations have no solution is divided, three times at most. Ends where the tolerance is
    met, after 10 passes, or with a pass that does not converge. Without a pass that was finished there is no
    `Fit.refinement`. ``passed`` tells whether the time is over.
    """
    mesh = replace(transcription, refine=False)
    first = fit = solve(mesh, None)
    for _ in range(_DIVISIONS):
        if fit.feasible or fit.status in ("interrupted", "time limit"):
            break
        # On too coarse a mesh the equations may have no solution.
        mesh = _divided(mesh, fit)
        fit = solve(mesh, None)
    steps: list[Step] = []
    raised = 0.0  # largest error before the order was raised last
    raising = True
    while True:
        if fit.status not in ("interrupted", "time limit") and passed():
            fit = replace(fit, status="time limit", message=_UNKNOWN)
        if fit.status in ("interrupted", "time limit"):  # no time to see how exact it is
            break
        found = integration_error(fit)
        assert isinstance(fit.transcription, Collocation)  # or there was no error to estimate
        worst = np.concatenate([each.worst for each in found])
        step = Step(
            order=fit.transcription.order,
            segments=worst.size,
            largest=float(worst.max()),
            coarse=int((worst > transcription.tolerance).sum()),
            iterations=fit.iterations,
            log_likelihood=fit.log_likelihood,
        )
        steps.append(step)
        points = step.segments * (step.order - 1)
        if step.coarse == 0 or len(steps) > _PASSES or points > _POINTS or not fit.converged:
            break
        raising &= (not raised or step.largest < raised / _HELP) and not _bent(fit, found)
        if raising and step.coarse > _MANY * step.segments and step.order < _HIGHEST:
            order, edges, raised = step.order + 1, [e.edges for e in found], step.largest
        else:
            order, edges, raised = step.order, _split(fit, found, step.order, transcription.tolerance), 0.0
        segments = tuple(tuple(e.tolist()) for e in edges)
        fit = solve(replace(transcription, order=order, substeps=1, segments=segments, refine=False), fit)
    if not steps:
        return fit
    # How exact it is now is said there, against the tolerance that was asked for.
    told = coarse_mesh_warning(fit) if fit.feasible else ""
    fit = replace(fit, warnings=tuple(w for w in fit.warnings if w != told))
    return replace(fit, refinement=Refinement.of(first.parameters, fit.parameters, steps, transcription.tolerance))


def _divided(mesh: Collocation, fit: FitResult) -> Collocation:
    """The mesh with every segment cut into four, those at the beginning, where there may be transients, into more."""
    divided = []
    for record in fit.records:
        ends = record.mesh_t[:: mesh.order - 1]
        share = np.arange(_PARTS * (ends.size - 1) + 1) / _PARTS
        finer = np.interp(share, np.arange(ends.size), ends)
        graded = finer[0] + (finer[1] - finer[0]) * float(_PARTS) ** -np.arange(_GRADES, 0, -1)
        divided.append(tuple(np.concatenate([finer[:1], graded, finer[1:]]).tolist()))
    return replace(mesh, substeps=1, segments=tuple(divided))


def _split(fit: FitResult, found: Sequence[IntegrationError], order: int, tolerance: float) -> list[_Array]:
    """Segment ends, with every segment that is too coarse divided as the order of the method asks for."""
    divided = []
    for record, each in zip(fit.records, found, strict=True):
        ends = [float(each.edges[0])]
        for a, b, error in zip(each.edges[:-1], each.edges[1:], each.worst, strict=True):
            if error > tolerance:
                pieces = math.ceil((error / (_AIM * tolerance)) ** (1.0 / (order + 1)))
                ends += _between(float(a), float(b), min(max(pieces, 2), _PIECES), record.input_times)
            ends.append(float(b))
        divided.append(np.array(ends))
    return divided


def _bent(fit: FitResult, found: Sequence[IntegrationError]) -> bool:
    """Whether inputs bend inside a segment, so that a higher order would be lost there."""
    for record, each in zip(fit.records, found, strict=True):
        linear = [name for name in record.inputs if kind_of(record.interpolation, name) == "linear"]
        if not linear:
            continue
        bends = np.concatenate([record.input_samples.get(name, (record.t,))[0] for name in linear])
        bends = bends[(bends >= record.t[0]) & (bends <= record.t[-1])]
        ends = np.searchsorted(each.edges, bends)
        near = np.minimum(
            np.abs(bends - each.edges[np.minimum(ends, each.edges.size - 1)]),
            np.abs(bends - each.edges[np.maximum(ends - 1, 0)]),
        )
        if near.max(initial=0.0) > 1e-6 * np.diff(each.edges).min():
            return True
    return False


def _between(a: float, b: float, pieces: int, samples: _Array) -> list[float]:
    """Where to cut: at samples, where inputs bend, as long as there are any inside."""
    cuts = a + (b - a) * np.arange(1, pieces) / pieces
    slack = 1e-6 * (b - a)
    inside = samples[(samples > a + slack) & (samples < b - slack)]
    if inside.size:
        cuts = np.unique(inside[np.abs(inside[None] - cuts[:, None]).argmin(axis=1)])
    return [float(c) for c in cuts]
