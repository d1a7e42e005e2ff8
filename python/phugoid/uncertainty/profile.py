"""Profile likelihood: intervals of one parameter, all others re-estimated at each value."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..errors import OptionError, UnknownName, did_you_mean, listing, part
from ..estimation.starts import Outcome
from ..estimation.workers import common_to, run_all
from ..figures import GREY, MEASURED, ORANGE, WIDTH, Panels, labelled, plain, styled
from ..fit_result import FitResult
from ..notebook import Html, Rows, overview, sparkline
from ..parameters import text_table
from ..solvers import limited
from ..tabular import arviz_draws
from .coloured import coloured as corrected
from .profile_search import End, Side, Sides

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Profile", "Profiles", "profile"]


_Array: TypeAlias = NDArray[np.float64]

# Log-likelihood by which another optimum is better.
_BETTER = 1e-3
_SAID: Mapping[str, str] = {
    "found": "",
    "bound": "at its bound",
    "open": "no end: the likelihood stays above",
    "failed": "not found: the solver did not converge beyond",
    "missing": "not reached: the run was ended before",
}


_ALIGN = "srrrrrll"


@dataclass(frozen=True, eq=False, repr=False)
class Profile:
    """The profile likelihood of one parameter.

    name       of the parameter; ``value`` its estimate, ``std_error`` the Cramér-Rao one, ``unit``.
    interval   (low, high) of all values whose likelihood ratio is not rejected; -inf or inf where it has no end.
    ends       what the ends are: "found"; "bound", where the interval ends at a bound of the parameter; "open", where
               the likelihood does not fall low enough however far one goes; "failed", where the solver came no farther;
               "missing", where the run was interrupted or its time limit was reached.
    values     (k,) that were tried, in order, the estimate among them.
    drops      (k,) drop of the log-likelihood there, with all else re-estimated.
    threshold  the drop at the ends: half of chi-square's quantile with one degree of freedom.
    inflation  factor on the root of the threshold for coloured residuals; 1 without.
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
        """Remarks on the ends, in words."""
        sides = zip(("lower", "upper"), self.ends, strict=True)
        return "; ".join(f"{side} end {_SAID[end]}" for side, end in sides if end != "found")

    @property
    def asymmetry(self) -> float:
        """Upper over lower half of the interval: 1 where the likelihood is a parabola."""
        low, high = self.interval
        return (high - self.value) / (self.value - low) if self.value > low else math.nan

    def quantiles(self, probabilities: Sequence[float] | _Array) -> _Array:
        """Return the values at which the signed root of the likelihood ratio has quantiles of the normal distribution.

        Between the values that were tried it is interpolated, beyond the last of them it goes on as it was between the
        last two. NaN where there are fewer than two.
        """
        root = np.sign(self.values - self.value) * np.sqrt(2.0 * np.maximum(self.drops, 0.0)) / self.inflation
        z = np.array([NormalDist().inv_cdf(p) for p in probabilities])
        there = np.isfinite(root) & np.concatenate([[True], np.diff(root) > 0.0])
        x, y = root[there], self.values[there]
        if x.size < 2:
            return np.full(z.size, np.nan)
        low, high = ((y[i + 1] - y[i]) / (x[i + 1] - x[i]) for i in (0, -2))
        found: _Array = np.interp(z, x, y) + np.minimum(z - x[0], 0.0) * low + np.maximum(z - x[-1], 0.0) * high
        return found

    def _cells(self, z: float) -> list[str]:
        """Return the row of a table, with the interval of so many standard errors."""
        reach = z * self.std_error * self.inflation
        wald = [f"{self.value - reach:.5g}", f"{self.value + reach:.5g}"] if math.isfinite(reach) else ["", ""]
        ends = [f"{end:.5g}" if not math.isnan(end) else "" for end in self.interval]
        return [self.name, f"{self.value:.5g}", *ends, *wald, self.unit, self.remark]

    def _picture(self) -> Html:
        """Return the log-likelihood over the parameter as a small picture."""
        return sparkline(-self.drops, t=self.values)

    def _repr_html_(self) -> str:
        rows = [self._cells(math.sqrt(2.0 * self.threshold) / self.inflation)]
        heads = ["parameter", "estimate", "from", "to", "by std error", "to", "unit", "remark"]
        note = f"log-likelihood drops by {self.threshold:.3g} at the ends"
        return overview("Profile", (heads, rows, _ALIGN), pictures={self.name: self._picture()}, note=note)

    def __repr__(self) -> str:
        low, high = self.interval
        return f"<Profile of {self.name}: {low:.4g} to {high:.4g}>"


