"""Options that commands share: how files are read, how a model is estimated, and where results go."""

from __future__ import annotations

import contextlib
import math
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import typer
from typer import Option

from ..api import estimate
from ..data.experiment import Experiment
from ..data.read import read
from ..errors import DataError, ModelError, OptionError, listing
from ..filter_error import FilterError
from ..goodness_of_fit import Tolerance
from ..modelling.model import Model
from ..result import Fit
from ..solvers.ipopt import Ipopt
from ..solvers.newton import Newton
from ..transcription import Collocation, Transcription

__all__ = [
    "DataArgument",
    "Estimation",
    "JsonOption",
    "ModelArgument",
    "PlotOption",
    "Reading",
    "ReportOption",
    "as_options",
    "fixes",
    "numbers",
    "tolerances",
]

ModelArgument: TypeAlias = Annotated[
    str, typer.Argument(help="model.py, model.py:name, or a saved model or fit (.json, .h5).", metavar="MODEL")
]
DataArgument: TypeAlias = Annotated[list[Path], typer.Argument(help="Data files, one record each.", metavar="DATA")]
PlotOption: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--plot",
        help="Write the figure of measured and computed outputs (.png, .pdf, .svg), one file for each record.",
        metavar="FILE",
    ),
]
ReportOption: TypeAlias = Annotated[
    Path | None, typer.Option("--report", help="Write a report with figures as one HTML page.", metavar="FILE.html")
]
JsonOption: TypeAlias = Annotated[bool, typer.Option("--json", help="Print the results as JSON.")]


def pairs(option: str, texts: Sequence[str] | None) -> dict[str, str]:
    """Parse ``A=B`` of a repeated option, or several separated by commas.

    >>> pairs("--rename", ["a=b,c=d"])
    {'a': 'b', 'c': 'd'}
    """
    found: dict[str, str] = {}
    for text in (part for given in texts or () for part in given.split(",")):
        left, equals, right = (part.strip() for part in text.partition("="))
        if not (left and equals and right):
            raise OptionError(f"{option}: '{text}' is not of the form A=B")
        if left in found:
            raise OptionError(f"{option}: '{left}' is given twice")
        found[left] = right
    return found


def numbers(option: str, texts: Sequence[str] | None) -> dict[str, float]:
    """Parse ``NAME=VALUE`` with finite numbers.

    >>> numbers("--start", ["Mw=0.2", "Mq=-1e-3"])
    {'Mw': 0.2, 'Mq': -0.001}
    """
    return {name: _number(option, f"{name}={text}", text) for name, text in pairs(option, texts).items()}


def tolerances(texts: Sequence[str] | None) -> dict[str, Tolerance]:
    """Parse ``OUTPUT=VALUE``, ``OUTPUT=PART%`` or ``OUTPUT=VALUE/PART%`` (whichever is greater).

    >>> tolerances(["V=1.5/5%", "q=0.01"])
    {'V': Tolerance(absolute=1.5, relative=0.05), 'q': Tolerance(absolute=0.01, relative=0.0)}
    """
    found = {}
    for name, text in pairs("--tolerance", texts).items():
        whole, parts = f"--tolerance {name}={text}", [part.strip() for part in text.split("/")]
        kinds = ["relative" if part.endswith("%") else "absolute" for part in parts]
        if len(set(kinds)) < len(kinds) or kinds[0] != min(kinds):
            raise OptionError(f"{whole}: is not of the form OUTPUT=VALUE, OUTPUT=PART% or OUTPUT=VALUE/PART%")
        numbers_of = {
            kind: _number("--tolerance", f"{name}={text}", part.rstrip("%")) / (100.0 if kind == "relative" else 1.0)
            for kind, part in zip(kinds, parts, strict=True)
        }
        try:
            found[name] = Tolerance(**numbers_of)
        except OptionError as error:
            raise OptionError(f"{whole}: {error}") from None
    return found


def fixes(texts: Sequence[str] | None, start: Mapping[str, float]) -> dict[str, float | None]:
    """Parse ``NAME`` or ``NAME=VALUE``; a name alone is fixed at its start value, None where that is the
    declared one."""
    found: dict[str, float | None] = {}
    for text in (part.strip() for given in texts or () for part in given.split(",")):
        if "=" in text:
            found |= numbers("--fix", [text])
        else:
            found[text] = start.get(text)
    return found


def names(text: str | None) -> list[str] | None:
    """Parse ``A,B`` into a list."""
    return None if text is None else [name.strip() for name in text.split(",") if name.strip()]


def span(text: str | None) -> tuple[float, float] | None:
    """Parse ``T0,T1``.

    >>> span("2,10.5")
    (2.0, 10.5)
    """
    if text is None:
        return None
    parts = text.split(",") if "," in text else text.split(":")
    if len(parts) != 2:
        raise OptionError(f"--window: '{text}' is not of the form T0,T1")
    return _number("--window", text, parts[0]), _number("--window", text, parts[1])


