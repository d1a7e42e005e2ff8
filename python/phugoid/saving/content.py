"""Checks that the content of a file is a fit: kinds, sizes and names of its parts, and their consistency.

A checksum finds damage, but files of earlier releases have none, and a program may write what it likes. What is let
through here, every method of a fit can use.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ..data.experiment import Experiment
from ..errors import DataError
from ..filter_error import FilterError
from ..fit_result import FitResult, Refinement, Smoothing
from ..parameters import Estimates
from ..records import Record
from ..solvers import HINTS, Iteration, Solution

__all__ = ["check_fit", "check_kinds"]

_WHOLE = 2**53  # beyond, JSON's numbers are not exact


def check_fit(fit: FitResult, moved: bool = True) -> None:
    """Raise DataError, with the place, unless the fit is complete and consistent."""
    fit.model.check()
    fit.noise.resolve(fit.model.output_names, dict.fromkeys(fit.model.output_names, 1.0), {})
    check_kinds("", vars(fit), ("status", "message"), ("iterations",), ("log_likelihood", "time"))
    _require(fit.status in HINTS, f"status is {_brief(fit.status)}, which is none")
    _require(all(isinstance(w, str) for w in fit.warnings), "warnings: one is no text")
    _records(fit)
    _parameters(fit)
    _history("history", fit.history)
    if fit.refinement is not None:
        _refinement(fit.refinement, fit.parameters)
    if fit.smoothing is not None:
        _smoothing(fit.smoothing, fit.parameters)
    if fit.experiments:
        _experiments(fit)
    if fit.solution is not None:
        _solution(fit.solution, fit)
    if fit._moved is not None:
        _require(moved, "moved: is moved itself")
        check_fit(fit._moved, moved=False)
        inner = fit._moved
        _require([r.name for r in inner.records] == [r.name for r in fit.records], "moved: has other records")
        _require(list(inner.parameters) == list(fit.parameters), "moved: has other parameters")
        _require(inner.model.output_names == fit.model.output_names, "moved: has other outputs")
        _require(inner.model.state_names == fit.model.state_names, "moved: has other states")


def check_kinds(
    place: str,
    values: Mapping[str, Any],
    texts: Iterable[str] = (),
    whole: Iterable[str] = (),
    numbers: Iterable[str] = (),
    flags: Iterable[str] = (),
) -> None:
    """Raise DataError unless the values of these names are of these kinds; ``numbers`` may be NaN or infinite."""
    kinds: list[tuple[Iterable[str], str, Callable[[Any], bool]]] = [
        (texts, "text", lambda v: isinstance(v, str)),
        (whole, "whole number from 0", lambda v: type(v) is int and 0 <= v <= _WHOLE),
        (numbers, "number", lambda v: type(v) is float or (type(v) is int and abs(v) <= _WHOLE)),
        (flags, "truth value", lambda v: isinstance(v, bool)),
    ]
    for names, kind, fits in kinds:
        for name in names:
            where = f"{place}.{name}" if place else name
            _require(fits(values[name]), f"{where} is no {kind}, but {_brief(values[name])}")


def _parameters(fit: FitResult) -> None:
    names = [r.name for r in fit.records]
    _estimates("parameters", fit.parameters, fit.status)
    known = set(fit.noise_parameters)
    for name in fit.model.parameter_names:  # each record has its own, or all have one
        own = [f"{name}[{r}]" for r in names]
        there = own if own[0] in fit.parameters else [name]
        for each in there:
            _require(each in fit.parameters, f"parameters: '{each}' is missing")
        known.update(there)
    for name in fit.parameters:
        _require(name in known, f"parameters: '{name}' is neither the model's nor the noise's")
    n = len(fit.parameters)
    _array("covariance", fit.covariance, (n, n), missing=True)
    with np.errstate(invalid="ignore"):
        _require(not (np.diag(fit.covariance) < 0).any(), "covariance: a variance is negative")
    _names("initial_states", fit.initial_states, names, empty=isinstance(fit.transcription, FilterError))
    for record, group in fit.initial_states.items():
        _estimates(f"initial_states.{record}", group, fit.status)
        _names(f"initial_states.{record}", group, fit.model.state_names)


def _estimates(place: str, group: Estimates, status: str) -> None:
    for name, e in group.items():
        where = f"{place}.{name}"
        check_kinds(where, vars(e), ("name", "unit"), (), ("value", "std_error", "start"), ("fixed",))
        _require(status != "converged" or math.isfinite(e.value), f"{where}.value is {e.value}")
        _require(not e.std_error < 0, f"{where}.std_error is negative")
        low, high = e.bounds
        _require(low <= high, f"{where}.bounds are {low} and {high}")
        _require(e.bounds_active in (None, "lower", "upper"), f"{where}.bounds_active is {_brief(e.bounds_active)}")


def _records(fit: FitResult) -> None:
    _require(len(fit.records) > 0, "records: there is none")
    model, finite = fit.model, fit.status == "converged"
    names = [r.name for r in fit.records]
    _require(len({*names}) == len(names), "records: two have one name")
    for i, r in enumerate(fit.records):
        place = f"records[{i}]"
        check_kinds(place, vars(r), ("name",), (), (), ("feasible",))
        how = r.interpolation
        kinds = list(how.values()) if isinstance(how, Mapping) else [how]
        _require(all(kind in ("linear", "cubic", "hold") for kind in kinds), f"{place}.interpolation is {_brief(how)}")
        _units(f"{place}.units", r.units)
        _times(f"{place}.t", r.t)
        _times(f"{place}.mesh_t", r.mesh_t, empty=True)
        _names(f"{place}.inputs", r.inputs, model.input_names)
        for kind in ("outputs", "measured", "residuals", "innovations", "innovation_std"):
            _names(f"{place}.{kind}", getattr(r, kind), model.output_names, empty=kind.startswith("innovation"))
        for kind in ("states", "state_std", "predicted_states", "mesh_states"):
            _names(f"{place}.{kind}", getattr(r, kind), model.state_names, empty=kind != "states")
        _groups(place, r, finite)


def _groups(place: str, r: Record, finite: bool) -> None:
    of_samples = ("inputs", "outputs", "states", "measured", "residuals", "state_std", "predicted_states")
    for kind in (*of_samples, "innovations", "innovation_std"):
        for name, values in getattr(r, kind).items():
            missing = not (finite and kind in ("inputs", "outputs", "states"))
            _array(f"{place}.{kind}.{name}", values, (r.t.size,), missing)
    for name, values in r.mesh_states.items():
        _array(f"{place}.mesh_states.{name}", values, (r.mesh_t.size,), missing=not finite)
    for name, (times, values) in r.input_samples.items():
        _require(name in r.inputs, f"{place}.input_samples: there is no input '{name}'")
        _times(f"{place}.input_samples.{name}", times)
        _array(f"{place}.input_samples.{name}", values, (times.size,))


def _experiments(fit: FitResult) -> None:
    _require([e.name for e in fit.experiments] == [r.name for r in fit.records], "experiments: are not the records'")
    for i, e in enumerate(fit.experiments):
        place = f"experiments[{i}]"
        n = fit.records[i].n
        _require(e.n == n, f"{place}: has {e.n} samples, and its record {n}")
        _mesh(place, e)
        for name, signal in e._signals_of().items():
            where = f"{place}.signals.{name}"
            times, values, delay, order = signal
            _require(name in {**e.inputs, **e.channels}, f"{where}: there is no such input")
            _times(where, times)
            _array(where, values, (times.size,))
            _require(math.isfinite(delay) and order in range(3), f"{where}: delay {delay}, order {order}")
        e.check_for(
            fit.model.input_names,
            fit.model.output_names,
            known_sigma=fit.model.output_names,
            conditions=fit.model.condition_names,
        )


def _mesh(place: str, e: Experiment) -> None:
    if e.mesh_times is not None:
        _times(f"{place}.mesh_times", e.mesh_times)


def _solution(s: Solution, fit: FitResult) -> None:
    place = "solution"
    check_kinds(place, vars(s), ("status", "message"), ("iterations", "flops"), ("time",))
    check_kinds(f"{place}.evaluations", s.evaluations, (), s.evaluations)
    _array(f"{place}.xi", s.xi, (s.xi.size,), missing=fit.status != "converged")
    _require(s.xi.size >= len(fit.parameters), f"{place}.xi: has {s.xi.size} values")
    _array(f"{place}.multipliers", s.multipliers, (s.multipliers.size,), missing=fit.status != "converged")
    for values in s.bound_multipliers:
        _array(f"{place}.bound_multipliers", values, (s.xi.size,))
    _history(f"{place}.history", s.history)


def _refinement(found: Refinement, parameters: Estimates) -> None:
    check_kinds("refinement", vars(found), (), (), ("tolerance",))
    _require(len(found.steps) > 0, "refinement.steps: there is none")
    for i, step in enumerate(found.steps):
        whole = ("order", "segments", "coarse", "iterations")
        check_kinds(f"refinement.steps[{i}]", vars(step), (), whole, ("largest", "log_likelihood"))
    _require({*found.changes} <= {*parameters}, "refinement.changes: one is of no parameter")


def _smoothing(found: Smoothing, parameters: Estimates) -> None:
    _require(len(found.steps) > 0, "smoothing.steps: there is none")
    for i, step in enumerate(found.steps):
        numbers = ("part", "log_likelihood")
        check_kinds(f"smoothing.steps[{i}]", vars(step), (), ("segments", "iterations"), numbers)
    _require({*found.left} <= {*parameters}, "smoothing.left: one is of no parameter")


def _history(place: str, lines: Sequence[Iteration]) -> None:
    numbers = ("log_likelihood", "defect", "dual", "step")
    for i, line in enumerate(lines):
        check_kinds(f"{place}[{i}]", vars(line), (), ("number", "trials"), numbers)


def _times(place: str, t: Any, empty: bool = False) -> None:
    _array(place, t, (t.size,))
    _require(t.size > 1 or (empty and t.size == 0), f"{place}: has {t.size} times")
    _require(bool((np.diff(t) > 0).all()), f"{place}: does not increase")


def _array(place: str, values: Any, shape: tuple[int, ...], missing: bool = False) -> None:
    _require(values.shape == shape, f"{place}: has shape {values.shape} in place of {shape}")
    bad = np.isinf(values) if missing else ~np.isfinite(values)
    _require(not bad.any(), f"{place}: {int(bad.sum())} of its numbers are not finite")


def _names(place: str, group: Collection[str], names: Sequence[str], empty: bool = False) -> None:
    if empty and not group:
        return
    _require(sorted(group) == sorted(names), f"{place}: names are {_brief(list(group))} in place of {list(names)}")


def _units(place: str, units: Any) -> None:
    _require(isinstance(units, Mapping) and all(isinstance(u, str) for u in units.values()), f"{place}: one is no text")


def _require(fine: bool, otherwise: str) -> None:
    if not fine:
        raise DataError(otherwise)


def _brief(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
