"""Files of saved results: JSON, or HDF5 for much data; with a format name and a version, written whole or not at all.

JSON has no NaN and no infinity: they are written as null and as ``"inf"`` or ``"-inf"``, which `to_float` and
`to_array` read back. Floats keep every bit.

In HDF5 every array is a dataset with its unit, and the rest is the same JSON, in the dataset ``document``. There an
array is ``{"hdf5 dataset": "/records/0/outputs/q"}``. The file is made and read in memory: HDF5's own library ends the
process where a disk is full, and may do so where bytes are damaged. After its last byte stands a line with the
checksum of all before it, which HDF5 passes over; files of earlier releases have none.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping
from io import BytesIO
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, MissingDependency
from ..writing import CHECKSUM, check_folder, check_suffix, sealed, unsealed, write

__all__ = [
    "DIAGNOSIS",
    "FORMAT",
    "MAGIC",
    "SUFFIXES",
    "VERSION",
    "Reader",
    "Writer",
    "format_of",
    "from_json",
    "load_fit_dict",
    "save_fit_dict",
    "to_array",
    "to_float",
    "to_json",
]

MAGIC = b"\x89HDF\r\n\x1a\n"
"""The first bytes of an HDF5 file."""
_KEY = "hdf5 dataset"
_DOCUMENT = "document"
_SEAL = b"\nphugoid sha256:"
_SEAL_LENGTH = len(_SEAL) + 65
# Arrays of fewer numbers gain nothing by compression.
_SMALL = 64


def _h5py(what: str) -> Any:
    try:
        import h5py
    except ImportError as error:
        raise MissingDependency(f'to {what} a fit as HDF5 needs h5py ({error}): pip install "phugoid[hdf5]"') from error
    return h5py


class Writer:
    """A new file in memory: call `keep` for every array, then `finish`."""

    def __init__(self, unit: Callable[[tuple[str | int, ...]], str]) -> None:
        # Creation times of datasets are left out: the same fit gives the same bytes.
        self._file = _h5py("save").File("saved.h5", "w", track_order=True, driver="core", backing_store=False)
        self._unit = unit

    def keep(self, array: NDArray[Any], place: tuple[str | int, ...]) -> dict[str, str]:
        """Write an array; return the value that stands for it in the JSON."""
        path = "/".join(_part(part) for part in place)
        while path in self._file or path == _DOCUMENT:  # names that differ by a slash
            path += "_"
        large = {"compression": "gzip", "compression_opts": 4, "shuffle": True} if array.size >= _SMALL else {}
        checked = {"fletcher32": True, **large} if array.size else {}
        data = np.asarray(array, dtype=np.float64) if array.dtype.kind == "f" else array
        dataset = self._file.create_dataset(path, data=data, track_times=False, **checked)
        if unit := self._unit(place):
            dataset.attrs["units"] = unit
        return {_KEY: f"/{path}"}

    def finish(self, text: str, name: str, version: int) -> bytes:
        """Add the JSON, the format and its version; return the content of the file."""
        data = np.array([text.encode("utf-8")])
        self._file.create_dataset(_DOCUMENT, data=data, track_times=False, chunks=(1,), fletcher32=True)
        self._file.attrs["format"], self._file.attrs["version"] = name, version
        self._file.flush()
        content = bytes(self._file.id.get_file_image())
        return content + _seal(content)

    def __enter__(self) -> Writer:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: object, trace: TracebackType | None) -> None:
        self._file.close()


class Reader:
    """A file to read; raises DataError where it is damaged or holds something else."""

    def __init__(self, path: str | PathLike[str]) -> None:
        self._path = path
        h5py = _h5py("read")
        content = self._try(lambda: Path(path).read_bytes())
        end = content.rfind(_SEAL, max(len(content) - _SEAL_LENGTH, 0))
        if end >= 0 and content[end:] != _seal(content[:end]):
            raise DataError(f"{path}: is damaged, or was changed after it was saved: save it again")
        self._file = self._try(lambda: h5py.File(BytesIO(content), "r"))

    def name(self) -> Any:
        """Return the name of the format, as passed to `Writer.finish`; None where there is none."""
        return self._try(lambda: self._file.attrs.get("format"))

    def text(self, name: str, what: str) -> str:
        """Return the JSON; raise DataError where the format is not that of ``what``."""
        found = self.name()
        if found != name:
            raise DataError(f"{self._path}: is not a {what} saved by phugoid (format {found!r} instead of '{name}')")
        return str(self._try(lambda: bytes(self._array(_DOCUMENT)[0]).decode("utf-8")))

    def _array(self, where: str) -> NDArray[Any]:
        dataset = self._file[where]
        # More is not read than was stored, which gzip makes smaller by a factor of 1032 at most.
        if dataset.dtype.kind not in "biufS" or dataset.nbytes > 1032 * dataset.id.get_storage_size() + 4096:
            raise ValueError(f"{where} has type {dataset.dtype} and shape {dataset.shape}, but less is stored")
        return np.asarray(dataset[()])

    def filled(self, value: Any) -> Any:
        """Return the content of the JSON with arrays in their places."""
        if isinstance(value, dict):
            where = value.get(_KEY)
            if len(value) == 1 and isinstance(where, str) and where.startswith("/"):
                return self._try(lambda: self._array(where))
            return {key: self.filled(item) for key, item in value.items()}
        if isinstance(value, list):
            return [self.filled(item) for item in value]
        return value

    def _try(self, read: Callable[[], Any]) -> Any:
        # Damaged bytes lead h5py to exceptions of many types.
        try:
            return read()
        except Exception as error:
            what = str(error).strip("\"'") or type(error).__name__
            raise DataError(f"{self._path}: is damaged or cut short ({what})") from error

    def __enter__(self) -> Reader:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: object, trace: TracebackType | None) -> None:
        self._file.close()


def _seal(content: bytes) -> bytes:
    from hashlib import sha256  # not at import: it takes its time

    return _SEAL + sha256(content).hexdigest().encode() + b"\n"


def _part(part: str | int) -> str:
    """Return a name as part of a path, in which a slash divides and a dot stands for the group itself."""
    text = str(part).replace("/", "∕")
    return text if text.strip(".") else f"_{text}"


FORMAT = "phugoid-fit"
VERSION = 2
"""1: without experiments and solution; 2: with them, and HDF5."""
DIAGNOSIS = "phugoid-diagnosis"
_VERSIONS = {FORMAT: VERSION, DIAGNOSIS: 1}
_WHAT = {FORMAT: "fit", DIAGNOSIS: "diagnosis"}
SUFFIXES = (".h5", ".hdf5")
"""Of files that are written as HDF5."""

_Place: TypeAlias = tuple[str | int, ...]
_Keep: TypeAlias = Callable[[NDArray[Any], _Place], Any]


def to_json(obj: Mapping[str, Any], keep: _Keep | None = None, name: str = FORMAT) -> str:
    """Return JSON text of ``obj`` under the format's name and version.

    Takes None, bool, int, float, str, numpy scalars and arrays, and mappings, lists and tuples of them; ``keep`` says
    what to write for an array at a place, unless its numbers. Raises DataError for anything else, with its place.

    >>> to_json({"mesh": np.array([0.0, np.nan])}).partition(', "checksum"')[0]
    '{"format": "phugoid-fit", "version": 2, "mesh": [0.0, null]'
    """
    for reserved in ("format", "version", CHECKSUM):
        if reserved in obj:
            raise DataError(f"the key '{reserved}' belongs to the file format: choose another")
    document = {"format": name, "version": _VERSIONS[name], **_plain(obj, (), keep)}
    return json.dumps(sealed(document), ensure_ascii=False, allow_nan=False)


def from_json(text: str, source: str = "the text", name: str = FORMAT) -> tuple[dict[str, Any], int]:
    """Return the dictionary that `to_json` took, with arrays as lists, and the version of the format ``name``.

    Raises DataError where ``text`` is cut short, is not JSON, is of another format, comes from a newer version, or is
    not what its checksum says; ``source`` is how the message calls it.
    """
    try:
        document = json.loads(text, parse_constant=_no_number)
    except (ValueError, RecursionError) as error:
        place = f"line {error.lineno}: {error.msg}" if isinstance(error, json.JSONDecodeError) else error
        what = "is empty" if not text.strip() else f"is not complete JSON ({place})"
        raise DataError(f"{source}: {what}; the file is damaged or cut short, or not a saved {_WHAT[name]}") from None
    found = document.pop("format", None) if isinstance(document, dict) else None
    if found != name:
        raise DataError(f"{source}: is not a {_WHAT[name]} saved by phugoid (format {found!r} instead of '{name}')")
    version = document.pop("version", None)
    if not isinstance(version, int) or isinstance(version, bool) or version < 1:
        raise DataError(f"{source}: has version {version!r} instead of a whole number; the file is damaged")
    if version > _VERSIONS[name]:
        raise DataError(
            f"{source}: has version {version} of the format, but this phugoid reads up to {_VERSIONS[name]}: "
            "install a newer phugoid"
        )
    content = unsealed({"format": name, "version": version, **document}, source)
    return {key: value for key, value in content.items() if key not in ("format", "version")}, version


def _no_number(name: str) -> None:
    raise ValueError(f"{name} is not a number of JSON")


def save_fit_dict(
    path: str | PathLike[str],
    payload: Mapping[str, Any],
    unit: Callable[[_Place], str] = lambda place: "",
    name: str = FORMAT,
) -> None:
    """Write the payload to ``path``, whole or not at all: the old file stays until then.

    The suffix says how: HDF5 for ``.h5`` and ``.hdf5``, with ``unit`` of the array at a place as an attribute; JSON
    else. Raises DataError where the file cannot be written, MissingDependency for HDF5 without h5py.
    """
    check_folder(path)
    if Path(path).suffix:
        check_suffix(path, (".json", *SUFFIXES), f"a {_WHAT[name]}")
    what = f"the {_WHAT[name]}"
    if Path(path).suffix.lower() not in SUFFIXES:
        write(path, to_json(payload, name=name), what)
        return
    with Writer(unit) as file:
        write(path, file.finish(to_json(payload, file.keep, name), name, _VERSIONS[name]), what)


def load_fit_dict(path: str | PathLike[str], name: str = FORMAT) -> tuple[dict[str, Any], int]:
    """Return the payload that `save_fit_dict` took, whatever the suffix, and the version of the format.

    DataError for a missing or damaged file, or another format; MissingDependency for HDF5 without h5py.
    """
    text = _text(path, _WHAT[name])
    if text is not None:
        return from_json(text, str(path), name)
    with Reader(path) as saved:
        document, version = from_json(saved.text(name, _WHAT[name]), str(path), name)
        return saved.filled(document), version


def format_of(path: str | PathLike[str]) -> str:
    """Return the name of the format of a saved file; that of a fit where none is found, whose reader reports
    the error."""
    text = _text(path, "fit")
    if text is None:
        with Reader(path) as saved:
            found = saved.name()
    else:
        # The format comes first, since the file may be large.
        head = re.match(r'\s*\{\s*"format"\s*:\s*"([^"]*)"', text)
        found = head[1] if head else FORMAT
    return found if found in _VERSIONS else FORMAT


def _text(path: str | PathLike[str], what: str) -> str | None:
    """Return the text of a file; None where it is HDF5."""
    try:
        with open(path, "rb") as file:
            binary = file.read(len(MAGIC)) == MAGIC
        text = "" if binary else Path(path).read_text(encoding="utf-8")
    except FileNotFoundError:
        raise DataError(f"{path}: there is no such file") from None
    except UnicodeDecodeError:
        raise DataError(f"{path}: is not a {what} saved by phugoid, or is damaged (it is not text)") from None
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror})") from error
    return None if binary else text


def to_float(value: Any) -> float:
    """Return a number read back from JSON: null is NaN, ``"inf"`` is infinity.

    >>> to_float(None), to_float("-inf"), to_float(0.1)
    (nan, -inf, 0.1)
    """
    return math.nan if value is None else float(value)


def to_array(value: Any) -> NDArray[np.float64]:
    """Return a list of numbers (nested for more dimensions) read back as float64."""
    return np.array(value, dtype=np.float64)


def _plain(value: Any, place: _Place = (), keep: _Keep | None = None) -> Any:
    """Return ``value`` in the types of JSON: dict, list, str, bool, int, finite float, null."""
    if isinstance(value, np.ndarray):
        if keep is not None and value.dtype.kind in "biuf":
            return keep(value, place)
        if value.dtype.kind in "iuf" and np.isfinite(value).all():
            return value.tolist()
        value = value.tolist()
    elif isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, float):
        if math.isnan(value):
            return None
        return float(value) if math.isfinite(value) else str(float(value))
    if isinstance(value, Mapping):
        for key in value:
            if not isinstance(key, str):
                raise DataError(f"cannot save '{_name(place)}': its key {key!r} is not text")
        return {key: _plain(item, (*place, key), keep) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item, (*place, i), keep) for i, item in enumerate(value)]
    raise DataError(f"cannot save '{_name(place)}': a {type(value).__name__} has no place in JSON")


def _name(place: _Place) -> str:
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place).lstrip(".")
