"""An effect that a model leaves out: its canonical name, and the sizes that it may physically have."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

__all__ = ["Effect", "Part", "term"]

FACTOR = re.compile(
    r"sign\((?P<sign>\w+)\)|\|(?P<abs>\w+)\||(?P<quadratic>\w+)\|(?P=quadratic)\||(?P<base>\w+?)(\^(?P<power>\d))?"
)
SHAPED = {"lag", "delay", "deadband", "saturation", "scale", "bias", "drift", "periodic"}


@dataclass(frozen=True)
class Effect:
    """An effect by its canonical name, ``where:what``.

    kind    what it counts as: "aerodynamic", "control", "unmodelled state", "sensor", "friction", "damping",
            "stiffness" or "disturbance".
    span    smallest and largest size of the coefficient, in its unit: a term's factor, s for a delay or a lag's time
            constant, the half-width of a dead-band, the limit of a saturation (both about trim), per s for a drift.
    signs   of the coefficient.
    shapes  ranges of its other numbers: tau (s), frequency (Hz), phase (rad).
    moves   an input that must move to show it.
    """

    name: str
    kind: str
    span: tuple[float, float]
    signs: tuple[int, ...] = (1, -1)
    shapes: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    moves: str = ""

    @property
    def where(self) -> str:
        """The quantity, state equation (with a prime), input or output."""
        return self.name.partition(":")[0]

    @property
    def what(self) -> str:
        """What is there: a term, or the word for another effect."""
        return self.name.partition(":")[2]

    @property
    def form(self) -> str:
        """ "term", "lagged" (a term in a lagged variable) or the word."""
        return "lagged" if self.what.startswith("lag_") else self.what if self.what in SHAPED else "term"

    def draw(self, rng: np.random.Generator) -> tuple[int, dict[str, float]]:
        """A sign and the other numbers: phases uniform, the rest log-uniform."""
        drawn = {
            n: rng.uniform(*r) if n == "phase" else float(np.exp(rng.uniform(*np.log(r))))
            for n, r in self.shapes.items()
        }
        return int(rng.choice(self.signs)), drawn


@dataclass(frozen=True)
class Part:
    """An effect with numbers: the coefficient is a float, or an array of one value a lane."""

    effect: Effect
    coefficient: Any
    shape: Mapping[str, float]


def term(
    what: str, names: Sequence[str], trim: Sequence[float], steep: Mapping[str, float]
) -> Callable[[Sequence[Any]], Any]:
    """The product that a name stands for, as a function of the values of ``names``, each centred at trim.

    ``sign(v)`` is tanh(v / steep[v]).
    """
    factors = []
    for text in what.split("*"):
        match = FACTOR.fullmatch(text)
        if match is None:
            raise ValueError(f"'{text}' in '{what}' is not a factor of a term")
        name = match["sign"] or match["abs"] or match["quadratic"] or match["base"]
        i = list(names).index(name)
        factors.append((i, trim[i], match, steep.get(name, 0.0)))

    def product(values: Sequence[Any]) -> Any:
        result: Any = 1.0
        for i, centre, match, width in factors:
            d = values[i] - centre
            if match["sign"]:
                result = result * np.tanh(d / width)
            elif match["abs"]:
                result = result * abs(d)
            elif match["quadratic"]:
                result = result * d * abs(d)
            else:
                result = result * d ** int(match["power"] or 1)
        return result

    return product
