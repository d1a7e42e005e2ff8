"""Flight logs: PX4 (ULog by pyulog, or the CSV tables of ulog2csv) and ArduPilot (DataFlash, by pymavlink)."""

from __future__ import annotations

import contextlib
import gzip
import io
import os
import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from functools import cache, partial
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import DataError
from . import Column, Source, existing, load, reading, stem
from .text import read_text

__all__ = ["find_tables", "read_ardupilot", "read_px4_tables", "read_ulog"]


def topic_name(topic: str, instance: int) -> str:
    """Return ``sensor_accel`` for the first instance of a topic, ``sensor_accel[1]`` for the second."""
    return topic if instance == 0 else f"{topic}[{instance}]"


def topic_columns(
    topic: str, fields: Mapping[str, tuple[Callable[[str], Any], str]], stamp: str, time: str | None
) -> list[Column]:
    """Return columns ``topic.field`` of the fields (values, unit), timed by the stamp, or by ``time`` if it is
    a field."""
    clock = time if time in fields else stamp
    return [
        Column(f"{topic}.{name}", values, unit, times=f"{topic}.{clock}") for name, (values, unit) in fields.items()
    ]


def topics_in(requested: set[str]) -> set[str]:
    """Return the topics, without instance, of names such as ``sensor_accel[1].x``."""
    return {name.partition(".")[0].partition("[")[0] for name in requested}


_ULOG = "a PX4 log (ULog)"


def read_ulog(path: Path, time: str | None, requested: set[str]) -> Source:
    """Read columns ``topic.field``, timed by ``timestamp`` or, say, ``time="timestamp_sample"``; microseconds become s.

    Times are since the start of the autopilot. A log with bytes that make no sense is read as far as it goes, with a
    warning: messages may be lost, as they are where a log ends with the battery.
    """
    existing(path)
    core = load("pyulog.core", _ULOG, "px4")
    # Only the topics asked for are unpacked, unless one of them is not there: then the message names all.
    topics = sorted(topics_in(requested))
    columns = _ulog_columns(core, path, time, topics) if topics else []
    if not topics_in({column.name for column in columns}) >= set(topics) or not columns:
        columns = _ulog_columns(core, path, time, None)
    if not columns:
        raise DataError(f"{path}: the log holds no data, or is damaged or cut short")
    return Source(str(path), stem(path), columns)


def _ulog_columns(core: Any, path: Path, time: str | None, topics: list[str] | None) -> list[Column]:
    # pyulog prints what it finds wrong.
    with reading(path, _ULOG), contextlib.redirect_stdout(io.StringIO()):
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


_FILE = re.compile(r"(.+)_(\d+)\.csv(?:\.gz)?")
# Topics begin so: where all tables of a folder share such a word, it is not a part of the log's name.
_FIRST_WORDS = ("vehicle", "sensor", "actuator", "estimator", "airspeed", "battery", "distance", "position")


