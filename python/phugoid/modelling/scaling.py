"""Scalings of states and parameters that leave all outputs unchanged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from .. import _core

__all__ = ["ScalingSymmetry", "scalings"]


@dataclass(frozen=True)
class ScalingSymmetry:
    """A family of models with the same outputs: each quantity is multiplied by s to the power of its exponent.

    exponents  name of state or parameter -> exponent, states first.
    held       the parameter that an estimate holds, so that the others are determined, and ``at`` which value.
    """

    exponents: Mapping[str, float]
    held: str
    at: float


def scalings(core: _core.Model, starts: Mapping[str, float]) -> list[ScalingSymmetry]:
    """Return the scaling symmetries of a complete model, its parameters starting at ``starts``."""
    return [ScalingSymmetry(dict(exponents), held, at) for exponents, held, at in core.scalings(list(starts.values()))]
