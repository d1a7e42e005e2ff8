"""The data that an estimation gives: model, noise, parameters, covariance, records, status."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

import phugoid._core as _core

from .data.experiment import Experiment
from .data.interpolation import kinds_for
from .errors import ByName, DataError
from .modelling.densities import PerExperiment
from .modelling.model import Model
from .modelling.noise import Noise
from .parameters import Estimates
from .passes import Refinement, Smoothing
from .records import Record
from .solvers import Iteration, Solution
from .transcription.filter_error import FilterError
from .transcription.shooting import Transcription

__all__ = ["FitResult", "dataset"]

_Array = NDArray[np.float64]
_T = TypeVar("_T")


@dataclass(frozen=True, eq=False, repr=False)
class FitResult:
    """The data of a fit, which all functions that take a fit need; `Fit` adds these functions as methods.

    parameters      by name, what was estimated of the noise (``sigma_<output>``, and more) among them.
    initial_states  experiment -> state -> estimate of the state at the first sample.
    log_likelihood  of the measurements (Eq. ellz_defn), without the constant -N n_y/2 ln 2 pi, whatever the noise.
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
    # With delays: the fit of the model without delays to data shifted by them. Where kinks were smoothed:
    # that of the smooth model.
    _moved: FitResult | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "initial_states", ByName("experiment", self.initial_states))

    @property
    def converged(self) -> bool:
        """Return whether the solver met its tolerances."""
        return self.status == "converged"

    @property
    def feasible(self) -> bool:
        """Tell whether the states satisfy the equations of the model. Where a run ended elsewhere, log-likelihood,
        standard errors and how well outputs match are NaN."""
        return all(record.feasible for record in self.records)

    def _only(self, what: str) -> Record:
        if len(self.records) > 1:
            names = ", ".join(f"'{r.name}'" for r in self.records)
            raise DataError(f"the fit has {len(self.records)} experiments ({names}): use fit.records[i].{what}")
        return self.records[0]

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

    def _runs(self) -> Sequence[Experiment]:
        """Return the experiments, of a file that has none as its records are."""
        if self.experiments:
            return self.experiments
        return [
            Experiment(r.t, r.inputs, r.measured, r.name, r.interpolation)._sampled(
                {name: (t, u, 0.0, 0) for name, (t, u) in r.input_samples.items()}, None
            )
            for r in self.records
        ]

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
            f"{len(self.parameters)} parameters>"
        )


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