def find_tables(path: Path) -> dict[str, Path]:
    """Return the tables of the log at a path, topic -> file; {} where the path is not such a log.

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
    """Read columns ``topic.field``, timed by ``timestamp`` or, say, ``time="timestamp_sample"``; microseconds become s.

    A table is read when a column of it is asked for. Times are since the start of the autopilot.
    """
    columns: list[Column] = []
    for topic, file in tables.items():
        fields = _header(file)
        if "timestamp" not in fields:
            raise DataError(f"{file}: is not a table of a PX4 log: its header has no 'timestamp'")
        read = cache(partial(_table_columns, file))
        of_topic = {f: (partial(_table_values, read, f), "us" if f.startswith("timestamp") else "") for f in fields}
        columns += topic_columns(topic, of_topic, "timestamp", time)
    return Source(str(path), path.name.rstrip("_"), columns)


def _log_name(files: list[str]) -> str:
    """Return the common beginning of all file names, up to an underscore, without the first words of topics."""
    alike = takewhile(lambda letters: len(set(letters)) == 1, zip(*files, strict=False))
    common = "".join(letters[0] for letters in alike) if len(files) > 1 else ""
    words = common.split("_")[:-1]
    while words and words[-1] in _FIRST_WORDS:
        words.pop()
    return "".join(f"{word}_" for word in words)


def _header(file: Path) -> list[str]:
    with reading(file, "a text table"), (gzip.open if file.suffix == ".gz" else open)(file, "rb") as stream:
        return [cell.strip().strip('"') for cell in stream.readline().decode("utf-8-sig").split(",")]


def _table_columns(file: Path) -> dict[str, Column]:
    return {column.name: column for column in read_text(file, None, ",").columns}


def _table_values(read: Any, field: str, name: str) -> Any:
    return read()[field].values(name)


_DATAFLASH = "a log of ArduPilot (.bin)"


def read_ardupilot(path: Path, time: str | None, requested: set[str]) -> Source:
    """Read columns ``MESSAGE.field`` such as ``IMU.GyrX``, of a second instance ``IMU[1].GyrX``, timed by ``TimeUS``.

    Microseconds since the start of the autopilot become s; units are those given in the log. Only messages that are
    asked for are unpacked.
    """
    existing(path)
    reader = load("pymavlink.DFReader", _DATAFLASH, "ardupilot")
    if path.stat().st_size == 0:
        raise DataError(f"{path}: is not {_DATAFLASH}, or is damaged or cut short (it is empty)")
    with reading(path, _DATAFLASH), _quiet():
        log = reader.DFReader_binary(str(path))
    try:
        kinds = {f.name: f for f in log.formats.values() if log.counts[f.type] and "TimeUS" in f.columns}
        asked = topics_in(requested) & set(kinds) if len(kinds) > 1 else set(kinds)
        with reading(path, _DATAFLASH), _quiet():
            messages = _messages(log, asked)
    finally:
        log.data_map.close()
        log.filehandle.close()
    columns: list[Column] = []
    for name, kind in kinds.items():
        units = {c: "us" if c == "TimeUS" else _unit(kind, c) for c in kind.columns}
        for instance, rows in messages.get(name, {0: []}).items():
            fields = {c: (partial(_values, rows, i), units[c]) for i, c in enumerate(kind.columns)}
            columns += topic_columns(topic_name(name, instance), fields, "TimeUS", time)
    if not columns:
        raise DataError(f"{path}: is not {_DATAFLASH}, or is damaged or cut short (it holds no messages with times)")
    return Source(str(path), stem(path), columns)


def _messages(log: Any, names: set[str]) -> dict[str, dict[int, list[list[Any]]]]:
    """Return the rows of the messages by name and instance."""
    found: dict[str, dict[int, list[list[Any]]]] = {}
    while names and (message := log.recv_match(type=list(names))) is not None:
        kind = message.fmt
        row = [getattr(message, column) for column in kind.columns]
        instance = 0 if kind.instance_field is None else int(getattr(message, kind.instance_field))
        found.setdefault(kind.name, {}).setdefault(instance, []).append(row)
    return found


def _unit(kind: Any, column: str) -> str:
    """Return a unit as given in the log; "" for text that is not a unit."""
    unit = str(kind.get_unit(column)).strip()
    named = {"deglatitude": "deg", "deglongitude": "deg", "degheading": "deg", "UNKNOWN": "", "instance": ""}
    return named.get(unit, unit)


def _values(rows: list[list[Any]], i: int, name: str) -> Any:
    return np.array([row[i] for row in rows])


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Suppress output, since pymavlink prints a line for every damaged byte; its C part does so past Python's
    streams."""
    with contextlib.ExitStack() as stack:
        stack.enter_context(contextlib.redirect_stdout(io.StringIO()))
        stack.enter_context(contextlib.redirect_stderr(io.StringIO()))
        with contextlib.suppress(OSError):  # a program without a console may have no such stream
            kept = os.dup(2)
            stack.callback(os.close, kept)
            stack.callback(os.dup2, kept, 2)
            with open(os.devnull, "wb") as nowhere:
                os.dup2(nowhere.fileno(), 2)
        yield