@dataclass(frozen=True, eq=False, repr=False)
class Profiles(Mapping[str, Profile]):
    """The result of `Fit.profile`: name -> `Profile`.

    level     of the intervals.
    status    "complete", "interrupted" or "time limit".
    warnings  in words.
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

    def _ipython_key_completions_(self) -> list[str]:
        return list(self)

    def __iter__(self) -> Any:
        return iter(self.profiles)

    def __len__(self) -> int:
        return len(self.profiles)

    def summary(self) -> str:
        """Return a table: estimate, interval by profile, and the interval from standard errors alone."""
        first, *others = self._remarks()
        lines = [f"profile likelihood, {self.status}: {first}", *others]
        return "\n".join([*lines, "", text_table(*self._rows()), *(f"\nWarning: {w}" for w in self.warnings)])

    def _repr_html_(self) -> str:
        pictures = {p.name: p._picture() for p in self.profiles.values()}
        remarks = [*self._remarks(), *self.warnings]
        return overview("Profile likelihood", self._rows(), remarks=remarks, pictures=pictures, note=self.status)

    def _rows(self) -> Rows:
        z = NormalDist().inv_cdf(0.5 + 0.5 * self.level)
        percent = f"{100 * self.level:g} %"
        heads = ["parameter", "estimate", f"{percent} from", "to", "by std error", "to", "unit", "remark"]
        return heads, [p._cells(z) for p in self.profiles.values()], _ALIGN

    def _remarks(self) -> list[str]:
        inflated = any(p.inflation != 1.0 for p in self.profiles.values())
        done = f"{self.runs} estimations in {self.time:.1f} s"
        return [done, "the threshold allows for coloured residuals"] if inflated else [done]

    def to_arviz(self, n: int = 1000, seed: int = 0) -> Any:
        """Return n draws of each parameter for the figures and tables of arviz, such as ``plot_forest``.

        They are those of a parameter whose signed root of the likelihood ratio is normal, as the intervals suppose, and
        are independent of the draws of other parameters. Raises MissingDependency without arviz,
        OptionError for n below 2.
        """
        if n < 2:
            raise OptionError(f"to_arviz: n is the number of draws, two or more, not {n}")
        random = np.random.default_rng(seed)
        return arviz_draws(
            {name: random.permutation(p.quantiles((np.arange(n) + 0.5) / n)) for name, p in self.items()}
        )

    def plot(self, names: Sequence[str] | None = None) -> tuple[Figure, dict[str, Axes]]:
        """Plot the log-likelihood over each parameter, with the parabola of its standard error and the interval.

        Returns the figure and its axes by name. Raises UnknownName for a name without a profile.
        """
        return plot_profiles([self[name] for name in (names or self.profiles)], self.level)

    def __str__(self) -> str:
        return self.summary()

    def __repr__(self) -> str:
        return f"<Profiles of {', '.join(self.profiles)}: {self.status}>"


def profile(
    fit: FitResult,
    names: str | Iterable[str] | None = None,
    *,
    level: float = 0.95,
    coloured: bool = False,
    executor: Executor | None = None,
    progress: bool | Callable[[Outcome], None] = False,
    time_limit: float | None = None,
) -> Profiles:
    """Compute profile-likelihood intervals; see `Fit.profile`."""
    begin = time.perf_counter()
    deadline = limited("profile", time_limit)
    part("profile: level", level, "0.95")
    chosen = _chosen(fit, names)
    inflation = {name: 1.0 for name in chosen}
    if coloured:
        ratios = corrected(fit).inflation
        inflation = {name: ratios[name] if math.isfinite(ratios[name]) else 1.0 for name in chosen}
    problem = Sides(**common_to(fit, "profile"))
    root = NormalDist().inv_cdf(0.5 + 0.5 * level)
    starts = [{"name": n, "side": side, "root": root * inflation[n]} for n in chosen for side in (-1, 1)]
    runs = run_all(problem, starts, executor, progress, "profile", deadline)
    found, better = {}, 0.0
    for i, name in enumerate(chosen):
        sides = [runs.outcomes.get(2 * i + k) for k in range(2)]
        there = [s if isinstance(s, Side) else None for s in sides]
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
            f"with a parameter fixed elsewhere the log-likelihood is higher by {better:.3g}: the fit is not the best "
            "optimum; see multistart"
        )
    return Profiles(
        profiles=found,
        level=float(level),
        status=runs.status,
        warnings=tuple(warnings),
        runs=sum(o.iterations for o in runs.outcomes.values()),
        time=time.perf_counter() - begin,
    )


def _chosen(fit: FitResult, names: Any) -> list[str]:
    """Return the parameters to profile; raise OptionError for those without a profile."""
    noise = fit.noise_parameters
    free = [n for n, e in fit.parameters.items() if n not in noise and not e.fixed]
    if names is None:
        return free
    asked = [names] if isinstance(names, str) or not isinstance(names, Iterable) else list(names)
    for name in asked:
        if name in free:
            continue
        if name in noise:
            raise OptionError(f"profile: '{name}' belongs to the noise; profiles are of the model's parameters")
        if name in fit.parameters:
            raise OptionError(f"profile: '{name}' is fixed")
        raise OptionError(f"profile: '{name}' is not a parameter of the fit.{listing(str(name), free)}")
    return list(dict.fromkeys(asked))


# Columns of panels, and the height of each in inches.
_COLUMNS, _HEIGHT = 3, 1.95
# Shown length of an infinite interval, in halves of a finite one.
_BEYOND = 4.0


def plot_profiles(profiles: Sequence[Profile], level: float) -> tuple[Figure, dict[str, Axes]]:
    """Plot one panel for each parameter: the drop of log-likelihood, the parabola of the Cramér-Rao standard error
    (dashed), the threshold and the interval."""
    from matplotlib.lines import Line2D

    columns = min(_COLUMNS, max(len(profiles), 1))
    rows = math.ceil(len(profiles) / columns)
    with styled() as plt:
        figure, grid = plt.subplots(
            rows, columns, figsize=(max(WIDTH * columns / _COLUMNS + 0.3, 3.9), _HEIGHT * rows + 0.4), squeeze=False
        )
        panels = list(grid.ravel())
        axes = {p.name: axis for p, axis in zip(profiles, panels, strict=False)}
        for axis in panels[len(profiles) :]:
            axis.set_visible(False)
        for i, p in enumerate(profiles):
            _draw_profile(axes[p.name], p)
            if i % columns == 0:
                axes[p.name].set_ylabel("Δ log-likelihood")
        handles = [
            Line2D([], [], color=MEASURED, marker="o", markersize=3, label="profile"),
            Line2D([], [], color=ORANGE, linestyle="--", label="standard error"),
            Line2D([], [], color=GREY, linewidth=0.8, label=f"{100 * level:g} %"),
        ]
        height = figure.get_figheight()
        figure.legend(handles=handles, loc="upper right", ncols=3, frameon=False, fontsize=8)
        figure.tight_layout(rect=(0, 0, 1, 1 - 0.28 / height))
    return figure, Panels(axes)


def _draw_profile(axis: Any, p: Profile) -> None:
    at, roots = p.values, np.sign(p.values - p.value) * np.sqrt(2.0 * np.maximum(p.drops, 0.0))
    reach = 1.35 * math.sqrt(2.0 * p.threshold)
    shown = np.abs(roots) <= 2.0 * reach
    at, roots = at[shown], roots[shown]
    if at.size > 1:
        # Roots are nearly straight, so what lies between the points is known.
        from scipy.interpolate import PchipInterpolator

        half = [abs(e - p.value) for e in p.interval if math.isfinite(e)] or [2.0 * p.std_error]
        beyond = _BEYOND * max(half) if math.isfinite(max(half)) else math.inf
        low = p.interval[0] if math.isfinite(p.interval[0]) else max(float(at[0]), p.value - beyond)
        high = p.interval[1] if math.isfinite(p.interval[1]) else min(float(at[-1]), p.value + beyond)
        fine = np.linspace(max(at[0], low - half[0]), min(at[-1], high + half[-1]), 200)
        smooth = PchipInterpolator(at, roots)(fine)
        axis.plot(fine, -0.5 * smooth**2, color=MEASURED, linewidth=1.3)
        margin = 0.12 * (high - low)
        axis.set_xlim(low - margin, high + margin)
    axis.plot(at, -0.5 * roots**2, "o", color=MEASURED, markersize=3)
    if math.isfinite(p.std_error):
        wide = np.linspace(axis.get_xlim()[0], axis.get_xlim()[1], 200)
        axis.plot(wide, -0.5 * ((wide - p.value) / p.std_error) ** 2, "--", color=ORANGE, linewidth=1.1, zorder=1)
    axis.axhline(-p.threshold, color=GREY, linewidth=0.8, zorder=0)
    for end in p.interval:
        if math.isfinite(end):
            axis.plot([end, end], [-p.threshold, -2.0 * p.threshold], color=GREY, linewidth=0.8, zorder=0)
    axis.set_ylim(-1.6 * p.threshold, 0.12 * p.threshold)
    axis.locator_params(axis="x", nbins=4)
    axis.tick_params(labelsize=7)
    axis.set_xlabel(plain(labelled(p.name, {p.name: p.unit})))
