"""A model integrated many times at once: for other parameters, first states and inputs in each lane."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ... import _core
from ...modelling.model import Model
from ...modelling.rebuilt import rebuilt

__all__ = ["Lanes"]

_Array = NDArray[np.float64]
_Indices = NDArray[np.intp]

# Steps are shorter than the fastest time constant, within reason, and then at least stable: the limit of the method
# is 2.7 of them.
_STEP, _REASON, _STABLE = 1.0, 3, 2.0
# Lanes that are integrated together: they stay in the cache.
_AT_ONCE = 1024


class Lanes:
    """The classical method of Runge and Kutta, in steps of equal length between the times ``t`` (N,), equally spaced.

    Delays are those of each lane: inputs are taken from before, outputs put between the steps.

    ``first`` are first states (n_x,) and ``values`` parameters (n_p,) nearby: they tell how short steps have to be,
    as do ``sizes`` (n_x,) of the states, greater than zero.
    """

    def __init__(self, model: Model, t: _Array, values: _Array, first: _Array, trim: _Array, sizes: _Array) -> None:
        self.model, self.t = model, t
        core = model._core
        self._inputs = [name for name, _ in core.inputs]

        def declare(new: _core.Model, declared: Any) -> None:
            new.input(declared[0], declared[1])  # an input: then each lane has its own

        slim = rebuilt(core, core.inputs, declare)
        self._evaluator = _core.Evaluator(slim)
        self._none = np.empty(0)
        self._values = slice(1 + len(self._inputs), 1 + len(self._inputs) + len(model.parameter_names))
        self._states = slice(self._values.stop, self._values.stop + len(model.state_names))
        self.steps = self._needed(values, first, trim, sizes)

    def _needed(self, values: _Array, first: _Array, trim: _Array, sizes: _Array) -> int:
        """Steps in an interval."""
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
        """Of the input, or of that which this one is late of, among the inputs of the model."""
        of, _ = self.model.delays.inputs.get(name, (name, ""))
        return self.model.input_names.index(of)

    def _f(self, columns: _Array) -> _Array:
        return np.asarray(self._evaluator.dynamics(self._none, columns))

    def outputs(self, values: _Array, first: _Array, inputs: _Array, which: _Indices) -> tuple[_Array, _Array]:
        """Outputs (L, n_y, N) and states (L, n_x, N) for parameters (L, n_p), first states (L, n_x), and ``which`` (L,)
        of inputs (M, n_u, N), linear between samples. Where a lane grows without limit they are not finite."""
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
        """An input at fine times (n, k), and which of the k a lane has."""
        source = inputs[:, self._place(name)]
        _, tau = self.model.delays.inputs.get(name, (name, ""))
        late = values[:, self.model.parameter_names.index(tau)] if tau else np.zeros(which.size)
        pairs, lane = np.unique(np.column_stack([which, late]), axis=0, return_inverse=True)
        table = np.array([np.interp(fine - delay, self.t, source[int(m)]) for m, delay in pairs])
        return np.ascontiguousarray(table.T), lane.ravel()

    def _measured(self, y: _Array, values: _Array) -> _Array:
        """Outputs (L, n_y, N) of those after each step where a sensor is late."""
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
