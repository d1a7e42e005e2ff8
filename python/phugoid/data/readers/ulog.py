"""PX4 logs (ULog), read by pyulog."""

from __future__ import annotations

import contextlib
import io
import warnings
from pathlib import Path
from typing import Any

from ...errors import DataError
from .source import Column, Source, existing, load, reading, stem
from .topic import topic_columns, topic_name, topics_in

__all__ = ["read_ulog"]

_KIND = "a PX4 log (ULog)"


def read_ulog(path: Path, time: str | None, wanted: set[str]) -> Source:
    """Columns ``topic.field``, timed by ``timestamp`` or, say, by ``time="timestamp_sample"``; microseconds become s.

    Times are since the start of the autopilot. A log with bytes that make no sense is read as far as it goes, with a
    warning: messages may be lost, as they are where a log ends with the battery.
    """
    existing(path)
    core = load("pyulog.core", _KIND, "px4")
    # Only the topics asked for are unpacked, unless one of them is not there: then the message names all.
    topics = sorted(topics_in(wanted))
    columns = _columns(core, path, time, topics) if topics else []
    if not topics_in({column.name for column in columns}) >= set(topics) or not columns:
        columns = _columns(core, path, time, None)
    if not columns:
        raise DataError(f"{path}: the log holds no data, or is damaged or cut short")
    return Source(str(path), stem(path), columns)


def _columns(core: Any, path: Path, time: str | None, topics: list[str] | None) -> list[Column]:
    # pyulog prints what it finds wrong.
    with reading(path, _KIND), contextlib.redirect_stdout(io.StringIO()):
        log = core.ULog(str(path), topics)
        found = [(data.name, data.multi_id, data.data) for data in log.data_list]
        damaged = log.file_corruption
    if damaged:
        warnings.warn(f"{path}: parts of the log are damaged; messages may be missing", stacklevel=6)
    columns: list[Column] = []
    for topic, instance, data in found:
        fields = {n: (lambda _, v=v: v, "us" if n.startswith("timestamp") else "") for n, v in data.items()}
        if "timestamp" in data and len(data["timestamp"]):
            columns += topic_columns(topic_name(topic, instance), fields, "timestamp", time)
    return columns
