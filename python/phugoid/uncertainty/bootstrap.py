"""Bootstrap: the estimation repeated on data simulated from the fit, which gives the distribution of the estimates."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, OptionError, is_whole, part, whole
from ..estimation import estimate
from ..estimation.starts import Outcome, Problem, stream
from ..estimation.workers import common_to, run_all
from ..figures import BAND, GREY, MEASURED, ORANGE, WIDTH, Panels, labelled, plain, styled
from ..filter_error import FilterError
from ..fit_result import ENDED_WELL, FitResult
from ..notebook import Rows, overview, sparkline
from ..parameters import Estimates, text_table
from ..solvers import limited
from ..tabular import arviz_draws
from .bands import of_fit
from .resample import Blocks, ColouredNoise, Parametric, Resampler, block_length

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Bootstrap", "ProcessNoiseResampler", "bootstrap"]


_Array: TypeAlias = NDArray[np.float64]
Kind: TypeAlias = Literal["parametric", "coloured", "block"]

# Columns of panels, and the height of each in inches.
_COLUMNS, _HEIGHT = 3, 1.6
# Bins of the small histograms in a notebook.
_BINS = 25
_KINDS = ("parametric", "coloured", "block")


@dataclass(frozen=True, eq=False, repr=False)
class Bootstrap:
    """The result of `Fit.bootstrap`.

    parameters  of the fit itself.
    estimates   (k, n_p) of the k runs that converged; columns as in ``names``.
    kind        of the noise; ``block`` the samples of a block, None where there are none.
    n           how many runs were asked for.
    failed      how many ended without converging: they are left out.
    status      "complete", or "interrupted" or "time limit" where runs are missing.
    warnings    in words.
    time        s.
    """

    parameters: Estimates
    estimates: _Array
    kind: Kind
    block: int | None
    n: int
    failed: int
    status: str
    warnings: tuple[str, ...] = ()
    time: float = 0.0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return self.parameters.names

    @cached_property
    def covariance(self) -> _Array:
        """(n_p, n_p) of the estimates; NaN where fewer than two are there."""
        if len(self.estimates) < 2:
            return np.full((len(self.names), len(self.names)), np.nan)
        return np.atleast_2d(np.cov(self.estimates.T))

    @property
    def std_errors(self) -> dict[str, float]:
        """Name -> standard deviation of the estimates."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    @property
    def bias(self) -> dict[str, float]:
        """Name -> mean of the estimates less that of the fit, from which they were simulated."""
        mean = self.estimates.mean(axis=0) if len(self.estimates) else np.full(len(self.names), np.nan)
        return dict(zip(self.names, (mean - self.parameters.values_array).tolist(), strict=True))

    def intervals(
        self, level: float = 0.95, method: Literal["percentile", "basic"] = "percentile"
    ) -> dict[str, tuple[float, float]]:
        """Return name -> (low, high). "percentile" takes the quantiles of the estimates; "basic" mirrors them at the
        fit, so that a bias is subtracted rather than doubled. Raises OptionError for other methods and levels."""
        part("bootstrap: level", level, "0.95")
        if method not in ("percentile", "basic"):
            raise OptionError(f'bootstrap: method is "percentile" or "basic", not {method!r}')
        if not len(self.estimates):
            return {name: (math.nan, math.nan) for name in self.names}
        low, high = np.quantile(self.estimates, [0.5 - 0.5 * level, 0.5 + 0.5 * level], axis=0)
        if method == "basic":
            value = self.parameters.values_array
            low, high = 2.0 * value - high, 2.0 * value - low
        return {n: (float(a), float(b)) for n, a, b in zip(self.names, low, high, strict=True)}

    def summary(self, level: float = 0.95) -> str:
        """Return a table: estimate, Cramér-Rao and bootstrap standard errors, percentile interval."""
        warnings = [f"\nWarning: {w}" for w in self.warnings]
        return "\n".join([f"bootstrap, {self.status}: {self._runs()}", "", text_table(*self._rows(level)), *warnings])

    def _repr_html_(self) -> str:
        pictures = {}
        for name, drawn in zip(self.names, self.estimates.T, strict=True):
            if drawn.size > 1 and np.ptp(drawn) > 0.0:
                counts, edges = np.histogram(drawn, bins=_BINS)
                pictures[name] = sparkline(counts, t=edges[:-1])
        return overview(
            "Bootstrap", self._rows(0.95), remarks=[self._runs(), *self.warnings], pictures=pictures, note=self.status
        )

    def _runs(self) -> str:
        """Return what was done, in words."""
        what = {
            "parametric": "white noise of the fit's model",
            "coloured": "noise with the autocorrelation of the residuals",
        }
        noise = what.get(self.kind, f"residuals in blocks of {self.block} samples")
        return f"{len(self.estimates)} of {self.n} runs converged, {noise}; {self.time:.1f} s"

    def _rows(self, level: float) -> Rows:
        intervals = self.intervals(level)
        rows = []
        for e in self.parameters.values():
            low, high = intervals[e.name]
            plain = f"{e.std_error:.2g}" if math.isfinite(e.std_error) else ""
            rows.append(
                [e.name, f"{e.value:.5g}", plain, f"{self.std_errors[e.name]:.2g}", f"{low:.5g}", f"{high:.5g}", e.unit]
            )
        heads = ["parameter", "estimate", "Cramér-Rao", "bootstrap", f"{100 * level:g} % from", "to", "unit"]
        return heads, rows, "srrrrrl"

    def to_arviz(self) -> Any:
        """Return the estimates of all runs as draws for the figures and tables of arviz, such as ``plot_forest``.

        They have the distribution of the estimator, not one of Bayes: arviz's word for the group is ``posterior``.
        Raises MissingDependency without arviz.
        """
        return arviz_draws(dict(zip(self.names, self.estimates.T, strict=True)))

    def plot(self, names: Sequence[str] | None = None, level: float = 0.95) -> tuple[Figure, dict[str, Axes]]:
        """Plot one panel for each parameter: a histogram of the estimates of all runs, the normal distribution of the
        Cramér-Rao standard error (dashed), the estimate, and the percentile interval at a confidence level (dotted).

        ``names`` chooses parameters; by default all that were estimated. Returns the figure and its axes by name.
        Raises UnknownName for a name that is not a parameter, OptionError where fewer than two runs converged.
        """
        if len(self.estimates) < 2:
            raise OptionError(f"bootstrap: {len(self.estimates)} runs converged: a distribution needs two or more")
        shown = [n for n, e in self.parameters.items() if not e.fixed] if names is None else list(names)
        return _plot(self, [self.parameters[n].name for n in shown], self.intervals(level))

    def __str__(self) -> str:
        return self.summary()

    def __repr__(self) -> str:
        return f"<Bootstrap ({self.kind}): {self.status}, {len(self.estimates)} of {self.n} runs converged>"


