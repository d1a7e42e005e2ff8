"""``phugoid fit``: estimates a model's parameters from data files."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from ..errors import PhugoidError
from ..result import Fit
from ..validation.result import Validation
from .data_files import Reading
from .estimation import Estimation
from .guard import INTERRUPTED, NOT_CONVERGED, guard, told
from .model_file import load_source
from .options import (
    ColumnsOption,
    ConvertOption,
    DataArgument,
    DebugOption,
    FixOption,
    InputsOption,
    IterationsOption,
    JsonOption,
    ModelArgument,
    OrderOption,
    OutputsOption,
    PlotOption,
    RenameOption,
    ReportOption,
    SolverOption,
    StartOption,
    TimeOption,
    UnitsOption,
    WindowOption,
)
from .results import check_saved, check_targets, emit_json, fit_facts, save_figures

__all__ = ["code_of", "fit"]


def fit(
    model: ModelArgument,
    data: DataArgument,
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
        Path | None, typer.Option("--save", help="Writes the fit, for phugoid.load: .json, or .h5 (HDF5).")
    ] = None,
    plot: PlotOption = None,
    report: ReportOption = None,
    json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Estimate the parameters of a model from one data file or several."""
    with guard(debug):
        check_saved(save, "fit")
        check_targets([plot], [save, report])
        how = Estimation.of(order, start, fix, solver, iterations)
        reading = Reading.of(time, rename, inputs, outputs, window, units, convert, columns)
        source = load_source(model)
        records = reading.read(data)
        # A saved fit is gone on from.
        result = how.run(source.model, records, source) if isinstance(source, Fit) else how.run(source, records)
        # Files first: whoever reads stdout may stop before its end.
        try:
            written = _write(
                result, save, plot, report, [model if Path(model).is_file() else model.rpartition(":")[0], *data]
            )
        except (PhugoidError, OSError, KeyboardInterrupt) as error:
            # The work is done: it is not lost with a full disk, nor with one more Ctrl-C.
            if isinstance(error, KeyboardInterrupt) and json:
                emit_json("fit", fit_facts(result), [save] if save is not None and save.is_file() else [])
            else:
                print(told(result))
            raise
        if json:
            emit_json("fit", fit_facts(result), written)
            raise typer.Exit(code_of(result))
        print(told(result))
        if written:
            print(f"\nWritten: {', '.join(map(str, written))}")
    raise typer.Exit(code_of(result))


def _write(
    result: Fit, save: Path | None, plot: Path | None, report: Path | None, files: Sequence[str | Path]
) -> list[Path]:
    written: list[Path] = []
    if save is not None:
        result.save(save)
        written.append(save)
    if plot is not None:
        written += save_figures(result, plot)
    if report is not None:
        written.append(write_report(result, report, files))
    return written


def write_report(result: Fit, report: Path, files: Sequence[str | Path], validation: Validation | None = None) -> Path:
    """The page, with the files that there are and the command."""
    sources = [Path(f) for f in files if Path(f).is_file()]
    result.report(report, validation=validation, files=sources, command=_command())
    return report


def _command() -> str:
    """As it was typed; nothing where another program called."""
    called = Path(sys.argv[0])
    mine = called.stem == "phugoid" or called.parent.name == "phugoid"
    return shlex.join(["phugoid", *sys.argv[1:]]) if mine else ""


def code_of(result: Fit) -> int:
    """The exit code that an estimation ends with."""
    if result.status == "interrupted":
        return INTERRUPTED
    return 0 if result.converged else NOT_CONVERGED
