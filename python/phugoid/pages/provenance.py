"""Which data and versions a report comes from."""

from __future__ import annotations

import datetime
import hashlib
import os
import platform
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

from .. import _core
from ..data.experiment import Experiment
from ..errors import DataError
from ..records import Record
from .markup import bullets, table

__all__ = ["facts", "files_table", "records_table", "steps_of"]


def records_table(records: Sequence[Record]) -> str:
    """A row for each record."""
    rows = []
    for r in records:
        missing = sum(int((z != z).sum()) for z in r.measured.values())
        span = f"{r.t[0]:g} to {r.t[-1]:g} s"
        rows.append([r.name, str(r.n), span, str(missing), ", ".join(r.inputs), ", ".join(r.outputs)])
    return table(["experiment", "samples", "time", "missing values", "inputs", "outputs"], rows, "lrrrlt")


def steps_of(experiments: Sequence[Experiment]) -> str:
    """What was done to the records since they were read; nothing where that is nothing."""
    return bullets(f"{e.name}: {'; '.join(e.history)}" for e in experiments if e.history)


def files_table(paths: Sequence[str | os.PathLike[str]]) -> str:
    """Name, size and SHA-256 of files; nothing for none. Raises DataError for one that cannot be read."""
    rows = []
    for path in map(Path, paths):
        try:
            content = path.read_bytes()
        except OSError as error:
            raise DataError(f"{path}: cannot be read for the report ({error.strerror or error})") from error
        rows.append((path.name, f"{len(content):,}".replace(",", " "), hashlib.sha256(content).hexdigest()))
    listed = "".join(
        f"<dt>{escape(name)}</dt><dd>{size} bytes, SHA-256 <span class='hash'>{digest}</span></dd>"
        for name, size, digest in rows
    )
    return f"<h3>Files</h3><dl>{listed}</dl>" if rows else ""


def facts(known: Mapping[str, str]) -> str:
    """A list of facts, with versions and the date at its end."""
    import matplotlib
    import numpy
    import scipy

    versions = f"phugoid {_core.__version__}, Python {platform.python_version()}, numpy {numpy.__version__}, "
    versions += f"scipy {scipy.__version__}, matplotlib {matplotlib.__version__}"
    every = {**known, "versions": versions, "written": datetime.date.today().isoformat()}
    listed = "".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in every.items())
    return f"<dl>{listed}</dl>"