def _plot(
    found: Bootstrap, names: Sequence[str], intervals: Mapping[str, tuple[float, float]]
) -> tuple[Figure, dict[str, Axes]]:
    columns = min(_COLUMNS, max(len(names), 1))
    rows = math.ceil(len(names) / columns)
    with styled() as plt:
        figure, grid = plt.subplots(rows, columns, figsize=(WIDTH, _HEIGHT * rows + 0.4), squeeze=False)
        axes: dict[str, Axes] = dict(zip(names, grid.ravel(), strict=False))
        for axis in grid.ravel()[len(names) :]:
            axis.set_visible(False)
        for name, axis in axes.items():
            e, drawn = found.parameters[name], found.estimates[:, found.names.index(name)]
            axis.hist(drawn, bins="auto", density=True, color=BAND, label="bootstrap")
            if math.isfinite(e.std_error) and e.std_error > 0.0:
                at = np.linspace(e.value - 3.5 * e.std_error, e.value + 3.5 * e.std_error, 200)
                density = np.exp(-0.5 * ((at - e.value) / e.std_error) ** 2) / (e.std_error * math.sqrt(2.0 * math.pi))
                axis.plot(at, density, "--", color=ORANGE, linewidth=1.1, label="standard error")
            axis.axvline(e.value, color=MEASURED, linewidth=1.0, label="estimate")
            for end in intervals[name]:
                axis.axvline(end, color=GREY, linewidth=0.8, linestyle=":")
            axis.set_yticks([])
            axis.locator_params(axis="x", nbins=4)
            axis.tick_params(labelsize=7)
            axis.set_xlabel(plain(labelled(name, {name: e.unit})))
        if names:
            handles, labels = axes[names[0]].get_legend_handles_labels()
            figure.legend(handles, labels, loc="upper right", ncols=3, frameon=False, fontsize=8)
        figure.tight_layout(rect=(0, 0, 1, 1 - 0.28 / figure.get_figheight()))
    return figure, Panels(axes)


@dataclass(frozen=True, eq=False, repr=False)
class _Resampled(Problem):
    """A problem whose data are drawn for each start, which holds only the number of the draw."""

    base: FitResult | None = None
    resampler: Resampler | None = None
    seed: int = 0

    def outcome(self, index: int, start: Mapping[str, Any]) -> Outcome:
        """Return the outcome of the estimation from the data of draw ``index``."""
        assert self.resampler is not None
        drawn = self.resampler.draw(stream(self.seed, index))
        data = [e.with_outputs(y) for e, y in zip(self.experiments, drawn, strict=True)]
        try:
            return replace(super().outcome(index, {"data": data}), start=start)
        except DataError as error:  # a draw may leave an output at rest; others do not
            return Outcome(index, start, "error", str(error))

    def fit(self, start: Mapping[str, Any]) -> FitResult:
        """Return the fit to the drawn data."""
        return estimate(
            self.model,
            start["data"],
            transcription=self.transcription,
            noise=self.noise,
            start=self.base,
            solver=self.solver,
        )


