"""Mutations of JSON documents, which know their structure, and of bytes."""

from __future__ import annotations

import copy
import json
from random import Random
from typing import Any

EXTREMES: tuple[Any, ...] = (
    *(0, -1, 1, 2, 3, 0.5, -0.0, 1e308, -1e308, 5e-324, 1e-16, 1e13, 10**9, 2**31, 2**63, 10**30, 10**400),
    *(
        "inf",
        "-inf",
        None,
        True,
        False,
        "",
        "x",
        "a\u0000b",
        "\ud800",
        "π" * 3,
        "y" * 3000,
        [],
        {},
        [[]],
        [None],
        {"": 0},
    ),
)


def mutated_json(document: Any, random: Random) -> Any:
    """A copy with one to three entries dropped, doubled, retyped, resized, nested, renamed or made extreme."""
    document = copy.deepcopy(document)
    for _ in range(random.choice((1, 1, 1, 2, 3))):
        _mutate(document, random)
    return document


def mutated_bytes(content: bytes, random: Random) -> bytes:
    """Bytes changed, cut out, doubled or put in, or an end cut off."""
    raw = bytearray(content)
    for _ in range(random.choice((1, 1, 2, 8))):
        at, more = random.randrange(len(raw) + 1), random.choice((1, 2, 4, 8, 64))
        kind = random.randrange(6)
        if kind == 0 and raw:
            raw[at % len(raw)] ^= 1 << random.randrange(8)
        elif kind == 1 and raw:
            raw[at % len(raw)] = random.choice((0, 1, 0x7F, 0x80, 0xFF, random.randrange(256)))
        elif kind == 2:
            del raw[at : at + more]
        elif kind == 3:
            raw[at:at] = raw[at : at + more]
        elif kind == 4:
            raw[at : at + more] = random.choice((b"\xff", b"\x00", b"9", b"-")) * more
        elif random.random() < 0.3:
            del raw[at:]
    return bytes(raw)


def _mutate(node: Any, random: Random) -> None:
    """Goes down to some container, and changes one of its entries."""
    while True:
        keys = list(node) if isinstance(node, dict) else list(range(len(node)))
        if not keys:
            _insert(node, random)
            return
        key = random.choice(keys)
        value = node[key]
        if isinstance(value, str) and value.startswith("{"):  # a model within a fit
            inner = json.loads(value)
            _mutate(inner, random)
            node[key] = json.dumps(inner)
            return
        if not isinstance(value, (dict, list)) or random.random() < 0.15:
            _change(node, key, random)
            return
        node = value


def _insert(node: Any, random: Random) -> None:
    if isinstance(node, dict):
        node[random.choice(("", "name", "x", "kind"))] = random.choice(EXTREMES)
    else:
        node.append(random.choice(EXTREMES))


def _change(node: Any, key: Any, random: Random) -> None:
    value, kind = node[key], random.randrange(8)
    if kind == 0:
        del node[key]
    elif kind == 1:
        if isinstance(node, list):
            node.insert(key, copy.deepcopy(value))
        else:
            node[str(key) + random.choice(("_", " ", "2"))] = node.pop(key)
    elif kind == 2 and isinstance(value, (list, str)) and value:
        node[key] = random.choice((value[: len(value) // 2], value + value, value[:1], value[:-1], value * 20))
    elif kind == 3:
        deep: Any = value
        for _ in range(random.choice((1, 2, 70, 200))):
            deep = [deep] if random.random() < 0.7 else {"x": deep}
        node[key] = deep
    elif kind == 4 and isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < 1e300:
        node[key] = random.choice((-value, value + 1, value * 1e6, value * 1e-9, int(value) if abs(value) < 1e9 else 0))
    elif kind == 5:
        other = random.choice(list(node) if isinstance(node, dict) else list(range(len(node))))
        node[key], node[other] = node[other], node[key]
    else:
        node[key] = copy.deepcopy(random.choice(EXTREMES))
