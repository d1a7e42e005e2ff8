"""Profile likelihood: how far one parameter can go, all others following, before the likelihood falls too low."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..errors import OptionError, PhugoidError, UnknownName, did_you_mean, listing
from ..estimate import estimate
from ..experiment import Experiment
from ..model import Model
from ..outcome import Outcome, Problem
from ..parameters import Estimates, text_table
from ..rebuilt import rebuilt
from ..result import Fit
from ..separate import Separated
from .runs import common_to, run_all

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Profile", "Profiles", "profile"]

_Array: TypeAlias = NDArray[np.float64]
End: TypeAlias = Literal["found", "bound", "open", "failed", "missing"]

# The likelihood's root at an end is right to this part of the threshold's.
_CLOSE = 5e-4
# Points on one side, how much farther each try reaches, and how far in standard errors, or decades of a parameter with
# a logarithm, before an end counts as open.
_POINTS, _FARTHER, _OPEN, _DECADES = 40, 2.0, 100.0, 6.0
# Log-likelihood by which another optimum is better.
_BETTER = 1e-3
# Where there is no standard error, the first step is this part of the value.
_STEP = 0.05

_SAID: Mapping[str, str] = {
    "found": "",
    "bound": "at its bound",
    "open": "no end: the likelihood stays above",
    "failed": "not found: the solver did not converge beyond",
    "missing": "interrupted",
}


@dataclass(frozen=True, eq=False, repr=False)
class Profile:
    """The profile likelihood of one parameter.

    name       of the parameter; ``value`` its estimate, ``std_error`` the Cramér-Rao one, ``unit``.
    interval   (low, high) of all values whose likelihood ratio is not rejected; -inf or inf where it has no end.
    ends       what the ends are: "found"; "bound", where the interval ends at a bound of the parameter; "open", where
               the likelihood does not fall low enough however far one goes; "failed", where the solver came no farther;
               "missing", where the run was interrupted.
    values     (k,) that were tried, in order, the estimate among them.
    drops      (k,) by how much the log-likelihood is lower there, with all else estimated anew.
    threshold  the drop at the ends: half of chi-square's quantile with one degree of freedom.
    inflation  by how much the threshold's root was made larger for coloured residuals; 1 where it was not.
    """

    name: str
    value: float
    std_error: float
    unit: str
    interval: tuple[float, float]
    ends: tuple[End, End]
    values: _Array
    drops: _Array
    threshold: float
    inflation: float = 1.0

    @property
    def remark(self) -> str:
        """What is to be said of the ends, in words."""
        sides = zip(("lower", "upper"), self.ends, strict=True)
        return "; ".join(f"{side} end {_SAID[end]}" for side, end in sides if end != "found")

    @property
    def asymmetry(self) -> float:
        """Upper over lower half of the interval: 1 where the likelihood is a parabola."""
        low, high = self.interval
        return (high - self.value) / (self.value - low) if self.value > low else math.nan

    def __repr__(self) -> str:
        low, high = self.interval
        return f"<Profile of {self.name}: {low:.4g} to {high:.4g}>"


@dataclass(frozen=True, eq=False, repr=False)
class Profiles(Mapping[str, Profile]):
    """The result of `Fit.profile`: name -> `Profile`.

    level     of the intervals.
    status    "complete", or "interrupted".
    warnings  what to beware of, in words.
    runs      estimations that it took.
    time      s.
    """

    profiles: Mapping[str, Profile]
    level: float
    status: str
    warnings: tuple[str, ...] = ()
    runs: int = 0
    time: float = 0.0

    def __getitem__(self, name: str) -> Profile:
        if name not in self.profiles:
            raise UnknownName(f"there is no profile of '{name}'.{did_you_mean(str(name), self.profiles)}")
        return self.profiles[name]

    def __iter__(self) -> Any:
        return iter(self.profiles)

    def __len__(self) -> int:
        return len(self.profiles)

    def summary(self) -> str:
        """A table: estimate, interval by profile, and what standard errors alone would say."""
        z = NormalDist().inv_cdf(0.5 + 0.5 * self.level)
        rows = []
        for p in self.profiles.values():
            reach = z * p.std_error * p.inflation
            wald = [f"{p.value - reach:.5g}", f"{p.value + reach:.5g}"] if math.isfinite(reach) else ["", ""]
            ends = [f"{end:.5g}" if not math.isnan(end) else "" for end in p.interval]
            rows.append([p.name, f"{p.value:.5g}", *ends, *wald, p.unit, p.remark])
        percent = f"{100 * self.level:g} %"
        heads = ["parameter", "estimate", f"{percent} from", "to", "by std error", "to", "unit", "remark"]
        lines = [f"profile likelihood, {self.status}: {self.runs} estimations in {self.time:.1f} s"]
        if any(p.inflation != 1.0 for p in self.profiles.values()):
            lines.append("the threshold allows for coloured residuals")
        return "\n".join([*lines, "", text_table(heads, rows, "lrrrrrll"), *(f"\nWarning: {w}" for w in self.warnings)])

    def plot(self, names: Sequence[str] | None = None) -> tuple[Figure, dict[str, Axes]]:
        """Log-likelihood over each parameter, with the parabola of its standard error and the interval.

        Returns the figure and its axes by name. Raises UnknownName for a name without a profile.
        """
        from .profile_figure import plot_profiles

        return plot_profiles([self[name] for name in (names or self.profiles)], self.level)

    def __str__(self) -> str:
        return self.summary()

    def __repr__(self) -> str:
        return f"<Profiles of {', '.join(self.profiles)}: {self.status}>"


@dataclass(frozen=True, eq=False)
class _Side(Outcome):
    """One side of a profile."""

    end: float = math.nan
    kind: End = "missing"
    points: tuple[tuple[float, float], ...] = ()  # value, drop
    better: float = 0.0


@dataclass(frozen=True, eq=False, repr=False)
class _Sides(Problem):
    """A side of a profile for each start: its parameter, direction and threshold."""

    base: Fit | None = None

    def single_threaded(self) -> _Sides:
        one = super().single_threaded()
        assert isinstance(one, _Sides)
        return one

    def outcome(self, index: int, start: Mapping[str, Any]) -> Outcome:
        """One side."""
        begin = time.perf_counter()
        assert self.base is not None
        walk = _Walk(self, self.base, start["name"])
        try:
            end, kind = walk.to_end(start["side"], start["root"])
        except KeyboardInterrupt:
            return _Side(index, start, "interrupted")
        return _Side(
            index,
            start,
            "converged" if kind != "failed" else "error",
            iterations=walk.runs,
            time=time.perf_counter() - begin,
            end=end,
            kind=kind,
            points=tuple(walk.points),
            better=walk.better,
        )


class _Walk:
    """Estimations with one parameter held at value after value, each from the nearest before."""

    def __init__(self, problem: _Sides, base: Fit, name: str) -> None:
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
        self.low, self.high = declared.bounds
        self.log = declared.transform == "log"
        self.top = _merit(self.base, self.model, self.key)
        self.fits: list[tuple[float, Fit]] = [(self.value, self.base)]
        self.points: list[tuple[float, float]] = []
        self.runs, self.better = 0, 0.0

    def root(self, value: float) -> float:
        """The root of twice the drop of the log-likelihood at a value; NaN where the solver does not converge."""
        _, near = min(self.fits, key=lambda f: abs(f[0] - value))
        kept = Estimates(e for n, e in near.parameters.items() if n != self.key)
        self.runs += 1
        try:
            fit = estimate(
                _held(self.model, self.key, value),
                self.experiments,
                transcription=self.problem.transcription,
                noise=self.problem.noise,
                start=replace(near, parameters=kept),
                solver=self.problem.solver,
            )
        except PhugoidError:
            return math.nan
        if fit.status == "interrupted":
            raise KeyboardInterrupt
        if fit.status not in ("converged", "acceptable"):
            return math.nan
        drop = self.top - _merit(fit, self.model, self.key) - self._prior(value) + self._prior(self.value)
        self.better = max(self.better, -drop)
        self.fits.append((value, fit))
        self.points.append((value, drop))
        return math.sqrt(2.0 * max(drop, 0.0))

    def _prior(self, value: float) -> float:
        """What the parameter's own prior adds to the log-likelihood."""
        prior = self.model.declared_parameters[self.key].prior
        return -0.5 * ((value - prior[0]) / prior[1]) ** 2 if prior else 0.0

    def to_end(self, side: int, target: float) -> tuple[float, End]:
        """Where the root reaches the target on a side, -1 or 1, and how the interval ends there."""
        begin, limit = self.value, self.high if side > 0 else self.low
        size = self.error if math.isfinite(self.error) and self.error > 0.0 else _STEP * (abs(self.value) or 1.0)
        if self.log:  # the way is that of the logarithm
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
        """Of the parameter at a place on the way."""
        if not self.log:
            return place
        return math.exp(place) if place < math.inf else place


