"""Saving and loading of fits, with the data that they were made of.

Version 1 of the format had neither experiments nor solution: such fits have none, and what needs these (a diagnosis)
takes what the records hold, and estimates again from there.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
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
from ..solvers import Iteration, Solution
from ..transcription import Transcription, from_dict, to_dict
from . import files as io
from .content import check_fit

__all__ = [
    "damage",
    "fit_from",
    "fit_payload",
    "fit_unit",
    "load",
    "save",
]


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
        return "s"
    if kind in ("signals", "input_samples"):  # times and values
        if place[-1] == 0:
            return "s"
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
    return e


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
