"""PX4 logs as tables: a CSV file a topic, as pyulog's ``ulog2csv`` writes them, also gzipped."""

from __future__ import annotations

import gzip
import re
from functools import cache, partial
from itertools import takewhile
from pathlib import Path
from typing import Any

from ...errors import DataError
from .source import Column, Source, reading
from .text import read_text
from .topic import topic_columns, topic_name

__all__ = ["find_tables", "read_px4_tables"]

_FILE = re.compile(r"(.+)_(\d+)\.csv(?:\.gz)?")
# Topics begin so: where all tables of a folder share such a word, it is no part of the log's name.
_FIRST_WORDS = ("vehicle", "sensor", "actuator", "estimator", "airspeed", "battery", "distance", "position")


def find_tables(path: Path) -> dict[str, Path]:
    """The tables of the log at a path, topic -> file; none where it is neither a folder of them nor their beginning.

    The path is a folder, or what the names of the tables begin with: ``logs/flight3`` for
    ``logs/flight3_vehicle_attitude_0.csv``.
    """
    folder, start = (path, "") if path.is_dir() else (path.parent, path.name.rstrip("_") + "_")
    if not folder.is_dir() or path.is_file():
        return {}
    files = {f.name: f for f in sorted(folder.iterdir()) if f.name.startswith(start) and _FILE.fullmatch(f.name)}
    log = start or _log_name(list(files))
    found = {}
    for name, file in files.items():
        match = _FILE.fullmatch(name)
        assert match
        found[topic_name(match[1].removeprefix(log), int(match[2]))] = file
    return found


def read_px4_tables(path: Path, tables: dict[str, Path], time: str | None) -> Source:
    """Columns ``topic.field``, timed by ``timestamp`` or, say, by ``time="timestamp_sample"``; microseconds become s.

    A table is read when a column of it is asked for. Times are since the start of the autopilot.
    """
    columns: list[Column] = []
    for topic, file in tables.items():
        fields = _header(file)
        if "timestamp" not in fields:
            raise DataError(f"{file}: is not a table of a PX4 log: its header has no 'timestamp'")
        read = cache(partial(_columns, file))
        of_topic = {f: (partial(_values, read, f), "us" if f.startswith("timestamp") else "") for f in fields}
        columns += topic_columns(topic, of_topic, "timestamp", time)
    return Source(str(path), path.name.rstrip("_"), columns)


def _log_name(files: list[str]) -> str:
    """What the names of all files begin with, up to an underscore, less the first words of topics."""
    alike = takewhile(lambda letters: len(set(letters)) == 1, zip(*files, strict=False))
    common = "".join(letters[0] for letters in alike) if len(files) > 1 else ""
    words = common.split("_")[:-1]
    while words and words[-1] in _FIRST_WORDS:
        words.pop()
    return "".join(f"{word}_" for word in words)


def _header(file: Path) -> list[str]:
    with reading(file, "a text table"), (gzip.open if file.suffix == ".gz" else open)(file, "rb") as stream:
        return [cell.strip().strip('"') for cell in stream.readline().decode("utf-8-sig").split(",")]


def _columns(file: Path) -> dict[str, Column]:
    return {column.name: column for column in read_text(file, None, ",").columns}


def _values(read: Any, field: str, name: str) -> Any:
    return read()[field].values(name)
