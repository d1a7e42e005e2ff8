"""``phugoid validate``: validates a fitted model on records that it was not fitted to."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from ..errors import OptionError
from ..result import Fit
from ..validation.result import Validation
from .estimation import Estimation
from .fit import code_of, write_report
from .guard import NOT_CONVERGED
from .model_file import load_source
from .options import DataArgument, JsonOption, PlotOption, Reading, ReportOption, tolerances
from .results import check_targets, emit_json, finish, fit_facts, match_facts, save_figures, saved

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
    *,
    how: Estimation,
    reading: Reading,
    plot: PlotOption = None,
    report: ReportOption = None,
    json: JsonOption = False,
) -> int:
    """Validate a fitted model on other records: only initial states and sensor biases are re-estimated."""
    check_targets([plot], report=report)
    limits = tolerances(tolerance)
    source = load_source(model)
    if isinstance(source, Fit):
        how.check_unused(model)
        fit, others = source, list(data)
    else:
        if len(data) < 2:
            raise OptionError(
                f"{model} is a model: give a data file to fit it to, and others to validate it on; or a saved fit"
            )
        fit = how.run(source, reading.read(data[:1]))
        others = list(data[1:])
    if not fit.converged:
        if json:
            emit_json("validate", {**fit_facts(fit), "validation": None})
        else:
            print(f"{fit.summary()}\n\nThere is nothing to validate: the fit has not converged.")
        return code_of(fit)
    result = fit.validate(reading.read(others), tolerances=limits or None)
    page = partial(write_report, fit, files=[model.rpartition(":")[0] or model, *data], validation=result)
    writers: list[Callable[[], list[Path]]] = [partial(save_figures, result, plot), saved(page, report)]
    finish("validate", result, partial(_facts, fit, result) if json else None, writers)
    return 0 if result.converged else NOT_CONVERGED


def _facts(fit: Fit, result: Validation) -> dict[str, Any]:
    inside = {n: m.inside for n, m in result.matches.items() if math.isfinite(m.inside)}
    return {
        "fit": fit_facts(fit),
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
