"""``phugoid validate``: tries a fitted model on records that it was not fitted to."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from ..errors import OptionError, PhugoidError
from ..result import Fit
from ..validation.result import Validation
from .data_files import Reading
from .estimation import Estimation
from .fit import code_of, write_report
from .guard import NOT_CONVERGED, guard, told
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
    tolerances,
)
from .results import check_targets, emit_json, fit_facts, match_facts, save_figures

__all__ = ["validate"]


def validate(
    model: Annotated[
        str,
        typer.Argument(
            help="A saved fit (.json, .h5); or a model, which is fitted to the first data file.", metavar="MODEL"
        ),
    ],
    data: DataArgument,
    tolerance: Annotated[
        list[str] | None,
        typer.Option(
            "--tolerance",
            help="Greatest deviation of an output in its unit, as a part of what is measured (5%), or the greater of "
            "both (1.5/5%).",
            metavar="OUTPUT=VALUE",
        ),
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
    plot: PlotOption = None,
    report: ReportOption = None,
    json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Try a fitted model on other records: only initial states and sensor biases are found anew."""
    with guard(debug):
        check_targets([plot], [report])
        limits = tolerances(tolerance)
        how = Estimation.of(order, start, fix, solver, iterations)
        reading = Reading.of(time, rename, inputs, outputs, window, units, convert, columns)
        source = load_source(model)
        if isinstance(source, Fit):
            if how.start or how.fixed:
                raise OptionError(f"--start and --fix are for a model that is fitted first: {model} holds a fit")
            fit, others = source, list(data)
        else:
            if len(data) < 2:
                raise OptionError(
                    f"{model} is a model: give a data file to fit it to, and others to try it on; or a saved fit"
                )
            fit = how.run(source, reading.read(data[:1]))
            others = list(data[1:])
        if not fit.converged:
            if json:
                emit_json("validate", {**fit_facts(fit), "validation": None})
            else:
                print(f"{fit.summary()}\n\nThere is nothing to validate: the fit has not converged.")
            raise typer.Exit(code_of(fit))
        result = fit.validate(reading.read(others), tolerances=limits or None)
        written: list[Path] = []
        try:
            if plot is not None:
                written += save_figures(result, plot)
            if report is not None:
                written.append(write_report(fit, report, [model.rpartition(":")[0] or model, *data], result))
        except (PhugoidError, OSError, KeyboardInterrupt):
            _tell(result, fit, json, written)
            raise
        _tell(result, fit, json, written)
    raise typer.Exit(0 if result.converged else NOT_CONVERGED)


def _tell(result: Validation, fit: Fit, json: bool, written: Sequence[Path]) -> None:
    if json:
        emit_json("validate", {"fit": fit_facts(fit), **_facts(result)}, written)
        return
    print(told(result))
    if written:
        print(f"\nWritten: {', '.join(map(str, written))}")


def _facts(result: Validation) -> dict[str, Any]:
    inside = {n: m.inside for n, m in result.matches.items() if math.isfinite(m.inside)}
    return {
        "status": result.status,
        "converged": result.converged,
        "log_likelihood": result.log_likelihood,
        "chi_square": result.chi_square,
        "degrees_of_freedom": result.degrees_of_freedom,
        "matches": match_facts(result.matches),
        "tolerances": {n: vars(each) for n, each in result.tolerances.items()},
        "inside_tolerance": inside,
        "freed": {n: {"value": e.value, "std_error": e.std_error} for n, e in result.freed.items()},
        "warnings": list(result.warnings),
    }
