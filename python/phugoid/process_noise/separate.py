"""Replacement of parameters of single experiments by shared ones, for methods that support only these.

A parameter p of which each experiment has its own becomes the quantity p = s1 p1 + s2 p2 + ..., with an input s_i that
is 1 in experiment i and 0 elsewhere. The fit is the same; it costs derivatives that are zero, so transcriptions that
can do without do so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from .. import _core
from .._core import Expr
from ..data.experiment import Experiment
from ..data.interpolation import kinds_for
from ..fit_result import FitResult
from ..modelling.model import Model
from ..modelling.rebuilt import rebuilt
from ..parameters import Estimates

__all__ = ["Separated"]


class Separated:
    """A model and experiments with shared parameters only, and the conversion of results back."""

    def __init__(self, model: Model, experiments: Sequence[Experiment]) -> None:
        self.original, self.records = model, list(experiments)
        local = [name for name, p in model.declared_parameters.items() if p.per_experiment]
        numbers = range(len(experiments))
        self.names = {f"{name}__{i}": f"{name}[{experiments[i].name}]" for name in local for i in numbers}
        self.model = self._model(local, len(experiments))
        self.experiments = [self._experiment(e, i) for i, e in enumerate(experiments)]

    def _model(self, local: Sequence[str], count: int) -> Model:
        def declare(core: _core.Model, declared: Any) -> None:
            name, unit, start, low, high, prior, fixed, _, log, scale = declared

            def shared(name: str) -> Expr:
                return core.parameter(name, unit, start, low, high, prior, fixed, False, log, scale)

            if name not in local:
                shared(name)
                return
            own = (shared(f"{name}__{i}") * Expr.symbol(f"experiment__{i}") for i in range(count))
            core.quantity(name, Expr(sum(own, Expr(0.0))), None)

        switches = [(f"experiment__{i}", "") for i in range(count)]
        old = self.original._core
        return self.original._around(rebuilt(old, [*old.inputs, *switches], declare), self.original.delays)

    def _experiment(self, e: Experiment, number: int) -> Experiment:
        switches = {f"experiment__{i}": np.full(e.n, float(i == number)) for i in range(len(self.records))}
        inputs = {name: e.input(name) for name in self.original.input_names}
        outputs = {name: e.output(name) for name in self.original.output_names}
        kinds = kinds_for(e.interpolation, inputs)
        other = Experiment(e.t, {**inputs, **switches}, outputs, e.name, kinds, units=e.units)
        signals = {name: s for name in inputs if (s := e.signal(name)) is not None}
        return other._sampled(signals, e.mesh_times)

    def start(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return start values by the new names."""
        found = {name: value for name, value in given.items() if name in self.model.parameter_names}
        for new, old in self.names.items():
            base = old.partition("[")[0]
            if old in given or base in given:
                found[new] = given.get(old, given.get(base))
        taken = {*self.names.values(), *(old.partition("[")[0] for old in self.names.values())}
        return {**{name: value for name, value in given.items() if name not in taken}, **found}

    def fit(self, fit: FitResult) -> FitResult:
        """Return a fit of the original model as one of this model, to start from."""
        new = {old: name for name, old in self.names.items()}
        estimates = Estimates(replace(e, name=new.get(e.name, e.name)) for e in fit.parameters.values())
        return replace(fit, parameters=estimates, model=self.model)

    def restored(self, fit: FitResult) -> FitResult:
        """Return a fit of this model as one of the original."""
        estimates = Estimates(replace(e, name=self.names.get(e.name, e.name)) for e in fit.parameters.values())
        records = [
            replace(r, inputs={name: u for name, u in r.inputs.items() if name in self.original.input_names})
            for r in fit.records
        ]
        return replace(fit, parameters=estimates, model=self.original, records=records)
