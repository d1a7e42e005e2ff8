"""Saving and loading of fits, with the data that they were made of.

Version 1 of the format had neither experiments nor solution: such fits have none, and what needs these (a diagnosis)
takes what the records hold, and estimates again from there.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..data.experiment import Experiment, Signal, completed
from ..errors import DataError, PhugoidError
from ..filter_error import FilterError
from ..fit_result import FitResult, Refinement, Smoothing
from ..modelling.densities import noise_from_dict
from ..modelling.model import Model
from ..parameters import Estimate, Estimates
from ..records import Record
from ..solvers import HINTS, Iteration, Solution
from ..transcription import Transcription, from_dict, to_dict
from . import files as io

__all__ = ["check_fit", "check_kinds", "damage", "fit_from", "fit_payload", "fit_unit", "load", "save"]

_Array: TypeAlias = NDArray[np.float64]

# Fields of records from the filter-error method.
_OF_FILTER = ("state_std", "innovations", "innovation_std", "predicted_states")


def save(fit: FitResult, path: str | os.PathLike[str]) -> None:
    """Write a fit: HDF5 where the suffix is ``.h5`` or ``.hdf5``, else JSON. See `Fit.save`."""
    io.save_fit_dict(path, fit_payload(fit), lambda place: fit_unit(fit, place))


def load(path: str | os.PathLike[str]) -> FitResult:
    """Read a fit that `Fit.save` wrote, of this version or an older one; the format is recognised by the content.

    Raises DataError for a missing, damaged or newer file, MissingDependency for HDF5 without h5py.
    """
    saved, version = io.load_fit_dict(path)
    with damage(path):
        return fit_from(saved, version)


@contextmanager
def damage(path: str | os.PathLike[str]) -> Iterator[None]:
    """Raise DataError in the name of the file for any exception that invalid content causes."""
    try:
        yield
    except Exception as error:  # invalid content may raise anything, up to RecursionError and MemoryError
        what = str(error) if isinstance(error, PhugoidError) else f"{type(error).__name__}: {error}"
        raise DataError(f"{path}: is damaged ({what[:500]})") from error


def fit_payload(fit: FitResult) -> dict[str, Any]:
    """Return a fit as numbers, texts, lists, mappings and arrays."""
    return {
        "model": fit.model.to_json(),
        "noise": fit.noise.to_dict(),
        "transcription": fit.transcription.to_dict()
        if isinstance(fit.transcription, FilterError)
        else to_dict(fit.transcription),
        "parameters": _listed(fit.parameters),
        "initial_states": {name: _listed(group) for name, group in fit.initial_states.items()},
        "covariance": fit.covariance,
        "log_likelihood": fit.log_likelihood,
        "integrated_log_likelihood": fit.integrated_log_likelihood,
        "records": [vars(r) for r in fit.records],
        "status": fit.status,
        "message": fit.message,
        "iterations": fit.iterations,
        "time": fit.time,
        "warnings": list(fit.warnings),
        "history": [vars(line) for line in fit.history],
        "refinement": fit.refinement.to_dict() if fit.refinement else None,
        "smoothing": fit.smoothing.to_dict() if fit.smoothing else None,
        "experiments": [_experiment_payload(e) for e in fit.experiments],
        "solution": _solution_payload(fit.solution) if fit.solution else None,
        "moved": fit_payload(fit._moved) if fit._moved else None,
    }


def _listed(group: Estimates) -> list[dict[str, Any]]:
    return [{**vars(e), "bounds": list(e.bounds)} for e in group.values()]


def _experiment_payload(e: Experiment) -> dict[str, Any]:
    return {
        "name": e.name,
        "t": e.t,
        "inputs": dict(e.inputs),
        "outputs": {n: z for n, z in e.outputs.items() if n not in e._unmeasured},
        "channels": dict(e.channels),
        "units": dict(e.units),
        "interpolation": e.interpolation,
        "signals": {name: list(signal) for name, signal in e._signals_of().items()},
        "mesh_times": e.mesh_times,
        "history": list(e.history),
        "read_as": dict(e._read_as),
    }


def _solution_payload(solution: Solution) -> dict[str, Any]:
    saved = {f.name: getattr(solution, f.name) for f in fields(solution)}
    lower, upper = (_sparse(v) for v in solution.bound_multipliers)
    return {
        **saved,
        "bound_multipliers": {"lower": lower, "upper": upper},
        "history": [vars(line) for line in solution.history],
    }


def _sparse(values: _Array) -> dict[str, Any]:
    """Return an array by its entries that are not zero, since few variables have bounds."""
    at = np.flatnonzero(values)
    return {"size": values.size, "at": at, "values": values[at]}


def fit_unit(fit: FitResult, place: tuple[str | int, ...]) -> str:
    """Return the unit of an array by its place: ``("records", 0, "outputs", "q")`` has the unit of q."""
    if place[0] == "moved":
        return fit_unit(fit._moved, place[1:]) if fit._moved else ""
    if place[0] not in ("records", "experiments") or len(place) < 3:
        return ""
    kind, name = str(place[2]), str(place[-1])
    if kind in ("t", "mesh_t", "mesh_times"):
        return str(fit.model.time_unit)
    if kind in ("signals", "input_samples"):  # times and values
        if place[-1] == 0:
            return str(fit.model.time_unit)
        name = str(place[3])
    units: Mapping[str, str] = fit.model.units
    if place[0] == "experiments" and isinstance(place[1], int):
        units = {**units, **fit.experiments[place[1]].units}
    return units.get(name, "")


def fit_from(saved: Mapping[str, Any], version: int) -> FitResult:
    """Return the fit of a payload; raise DataError, or another exception, where it is none."""
    fit = FitResult(
        model=Model.from_json(saved["model"]),
        noise=noise_from_dict(saved["noise"]),
        transcription=_transcription(saved["transcription"]),
        parameters=_estimates(saved["parameters"]),
        initial_states={name: _estimates(group) for name, group in saved["initial_states"].items()},
        covariance=io.to_array(saved["covariance"]),
        log_likelihood=io.to_float(saved["log_likelihood"]),
        records=[_record(r) for r in saved["records"]],
        status=saved["status"],
        message=saved["message"],
        iterations=saved["iterations"],
        time=io.to_float(saved["time"]),
        warnings=tuple(saved["warnings"]),
        history=_history(saved["history"]),
        refinement=Refinement.from_dict(saved["refinement"]) if saved.get("refinement") else None,
        smoothing=Smoothing.from_dict(saved["smoothing"]) if saved.get("smoothing") else None,
        integrated_log_likelihood=_optional(saved.get("integrated_log_likelihood")),
    )
    if version > 1:
        solution, moved = saved["solution"], saved["moved"]
        fit = replace(
            fit,
            experiments=tuple(completed([_experiment(e) for e in saved["experiments"]], fit.model.output_names)),
            solution=_solution(solution) if solution is not None else None,
            _moved=fit_from(moved, version) if moved is not None else None,
        )
    check_fit(fit)
    return fit


def _optional(number: Any) -> float | None:
    return None if number is None else io.to_float(number)


def _history(lines: list[dict[str, Any]]) -> list[Iteration]:
    whole = ("number", "trials")

    def number(key: str, value: Any) -> Any:
        return value if key in whole else io.to_float(value)

    return [Iteration(**{k: number(k, v) for k, v in line.items()}) for line in lines]


def _estimates(group: list[dict[str, Any]]) -> Estimates:
    numbers = ("value", "std_error", "start")
    return Estimates(
        Estimate(
            **{**e, **{k: io.to_float(e[k]) for k in numbers}, "bounds": tuple(map(io.to_float, e["bounds"]))},
        )
        for e in group
    )


def _record(saved: Mapping[str, Any]) -> Record:
    groups = ("inputs", "outputs", "states", "measured", "residuals", "mesh_states")
    each = {**{k: saved[k] for k in groups}, **{k: saved.get(k, {}) for k in _OF_FILTER}}
    own = {n: (io.to_array(at), io.to_array(v)) for n, (at, v) in saved.get("input_samples", {}).items()}
    return Record(
        name=saved["name"],
        units=saved["units"],
        t=io.to_array(saved["t"]),
        mesh_t=io.to_array(saved["mesh_t"]),
        interpolation=saved.get("interpolation", "linear"),
        input_samples=own,
        feasible=bool(saved.get("feasible", True)),
        **{k: _arrays(group) for k, group in each.items()},
    )


def _arrays(group: Mapping[str, Any]) -> dict[str, _Array]:
    return {name: io.to_array(values) for name, values in group.items()}


def _transcription(saved: Mapping[str, Any]) -> Transcription | FilterError:
    return FilterError(**saved) if "states" in saved else from_dict(dict(saved))


def _experiment(saved: Mapping[str, Any]) -> Experiment:
    groups = (_arrays(saved["inputs"]), _arrays(saved["outputs"]))
    channels = _arrays(saved["channels"])
    # Earlier releases accepted units of channels that the record has not.
    units = {n: unit for n, unit in saved["units"].items() if any(n in group for group in (*groups, channels))}
    e = Experiment(
        io.to_array(saved["t"]), *groups, saved["name"], saved["interpolation"], channels=channels, units=units
    )
    signals: dict[str, Signal] = {
        name: (io.to_array(t), io.to_array(values), io.to_float(delay), int(order))
        for name, (t, values, delay, order) in saved["signals"].items()
    }
    e._sampled(signals, None if saved["mesh_times"] is None else io.to_array(saved["mesh_times"]))
    e._history = tuple(map(str, saved["history"]))
    e._read_as = _read_as(saved.get("read_as", {}))
    return e


def _read_as(saved: Any) -> dict[str, Any]:
    """Return options of `read`; raise TypeError for what is none."""
    kinds: dict[str, Any] = {
        "time": str,
        "rate": (int, float),
        "rename": dict,
        "units": dict,
        "convert": bool,
        "columns": list,
    }
    if not isinstance(saved, dict) or not all(isinstance(given, kinds.get(n, ())) for n, given in saved.items()):
        raise TypeError("read_as holds other things than options of read")
    units = {n: unit if isinstance(unit, str) else tuple(map(str, unit)) for n, unit in saved.get("units", {}).items()}
    return {**saved, "units": units} if units else dict(saved)


def _solution(saved: Mapping[str, Any]) -> Solution:
    xi = io.to_array(saved["xi"])

    def whole(part: Mapping[str, Any]) -> _Array:
        at = np.asarray(part["at"], dtype=np.intp)
        if part["size"] != xi.size or (at.size and at.min() < 0):
            raise DataError("solution.bound_multipliers: are not those of as many variables")
        values = np.zeros(xi.size)
        values[at] = io.to_array(part["values"])
        return values

    bounds = saved["bound_multipliers"]
    return Solution(
        **{
            **saved,
            "xi": xi,
            "multipliers": io.to_array(saved["multipliers"]),
            "bound_multipliers": (whole(bounds["lower"]), whole(bounds["upper"])),
            "time": io.to_float(saved["time"]),
            "history": _history(saved["history"]),
        }
    )


_WHOLE = 2**53  # beyond, JSON's numbers are not exact


def check_fit(fit: FitResult, moved: bool = True) -> None:
    """Raise DataError, with the place, unless the fit is complete and consistent."""
    fit.model.check()
    fit.noise.resolve(fit.model.output_names, dict.fromkeys(fit.model.output_names, 1.0), {})
    check_kinds("", vars(fit), ("status", "message"), ("iterations",), ("log_likelihood", "time"))
    integrated = fit.integrated_log_likelihood
    _require(integrated is None or type(integrated) in (float, int), "integrated_log_likelihood is not a number")
    _require(fit.status in HINTS, f"status is {_brief(fit.status)}, which is none")
    _require(all(isinstance(w, str) for w in fit.warnings), "warnings: one is not text")
    _records(fit)
    _parameters(fit)
    _check_history("history", fit.history)
    if fit.refinement is not None:
        _refinement(fit.refinement, fit.parameters)
    if fit.smoothing is not None:
        _smoothing(fit.smoothing, fit.parameters)
    if fit.experiments:
        _experiments(fit)
    if fit.solution is not None:
        _check_solution(fit.solution, fit)
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
        (whole, "a whole number from 0", lambda v: type(v) is int and 0 <= v <= _WHOLE),
        (numbers, "a number", lambda v: type(v) is float or (type(v) is int and abs(v) <= _WHOLE)),
        (flags, "a truth value", lambda v: isinstance(v, bool)),
    ]
    for names, kind, fits in kinds:
        for name in names:
            where = f"{place}.{name}" if place else name
            _require(fits(values[name]), f"{where} is not {kind}, but {_brief(values[name])}")


def _parameters(fit: FitResult) -> None:
    names = [r.name for r in fit.records]
    _check_estimates("parameters", fit.parameters, fit.status)
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
        _check_estimates(f"initial_states.{record}", group, fit.status)
        _names(f"initial_states.{record}", group, fit.model.state_names)


def _check_estimates(place: str, group: Estimates, status: str) -> None:
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


def _check_solution(s: Solution, fit: FitResult) -> None:
    place = "solution"
    check_kinds(place, vars(s), ("status", "message"), ("iterations", "flops"), ("time",))
    check_kinds(f"{place}.evaluations", s.evaluations, (), s.evaluations)
    _array(f"{place}.xi", s.xi, (s.xi.size,), missing=fit.status != "converged")
    _require(s.xi.size >= len(fit.parameters), f"{place}.xi: has {s.xi.size} values")
    _array(f"{place}.multipliers", s.multipliers, (s.multipliers.size,), missing=fit.status != "converged")
    for values in s.bound_multipliers:
        _array(f"{place}.bound_multipliers", values, (s.xi.size,))
    _check_history(f"{place}.history", s.history)


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


def _check_history(place: str, lines: Sequence[Iteration]) -> None:
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
    texts = isinstance(units, Mapping) and all(isinstance(u, str) for u in units.values())
    _require(texts, f"{place}: one is not text")


def _require(fine: bool, otherwise: str) -> None:
    if not fine:
        raise DataError(otherwise)


def _brief(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
