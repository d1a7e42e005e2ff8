"""What the simulation says: outputs for given parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from . import _core
from .errors import DataError, EvaluationError, ModelError, did_you_mean
from .experiment import Experiment
from .guess import measured_states
from .model import Model
from .records import Record
from .result import Fit

__all__ = ["simulate"]


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
    not given are the fit's for this experiment, else as measured at the first sample that has a value, else 0.
    ``method`` and ``rtol`` are those of `scipy.integrate.solve_ivp`.

    Raises ModelError for a missing or unknown parameter, DataError for missing inputs, EvaluationError where the
    solution ceases to exist, with the time.
    """
    from scipy.integrate import solve_ivp

    data.check_for(model.input_names, [])
    values = _values(model, parameters)
    theta = np.array(list(values.values()))
    evaluator = _core.Evaluator(model._core)
    t = np.ascontiguousarray(data.t)
    inputs = [np.ascontiguousarray(data.input(name)) for name in model.input_names]
    x0 = _initial(model, values, parameters, data, initial or {})

    if data.interpolation == "cubic" and inputs:
        from scipy.interpolate import CubicSpline

        at: Callable[[float], Any] = CubicSpline(t, np.column_stack(inputs))  # as the core's
    else:

        def at(time: float) -> Any:
            return [np.interp(time, t, u) for u in inputs]

    def rhs(time: float, x: Any) -> Any:
        column = np.array([time, *at(time), *x])[:, np.newaxis]
        return evaluator.dynamics(theta, column)[:, 0]

    scale = np.maximum(np.abs(x0), 1e-3)
    # A step never skips a sample interval: the inputs bend there.
    step = float(np.diff(t).max())
    with np.errstate(all="ignore"):
        solution = solve_ivp(rhs, (t[0], t[-1]), x0, method, t_eval=t, rtol=rtol, atol=rtol * scale, max_step=step)
    if not solution.success or not np.isfinite(solution.y).all():
        reached = solution.t[-1] if solution.t.size else t[0]
        raise EvaluationError(
            f"experiment '{data.name}': the simulation of '{model.name}' ends at t = {reached:g} s of {t[-1]:g} s "
            f"({solution.message}); the model may be unstable with these parameters"
        )
    y = evaluator.outputs(theta, np.vstack([t, *inputs, solution.y]))
    outputs = dict(zip(model.output_names, y, strict=True))
    there = {*data.outputs, *data.channels}
    measured = {n: data.output(n) for n in model.output_names if n in there}
    return Record(
        name=data.name,
        t=t,
        inputs=dict(zip(model.input_names, inputs, strict=True)),
        outputs=outputs,
        states=dict(zip(model.state_names, solution.y, strict=True)),
        measured=measured,
        residuals={n: z - outputs[n] for n, z in measured.items()},
        units=model.units,
    )


def _values(model: Model, parameters: Mapping[str, Any] | Fit) -> dict[str, float]:
    given = parameters.parameters if isinstance(parameters, Fit) else parameters
    for name in given:
        if name not in model.parameter_names and not str(name).startswith("sigma_"):
            raise ModelError(f"simulate: '{name}' is no parameter.{did_you_mean(name, model.parameter_names)}")
    missing = [name for name in model.parameter_names if name not in given]
    if missing:
        raise ModelError(f"simulate: no value was given for {', '.join(missing)}")
    return {name: float(given[name]) for name in model.parameter_names}


def _initial(
    model: Model, values: Mapping[str, float], source: Any, data: Experiment, initial: Mapping[str, float]
) -> Any:
    for name in initial:
        if name not in model.state_names:
            raise ModelError(f"simulate: initial '{name}' is no state.{did_you_mean(name, model.state_names)}")
    of_fit: Mapping[str, Any] = source.initial_states.get(data.name, {}) if isinstance(source, Fit) else {}
    measured = measured_states(model, values)
    there = {*data.outputs, *data.channels}
    x0 = []
    for name in model.state_names:
        if name in initial:
            x0.append(float(initial[name]))
        elif name in of_fit:
            x0.append(float(of_fit[name]))
        elif name in measured and measured[name][0] in there:
            output, offset, slope = measured[name]
            z = data.output(output)
            z = z[np.isfinite(z)]
            x0.append((float(z[0]) - offset) / slope if z.size else 0.0)
        else:
            x0.append(0.0)
    if not np.isfinite(x0).all():
        raise DataError("simulate: initial states must be finite numbers")
    return np.array(x0)
