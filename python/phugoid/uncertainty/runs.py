"""Many estimations about a fit, here or on an executor, with progress, and what is there after Ctrl-C."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from ..errors import OptionError
from ..fit_result import FitResult
from ..sensitivities.collocated import dataset
from ..solvers import Newton
from ..solvers.limits import Deadline
from ..starts.collect import Watch, check_progress, collect
from ..starts.outcome import Outcome, Problem
from ..transcription.filter_error import FilterError
from ..transcription.shooting import Transcription

__all__ = ["NEAR", "Runs", "common_to", "run_all"]


NEAR = Newton(regression=False)
"""The solver: the path is known, so there is no need of a regression on measured states."""


@dataclass(frozen=True)
class Runs:
    """What came of the runs: outcomes by number, "complete" where all are there or else why not, and what went wrong
    with workers."""

    outcomes: Mapping[int, Outcome]
    status: str
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
        "transcription": _without_limit(fit.transcription),
        "noise": fit.noise,
        "solver": None if isinstance(fit.transcription, FilterError) else NEAR,  # which has its own
        "base": replace(fit, history=()),
    }


def _without_limit(transcription: Transcription | FilterError) -> Transcription | FilterError:
    """A limit was that of the fit itself."""
    return replace(transcription, time_limit=None) if isinstance(transcription, FilterError) else transcription


def run_all(
    problem: Problem,
    starts: Sequence[Mapping[str, Any]],
    executor: Any,
    progress: bool | Watch,
    caller: str,
    deadline: Deadline,
) -> Runs:
    """Runs all starts; Ctrl-C and the deadline end it with what is there."""
    from ..starts.workers import Crew  # executors are loaded by whoever runs something

    check_progress(caller, progress)
    crew = Crew(executor, problem)
    with deadline.in_force():
        done = collect(crew, enumerate(starts), progress, f"{problem.model.name}: {caller}", len(starts))
    return Runs(done, "complete" if len(done) == len(starts) else deadline.ended(), crew.warnings)
