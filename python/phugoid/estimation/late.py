"""Estimation of delays: u(t - tau) in the equations, z(t) = y(t - tau) at a sensor.

A model `at_delays` is solved, the base of its delays moved to the estimate, and so on until nothing is left.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..data.experiment import Experiment, Signal
from ..data.interpolation import Interpolation, interpolated, kinds_for
from ..data.multirate import together
from ..errors import DataError
from ..fit_result import FitResult
from ..guess import parameter_start
from ..modelling.delayed import at_delays
from ..modelling.model import Model
from ..parameters import Estimate, Parameter
from ..records import Record
from ..solvers import HINTS, Ipopt, Newton
from ..solvers.limits import Deadline

__all__ = ["estimate_late"]

# A delay moves by no more than this many sample intervals before its base follows.
_REACH = 2.0
# Bases have settled too when they move by less than this part of a sample interval.
_NOTHING = 1e-9
# A delay is at a bound when it is this near, in s.
_THERE = 1e-6


def _moved(model: Model, slim: Model, experiment: Experiment, base: Mapping[str, float]) -> Experiment:
    """The record with signals moved by the base: outputs earlier, late inputs later."""
    t, delays = experiment.t, model.delays
    channels = {}
    for name in model.output_names:
        own = t - base[delays.outputs[name]] if name in delays.outputs else t
        inside = (own >= t[0]) & (own <= t[-1])
        if not np.isfinite(experiment.output(name)[inside]).any():
            raise DataError(
                f"experiment '{experiment.name}', output '{name}': no sample is left with a delay of "
                f"{base[delays.outputs[name]]:g} s in a record of {t[-1] - t[0]:g} s"
            )
        channels[name] = own[inside], experiment.output(name)[inside]
    times, outputs = together(channels)
    signals: dict[str, Signal] = {}
    kinds: dict[str, Interpolation] = {}
    for name in slim.input_names:
        whole = name.removesuffix("_rate").removesuffix("_bend") if name not in dict(model._core.inputs) else name
        order = 0 if name == whole else 1 if name.endswith("_rate") else 2
        of, delay = (delays.inputs[whole][0], base[delays.inputs[whole][1]]) if whole in delays.inputs else (whole, 0.0)
        own_t, values, already, _ = experiment.signal(of) or (t, experiment.input(of), 0.0, 0)
        signals[name], kinds[name] = (own_t, values, already + delay, order), experiment.interpolation_of(of)
    inputs = {name: interpolated(kinds[name], s[0], s[1], times - s[2]) for name, s in signals.items()}
    alike = kinds_for(kinds, kinds)
    record = Experiment(times, inputs, outputs, experiment.name, alike, units=experiment.units)
    return record._sampled(signals, t if experiment.mesh_times is None else experiment.mesh_times)


def estimate_late(
    estimate: Callable[..., FitResult],
    model: Model,
    experiments: Sequence[Experiment],
    start: Any,
    by: tuple[Newton | Ipopt, Deadline],
    options: Mapping[str, Any],
) -> FitResult:
    """`estimate` for a model with delays, by passes of it over models without, which share the iterations and the
    time that are left."""
    solver, deadline = by
    given = start.as_start() if isinstance(start, FitResult) else dict(start or {})
    names = model.delays.parameters
    values = parameter_start(model, given)
    base = {name: values[name] for name in names}
    interval = min(float(np.median(np.diff(e.t))) for e in experiments)
    # A warm start has the delays at which it was found.
    begin: Any = start if isinstance(start, FitResult) else {n: v for n, v in given.items() if n not in names} or None
    iterations, time, warnings = 0, 0.0, []
    for number in range(model.delays.passes):
        slim = at_delays(model, base, _REACH * interval)
        moved = [_moved(model, slim, e, base) for e in experiments]
        within = replace(solver, time_limit=deadline.left(), max_iterations=solver.max_iterations - iterations)
        fit = estimate(slim, moved, start=_at(moved[0], experiments[0], model, begin), solver=within, **options)
        iterations, time, begin = iterations + fit.iterations, time + fit.time, fit
        left = {name: fit.parameters[name].value - base[name] for name in names}
        errors = {name: fit.parameters[name].std_error for name in names}
        settled = all(
            abs(d) <= max(_NOTHING * interval, model.delays.settled * (errors[n] if np.isfinite(errors[n]) else 0.0))
            for n, d in left.items()
        )
        if settled or fit.status in ("interrupted", "failed", "diverging", "infeasible", "time limit"):
            break
        if number == model.delays.passes - 1 or iterations >= solver.max_iterations:  # the base stays that of the fit
            warnings.append(
                f"the delays still move by up to {max(map(abs, left.values())):.1e} s: where inputs bend sharply "
                "between samples, the likelihood is not smooth in a delay"
            )
            break
        base = {name: fit.parameters[name].value for name in names}
    declared = model.declared_parameters
    estimates = type(fit.parameters)(
        _as_declared(e, declared[e.name]) if e.name in names else e for e in fit.parameters.values()
    )
    status, message = fit.status, fit.message
    moving = [n for n in names if fit.parameters[n].bounds_active and not estimates[n].bounds_active]
    if moving and fit.converged:
        status, message = "iteration limit", f"{HINTS['iteration limit']} ({', '.join(moving)} is still on the way)"
    records = [_restored(model, r, e, base) for r, e in zip(fit.records, experiments, strict=True)]
    return replace(
        fit,
        model=model,
        parameters=estimates,
        status=status,
        message=message,
        records=records,
        iterations=iterations,
        time=time,
        warnings=(*fit.warnings, *warnings),
        solution=None,
        experiments=tuple(experiments),
        _moved=fit,
    )


def _as_declared(estimate: Estimate, declared: Parameter) -> Estimate:
    """A delay with the bounds of the model: that a pass let it go no further is no bound of these."""
    low, high = declared.bounds
    bound = low if estimate.bounds_active == "lower" else high
    there = abs(estimate.value - bound) <= _THERE * max(1.0, abs(bound))
    active = estimate.bounds_active if there or declared.fixed else None
    return replace(estimate, start=declared.start, bounds=declared.bounds, bounds_active=active)


def _at(moved: Experiment, experiment: Experiment, model: Model, start: Any) -> Any:
    """Start values of states that are given one a sample, at the samples of a moved record."""
    if not isinstance(start, dict):
        return start
    given = {n: v for n, v in start.items() if n in model.state_names and np.shape(v) == experiment.t.shape}
    return start | {n: np.interp(moved.t, experiment.t, v) for n, v in given.items()}


def _restored(model: Model, record: Record, experiment: Experiment, base: Mapping[str, float]) -> Record:
    """The record at the samples of the experiment: outputs as measured, late; NaN where they reach back too far."""
    t = experiment.t
    outputs = {}
    for name in model.output_names:
        own = t - base[model.delays.outputs[name]] if name in model.delays.outputs else t
        at = np.searchsorted(record.t, own + 1e-6 * float(np.median(np.diff(t))), side="right") - 1
        inside = (own >= t[0]) & (own <= t[-1])
        outputs[name] = np.where(inside, record.outputs[name][np.clip(at, 0, None)], np.nan)
    measured = {name: experiment.output(name) for name in model.output_names}
    return replace(
        record,
        t=t,
        inputs={name: experiment.input(name) for name in model.input_names},
        input_samples=experiment.own_samples(model.input_names),
        outputs=outputs,
        states={name: np.interp(t, record.mesh_t, path) for name, path in record.mesh_states.items()},
        measured=measured,
        residuals={name: z - outputs[name] for name, z in measured.items()},
    )
