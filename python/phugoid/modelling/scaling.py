"""Scalings of states and parameters that no output can tell."""

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

    def parameters(self, states: tuple[str, ...]) -> list[str]:
        """The parameters that are scaled."""
        return [name for name in self.exponents if name not in states]

    def advice(self, states: tuple[str, ...]) -> str:
        """Say which quantities are free to scale, and what to fix."""
        scaled = ", ".join(f"{name}*{_power(e)}" for name, e in self.exponents.items())
        parameters, own = self.parameters(states), [name for name in self.exponents if name in states]
        fix = f"fix one of {', '.join(parameters)}" if len(parameters) > 1 else f"fix {parameters[0]}"
        known = f", or give {' or '.join(own[:3])} a known initial value (model.initial)" if own else ""
        return (
            f"{', '.join(self.exponents)} cannot be told apart with any data: the outputs stay the same with {scaled} "
            f"for every s > 0; {self.held} was held at {self.at:g}. To determine them {fix}{known}, or give one a prior"
        )


def _power(exponent: float) -> str:
    return "s" if exponent == 1 else f"s**{exponent:.4g}" if exponent > 0 else f"s**({exponent:.4g})"


def scalings(core: _core.Model, starts: Mapping[str, float]) -> list[ScalingSymmetry]:
    """The scalings of a model that is complete, its parameters starting at ``starts``."""
    return [ScalingSymmetry(dict(exponents), held, at) for exponents, held, at in core.scalings(list(starts.values()))]
