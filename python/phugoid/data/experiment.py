"""Measured time histories: `Experiment` holds one record.

Everything that could spoil an estimate without a trace (unsorted time, gaps in an input, a text cell, a dead
sensor) is refused here, with the channel, the sample and the time.
"""

from __future__ import annotations

import copy
import warnings
from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import DataError, ReadOnly, listing, refuse_attribute
from ..notebook import bullets, channels_table, notebook_page
from ..tabular import experiment_dataset, experiment_frame
from . import checked
from .checked import FloatArray, checked_gaps, gap_intervals, pieces
from .filtering import Columns, Interpolation, Interpolations, Signal, checked_kinds, kind_of
from .preprocess import Preprocessing

if TYPE_CHECKING:
    import pandas
    import xarray

__all__ = ["Experiment", "FloatArray", "Interpolation", "Signal", "as_experiments"]

_FROM_ARRAYS = "The record was made from arrays: use `inputs` and `outputs`."


class Experiment(Preprocessing):
    """One record of measured inputs and outputs over N samples; immutable.

    t              (N,) time in the model's unit, strictly increasing, at least 2 samples; the spacing may vary.
    inputs         name -> (N,), finite.
    outputs        name -> (N,); NaN marks a missing sample.
    name           name of the record in messages and plots.
    interpolation  how inputs behave between samples: ``"linear"``, ``"cubic"`` (spline) or ``"hold"`` (each sample is
                   held until the next, as a computer puts out commands); by input as in ``{"de": "hold", "V":
                   "linear"}``, where inputs that are not named are linear. A wrong assumption here looks like an error
                   of the model. A held input jumps at its samples; at a sample time the outputs depend on the value
                   that is held from that sample on.
    channels       name -> (N,): columns not yet assigned. A model takes inputs and outputs from here that are not in
                   ``inputs`` and ``outputs``; extra channels do no harm.
    units          name -> unit of the channels given here, and of ``time``, for labels; nothing is converted.

    Filters, detrending and changes of the sampling rate are methods, each of which gives a new record whose ``history``
    says what was done.

    Lists, numpy arrays and pandas Series are accepted (and copied). Bad input raises DataError, which names the
    channel, the sample's index and its time.

    >>> run = Experiment([0.0, 0.1, 0.2], inputs={"de": [0, 1, 1]}, outputs={"q": [0.0, float("nan"), 0.2]})
    >>> run
    Experiment('experiment', 3 samples, 0 to 0.2, inputs: de, outputs: q (1 missing))
    >>> run.window(0.1, 0.2).t
    array([0.1, 0.2])
    """

    def __init__(
        self,
        t: ArrayLike,
        inputs: Mapping[str, ArrayLike] | None = None,
        outputs: Mapping[str, ArrayLike] | None = None,
        name: str = "experiment",
        interpolation: Interpolations = "linear",
        *,
        channels: Mapping[str, ArrayLike] | None = None,
        units: Mapping[str, str] | None = None,
    ) -> None:
        self._name = str(name)
        self._t = checked.times(self._name, t)
        self._inputs = checked.columns(self._name, "input", inputs, self._t)
        self._outputs = checked.columns(self._name, "output", outputs, self._t)
        self._channels = checked.columns(self._name, "channel", channels, self._t)
        self._units = checked.units(self._name, units, [*self._inputs, *self._outputs, *self._channels])
        self._interpolation = checked_kinds(self._name, interpolation, [*self._inputs, *self._channels])
        self._signals = {}
        self._mesh_times: FloatArray | None = None
        self._history: tuple[str, ...] = ()
        self._left_out: Mapping[str, str] = {}  # of the file: name -> why it is not a channel
        self._read_as: Mapping[str, Any] = {}  # options of `read` that say how names and units of the file were changed
        self._unmeasured: frozenset[str] = frozenset()  # outputs that only other experiments measure
        for channel, values in self._inputs.items():
            checked.check_input(checked.where(self._name, "input", channel), values, self._t)
        for channel, values in self._outputs.items():
            checked.check_output(checked.where(self._name, "output", channel), values, self._t)

    def __setattr__(self, name: str, value: Any) -> None:
        refuse_attribute(self, Experiment, name, value)
        object.__setattr__(self, name, value)

    @property
    def name(self) -> str:
        """The name of the record in messages and plots."""
        return self._name

    @property
    def t(self) -> FloatArray:
        """Time of the samples in s, shape (N,), read-only."""
        return self._t

    @property
    def inputs(self) -> Mapping[str, FloatArray]:
        """The channels given as inputs: name -> (N,), read-only."""
        return ReadOnly("input", self._inputs)

    @property
    def outputs(self) -> Mapping[str, FloatArray]:
        """The channels given as outputs: name -> (N,), read-only; NaN where a sample is missing."""
        return ReadOnly("output", self._outputs)

    @property
    def channels(self) -> Mapping[str, FloatArray]:
        """The columns that may serve as inputs or outputs: name -> (N,), read-only."""
        return ReadOnly("channel", self._channels, "" if self._channels else _FROM_ARRAYS)

    @property
    def units(self) -> Mapping[str, str]:
        """Units of the channels, and of ``time``, where known (from the file's header, or as given)."""
        return ReadOnly("unit of channel", self._units)

    def signal(self, name: str) -> Signal | None:
        """Return how an input was sampled at times of its own, and what is taken of it.

        Times (s), samples, delay (s), order of the derivative; None for an input that has a sample at each time of the
        record.
        """
        return self._signals.get(name)

    def samples(self, name: str) -> tuple[FloatArray, FloatArray]:
        """Return the times (s) and values that an input is interpolated between: its own, or those of the record."""
        own = self._signals.get(name)
        return (self._t, self.input(name)) if own is None else (own[0], own[1])

    def own_samples(self, names: Sequence[str]) -> dict[str, tuple[FloatArray, FloatArray]]:
        """Return `samples` of the inputs that have their own, if these are neither delayed nor differentiated."""
        return {n: self.samples(n) for n in names if n in self._signals and self._signals[n][2:] == (0.0, 0)}

    @property
    def mesh_times(self) -> FloatArray | None:
        """Times that a mesh follows where these are not the sample times; None where they are."""
        return self._mesh_times

    @property
    def interpolation(self) -> Interpolations:
        """How inputs behave between samples: one word for all, or a mapping by name, else ``"linear"``."""
        return self._interpolation if isinstance(self._interpolation, str) else dict(self._interpolation)

    def interpolation_of(self, name: str) -> Interpolation:
        """Return how the input ``name`` behaves between its samples."""
        return kind_of(self._interpolation, name)

    @property
    def history(self) -> tuple[str, ...]:
        """The steps that were applied to the record since it was read or made: one sentence each, in order."""
        return self._history

    @property
    def n(self) -> int:
        """Number of samples, N."""
        return int(self._t.size)

    def __len__(self) -> int:
        return self.n

    def __repr__(self) -> str:
        parts = [f"{self.n} samples", self.time_unit.of(f"{self._t[0]:g} to {self._t[-1]:g}")]
        parts += [f"{kind}s: {' '.join(group)}" for kind, group in self._columns_of().items() if group]
        missing = sum(int(np.isnan(values).sum()) for values in self._outputs.values())
        return f"Experiment('{self._name}', {', '.join(parts)}{f' ({missing} missing)' if missing else ''})"

    def _repr_html_(self) -> str:
        groups = {"input": self._inputs, "output": self._outputs, "": self._channels}
        found = channels_table(groups, self._units, self._t)
        note = f"{self.n} samples, {self.time_unit.of(f'{self._t[0]:g} to {self._t[-1]:g}')}"
        return notebook_page(self._name, found, bullets(self._history), note=note)

    def input(self, name: str) -> FloatArray:
        """Return the input channel ``name``, shape (N,); raise DataError where there is none."""
        return self._resolve(name, self._inputs, "input")

    def output(self, name: str) -> FloatArray:
        """Return the output channel ``name``, shape (N,), NaN where missing; raise DataError where there is none."""
        return self._resolve(name, self._outputs, "output")

    def check_for(
        self,
        model_inputs: Sequence[str],
        model_outputs: Sequence[str],
        known_sigma: Collection[str] = (),
        *,
        conditions: Collection[str] = (),
    ) -> None:
        """Raise DataError unless a model with these inputs and outputs can be estimated from this record.

        Every name must be there, inputs without gaps, outputs with at least one sample. An output that never changes is
        refused, since its σ cannot be estimated, unless it is in ``known_sigma``. ``conditions``: the inputs that
        errors call conditions.
        """
        for name in model_inputs:
            role = "condition" if name in conditions else "input"
            where = checked.where(self._name, role, name)
            checked.check_input(where, self._resolve(name, self._inputs, role), self._t)
            if name in self._signals:
                checked.check_input(where, self._signals[name][1], self._signals[name][0])
        for name in model_outputs:
            if name in self._unmeasured:
                continue
            values, where = self.output(name), checked.where(self._name, "output", name)
            checked.check_output(where, values, self._t)
            if name not in known_sigma:
                checked.check_moves(where, values)

    def window(self, t0: float, t1: float, name: str | None = None) -> Experiment:
        """Return the samples with ``t0 <= t <= t1`` (s), time unchanged; raise DataError where fewer than 2 are
        left."""
        # Sample times such as 0.1*k carry rounding: without slack window(0, 0.3) would lose its last sample.
        slack = 1e-6 * float(np.median(np.diff(self._t)))
        kept = (self._t >= t0 - slack) & (self._t <= t1 + slack)
        if int(kept.sum()) < 2:
            raise DataError(
                f"experiment '{self._name}': the window {t0:g} to {t1:g} holds {int(kept.sum())} samples; "
                f"the record runs from {self.time_unit.of(f'{self._t[0]:g} to {self._t[-1]:g}')}"
            )
        t = self._t[kept]
        columns = {kind: {n: z[kept] for n, z in group.items()} for kind, group in self._columns_of().items()}
        step = self.time_unit.of(f"window {t[0]:g} to {t[-1]:g}") if t.size < self.n else ""
        return self._made(step, columns, name, t=t)

    def cut(self, spans: Sequence[Any]) -> list[Experiment]:
        """Return the records of several spans, called ``name[1]``, ``name[2]``, ...; spans that overlap are one.

        spans  (t0, t1) in s each, or objects with such a ``span``, as `manoeuvres` finds them. What lies outside the
               record is left out.

        Raises DataError for spans that are no such pairs, and where one holds fewer than 2 samples.

        >>> run = Experiment([0.0, 0.1, 0.2, 0.3, 0.4], outputs={"q": [0.0, 0.1, 0.2, 0.1, 0.0]}, name="run")
        >>> [(part.name, part.n) for part in run.cut([(0.0, 0.1), (0.3, 0.4)])]
        [('run[1]', 2), ('run[2]', 2)]
        """
        merged = checked.merged_spans(f"experiment '{self._name}': cut", spans)
        return [self.window(a, b, f"{self._name}[{i}]") for i, (a, b) in enumerate(merged, 1)]

    def split(self, gaps: bool | float = True) -> list[Experiment]:
        """Return the parts of the record between gaps in its sampling, called ``name[1]``, ``name[2]``, ...

        In a gap the inputs are unknown, and the model would be driven by what interpolation makes of them. The
        parts are estimated together, each with initial states of its own.

        gaps  True: an interval is a gap where it is longer than ten times those beside it (the twenty nearest, of which
              two may be as long). Sampling that is irregular by nature, such as increasing intervals, bursts, or
              outputs of several rates, has no gaps. A number: an interval that is longer than so many s.

        Inputs with samples of their own count too, unless they are held between these: samples of the record within a
        gap of such an input belong to no part. Missing outputs (NaN) are not gaps. Without gaps the record itself is
        returned, in a list. A part with fewer than two samples is left out, with a UserWarning.

        Raises OptionError for a length that is not positive.

        >>> run = Experiment([0.0, 0.1, 0.2, 9.0, 9.1], outputs={"q": [0.0, 0.1, 0.2, 0.0, 0.1]}, name="run")
        >>> [(part.name, part.n) for part in run.split(gaps=5.0)]
        [('run[1]', 3), ('run[2]', 2)]
        """
        limit = checked_gaps(f"experiment '{self._name}': split", gaps)
        intervals = gap_intervals(self._t, limit)
        for name, (own, _, delay, _) in self._signals.items():
            if not self._is_held(name):
                intervals += gap_intervals(own + delay, limit)
        parts = pieces(self._t, intervals)
        if len(parts) == 1 and parts[0] == (0, self.n - 1):
            return [self]
        found: list[Experiment] = []
        for a, b in parts:
            if a == b:
                warnings.warn(
                    f"experiment '{self._name}': the sample at t = {self._t[a]:g} stands alone between gaps "
                    "and is left out",
                    UserWarning,
                    stacklevel=2,
                )
                continue
            found.append(self.window(self._t[a], self._t[b], f"{self._name}[{len(found) + 1}]"))
        return found

    def rename(self, names: Mapping[str, str]) -> Experiment:
        """Return the record with channels renamed, ``{"old": "new"}``; raise DataError for unknown or taken names."""
        present = self._names()
        for old in names:
            if old not in present:
                raise DataError(f"{self._absent('channel', old)}{listing(old, present)}")

        def renamed(group: Mapping[str, Any]) -> dict[str, Any]:
            result = {names.get(key, key): values for key, values in group.items()}
            if len(result) < len(group):
                taken = next(new for old, new in names.items() if old in group and new in group)
                raise DataError(f"experiment '{self._name}': two channels would be called '{taken}'")
            return result

        kinds = self._interpolation
        changed = [f"{old} to {new}" for old, new in names.items() if old != new]
        return self._made(
            f"renamed {', '.join(changed)}" if changed else "",
            {kind: renamed(group) for kind, group in self._columns_of().items()},
            interpolation=kinds if isinstance(kinds, str) else renamed(kinds),
            units={names.get(key, key): unit for key, unit in self._units.items()},
            signals={names.get(key, key): s for key, s in self._signals.items()},
        )

    def with_interpolation(self, interpolation: Interpolations) -> Experiment:
        """Return the same record with inputs that behave otherwise between samples, as the constructor takes it; those
        not named stay as they are."""
        kinds = interpolation
        if not isinstance(interpolation, str):
            names = [*self._inputs, *self._channels]
            kinds = {**{name: self.interpolation_of(name) for name in names}, **interpolation}
        return self._made(f"interpolation: {interpolation}", interpolation=kinds)

    def with_outputs(self, outputs: Mapping[str, ArrayLike], name: str | None = None) -> Experiment:
        """Return the record with ``outputs`` (name -> (N,)) in place of the measured ones, as for simulated data."""
        units = self._units_of(self._inputs, outputs, self._channels)
        return self._made(f"outputs replaced: {', '.join(outputs)}", {"output": outputs}, name, units=units)

    def with_channels(
        self, channels: Mapping[str, ArrayLike], units: Mapping[str, str] | None = None, name: str | None = None
    ) -> Experiment:
        """Return the record with ``channels`` (name -> (N,)) added, or in place of those of the same name, such as a
        corrected angle or a dynamic pressure. An input replaced so has its samples at the times of the record.

        Raises DataError as the constructor does.

        >>> run = Experiment([0.0, 0.1, 0.2], inputs={"de": [0, 1, 1]}, outputs={"q": [0.0, 0.1, 0.2]})
        >>> run.with_channels({"V": [100, 101, 102], "q": run.output("q") - 0.1})
        Experiment('experiment', 3 samples, 0 to 0.2, inputs: de, outputs: q, channels: V)
        """

        def replaced(group: Mapping[str, FloatArray]) -> dict[str, ArrayLike]:
            return {key: channels.get(key, values) for key, values in group.items()}

        new = {key: values for key, values in channels.items() if key not in (*self._inputs, *self._outputs)}
        columns = {
            "input": replaced(self._inputs),
            "output": replaced(self._outputs),
            "channel": {**self._channels, **new},
        }
        return self._made(
            f"channels given: {', '.join(channels)}",
            columns,
            name,
            units={**self._units, **(units or {})},
            signals={key: s for key, s in self._signals.items() if key not in channels},
        )

    def to_pandas(self) -> pandas.DataFrame:
        """Return the channels as a table over time (s), one column each.

        An input that has samples of its own stands at their times, and there are rows for these too; NaN where a
        channel has no sample. ``attrs`` holds name, units, interpolation and history. Raises DataError where an input
        and an output of one name differ, MissingDependency without pandas.
        """
        return experiment_frame(self)

    def to_xarray(self) -> xarray.Dataset:
        """Return the channels over ``time`` (s), each with ``units`` and its ``role`` (input, output or channel) as
        attributes. An input that has samples of its own has its own axis, ``time_<input>``.

        Raises DataError where an input and an output of one name differ, MissingDependency without xarray.
        """
        return experiment_dataset(self)

    def _made(
        self,
        step: str,
        columns: Mapping[str, Mapping[str, ArrayLike]] | None = None,
        name: str | None = None,
        *,
        interpolation: Interpolations | None = None,
        units: Mapping[str, str] | None = None,
        signals: Mapping[str, Signal] | None = None,
        t: FloatArray | None = None,
        mesh: bool = True,
    ) -> Experiment:
        """Return the record made of this one by a step, "" for none, with what is given in place of what it has; with
        ``mesh``, a mesh follows the same times as in this one."""
        groups = {**self._columns_of(), **(columns or {})}
        made = Experiment(
            self._t if t is None else t,
            groups["input"],
            groups["output"],
            self._name if name is None else name,
            self._interpolation if interpolation is None else interpolation,
            channels=groups["channel"],
            units=self._units if units is None else units,
        )
        made._sampled(self._signals if signals is None else signals, self._mesh_times if mesh else None)
        return made._after(self, *filter(None, [step]))

    def _after(self, before: Experiment, *steps: str) -> Experiment:
        """Set the history: that of the record this one was made of, and the steps since; return this record."""
        self._history = (*before._history, *steps)
        self._left_out, self._read_as = before._left_out, before._read_as
        return self

    def _units_of(self, *groups: Collection[str]) -> dict[str, str]:
        """Return the units of the channels that a record made of this one has."""
        return {name: unit for name, unit in self._units.items() if any(name in group for group in groups)}

    def _stepped(
        self,
        step: str,
        columns: Columns,
        signals: Mapping[str, Signal],
        t: FloatArray | None = None,
        cubic: bool = False,
    ) -> Experiment:
        kind = self._interpolation
        if cubic:  # not for inputs that are held between samples, which have no finer values
            names = [*columns["input"], *columns["channel"]]
            held = {name: self.interpolation_of(name) for name in names if self._is_held(name)}
            kind = {name: held.get(name, "cubic") for name in names} if held else "cubic"
        # At new times a mesh follows these.
        return self._made(step, columns, interpolation=kind, signals=signals, t=t, mesh=t is None)

    def _sampled(self, signals: Mapping[str, Signal], mesh_times: FloatArray | None) -> Experiment:
        """Set the inputs that have samples of their own, and the times that a mesh follows; return this record."""
        self._signals = dict(signals)
        if mesh_times is not None:
            # A mesh spans the record.
            inner = mesh_times[(mesh_times > self._t[0]) & (mesh_times < self._t[-1])]
            self._mesh_times = np.concatenate([self._t[:1], inner, self._t[-1:]])
        return self

    def __setstate__(self, state: dict[str, Any]) -> None:
        # Pickling (multistart in other processes) forgets that the arrays are read-only.
        self.__dict__.update(state)
        for name, nothing in (("_history", ()), ("_read_as", {})):  # pickled by an older version
            self.__dict__.setdefault(name, nothing)
        for values in (self._t, *self._inputs.values(), *self._outputs.values(), *self._channels.values()):
            values.setflags(write=False)

    def _absent(self, kind: str, channel: str) -> str:
        return f"experiment '{self._name}' has no {kind} '{channel}'."

    def _names(self) -> list[str]:
        return list(dict.fromkeys([*self._inputs, *self._outputs, *self._channels]))

    def _resolve(self, name: str, group: Mapping[str, FloatArray], kind: str) -> FloatArray:
        for source in (group, self._channels):
            if name in source:
                return source[name]
        if name in self._names():
            other, side = ("input", "output") if kind == "output" else ("output", "input")
            raise DataError(
                f"{self._absent(kind, name)} It is there as an {other}: "
                f"give it among the {side}s too if the model uses it as {'a' if kind == 'condition' else 'an'} {kind}."
            )
        if name in self._left_out:
            raise DataError(f"{self._absent(kind, name)} The file has it, but it {self._left_out[name]}.")
        there = list(dict.fromkeys([*group, *self._channels]))
        unmeasured = ", and leave an output that was not measured out of the model" if kind == "output" else ""
        raise DataError(
            f"{self._absent(kind, name)}{listing(name, there)} Use .rename({{...}}) where names differ{unmeasured}."
        )


