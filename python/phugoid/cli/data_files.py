"""Records from the data files of a command."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

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
    """How data files are read: the options of `read`."""

    time: str = "t"
    rename: Mapping[str, str] = field(default_factory=dict)
    inputs: Sequence[str] | None = None
    outputs: Sequence[str] | None = None
    window: tuple[float, float] | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    convert: bool = False
    columns: Sequence[str] | None = None

    @classmethod
    def of(
        cls,
        time: str,
        rename: Sequence[str] | None,
        inputs: str | None,
        outputs: str | None,
        window: str | None,
        units: Sequence[str] | None = None,
        convert: bool = False,
        columns: str | None = None,
    ) -> Reading:
        """From the texts of the options."""
        told = pairs("--units", units)
        names_of = names(inputs), names(outputs)
        return cls(time, pairs("--rename", rename), *names_of, span(window), told, convert, names(columns))

    def read(self, files: Sequence[Path]) -> list[Experiment]:
        """One record a file, each with a name of its own: the file's, with its folder where that is not enough."""
        twice = [f for i, f in enumerate(files) if f.resolve() in [g.resolve() for g in files[:i]]]
        if twice:
            raise OptionError(f"{twice[0]} is given twice")
        stems = [f.stem for f in files]
        return [self._record(f, str(f) if stems.count(f.stem) > 1 else None) for f in files]

    def _record(self, file: Path, name: str | None) -> Experiment:
        try:
            return read(
                file,
                time=self.time,
                inputs=self.inputs,
                outputs=self.outputs,
                rename=self.rename,
                name=name,
                window=self.window,
                units=self.units,
                convert=self.convert,
                columns=self.columns,
            )
        except DataError as error:
            text = str(error)
            for option, called in _CALLED.items():
                text = text.replace(option, called)
            raise DataError(text) from error
