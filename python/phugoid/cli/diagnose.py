"""``phugoid diagnose``: what a fit says that its model misses."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from ..api import diagnose as find_missing
from ..api import load_fit
from ..diagnosis import Diagnosis
from ..errors import OptionError, PhugoidError
from ..result import Fit
from .data_files import Reading
from .estimation import Estimation
from .fit import code_of
from .guard import INTERRUPTED, NOT_CONVERGED, guard, told
from .model_file import load_source
from .options import (
    ColumnsOption,
    ConvertOption,
    DebugOption,
    FixOption,
    InputsOption,
    IterationsOption,
    JsonOption,
    ModelArgument,
    OrderOption,
    OutputsOption,
    RenameOption,
    ReportOption,
    SolverOption,
    StartOption,
    TimeOption,
    UnitsOption,
    WindowOption,
)
from .results import check_saved, check_targets, emit_json, fit_facts

__all__ = ["diagnose"]


def diagnose(
    model: ModelArgument,
    data: Annotated[
        list[Path] | None, typer.Argument(help="Data files; none where MODEL is a saved fit.", metavar="DATA...")
    ] = None,
    fit: Annotated[Path | None, typer.Option("--fit", help="A saved fit of the model to start from.")] = None,
    validation: Annotated[
        list[Path] | None, typer.Option("--validation", help="Another record, to measure the gain on.")
    ] = None,
    order: OrderOption = None,
    start: StartOption = None,
    fix: FixOption = None,
    solver: SolverOption = "newton",
    iterations: IterationsOption = None,
    time: TimeOption = "t",
    rename: RenameOption = None,
    inputs: InputsOption = None,
    outputs: OutputsOption = None,
    window: WindowOption = None,
    units: UnitsOption = None,
    convert: ConvertOption = False,
    columns: ColumnsOption = None,
    save: Annotated[
        Path | None, typer.Option("--save", help="Writes the diagnosis, for phugoid.load: .json, or .h5 (HDF5).")
    ] = None,
    report: ReportOption = None,
    json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Name what a model misses: shows the misfit, its cause among some 250 candidates, and the gain.

    Exit code 1: the fit has not converged, or the misfit stays without a cause.
    """
    with guard(debug):
        check_saved(save, "diagnosis")
        check_targets((), [save, report])
        how = Estimation.of(order, start, fix, solver, iterations)
        reading = Reading.of(time, rename, inputs, outputs, window, units, convert, columns)
        base = _base(model, reading, data or [], fit, how)
        others = reading.read(validation) if validation else None
        if base.status not in ("converged", "acceptable"):
            if json:
                emit_json("diagnose", {"fit": fit_facts(base), "findings": None})
            else:
                print(f"{base.summary()}\n\nThere is nothing to diagnose: what is missing shows at an optimum only.")
            raise typer.Exit(code_of(base) or NOT_CONVERGED)
        with _steps() as watch:
            found = find_missing(base, validation=others, progress=watch)
        written: list[Path] = []
        try:
            for path, write in ((save, found.save), (report, found.report)):
                if path is not None:
                    write(path)
                    written.append(path)
        except (PhugoidError, OSError, KeyboardInterrupt):
            if json:
                emit_json("diagnose", _facts(found), written)
            else:
                print(told(found))
            raise
        if json:
            emit_json("diagnose", _facts(found), written)
        else:
            print(told(found))
            if written:
                print(f"\nWritten: {', '.join(map(str, written))}")
    raise typer.Exit(_code(found))


def _base(model: str, reading: Reading, data: list[Path], saved: Path | None, how: Estimation) -> Fit:
    """The fit to diagnose: as saved where no data are given, else estimated, from a saved one where there is one."""
    source = load_source(model)
    before = load_fit(saved) if saved is not None else source if isinstance(source, Fit) else None
    if not data:
        if isinstance(source, Fit) and saved is None:
            if how.start or how.fixed:
                raise OptionError(f"--start and --fix are for a model that is fitted first: {model} holds a fit")
            return source
        raise OptionError(f"{model} is a model: give data files to fit it to")
    described = source.model if isinstance(source, Fit) else source
    return how.run(described, reading.read(data), before)


@contextmanager
def _steps() -> Iterator[Callable[[str], None]]:
    """What to call with each step: a status line on a terminal, else a line on stderr each."""
    if not sys.stderr.isatty():
        yield lambda text: print(f"diagnose: {text}", file=sys.stderr)
        return
    from rich.console import Console

    with Console(stderr=True).status("diagnose") as status:
        yield status.update


def _code(found: Diagnosis) -> int:
    if found.interrupted:
        return INTERRUPTED
    # A misfit of which no finding names a cause.
    return NOT_CONVERGED if found.found and not any(f.cause for f in found.findings) else 0


def _facts(found: Diagnosis) -> dict[str, Any]:
    kept = (
        "cause",
        "aliases",
        "status",
        "coefficient",
        "std_error",
        "interval",
        "unit",
        "parameters",
        "gain",
        "held_out_gain",
        "threshold",
        "explanation",
        "advice",
        "ringing",
    )
    ranking = [{"name": s.name, "statistic": s.statistic, "ranking": s.ranking} for s in found.ranking[:20]]
    return {
        "fit": fit_facts(found.fit),
        "found": found.found,
        "findings": [{key: getattr(f, key) for key in kept} for f in found.findings],
        "ranking": ranking,
        "threshold": found.threshold,
        "interrupted": found.interrupted,
        "notes": list(found.notes),
        "seconds": found.seconds,
    }
