"""The bootstrap: estimates from resampled data (Efron & Tibshirani 1993)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from numbers import Integral
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, OptionError
from ..estimation.estimate import estimate
from ..fit_result import FitResult
from ..parameters import Estimates, text_table
from ..solvers.limits import limited
from ..starts.collect import common_to, run_all
from ..starts.outcome import Outcome, Problem
from ..starts.starts import stream
from ..transcription.filter_error import FilterError
from .process_noise_bootstrap import ProcessNoiseResampler
from .resample import Blocks, ColouredNoise, Parametric, Resampler, block_length

if TYPE_CHECKING:
    from concurrent.futures import Executor

__all__ = ["Bootstrap", "bootstrap"]

_Array: TypeAlias = NDArray[np.float64]
Kind: TypeAlias = Literal["parametric", "coloured", "block"]

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
        if not isinstance(level, (int, float)) or not 0.0 < level < 1.0:
            raise OptionError(f"bootstrap: level is a number between 0 and 1, such as 0.95, not {level!r}")
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
        what = {
            "parametric": "white noise of the fit's model",
            "coloured": "noise with the autocorrelation of the residuals",
        }
        noise = what.get(self.kind, f"residuals in blocks of {self.block} samples")
        lines = [
            f"bootstrap, {self.status}: {len(self.estimates)} of {self.n} runs converged, {noise}; {self.time:.1f} s"
        ]
        intervals = self.intervals(level)
        rows = []
        for e in self.parameters.values():
            low, high = intervals[e.name]
            plain = f"{e.std_error:.2g}" if math.isfinite(e.std_error) else ""
            rows.append(
                [e.name, f"{e.value:.5g}", plain, f"{self.std_errors[e.name]:.2g}", f"{low:.5g}", f"{high:.5g}", e.unit]
            )
        heads = ["parameter", "estimate", "Cramér-Rao", "bootstrap", f"{100 * level:g} % from", "to", "unit"]
        return "\n".join([*lines, "", text_table(heads, rows, "lrrrrrl"), *(f"\nWarning: {w}" for w in self.warnings)])

    def __str__(self) -> str:
        return self.summary()

    def __repr__(self) -> str:
        return f"<Bootstrap ({self.kind}): {self.status}, {len(self.estimates)} of {self.n} runs converged>"


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
    if not _whole(n, 1):
        raise OptionError(f"bootstrap: n is a whole number from 1, not {n!r}")
    if not _whole(seed, 0):
        raise OptionError(f"bootstrap: seed is a whole number from 0, not {seed!r}")
    if kind not in _KINDS:
        raise OptionError(f"bootstrap: kind is one of {', '.join(map(repr, _KINDS))}, not {kind!r}")
    if block is not None and kind != "block":
        raise OptionError(f'bootstrap: block is for kind="block", not for {kind!r}')
    longest = min(r.n for r in fit.records)
    if block is not None and not (_whole(block, 1) and block <= longest):
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
    good = [o for o in runs.outcomes.values() if o.status in ("converged", "acceptable")]
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


def _whole(value: Any, least: int) -> bool:
    return isinstance(value, Integral) and not isinstance(value, bool) and int(value) >= least
