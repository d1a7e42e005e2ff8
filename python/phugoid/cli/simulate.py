"""``phugoid simulate``: simulates a model with given parameters over the inputs of a data file."""

from __future__ import annotations

import csv
import sys
from collections.abc import Mapping, Sequence
from io import StringIO
from pathlib import Path
from typing import Annotated, Any, TextIO

import typer

from ..api import load_fit
from ..errors import ModelError, OptionError, listing
from ..goodness_of_fit import match
from ..modelling.model import Model
from ..records import Record
from ..result import Fit
from ..saving.files import SUFFIXES
from ..simulation import simulate as integrate
from ..writing import write
from .model_file import load_source
from .options import JsonOption, ModelArgument, Reading, numbers
from .results import check_targets, emit_json, match_facts

__all__ = ["simulate"]


def simulate(
    model: ModelArgument,
    data: Annotated[Path, typer.Argument(help="Data file with time and inputs.", metavar="DATA")],
    parameters: Annotated[
        list[str] | None,
        typer.Option("--parameters", help="A saved fit, or values (several times).", metavar="FIT.json|NAME=VALUE"),
    ] = None,
    initial: Annotated[
        list[str] | None,
        typer.Option("--initial", help="Initial state, NAME=VALUE; default: as in the fit, as measured, or 0."),
    ] = None,
    *,
    reading: Reading,
    out: Annotated[Path | None, typer.Option("--out", help="Write the CSV to this file instead of stdout.")] = None,
    json: JsonOption = False,
) -> None:
    """Simulate a model over the inputs of a data file: a CSV of time, inputs, outputs and states."""
    check_targets((), [out])
    source = load_source(model)
    described = source.model if isinstance(source, Fit) else source
    (experiment,) = reading.read([data])
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
    units = {"t": "s", **record.units}
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow([f"{name} [{units[name]}]" if units.get(name) else name for name in columns])
    writer.writerows(zip(*(map(repr, values) for values in columns.values()), strict=True))
