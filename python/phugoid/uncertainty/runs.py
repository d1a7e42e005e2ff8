"""Many estimations about a fit, here or on an executor, with progress, and what is there after Ctrl-C."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from ..discrepancy.search.linearised import dataset
from ..errors import OptionError
from ..fit_result import FitResult
from ..solvers import Newton
from ..starts.gathered import Watch, check_progress, gathered
from ..starts.outcome import Outcome, Problem
from ..transcription.filter_error import FilterError

__all__ = ["NEAR", "Runs", "common_to", "run_all"]


NEAR = Newton(regression=False)
"""The solver: the path is known, so there is no need of a regression on measured states."""


@dataclass(frozen=True)
class Runs:
    """What came of the runs: outcomes by number, whether all are there, and what went wrong with workers."""

    outcomes: Mapping[int, Outcome]
    complete: bool
    warnings: tuple[str, ...]


def common_to(fit: FitResult, caller: str) -> dict[str, Any]:
    """What all runs share, as `Problem` takes it. Raises OptionError where that cannot be."""
    if fit.status not in ("converged", "acceptable"):
        raise OptionError(f"{caller}: the fit has not converged ({fit.status}): {fit.message or 'see its summary'}")
    if all(e.fixed for e in fit.parameters.values()):
        raise OptionError(f"{caller}: the fit has no free parameters")
    return {
        "model": fit.model,
        "experiments": tuple(dataset(fit)),
        "transcription": fit.transcription,
        "noise": fit.noise,
        "solver": None if isinstance(fit.transcription, FilterError) else NEAR,  # which has its own
        "base": replace(fit, history=()),
    }


def run_all(
    problem: Problem,
    starts: Sequence[Mapping[str, Any]],
    executor: Any,
    progress: bool | Watch,
    caller: str,
) -> Runs:
    """Runs all starts; Ctrl-C ends it with what is there."""
    from ..starts.workers import Crew  # executors are loaded by whoever runs something

    check_progress(caller, progress)
    crew = Crew(executor, problem)
    done = gathered(crew, enumerate(starts), progress, f"{problem.model.name}: {caller}", len(starts))
    return Runs(done, len(done) == len(starts), crew.warnings)
