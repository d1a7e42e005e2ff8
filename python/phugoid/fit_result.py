"""The data that an estimation gives: model, noise, parameters, covariance, records, status; and its passes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

import phugoid._core as _core

from .data.experiment import Experiment
from .data.filtering import kinds_for
from .errors import ByName, DataError, counted
from .filter_error import FilterError
from .modelling.densities import PerExperiment
from .modelling.model import Model
from .modelling.noise import Noise
from .notebook import Rows, overview
from .parameters import Estimates, text_table
from .records import Record, only
from .solvers import History, Iteration, Solution
from .transcription import Transcription

__all__ = ["ENDED_WELL", "FitResult", "Refinement", "Smoothing", "SmoothingStep", "Step", "dataset"]


ENDED_WELL = ("converged", "acceptable")
"""Statuses of fits at an optimum."""

_Array = NDArray[np.float64]
_T = TypeVar("_T")
_F = TypeVar("_F", bound="FitResult")


@dataclass(frozen=True, eq=False, repr=False)
class FitResult:
    """The data of a fit, which all functions that take a fit need; `Fit` adds these functions as methods.

    parameters      by name, what was estimated of the noise (``sigma_<output>``, and more) among them.
    initial_states  experiment -> state -> estimate of the state at the first sample.
    log_likelihood  of the measurements, without the constant -N n_y/2 ln 2 pi, whatever the noise.
    integrated_log_likelihood
                    the same of the model integrated with the estimates, independent of the mesh: of an estimation by
                    `Collocation` that a limit ended, and where samples are few and parameters determine the initial
                    states.
                    NaN where the model cannot be integrated; None for other fits, among them those of models with
                    delays and those ended by Ctrl-C. The message says where it differs from ``log_likelihood``.
    records         one an experiment: measured, outputs, residuals, states.
    status          "converged", or what else happened; ``message`` says what to do.
    warnings        in words.
    covariance      (n, n) of the parameters in their order; NaN where there is none.
    refinement      what ``Collocation(refine=True)`` did.
    smoothing       how kinks of the state equations were smoothed, where they had to be; None otherwise.
    experiments     the data it was fitted to; empty for a fit of a file of version 1, which had none.
    """

    model: Model
    noise: Noise
    transcription: Transcription | FilterError
    parameters: Estimates
    initial_states: Mapping[str, Estimates]
    covariance: _Array
    log_likelihood: float
    records: Sequence[Record]
    status: str
    message: str
    iterations: int
    time: float
    warnings: tuple[str, ...] = ()
    history: Sequence[Iteration] = ()
    solution: Solution | None = field(default=None)
    refinement: Refinement | None = None
    smoothing: Smoothing | None = None
    experiments: Sequence[Experiment] = ()
    integrated_log_likelihood: float | None = None
    # With delays: the fit of the model without delays to data shifted by them. Where kinks were smoothed:
    # that of the smooth model.
    _moved: FitResult | None = field(default=None, repr=False)

    @classmethod
    def _of(cls: type[_F], result: FitResult) -> _F:
        """Return a fit of this class with the data of a result; one that is of it as it is."""
        if isinstance(result, cls):
            return result
        return cls(**{f.name: getattr(result, f.name) for f in fields(result)})

    def __post_init__(self) -> None:
        object.__setattr__(self, "initial_states", ByName("experiment", self.initial_states))
        object.__setattr__(self, "history", History(self.history))

    @property
    def converged(self) -> bool:
        """Return whether the solver met its tolerances."""
        return self.status == "converged"

    @property
    def ranked_log_likelihood(self) -> float:
        """The log-likelihood by which fits of one problem compare: of the integrated model where it is known."""
        integrated = self.integrated_log_likelihood
        return float(self.log_likelihood if integrated is None else integrated)

    @property
    def feasible(self) -> bool:
        """Return whether the states satisfy the equations of the model. Where a run ended elsewhere, log-likelihood,
        standard errors and how well outputs match are NaN."""
        return all(record.feasible for record in self.records)

    def _only(self, what: str) -> Record:
        return only(self.records, "fit", what)

    @property
    def states(self) -> Mapping[str, _Array]:
        """State -> (N,) at the samples, of the only experiment."""
        return self._only("states").states

    @property
    def outputs(self) -> Mapping[str, _Array]:
        """Output -> (N,) of the model, of the only experiment."""
        return self._only("outputs").outputs

    @property
    def residuals(self) -> Mapping[str, _Array]:
        """Output -> (N,) measured minus model, NaN where missing, of the only experiment."""
        return self._only("residuals").residuals

    @property
    def _intensities(self) -> set[str]:
        t = self.transcription
        return {f"q_{name}" for name in t.states} if isinstance(t, FilterError) else set()

    @property
    def noise_parameters(self) -> set[str]:
        """Names of the parameters that are those of the noise, not of the model."""
        names = {*self.noise.names(self.model.output_names), *(f"sigma_{n}" for n in self.model.output_names)}
        # Also of a single experiment, as in sigma_q[run 1].
        return {n for n in self.parameters if n.partition("[")[0] in names} | self._intensities

    def _solution_of(self, problem: _core.Problem) -> Solution:
        """Return the solution, after a check that it fits a problem made again from the model and the data.

        Raises DataError where it is not, as in a file whose parts belong to different fits.
        """
        s = self.solution
        if s is None or (s.xi.size, s.multipliers.size) != (problem.n, problem.m):
            raise DataError(
                f"fit of '{self.model.name}': its solution is not one of its model and data ({problem.n} unknowns and "
                f"{problem.m} equations); estimate it again with start=fit"
            )
        return s

    def as_start(self, noise: Noise | None = None) -> dict[str, float]:
        """Return the parameters as start values of another estimation: of the noise those that ``noise`` has,
        or all."""
        outputs = self.model.output_names
        gone = set() if noise is None else {*self.noise.names(outputs)}.difference(noise.names(outputs))
        gone |= {f"sigma_{name}" for name in self.noise.known_sigmas(outputs)} | self._intensities
        if isinstance(self.noise, PerExperiment):  # starts are for all experiments
            gone |= {name for name in self.parameters if name.partition("[")[0] in self.noise.names(outputs)}
        return {name: e.value for name, e in self.parameters.items() if name not in gone}

    def _own(self, experiment: str) -> dict[str, float]:
        """Return the values of the model's parameters in one experiment."""
        labels = {name: f"{name}[{experiment}]" for name in self.model.parameter_names}
        return {n: self.parameters[label if label in self.parameters else n].value for n, label in labels.items()}

    def _once(self, name: str, compute: Callable[[], _T]) -> _T:
        """Return the result of ``compute``, which is stored with the fit under a name at the first call."""
        known = vars(self)
        if name not in known:
            known[name] = compute()
        found: _T = known[name]
        return found

    def __repr__(self) -> str:
        return (
            f"<Fit of '{self.model.name}': {self.status}, log-likelihood {self.log_likelihood:.6g}, "
            f"{counted(len(self.parameters), 'parameter')}>"
        )


