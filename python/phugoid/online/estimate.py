"""The estimate after a sample, and what the detector says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Alarm", "OnlineEstimate"]

_Array = NDArray[np.float64]


@dataclass(frozen=True)
class Alarm:
    """The model no longer holds.

    ``since``: time from which on it does not, as far as can be said, in s. ``noticed``: time of the sample at which
    that was noticed. ``kind``: "parameter" where a watched parameter changed, "output" where the innovations of one
    output have another mean or variance, "several" where those of several outputs do; ``name``: the parameter or
    output. ``before``, ``change``, ``error``: of a parameter, its value before, the change and its standard error,
    else NaN. ``share``: part of the evidence that belongs to this kind of change.
    """

    since: float
    noticed: float
    kind: str
    name: str | None
    before: float
    change: float
    error: float
    share: float

    def __str__(self) -> str:
        begin = f"The model no longer holds since {self.since:.4g} s (noticed at {self.noticed:.4g} s)"
        if self.kind == "parameter":
            factor, error = 1 + self.change / self.before, abs(self.error / self.before)
            return f"{begin}; most likely {self.name} × {factor:.2f} ± {error:.2f}"
        where = f"of output {self.name}" if self.kind == "output" else "of several outputs"
        return f"{begin}; most likely another mean or variance of the innovations {where}"


@dataclass(frozen=True)
class OnlineEstimate:
    """The estimate after a sample, by name.

    ``t``: time of the latest sample, in s, which states refer to. ``states``, ``parameters``: values;
    ``state_errors`` and
    ``parameter_errors``: their standard errors, 0 for a fixed parameter. ``covariance`` (m, m): of the states, then
    the estimated parameters, in their order in the model. ``sigma``: standard deviations of the measurement noise.
    ``innovations``: measured outputs minus their predictions from all samples before, NaN where missing;
    ``innovation_errors``: their standard deviations;
    ``normalised``: innovations made independent, with unit variances. ``at_bound``: parameters that lie at a bound.
    ``arrival``: "latest", "late" for a sample that was put into the window, "too late" for one that was not used.
    ``iterations``, ``converged``, ``in_time``: Gauss-Newton iterations done, whether the last step was below the
    tolerance, and whether they ended without the deadline. ``alarm``: what the detector says, None while the model
    holds.
    """

    t: float
    arrival: str
    states: dict[str, float]
    state_errors: dict[str, float]
    parameters: dict[str, float]
    parameter_errors: dict[str, float]
    covariance: _Array
    sigma: dict[str, float]
    innovations: dict[str, float]
    innovation_errors: dict[str, float]
    normalised: dict[str, float]
    at_bound: tuple[str, ...]
    iterations: int
    converged: bool
    in_time: bool
    alarm: Alarm | None

    def __str__(self) -> str:
        rows = [f"t = {self.t:g} s, {self.iterations} iterations{'' if self.converged else ', not converged'}"]
        for name, value in self.parameters.items():
            rows.append(f"  {name:12} {value:12.5g} ± {self.parameter_errors[name]:.2g}")
        for name, value in self.states.items():
            rows.append(f"  {name:12} {value:12.5g} ± {self.state_errors[name]:.2g}")
        if self.alarm is not None:
            rows.append(str(self.alarm))
        return "\n".join(rows)


def estimate_of(found: dict[str, Any], states: list[str], parameters: list[str], outputs: list[str]) -> OnlineEstimate:
    """Return what the core says, by name."""

    def named(names: list[str], key: str) -> dict[str, float]:
        return dict(zip(names, found[key].tolist(), strict=True))

    return OnlineEstimate(
        t=found["t"],
        arrival=found["arrival"],
        states=named(states, "states"),
        state_errors=named(states, "state_errors"),
        parameters=named(parameters, "parameters"),
        parameter_errors=named(parameters, "parameter_errors"),
        covariance=found["covariance"],
        sigma=named(outputs, "sigma"),
        innovations=named(outputs, "innovations"),
        innovation_errors=named(outputs, "innovation_errors"),
        normalised=named(outputs, "normalised"),
        at_bound=tuple(name for name, at in zip(parameters, found["at_bound"], strict=True) if at),
        iterations=found["iterations"],
        converged=found["converged"],
        in_time=found["in_time"],
        alarm=None if found["alarm"] is None else Alarm(*found["alarm"]),
    )
