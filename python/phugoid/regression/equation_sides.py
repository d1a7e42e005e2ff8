"""The data of an experiment for regression equations, and the parameters as its unknowns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..data.experiment import Experiment
from ..errors import DataError
from ..modelling.model import Model
from ..records import Record
from .differentiate import Differentiator
from .equations import Equation, Evaluation, MeasuredChannel

__all__ = ["EquationSides", "Unknown", "unknowns_of"]

_Array: TypeAlias = NDArray[np.float64]
_Mask: TypeAlias = NDArray[np.bool_]
_Of = TypeVar("_Of", bound=Mapping[str, float])


@dataclass(frozen=True)
class Unknown:
    """A parameter, of all experiments or of one alone."""

    label: str
    name: str
    experiment: int | None

    def among(self, each: Sequence[_Of]) -> Sequence[_Of]:
        """Return the values of those experiments that the parameter belongs to."""
        return each if self.experiment is None else each[self.experiment : self.experiment + 1]


def unknowns_of(model: Model, names: Sequence[str], runs: Sequence[Experiment]) -> list[Unknown]:
    declared = model.declared_parameters
    found = []
    for name in names:
        if declared[name].per_experiment:
            found += [Unknown(f"{name}[{run.name}]", name, i) for i, run in enumerate(runs)]
        else:
            found.append(Unknown(name, name, None))
    return found


class EquationSides:
    """The data of an experiment for the equations: left-hand sides (E, N), valid rows, columns for the right-hand
    sides."""

    def __init__(
        self,
        model: Model,
        run: Experiment,
        measured: Sequence[MeasuredChannel],
        listed: Sequence[Equation],
        way: Differentiator,
    ) -> None:
        self.model, self.run, self.measured, self.listed = model, run, measured, listed
        smooth = {c.state: _smooth(run, c, way) for c in measured}
        self.columns = np.vstack(
            [run.t, *(run.input(n) for n in model.input_names), *(smooth[n][0] for n in model.state_names)]
        )
        # Beyond the first and the last sample of a state the smoothing extrapolates.
        covered = np.ones(run.n, dtype=bool)
        for c in measured:
            present = np.flatnonzero(np.isfinite(run.output(c.output)))
            covered[: present[0]] = covered[present[-1] + 1 :] = False
        own = [np.isfinite(run.output(e.channel.output if e.channel else e.name)) for e in listed]
        self.mask: _Mask = np.array([covered & o for o in own])
        left = [smooth[e.channel.state][1] if e.channel else run.output(e.name) for e in listed]
        self.left = np.where(self.mask, np.array(left), 0.0)

    def unit(self, equation: Equation) -> str:
        """Return the unit of the sides of an equation, where it is known."""
        units = self.model.units
        if equation.channel is None:
            return units.get(equation.name, "")
        own = units.get(equation.channel.output, units.get(equation.channel.state))
        return f"{own}/s" if own else ""

    def record(self, values: Mapping[str, float]) -> Record:
        """Return a record of both sides at the result."""
        right, _ = Evaluation(self.model, self.listed, [])(values, self.columns)
        left = np.where(self.mask, self.left, np.nan)
        first = 1 + len(self.model.input_names)
        channel = dict(zip(self.model.state_names, self.columns[first:], strict=True))
        states = {
            c.state: (channel[c.state] - _number(c.offset, values)) / _number(c.slope, values) for c in self.measured
        }
        states = {name: states[name] for name in self.model.state_names}
        units = {**self.model.units, **{e.name: unit for e in self.listed if (unit := self.unit(e))}}
        names = [e.name for e in self.listed]
        return Record(
            name=self.run.name,
            t=self.run.t,
            inputs={n: self.run.input(n) for n in self.model.input_names},
            outputs=dict(zip(names, right, strict=True)),
            states=states,
            measured=dict(zip(names, left, strict=True)),
            residuals=dict(zip(names, left - right, strict=True)),
            mesh_t=self.run.t,
            mesh_states=states,
            units=units,
        )


def _smooth(run: Experiment, channel: MeasuredChannel, way: Differentiator) -> tuple[_Array, _Array]:
    try:
        return way.smooth(run.t, run.output(channel.output))
    except DataError as error:
        raise DataError(f"experiment '{run.name}', output '{channel.output}': {error}") from None


def _number(e: Any, values: Mapping[str, float]) -> float:
    return float(e.evaluate({n: values[n] for n in e.symbols}))