def mean_square(fit: FitResult, name: str) -> float:
    """Return the mean square of an output's residuals over all records; NaN where there are none."""
    residuals = np.concatenate([r.residuals[name] for r in fit.records])
    residuals = residuals[np.isfinite(residuals)]
    return float(np.mean(residuals**2)) if residuals.size else math.nan


def dataset(fit: FitResult) -> Sequence[Experiment]:
    """Return the data of a fit; for a fit from a file, what its records hold."""
    if fit.experiments:
        return fit.experiments
    return [
        Experiment(r.t, dict(r.inputs), dict(r.measured), r.name, kinds_for(r.interpolation, r.inputs))._sampled(
            {name: (*own, 0.0, 0) for name, own in r.input_samples.items()}, None
        )
        for r in fit.records
    ]


@dataclass(frozen=True)
class Step:
    """One pass: the transcription, and how exact it was.

    order           points of a segment.
    segments        their number in all experiments.
    largest         largest integration error of a segment, in units of `IntegrationError.scales`.
    coarse          number of segments above the tolerance.
    iterations      of the solver.
    log_likelihood  at the end.
    """

    order: int
    segments: int
    largest: float
    coarse: int
    iterations: int
    log_likelihood: float


@dataclass(frozen=True)
class Refinement:
    """The passes of a refined estimation, the first as asked for, the last the one that the fit holds.

    tolerance  of the integration error of a segment, in units of the noise.
    steps      the passes.
    changes    parameter -> (first estimate, last estimate, standard error of the last).
    """

    tolerance: float
    steps: Sequence[Step]
    changes: Mapping[str, tuple[float, float, float]]

    @staticmethod
    def of(first: Mapping[str, float], last: Estimates, steps: Sequence[Step], tolerance: float) -> Refinement:
        """Return the refinement made of the values in the first pass and the estimates of the last."""
        changes = {
            name: (first[name], e.value, e.std_error) for name, e in last.items() if name in first and not e.fixed
        }
        return Refinement(tolerance, tuple(steps), changes)

    @property
    def met(self) -> bool:
        """Return whether the tolerance was met in the end."""
        return self.steps[-1].coarse == 0

    def change(self, name: str) -> tuple[float, float]:
        """Return the change of a parameter by refinement: in % of its value, and in standard errors; NaN where
        undefined."""
        first, last, error = self.changes[name]
        return (
            100.0 * (last - first) / abs(last) if last else math.nan,
            (last - first) / error if error > 0 else math.nan,
        )

    def summary(self) -> str:
        """Return passes and changes as plain-text tables."""
        return "\n\n".join([self._outcome(), *(text_table(*rows) for rows in self._tables())])

    def _repr_html_(self) -> str:
        return overview(self._outcome(), *self._tables())

    def _outcome(self) -> str:
        outcome = "met" if self.met else "not met"
        return f"mesh refinement: tolerance {self.tolerance:g} of the noise {outcome}"

    def _tables(self) -> list[Rows]:
        """Return heads, rows and alignment: of the passes, and of the changes where there was more than one."""
        rows = [
            [
                str(s.order),
                str(s.segments),
                f"{s.largest:.1e}",
                str(s.coarse),
                str(s.iterations),
                f"{s.log_likelihood:.3f}",
            ]
            for s in self.steps
        ]
        heads = ["order", "segments", "largest error", "too coarse", "iterations", "log-likelihood"]
        tables: list[Rows] = [(heads, rows, "rrrrrr")]
        if len(self.steps) > 1:
            moved = [
                [name, f"{first:.6g}", f"{last:.6g}", *(_signed(c) for c in self.change(name))]
                for name, (first, last, _) in self.changes.items()
            ]
            tables.append((["parameter", "first mesh", "last mesh", "change, %", "in std errors"], moved, "srrrr"))
        return tables

    def to_dict(self) -> dict[str, Any]:
        """Return the refinement as JSON takes it."""
        changes = {name: list(c) for name, c in self.changes.items()}
        return {"tolerance": self.tolerance, "steps": [vars(s) for s in self.steps], "changes": changes}

    @staticmethod
    def from_dict(saved: Mapping[str, Any]) -> Refinement:
        """Read the result of `to_dict`."""
        changes = {
            name: (float(a), float(b), math.nan if e is None else float(e))
            for name, (a, b, e) in saved["changes"].items()
        }
        return Refinement(saved["tolerance"], tuple(Step(**s) for s in saved["steps"]), changes)


