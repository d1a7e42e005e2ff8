"""Outcomes of many runs as they come in: shown, kept, and there after Ctrl-C."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing, contextmanager
from typing import TYPE_CHECKING, Any, TypeAlias

from ..errors import OptionError
from ..interrupts import interrupts
from .outcome import Outcome

if TYPE_CHECKING:
    from .workers import Crew

__all__ = ["Watch", "check_progress", "collect"]

Watch: TypeAlias = Callable[[Outcome], None]


def check_progress(caller: str, progress: Any) -> None:
    """Raises OptionError, in the caller's name, for what is neither a truth value nor a function."""
    if not isinstance(progress, bool) and not callable(progress):
        raise OptionError(f"{caller}: progress is True, False or a function, not {progress!r}")


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
    """Number -> outcome of all work, in order; Ctrl-C and the limit in force end it with what is there.

    ``known``: outcomes that are there already, among ``total``. ``keep`` is called with each new one before it is
    shown. ``best``: the bar tells the greatest log-likelihood.
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
    """What to call with each outcome: nothing, our bar, or the user's own function."""
    if callable(progress):
        yield progress
        return
    if not progress:
        yield lambda outcome: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    reached = [o.log_likelihood for o in done if o.converged]
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, TextColumn("{task.fields[best]}"), console=Console(stderr=True)) as bar:
        task = bar.add_task(title, total=total, completed=len(done), best="")

        def advance(outcome: Outcome) -> None:
            if outcome.converged:
                reached[:] = [max([*reached, outcome.log_likelihood])]
            bar.update(task, advance=1, best=f"best logL {reached[0]:.3f}" if best and reached else "")

        yield advance
