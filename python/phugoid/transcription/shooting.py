"""Shooting: the states result from integration; there are no equations for them in the program."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, TypeAlias

from numpy.typing import ArrayLike

import phugoid._core as _core

from ..data.experiment import Experiment
from ..errors import OptionError, positive, whole
from ..modelling.model import Model
from .collocation import Collocation, GridSpec, checked_segments, division, limit, records_of

__all__ = ["MultipleShooting", "SingleShooting", "Transcription", "from_dict", "step_spec", "to_dict"]

_INTEGRATORS = ("euler", "heun", "kutta", "rk4", "dopri5")


@dataclass(frozen=True)
class SingleShooting:
    """Simulation from the first sample to the last (Eq. oem_ivp of the paper): unknowns are parameters and the
    initial states alone.

    The classical method, and a fragile one: where a simulation with poor parameters diverges, there is no likelihood
    to improve. Collocation and multiple shooting do not have this problem.

    ``integrator``: a Runge-Kutta method of fixed steps, "euler", "heun", "kutta", "rk4" or "dopri5", of orders 1 to 5.
    A step leads from sample to sample; ``substeps`` divides it. Instead, ``step`` (s) is the greatest length of a step,
    or ``steps`` their number in a segment, whatever the sample times; states at samples within a step come from the
    cubic through its ends with the slopes there. Inputs bend at samples, so steps across them lose accuracy. In a
    record with inputs that are held between samples, steps also end where these jump and at the samples.
    ``threads`` 0 is one a core.
    """

    integrator: str = "rk4"
    substeps: int = 1
    step: float | None = None
    steps: int | None = None
    threads: int = 0

    def __post_init__(self) -> None:
        _check(self)

    def grids(self, experiments: Sequence[Experiment]) -> list[GridSpec]:
        """Return the division into segments as the core takes it."""
        return [("uniform", 1, None)]

    def problem(self, model: Model, experiments: Sequence[Experiment], noise: _core.Noise) -> _core.Shooting:
        """Return the nonlinear program."""
        return _problem(self, model, experiments, noise)

    def __str__(self) -> str:
        return f"single shooting, {_steps_in_words(self)}"


@dataclass(frozen=True)
class MultipleShooting:
    """Simulation segment by segment (Eq. oem_ms of the paper): the states where segments start are unknowns too, and
    each segment ends where the next one starts.

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
        _check(self)
        if self.segments is None:
            raise OptionError("MultipleShooting: segments is a number, or the times of segment ends, not None")
        object.__setattr__(self, "segments", checked_segments("MultipleShooting", self.segments))

    def grids(self, experiments: Sequence[Experiment]) -> list[GridSpec]:
        """Return the division into segments as the core takes it: one for all, or one for each experiment.

        Raises OptionError for segment ends that do not fit the experiments.
        """
        return division("MultipleShooting", self.segments, experiments)

    def problem(self, model: Model, experiments: Sequence[Experiment], noise: _core.Noise) -> _core.Shooting:
        """Return the nonlinear program."""
        return _problem(self, model, experiments, noise)

    def __str__(self) -> str:
        grid = f"{self.segments} equal segments" if isinstance(self.segments, int) else "given segments"
        return f"multiple shooting, {grid}, {_steps_in_words(self)}"


Transcription: TypeAlias = Collocation | MultipleShooting | SingleShooting
_Shooting: TypeAlias = MultipleShooting | SingleShooting


def _check(options: _Shooting) -> None:
    what = type(options).__name__
    if options.integrator not in _INTEGRATORS:
        raise OptionError(f"{what}: integrator is one of {', '.join(_INTEGRATORS)}, not {options.integrator!r}")
    for name in ("substeps", "threads", "steps"):
        value, least = getattr(options, name), 0 if name == "threads" else 1
        if name == "steps" and value is None:
            continue
        object.__setattr__(options, name, whole(f"{what}: {name}", value, least))
        limit(what, name, value)
    step = options.step
    if step is not None:
        object.__setattr__(options, "step", positive(f"{what}: step", step, "seconds"))
    if (options.substeps != 1) + (step is not None) + (options.steps is not None) > 1:
        raise OptionError(f"{what}: substeps, step and steps are three ways to say the same; give one")


def _problem(
    options: _Shooting,
    model: Model,
    experiments: Sequence[Experiment],
    noise: _core.Noise,
) -> _core.Shooting:
    records = records_of(model, experiments)
    grids = options.grids(experiments)
    return _core.Shooting(model._core, records, noise, grids, options.integrator, step_spec(options), options.threads)


def step_spec(options: _Shooting) -> tuple[str, float]:
    """Return the steps as the core takes them."""
    if options.steps is not None:
        return "number", options.steps
    return ("samples", options.substeps) if options.step is None else ("length", options.step)


def _steps_in_words(options: _Shooting) -> str:
    if options.steps is not None:
        return f"{options.steps} steps of {options.integrator} in a segment"
    if options.step is not None:
        return f"steps of {options.integrator} of {options.step:g} s at most"
    if options.substeps == 1:
        return f"one step of {options.integrator} between samples"
    return f"{options.substeps} steps of {options.integrator} between samples"


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
