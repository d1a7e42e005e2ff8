"""Records that begin at a steady state (pre-equilibration): a part before the first sample in which the model rests."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .data.experiment import Experiment
from .data.filtering import Interpolation
from .errors import DataError, EvaluationError, ModelError, finite, listing
from .fit_result import FitResult
from .modelling.model import Model
from .records import Record
from .simulation import simulate

__all__ = ["REST", "at_rest", "duration_of_rest", "from_steady_state", "integrated"]

_Array = NDArray[np.float64]
# The mesh of a rest, in parts of its duration: from the fastest motion to the slowest, five points a decade.
REST = np.concatenate([[0.0], np.logspace(-10.0, 0.0, 51)])
# A model is at rest where no state moves by more than this part of its size, while time goes on tenfold.
_STILL = 1e-7
_LONGEST = 1e12
# A rest is so many times longer than the model takes at the parameters at hand, since at others it is slower. Where a
# state still moves by more than this part of its size between points of the mesh that are so far apart, it is too
# short.
_LONGER = 1e4
_MOVES = 1e-5
_APART = 2


def from_steady_state(
    model: Model,
    data: Experiment,
    parameters: Mapping[str, Any] | FitResult | None = None,
    *,
    inputs: Mapping[str, float] | None = None,
) -> Experiment:
    """Return the record with the steady state before it: a part without samples in which the inputs are constant.

    The model comes to rest in this part from its initial conditions (`Model.initial`), and the record begins at the
    steady state that they lead to. It is integrated with the record, so that estimates, their standard errors and all
    else follow how the steady state depends on the parameters.

    parameters  values by name, or a fit; those not given are as declared. The part before the record is ten thousand
                times as long as the model takes to come to rest with them, since with others it takes longer.
    inputs      name -> the value before the record; those not given have that of their first sample. An input that
                jumps at the first sample has to be held between its samples.

    Raises ModelError for a state without an initial condition and for equations that depend on time, DataError for an
    input that is not there, is not constant by its interpolation, or has samples at times of its own, EvaluationError
    where the model does not come to rest.

    >>> import phugoid as ph
    >>> m = ph.Model("drug")
    >>> (x,), (u,), (k,) = m.states("x"), m.inputs("u"), m.parameters(k=0.5)
    >>> m.dynamics(x=u - k * x)
    >>> m.initial(x=0)
    >>> m.outputs(y=x)
    >>> run = ph.Experiment([0.0, 1.0, 2.0], {"u": [0, 0, 0]}, {"y": [4.1, 2.4, 1.5]}, interpolation="hold")
    >>> whole = ph.from_steady_state(m, run, inputs={"u": 2.0})
    >>> round(float(ph.simulate(m, {"k": 0.5}, whole).outputs["y"][-3]), 6)
    4.0
    """
    who = "from_steady_state"
    if not isinstance(model, Model):
        raise ModelError(f"{who}: the first argument is a Model, not a {type(model).__name__}")
    if not isinstance(data, Experiment):
        raise DataError(f"{who}: data is one Experiment, not a {type(data).__name__}")
    model.check()
    data.check_for(model.input_names, [], conditions=model.condition_names)
    _check_model(model)
    before = _constant_inputs(model, data, inputs or {})
    at: dict[str, Any] = {n: p.start for n, p in model.declared_parameters.items()}
    given: Any = parameters.parameters if isinstance(parameters, FitResult) else parameters or {}
    if not isinstance(given, Mapping):
        raise ModelError(f"{who}: parameters are values by name, or a fit, not {given!r}")
    at |= given
    held = {n: np.full(2, value) for n, value in before.items()}
    rest = Experiment([-1.0, 0.0], held, name=data.name, interpolation="hold")
    duration = duration_of_rest(model, at, rest, who)
    earlier = data.t[0] + duration * (REST[:-1] - 1.0)
    earlier = earlier[earlier < data.t[0]]
    t = np.concatenate([earlier, data.t])
    # Inputs of the model may be among the channels.
    u = {n: np.concatenate([np.full(earlier.size, before[n]), data.input(n)]) for n in model.input_names}
    there = {*data.outputs, *(n for n in model.output_names if n in data.channels)}
    z = {n: np.concatenate([np.full(earlier.size, np.nan), data.output(n)]) for n in there}
    kinds: dict[str, Interpolation] = {n: data.interpolation_of(n) for n in u}
    units = {n: unit for n, unit in data.units.items() if n in u or n in z or n == "time"}
    made = Experiment(t, u, z, data.name, kinds or "linear", units=units)
    return made._after(data, f"steady state before t = {data.t[0]:g}")


def _check_model(model: Model) -> None:
    """Raise ModelError where a model has no steady state before a record."""
    known = {state for end, state, _ in model.end_conditions if end == "initial"}
    if free := [n for n in model.state_names if n not in known]:
        raise ModelError(
            f"from_steady_state: the state '{free[0]}' has no initial condition, from which it would come to rest: "
            f"declare initial({free[0]}=...)"
        )
    slopes = model.state_expressions()
    if timed := [n for n, e in slopes.items() if "time" in e.symbols]:
        raise ModelError(f"from_steady_state: the equation of '{timed[0]}' depends on time, and has no steady state")


def _constant_inputs(model: Model, data: Experiment, inputs: Mapping[str, float]) -> dict[str, float]:
    """Return the value of each input before a record."""
    who = f"from_steady_state: experiment '{data.name}'"
    for name in inputs:
        if name not in model.input_names:
            raise DataError(
                f"{who}: '{name}' is not an input of the model.{listing(str(name), list(model.input_names))}"
            )
    found = {}
    for name in model.input_names:
        if data.signal(name) is not None:
            raise DataError(
                f"{who}: the input '{name}' has samples at times of its own; give it at those of the record"
            )
        first = float(data.input(name)[0])
        value = finite(f"{who}: the input '{name}'", inputs.get(name, first), DataError)
        kind = data.interpolation_of(name)
        if kind == "cubic" or (kind == "linear" and value != first):
            raise DataError(
                f"{who}: the input '{name}' is {value:g} before the record and {first:g} at its first sample, with "
                f"interpolation '{kind}' between; with_interpolation({{'{name}': 'hold'}}) makes it jump there"
            )
        found[name] = value
    return found


def duration_of_rest(model: Model, at: Mapping[str, Any], experiment: Experiment, who: str) -> float:
    """Return a duration after which the model, at these parameters and slower ones, has long been at rest.

    The inputs stay as at the end of the experiment. Raises EvaluationError, in the name of ``who``, where the model
    does not come to rest.
    """
    duration = 1.0
    while duration < _LONGEST:
        t = experiment.t[-1] + np.array([0.0, 1.0, 10.0]) * duration
        record = integrated(model, at, _held_on(model, experiment, np.concatenate([experiment.t[:-1], t])), who)
        states = np.array(list(record.states.values()))
        size = np.abs(states).max(axis=1) + 1e-300
        if (np.abs(states[:, -1] - states[:, -2]) <= _STILL * size).all():
            return _LONGER * duration
        duration *= 4.0
    raise EvaluationError(f"{who}: the model does not come to rest in '{experiment.name}'")


def at_rest(record: Record, end: int) -> bool:
    """Return whether the states are at rest before a sample of this number, where a rest ends.

    Compared are the states at the last point of the rest before its end, where states may be set, and those at 0.4 of
    that time.
    """
    states = np.array(list(record.states.values()))
    size = np.abs(states).max(axis=1) + 1e-300
    moved = np.abs(states[:, end - 1] - states[:, end - 1 - _APART])
    return bool((moved <= _MOVES * size).all())


def integrated(
    model: Model, at: Mapping[str, Any], experiment: Experiment, who: str, time_limit: float | None = 20.0
) -> Record:
    """Integrate the model over an experiment with a rest, by an implicit method where the explicit one fails."""
    try:
        return simulate(model, at, experiment, rtol=1e-8, time_limit=time_limit)
    except EvaluationError:
        pass  # of a stiff rest the explicit method may take too many steps
    try:
        return simulate(model, at, experiment, method="Radau", rtol=1e-8, time_limit=time_limit)
    except EvaluationError as error:
        raise EvaluationError(f"{who}: the steady state of '{experiment.name}' was not reached: {error}") from error


def _held_on(model: Model, experiment: Experiment, t: _Array) -> Experiment:
    """Return the signals of an experiment over other times, constant at their last values."""
    place = np.clip(np.searchsorted(experiment.t, t, side="right") - 1, 0, experiment.n - 1)
    inputs = {n: experiment.input(n)[place] for n in model.input_names}
    kinds: dict[str, Interpolation] = dict.fromkeys(inputs, "hold")
    return Experiment(t, inputs, name=experiment.name, interpolation=kinds or "linear")
