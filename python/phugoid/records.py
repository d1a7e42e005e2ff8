"""Time histories of one experiment, fitted or simulated, and outputs that hold the same measurement."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .data.experiment import Experiment
from .data.filtering import Interpolations, kinds_for
from .errors import ByName, DataError, joined
from .modelling.model import Model
from .notebook import channels_table, notebook_page
from .tabular import record_dataset, record_frame
from .time_unit import time_unit_of

if TYPE_CHECKING:
    import pandas
    import xarray


__all__ = ["Record", "record_of", "repeated_outputs"]

_Array = NDArray[np.float64]


# What the values of each group belong to, for the message on an unknown name.
_GROUPS = {
    "inputs": "input",
    **dict.fromkeys(("outputs", "residuals", "innovations", "innovation_std"), "output"),
    **dict.fromkeys(("states", "mesh_states", "state_std", "predicted_states"), "state"),
    "measured": "measured output",
}


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Record:
    """Fitted or simulated time histories of one experiment; N samples, M mesh points.

    name         the experiment's name.
    t            (N,) time of the samples, s.
    inputs       name -> (N,).
    outputs      name -> (N,): the outputs of the model.
    states       name -> (N,): the states at the sample times.
    measured     name -> (N,), NaN where missing; empty for a plain simulation.
    residuals    name -> (N,): measured - outputs, NaN where missing.
    mesh_t       (M,) time of the mesh points of the transcription, s.
    mesh_states  name -> (M,): the states there.
    units        name -> unit, for every kind of channel.
    interpolation  of the inputs between samples, as `Experiment.interpolation` has it.
    input_samples  name -> times (s) and values of the inputs that have samples of their own, such as finer ones.
    feasible     whether the states satisfy the equations; where they do not, after a run that ended early, `match`
                 gives NaN.

    With process noise (`FilterError`) ``states`` and ``outputs`` are those of the most probable path, and there are:

    state_std       name -> (N,): standard deviation of each state given all data, for parameters known.
    innovations     name -> (N,): measured minus the prediction from the preceding samples; white where the model is
                    right, as residuals of a smoothed path are not. NaN where missing.
    innovation_std  name -> (N,): their expected standard deviations.
    predicted_states  name -> (N,): the states predicted from the samples before. The innovations of a right model are
                    independent of these; of ``states``, which all samples determine, they are not.
    """

    name: str
    t: _Array
    inputs: Mapping[str, _Array]
    outputs: Mapping[str, _Array]
    states: Mapping[str, _Array]
    measured: Mapping[str, _Array] = field(default_factory=dict)
    residuals: Mapping[str, _Array] = field(default_factory=dict)
    mesh_t: _Array = field(default_factory=lambda: np.empty(0))
    mesh_states: Mapping[str, _Array] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    interpolation: Interpolations = "linear"
    input_samples: Mapping[str, tuple[_Array, _Array]] = field(default_factory=dict)
    feasible: bool = True
    state_std: Mapping[str, _Array] = field(default_factory=dict)
    innovations: Mapping[str, _Array] = field(default_factory=dict)
    innovation_std: Mapping[str, _Array] = field(default_factory=dict)
    predicted_states: Mapping[str, _Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for group, what in _GROUPS.items():
            object.__setattr__(self, group, ByName(what, getattr(self, group)))

    @property
    def n(self) -> int:
        """Number of samples, N."""
        return int(self.t.size)

    def without_rest(self) -> Record:
        """Return the record from its first measured sample on where what lies before that is longer than what follows,
        as a steady state is (`from_steady_state`); else the record itself. Figures show this part."""
        there = [np.isfinite(z) for z in self.measured.values()]
        first = int(np.argmax(np.any(there, axis=0))) if there else 0
        if self.n - first < 2 or self.t[first] - self.t[0] <= self.t[-1] - self.t[first]:
            return self
        over_time = [group for group in _GROUPS if group != "mesh_states"]
        parts: dict[str, Any] = {g: {n: v[first:] for n, v in getattr(self, g).items()} for g in over_time}
        kept = self.mesh_t >= self.t[first]
        mesh = {n: v[kept] for n, v in self.mesh_states.items()}
        return replace(self, t=self.t[first:], mesh_t=self.mesh_t[kept], mesh_states=mesh, **parts)

    def rms(self) -> dict[str, float]:
        """Return the root mean square of each output's residuals, in its unit; NaN without samples, and where the
        states do not satisfy the equations.

        >>> y, z = np.array([1.0, np.nan, 3.0]), np.zeros(3)
        >>> Record(name="run", t=z, inputs={}, outputs={"y": z}, states={}, residuals={"y": y}).rms()
        {'y': 2.23606797749979}
        """
        if not self.feasible:
            return dict.fromkeys(self.residuals, float("nan"))
        present = {name: r[~np.isnan(r)] for name, r in self.residuals.items()}
        return {n: float(np.sqrt(np.mean(r**2))) if r.size else float("nan") for n, r in present.items()}

    def to_pandas(self) -> pandas.DataFrame:
        """Return the time histories as a table over time (s), with columns ``("outputs", "q")``, ``("measured", "q")``,
        ...

        An input that has samples of its own stands at their times, and there are rows for these too; NaN where a
        channel has no sample. ``attrs`` holds name, units and interpolation. Raises MissingDependency without pandas.
        """
        return record_frame(self)

    def to_xarray(self) -> xarray.Dataset:
        """Return the time histories over ``time`` (s): ``input_de``, ``state_q``, ``output_q``, ``measured_q``,
        ``residual_q``, ..., each with its unit as the attribute ``units``.

        An input that has samples of its own has an axis of its own, ``time_de``. The path between the samples is in
        ``mesh_t`` and ``mesh_states`` alone. Raises MissingDependency without xarray.
        """
        return record_dataset(self)

    def _repr_html_(self) -> str:
        groups = {"input": self.inputs, "output": self.outputs, "state": self.states, "residual": self.residuals}
        note = f"{self.n} samples, {self.t[0]:g} to {self.t[-1]:g} {time_unit_of(self.units)}"
        return notebook_page(self.name, channels_table(groups, self.units, self.t), note=note)

    def __repr__(self) -> str:
        def names(group: Mapping[str, _Array]) -> str:
            return " ".join(group) or "none"

        return (
            f"Record('{self.name}', {self.n} samples, {self.mesh_t.size} mesh points, "
            f"inputs: {names(self.inputs)}, outputs: {names(self.outputs)}, states: {names(self.states)})"
        )


# Correlation of residuals from which on one output has no information beyond the other: digits are rounded.
_SAME = 0.999
# Outputs that differ by less than this part of their residuals, once one is scaled to the other, are copies with slight
# noise of their own.
_OWN = 0.2
_FEWEST = 10  # samples that both have
_EXACT = 1e-9  # part of an output's spread: smaller residuals are rounding errors


def only(records: Sequence[Record], owner: str, what: str) -> Record:
    """Return the only record of a fit or a validation, the ``owner``; raise DataError that leads to ``what`` in each
    where there are several."""
    if len(records) > 1:
        names = ", ".join(f"'{r.name}'" for r in records)
        raise DataError(f"the {owner} has {len(records)} experiments ({names}): use {owner}.records[i].{what}")
    return records[0]


def record_of(
    model: Model, experiment: Experiment, outputs: Iterable[_Array], states: Iterable[_Array], **more: Any
) -> Record:
    """Return the record of a model's outputs (n_y, N) and states (n_x, N) at the samples of an experiment, with its
    inputs. ``more``: other fields of `Record`."""
    return Record(
        name=experiment.name,
        t=experiment.t,
        inputs={name: experiment.input(name) for name in model.input_names},
        outputs=dict(zip(model.output_names, outputs, strict=True)),
        states=dict(zip(model.state_names, states, strict=True)),
        units=model.units,
        interpolation=kinds_for(experiment.interpolation, model.input_names),
        input_samples=experiment.own_samples(model.input_names),
        **more,
    )


def repeated_outputs(records: Sequence[Record], outputs: Sequence[str]) -> list[str]:
    """Return a warning for each group of outputs whose residuals are proportional to each other.

    Residuals are compared, not measurements alone: two outputs that move alike have more information than one as long
    as their noise is their own. With process noise they are the innovations, which two sensors of a state that was
    wrongly predicted may share: there, only proportional ones are reported.
    """
    if not _some_are_correlated(records, outputs):  # nearly always, and quickly seen
        return []
    residuals = {name: _joined(r.innovations.get(name, r.residuals[name]) for r in records) for name in outputs}
    measured = {name: _joined(r.measured[name] for r in records) for name in outputs}
    known = [name for name in outputs if _size(residuals[name]) > _EXACT * _size(measured[name])]
    innovations = any(r.innovations for r in records)

    def alike(one: str, other: str) -> bool:
        correlation = _correlation(residuals[one], residuals[other])
        # A copy with noise of its own has correlated residuals as well, though less closely.
        if innovations or correlation < 1 - 2 * _OWN**2:
            return correlation > _SAME
        copies = _copies((residuals[one], measured[one]), (residuals[other], measured[other]))
        return copies or correlation > _SAME

    groups: list[list[str]] = []
    for name in known:
        group = next((g for g in groups if any(alike(name, other) for other in g)), None)
        if group is None:
            groups.append([name])
        else:
            group.append(name)
    found = []
    for members in (g for g in groups if len(g) > 1):
        found.append(
            f"outputs {joined(members)} hold the same measurement: their residuals are nearly proportional. "
            f"Each counts as if its noise were independent, so that standard errors are too small, by √{len(members)} "
            f"where nothing else is measured: leave {'one' if len(members) == 2 else 'all but one'} out of the outputs"
        )
    return found


def _some_are_correlated(records: Sequence[Record], outputs: Sequence[str]) -> bool:
    """Return whether residuals of any two outputs may be as closely correlated as those of repeated ones; True where
    some samples are missing, which takes longer to see."""
    parts = [np.array([r.innovations.get(name, r.residuals[name]) for name in outputs]) for r in records]
    all_of = np.concatenate([p - p.mean(axis=1, keepdims=True) for p in parts], axis=1)
    products = all_of @ all_of.T
    if not np.isfinite(products).all():
        return True
    size = np.sqrt(np.diag(products))
    least = min(_SAME, 1 - 2 * _OWN**2)
    close = np.abs(products) > (least - 1e-6) * np.outer(size, size)
    return bool(np.triu(close, 1).any())


def _centred(values: _Array) -> _Array:
    there = np.isfinite(values)
    return np.asarray(values - values[there].mean()) if there.any() else values


def _joined(parts: Iterable[_Array]) -> _Array:
    """Return the values of all records, each about its mean."""
    return np.concatenate([_centred(part) for part in parts])


def _size(values: _Array) -> float:
    return float(np.sqrt(np.nansum(values**2)))


def _correlation(one: _Array, other: _Array) -> float:
    """Return the absolute value of the correlation; 0 with too few samples."""
    both = np.isfinite(one) & np.isfinite(other)
    if both.sum() < _FEWEST:
        return 0.0
    a, b = one[both], other[both]
    product = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(abs(a @ b)) / product if product > 0.0 else 0.0


_Pair = tuple[_Array, _Array]  # residuals and measurements


def _copies(one: _Pair, other: _Pair) -> bool:
    """Return whether one output is a scaled copy of the other, but for noise that is small beside the residuals."""
    both = np.isfinite(one[0]) & np.isfinite(other[0])
    (a, za), (b, zb) = ([values[both] for values in pair] for pair in (one, other))
    if not _size(za) > 0.0:
        return False
    scale = (za @ zb) / (za @ za)
    size = _OWN * np.std(b)
    return bool(np.std(zb - scale * za) < size and np.std(b - scale * a) < size)