def bootstrap(
    fit: FitResult,
    n: int = 200,
    kind: Kind = "parametric",
    *,
    block: int | None = None,
    seed: int = 0,
    executor: Executor | None = None,
    progress: bool | Callable[[Outcome], None] = False,
    time_limit: float | None = None,
) -> Bootstrap:
    """Run the bootstrap; see `Fit.bootstrap`."""
    begin = time.perf_counter()
    deadline = limited("bootstrap", time_limit)
    whole("bootstrap: n", n, 1)
    whole("bootstrap: seed", seed, 0)
    if kind not in _KINDS:
        raise OptionError(f"bootstrap: kind is one of {', '.join(map(repr, _KINDS))}, not {kind!r}")
    if block is not None and kind != "block":
        raise OptionError(f'bootstrap: block is for kind="block", not for {kind!r}')
    longest = min(r.n for r in fit.records)
    if block is not None and not (is_whole(block) and 1 <= block <= longest):
        raise OptionError(f"bootstrap: block is a number of samples from 1 to {longest}, not {block!r}")
    common = common_to(fit, "bootstrap")
    resampler: Resampler
    if isinstance(fit.transcription, FilterError):
        if kind != "parametric":
            raise OptionError(
                f'bootstrap: kind="{kind}" is for coloured residuals; with process noise (FilterError) innovations are '
                'white where the model is right: kind="parametric" draws process noise and that of the sensors'
            )
        resampler = ProcessNoiseResampler.of(fit)
    elif kind == "block":
        block = block_length(fit) if block is None else int(block)
        resampler = Blocks.of(fit, block)
    else:
        resampler = Parametric.of(fit) if kind == "parametric" else ColouredNoise.of(fit)
    problem = _Resampled(**common, resampler=resampler, seed=int(seed))
    runs = run_all(problem, [{"draw": i} for i in range(n)], executor, progress, "bootstrap", deadline)
    good = [o for o in runs.outcomes.values() if o.status in ENDED_WELL]
    failed = len(runs.outcomes) - len(good)
    warnings = list(runs.warnings)
    if failed:
        first = next(o for o in runs.outcomes.values() if o not in good)
        warnings.append(
            f"{failed} of {len(runs.outcomes)} runs did not converge and are left out; the first, number "
            f"{first.index}: {first.status}: {first.message}"
        )
    names = list(fit.parameters)
    return Bootstrap(
        parameters=fit.parameters,
        estimates=np.array([[o.parameters[name] for name in names] for o in good]).reshape(-1, len(names)),
        kind=kind,
        block=block,
        n=int(n),
        failed=failed,
        status=runs.status,
        warnings=tuple(warnings),
        time=time.perf_counter() - begin,
    )


# Number of draws that are tried, and the largest range of their motion as a multiple of the recorded one.
_TRIED, _FAR = 5, 5.0


@dataclass(frozen=True, eq=False)
class ProcessNoiseResampler(Resampler):
    """Simulates the model with the recorded inputs and drawn process noise, and adds drawn sensor noise.

    Initial states are those of the fit, and drawn where they have a prior.
    """

    fit: FitResult | None = None

    @classmethod
    def of(cls, fit: FitResult) -> ProcessNoiseResampler:
        """Return the resampler of a fit; raise OptionError where other noise would carry the vehicle far away."""
        found = cls(**cls.parts(fit), fit=fit)
        far = float(np.median([found._reach(stream(0, i)) for i in range(_TRIED)]))
        if not far < _FAR:
            raise OptionError(
                f"bootstrap: with other process noise the motion goes {far:.2g} times as far as in the record: its "
                "inputs were responses of a pilot or a controller to the actual noise, and an unstable vehicle "
                "needs responses to the drawn noise. Use profile"
            )
        return found

    def draw(self, random: np.random.Generator) -> list[dict[str, _Array]]:
        """Return the outputs of all experiments."""
        assert self.fit is not None
        likelihood, _ = of_fit(self.fit)
        options, problem, names = likelihood.options, likelihood.problem, self.fit.model.output_names
        assert isinstance(options, FilterError)
        first = []
        for record in self.fit.records:
            for name in self.fit.model.state_names:
                prior = (options.initial or {}).get(name)
                first.append(random.normal(*prior) if prior else record.states[name][0])
        intervals = sum(t.size - 1 for t in self.times)
        noises = random.standard_normal(intervals * problem.noises)
        found = problem.simulate(likelihood.theta(likelihood.values), np.array(first), noises)
        known = self.fit.noise.known_sigmas(names)
        sigma = [known[n] if n in known else self.fit.parameters[f"sigma_{n}"].value for n in names]
        return [
            {
                n: np.where(there[n], y + s * random.standard_normal(y.size), np.nan)
                for n, y, s in zip(names, outputs, sigma, strict=True)
            }
            for (_, outputs), there in zip(found, self.there, strict=True)
        ]

    def _reach(self, random: np.random.Generator) -> float:
        """Return the range of a drawn motion as a multiple of the recorded one, in the output where it is greatest."""
        ratios = [0.0]
        for drawn, model, there in zip(self.draw(random), self.model, self.there, strict=True):
            for name, y in drawn.items():
                here = there[name]
                if here.any() and np.ptp(model[name][here]) > 0.0:
                    ratios.append(float(np.ptp(y[here]) / np.ptp(model[name][here])))
        return float(np.max(ratios))
