"""What differs from condition to condition: values of constants, as signals that are constant in a phase."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from .._core import Expr
from ..errors import ModelError

__all__ = ["Conditions", "Phase"]


@dataclass(frozen=True)
class Phase:
    """The conditions of a simulation: of the steady state before it, if there is one, and its own."""

    before: str | None
    during: str

    @property
    def name(self) -> str:
        """The name of the experiment."""
        return self.during if self.before is None else f"{self.before}__{self.during}"


@dataclass
class Conditions:
    """The condition table, read for a set of phases.

    values   by name: what stands for it in the model, an expression in parameters and signals.
    signals  by signal: its value by condition.
    """

    values: dict[str, Expr] = field(default_factory=dict)
    signals: dict[str, dict[str, float]] = field(default_factory=dict)

    @classmethod
    def read(cls, table: Any, used: Sequence[str], defaults: Mapping[str, Expr]) -> Conditions:
        """Read a condition table for the conditions that are ``used``.

        ``defaults``: values of names of which a condition says nothing (NaN). Raises ModelError where there is none.
        """
        found = cls()
        entries: dict[str, float | str | Expr | None]
        for name in table.columns:
            if name == "conditionName":
                continue
            entries = {c: _entry(table.loc[c, name]) for c in used}
            if all(e is None for e in entries.values()):
                continue
            if missing := [c for c, e in entries.items() if e is None]:
                if name not in defaults:
                    raise ModelError(f"PEtab: condition {missing[0]} has no value of {name}, and the model has none")
                entries |= dict.fromkeys(missing, defaults[name])
            found._add(str(name), entries)
        return found

    def _add(self, name: str, entries: Mapping[str, float | str | Expr | None]) -> None:
        numbers = {c: e for c, e in entries.items() if isinstance(e, float)}
        others: dict[str, tuple[Expr, list[str]]] = {}
        for condition, entry in entries.items():
            if isinstance(entry, (str, Expr)):
                value = Expr.symbol(entry) if isinstance(entry, str) else entry
                others.setdefault(str(value), (value, []))[1].append(condition)
        if not others and len(set(numbers.values())) == 1:
            self.values[name] = Expr(next(iter(numbers.values())))
            return
        if not numbers and len(others) == 1:
            self.values[name] = next(iter(others.values()))[0]
            return
        total = Expr(0.0)
        if any(numbers.values()):
            self.signals[f"{name}_given"] = {c: numbers.get(c, 0.0) for c in entries}
            total = Expr.symbol(f"{name}_given")
        for k, (value, where) in enumerate(others.values(), 1):
            chosen = f"{name}_is_{value.name or k}"
            self.signals[chosen] = {c: float(c in where) for c in entries}
            total = Expr(total + Expr.symbol(chosen) * value)
        self.values[name] = total


def _entry(value: Any) -> float | str | None:
    """Return a number, the name of a parameter, or None for an empty entry."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        text = str(value).strip()
        return text or None
    return None if math.isnan(number) else number
