"""The estimate from a fleet, and what it says of each record."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import ByName, OptionError, counted
from ..fit_result import ENDED_WELL
from ..modelling.model import Model
from ..modelling.noise import Noise
from ..parameters import Estimate, Estimates, text_table
from ..solvers import Iteration
from ..transcription import Collocation
from .population import Population

__all__ = ["FleetFit", "FlightResult", "Unlike"]

# Of a normal distribution the median absolute deviation is this part of the standard deviation.
_MAD = 0.6745
# With fewer records nothing can be said of what is usual among them.
_FEWEST = 8


@dataclass(frozen=True)
class FlightResult:
    """What the estimate from a fleet says of one record.

    parameters      those that each record has of its own. Their standard errors take the shared parameters as known.
    initial_states  state -> value at the first sample.
    rms             output -> root mean square of the residuals, in the output's unit; NaN where it is not measured.
    correlation     output -> correlation of successive residuals, lag 1.
    log_likelihood  without the constant -N n_y/2 ln 2 pi.
    """

    name: str
    samples: int
    log_likelihood: float
    parameters: Estimates
    initial_states: Mapping[str, float]
    rms: Mapping[str, float]
    correlation: Mapping[str, float]

    @staticmethod
    def of(found: Mapping[str, Any], model: Model, own: Sequence[str]) -> FlightResult:
        """Return the result made of what a worker gives."""
        declared = model.declared_parameters
        estimates = [
            Estimate(name, value, error, declared[name].unit, declared[name].start, declared[name].bounds)
            for name, value, error in zip(own, found["own"], found["own_errors"], strict=True)
        ]

        def by(names: Sequence[str], values: Sequence[float]) -> Mapping[str, float]:
            return ByName("name", dict(zip(names, map(float, values), strict=True)))

        return FlightResult(
            found["name"],
            int(found["samples"]),
            float(found["log_likelihood"]),
            Estimates(estimates),
            by(model.state_names, found["initial"]),
            by(model.output_names, found["rms"]),
            by(model.output_names, found["correlation"]),
        )


@dataclass(frozen=True)
class Unlike:
    """A record that differs from the others, in one respect.

    what      "residual of q", or the name of a parameter of each record's own.
    value     of the record: root mean square of the residual, or the estimate.
    typical   median of all records.
    distance  from it, in robust standard deviations (median absolute deviation); for a residual in logarithms.
    """

    name: str
    what: str
    value: float
    typical: float
    distance: float


@dataclass(frozen=True, eq=False, repr=False)
class FleetFit:
    """The estimate of the parameters that the records of a fleet share.

    parameters      by name, what was estimated of the noise (``sigma_<output>``, and more) among them.
    covariance      (n, n) of the parameters in their order; NaN where there is none.
    log_likelihood  of all measurements, without the constant -N n_y/2 ln 2 pi.
    flights         name of the record -> `FlightResult`; empty where the work was ended early.
    populations     name of a parameter of each record's own -> the distribution that it is drawn from, where asked for.
    left_out        name of a record that was left out -> why.
    status          "converged", or what else happened; ``message`` says what to do.
    iterations      of the driver. ``evaluations`` counts trials, ``factorizations`` those of all records.
    samples         of all records in the estimate.
    time            seconds.
    """

    model: Model
    noise: Noise
    transcription: Collocation
    parameters: Estimates
    covariance: NDArray[np.float64]
    log_likelihood: float
    flights: Mapping[str, FlightResult]
    left_out: Mapping[str, str]
    populations: Mapping[str, Population]
    status: str
    message: str
    iterations: int
    evaluations: int
    factorizations: int
    samples: int
    time: float
    warnings: tuple[str, ...] = ()
    history: Sequence[Iteration] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "flights", ByName("record", dict(self.flights)))

    @property
    def converged(self) -> bool:
        """Return whether the tolerance was met."""
        return self.status == "converged"

    def start(self) -> dict[str, float]:
        """Return the shared parameters as start values of another estimation."""
        return {name: e.value for name, e in self.parameters.items() if not e.fixed}

    def model_of(self, flight: str) -> Model:
        """Return the model with the shared parameters fixed at their estimates, to look at one record by
        ``ph.estimate(fleet.model_of("flight 17"), record)``; its own parameters start where they were estimated."""
        result = self.flights[flight]
        declared = self.model.declared_parameters
        changes: dict[str, Any] = {}
        for name, p in declared.items():
            if p.per_experiment:
                changes[name] = result.parameters[name].value
            else:
                changes[name] = type(p)(self.parameters[name].value, unit=p.unit, fixed=True)
        return self.model.with_parameters(changes)

    def unlike(self, distance: float = 5.0) -> list[Unlike]:
        """Return the records whose residuals or own parameters are unlike those of the others, the most unlike first.

        distance  from the median, in robust standard deviations, from which on a record is named.

        Raises OptionError where there are fewer than 8 records.
        """
        if len(self.flights) < _FEWEST:
            raise OptionError(f"unlike: {counted(len(self.flights), 'record')} say nothing of what is usual; 8 do")
        columns: dict[str, tuple[bool, list[float]]] = {}
        for name in self.model.output_names:
            columns[f"residual of {name}"] = (True, [f.rms[name] for f in self.flights.values()])
        for name in next(iter(self.flights.values())).parameters:
            columns[name] = (False, [f.parameters[name].value for f in self.flights.values()])
        found = []
        for what, (logarithmic, values) in columns.items():
            column = np.array(values, dtype=float)
            with np.errstate(divide="ignore", invalid="ignore"):
                scaled = np.log(column) if logarithmic else column
            present = np.isfinite(scaled)
            if present.sum() < _FEWEST:
                continue
            middle = float(np.median(scaled[present]))
            spread = float(np.median(np.abs(scaled[present] - middle))) / _MAD
            if not spread > 0.0:
                continue
            far = np.where(present, (scaled - middle) / spread, 0.0)
            typical = math.exp(middle) if logarithmic else middle
            found += [
                Unlike(name, what, float(column[k]), typical, float(far[k]))
                for k, name in enumerate(self.flights)
                if abs(far[k]) > distance
            ]
        return sorted(found, key=lambda u: -abs(u.distance))

    def summary(self) -> str:
        """Return status, parameters, and records that are unlike the others, as plain-text tables."""
        rows = [
            [name, f"{e.value:.6g}", f"{e.std_error:.2g}" if math.isfinite(e.std_error) else "", e.unit, e.remark]
            for name, e in self.parameters.items()
        ]
        parts = [
            f"{self.model.name}: {self.status} after {counted(self.iterations, 'iteration')}, "
            f"{counted(len(self.flights), 'record')}, {self.samples} samples, log-likelihood {self.log_likelihood:.3f}",
            text_table(["parameter", "estimate", "std error", "unit", ""], rows, "srrss"),
        ]
        if self.status not in ENDED_WELL:
            parts.insert(1, self.message)
        if self.populations:
            of = [
                [p.name, f"{p.mean:.6g}", f"{p.mean_error:.2g}", f"{p.std:.4g}", f"{p.std_error:.2g}"]
                for p in self.populations.values()
            ]
            parts.append(text_table(["population", "mean", "std error", "std", "std error"], of, "srrrr"))
        if len(self.flights) >= _FEWEST and (unlike := self.unlike()):
            cells = [[u.name, u.what, f"{u.value:.4g}", f"{u.typical:.4g}", f"{u.distance:+.1f}"] for u in unlike[:10]]
            heads = ["record", "unlike in", "value", "typical", "distance"]
            parts.append(f"records unlike the others: {len(unlike)}\n" + text_table(heads, cells, "ssrrr"))
        parts += [f"warning: {w}" for w in self.warnings]
        return "\n\n".join(parts)

    def __repr__(self) -> str:
        return (
            f"<FleetFit of '{self.model.name}': {self.status}, {counted(len(self.flights), 'record')}, "
            f"log-likelihood {self.log_likelihood:.6g}, {counted(len(self.parameters), 'parameter')}>"
        )
