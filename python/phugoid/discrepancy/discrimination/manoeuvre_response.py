"""The response of a refit to planned manoeuvres: outputs, and their sensitivities to parameters and initial states."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...modelling.compiled import CompiledModel
from ...modelling.model import Model
from ..search.refit import Refit

__all__ = ["BatchSimulation", "ManoeuvreResponse"]

_Array = NDArray[np.float64]
_Indices = NDArray[np.intp]

# Steps are shorter than the fastest time constant, within reason, and then at least stable: the limit of the method
# is 2.7 of them.
_STEP, _REASON, _STABLE = 1.0, 3, 2.0
# BatchSimulation that are integrated together: they stay in the cache.
_AT_ONCE = 1024


class BatchSimulation:
    """The classical method of Runge and Kutta, in steps of equal length between the times ``t`` (N,), equally spaced.

    Delays are those of each lane: inputs are taken from before, outputs put between the steps.

    ``first`` are initial states (n_x,) and ``values`` parameters (n_p,) nearby, from which the step
    length follows, and from ``sizes`` (n_x,) of the states, greater than zero.
    """

    def __init__(self, model: Model, t: _Array, values: _Array, first: _Array, trim: _Array, sizes: _Array) -> None:
        self.model, self.t = model, t
        self._inputs = list(model.declared_inputs)
        self._evaluator = CompiledModel(model, own_parameters=True)
        self._none = np.empty(0)
        self._values = slice(1 + len(self._inputs), 1 + len(self._inputs) + len(model.parameter_names))
        self._states = slice(self._values.stop, self._values.stop + len(model.state_names))
        self.steps = self._needed(values, first, trim, sizes)

    def _needed(self, values: _Array, first: _Array, trim: _Array, sizes: _Array) -> int:
        """Return steps in an interval."""
        columns = np.empty((self._states.stop, 2 * first.size))
        columns[0] = self.t[0]
        for row, name in enumerate(self._inputs, start=1):
            columns[row] = trim[self._place(name)]
        columns[self._values], columns[self._states] = values[:, None], first[:, None]
        h = 1e-6 * sizes
        columns[self._states, : first.size] += np.diag(h)
        columns[self._states, first.size :] -= np.diag(h)
        f = self._f(columns)
        slopes = (f[:, : first.size] - f[:, first.size :]) / (2.0 * h)
        if not np.isfinite(slopes).all():
            return 1
        fastest = float(np.abs(np.linalg.eigvals(slopes)).max(initial=0.0)) * float(self.t[1] - self.t[0])
        return max(1, min(int(np.ceil(fastest / _STEP)), _REASON), int(np.ceil(fastest / _STABLE)))

    def _place(self, name: str) -> int:
        """Return the index of the input, or of that which this one is late of, among the inputs of the model."""
        of, _ = self.model.delays.inputs.get(name, (name, ""))
        return self.model.input_names.index(of)

    def _f(self, columns: _Array) -> _Array:
        return np.asarray(self._evaluator.dynamics(self._none, columns))

    def outputs(self, values: _Array, first: _Array, inputs: _Array, which: _Indices) -> tuple[_Array, _Array]:
        """Return outputs (L, n_y, N) and states (L, n_x, N) for parameters (L, n_p), initial states (L, n_x), and
        ``which`` (L,) of inputs (M, n_u, N), linear between samples. Where a lane grows without limit they are not
        finite."""
        n, lanes = self.t.size, which.size
        y = np.empty((lanes, len(self.model.output_names), n))
        x = np.empty((lanes, first.shape[1], n))
        with np.errstate(all="ignore"):
            for begin in range(0, lanes, _AT_ONCE):
                some = slice(begin, begin + _AT_ONCE)
                y[some], x[some] = self._together(values[some], first[some], inputs, which[some])
        return y, x

    def _together(self, values: _Array, first: _Array, inputs: _Array, which: _Indices) -> tuple[_Array, _Array]:
        fine = np.linspace(self.t[0], self.t[-1], 2 * self.steps * (self.t.size - 1) + 1)  # and in the middle of steps
        signals = [self._signal(name, values, inputs, which, fine) for name in self._inputs]
        columns = np.empty((self._states.stop, which.size))
        columns[self._values] = values.T
        x = first.T.copy()
        h = float(fine[2] - fine[0])
        # What a late sensor shows is needed between samples too.
        every = 1 if self.model.delays.outputs else self.steps
        y = np.empty((self.steps * (self.t.size - 1) // every + 1, len(self.model.output_names), which.size))
        path = np.empty((self.t.size, *x.shape))

        def moment(k: int) -> None:
            columns[0] = fine[k]
            for row, (table, lane) in enumerate(signals, start=1):
                table[k].take(lane, out=columns[row], mode="clip")

        def slope(state: _Array) -> _Array:
            columns[self._states] = state
            return self._f(columns)

        def show(k: int) -> None:
            if k % every == 0:
                columns[self._states] = x
                y[k // every] = self._evaluator.outputs(self._none, columns)
            if k % self.steps == 0:
                path[k // self.steps] = x

        moment(0)
        show(0)
        for k in range(self.steps * (self.t.size - 1)):
            k1 = slope(x)
            moment(2 * k + 1)
            k2 = slope(x + 0.5 * h * k1)
            k3 = slope(x + 0.5 * h * k2)
            moment(2 * k + 2)
            k4 = slope(x + h * k3)
            x = x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
            show(k + 1)
        return self._measured(y.transpose(2, 1, 0), values), path.transpose(2, 1, 0)

    def _signal(
        self, name: str, values: _Array, inputs: _Array, which: _Indices, fine: _Array
    ) -> tuple[_Array, _Indices]:
        """Return an input at fine times (n, k), and which of the k a lane has."""
        source = inputs[:, self._place(name)]
        _, tau = self.model.delays.inputs.get(name, (name, ""))
        late = values[:, self.model.parameter_names.index(tau)] if tau else np.zeros(which.size)
        pairs, lane = np.unique(np.column_stack([which, late]), axis=0, return_inverse=True)
        table = np.array([np.interp(fine - delay, self.t, source[int(m)]) for m, delay in pairs])
        return np.ascontiguousarray(table.T), lane.ravel()

    def _measured(self, y: _Array, values: _Array) -> _Array:
        """Return outputs (L, n_y, N) of those after each step where a sensor is late."""
        late = self.model.delays.outputs
        if not late:
            return y
        found = y[:, :, :: self.steps].copy()
        for name, tau in late.items():
            i, delays = self.model.output_names.index(name), values[:, self.model.parameter_names.index(tau)]
            for delay in np.unique(delays).tolist():
                at = (self.t - delay - self.t[0]) / (self.t[1] - self.t[0]) * self.steps
                found[delays == delay, i] = _between(y[delays == delay, i], at)
        return found


def _between(y: _Array, at: _Array) -> _Array:
    """Cubic through the four nearest of equally spaced values (..., n), at places among them; outside the nearest
    value."""
    at = np.clip(at, 0.0, y.shape[-1] - 1.0)
    k = np.clip(np.floor(at).astype(np.intp), 1, y.shape[-1] - 3)
    s = at - k
    return np.asarray(
        -s * (s - 1) * (s - 2) / 6 * y[..., k - 1]
        + (s + 1) * (s - 1) * (s - 2) / 2 * y[..., k]
        - (s + 1) * s * (s - 2) / 2 * y[..., k + 1]
        + (s + 1) * s * (s - 1) / 6 * y[..., k + 2]
    )


# Standard errors by which parameters follow readily: the records at hand do not let them go anywhere.
_LOOSE = 10.0
# Steps of differences: of a standard error, and of the value or a state's range at most.
_DIFFERENCE, _MOST = 0.01, 1e-3


class ManoeuvreResponse:
    """From the state in which its first record begins, at times ``t`` (N,) with inputs about ``trim`` (n_u,).

    units   (k,) by which free parameters, then initial states, move: ten standard errors; the range of the state.
    tied    (k,) 1 for parameters, which the records at hand hold within some units, 0 for initial states.
    late    (n_y,) delays of the sensors, s.
    """

    def __init__(self, refit: Refit, t: _Array, trim: _Array) -> None:
        fit = refit.fit
        self.model, self.trim = fit.model, trim
        self._t0, self._experiment = float(t[0]), fit.records[0].name
        model, record = fit.model, fit.records[0]
        labels = [n if n in fit.parameters else f"{n}[{record.name}]" for n in model.parameter_names]
        declared = model.declared_parameters.values()
        estimates = [fit.parameters.get(label) for label in labels]
        self._values = np.array([p.start if e is None else e.value for p, e in zip(declared, estimates, strict=True)])
        self._low, self._high = np.array([p.bounds for p in declared]).reshape(-1, 2).T
        first = fit.initial_states[record.name]
        self._first = np.array([float(first[n]) for n in model.state_names])
        held = {state for end, state, _ in model.end_conditions if end == "initial"}
        self._free = [
            i
            for i, (p, e) in enumerate(zip(declared, estimates, strict=True))
            if e is not None and not p.fixed and not e.bounds_active
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
        self._simulation = BatchSimulation(model, t, self._values, self._first, trim, np.where(sizes > 0.0, sizes, 1.0))

    def simulate(
        self, inputs: _Array, moves: _Array | None = None, which: NDArray[np.intp] | None = None
    ) -> tuple[_Array, _Array]:
        """Return outputs (L, n_y, N) and states (L, n_x, N) with parameters and initial states ``moves`` (L, k) units
        from the estimates, and ``which`` (L,) of the inputs (M, n_u, N), unless given each of them; not finite where
        there is no solution."""
        which = np.arange(inputs.shape[0]) if which is None else which
        moves = np.zeros((which.size, self.units.size)) if moves is None else moves
        values = np.tile(self._values, (which.size, 1))
        first = np.tile(self._first, (which.size, 1))
        by = moves * self.units
        values[:, self._free] += by[:, : len(self._free)]
        first[:, self._states] += by[:, len(self._free) :]
        np.clip(values, self._low, self._high, out=values)
        return self._simulation.outputs(values, self._conditioned(values, first), inputs, which)

    def _conditioned(self, values: _Array, first: _Array) -> _Array:
        """Return the initial states (L, n_x) that the model's initial conditions require."""
        conditions = [(state, e) for end, state, e in self.model.end_conditions if end == "initial"]
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
        """Return (M, k, n_y, N) changes of the outputs with each free parameter and initial state, by its unit."""
        n, k = inputs.shape[0], self.units.size
        moves = np.vstack([np.zeros(k), np.diag(self._small)])
        y, _ = self.simulate(inputs, np.tile(moves, (n, 1)), np.repeat(np.arange(n), k + 1))
        y = y.reshape(n, k + 1, *y.shape[1:])
        with np.errstate(invalid="ignore"):
            return np.asarray((y[:, 1:] - y[:, :1]) / self._small[:, None, None])
