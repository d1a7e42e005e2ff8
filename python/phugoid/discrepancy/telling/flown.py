"""A refit in manoeuvres that were not flown yet: its outputs, and how they follow its parameters and first states."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..search.lanes import Lanes
from ..search.refit import Refit

__all__ = ["Flown"]

_Array = NDArray[np.float64]

# Standard errors by which parameters follow readily: the records at hand do not let them go anywhere.
_LOOSE = 10.0
# Steps of differences: of a standard error, and of the value or a state's range at most.
_DIFFERENCE, _MOST = 0.01, 1e-3


class Flown:
    """From the state in which its first record begins, at times ``t`` (N,) with inputs about ``trim`` (n_u,).

    units   (k,) by which free parameters, then first states, move: ten standard errors; the range of the state.
    tied    (k,) 1 for parameters, which the records at hand hold within some units, 0 for first states.
    late    (n_y,) delays of the sensors, s.
    """

    def __init__(self, refit: Refit, t: _Array, trim: _Array) -> None:
        fit = refit.fit
        self.model, self.trim = fit.model, trim
        self._t0, self._experiment = float(t[0]), fit.records[0].name
        model, record = fit.model, fit.records[0]
        labels = [n if n in fit.parameters else f"{n}[{record.name}]" for n in model.parameter_names]
        declared = model._core.parameters
        estimates = [fit.parameters.get(label) for label in labels]
        self._values = np.array([d[2] if e is None else e.value for d, e in zip(declared, estimates, strict=True)])
        self._low, self._high = (np.array([d[k] for d in declared], dtype=np.float64) for k in (3, 4))
        first = fit.initial_states[record.name]
        self._first = np.array([float(first[n]) for n in model.state_names])
        held = {state for end, state, *_ in model._core.conditions if end == "initial"}
        self._free = [
            i
            for i, (d, e) in enumerate(zip(declared, estimates, strict=True))
            if e is not None and not d[6] and not e.bounds_active
        ]
        self._states = [i for i, n in enumerate(model.state_names) if n not in held]
        errors = np.array([refit.own.parameter(labels[i])[1] for i in self._free])
        values = np.abs(self._values[self._free])
        errors = np.where(np.isfinite(errors) & (errors > 0.0), errors, np.maximum(values, 1e-6))
        ranges = np.array([np.ptp(record.states[model.state_names[i]]) for i in self._states])
        ranges = np.where(ranges > 0.0, ranges, np.maximum(np.abs(self._first[self._states]), 1.0))
        self.units = np.concatenate([_LOOSE * errors, ranges])
        self.tied = np.repeat([1.0, 0.0], [len(self._free), len(self._states)])
        small = _DIFFERENCE * errors
        small = np.where(values > 0.0, np.minimum(small, _MOST * values), small)
        self._small = np.concatenate([small, _MOST * _DIFFERENCE * ranges]) / self.units
        delays = dict(zip(model.parameter_names, self._values, strict=True))
        self.late = np.array([delays.get(model.delays.outputs.get(n, ""), 0.0) for n in model.output_names])
        sizes = np.array([np.abs(record.states[name]).max() for name in model.state_names])
        self._lanes = Lanes(model, t, self._values, self._first, trim, np.where(sizes > 0.0, sizes, 1.0))

    def fly(
        self, inputs: _Array, moves: _Array | None = None, which: NDArray[np.intp] | None = None
    ) -> tuple[_Array, _Array]:
        """Outputs (L, n_y, N) and states (L, n_x, N) with parameters and first states ``moves`` (L, k) units from the
        estimates, and ``which`` (L,) of the inputs (M, n_u, N), unless given each of them; not finite where there is no
        solution."""
        which = np.arange(inputs.shape[0]) if which is None else which
        moves = np.zeros((which.size, self.units.size)) if moves is None else moves
        values = np.tile(self._values, (which.size, 1))
        first = np.tile(self._first, (which.size, 1))
        by = moves * self.units
        values[:, self._free] += by[:, : len(self._free)]
        first[:, self._states] += by[:, len(self._free) :]
        np.clip(values, self._low, self._high, out=values)
        return self._lanes.outputs(values, self._conditioned(values, first), inputs, which)

    def _conditioned(self, values: _Array, first: _Array) -> _Array:
        """First states (L, n_x) that the model's initial conditions ask for."""
        conditions = [(state, e) for end, state, e, _ in self.model._core.conditions if end == "initial"]
        if not conditions:
            return first
        known = dict(zip(self.model.input_names, self.trim.tolist(), strict=True)) | {"time": self._t0}
        for late, (of, _) in self.model.delays.inputs.items():
            known[late] = known[of]
        names, done = self.model.state_names, {}
        for lane in range(first.shape[0]):
            key = (values[lane].tobytes(), first[lane].tobytes())  # manoeuvres begin alike
            if key not in done:
                numbers = known | dict(zip(self.model.parameter_names, values[lane].tolist(), strict=True))
                numbers |= dict(zip(names, first[lane].tolist(), strict=True))
                for state, e in conditions:
                    numbers[state] = e.evaluate({n: numbers[n] for n in e.symbols})
                done[key] = [numbers[n] for n in names]
            first[lane] = done[key]
        return first

    def tangents(self, inputs: _Array) -> _Array:
        """(M, k, n_y, N) changes of the outputs with each free parameter and first state, by its unit."""
        n, k = inputs.shape[0], self.units.size
        moves = np.vstack([np.zeros(k), np.diag(self._small)])
        y, _ = self.fly(inputs, np.tile(moves, (n, 1)), np.repeat(np.arange(n), k + 1))
        y = y.reshape(n, k + 1, *y.shape[1:])
        with np.errstate(invalid="ignore"):
            return np.asarray((y[:, 1:] - y[:, :1]) / self._small[:, None, None])
