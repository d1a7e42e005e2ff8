"""What the simulation says: outputs for given parameters."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _core
from .data.experiment import Experiment
from .data.interpolation import interpolated, kinds_for
from .data.multirate import distinct
from .data.unit_check import check_units
from .errors import DataError, EvaluationError, ModelError, OptionError, did_you_mean
from .estimation.late import simulated_late
from .guess import measured_states
from .modelling.model import Model
from .records import Record
from .result import Fit

__all__ = ["first_values", "simulate"]

_Array = NDArray[np.float64]

_METHODS = ("RK45", "RK23", "DOP853", "Radau", "BDF", "LSODA")


def simulate(
    model: Model,
    parameters: Mapping[str, Any] | Fit,
    data: Experiment,
    *,
    initial: Mapping[str, float] | None = None,
    method: str = "DOP853",
    rtol: float = 1e-9,
) -> Record:
    """Integrates the model over an experiment's inputs; returns its outputs and states at the samples.

    ``parameters``: values by name (numbers or estimates), or a fit. ``initial``: states at the first sample; those
    not given are the fit's for this experiment, else as the model's initial conditions say, else as measured at the
    first sample that has a value, else 0.
    ``method`` and ``rtol`` are those of `scipy.integrate.solve_ivp`.

    Raises ModelError for a missing or unknown parameter, DataError for missing inputs, OptionError for a wrong
    method or tolerance, EvaluationError where the solution ceases to exist or an output is not finite, with the time.
    """
    if not isinstance(model, Model):
        raise ModelError(f"simulate: the first argument is a Model, not a {type(model).__name__}")
    if not isinstance(data, Experiment):
        raise DataError(f"simulate: data is one Experiment, not a {type(data).__name__}")
    if method not in _METHODS:
        raise OptionError(f"simulate: method is one of {', '.join(_METHODS)}, not {method!r}")
    if not (isinstance(rtol, Real) and 0 < rtol < 1):
        raise OptionError(f"simulate: rtol is a number between 0 and 1, not {rtol!r}")
    model.check()
    data.check_for(model.input_names, [])
    check_units(model, [data], "simulate")
    values = _values(model, parameters, data.name)
    x0 = first_values(model, values, parameters, data, initial or {})
    if model.delays:
        first = dict(zip(model.state_names, x0, strict=True))
        return simulated_late(simulate, model, values, data, initial=first, method=method, rtol=rtol)
    flow = _Flow(model, values, data)
    states = flow.path(x0, method, float(rtol))
    y = flow.outputs(states)
    outputs = dict(zip(model.output_names, y, strict=True))
    there = {*data.outputs, *data.channels}
    measured = {n: data.output(n) for n in model.output_names if n in there}
    return Record(
        name=data.name,
        t=data.t,
        inputs={name: data.input(name) for name in model.input_names},
        outputs=outputs,
        states=dict(zip(model.state_names, states, strict=True)),
        measured=measured,
        residuals={n: z - outputs[n] for n, z in measured.items()},
        units=model.units,
        interpolation=kinds_for(data.interpolation, model.input_names),
        input_samples=data.own_samples(model.input_names),
    )


class _Flow:
    """A model with numbers put in, over the inputs of an experiment."""

    def __init__(self, model: Model, values: Mapping[str, float], data: Experiment) -> None:
        self.model, self.data = model, data
        self.theta = np.array(list(values.values()))
        self.evaluator = _core.Evaluator(model._core)
        self.t = data.t
        self.inputs = np.array([data.input(name) for name in model.input_names]).reshape(-1, data.n)
        self.splines: dict[int, tuple[Any, _Array]] = {}  # of inputs that are cubic, and the ends of their samples
        self.knots = self.t
        samples = [data.samples(name) for name in model.input_names]
        kinds = [data.interpolation_of(name) for name in model.input_names]
        if "cubic" in kinds:
            from scipy.interpolate import CubicSpline

            cubic = [i for i, kind in enumerate(kinds) if kind == "cubic"]
            self.splines = {i: (CubicSpline(*samples[i]), samples[i][0][[0, -1]]) for i in cubic}  # as the core's
        own = [t for (t, _), kind in zip(samples, kinds, strict=True) if t is not self.t and kind != "cubic"]
        if own:
            # Where inputs with samples of their own bend or jump.
            same = 1e-9 * float(np.diff(self.t).min())
            inner = distinct(np.concatenate(own), same)
            inner = inner[(inner > self.t[0] + same) & (inner < self.t[-1] - same)]
            after = np.searchsorted(self.t, inner)
            apart = np.minimum(inner - self.t[after - 1], self.t[after] - inner) > same
            self.knots = np.union1d(self.t, inner[apart])
        at = [interpolated(kind, *own, self.knots) for kind, own in zip(kinds, samples, strict=True)]
        # Inputs where intervals begin, and where they end: what is held jumps there.
        self.begins = np.array(at).reshape(-1, self.knots.size)
        self.ends = self.begins.copy()
        held = [i for i, kind in enumerate(kinds) if kind == "hold"]
        self.ends[held, 1:] = self.begins[held, :-1]
        self.bad: tuple[float, _Array, _Array] | None = None  # the last point where an equation was not finite

    def at(self, k: int, time: float) -> _Array:
        """Inputs at a time in the interval after knot ``k``."""
        if time == self.knots[k + 1]:
            return np.asarray(self.ends[:, k + 1])  # to the bit: a hair below zero may have no square root
        share = (time - self.knots[k]) / (self.knots[k + 1] - self.knots[k])
        u = self.begins[:, k] + share * (self.ends[:, k + 1] - self.begins[:, k])
        for i, (spline, ends) in self.splines.items():
            # Beyond its own samples an input stays as it was, as in the core.
            u[i] = spline(min(max(time, ends[0]), ends[1]))
        return np.asarray(u)

    def rhs(self, k: int, time: float, x: _Array) -> _Array:
        """x' in that interval."""
        u = self.at(k, time)
        slope = self.evaluator.dynamics(self.theta, np.concatenate([[time], u, x])[:, np.newaxis])[:, 0]
        if not np.isfinite(slope).all() and np.isfinite(x).all():
            self.bad = time, np.concatenate([x, u]), slope
        return slope

    def path(self, x0: _Array, method: str, rtol: float) -> _Array:
        """States at the samples, shape (n_x, N).

        Each interval by itself: inputs bend or jump at the samples, which no integrator sees coming.
        """
        from scipy.integrate import solve_ivp

        states = np.empty((x0.size, self.knots.size))
        states[:, 0] = x0
        self.rhs(0, self.t[0], x0)
        if self.bad is not None:  # the integrator would never return
            raise self.failure(self.t[0])
        atol = rtol * np.maximum(np.abs(x0), 1e-3)
        step = None
        with np.errstate(all="ignore"):
            for k, (begin, end) in enumerate(zip(self.knots[:-1], self.knots[1:], strict=True)):
                step = None if step is None else min(step, end - begin)
                options = {"rtol": rtol, "atol": atol, "first_step": step}
                solution = solve_ivp(partial(self.rhs, k), (begin, end), states[:, k], method, **options)
                if not solution.success or not np.isfinite(solution.y[:, -1]).all():
                    raise self.failure(solution.t[-1])
                states[:, k + 1] = solution.y[:, -1]
                step = float(np.diff(solution.t).max())
        return states[:, np.searchsorted(self.knots, self.t)]

    def failure(self, reached: float) -> EvaluationError:
        """Why there is no solution from a time on."""
        text = (
            f"experiment '{self.data.name}': the simulation of '{self.model.name}' ends at t = {reached:g} s "
            f"of {self.t[-1]:g} s: "
        )
        if self.bad is None:
            return EvaluationError(
                f"{text}the solution grows without limit; the model may be unstable with these parameters"
            )
        time, point, slope = self.bad
        state = self.model.state_names[int(np.flatnonzero(~np.isfinite(slope))[0])]
        names = (*self.model.state_names, *self.model.input_names)
        where = ", ".join(f"{n} = {v:.6g}" for n, v in zip(names, point, strict=True))
        return EvaluationError(f"{text}the equation of {state}' is not finite at t = {time:.6g} s, {where}")

    def outputs(self, states: _Array) -> _Array:
        """Outputs at the samples, shape (n_y, N)."""
        y = self.evaluator.outputs(self.theta, np.vstack([self.t, self.inputs, states]))
        wrong = np.argwhere(~np.isfinite(y.T))
        if wrong.size:
            k, c = wrong[0]
            raise EvaluationError(
                f"experiment '{self.data.name}': the output '{self.model.output_names[c]}' of '{self.model.name}' "
                f"is {y[c, k]} at t = {self.t[k]:g} s"
            )
        return y


