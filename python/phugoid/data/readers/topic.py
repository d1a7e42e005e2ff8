"""Messages of a flight log: a topic is a table with time stamps of its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from .source import Column

__all__ = ["topic_columns", "topic_name", "topics_in"]


def topic_name(topic: str, instance: int) -> str:
    """``sensor_accel`` of the first instance, ``sensor_accel[1]`` of the second."""
    return topic if instance == 0 else f"{topic}[{instance}]"


def topic_columns(
    topic: str, fields: Mapping[str, tuple[Callable[[str], Any], str]], stamp: str, time: str | None
) -> list[Column]:
    """Columns ``topic.field`` of the fields (values, unit), timed by the stamp, or by ``time`` where it is one."""
    clock = time if time in fields else stamp
    return [
        Column(f"{topic}.{name}", values, unit, times=f"{topic}.{clock}") for name, (values, unit) in fields.items()
    ]


def topics_in(wanted: set[str]) -> set[str]:
    """The topics, without instance, of names such as ``sensor_accel[1].x``."""
    return {name.partition(".")[0].partition("[")[0] for name in wanted}