def _number(option: str, text: str, number: str) -> float:
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise OptionError(f"{option} {text}: '{number}' is not a finite number")
    return value


# What errors of the package call arguments and methods, and the options of the command that stand for them.
_OPTIONS = (
    (r" its values, or let ph.read do it:", r""),
    (r"\bconvert=m\.units", r"--convert"),
    (r"\bgive units=\{'([^']*)': \('([^']*)', '[^']*'\)\};", r"give --units \1=\2 --convert;"),
    (r", or this one with units=\{'[^']*': \('[^']*', '[^']*'\)\}", r""),  # the command line has --convert alone
    (r"\bunits=\{'[^']*': \('[^']*', '[^']*'\)\}, or convert=True without units", r"--convert, without --units"),
    (r"\brename is \{column: name\}: \{'([^']*)': '([^']*)'\}", r"OLD is the column: --rename '\1=\2'"),
    (r"\btime='([^']*)'", r"--time \1"),
    (r"\bunits=\{'([^']*)': '([^']*)'\}", r"--units \1=\2"),
    (r"\brate=\.\.\.", r"--rate RATE"),
    (r"\b(inputs|outputs)=\[\.\.\.\]", r"--\1 A,B"),
    (r"\bcolumns=\[\.\.\.\]", r"--columns A,B"),
    (r"\((inputs|outputs)=\.\.\.\)", r"(--\1)"),
    (r"\bconvert=True", r"--convert"),
    (r": rename: ", r": --rename: "),
    (r"\.rename\(\{\.\.\.\}\)", r"--rename OLD=NEW"),
    (r" \(\[\] for none\)", r""),
)


def as_options(text: str) -> str:
    """Return a message of the package with options of the command line in place of arguments in Python.

    >>> as_options("name its 2 columns with columns=[...], or give time='my clock'")
    "name its 2 columns with --columns A,B, or give --time 'my clock'"
    """
    for pattern, option in _OPTIONS:
        text = re.sub(pattern, lambda found, option=option: _quoted(found.expand(option)), text)  # type: ignore[misc]
    return text


def _quoted(option: str) -> str:
    """Return an option with its value quoted for the shell, where it has to be."""
    name, space, value = option.partition(" ")
    return name + space + shlex.quote(value) if space and name in ("--time", "--units") else option


@dataclass(frozen=True)
class Reading:
    """Hold the options of `read` for data files, as texts. Raises OptionError for invalid ones."""

    time: Annotated[
        str | None, Option("--time", help="Time column; default: t, time or another common name.", metavar="NAME")
    ] = None
    rate: Annotated[
        float | None, Option("--rate", help="Sampling rate of a file without a time column.", metavar="RATE")
    ] = None
    rename: Annotated[
        list[str] | None, Option("--rename", help="Rename column OLD to NEW, its name in the model.", metavar="OLD=NEW")
    ] = None
    inputs: Annotated[
        str | None, Option("--inputs", help="Input columns; default: the inputs of the model.", metavar="A,B")
    ] = None
    outputs: Annotated[
        str | None, Option("--outputs", help="Output columns; default: the outputs of the model.", metavar="A,B")
    ] = None
    window: Annotated[str | None, Option("--window", help="Use the samples from T0 to T1 only.", metavar="T0,T1")] = (
        None
    )
    units: Annotated[
        list[str] | None,
        Option("--units", help="Unit of a column, instead of that in the file.", metavar="NAME=UNIT"),
    ] = None
    convert: Annotated[
        bool,
        Option(
            "--convert",
            help="Convert columns to the units of the model, others to SI: degrees to radians, knots to m/s, ...",
        ),
    ] = False
    columns: Annotated[
        str | None,
        Option("--columns", help="Names of all columns, in order, if there is no header.", metavar="T,A,B"),
    ] = None

    def __post_init__(self) -> None:
        self._given()

    def _given(self) -> dict[str, Any]:
        """Return the arguments of `read`."""
        return {
            "time": self.time,
            "rate": self.rate,
            "units": pairs("--units", self.units),
            "rename": pairs("--rename", self.rename),
            "inputs": names(self.inputs),
            "outputs": names(self.outputs),
            "window": span(self.window),
            "convert": self.convert,
            "columns": names(self.columns),
        }

    def read(self, files: Sequence[Path], of: Model | Fit) -> list[Experiment]:
        """Read one record a file, with times in the unit of a model or of a fit; each is named after its file, with the
        folder where file names are equal. Options that are not given are those that the first record of a fit was read
        with, where the file has what they name."""
        twice = [f for i, f in enumerate(files) if f.resolve() in [g.resolve() for g in files[:i]]]
        if twice:
            raise OptionError(f"{twice[0]} is given twice")
        model = of.model if isinstance(of, Fit) else of
        stems = [f.stem for f in files]
        before = of.experiments[0]._read_as if isinstance(of, Fit) else {}
        return [self._record(f, str(f) if stems.count(f.stem) > 1 else None, model, before) for f in files]

    def _record(self, file: Path, name: str | None, model: Model, before: Mapping[str, Any]) -> Experiment:
        given = self._given()
        if any(not given[option] for option in before):
            with contextlib.suppress(DataError):
                as_before = {**given, **{option: given[option] or before[option] for option in before}}
                as_before["convert"] = model.units if as_before["convert"] else False
                found: Experiment = read(file, name=name, time_unit=model.time_unit, **as_before)
                return found
        given["convert"] = model.units if self.convert else False
        record: Experiment = read(file, name=name, time_unit=model.time_unit, **given)
        return record