# Names of what is estimated of the noise begin like this; they may be there, as in Estimates.to_dict().
_NOISE = ("sigma_", "corr_", "dof_")


def _values(model: Model, parameters: Mapping[str, Any] | Fit, experiment: str) -> dict[str, float]:
    given: Any = parameters
    if isinstance(parameters, Fit):
        others = parameters.noise_parameters
        given = {n: e for n, e in parameters.parameters.items() if n not in others}
    if not isinstance(given, Mapping):
        raise ModelError(f"simulate: parameters are values by name, or a fit, not {given!r}")
    noise = parameters.noise.names(parameters.model.output_names) if isinstance(parameters, Fit) else ()
    local = [name for name, p in model.declared_parameters.items() if p.per_experiment]
    for name in given:
        of_one = str(name).endswith("]") and str(name).partition("[")[0] in {*local, *noise}
        known = name in model.parameter_names or of_one or name in noise
        if not known and not str(name).startswith(_NOISE):
            raise ModelError(f"simulate: '{name}' is no parameter.{did_you_mean(name, model.parameter_names)}")
    # A parameter that each experiment has its own of: that of this one, before one for all.
    found = {name: f"{name}[{experiment}]" for name in local if f"{name}[{experiment}]" in given}
    missing = [name for name in model.parameter_names if name not in given and name not in found]
    if missing:
        raise ModelError(f"simulate: no value was given for {', '.join(missing)}")
    return {name: _finite(f"parameter '{name}'", given[found.get(name, name)]) for name in model.parameter_names}


