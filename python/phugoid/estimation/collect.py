"""Outcomes of many runs as they come in, here or on an executor: shown, kept, and there after Ctrl-C."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeAlias

from ..errors import OptionError, check_progress
from ..filter_error import FilterError
from ..fit_result import ENDED_WELL, FitResult, dataset
from ..solvers import Newton
from ..solvers.solution import Deadline, interrupts
from ..transcription import Transcription
from .starts import Outcome, Problem

if TYPE_CHECKING:
    from .workers import Crew

__all__ = ["NEAR", "Runs", "Watch", "collect", "common_to", "run_all"]

Watch: TypeAlias = Callable[[Outcome], None]


def collect(
    crew: Crew,
    work: Iterable[tuple[int, Mapping[str, Any]]],
    progress: bool | Watch,
    title: str,
    total: int,
    *,
    known: Mapping[int, Outcome] | None = None,
    keep: Watch | None = None,
    best: bool = False,
) -> dict[int, Outcome]:
    """Return the outcomes by number, in order; Ctrl-C and the time limit end the work with the outcomes so far.

    ``known``: outcomes that are there already, among ``total``. ``keep`` is called with each new one before it is
    shown. ``best``: the bar shows the greatest log-likelihood.
    """
    done = dict(known or {})
    with _watching(progress, title, total, tuple(done.values()), best) as watch, closing(crew.outcomes(work)) as coming:
        try:
            for outcome in coming:
                if keep is not None:
                    keep(outcome)
                done[outcome.index] = outcome
                watch(outcome)
        except KeyboardInterrupt:
            with interrupts():  # one more, while workers are dismissed, loses nothing
                coming.close()
    return {i: done[i] for i in sorted(done)}


@contextmanager
def _watching(progress: bool | Watch, title: str, total: int, done: tuple[Outcome, ...], best: bool) -> Iterator[Watch]:
    """Return what is called with each outcome: nothing, our bar, or the user's own function."""
    if callable(progress):
        yield progress
        return
    if not progress:
        yield lambda outcome: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    reached = [o.log_likelihood for o in done if o.at_optimum]
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, TextColumn("{task.fields[best]}"), console=Console(stderr=True)) as bar:
        task = bar.add_task(title, total=total, completed=len(done), best="")

        def advance(outcome: Outcome) -> None:
            if outcome.at_optimum:
                reached[:] = [max([*reached, outcome.log_likelihood])]
            bar.update(task, advance=1, best=f"best logL {reached[0]:.3f}" if best and reached else "")

        yield advance


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
    """Return what all runs share, as `Problem` takes it. Raises OptionError where they cannot share it."""
    if fit.status not in ENDED_WELL:
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
    """Return the transcription without its time limit, which was that of the fit itself."""
    return replace(transcription, time_limit=None) if isinstance(transcription, FilterError) else transcription


def run_all(
    problem: Problem,
    starts: Sequence[Mapping[str, Any]],
    executor: Any,
    progress: bool | Watch,
    caller: str,
    deadline: Deadline,
) -> Runs:
    """Run all starts; Ctrl-C and the deadline end it with the outcomes so far."""
    from .workers import Crew

    check_progress(caller, progress)
    crew = Crew(executor, problem)
    with deadline.in_force():
        done = collect(crew, enumerate(starts), progress, f"{problem.model.name}: {caller}", len(starts))
    return Runs(done, "complete" if len(done) == len(starts) else deadline.ended(), crew.warnings)
