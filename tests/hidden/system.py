"""A vehicle or mechanism of which cases are made: its base model, true values, manoeuvres and effects."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import phugoid as ph

from .effect import Effect

__all__ = ["System", "Vehicle"]

Values = Mapping[str, Any]


@dataclass(frozen=True)
class Vehicle:
    """One specimen: true parameters by name, and the steady state and inputs that it starts from and is centred at."""

    parameters: dict[str, float]
    states: dict[str, float]
    inputs: dict[str, float]


@dataclass(frozen=True)
class System:
    """Equations are written once, for symbols, numbers and arrays over lanes alike.

    states, inputs, outputs  name -> unit.
    derivatives     nominal values of the parameters; true ones lie within 20 % of them.
    biases          of sensors, parameters too: standard deviation of their true values.
    quantities      (x, u, p) -> name -> value, with x and u in the order of states and inputs; may be empty.
    dynamics        (x, u, q, p) -> derivatives of the states, q the quantities by name.
    measured        (x, u, q, p) -> outputs by name.
    sigma           standard deviation of the noise by output.
    step, samples   of a record, s.
    amplitudes      input -> range of the peaks of manoeuvres, from trim.
    pulse           range of the width of a pulse of a manoeuvre, s.
    wander          state -> standard deviation of its start from trim, where a record does not start steady.
    limits          state -> farthest that it may get from trim.
    trim            completes (parameters, random numbers) to steady states and inputs; all zero where None.
    steep           state -> width of the tanh that stands for its sign.
    needed          inputs that move in every record, since parameters stand with them; the first always does.
    substeps        Runge-Kutta steps in a sample interval, for the strength of effects.
    """

    name: str
    states: Mapping[str, str]
    inputs: Mapping[str, str]
    outputs: Mapping[str, str]
    derivatives: Mapping[str, float]
    biases: Mapping[str, float]
    quantities: Callable[[Sequence[Any], Sequence[Any], Values], dict[str, Any]]
    dynamics: Callable[[Sequence[Any], Sequence[Any], Values, Values], list[Any]]
    measured: Callable[[Sequence[Any], Sequence[Any], Values, Values], dict[str, Any]]
    sigma: Mapping[str, float]
    step: float
    samples: int
    amplitudes: Mapping[str, tuple[float, float]]
    pulse: tuple[float, float]
    wander: Mapping[str, float]
    limits: Mapping[str, float]
    effects: Sequence[Effect]
    trim: Callable[[dict[str, float], np.random.Generator], tuple[dict[str, float], dict[str, float]]] | None = None
    steep: Mapping[str, float] = field(default_factory=dict)
    needed: Sequence[str] = ()
    substeps: int = 1

    @property
    def t(self) -> np.ndarray:
        """(N,) times of the samples, s."""
        return self.step * np.arange(self.samples)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of what the base model estimates."""
        return (*self.derivatives, *self.biases)

    def effect(self, name: str) -> Effect:
        """The effect of that name."""
        found = {e.name: e for e in self.effects}
        if name not in found:
            raise KeyError(f"{self.name} has no effect '{name}'; it has {', '.join(found)}")
        return found[name]

    def vehicle(self, rng: np.random.Generator) -> Vehicle:
        """A specimen, drawn."""
        p = {name: value * rng.uniform(0.8, 1.2) for name, value in self.derivatives.items()}
        p |= {name: sigma * rng.standard_normal() for name, sigma in self.biases.items()}
        if self.trim is None:
            return Vehicle(p, dict.fromkeys(self.states, 0.0), dict.fromkeys(self.inputs, 0.0))
        return Vehicle(p, *self.trim(p, rng))

    def model(self) -> ph.Model:
        """The base model, without any effect; parameters start at 0."""
        m = ph.Model(self.name)
        x, u = m.states(**self.states), m.inputs(**self.inputs)
        p = dict(zip(self.parameters, m.parameters(" ".join(self.parameters)), strict=True))
        q = self.quantities(x, u, p)
        if q:
            q = dict(zip(q, m.quantities(**q), strict=True))
        m.dynamics(**dict(zip(self.states, self.dynamics(x, u, q, p), strict=True)))
        m.outputs(**{name: (y, self.outputs[name]) for name, y in self.measured(x, u, q, p).items()})
        return m