def first_values(
    model: Model, values: Mapping[str, float], source: Any, data: Experiment, initial: Mapping[str, float]
) -> _Array:
    """States at the first sample (n_x,), as `simulate` takes them."""
    for name in initial:
        if name not in model.state_names:
            raise ModelError(f"simulate: initial '{name}' is no state.{did_you_mean(name, model.state_names)}")
    of_fit: Mapping[str, Any] = source.initial_states.get(data.name, {}) if isinstance(source, Fit) else {}
    measured = measured_states(model, values)
    there = {*data.outputs, *data.channels}
    x0 = []
    for name in model.state_names:
        if name in initial:
            x0.append(_finite(f"initial '{name}'", initial[name]))
        elif name in of_fit:
            x0.append(float(of_fit[name]))
        elif name in measured and measured[name][0] in there:
            output, offset, slope = measured[name]
            z = data.output(output)
            z = z[np.isfinite(z)]
            x0.append((float(z[0]) - offset) / slope if z.size else 0.0)
        else:
            x0.append(0.0)
    found = dict(zip(model.state_names, x0, strict=True))
    known = {**values, "time": float(data.t[0]), **{n: float(data.input(n)[0]) for n in model.input_names}}
    for end, state, expression, _ in model._core.conditions:
        if end == "initial" and state not in initial and state not in of_fit:
            numbers = {**known, **found}
            found[state] = expression.evaluate({n: numbers[n] for n in expression.symbols})
    return np.array(list(found.values()))


def _finite(what: str, value: Any) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = float("nan")
    if not np.isfinite(number):
        raise ModelError(f"simulate: {what} is {value!r}, not a finite number")
    return number
