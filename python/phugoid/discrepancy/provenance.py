"""Which data and versions a report comes from."""

from __future__ import annotations

import datetime
import platform
from collections.abc import Mapping, Sequence
from html import escape

from .. import _core
from ..records import Record
from .markup import table

__all__ = ["facts", "records_table"]


def records_table(records: Sequence[Record]) -> str:
    """A row for each record."""
    rows = []
    for r in records:
        missing = sum(int((z != z).sum()) for z in r.measured.values())
        span = f"{r.t[0]:g} to {r.t[-1]:g} s"
        rows.append([r.name, str(r.n), span, str(missing), ", ".join(r.inputs), ", ".join(r.outputs)])
    return table(["experiment", "samples", "time", "missing values", "inputs", "outputs"], rows, "lrrrll")


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