def _signed(value: float) -> str:
    return f"{value:+.3f}" if math.isfinite(value) else ""


@dataclass(frozen=True)
class SmoothingStep:
    """One pass.

    part            width of each kink as a part of the standard deviation of its argument over the path.
    segments        of the mesh, in all experiments.
    iterations      of the solver.
    log_likelihood  at the end.
    """

    part: float
    segments: int
    iterations: int
    log_likelihood: float


@dataclass(frozen=True)
class Smoothing:
    """Hold how kinks and jumps of the state equations were smoothed, in passes with narrower and narrower widths.

    widths  "sign(v) in v'" -> (the width in the last pass, its unit, "" where that is not known).
    steps   the passes, the last the one that the fit holds.
    left    parameter -> (change with widths of zero, standard error). The change is extrapolated from the last two
            passes, in proportion to the width; NaN after a single pass.
    """

    widths: Mapping[str, tuple[float, str]]
    steps: Sequence[SmoothingStep]
    left: Mapping[str, tuple[float, float]]

    def beyond(self, errors: float) -> dict[str, float]:
        """Return the parameters whose remaining error exceeds ``errors`` standard errors, and its size in these."""
        parts = {name: left / error for name, (left, error) in self.left.items() if error > 0}
        return {name: part for name, part in parts.items() if not abs(part) <= errors}

    @property
    def description(self) -> str:
        """The widths in words."""
        return ", ".join(f"{kink} over {width:.2g} {unit}".rstrip() for kink, (width, unit) in self.widths.items())

    def summary(self) -> str:
        """Return passes and the remaining error as plain-text tables."""
        return "\n\n".join([f"kinks smoothed: {self.description}", *(text_table(*rows) for rows in self._tables())])

    def _repr_html_(self) -> str:
        return overview(f"kinks smoothed: {self.description}", *self._tables())

    def _tables(self) -> tuple[Rows, Rows]:
        """Return heads, rows and alignment of both tables."""
        rows = [[f"{s.part:.1e}", str(s.segments), str(s.iterations), f"{s.log_likelihood:.3f}"] for s in self.steps]
        left = [
            [name, f"{change:+.2g}" if math.isfinite(change) else "", _part(change, error)]
            for name, (change, error) in self.left.items()
        ]
        passes = ["width/spread", "segments", "iterations", "log-likelihood"]
        return (passes, rows, "rrrr"), (["parameter", "left by smoothing", "in std errors"], left, "srr")

    def to_dict(self) -> dict[str, Any]:
        """Return the smoothing as JSON takes it."""
        widths = {kink: list(width) for kink, width in self.widths.items()}
        left = {name: list(pair) for name, pair in self.left.items()}
        return {"widths": widths, "steps": [vars(s) for s in self.steps], "left": left}

    @staticmethod
    def from_dict(saved: Mapping[str, Any]) -> Smoothing:
        """Read the result of `to_dict`."""

        def number(value: Any) -> float:
            return math.nan if value is None else float(value)

        return Smoothing(
            {str(kink): (float(width), str(unit)) for kink, (width, unit) in saved["widths"].items()},
            tuple(SmoothingStep(**s) for s in saved["steps"]),
            {str(name): (number(left), number(error)) for name, (left, error) in saved["left"].items()},
        )


def _part(change: float, error: float) -> str:
    return f"{change / error:+.2f}" if error > 0 and math.isfinite(change) else ""
