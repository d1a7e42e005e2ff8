"""Simulation: the outputs of a model for given parameters and inputs; and the integration error of a fit's path."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import phugoid._core as _core

from .data.experiment import Experiment
from .data.units import check_units
from .errors import DataError, ModelError, OptionError, did_you_mean, finite
from .figures import LIMIT, SERIES, WIDTH, Panels, figure_of, plain, styled
from .fit_result import FitResult, dataset
from .initialisation import measured_states
from .modelling.model import Model
from .records import Record, record_of
from .solvers import limited
from .time_unit import SECONDS, TimeUnit
from .transcription import Collocation, records_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "IntegrationError",
    "first_values",
    "integration_error",
    "simulate",
]

_Array = NDArray[np.float64]

_METHODS = ("auto", "DOP853", "Radau")


def simulate(
    model: Model,
    parameters: Mapping[str, Any] | FitResult,
    data: Experiment,
    *,
    initial: Mapping[str, float] | None = None,
    method: str = "auto",
    rtol: float = 1e-9,
    time_limit: float | None = None,
) -> Record:
    """Integrate the model over an experiment's inputs; return its outputs and states at the samples.

    ``parameters``: values by name (numbers or estimates), or a fit. ``initial``: states at the first sample; those
    not given are the fit's for this experiment, else as the model's initial conditions say, else as measured at the
    first sample that has a value, else 0.
    ``method``: "DOP853", Dormand and Prince's explicit Runge-Kutta method of order 8; "Radau", the implicit Radau IIA
    method of order 5, for stiff systems; "auto" begins with the first and goes on with the second from where stability
    and not accuracy limits the step (Hairer, Norsett and Wanner, Solving Ordinary Differential Equations).
    ``rtol``: error that a step may make, relative to the state. ``time_limit``: most time to spend, in s.

    Raises ModelError for a missing or unknown parameter, DataError for missing inputs, OptionError for a wrong
    method, tolerance or time limit, EvaluationError where the solution ceases to exist, an output is not finite (where
    the experiment has that output: at a sample that is measured) or the time limit is reached, with the time. Ctrl-C
    ends it (KeyboardInterrupt).
    """
    if not isinstance(model, Model):
        raise ModelError(f"simulate: the first argument is a Model, not a {type(model).__name__}")
    if not isinstance(data, Experiment):
        raise DataError(f"simulate: data is one Experiment, not a {type(data).__name__}")
    if method not in _METHODS:
        raise OptionError(f"simulate: method is one of {', '.join(_METHODS)}, not {method!r}")
    if not (isinstance(rtol, Real) and 0 < rtol < 1):
        raise OptionError(f"simulate: rtol is a number between 0 and 1, not {rtol!r}")
    deadline = limited("simulate", time_limit)
    model.check()
    data.check_for(model.input_names, [], conditions=model.condition_names)
    check_units(model, [data], "simulate")
    values = _values(model, parameters, data.name)
    x0 = first_values(model, values, parameters, data, initial or {})
    states, y = _core.simulate(
        model._core,
        model.delays.spec,
        _record(model, data),
        list(values.items()),
        list(zip(model.state_names, x0.tolist(), strict=True)),
        method,
        float(rtol),
        deadline.left(),
    )
    outputs = dict(zip(model.output_names, y, strict=True))
    there = {*data.outputs, *data.channels}
    measured = {n: data.output(n) for n in model.output_names if n in there}
    residuals = {n: z - outputs[n] for n, z in measured.items()}
    return record_of(model, data, y, states, measured=measured, residuals=residuals)


def _record(model: Model, data: Experiment) -> tuple[Any, ...]:
    """Return the experiment as the core takes it; outputs need not be measured."""
    missing = np.full(data.n, np.nan)
    there = {*data.outputs, *data.channels}
    return (
        data.name,
        np.ascontiguousarray(data.t),
        [np.ascontiguousarray(data.input(n)) for n in model.input_names],
        [np.ascontiguousarray(data.output(n)) if n in there else missing for n in model.output_names],
        [data.interpolation_of(n) for n in model.input_names],
        [data.signal(n) for n in model.input_names],
    )


# Names of noise parameters begin like this; they may be there, as in Estimates.to_dict().
_NOISE = ("sigma_", "corr_", "dof_")


def _values(model: Model, parameters: Mapping[str, Any] | FitResult, experiment: str) -> dict[str, float]:
    given: Any = parameters
    if isinstance(parameters, FitResult):
        others = parameters.noise_parameters
        given = {n: e for n, e in parameters.parameters.items() if n not in others}
    if not isinstance(given, Mapping):
        raise ModelError(f"simulate: parameters are values by name, or a fit, not {given!r}")
    noise = parameters.noise.names(parameters.model.output_names) if isinstance(parameters, FitResult) else ()
    local = [name for name, p in model.declared_parameters.items() if p.per_experiment]
    for name in given:
        of_one = str(name).endswith("]") and str(name).partition("[")[0] in {*local, *noise}
        known = name in model.parameter_names or of_one or name in noise
        if not known and not str(name).startswith(_NOISE):
            raise ModelError(f"simulate: '{name}' is not a parameter.{did_you_mean(name, model.parameter_names)}")
    # For a parameter of single experiments, the value of this one precedes one for all.
    found = {name: f"{name}[{experiment}]" for name in local if f"{name}[{experiment}]" in given}
    missing = [name for name in model.parameter_names if name not in given and name not in found]
    if missing:
        own = [name for name in missing if name in local]
        why = f"; each experiment has its own {', '.join(own)}, and '{experiment}' has none" if own else ""
        raise ModelError(f"simulate: no value was given for {', '.join(missing)}{why}")
    return {
        name: finite(f"simulate: parameter '{name}'", given[found.get(name, name)], ModelError)
        for name in model.parameter_names
    }


def first_values(
    model: Model, values: Mapping[str, float], source: Any, data: Experiment, initial: Mapping[str, float]
) -> _Array:
    """Return the states at the first sample (n_x,), as `simulate` takes them."""
    for name in initial:
        if name not in model.state_names:
            raise ModelError(f"simulate: initial '{name}' is not a state.{did_you_mean(name, model.state_names)}")
    of_fit: Mapping[str, Any] = source.initial_states.get(data.name, {}) if isinstance(source, FitResult) else {}
    measured = measured_states(model, values)
    there = {*data.outputs, *data.channels}
    x0 = []
    for name in model.state_names:
        if name in initial:
            x0.append(finite(f"simulate: initial '{name}'", initial[name], ModelError))
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


@dataclass(frozen=True, eq=False, repr=False)
class IntegrationError:
    """The error that each of S segments of one experiment adds to the path.

    name    the experiment's.
    edges   (S + 1,) ends of the segments.
    errors  state -> (S,): how far, at most, the collocation polynomial departs within the segment from the exact
            solution through its first point, in the state's unit.
    scales  state -> what is small for it: the standard deviation of the noise of its measurement; one hundredth of
            the standard deviation of its path where it is not measured; at least 1e-6 of that.
    """

    name: str
    edges: _Array
    errors: Mapping[str, _Array]
    scales: Mapping[str, float]
    time_unit: TimeUnit = SECONDS

    @property
    def relative(self) -> dict[str, _Array]:
        """State -> (S,): errors over scales."""
        return {name: e / self.scales[name] for name, e in self.errors.items()}

    @property
    def worst(self) -> _Array:
        """(S,): the largest relative error of any state in each segment."""
        return np.asarray(np.max(list(self.relative.values()), axis=0))

    def plot(self, axes: Axes | None = None, tolerance: float | None = None) -> tuple[Figure, dict[str, Axes]]:
        """Plot the relative error of each segment over time, on a logarithmic scale, for each state.

        axes       to draw in; None: those of a new figure.
        tolerance  drawn as a line, where given.

        Returns the figure and the axes by ``"error"``.
        """
        if axes is None:
            with styled() as plt:
                _, axes = plt.subplots(figsize=(WIDTH, 2.4), layout="constrained")
        for i, (name, e) in enumerate(self.relative.items()):
            colour = SERIES[i % len(SERIES)][0]
            axes.stairs(
                np.maximum(e, 1e-300), self.edges, label=plain(name), color=colour, linewidth=0.9, baseline=None
            )
        axes.set_yscale("log")
        largest = float(self.worst.max())
        axes.set_ylim(max(1e-8 * largest, 1e-14), 3.0 * max(largest, tolerance or 0.0))
        if tolerance is not None:
            axes.axhline(tolerance, color=LIMIT, linestyle="--", linewidth=0.8, label="tolerance")
        axes.set_xlabel(plain(self.time_unit.axis()))
        axes.set_ylabel("error of a segment / noise")
        axes.legend(fontsize="small", frameon=False, ncols=3)
        return figure_of(axes), Panels({"error": axes})

    def __repr__(self) -> str:
        size = f"{self.edges.size - 1} segments, at most {self.worst.max():.1e} of the noise in one"
        return f"<IntegrationError of '{self.name}': {size}>"


def integration_error(fit: FitResult) -> tuple[IntegrationError, ...]:
    """Return the error that each segment of the mesh adds to the path, one for each experiment of a fit.

    On a segment, collocation replaces f along the path by its polynomial through the segment's points
    (Dutra 2019). What f is in truth between the points, at those of a finer Lobatto rule, leaves a defect d; the error
    follows from the linearised state equations e' = f_x e + d, e = 0 at the start of the segment.

    Raises OptionError for a fit that was not transcribed by collocation, or has delays and no fit without them within,
    and EvaluationError where the state equations are not finite between the points of the mesh.
    """
    if not isinstance(fit.transcription, Collocation):
        raise OptionError("integration_error: only collocation has a mesh whose error can be estimated")
    if fit.model.delays:  # the mesh is that of the model without delays, on records moved by them
        if fit._moved is None:
            raise OptionError("integration_error: estimate this fit with delays again first, with start=fit")
        return integration_error(fit._moved)
    # A mesh for smoothed kinks resolves these, and no jumps.
    model = fit._moved.model if fit.smoothing and fit._moved else fit.model
    found = []
    for record, run in zip(fit.records, dataset(fit), strict=True):
        edges, errors, scales = _core.integration_error(
            model._core,
            records_of(model, [run])[0],
            [fit._own(record.name)[name] for name in model.parameter_names],
            [_sigma(fit, record.name, name) for name in model.output_names],
            fit.transcription.order,
            np.ascontiguousarray(record.mesh_t),
            [np.ascontiguousarray(record.mesh_states[name]) for name in model.state_names],
        )
        by_state = dict(zip(model.state_names, errors, strict=True))
        small = dict(zip(model.state_names, scales, strict=True))
        found.append(IntegrationError(record.name, edges, by_state, small, model.time_unit))
    return tuple(found)


def _sigma(fit: FitResult, experiment: str, output: str) -> float | None:
    """Return the standard deviation of an output's noise in an experiment; None where there is none."""
    if output in fit.noise.known:
        return fit.noise.known[output]
    for name in (f"sigma_{output}[{experiment}]", f"sigma_{output}"):
        if name in fit.parameters:
            return fit.parameters[name].value
    return None
