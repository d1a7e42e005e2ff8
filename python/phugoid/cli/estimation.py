"""The options of an estimation, as the commands take them."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Annotated, Any

from typer import Option

from ..api import estimate
from ..data.experiment import Experiment
from ..errors import ModelError, OptionError, listing
from ..modelling.model import Model
from ..progress import Progress
from ..result import Fit
from ..solvers import Ipopt, Newton
from ..solvers.solution import Iteration
from ..transcription.collocation import Collocation
from ..transcription.filter_error import FilterError
from ..transcription.shooting import Transcription
from .options import fixes, numbers

__all__ = ["Estimation"]


@contextmanager
def progress_bar(title: str, limit: int) -> Iterator[Callable[[Iteration], None]]:
    """Yield a function to call with each iteration: a bar on a terminal, else one line for every tenth iteration.

    The bar ends at ``limit`` iterations; most runs converge long before.
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


_SOLVERS: Mapping[str, type[Newton] | type[Ipopt]] = {"newton": Newton, "ipopt": Ipopt}


@dataclass(frozen=True)
class Estimation:
    """Hold the options of an estimation, as texts. Raises OptionError for invalid ones."""

    order: Annotated[
        int | None,
        Option("--order", help="Points of a collocation segment, 2 is the trapezoid; default: 4, or the saved fit's."),
    ] = None
    start: Annotated[
        list[str] | None, Option("--start", help="Start value of a parameter or state.", metavar="NAME=VALUE")
    ] = None
    fix: Annotated[
        list[str] | None,
        Option("--fix", help="Fixes a parameter at its start, or at a value.", metavar="NAME[=VALUE]"),
    ] = None
    solver: Annotated[str, Option("--solver", help="newton or ipopt.", metavar="NAME")] = "newton"
    iterations: Annotated[
        int | None, Option("--iterations", help="The most iterations; default: the solver's.", metavar="N")
    ] = None

    def __post_init__(self) -> None:
        self._solver()
        self._values()

    def _solver(self) -> Newton | Ipopt:
        if self.solver not in _SOLVERS:
            raise OptionError(f"--solver: there is no '{self.solver}'.{listing(self.solver, _SOLVERS)}")
        kind = _SOLVERS[self.solver]
        return kind() if self.iterations is None else kind(max_iterations=self.iterations)

    def _values(self) -> tuple[dict[str, float], dict[str, float | None]]:
        """Return the start values, and the fixed parameters: name -> value, or None for the declared start."""
        start = numbers("--start", self.start)
        return start, fixes(self.fix, start)

    def check_unused(self, source: str) -> None:
        """Raise OptionError for options that do not apply to a saved fit."""
        if self.start or self.fix:
            raise OptionError(f"--start and --fix are for a model that is fitted first: {source} holds a fit")

    def run(self, model: Model, data: Sequence[Experiment], before: Fit | None = None) -> Fit:
        """Estimate with progress on stderr; continue from the fit ``before``, with its noise, where there is one."""
        start, fixed = self._values()
        solver = self._solver()
        model = _with_fixed(model, fixed)
        begin: dict[str, Any] = {} if before is None else dict(before.as_start(before.noise))
        begin = {n: v for n, v in {**begin, **start}.items() if n.partition("[")[0] not in fixed}
        mesh: Transcription | FilterError = Collocation(order=4 if self.order is None else self.order)
        if before is not None and self.order is None:
            mesh = before.transcription
        with progress_bar(model.name, solver.max_iterations) as watch:
            return estimate(
                model,
                data,
                transcription=mesh,
                noise=None if before is None else before.noise,
                start=begin,
                solver=None if isinstance(mesh, FilterError) else solver,  # the filter-error method has its own
                progress=watch,
            )


def _with_fixed(model: Model, fixed: Mapping[str, float | None]) -> Model:
    """Return the model with parameters fixed at values, or (None) at their declared starts."""
    declared, changes = model.declared_parameters, {}
    for name, value in fixed.items():
        if name not in declared:
            raise ModelError(f"--fix: '{name}' is no parameter.{listing(name, model.parameter_names)}")
        low, high = declared[name].bounds
        if value is not None and not low <= value <= high:
            raise ModelError(f"--fix: {name} = {value:g} lies outside its bounds ({low:g}, {high:g})")
        changes[name] = replace(declared[name], start=declared[name].start if value is None else value, fixed=True)
    return model.with_parameters(changes)