_SOLVERS: Mapping[str, type[Newton] | type[Ipopt]] = {"newton": Newton, "ipopt": Ipopt}


@dataclass(frozen=True)
class Estimation:
    """Hold the options of an estimation, as texts. Raises OptionError for invalid ones."""

    order: Annotated[
        int | None,
        Option(
            "--order",
            help="Number of collocation points in a segment (2: trapezoidal rule); default: 4, or as saved.",
            metavar="N",
        ),
    ] = None
    refine: Annotated[
        bool, Option("--refine", help="Divide the mesh where its integration error is large, and estimate again.")
    ] = False
    start: Annotated[
        list[str] | None, Option("--start", help="Start value of a parameter or a state.", metavar="NAME=VALUE")
    ] = None
    fix: Annotated[
        list[str] | None,
        Option("--fix", help="Fix a parameter at its start value, or at VALUE.", metavar="NAME[=VALUE]"),
    ] = None
    solver: Annotated[str, Option("--solver", help="newton or ipopt.", metavar="NAME")] = "newton"
    iterations: Annotated[
        int | None,
        Option("--iterations", help="Maximum number of iterations; default: that of the solver.", metavar="N"),
    ] = None

    def __post_init__(self) -> None:
        self._solver()
        self._values()

    def _solver(self) -> Newton | Ipopt:
        if self.solver not in _SOLVERS:
            raise OptionError(f"--solver: there is no '{self.solver}'.{listing(self.solver, _SOLVERS)}")
        kind = _SOLVERS[self.solver]
        return kind() if self.iterations is None else kind(max_iterations=self.iterations)

    def _values(self) -> tuple[dict[str, float], dict[str, float | None]]:
        """Return the start values, and the fixed parameters: name -> value, or None for the declared start."""
        start = numbers("--start", self.start)
        return start, fixes(self.fix, start)

    def check_unused(self, source: str) -> None:
        """Raise OptionError for options that do not apply to a saved fit."""
        if self.start or self.fix:
            raise OptionError(f"--start and --fix are for a model that is fitted first: {source} holds a fit")

    def run(self, model: Model, data: Sequence[Experiment], before: Fit | None = None) -> Fit:
        """Estimate with progress on stderr; continue from the fit ``before``, with its noise, where there is one."""
        start, fixed = self._values()
        solver = self._solver()
        model = _with_fixed(model, fixed)
        begin: dict[str, Any] = {} if before is None else dict(before.as_start(before.noise))
        begin = {n: v for n, v in {**begin, **start}.items() if n.partition("[")[0] not in fixed}
        mesh: Transcription | FilterError = Collocation(4 if self.order is None else self.order, refine=self.refine)
        if before is not None and self.order is None:
            mesh = before.transcription
            if self.refine:
                if not isinstance(mesh, Collocation):
                    raise OptionError(f"--refine: the saved fit is not one by collocation ({mesh})")
                mesh = replace(mesh, refine=True)
        return estimate(
            model,
            data,
            transcription=mesh,
            noise=None if before is None else before.noise,
            start=begin,
            solver=None if isinstance(mesh, FilterError) else solver,  # the filter-error method has its own
            progress=True,
        )


def _with_fixed(model: Model, fixed: Mapping[str, float | None]) -> Model:
    """Return the model with parameters fixed at values, or (None) at their declared starts."""
    declared, changes = model.declared_parameters, {}
    for name, value in fixed.items():
        if name not in declared:
            raise ModelError(f"--fix: '{name}' is not a parameter.{listing(name, model.parameter_names)}")
        low, high = declared[name].bounds
        if value is not None and not low <= value <= high:
            raise ModelError(f"--fix: {name} = {value:g} lies outside its bounds ({low:g}, {high:g})")
        changes[name] = replace(declared[name], start=declared[name].start if value is None else value, fixed=True)
    return model.with_parameters(changes)
