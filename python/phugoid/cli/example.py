"""``phugoid example``: writes a packaged model file and simulated records to try the other commands on."""

from __future__ import annotations

import csv
import textwrap
from io import StringIO
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from ..errors import OptionError
from ..modelling.model import Model
from ..writing import write
from .model_file import load_model
from .options import JsonOption
from .packaged import EXAMPLES, Example, example_of
from .results import emit_json

__all__ = ["EXAMPLES", "example"]


def example(
    name: Annotated[str | None, typer.Argument(help="Which; --list shows them.", metavar="NAME")] = None,
    folder: Annotated[Path, typer.Option("--out", help="Folder to write into; it is made.")] = Path(),
    every: Annotated[bool, typer.Option("--list", help="Shows the examples there are.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Writes over files that are there.")] = False,
    json: JsonOption = False,
) -> None:
    """Write an example, a model file and two simulated records, and say which commands to run on it."""
    if every:
        if json:
            emit_json("example", {"examples": {e.name: e.about for e in EXAMPLES.values()}})
        else:
            width = max(map(len, EXAMPLES))
            print("\n".join(f"{e.name.ljust(width)}  {e.about}" for e in EXAMPLES.values()))
        return
    if name is None:
        raise OptionError(f"which example? There are: {', '.join(EXAMPLES)}")
    chosen = example_of(name)
    file = folder / f"{name}.py"
    records = [folder / f"{name}.csv", folder / f"{name}_other.csv"]
    there = [str(p) for p in (file, *records) if p.exists()]
    if there and not force:
        raise OptionError(f"{', '.join(there)} would be written over; give --force, or --out for another folder")
    folder.mkdir(parents=True, exist_ok=True)
    write(file, chosen.text)
    model = load_model(str(file))
    for which, path in enumerate(records):
        _write(chosen, model, which, path)
    commands = _commands(file, *records)
    if json:
        facts = {"example": name, "look_for": chosen.look, "commands": commands}
        emit_json("example", facts, [file, *records])
    else:
        print(f"{chosen.about}\n\nWritten: {', '.join(map(str, [file, *records]))}\n\nNow try:")
        print("\n".join(f"  {line}" for line in commands))
        print(f"\nWhat to look for:\n{textwrap.fill(chosen.look, 76, initial_indent='  ', subsequent_indent='  ')}")


def _commands(file: Path, data: Path, other: Path) -> list[str]:
    fit, page, missing, out = (
        file.with_name(f"{file.stem}{end}") for end in ("_fit.json", "_fit.html", "_missing.html", "_simulated.csv")
    )
    return [
        f"phugoid fit {file} {data} --save {fit} --report {page}",
        f"phugoid validate {fit} {other}",
        f"phugoid simulate {file} {other} --parameters {fit} --out {out}",
        f"phugoid diagnose {fit} --validation {other} --report {missing}",
    ]


def _write(chosen: Example, model: Model, which: int, path: Path) -> None:
    t, inputs, measured = chosen.record(model, which)
    columns = {"t": t, **inputs, **measured}
    units = {"t": "s", **model.units}
    table = StringIO(newline="")
    writer = csv.writer(table, lineterminator="\n")
    # Of a number in brackets no reader knows that it is a unit.
    writer.writerow([f"{n} [{units[n]}]" if units.get(n) not in (None, "", "1") else n for n in columns])
    writer.writerows([f"{value:.9g}" for value in row] for row in np.column_stack(list(columns.values())))
    write(path, table.getvalue(), "the record")
