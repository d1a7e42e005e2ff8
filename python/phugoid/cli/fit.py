"""``phugoid fit``: estimates a model's parameters from data files."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from ..result import Fit
from ..validation.result import Validation
from .estimation import Estimation
from .guard import INTERRUPTED, NOT_CONVERGED
from .model_file import load_source
from .options import DataArgument, JsonOption, ModelArgument, PlotOption, Reading, ReportOption
from .results import check_saved, check_targets, finish, fit_facts, save_figures, saved

__all__ = ["code_of", "fit", "write_report"]


def fit(
    model: ModelArgument,
    data: DataArgument,
    how: Estimation,
    reading: Reading,
    save: Annotated[
        Path | None, typer.Option("--save", help="Writes the fit, for phugoid.load: .json, or .h5 (HDF5).")
    ] = None,
    plot: PlotOption = None,
    report: ReportOption = None,
    json: JsonOption = False,
) -> int:
    """Estimate the parameters of a model from one data file or several."""
    check_saved(save, "fit")
    check_targets([plot], [save], report)
    source = load_source(model)
    records = reading.read(data)
    # The estimation continues from a saved fit.
    result = how.run(source.model, records, source) if isinstance(source, Fit) else how.run(source, records)
    files: list[str | Path] = [model if Path(model).is_file() else model.rpartition(":")[0], *data]
    finish(
        "fit",
        result,
        partial(fit_facts, result) if json else None,
        [
            saved(result.save, save),
            partial(save_figures, result, plot),
            saved(partial(write_report, result, files=files), report),
        ],
    )
    return code_of(result)


def write_report(
    result: Fit, report: Path, *, files: Sequence[str | Path], validation: Validation | None = None
) -> None:
    """Write the report page, with the source files that exist and the command line."""
    sources = [Path(f) for f in files if Path(f).is_file()]
    result.report(report, validation=validation, files=sources, command=_command())


def _command() -> str:
    """Return the command line as typed; "" where another program called."""
    called = Path(sys.argv[0])
    is_command = called.stem == "phugoid" or called.parent.name == "phugoid"
    return shlex.join(["phugoid", *sys.argv[1:]]) if is_command else ""


def code_of(result: Fit) -> int:
    """Return the exit code for the status of an estimation."""
    if result.status == "interrupted":
        return INTERRUPTED
    return 0 if result.converged else NOT_CONVERGED
