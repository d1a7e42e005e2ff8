"""Records, experiments and estimates as tables of pandas and datasets of xarray, draws of parameters for arviz.

What is sampled at times of its own keeps them: in a table there are rows for all times, NaN where a channel has no
sample; in a dataset such a channel has a time axis of its own, ``time_<channel>``.
"""

from __future__ import annotations

import importlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from .errors import DataError, MissingDependency
from .time_unit import time_unit_of

if TYPE_CHECKING:
    import pandas
    import xarray

__all__ = [
    "arviz_draws",
    "estimates_frame",
    "experiment_dataset",
    "experiment_frame",
    "fit_dataset",
    "package",
    "record_dataset",
    "record_frame",
]

_Array: TypeAlias = NDArray[np.float64]

# Times closer than this part of the shortest interval are the same.
_SAME = 1e-8

# Groups of a record, and how a variable of each begins.
_GROUPS = {
    "inputs": "input",
    "states": "state",
    "outputs": "output",
    "measured": "measured",
    "residuals": "residual",
    "state_std": "state_std",
    "innovations": "innovation",
    "innovation_std": "innovation_std",
    "predicted_states": "predicted_state",
}


def arviz_draws(draws: Mapping[str, _Array]) -> Any:
    """Return draws of parameters, name -> (n,), as arviz takes them: one chain of its group ``posterior``."""
    base = package("arviz_base", "to_arviz", "arviz")
    return base.from_dict({"posterior": {name: values[np.newaxis] for name, values in draws.items()}})


def estimates_frame(estimates: Iterable[Any]) -> pandas.DataFrame:
    """Return a table with one row for each estimate. See `Estimates.to_pandas`."""
    pd = package("pandas", "to_pandas")
    rows = {
        e.name: {
            "value": e.value,
            "std_error": e.std_error,
            "relative_std_error": e.relative_std_error,
            "unit": e.unit,
            "start": e.start,
            "lower": e.bounds[0],
            "upper": e.bounds[1],
            "fixed": e.fixed,
            "bounds_active": e.bounds_active or "",
        }
        for e in estimates
    }
    frame = pd.DataFrame(list(rows.values()), index=pd.Index(list(rows), name="parameter", dtype=object))
    return frame if rows else pd.DataFrame(columns=["value", "std_error"], index=frame.index)


def _kinds(record: Any) -> str:
    """Return how inputs behave between samples in words: ``"linear"``, or ``"de hold, V linear"``."""
    kinds = record.interpolation
    return kinds if isinstance(kinds, str) else ", ".join(f"{name} {kind}" for name, kind in kinds.items())


def record_frame(record: Any) -> pandas.DataFrame:
    """Return the time histories of a `Record`. See `Record.to_pandas`."""
    pd = package("pandas", "to_pandas")
    columns = {(group, name): values for group in _GROUPS for name, values in getattr(record, group).items()}
    frame = _joined(pd, record.t, columns, {("inputs", n): own for n, own in record.input_samples.items()})
    frame.columns = pd.MultiIndex.from_tuples(list(frame.columns), names=["group", "channel"])
    frame.attrs = {"name": record.name, "units": dict(record.units), "interpolation": _kinds(record)}
    return frame


def record_dataset(record: Any, apart: Collection[str] = ()) -> xarray.Dataset:
    """Return the time histories of a `Record`, with inputs ``apart`` always over their own axis. See
    `Record.to_xarray`."""
    xr = package("xarray", "to_xarray")
    data: xarray.Dataset = xr.Dataset(coords={"time": ("time", record.t, {"units": str(time_unit_of(record.units))})})
    for group, prefix in _GROUPS.items():
        for name, values in getattr(record, group).items():
            own = record.input_samples.get(name) if group == "inputs" else None
            own = (record.t, values) if own is None and group == "inputs" and name in apart else own
            attributes = {"units": record.units.get(name, ""), "channel": name, "group": group}
            data = _with_variable(data, f"{prefix}_{name}", name, values, own, attributes)
    data.attrs = {"experiment": record.name, "interpolation": _kinds(record)}
    return data


def experiment_frame(e: Any) -> pandas.DataFrame:
    """Return an `Experiment` as a table. See `Experiment.to_pandas`."""
    pd = package("pandas", "to_pandas")
    frame = _joined(pd, e.t, {name: values for name, _, values in _channels(e)}, _own_samples(e))
    frame.attrs = {"name": e.name, "units": dict(e.units), "interpolation": _kinds(e), "history": list(e.history)}
    return frame


