"""Progress of an estimation, on stderr."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from ..progress import Progress
from ..solvers.solution import Iteration

__all__ = ["bar"]


@contextmanager
def bar(title: str, limit: int) -> Iterator[Callable[[Iteration], None]]:
    """What to call with each iteration: a bar of at most ``limit`` iterations on a terminal, else a line every tenth.

    Iterations end where the optimum is, mostly long before the limit.
    """
    if not sys.stderr.isatty():
        with Progress.of(True, title) as watch:
            assert watch is not None
            yield watch
        return
    from rich.console import Console
    from rich.progress import BarColumn, SpinnerColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bars

    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        BarColumn(20),
        TextColumn("iteration {task.completed}/{task.total}"),
        TextColumn("{task.fields[now]}"),
        TimeElapsedColumn(),
    )
    with Bars(*columns, console=Console(stderr=True), transient=True) as bars:
        task = bars.add_task(title, total=limit, now="")

        def show(line: Iteration) -> None:
            bars.update(task, completed=line.number, now=f"logL {line.log_likelihood:.4f}")

        yield show
