"""ArduPilot's logs of the flight controller (DataFlash ``.bin``), read by pymavlink."""

from __future__ import annotations

import contextlib
import io
import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import DataError
from .source import Column, Source, existing, load, reading, stem
from .topic import topic_columns, topic_name, topics_in

__all__ = ["read_ardupilot"]

_KIND = "a log of ArduPilot (.bin)"


def read_ardupilot(path: Path, time: str | None, wanted: set[str]) -> Source:
    """Columns ``MESSAGE.field`` such as ``IMU.GyrX``, of a second instance ``IMU[1].GyrX``, timed by ``TimeUS``.

    Microseconds since the start of the autopilot become s; units are those that the log tells. Only messages that are
    asked for are unpacked.
    """
    existing(path)
    reader = load("pymavlink.DFReader", _KIND, "ardupilot")
    if path.stat().st_size == 0:
        raise DataError(f"{path}: is not {_KIND}, or is damaged or cut short (it is empty)")
    with reading(path, _KIND), _quiet():
        log = reader.DFReader_binary(str(path))
    try:
        kinds = {f.name: f for f in log.formats.values() if log.counts[f.type] and "TimeUS" in f.columns}
        asked = topics_in(wanted) & set(kinds) if len(kinds) > 1 else set(kinds)
        with reading(path, _KIND), _quiet():
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
        raise DataError(f"{path}: is not {_KIND}, or is damaged or cut short (it holds no messages with times)")
    return Source(str(path), stem(path), columns)


def _messages(log: Any, names: set[str]) -> dict[str, dict[int, list[list[Any]]]]:
    """Rows of the messages by name and instance."""
    found: dict[str, dict[int, list[list[Any]]]] = {}
    while names and (message := log.recv_match(type=list(names))) is not None:
        kind = message.fmt
        row = [getattr(message, column) for column in kind.columns]
        instance = 0 if kind.instance_field is None else int(getattr(message, kind.instance_field))
        found.setdefault(kind.name, {}).setdefault(instance, []).append(row)
    return found


def _unit(kind: Any, column: str) -> str:
    """As the log tells it, less what is no unit but a name for one."""
    unit = str(kind.get_unit(column)).strip()
    named = {"deglatitude": "deg", "deglongitude": "deg", "degheading": "deg", "UNKNOWN": "", "instance": ""}
    return named.get(unit, unit)


def _values(rows: list[list[Any]], i: int, name: str) -> Any:
    return np.array([row[i] for row in rows])


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """pymavlink prints what it finds wrong, a line a damaged byte; its part in C does so past Python's streams."""
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
