"""Records from the data files of a command."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from typer import Option

from ..data.experiment import Experiment
from ..data.read import read
from ..errors import DataError, OptionError
from .options import names, pairs, span

__all__ = ["Reading"]

# Options of `read` as its errors call them, and as the command does; it has no rate.
_CALLED = {
    ", or for even sampling rate=... in Hz": "",
    "time='...'": "--time NAME",
    "inputs=[...]": "--inputs A,B",
    "outputs=[...]": "--outputs A,B",
    "(inputs=...)": "(--inputs)",
    "(outputs=...)": "(--outputs)",
    ": rename: ": ": --rename: ",
    " ([] for none)": "",
}


@dataclass(frozen=True)
class Reading:
    """How data files are read: the options of `read`, as texts. Raises OptionError for what they cannot be."""

    time: Annotated[str, Option("--time", help="Column of time, in s.", metavar="NAME")] = "t"
    rename: Annotated[
        list[str] | None, Option("--rename", help="OLD=NEW: a column as the model calls it.", metavar="OLD=NEW")
    ] = None
    inputs: Annotated[
        str | None, Option("--inputs", help="Columns that are inputs; default: the model's.", metavar="A,B")
    ] = None
    outputs: Annotated[
        str | None, Option("--outputs", help="Columns that are outputs; default: the model's.", metavar="A,B")
    ] = None
    window: Annotated[str | None, Option("--window", help="Keeps this part of each record, in s.", metavar="T0,T1")] = (
        None
    )
    units: Annotated[
        list[str] | None,
        Option("--units", help="Unit of a column, in place of what the file says.", metavar="NAME=UNIT"),
    ] = None
    convert: Annotated[
        bool, Option("--convert", help="Brings columns to SI: degrees to radians, knots to m/s, ...")
    ] = False
    columns: Annotated[
        str | None,
        Option("--columns", help="Names of all columns in order, of a file without a header.", metavar="T,A,B"),
    ] = None

    def __post_init__(self) -> None:
        self._given()

    def _given(self) -> dict[str, Any]:
        """The arguments of `read`."""
        return {
            "time": self.time,
            "units": pairs("--units", self.units),
            "rename": pairs("--rename", self.rename),
            "inputs": names(self.inputs),
            "outputs": names(self.outputs),
            "window": span(self.window),
            "convert": self.convert,
            "columns": names(self.columns),
        }

    def read(self, files: Sequence[Path]) -> list[Experiment]:
        """One record a file, each with a name of its own: the file's, with its folder where that is not enough."""
        twice = [f for i, f in enumerate(files) if f.resolve() in [g.resolve() for g in files[:i]]]
        if twice:
            raise OptionError(f"{twice[0]} is given twice")
        stems = [f.stem for f in files]
        return [self._record(f, str(f) if stems.count(f.stem) > 1 else None) for f in files]

    def _record(self, file: Path, name: str | None) -> Experiment:
        try:
            record: Experiment = read(file, name=name, **self._given())
            return record
        except DataError as error:
            text = str(error)
            for option, called in _CALLED.items():
                text = text.replace(option, called)
            raise DataError(text) from error