def _merit(fit: Fit, model: Model, without: str) -> float:
    """Log-likelihood with what priors add, but for that of one parameter."""
    total = fit.log_likelihood
    for name, e in fit.parameters.items():
        base = name.partition("[")[0]
        declared = model.declared_parameters.get(name) or model.declared_parameters.get(base)
        if declared is not None and declared.prior is not None and name != without:
            total -= 0.5 * ((e.value - declared.prior[0]) / declared.prior[1]) ** 2
    return total


def _held(model: Model, name: str, value: float) -> Model:
    """The model with one parameter held at a value."""

    def declare(core: _core.Model, declared: Any) -> None:
        own, unit, start, low, high, prior, fixed, local, log, scale = declared
        if own == name:
            core.parameter(own, unit, value, -math.inf, math.inf, None, True, False, False, None)
        else:
            core.parameter(own, unit, start, low, high, prior, fixed, local, log, scale)

    return model._around(rebuilt(model._core, model._core.inputs, declare), model.delays)


def profile(
    fit: Fit,
    names: str | Iterable[str] | None = None,
    *,
    level: float = 0.95,
    coloured: bool = False,
    executor: Executor | None = None,
    progress: bool | Callable[[Outcome], None] = False,
) -> Profiles:
    """What `Fit.profile` does; see there."""
    begin = time.perf_counter()
    if not isinstance(level, (int, float)) or not 0.0 < level < 1.0:
        raise OptionError(f"profile: level is a number between 0 and 1, such as 0.95, not {level!r}")
    chosen = _chosen(fit, names)
    inflation = {name: 1.0 for name in chosen}
    if coloured:
        ratios = fit.coloured.inflation
        inflation = {name: ratios[name] if math.isfinite(ratios[name]) else 1.0 for name in chosen}
    problem = _Sides(**common_to(fit, "profile"))
    root = NormalDist().inv_cdf(0.5 + 0.5 * level)
    starts = [{"name": n, "side": side, "root": root * inflation[n]} for n in chosen for side in (-1, 1)]
    runs = run_all(problem, starts, executor, progress, "profile")
    found, better = {}, 0.0
    for i, name in enumerate(chosen):
        sides = [runs.outcomes.get(2 * i + k) for k in range(2)]
        there = [s if isinstance(s, _Side) else None for s in sides]
        points = sorted([(fit.parameters[name].value, 0.0), *(p for s in there if s for p in s.points)])
        better = max([better, *(s.better for s in there if s)])
        e = fit.parameters[name]
        found[name] = Profile(
            name=name,
            value=e.value,
            std_error=e.std_error,
            unit=e.unit,
            interval=(there[0].end if there[0] else math.nan, there[1].end if there[1] else math.nan),
            ends=(there[0].kind if there[0] else "missing", there[1].kind if there[1] else "missing"),
            values=np.array([v for v, _ in points]),
            drops=np.array([d for _, d in points]),
            threshold=0.5 * (root * inflation[name]) ** 2,
            inflation=inflation[name],
        )
    warnings = list(runs.warnings)
    if better > _BETTER:
        warnings.append(
            f"with a parameter held elsewhere the log-likelihood is higher by {better:.3g}: the fit is not the best "
            "optimum; see multistart"
        )
    return Profiles(
        profiles=found,
        level=float(level),
        status="complete" if runs.complete else "interrupted",
        warnings=tuple(warnings),
        runs=sum(o.iterations for o in runs.outcomes.values()),
        time=time.perf_counter() - begin,
    )


def _chosen(fit: Fit, names: Any) -> list[str]:
    """Of which parameters. Raises OptionError for what has no profile."""
    noise = fit.noise_parameters
    free = [n for n, e in fit.parameters.items() if n not in noise and not e.fixed]
    if names is None:
        return free
    asked = [names] if isinstance(names, str) else list(names)
    for name in asked:
        if name in free:
            continue
        if name in noise:
            raise OptionError(f"profile: '{name}' belongs to the noise; profiles are of the model's parameters")
        if name in fit.parameters:
            raise OptionError(f"profile: '{name}' is fixed")
        raise OptionError(f"profile: '{name}' is no parameter of the fit.{listing(str(name), free)}")
    return list(dict.fromkeys(asked))
