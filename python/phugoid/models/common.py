"""Common parts of the linear model forms: names of channels, feedthrough, outputs."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from numbers import Integral

import numpy as np

from .._core import Expr
from ..errors import ModelError, OptionError, listing
from ..linear.state_space import StateSpace
from ..modelling.model import Model
from ..parameters import Parameter

__all__ = ["add_feedthrough", "add_outputs", "channels_of", "counted", "summed"]


def channels_of(
    caller: str, inputs: str | Sequence[str] | None, outputs: str | Sequence[str] | None, system: StateSpace | None
) -> tuple[list[str], list[str]]:
    found = []
    for kind, given, there, letter in (
        ("inputs", inputs, None if system is None else system.inputs, "u"),
        ("outputs", outputs, None if system is None else system.outputs, "y"),
    ):
        names = given if given is not None else there or letter
        listed = names.replace(",", " ").split() if isinstance(names, str) else list(names)
        if not listed or not all(isinstance(name, str) for name in listed):
            raise OptionError(f"{caller}: {kind} holds names of channels, not {given!r}")
        if there is not None and len(listed) != len(there):
            raise ModelError(
                f"{caller}: {len(listed)} {kind} are named, but start has {len(there)}: {', '.join(there)}"
            )
        found.append(listed)
    return found[0], found[1]


def counted(what: str, given: int | None, there: int | None, unless: int | None = None, caller: str = "modal") -> int:
    if given is None:
        if there is None and unless is None:
            raise OptionError(f"{caller}: give {what}, or start")
        return int(there if there is not None else unless or 0)
    if not isinstance(given, Integral) or isinstance(given, bool) or given < 0:
        raise OptionError(f"{caller}: {what} is a whole number, not {given!r}")
    if there is not None and given != there:
        raise ModelError(f"{caller}: {what} is {given}, but start has {there}: leave it out, or give another start")
    return int(given)


def add_feedthrough(
    m: Model,
    caller: str,
    feedthrough: bool | Collection[str] | None,
    system: StateSpace | None,
    force: Sequence[Expr],
    outputs: Sequence[str],
    parts: list[list[Expr | float]],
    always: bool = False,
) -> None:
    """Add D u: ``d``, with names where there are several inputs or outputs, or ``always``."""
    if feedthrough is None:
        chosen = [] if system is None else [y for y, row in zip(outputs, system.D, strict=True) if np.any(row != 0.0)]
    elif isinstance(feedthrough, bool):
        chosen = list(outputs) if feedthrough else []
    else:
        chosen = [feedthrough] if isinstance(feedthrough, str) else list(feedthrough)
    for name in chosen:
        if name not in outputs:
            raise OptionError(f"{caller}: feedthrough: '{name}' is no output.{listing(str(name), outputs)}")
    for j, y in enumerate(outputs):
        for i, u in enumerate(force if y in chosen else ()):
            label = ["d"] + ([y] if always or len(outputs) > 1 else []) + ([str(u)] if always or len(force) > 1 else [])
            value = 0.0 if system is None else float(system.D[j, i])
            parts[j].append(m.parameters(**{"_".join(label): value})[0] * u)


def add_outputs(m: Model, outputs: Sequence[str], parts: list[list[Expr | float]], bias: bool) -> None:
    for y, terms in zip(outputs, parts, strict=True):
        if bias:
            terms.append(m.parameters(**{f"bias_{y}": Parameter(per_experiment=True)})[0])
        m.outputs(**{y: summed(terms)})


def summed(terms: Sequence[Expr | float]) -> Expr | float:
    return sum(terms[1:], terms[0]) if terms else 0.0
