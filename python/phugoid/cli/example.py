"""``phugoid example``: writes a packaged model file and simulated records to try the other commands on.

Below are the examples: their true parameters, and the manoeuvres that their records are simulated with.
"""

from __future__ import annotations

import csv
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from ..data.experiment import Experiment
from ..design.steps import doublet, multistep, step, sweep, three_two_one_one
from ..errors import OptionError, listing
from ..modelling.model import Model
from ..models.general import model_text
from ..simulation import simulate
from ..writing import write
from .model_file import load_model
from .options import JsonOption
from .results import emit_json

__all__ = ["EXAMPLES", "Example", "example", "example_of"]

_Array = NDArray[np.float64]


def example(
    name: Annotated[
        str | None, typer.Argument(help="Example to write; without it they are listed.", metavar="NAME")
    ] = None,
    folder: Annotated[
        Path, typer.Option("--out", help="Folder to write into; created if necessary.", metavar="FOLDER")
    ] = Path(),
    every: Annotated[bool, typer.Option("--list", help="List the examples.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite existing files.")] = False,
    json: JsonOption = False,
) -> None:
    """Write an example: a model file, two simulated records and a page.

    The page says what to look for. A list of the commands to run on it is printed, too.
    """
    if every or name is None:
        if json:
            emit_json("example", {"examples": {e.name: e.about for e in EXAMPLES.values()}})
        else:
            width = max(map(len, EXAMPLES))
            print("\n".join(f"{e.name.ljust(width)}  {e.about}" for e in EXAMPLES.values()))
            print("\nWrite one: phugoid example NAME")
        return
    chosen = example_of(name)
    file = folder / f"{name}.py"
    records, page = [folder / f"{name}.csv", folder / f"{name}_other.csv"], folder / f"{name}.md"
    there = [str(p) for p in (file, *records, page) if p.exists()]
    if there and not force:
        raise OptionError(f"{', '.join(there)} would be overwritten; give --force, or --out for another folder")
    folder.mkdir(parents=True, exist_ok=True)
    write(file, chosen.text)
    model = load_model(str(file))
    for which, path in enumerate(records):
        _write(chosen, model, which, path)
    commands = _commands(file, *records)
    write(page, chosen.page(commands))
    written = [file, *records, page]
    if json:
        facts = {"example": name, "look_for": chosen.look, "commands": commands}
        emit_json("example", facts, written)
    else:
        print(f"{chosen.about}\n\nWritten: {', '.join(map(str, written))}\n\nNow try:")
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
    units = {"t": model.time_unit, **model.units}
    table = StringIO(newline="")
    writer = csv.writer(table, lineterminator="\n")
    # Of a number in brackets no reader knows that it is a unit.
    writer.writerow([f"{n} [{units[n]}]" if units.get(n) not in (None, "", "1") else n for n in columns])
    writer.writerows([f"{value:.9g}" for value in row] for row in np.column_stack(list(columns.values())))
    write(path, table.getvalue(), "the record")


# Begin and end in s, and the step: 3-2-1-1, then a pulse; and a doublet the other way.
_FIRST = ((2, 5, 1), (5, 7, -1), (7, 8, 1), (8, 9, -1), (25, 27, 1))
_SECOND = ((3, 5, -1), (5, 7, 1), (20, 22, -1), (22, 23, 1))


