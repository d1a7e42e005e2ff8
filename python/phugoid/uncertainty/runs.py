"""Many estimations about a fit, here or on an executor, with progress, and what is there after Ctrl-C."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from typing import Any

from ..discrepancy.linearised import dataset
from ..errors import OptionError
from ..filter_error import FilterError
from ..outcome import Outcome, Problem
from ..result import Fit
from ..solvers import Newton
from ..workers import Crew

__all__ = ["NEAR", "Runs", "common_to", "run_all"]

Watch = Callable[[Outcome], None]

NEAR = Newton(regression=False)
"""The solver: the path is known, so there is no need of a regression on measured states."""


@dataclass(frozen=True)
class Runs:
    """What came of the runs: outcomes by number, whether all are there, and what went wrong with workers."""

    outcomes: Mapping[int, Outcome]
    complete: bool
    warnings: tuple[str, ...]


def common_to(fit: Fit, caller: str) -> dict[str, Any]:
    """What all runs share, as `Problem` takes it. Raises OptionError where that cannot be."""
    if isinstance(fit.transcription, FilterError):
        raise OptionError(f"{caller}: is not offered for fits with process noise (FilterError)")
    if fit.status not in ("converged", "acceptable"):
        raise OptionError(f"{caller}: the fit has not converged ({fit.status}): {fit.message or 'see its summary'}")
    if all(e.fixed for e in fit.parameters.values()):
        raise OptionError(f"{caller}: the fit has no free parameters")
    return {
        "model": fit.model,
        "experiments": tuple(dataset(fit)),
        "transcription": fit.transcription,
        "noise": fit.noise,
        "solver": NEAR,
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
    if not isinstance(progress, bool) and not callable(progress):
        raise OptionError(f"{caller}: progress is True, False or a function, not {progress!r}")
    crew = Crew(executor, problem)
    done: dict[int, Outcome] = {}
    title = f"{problem.model.name}: {caller}"
    with _watching(progress, title, len(starts)) as watch, closing(crew.outcomes(enumerate(starts))) as coming:
        try:
            for outcome in coming:
                done[outcome.index] = outcome
                watch(outcome)
        except KeyboardInterrupt:
            pass
    return Runs({i: done[i] for i in sorted(done)}, len(done) == len(starts), crew.warnings)


@contextmanager
def _watching(progress: bool | Watch, title: str, total: int) -> Iterator[Watch]:
    """What to call with each outcome: nothing, a bar, or the user's own function."""
    if callable(progress):
        yield progress
        return
    if not progress:
        yield lambda outcome: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(title, total=total)
        yield lambda outcome: bar.update(task, advance=1)
