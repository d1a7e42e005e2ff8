"""``phugoid example``: writes a packaged model file and simulated records to try the other commands on."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from io import StringIO
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from ..data.experiment import Experiment
from ..errors import OptionError, listing
from ..modelling.model import Model
from ..records import Record
from ..simulate import simulate
from ..writing import write
from .model_file import load_model
from .options import JsonOption
from .results import emit_json

__all__ = ["EXAMPLES", "example"]

# Begin and end in s, and the step: 3-2-1-1, then a pulse; and a doublet the other way.
_FIRST = ((2, 5, 1), (5, 7, -1), (7, 8, 1), (8, 9, -1), (25, 27, 1))
_SECOND = ((3, 5, -1), (5, 7, 1), (20, 22, -1), (22, 23, 1))


@dataclass(frozen=True)
class Example:
    """A model with the true parameters that its records are simulated with.

    ``inputs``: name -> (trim, size of a step of the manoeuvres, in its unit). ``sigma``: output -> standard deviation
    of white Gaussian noise. ``seconds`` and ``rate`` (Hz) of a record.
    """

    name: str
    about: str
    parameters: Mapping[str, float]
    initial: Mapping[str, float]
    inputs: Mapping[str, tuple[float, float]]
    sigma: Mapping[str, float]
    seconds: float
    rate: float

    @property
    def text(self) -> str:
        """The text of the model file."""
        return files(__package__).joinpath("examples", f"{self.name}.txt").read_text(encoding="utf-8")

    def record(self, model: Model, which: int) -> tuple[Record, dict[str, NDArray[np.float64]]]:
        """Return the first or the second manoeuvre, and its measurements with noise; the same at every call."""
        t = np.arange(round(self.seconds * self.rate) + 1) / self.rate
        stretch = self.seconds / 60.0
        shape = np.zeros(t.size)
        for begin, end, sign in (_FIRST, _SECOND)[which]:
            shape[(t >= begin * stretch) & (t < end * stretch)] += sign
        inputs = {name: trim + size * shape for name, (trim, size) in self.inputs.items()}
        truth = simulate(model, self.parameters, Experiment(t, inputs, name=self.name), initial=self.initial)
        rng = np.random.default_rng(which)
        measured = {n: truth.outputs[n] + s * rng.standard_normal(t.size) for n, s in self.sigma.items()}
        return truth, measured


def example_of(name: str) -> Example:
    """Return the example of a name; raise OptionError for an unknown name."""
    if name not in EXAMPLES:
        raise OptionError(f"there is no example '{name}'.{listing(name, EXAMPLES)}")
    return EXAMPLES[name]


_ALL = (
    Example(
        "hfb320",
        "HFB-320 Hansa Jet, longitudinal motion: 15 parameters, 7 outputs",
        # Near the optimum that was published with the paper.
        {
            "CD0": 0.0580, "CDV": -0.0316, "CDa": 0.2453, "CL0": 0.1808, "CLV": 0.2012, "CLa": 3.0904,
            "Cm0": 0.1184, "CmV": 0.0137, "Cma": -0.9941, "Cmq": -28.65, "Cmde": -1.4714,
            "b_q": -1e-4, "b_aq": 0.0, "b_ax": -0.1208, "b_az": -0.0110,
        },
        {"V": 106.0, "alpha": 0.112, "theta": 0.104, "q": -0.003},
        {"de": (-0.008, 0.012), "T": (11500.0, 0.0)},
        {"V": 0.87, "alpha": 0.0023, "theta": 0.0020, "q": 0.0025, "aq": 0.0079, "ax": 0.025, "az": 0.21},
        60.0,
        10.0,
    ),
    Example(
        "unstable",
        "short period of an unstable aircraft: 6 parameters, 3 outputs",
        {"Zw": -1.4249, "Zq": -1.4768, "Zde": -6.2632, "Mw": 0.2163, "Mq": -3.7067, "Mde": -12.784},
        {"w": 0.0, "q": 0.0},
        {"de": (0.0, 0.01)},
        {"w": 0.05, "q": 0.002, "az": 0.05},
        6.0,
        50.0,
    ),
)  # fmt: skip
EXAMPLES: Mapping[str, Example] = {e.name: e for e in _ALL}


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
        emit_json("example", {"example": name, "commands": commands}, [file, *records])
    else:
        print(f"{chosen.about}\n\nWritten: {', '.join(map(str, [file, *records]))}\n\nNow try:")
        print("\n".join(f"  {line}" for line in commands))


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
    truth, measured = chosen.record(model, which)
    columns = {"t": truth.t, **truth.inputs, **measured}
    units = {"t": "s", **model.units}
    table = StringIO(newline="")
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow([f"{n} [{units[n]}]" if units.get(n) else n for n in columns])
    writer.writerows([f"{value:.9g}" for value in row] for row in np.column_stack(list(columns.values())))
    write(path, table.getvalue(), "the record")