@dataclass(frozen=True)
class Example:
    """A model with the true parameters that its records are simulated with.

    ``inputs``: name -> (trim, size of a step of the manoeuvres, in its unit). ``sigma``: output -> standard deviation
    of white Gaussian noise. ``seconds`` and ``rate`` (Hz) of a record. ``look``: what to look for in it. ``signals``:
    the inputs over the times (N,) of the first (0) or the second (1) record, where these are not steps about a trim.
    """

    name: str
    about: str
    parameters: Mapping[str, float]
    initial: Mapping[str, float]
    inputs: Mapping[str, tuple[float, float]]
    sigma: Mapping[str, float]
    seconds: float
    rate: float
    look: str
    signals: Callable[[_Array, int], dict[str, _Array]] | None = None

    @property
    def text(self) -> str:
        """The text of the model file."""
        return model_text(self.name)

    def page(self, commands: Sequence[str]) -> str:
        """Return a page in Markdown: commands, what to look for, and the values that the records were made with."""
        rows = [f"| {name} | {value:g} |" for name, value in self.parameters.items()]
        lines = "\n".join(f"    {line}" for line in commands)
        return (
            f"# {self.about[:1].upper()}{self.about[1:]}\n\nThe model is in `{self.name}.py`. The records are "
            f"simulated, with noise; `{self.name}_other.csv` is for validation.\n\n## Commands\n\n{lines}\n\n"
            f"## What to look for\n\n{textwrap.fill(self.look, 100)}\n\n"
            "## True values\n\n| parameter | value |\n|---|---|\n" + "\n".join(rows) + "\n"
        )

    def record(self, model: Model, which: int) -> tuple[_Array, dict[str, _Array], dict[str, _Array]]:
        """Return times (s), inputs and measurements with noise of the first or the second record; always the same."""
        t = np.arange(round(self.seconds * self.rate) + 1) / self.rate
        inputs = self._steps(t, which) if self.signals is None else self.signals(t, which)
        truth = simulate(model, self.parameters, Experiment(t, inputs, name=self.name), initial=self.initial)
        rng = np.random.default_rng(which)
        measured = {n: truth.outputs[n] + s * rng.standard_normal(t.size) for n, s in self.sigma.items()}
        return t, inputs, measured

    def _steps(self, t: _Array, which: int) -> dict[str, _Array]:
        stretch = self.seconds / 60.0
        shape = np.zeros(t.size)
        for begin, end, sign in (_FIRST, _SECOND)[which]:
            shape[(t >= begin * stretch) & (t < end * stretch)] += sign
        return {name: trim + size * shape for name, (trim, size) in self.inputs.items()}


def example_of(name: str) -> Example:
    """Return the example of a name; raise OptionError for an unknown name."""
    if name not in EXAMPLES:
        raise OptionError(f"there is no example '{name}'.{listing(name, EXAMPLES)}")
    return EXAMPLES[name]


def _quadrotor(t: _Array, which: int) -> dict[str, _Array]:
    """Return steps whose double integral vanishes, so that the vehicle stays near hover."""
    shape = (1.0, -1.0, 1.0)
    if which:
        cases = [(0.02, 0.2, 1.0), (-0.02, 0.35, 5.0), (0.03, 0.12, 12.0)]
    else:
        cases = [(0.03, 0.15, 1.0), (-0.03, 0.25, 4.0), (0.02, 0.3, 9.0), (0.015, 0.4, 13.0)]
    return {"command": sum((multistep(t, a, (1, 2, 1), width=w, heights=shape, start=s) for a, w, s in cases), 0.0 * t)}


def _car(t: _Array, which: int) -> dict[str, _Array]:
    """Return steering that grows until the tyres saturate, at a speed that changes slowly."""
    if which:
        return {"delta": step(t, 0.05, start=5.0, rise=0.2) - step(t, 0.05, start=20.0, rise=0.2), "V": 22.0 + 0.1 * t}
    growing = 0.012 * (1.0 + t / 10.0) * np.sin(2.0 * np.pi * 0.4 * t)
    return {"delta": growing + step(t, 0.03, start=20.0, rise=0.3), "V": 25.0 + 1.5 * np.sin(0.3 * t)}


def _uav(t: _Array, which: int) -> dict[str, _Array]:
    """Return elevator manoeuvres with rest between them, at constant thrust."""
    de, thrust = np.full(t.size, 0.02407625), np.full(t.size, 4.68731546)
    if which:
        de += three_two_one_one(t, 0.06, width=0.3, start=30.0) + doublet(t, -0.05, width=0.5, start=70.0)
        return {"de": de, "T": thrust}
    de += doublet(t, 0.06, width=0.4, start=20.0) + three_two_one_one(t, -0.05, width=0.35, start=40.0)
    de += sweep(t, 0.04, band=(0.3, 3.0), start=60.0, duration=25.0, fade=1.0)
    return {"de": de + doublet(t, -0.08, width=0.3, start=102.0), "T": thrust}


