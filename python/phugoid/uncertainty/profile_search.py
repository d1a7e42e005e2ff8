"""Search for the ends of a profile: one parameter fixed at value after value, all others re-estimated."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias

from ..data.experiment import Experiment
from ..errors import PhugoidError
from ..estimation import estimate
from ..estimation.filter_variables import Separated
from ..estimation.starts import Outcome, Problem
from ..fit_result import ENDED_WELL, FitResult
from ..modelling.model import Model
from ..parameters import Estimates, Parameter
from ..solvers import check_time

__all__ = ["End", "Side", "Sides"]

End: TypeAlias = Literal["found", "bound", "open", "failed", "missing"]

# Relative tolerance of the likelihood's root at an end.
_CLOSE = 5e-4
# Points on one side, how much farther each try reaches, and how far in standard errors, or decades of a parameter with
# a logarithm, before an end counts as open.
_POINTS, _FARTHER, _OPEN, _DECADES = 40, 2.0, 100.0, 6.0
# Where there is no standard error, the first step is this part of the value.
_STEP = 0.05


@dataclass(frozen=True, eq=False)
class Side(Outcome):
    """One side of a profile."""

    end: float = math.nan
    kind: End = "missing"
    points: tuple[tuple[float, float], ...] = ()  # value, drop
    better: float = 0.0


@dataclass(frozen=True, eq=False, repr=False)
class Sides(Problem):
    """A problem with one side of a profile for each start: parameter, direction and threshold."""

    base: FitResult | None = None

    def single_threaded(self) -> Sides:
        one = super().single_threaded()
        assert isinstance(one, Sides)
        return one

    def outcome(self, index: int, start: Mapping[str, Any]) -> Outcome:
        """Return the outcome of one side."""
        begin = time.perf_counter()
        assert self.base is not None
        search = _ProfileSearch(self, self.base, start["name"])
        try:
            end, kind = search.to_end(start["side"], start["root"])
        except KeyboardInterrupt:
            return Side(index, start, "interrupted")
        return Side(
            index,
            start,
            "converged" if kind != "failed" else "error",
            iterations=search.runs,
            time=time.perf_counter() - begin,
            end=end,
            kind=kind,
            points=tuple(search.points),
            better=search.better,
        )


class _ProfileSearch:
    """Estimations with one parameter fixed at value after value, each started from the nearest before."""

    def __init__(self, problem: Sides, base: FitResult, name: str) -> None:
        self.problem, self.name = problem, name
        self.model: Model = problem.model
        self.experiments: Sequence[Experiment] = problem.experiments
        estimates = base.parameters
        self.value, self.error = estimates[name].value, estimates[name].std_error
        self.key, self.base = name, base
        if name.endswith("]"):  # one experiment's own
            separated = Separated(self.model, self.experiments)
            self.model, self.experiments = separated.model, separated.experiments
            self.key = next(new for new, old in separated.names.items() if old == name)
            self.base = separated.fit(base)
        declared = self.model.declared_parameters[self.key]
        self.unit = declared.unit
        self.low, self.high = declared.bounds
        self.log = declared.transform == "log"
        self.top = _merit(self.base, self.model, self.key)
        self.fits: list[tuple[float, FitResult]] = [(self.value, self.base)]
        self.points: list[tuple[float, float]] = []
        self.runs, self.better = 0, 0.0

    def root(self, value: float) -> float:
        """Return the root of twice the drop of the log-likelihood at a value; NaN where the solver does not
        converge."""
        _, near = min(self.fits, key=lambda f: abs(f[0] - value))
        kept = Estimates(e for n, e in near.parameters.items() if n != self.key)
        self.runs += 1
        try:
            fit = estimate(
                self.model.with_parameters({self.key: Parameter(value, unit=self.unit, fixed=True)}),
                self.experiments,
                transcription=self.problem.transcription,
                noise=self.problem.noise,
                start=replace(near, parameters=kept),
                solver=self.problem.solver,
            )
        except PhugoidError:
            return math.nan
        if fit.status == "time limit":
            check_time()
        if fit.status == "interrupted":
            raise KeyboardInterrupt
        if fit.status not in ENDED_WELL:
            return math.nan
        drop = self.top - _merit(fit, self.model, self.key) - self._prior(value) + self._prior(self.value)
        self.better = max(self.better, -drop)
        self.fits.append((value, fit))
        self.points.append((value, drop))
        return math.sqrt(2.0 * max(drop, 0.0))

    def _prior(self, value: float) -> float:
        """Return the contribution of the parameter's own prior to the log-likelihood."""
        prior = self.model.declared_parameters[self.key].prior
        return -0.5 * ((value - prior[0]) / prior[1]) ** 2 if prior else 0.0

    def to_end(self, side: int, target: float) -> tuple[float, End]:
        """Return where the root reaches the target on a side, -1 or 1, and how the interval ends there."""
        begin, limit = self.value, self.high if side > 0 else self.low
        size = self.error if math.isfinite(self.error) and self.error > 0.0 else _STEP * (abs(self.value) or 1.0)
        if self.log:  # search in the logarithm
            begin, limit, size = math.log(begin), math.log(limit) if limit > 0.0 else -math.inf, size / begin
        room = side * (limit - begin)
        if not room > 1e-9 * size:
            return self._value(limit), "bound"

        def at(step: float) -> float:
            return self._value(limit if step == room else begin + side * step)

        far = min(_OPEN * target * size, _DECADES * math.log(10.0) if self.log else math.inf)
        inner, outer = (0.0, -target), (math.inf, math.inf)  # steps, and what roots are above the target there
        slope = 1.0 / size  # of the root, between the last two steps
        step = min(
            0.5 * target * size, far
        )  # half way first: the others follow more easily, and it shows in the figure
        last = 0  # the end that was moved last
        while self.runs < _POINTS:
            step = min(step, room)
            above = self.root(at(step)) - target
            if abs(above) <= _CLOSE * target:
                return at(step), "found"
            if above < 0.0:
                if step == room:
                    return at(step), "bound"
                if step >= far:
                    return self._value(side * math.inf), "open"
                # Illinois: an end that stays counts half, so that it does not stay forever.
                outer = (outer[0], 0.5 * outer[1]) if last < 0 else outer
                slope = (above - inner[1]) / (step - inner[0])
                inner, last = (step, above), -1
            else:
                inner = (inner[0], 0.5 * inner[1]) if last > 0 else inner
                outer, last = (step, above), 1  # not a number where the solver did not converge
            if math.isinf(outer[0]):
                reach = -1.05 * above / slope if slope > 0.0 else math.inf
                step = min(inner[0] + min(max(reach, 0.02 * inner[0]), (_FARTHER - 1.0) * inner[0]), 1.001 * far)
                continue
            gap = outer[0] - inner[0]
            if gap <= 1e-6 * max(size, outer[0]):
                break
            share = inner[1] / (inner[1] - outer[1]) if math.isfinite(outer[1]) else 0.5
            step = inner[0] + min(max(share, 0.02), 0.98) * gap
        if math.isnan(outer[1]) or math.isinf(outer[0]):
            return math.nan, "failed"
        return at(step), "found"

    def _value(self, place: float) -> float:
        """Return the value of the parameter at a position of the search."""
        if not self.log:
            return place
        return math.exp(place) if place < math.inf else place


def _merit(fit: FitResult, model: Model, without: str) -> float:
    """Return the log-likelihood with the contribution of priors, except that of one parameter."""
    total = fit.log_likelihood
    for name, e in fit.parameters.items():
        base = name.partition("[")[0]
        declared = model.declared_parameters.get(name) or model.declared_parameters.get(base)
        if declared is not None and declared.prior is not None and name != without:
            total -= 0.5 * ((e.value - declared.prior[0]) / declared.prior[1]) ** 2
    return total
