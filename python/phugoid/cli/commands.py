"""The commands on a model: ``fit``, ``validate``, ``diagnose``, and ``simulate`` over the inputs of a data file."""

from __future__ import annotations

import csv
import math
import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TextIO

import typer

from ..api import load_fit
from ..errors import ModelError, OptionError, listing
from ..fit_result import ENDED_WELL
from ..goodness_of_fit import match
from ..modelling.model import Model
from ..records import Record
from ..result import Fit
from ..saving.files import SUFFIXES
from ..simulation import simulate as integrate
from ..time_unit import time_unit_of
from ..validation import Validation
from ..writing import write
from .model_file import load_source
from .options import (
    DataArgument,
    Estimation,
    JsonOption,
    ModelArgument,
    PlotOption,
    Reading,
    ReportOption,
    numbers,
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

__all__ = ["code_of", "diagnose", "fit", "simulate", "validate", "write_report"]


def fit(
    model: ModelArgument,
    data: DataArgument,
    how: Estimation,
    reading: Reading,
    save: Annotated[
        Path | None, typer.Option("--save", help="Save the fit (.json, .h5); phugoid.load reads it.", metavar="FILE")
    ] = None,
    plot: PlotOption = None,
    report: ReportOption = None,
    json: JsonOption = False,
) -> int:
    """Estimate the parameters of a model from one or more data files."""
    check_saved(save, "fit")
    check_targets([plot], [save], report)
    source = load_source(model)
    records = reading.read(data, source)
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
            help="Largest deviation that an output may have: in its unit (1.5), in per cent of the measured "
            "value (5%), or the greater of both (1.5/5%).",
            metavar="OUTPUT=VALUE",
        ),
    ] = None,
    initial_samples: Annotated[
        int | None,
        typer.Option(
            "--initial-samples",
            help="Estimate initial states and biases from the first N samples alone, and simulate the rest.",
            metavar="N",
        ),
    ] = None,
    *,
    how: Estimation,
    reading: Reading,
    plot: PlotOption = None,
    report: ReportOption = None,
    json: JsonOption = False,
) -> int:
    """Validate a fitted model on other records.

    Only initial states and sensor biases are re-estimated; all other parameters stay as fitted.
    """
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
        fit = how.run(source, reading.read(data[:1], source))
        others = list(data[1:])
    if not fit.converged:
        if json:
            emit_json("validate", {**fit_facts(fit), "validation": None})
        else:
            print(f"{fit.summary()}\n\nThere is nothing to validate: the fit has not converged.")
        return code_of(fit)
    records = reading.read(others, fit)
    result = fit.validate(records, tolerances=limits or None, initial_samples=initial_samples, progress=True)
    page = partial(write_report, fit, files=[model.rpartition(":")[0] or model, *data], validation=result)
    writers: list[Callable[[], list[Path]]] = [partial(save_figures, result, plot), saved(page, report)]
    finish("validate", result, partial(_validation_facts, fit, result) if json else None, writers)
    return code_of(result)


def _validation_facts(fit: Fit, result: Validation) -> dict[str, Any]:
    inside = {n: m.inside for n, m in result.matches.items() if math.isfinite(m.inside)}
    biases = {n: {"value": e.value, "std_error": e.std_error} for n, e in result.re_estimated.items()}
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
        "re_estimated": biases,
        "freed": biases,  # until the next release
        "warnings": list(result.warnings),
    }


def diagnose(
    model: ModelArgument,
    data: Annotated[
        list[Path] | None, typer.Argument(help="Data files; none where MODEL is a saved fit.", metavar="DATA")
    ] = None,
    fit: Annotated[
        Path | None, typer.Option("--fit", help="Saved fit from which the estimation starts.", metavar="FILE")
    ] = None,
    validation: Annotated[
        list[Path] | None,
        typer.Option(
            "--validation",
            help="Data file held out of the estimation, on which the gain is computed (several times).",
            metavar="FILE",
        ),
    ] = None,
    *,
    how: Estimation,
    reading: Reading,
    save: Annotated[
        Path | None,
        typer.Option("--save", help="Save the diagnosis (.json, .h5); phugoid.load reads it.", metavar="FILE"),
    ] = None,
    report: ReportOption = None,
    json: JsonOption = False,
) -> int:
    """Find physical effects that a fitted model misses.

    Some 250 candidates are compared, the model is extended by those that are named, and the gain is reported.

    Exit code 1: the fit has not converged, or the residuals have structure and no cause is named.
    """
    check_saved(save, "diagnosis")
    check_targets((), [save], report)
    base = _base(model, reading, data or [], fit, how)
    others = reading.read(validation, base) if validation else None
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
    return how.run(described, reading.read(data, described), before)


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
        "explained_in",
        "explained_interval",
        "explained_another",
        "explained_outputs",
        "alternatives_explained",
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
        "findings": [
            # The last name until the next release.
            {**{key: getattr(f, key) for key in kept}, "rivals_explained": f.alternatives_explained}
            for f in found.findings
        ],
        "ranking": ranking,
        "threshold": found.threshold,
        "interrupted": found.interrupted,
        "notes": list(found.notes),
        "seconds": found.seconds,
    }