def as_experiments(data: Any, caller: str) -> list[Experiment]:
    """Return one experiment or several as a list; raise DataError, in the caller's name, for anything else or repeated
    names."""
    runs = [data] if isinstance(data, Experiment) else list(data) if isinstance(data, (list, tuple)) else None
    if runs is None or not all(isinstance(e, Experiment) for e in runs):
        first = data if runs is None else next(e for e in runs if not isinstance(e, Experiment))
        raise DataError(
            f"{caller}: data is an Experiment or a list of them, not {type(first).__name__}; make one with "
            "ph.read (of a file or a data frame) or ph.Experiment (of arrays)"
        )
    if not runs:
        raise DataError(f"{caller}: the list of experiments is empty")
    names = [e.name for e in runs]
    if len(set(names)) < len(names):
        twice = next(n for n in names if names.count(n) > 1)
        raise DataError(f"{caller}: two experiments are called '{twice}'; give each a name of its own")
    return runs


def completed(experiments: Sequence[Experiment], outputs: Sequence[str]) -> list[Experiment]:
    """Return experiments that have all outputs: an output that only others measure is missing throughout.

    An experiment without any output is unchanged: `Experiment.check_for` reports it.
    """
    there = [{*e.outputs, *e.channels} for e in experiments]
    anywhere = set().union(*there)
    found = []
    for e, own in zip(experiments, there, strict=True):
        absent = [n for n in outputs if n not in own and n in anywhere]
        if absent and not own.isdisjoint(outputs):
            e = copy.copy(e)
            e._outputs = {**e._outputs, **{n: np.full(e.n, np.nan) for n in absent}}
            e._unmeasured |= set(absent)
        found.append(e)
    return found
