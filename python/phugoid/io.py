"""Saved fits: JSON with a format name and a version, written so that a crash never leaves half a file.

JSON has no NaN and no infinity: they are written as null and as ``"inf"`` or ``"-inf"``, which `to_float` and
`to_array` read back. Floats keep every bit.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from threading import get_ident
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import DataError

__all__ = [
    "FORMAT",
    "VERSION",
    "from_json",
    "load_fit_dict",
    "save_fit_dict",
    "to_array",
    "to_float",
    "to_json",
]

FORMAT = "phugoid-fit"
VERSION = 1


def to_json(obj: Mapping[str, Any]) -> str:
    """JSON text of ``obj`` under the format's name and version.

    Takes None, bool, int, float, str, numpy scalars and arrays, and mappings, lists and tuples of them.
    Raises DataError for anything else, with its place.

    >>> to_json({"mesh": np.array([0.0, np.nan])})
    '{"format": "phugoid-fit", "version": 1, "mesh": [0.0, null]}'
    """
    for reserved in ("format", "version"):
        if reserved in obj:
            raise DataError(f"the key '{reserved}' belongs to the file format: choose another")
    document = {"format": FORMAT, "version": VERSION, **_plain(obj, "")}
    return json.dumps(document, ensure_ascii=False, allow_nan=False)


def from_json(text: str, source: str = "the text") -> dict[str, Any]:
    """The dictionary that `to_json` took, with arrays as lists.

    Raises DataError where ``text`` is cut short, is no JSON, is of another format, or comes from a newer
    version; ``source`` is how the message calls it.
    """
    try:
        document = json.loads(text)
    except json.JSONDecodeError as error:
        what = "is empty" if not text.strip() else f"is no complete JSON (line {error.lineno}: {error.msg})"
        raise DataError(f"{source}: {what}; the file is damaged or cut short, or is no saved fit") from None
    found = document.pop("format", None) if isinstance(document, dict) else None
    if found != FORMAT:
        raise DataError(f"{source}: is not a fit saved by phugoid (format {found!r} instead of '{FORMAT}')")
    version = document.pop("version", None)
    if not isinstance(version, int) or isinstance(version, bool) or version < 1:
        raise DataError(f"{source}: has version {version!r} instead of a whole number; the file is damaged")
    if version > VERSION:
        raise DataError(
            f"{source}: has version {version} of the format, but this phugoid reads up to {VERSION}: "
            "install a newer phugoid"
        )
    return dict(document)


def save_fit_dict(path: str | PathLike[str], payload: Mapping[str, Any]) -> None:
    """Writes ``to_json(payload)`` to ``path``, whole or not at all: the old file stays until then."""
    text = to_json(payload)
    target = Path(path).resolve()  # through a link: the file is replaced, not the link
    if not target.parent.is_dir():
        raise DataError(f"{path}: cannot be saved, since there is no folder {target.parent}")
    temporary = target.with_name(f".{target.name}.{os.getpid()}-{get_ident()}.tmp")
    try:
        with open(temporary, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, target)
    except OSError as error:
        raise DataError(f"{path}: cannot be saved ({error.strerror})") from error
    finally:
        temporary.unlink(missing_ok=True)


def load_fit_dict(path: str | PathLike[str]) -> dict[str, Any]:
    """The payload that `save_fit_dict` took; DataError for a missing or damaged file, or another format."""
    try:
        text = Path(path).read_text(encoding="utf-8")
    except FileNotFoundError:
        raise DataError(f"{path}: there is no such file") from None
    except UnicodeDecodeError:
        raise DataError(f"{path}: is not a fit saved by phugoid (it is no text)") from None
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror})") from error
    return from_json(text, source=str(path))


def to_float(value: Any) -> float:
    """A number read back: null is NaN, ``"inf"`` is infinity.

    >>> to_float(None), to_float("-inf"), to_float(0.1)
    (nan, -inf, 0.1)
    """
    return math.nan if value is None else float(value)


def to_array(value: Any) -> NDArray[np.float64]:
    """A list of numbers (nested for more dimensions) read back as float64."""
    return np.array(value, dtype=np.float64)


def _plain(value: Any, place: str) -> Any:
    """``value`` in what JSON has: dict, list, str, bool, int, finite float, null."""
    if isinstance(value, np.ndarray):
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
                raise DataError(f"cannot save '{place}': its key {key!r} is not text")
        return {key: _plain(item, f"{place}.{key}".lstrip(".")) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item, f"{place}[{i}]") for i, item in enumerate(value)]
    raise DataError(f"cannot save '{place}': a {type(value).__name__} has no place in JSON")