def _servo(t: _Array, which: int) -> dict[str, _Array]:
    """Return voltages that reverse, and grow."""
    frequency = 0.7 if which else 0.4
    return {"volts": 1.5 * np.sign(np.sin(2.0 * np.pi * frequency * t)) * np.minimum(1.0, 0.3 + 0.1 * t)}


def _tank(t: _Array, which: int) -> dict[str, _Array]:
    """Return voltages of the pump of which new ones are drawn every 40 s."""
    levels = np.random.default_rng(7 + which).uniform(1.0, 5.0, 41)
    return {"pump": np.repeat(levels, 10)[: t.size]}


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
        "Derivatives that start at 0 converge; validate on the other record; CmV is small beside its standard error.",
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
        "Simulation from wrong parameters runs away, collocation does not: it converges from all derivatives 0.",
    ),
    Example(
        "quadrotor",
        "quadrotor near hover, pitch axis: 8 parameters, 4 outputs, a delay and a lag",
        {"T": 0.06, "delay": 0.035, "Mn": 60.0, "Mq": -1.5, "Mu": 0.05, "D": 0.35, "b_q": 0.01, "b_ax": 0.1},
        {"u": 0.0, "theta": 0.0, "q": 0.0, "n": 0.0},
        {},
        {"u": 0.05, "theta": 0.003, "q": 0.01, "ax": 0.08},
        20.0,
        100.0,
        "The lag of the rotors and the damping Mq are interchangeable: the upper bound of T decides which is which. "
        "Only fast steps distinguish the delay from the lag: see the correlation of T and delay. The accelerometer "
        "measures the drag. The delay moves steps between samples: --refine divides the mesh there.",
        _quadrotor,
    ),
    Example(
        "car",
        "car, single track with tyres that saturate: 4 parameters, 3 outputs",
        {"Bf": 9.5, "Br": 12.0, "muf": 0.95, "mur": 1.0},
        {"v": 0.0, "r": 0.0},
        {},
        {"r": 0.005, "ay": 0.08, "beta": 0.002},
        30.0,
        50.0,
        "Small steering angles determine the products of stiffness and force alone: only where the tyres saturate do B "
        "and mu separate. Fit the first 10 s, and see the correlation of Bf and muf.",
        _car,
    ),
    Example(
        "uav",
        "small fixed-wing aircraft, manoeuvres in a log of two minutes: 10 parameters, 6 outputs",
        {
            "CL0": 0.25, "CLa": 4.8, "CLde": 0.35, "CD0": 0.035, "CDk": 0.06,
            "Cm0": 0.03, "Cma": -0.8, "Cmq": -12.0, "Cmde": -1.0, "b_q": 0.005,
        },
        {"V": 18.0, "alpha": 0.0074047, "theta": 0.0074047, "q": 0.0},
        {},
        {"V": 0.15, "alpha": 0.004, "theta": 0.004, "q": 0.01, "ax": 0.15, "az": 0.3},
        120.0,
        50.0,
        "ph.manoeuvres finds the manoeuvres, and .cut() gives them as records of one fit. States that are measured "
        "(V and alpha, and not u and w) let the fit start from the data.",
        _uav,
    ),
    Example(
        "servo",
        "servo with dry friction: 3 parameters, 1 output",
        {"gain": 80.0, "T": 0.25, "dry": 25.0},
        {"angle": 0.0, "rate": 0.0},
        {},
        {"angle": 0.002},
        8.0,
        200.0,
        "Dry friction is smoothed over 0.2 rad/s, so that the shaft can stick; sign(rate) itself is estimated, too. "
        "Without reversals dry friction is an offset of the voltage: fit the first second alone.",
        _servo,
    ),
    Example(
        "tank",
        "two tanks, the upper level unmeasured: 3 parameters, 1 output",
        {"k_in": 0.05, "k1": 0.06, "k2": 0.055},
        {"upper": 4.0, "lower": 6.0},
        {},
        {"lower": 0.1},
        1600.0,
        0.25,
        "The upper level is estimated with the parameters. k_in and k2 are correlated: levels at rest determine only "
        "their ratio, and changes that are quicker than the tanks would determine both better.",
        _tank,
    ),
)  # fmt: skip
EXAMPLES: Mapping[str, Example] = {e.name: e for e in _ALL}
