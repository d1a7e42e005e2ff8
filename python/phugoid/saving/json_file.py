"""Files of saved results: JSON, or HDF5 for much data; with a format name and a version, written whole or not at all.

JSON has no NaN and no infinity: they are written as null and as ``"inf"`` or ``"-inf"``, which `to_float` and
`to_array` read back. Floats keep every bit. In HDF5 arrays are datasets, and the rest is the same JSON (`hdf5_file`).
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from ..writing import CHECKSUM, check_folder, check_suffix, sealed, unsealed, write
from . import hdf5_file

__all__ = [
    "DIAGNOSIS",
    "FORMAT",
    "SUFFIXES",
    "VERSION",
    "format_of",
    "from_json",
    "load_fit_dict",
    "save_fit_dict",
    "to_array",
    "to_float",
    "to_json",
]

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

    Raises DataError where ``text`` is cut short, is no JSON, is of another format, comes from a newer version, or is
    not what its checksum says; ``source`` is how the message calls it.
    """
    try:
        document = json.loads(text, parse_constant=_no_number)
    except (ValueError, RecursionError) as error:
        place = f"line {error.lineno}: {error.msg}" if isinstance(error, json.JSONDecodeError) else error
        what = "is empty" if not text.strip() else f"is no complete JSON ({place})"
        raise DataError(f"{source}: {what}; the file is damaged or cut short, or is no saved {_WHAT[name]}") from None
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
    raise ValueError(f"{name} is no number of JSON")


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
    check_suffix(path, (".json", *SUFFIXES), f"a {_WHAT[name]}")
    what = f"the {_WHAT[name]}"
    if Path(path).suffix.lower() not in SUFFIXES:
        write(path, to_json(payload, name=name), what)
        return
    with hdf5_file.Writer(unit) as file:
        write(path, file.finish(to_json(payload, file.keep, name), name, _VERSIONS[name]), what)


def load_fit_dict(path: str | PathLike[str], name: str = FORMAT) -> tuple[dict[str, Any], int]:
    """Return the payload that `save_fit_dict` took, whatever the suffix, and the version of the format.

    DataError for a missing or damaged file, or another format; MissingDependency for HDF5 without h5py.
    """
    text = _text(path, _WHAT[name])
    if text is not None:
        return from_json(text, str(path), name)
    with hdf5_file.Reader(path) as saved:
        document, version = from_json(saved.text(name, _WHAT[name]), str(path), name)
        return saved.filled(document), version


def format_of(path: str | PathLike[str]) -> str:
    """Return the name of the format of a saved file; that of a fit where none is found, whose reader reports
    the error."""
    text = _text(path, "fit")
    if text is None:
        with hdf5_file.Reader(path) as saved:
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
            binary = file.read(len(hdf5_file.MAGIC)) == hdf5_file.MAGIC
        text = "" if binary else Path(path).read_text(encoding="utf-8")
    except FileNotFoundError:
        raise DataError(f"{path}: there is no such file") from None
    except UnicodeDecodeError:
        raise DataError(f"{path}: is not a {what} saved by phugoid, or is damaged (it is no text)") from None
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
