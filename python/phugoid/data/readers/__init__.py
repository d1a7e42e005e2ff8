"""Readers, one for each kind of file, and their common result: columns by name, and what holds the times of each."""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from ...errors import DataError, MissingDependency, PhugoidError, nearest

__all__ = [
    "KINDS",
    "TIMES",
    "TIME_UNITS",
    "Column",
    "Source",
    "contents",
    "existing",
    "load",
    "reading",
    "split_unit",
    "stem",
]

KINDS = ".mat, .h5, .hdf5, .parquet, .ulg, .bin"
# Names of a time column that need no `time=`, in any case; of several none is taken. ("T" is no time but a thrust.)
TIME_UNITS = ("s", "ms", "us", "ns")
TIMES = (
    *("time", "elapsed", "elapsed time", "elapsed_time", "time elapsed", "time_elapsed", "seconds", "sec"),
    *("zeit", "temps", "tiempo", "tempo", "tijd"),
    *(f"{name}_{unit}" for name in ("time", "t", "timestamp") for unit in TIME_UNITS),
)


@dataclass(frozen=True)
class Column:
    """One column of a file.

    name    as the file has it, without the unit.
    values  returns the values, (N,), when called with the user's name of the column, which messages contain.
    unit    "" where the file has none.
    header  name and unit as written, where these were one text.
    times   name of the column that holds its times; None: the one that the user calls the time.
    """

    name: str
    values: Callable[[str], ArrayLike]
    unit: str = ""
    header: str = ""
    times: str | None = None


@dataclass(frozen=True)
class Source:
    """The columns of a file, or of a table in memory.

    where     what messages call it.
    name      what the experiment is called unless the user says otherwise.
    left_out  name -> why it is not a column, for messages on names that may be asked for.
    group     the group that holds all columns and is not part of their names, with its dot; "" where there is none.
    """

    where: str
    name: str
    columns: list[Column]
    left_out: Mapping[str, str] = field(default_factory=dict)
    group: str = ""

    def bare(self, name: Any) -> Any:
        """Return the name of a column without the group; what is not text, as it is."""
        return name.removeprefix(self.group) if isinstance(name, str) else name


def stem(path: Path) -> str:
    """Return the file's name without its ending: ``run1`` of ``run1.csv.gz``."""
    name = path.name.removesuffix(".gz")
    return name.rsplit(".", 1)[0] if "." in name[1:] else name


def existing(path: Path) -> None:
    """Raise DataError unless the path is a file; the message names the folder, and a similar file there."""
    if path.is_dir():
        raise DataError(f"{path}: is a folder, not a file")
    if not path.is_file():
        folder = path.parent.resolve()
        if not folder.is_dir():
            raise DataError(f"{path}: there is no such file; there is no folder {folder} either")
        # A record with another number is another record, and one with another ending is not a slip of a finger.
        near = [p.stem for p in folder.iterdir() if p.suffix == path.suffix and _digits(p.name) == _digits(path.name)]
        meant = nearest(path.stem, near)  # without the ending, which makes any two names alike
        hint = f" Did you mean '{meant}{path.suffix}'?" if meant else ""
        raise DataError(f"{path}: there is no such file in {folder}.{hint}")


def _digits(name: str) -> str:
    return "".join(filter(str.isdigit, name))


def contents(path: Path) -> bytes:
    """Return the bytes of a file; raise DataError where it is absent or cannot be read."""
    existing(path)
    try:
        return path.read_bytes()
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror})") from error


def load(module: str, kind: str, extra: str) -> Any:
    """Import and return an optional package; MissingDependency gives the command that installs it."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        raise MissingDependency(f'to read {kind} needs {package} ({error}): pip install "phugoid[{extra}]"') from error


@contextmanager
def reading(where: str | Path, kind: str) -> Iterator[None]:
    """Turn the exceptions of a foreign reader into a DataError that names the file.

    Damaged bytes lead the packages that parse them to exceptions of any type, so none is left out.
    """
    try:
        yield
    except PhugoidError:
        raise
    except Exception as error:
        why = " ".join(str(error).split()) or type(error).__name__
        raise DataError(f"{where}: is not {kind}, or is damaged or cut short ({why})") from None


def split_unit(header: str) -> tuple[str, str]:
    """Return name and unit of ``alpha [deg]`` or ``alpha (deg)``; the unit is "" where there is none or it is ``-``."""
    match = re.fullmatch(r"(.+?)\s*[\[(]\s*([^\[\]()]+?)\s*[\])]", header)
    # A whole number in brackets is an index, as in PX4's "xyz[0]", and part of the name.
    if match and not match[2].isdigit():
        return match[1], "" if match[2] == "-" else match[2]
    return header, ""