def experiment_dataset(e: Any) -> xarray.Dataset:
    """Return an `Experiment` as a dataset. See `Experiment.to_xarray`."""
    xr = package("xarray", "to_xarray")
    data: xarray.Dataset = xr.Dataset(coords={"time": ("time", e.t, {"units": str(e.time_unit)})})
    samples = _own_samples(e)
    for name, role, values in _channels(e):
        attributes = {"units": e.units.get(name, ""), "role": role}
        data = _with_variable(data, name, name, values, samples.get(name), attributes)
    data.attrs = {"experiment": e.name, "interpolation": _kinds(e), "history": "\n".join(e.history)}
    return data


def fit_dataset(
    records: Sequence[Any], estimates: Any, covariance: _Array, attributes: Mapping[str, Any]
) -> xarray.Dataset:
    """Return the records and `Estimates` of a fit as one dataset with attributes. See `Fit.to_xarray`."""
    xr = package("xarray", "to_xarray")
    # An input is over the same axis in all experiments.
    each = [record_dataset(r, {name for r in records for name in r.input_samples}) for r in records]
    if len(each) == 1:
        data = each[0]
    else:
        names = xr.Variable("experiment", np.array([r.name for r in records], dtype=object))
        data = xr.concat(each, dim="experiment", join="outer", combine_attrs="drop_conflicts").assign_coords(
            experiment=names
        )
    names = list(estimates)
    units = np.array([e.unit for e in estimates.values()], dtype=object)
    data = data.assign_coords(
        parameter=("parameter", np.array(names, dtype=object)),
        parameter_other=("parameter_other", np.array(names, dtype=object)),
        parameter_unit=("parameter", units),
    )
    data["estimate"] = ("parameter", estimates.values_array)
    data["std_error"] = ("parameter", estimates.std_errors_array)
    data["covariance"] = (("parameter", "parameter_other"), np.array(covariance))
    data.attrs = {**data.attrs, **attributes}
    return data


def package(name: str, caller: str, extra: str = "") -> Any:
    """Import and return a package of an extra, that of its name by default; raise MissingDependency where it is not
    installed."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise MissingDependency(f'{caller} needs {name} ({error}): pip install "phugoid[{extra or name}]"') from error


def _channels(e: Any) -> list[tuple[str, str, _Array]]:
    """Return name, role and values of each column; equal columns of one name are returned once."""
    found: dict[str, tuple[str, _Array]] = {}
    for role, group in (("input", e.inputs), ("output", e.outputs), ("channel", e.channels)):
        for name, values in group.items():
            if name not in found:
                found[name] = role, values
            elif not np.array_equal(found[name][1], values, equal_nan=True):
                raise DataError(
                    f"experiment '{e.name}': the {found[name][0]} '{name}' and the {role} '{name}' differ, and a table "
                    f"has one column of a name: use .rename first, or e.{role}s['{name}']"
                )
    return [(name, role, values) for name, (role, values) in found.items()]


def _own_samples(e: Any) -> dict[str, tuple[_Array, _Array]]:
    """Return times and samples of the columns that have their own; no output has."""
    found: dict[str, tuple[_Array, _Array]] = e.own_samples([n for n, role, _ in _channels(e) if role != "output"])
    return found


def _joined(pd: Any, t: _Array, columns: Mapping[Any, _Array], samples: Mapping[Any, tuple[_Array, _Array]]) -> Any:
    """Return columns, each at its own times, in one table."""
    near = {key: (_aligned(own, t), there) for key, (own, there) in samples.items()}
    times = np.unique(np.concatenate([t, *(own for own, _ in near.values())]))
    table = {}
    for key, values in columns.items():
        own, there = near.get(key, (t, values))
        table[key] = np.full(times.size, np.nan)
        table[key][np.searchsorted(times, own)] = there
    frame = pd.DataFrame(index=pd.Index(times, name="time"))
    return pd.concat([frame, pd.DataFrame(table, index=frame.index)], axis=1) if table else frame


def _aligned(own: _Array, t: _Array) -> _Array:
    """Return times, replaced by those of ``t`` where they differ by rounding only: 3 * 0.2 is not 6 * 0.1."""
    after = np.clip(np.searchsorted(t, own), 1, t.size - 1)
    nearest = np.where(own - t[after - 1] < t[after] - own, t[after - 1], t[after])
    gap = min(float(np.diff(v).min()) for v in (own, t) if v.size > 1)
    return np.asarray(np.where(np.abs(own - nearest) <= _SAME * gap, nearest, own))


def _with_variable(data: Any, name: str, channel: str, values: _Array, own: Any, attributes: Mapping[str, str]) -> Any:
    """Return the dataset with one more variable, over its own axis where it has other times."""
    if own is None:
        data[name] = ("time", np.array(values), dict(attributes))
        return data
    axis = f"time_{channel}"
    data = data.assign_coords({axis: (axis, own[0], dict(data["time"].attrs))})
    data[name] = (axis, np.array(own[1]), dict(attributes))
    return data
