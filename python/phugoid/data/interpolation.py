"""The declaration of how inputs behave between samples, checked, and the interpolated values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

import phugoid._core as _core

from ..errors import DataError, listing

__all__ = ["Interpolation", "Interpolations", "checked_kinds", "interpolated", "kind_of", "kinds_for"]

_Array = NDArray[np.float64]

Interpolation = Literal["linear", "cubic", "hold"]
"""Straight lines, a cubic spline, or each sample held until the next (zero-order hold)."""
Interpolations: TypeAlias = "Interpolation | Mapping[str, Interpolation]"
"""One for all inputs, or by name; ``"linear"`` for inputs that are not named."""

_KINDS = "take 'linear', 'cubic' or 'hold', or a mapping such as {'de': 'hold'}"


def checked_kinds(experiment: str, kinds: object, names: Iterable[str]) -> Interpolations:
    """Return a declaration for channels of these names, as a copy of its own.

    Raises DataError for unknown kinds and unknown names.
    """
    if isinstance(kinds, str):
        _check(f"experiment '{experiment}'", kinds)
        return kinds  # type: ignore[return-value]
    if not isinstance(kinds, Mapping):
        raise DataError(f"experiment '{experiment}': interpolation {kinds!r} is not known; {_KINDS}")
    there = list(names)
    for name, kind in kinds.items():
        if name not in there:
            raise DataError(
                f"experiment '{experiment}': interpolation names the input '{name}', which is not there."
                f"{listing(str(name), there)}"
            )
        _check(f"experiment '{experiment}', input '{name}'", kind)
    return dict(kinds)


def _check(where: str, kind: object) -> None:
    if not isinstance(kind, str) or kind not in get_args(Interpolation):
        raise DataError(f"{where}: interpolation {kind!r} is not known; {_KINDS}")


def kind_of(kinds: Interpolations, name: str) -> Interpolation:
    """Return how the input of a name behaves between its samples."""
    return kinds if isinstance(kinds, str) else kinds.get(name, "linear")


def kinds_for(kinds: Interpolations, names: Iterable[str]) -> Interpolations:
    """Return the declaration for these inputs alone: one for all where they agree."""
    by_name = {name: kind_of(kinds, name) for name in names}
    if isinstance(kinds, str) or not by_name:
        return kinds if isinstance(kinds, str) else "linear"
    first, *others = set(by_name.values())
    return by_name if others else first


def interpolated(kind: Interpolation, t: _Array, values: _Array, at: _Array) -> _Array:
    """Return the values at the times ``at`` (s, any shape) of a signal sampled at the times ``t`` (s)."""
    found = _core.interpolate(kind, t.tolist(), values.tolist(), at.ravel().tolist())
    return np.array(found, dtype=np.float64).reshape(at.shape)
