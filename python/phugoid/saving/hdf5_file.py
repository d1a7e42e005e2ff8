"""A saved fit as HDF5: every array a dataset with its unit, the rest JSON in the dataset ``document``.

In the JSON an array is ``{"hdf5 dataset": "/records/0/outputs/q"}``. The file is made and read in memory: HDF5's own
library ends the process where a disk is full, and may do so where bytes are damaged. After its last byte stands a line
with the checksum of all before it, which HDF5 passes over; files of earlier releases have none.
"""

from __future__ import annotations

from collections.abc import Callable
from hashlib import sha256
from io import BytesIO
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, MissingDependency

__all__ = ["MAGIC", "Reader", "Writer"]

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
    return _SEAL + sha256(content).hexdigest().encode() + b"\n"


def _part(part: str | int) -> str:
    """Return a name as part of a path, in which a slash divides and a dot stands for the group itself."""
    text = str(part).replace("/", "∕")
    return text if text.strip(".") else f"_{text}"
