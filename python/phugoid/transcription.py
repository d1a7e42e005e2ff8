"""Transcriptions: an estimation problem as a nonlinear program, by collocation or by shooting."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

import phugoid._core as _core

from .data.experiment import Experiment, FloatArray
from .errors import OptionError, is_whole, part, positive, whole
from .modelling.model import Model

__all__ = [
    "Collocation",
    "MultipleShooting",
    "SingleShooting",
    "Transcription",
    "from_dict",
    "to_dict",
]


GridSpec = tuple[str, int, "list[float] | None"]
# As in the core: most segments or steps of a record, most threads of a problem.
_MOST_SEGMENTS, _MOST_THREADS = 10_000_000, 1024
_Array = NDArray[np.float64]
Signal = tuple[_Array, _Array, float, int]
Record = tuple[str, _Array, list[_Array], list[_Array], list[str], list[Signal | None]]


@dataclass(frozen=True)
class Collocation:
    """Legendre-Gauss-Lobatto collocation (Dutra, AIAA Aviation 2019).

    ``order`` is the number of points of a segment, ends included: 2 is the trapezoid, m integrates to order
    2m - 2. By default every interval between samples is a segment; ``substeps`` divides each further;
    ``segments`` gives a number of equal segments, or the times of their ends (s), instead, which need not be
    sample times (a list of such for several experiments). Where an input that is held between its samples jumps, a
    segment ends in any case. ``threads`` 0 is one a core.

    ``refine``: estimate the integration error of each segment, split the segments where it is above ``tolerance`` (in
    units of the noise of the state's measurement; see `IntegrationError`), or raise the order where it is above in
    most, and estimate again, until it is below everywhere. ``Fit.refinement`` reports the passes and the changes of the
    estimates.
    """

    order: int = 4
    substeps: int = 1
    segments: int | ArrayLike | Sequence[ArrayLike] | None = None
    threads: int = 0
    refine: bool = False
    tolerance: float = 1e-4

    def __post_init__(self) -> None:
        if not is_whole(self.order) or not 2 <= self.order <= 64:
            raise OptionError(f"Collocation: order is a whole number from 2 (trapezoid) to 64, not {self.order!r}")
        whole("Collocation: substeps", self.substeps, 1)
        limit("Collocation", "substeps", self.substeps)
        if self.segments is not None and self.substeps != 1:
            raise OptionError("Collocation: substeps divides sample intervals and segments replaces them; give one")
        whole("Collocation: threads", self.threads, 0)
        limit("Collocation", "threads", self.threads)
        if not isinstance(self.refine, bool):
            raise OptionError(f"Collocation: refine is True or False, not {self.refine!r}")
        part("Collocation: tolerance", self.tolerance)
        for name in ("order", "substeps", "threads"):
            object.__setattr__(self, name, int(getattr(self, name)))
        object.__setattr__(self, "segments", checked_segments("Collocation", self.segments))

    def grids(self, experiments: Sequence[Experiment]) -> list[GridSpec]:
        """Return the division into segments as the core takes it: one for all, or one for each experiment.

        Raises OptionError for segment ends that do not fit the experiments.
        """
        if self.segments is None:
            if all(e.mesh_times is None for e in experiments):
                return [("samples", self.substeps, None)]
            return [
                ("edges", 0, _divided(e.t if e.mesh_times is None else e.mesh_times, self.substeps))
                for e in experiments
            ]
        return division("Collocation", self.segments, experiments)

    def problem(self, model: Model, experiments: Sequence[Experiment], noise: _core.Noise) -> _core.Collocation:
        """Return the nonlinear program."""
        records = records_of(model, experiments)
        return _core.Collocation(model._core, records, noise, self.order, self.grids(experiments), self.threads)

    def __str__(self) -> str:
        if self.segments is None:
            grid = "one segment" if self.substeps == 1 else f"{self.substeps} segments"
            grid += " between samples"
        elif isinstance(self.segments, int):
            grid = f"{self.segments} equal segments"
        else:
            grid = "given segments"
        return f"collocation of order {self.order}, {grid}"


def _divided(times: FloatArray, parts: int) -> list[float]:
    """Return times with every interval divided into ``parts``."""
    share = np.arange(parts * (times.size - 1) + 1) / parts
    return [float(t) for t in np.interp(share, np.arange(times.size), times)]


def limit(what: str, name: str, value: int) -> None:
    """Raise OptionError for a number of segments, steps or threads that no machine can serve."""
    most = _MOST_THREADS if name == "threads" else _MOST_SEGMENTS
    if value > most:
        raise OptionError(f"{what}: {name} is at most {most}, not {float(min(value, 10**300)):g}")


def records_of(model: Model, experiments: Sequence[Experiment]) -> list[Record]:
    """Return experiments as the core takes them."""
    return [
        (
            e.name,
            np.ascontiguousarray(e.t),
            [np.ascontiguousarray(e.input(n)) for n in model.input_names],
            [np.ascontiguousarray(e.output(n)) for n in model.output_names],
            [e.interpolation_of(n) for n in model.input_names],
            [e.signal(n) for n in model.input_names],
        )
        for e in experiments
    ]


def division(what: str, segments: Any, experiments: Sequence[Experiment]) -> list[GridSpec]:
    """Return checked segments as the core takes them: one division for all, or one for each experiment.

    Raises OptionError for segment ends that do not fit the experiments.
    """
    if isinstance(segments, int):
        return [("uniform", segments, None)]
    lists: Any = segments if isinstance(segments[0], tuple) else (segments,)
    if len(lists) != len(experiments):
        raise OptionError(
            f"{what}: segments holds {len(lists)} list(s) of segment ends for {len(experiments)} "
            "experiment(s): give each its own"
        )
    for edges, experiment in zip(lists, experiments, strict=True):
        first, last = experiment.t[[0, -1]]
        if not np.allclose([edges[0], edges[-1]], [first, last], rtol=0, atol=1e-9 * (last - first)):
            raise OptionError(
                f"{what}: the segments run from {edges[0]:g} to {edges[-1]:g}, but experiment "
                f"'{experiment.name}' from {first:g} to {last:g}: they must start and end alike"
            )
    return [("edges", 0, list(edges)) for edges in lists]


def checked_segments(what: str, segments: Any) -> Any:
    """Return None, a number, the segment ends of one experiment, or a tuple of such, as plain data, so that options
    compare."""
    if segments is None:
        return None
    if is_whole(segments):
        if segments < 1:
            raise OptionError(f"{what}: at least 1 segment is needed, not {segments}")
        limit(what, "segments", segments)
        return int(segments)
    wrong = OptionError(f"{what}: segments is a whole number or the times of segment ends, not {segments!r}")
    if isinstance(segments, str) or not np.iterable(segments):
        raise wrong
    parts = list(segments)
    if parts and all(np.ndim(part) == 1 for part in parts):
        return tuple(_checked_ends(what, part, wrong) for part in parts)
    return _checked_ends(what, parts, wrong)


def _checked_ends(what: str, ends: Any, wrong: OptionError) -> tuple[float, ...]:
    try:
        array = np.array(ends, dtype=np.float64)
    except (TypeError, ValueError):
        raise wrong from None
    if array.ndim != 1 or array.size < 2 or not np.isfinite(array).all():
        raise wrong
    if not np.all(np.diff(array) > 0):
        i = int(np.flatnonzero(np.diff(array) <= 0)[0]) + 1
        raise OptionError(f"{what}: segment ends increase, but number {i} ({array[i]:g}) does not come after the last")
    return tuple(array.tolist())


_INTEGRATORS = ("euler", "heun", "kutta", "rk4", "dopri5")


class _Shooting:
    """The options of shooting that say how a segment is integrated, and the nonlinear program."""

    integrator: str
    substeps: int
    step: float | None
    steps: int | None
    threads: int

    def __post_init__(self) -> None:
        what = type(self).__name__
        if self.integrator not in _INTEGRATORS:
            raise OptionError(f"{what}: integrator is one of {', '.join(_INTEGRATORS)}, not {self.integrator!r}")
        for name in ("substeps", "threads", "steps"):
            value, least = getattr(self, name), 0 if name == "threads" else 1
            if name == "steps" and value is None:
                continue
            object.__setattr__(self, name, whole(f"{what}: {name}", value, least))
            limit(what, name, value)
        if self.step is not None:
            object.__setattr__(self, "step", positive(f"{what}: step", self.step))
        if (self.substeps != 1) + (self.step is not None) + (self.steps is not None) > 1:
            raise OptionError(f"{what}: substeps, step and steps are three ways to say the same; give one")

    @abstractmethod
    def grids(self, experiments: Sequence[Experiment]) -> list[GridSpec]:
        """Return the division into segments as the core takes it: one for all, or one for each experiment.

        Raises OptionError for segment ends that do not fit the experiments.
        """

    def problem(self, model: Model, experiments: Sequence[Experiment], noise: _core.Noise) -> _core.Shooting:
        """Return the nonlinear program."""
        records, grids = records_of(model, experiments), self.grids(experiments)
        return _core.Shooting(model._core, records, noise, grids, self.integrator, self.step_spec, self.threads)

    @property
    def step_spec(self) -> tuple[str, float]:
        """The steps as the core takes them."""
        if self.steps is not None:
            return "number", self.steps
        return ("samples", self.substeps) if self.step is None else ("length", self.step)

    def _steps_in_words(self) -> str:
        if self.steps is not None:
            return f"{self.steps} steps of {self.integrator} in a segment"
        if self.step is not None:
            return f"steps of {self.integrator} of {self.step:g} at most"
        if self.substeps == 1:
            return f"one step of {self.integrator} between samples"
        return f"{self.substeps} steps of {self.integrator} between samples"


@dataclass(frozen=True)
class SingleShooting(_Shooting):
    """Simulation from the first sample to the last (single shooting; Dutra 2019): unknowns are parameters and the
    initial states alone.

    The classical method, and a fragile one: where a simulation with poor parameters diverges, there is no likelihood
    to improve. Collocation and multiple shooting do not have this problem.

    ``integrator``: a Runge-Kutta method of fixed steps, "euler", "heun", "kutta", "rk4" or "dopri5", of orders 1 to 5.
    A step leads from sample to sample; ``substeps`` divides it. Instead, ``step`` (s) is the greatest length of a step,
    or ``steps`` their number in a segment, whatever the sample times; states at samples within a step come from the
    cubic through its ends with the slopes there. Inputs have corners at samples, so steps across them lose accuracy. In
    a record with inputs that are held between samples, steps also end where these jump and at the samples.
    ``threads`` 0 is one a core.
    """

    integrator: str = "rk4"
    substeps: int = 1
    step: float | None = None
    steps: int | None = None
    threads: int = 0

    def grids(self, experiments: Sequence[Experiment]) -> list[GridSpec]:
        """Return the division into segments as the core takes it."""
        return [("uniform", 1, None)]

    def __str__(self) -> str:
        return f"single shooting, {self._steps_in_words()}"


@dataclass(frozen=True)
class MultipleShooting(_Shooting):
    """Simulation segment by segment (multiple shooting; Dutra 2019).

    The states where segments start are unknowns too, and each segment ends where the next one starts.

    ``segments``: a number of equal segments, or the times of their ends (s), which need not be sample times (a list of
    such for several experiments). The other options are those of `SingleShooting`.
    """

    segments: int | ArrayLike | Sequence[ArrayLike] = 20
    integrator: str = "rk4"
    substeps: int = 1
    step: float | None = None
    steps: int | None = None
    threads: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.segments is None:
            raise OptionError("MultipleShooting: segments is a number, or the times of segment ends, not None")
        object.__setattr__(self, "segments", checked_segments("MultipleShooting", self.segments))

    def grids(self, experiments: Sequence[Experiment]) -> list[GridSpec]:
        """Return the division into segments as the core takes it; raise OptionError for ends that do not fit."""
        return division("MultipleShooting", self.segments, experiments)

    def __str__(self) -> str:
        grid = f"{self.segments} equal segments" if isinstance(self.segments, int) else "given segments"
        return f"multiple shooting, {grid}, {self._steps_in_words()}"


Transcription: TypeAlias = Collocation | MultipleShooting | SingleShooting


def to_dict(transcription: Transcription) -> dict[str, Any]:
    """Return kind and options, without threads, as plain data."""

    def plain(value: Any) -> Any:
        return [plain(v) for v in value] if isinstance(value, tuple) else value

    options = {f.name: plain(getattr(transcription, f.name)) for f in fields(transcription) if f.name != "threads"}
    return {"kind": type(transcription).__name__, **options}


def from_dict(saved: Mapping[str, Any]) -> Transcription:
    """Read the result of `to_dict`; without a kind it is a `Collocation`. Raises KeyError or TypeError for anything
    else."""
    kinds: dict[str, type[Transcription]] = {c.__name__: c for c in (Collocation, MultipleShooting, SingleShooting)}
    options = dict(saved)
    kind = kinds[options.pop("kind", "Collocation")]
    return kind(**options)
