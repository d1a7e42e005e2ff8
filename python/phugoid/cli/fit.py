"""The commands that end in a fit: ``phugoid fit``, ``validate`` and ``diagnose``."""

from __future__ import annotations

import math
import shlex
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..api import load_fit
from ..errors import OptionError
from ..fit_result import ENDED_WELL
from ..result import Fit
from ..validation import Validation
from .model_file import load_source
from .options import (
    DataArgument,
    Estimation,
    JsonOption,
    ModelArgument,
    PlotOption,
    Reading,
    ReportOption,
    tolerances,
)
from .results import (
    INTERRUPTED,
    NOT_CONVERGED,
    check_saved,
    check_targets,
    emit_json,
    finish,
    fit_facts,
    match_facts,
    save_figures,
    saved,
)

if TYPE_CHECKING:
    from ..diagnosis import Diagnosis

__all__ = ["code_of", "diagnose", "fit", "validate", "write_report"]


def fit(
    model: ModelArgument,
    data: DataArgument,
    how: Estimation,
    reading: Reading,
    save: Annotated[
        Path | None, typer.Option("--save", help="Save the fit, to be read by phugoid.load (.json, .h5).")
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


def code_of(result: Fit | Validation) -> int:
    """Return the exit code for the status of an estimation or a validation."""
    if result.status == "interrupted":
        return INTERRUPTED
    return 0 if result.converged else NOT_CONVERGED


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
    records = reading.read(others)
    result = fit.validate(records, tolerances=limits or None, progress=True)
    page = partial(write_report, fit, files=[model.rpartition(":")[0] or model, *data], validation=result)
    writers: list[Callable[[], list[Path]]] = [partial(save_figures, result, plot), saved(page, report)]
    finish("validate", result, partial(_validation_facts, fit, result) if json else None, writers)
    return code_of(result)


def _validation_facts(fit: Fit, result: Validation) -> dict[str, Any]:
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


def diagnose(
    model: ModelArgument,
    data: Annotated[
        list[Path] | None, typer.Argument(help="Data files; none where MODEL is a saved fit.", metavar="DATA...")
    ] = None,
    fit: Annotated[Path | None, typer.Option("--fit", help="Saved fit from which the estimation starts.")] = None,
    validation: Annotated[
        list[Path] | None, typer.Option("--validation", help="Record held out, on which the gain is computed.")
    ] = None,
    *,
    how: Estimation,
    reading: Reading,
    save: Annotated[
        Path | None, typer.Option("--save", help="Save the diagnosis, to be read by phugoid.load (.json, .h5).")
    ] = None,
    report: ReportOption = None,
    json: JsonOption = False,
) -> int:
    """Name the cause of a model's misfit, among some 250 candidates, and the gain of the extended model.

    Exit code 1: the fit has not converged, or the residuals have structure and no cause is named.
    """
    check_saved(save, "diagnosis")
    check_targets((), [save], report)
    base = _base(model, reading, data or [], fit, how)
    others = reading.read(validation) if validation else None
    if base.status not in ENDED_WELL:
        if json:
            emit_json("diagnose", {"fit": fit_facts(base), "findings": None})
        else:
            print(f"{base.summary()}\n\nThere is nothing to diagnose: a diagnosis needs a converged fit.")
        return code_of(base) or NOT_CONVERGED
    found = base.diagnose(validation=others, progress=True)
    writers = [saved(found.save, save), saved(found.report, report)]
    finish("diagnose", found, partial(_diagnosis_facts, found) if json else None, writers)
    return _code(found)


def _base(model: str, reading: Reading, data: list[Path], saved: Path | None, how: Estimation) -> Fit:
    """Return the fit to diagnose: the saved one where no data are given, else one estimated from the data, with a saved
    fit as start."""
    source = load_source(model)
    before = load_fit(saved) if saved is not None else source if isinstance(source, Fit) else None
    if not data:
        if isinstance(source, Fit) and saved is None:
            how.check_unused(model)
            return source
        raise OptionError(f"{model} is a model: give data files to fit it to")
    described = source.model if isinstance(source, Fit) else source
    return how.run(described, reading.read(data), before)


def _code(found: Diagnosis[Fit]) -> int:
    if found.interrupted:
        return INTERRUPTED
    return NOT_CONVERGED if found.verdict == "unexplained" else 0


def _diagnosis_facts(found: Diagnosis[Fit]) -> dict[str, Any]:
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
        "explained",
        "explained_interval",
        "explained_outputs",
        "rivals_explained",
        "threshold",
        "explanation",
        "advice",
        "ringing",
    )
    ranking = [{"name": s.name, "statistic": s.statistic, "ranking": s.ranking} for s in found.ranking[:20]]
    return {
        "fit": fit_facts(found.fit),
        "found": found.found,
        "verdict": found.verdict,
        "findings": [{key: getattr(f, key) for key in kept} for f in found.findings],
        "ranking": ranking,
        "threshold": found.threshold,
        "interrupted": found.interrupted,
        "notes": list(found.notes),
        "seconds": found.seconds,
    }