def simulate(
    model: ModelArgument,
    data: Annotated[Path, typer.Argument(help="Data file with time and inputs.", metavar="DATA")],
    parameters: Annotated[
        list[str] | None,
        typer.Option("--parameters", help="A saved fit, or values (several times).", metavar="FIT.json|NAME=VALUE"),
    ] = None,
    initial: Annotated[
        list[str] | None,
        typer.Option(
            "--initial", help="Initial state; default: as in the fit, as measured, or 0.", metavar="NAME=VALUE"
        ),
    ] = None,
    *,
    reading: Reading,
    out: Annotated[
        Path | None, typer.Option("--out", help="Write the CSV to this file instead of stdout.", metavar="FILE")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Simulate a model with the inputs of a data file.

    The result is a CSV of time, inputs, outputs and states.
    """
    check_targets((), [out])
    source = load_source(model)
    described = source.model if isinstance(source, Fit) else source
    (experiment,) = reading.read([data], source)
    fit, values = _parameters(described, source if isinstance(source, Fit) else None, parameters)
    first = _first(described, fit, experiment.name, numbers("--initial", initial))
    record = integrate(described, values, experiment, initial=first)
    written = []
    if out is not None:
        table = StringIO(newline="")
        _write(record, table)
        write(out, table.getvalue(), "the table")
        written.append(out)
    measured = {name: match(record, name) for name in record.measured}
    if json:
        facts = {"model": described.name, "record": record.name, "samples": record.n}
        series = {} if out is not None else {"columns": _columns(record)}
        emit_json("simulate", {**facts, "matches": match_facts(measured), **series}, written)
    elif out is None:
        _write(record, sys.stdout)
    else:
        print(f"{described.name}: {record.n} samples of '{record.name}'")
        for m in measured.values():
            print(f"  {m.output}: RMS of measured minus simulated {m.rms:.4g} {m.unit}".rstrip())
        print(f"\nWritten: {out}")


def _parameters(
    model: Model, fit: Fit | None, given: Sequence[str] | None
) -> tuple[Fit | None, Mapping[str, Any] | Fit]:
    """Return the fit whose initial states apply, and the parameter values: those given by name override those of the
    fit."""
    files = [text for text in given or () if "=" not in text]
    if len(files) > 1:
        raise OptionError(f"--parameters: one saved fit, not {len(files)}")
    if files and not files[0].lower().endswith((".json", *SUFFIXES)):
        raise OptionError(f"--parameters: '{files[0]}' is neither a saved fit (.json, .h5) nor of the form NAME=VALUE")
    fit = load_fit(files[0]) if files else fit
    values = numbers("--parameters", [text for text in given or () if "=" in text])
    for name in values:
        known = [*dict.fromkeys([*model.parameter_names, *(fit.parameters if fit is not None else ())])]
        if name not in known:
            raise ModelError(f"--parameters: '{name}' is not a parameter.{listing(name, known)}")
    if fit is not None:
        return (fit, fit) if not values else (fit, {**fit.as_start(), **values})
    # Only fixed parameters have a declared value; the start of an estimation is not one.
    fixed = {name: p.start for name, p in model.declared_parameters.items() if p.fixed}
    found = {**fixed, **values}
    missing = [name for name in model.parameter_names if name not in found]
    if missing:
        raise ModelError(
            f"no value was given for {', '.join(missing)}: give --parameters fit.json, or --parameters {missing[0]}=..."
        )
    return None, found


def _first(model: Model, fit: Fit | None, experiment: str, given: Mapping[str, float]) -> dict[str, float]:
    for name in given:
        if name not in model.state_names:
            raise ModelError(f"--initial: '{name}' is not a state.{listing(name, model.state_names)}")
    of_fit = fit.initial_states.get(experiment) if fit is not None else None
    return {**({name: e.value for name, e in of_fit.items()} if of_fit is not None else {}), **given}


def _columns(record: Record) -> dict[str, list[float]]:
    """Return time, inputs, outputs, and the states that are not outputs of the same name."""
    groups = {**record.states, **record.inputs, **record.outputs}
    order = dict.fromkeys([*record.inputs, *record.outputs, *record.states])
    return {"t": record.t.tolist(), **{name: groups[name].tolist() for name in order}}


def _write(record: Record, file: TextIO) -> None:
    """Write a CSV, with units in its header, that `read` reads back to the last bit."""
    columns = _columns(record)
    units = {"t": time_unit_of(record.units), **record.units}
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow([f"{name} [{units[name]}]" if units.get(name) else name for name in columns])
    writer.writerows(zip(*(map(repr, values) for values in columns.values()), strict=True))
