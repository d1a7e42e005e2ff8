"""The core's estimation, called with what Python holds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

import phugoid._core as _core

from ..data.experiment import Experiment
from ..errors import EvaluationError
from ..fit_result import FitResult
from ..modelling.model import Model
from ..noise.noise import Noise
from ..regression.equation_error import EquationError
from ..solvers import Ipopt, Iteration, Newton, Solution
from ..solvers.solution import Progress
from ..transcription.collocation import Collocation, records_of
from ..transcription.shooting import Transcription, step_spec

__all__ = ["Earlier", "estimated"]

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

    @staticmethod
    def of(fit: FitResult | EquationError, noise: Noise) -> Earlier:
        """Return what a fit or a regression gives for an estimation with this noise."""
        paths = [(r.mesh_t, dict(r.mesh_states)) for r in fit.records]
        if isinstance(fit, EquationError):
            return Earlier(fit.as_start(), paths)
        shooting = not isinstance(fit.transcription, Collocation)
        return Earlier(fit.as_start(noise), paths, fit.solution, shooting, near=True)

    def _spec(self) -> dict[str, Any]:
        s = self.solution
        paths = [
            (np.ascontiguousarray(t), [(n, np.ascontiguousarray(x)) for n, x in states.items()])
            for t, states in self.paths
        ]
        multipliers = None if s is None else (s.xi.size, s.multipliers, s.bound_multipliers, self.shooting)
        return {"values": list(self.values.items()), "paths": paths, "multipliers": multipliers, "near": self.near}


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

    ``pressed`` tells how often the user asked for an end: once gives the best point so far, twice leaves out its
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
        options["shooting"] = transcription.integrator, step_spec(transcription)
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
