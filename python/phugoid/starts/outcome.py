"""One start of many: the problem that it is run on, and what comes of it."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from ..data.experiment import Experiment
from ..errors import DataError, MissingDependency, ModelError, OptionError
from ..estimation.estimate import estimate
from ..fit_result import FitResult
from ..modelling.model import Model
from ..noise.noise import Noise
from ..solvers import Newton
from ..transcription.filter_error import FilterError
from ..transcription.shooting import Transcription

__all__ = ["Outcome", "Problem"]

# Faults of the call, which every start would meet alike: they end the whole.
_FAULTS = (DataError, MissingDependency, ModelError, OptionError)


@dataclass(frozen=True, eq=False)
class Outcome:
    """What came of one start of `multistart`; small, without time histories.

    index           number of the start, from 0.
    start           name -> starting value, as drawn or given for this start.
    status          of the fit ("converged", "iteration limit", ...); "error" where the run raised an exception;
                    "killed" where the worker process that ran it was lost time and again.
    message         what the status means, or the text of the exception.
    log_likelihood  where the run ended; NaN where there is none.
    parameters      name -> value where the run ended, in the parameter's unit; empty where there is none.
    std_errors      name -> standard error; NaN for a parameter that is fixed, at a bound, or not identifiable.
    iterations      of the solver.
    time            s, of the whole run.
    """

    index: int
    start: Mapping[str, Any]
    status: str
    message: str = ""
    log_likelihood: float = float("nan")
    parameters: Mapping[str, float] = field(default_factory=dict)
    std_errors: Mapping[str, float] = field(default_factory=dict)
    iterations: int = 0
    time: float = 0.0

    @property
    def converged(self) -> bool:
        """Whether the solver met its tolerances."""
        return self.status == "converged"

    @property
    def at_optimum(self) -> bool:
        """Whether the run ended at an optimum: converged, where the data leave directions undetermined, or where only
        rounding kept it from its tolerances."""
        return self.status in ("converged", "unidentifiable", "acceptable") and math.isfinite(self.log_likelihood)


@dataclass(frozen=True, eq=False, repr=False)
class Problem:
    """What all starts share: the arguments of `estimate`; ``start`` holds what the starts themselves do not give."""

    model: Model
    experiments: tuple[Experiment, ...]
    transcription: Transcription | FilterError
    noise: Noise
    solver: Any = None
    start: Mapping[str, Any] = field(default_factory=dict)

    def fit(self, start: Mapping[str, Any]) -> FitResult:
        """Return the fit from a start."""
        return estimate(
            self.model,
            self.experiments,
            transcription=self.transcription,
            noise=self.noise,
            start={**self.start, **start},
            # A regression would make one start of many.
            solver=self.solver or Newton(regression=False),
        )

    def outcome(self, index: int, start: Mapping[str, Any]) -> Outcome:
        """Return the outcome of a start. Raises only what every start would, for a model, data or an option."""
        begin = time.perf_counter()
        try:
            fit = self.fit(start)
        except (*_FAULTS, KeyboardInterrupt, SystemExit):
            raise
        except BaseException as error:  # a panic in Rust is no Exception
            message = f"{type(error).__name__}: {error}"
            return Outcome(index, start, "error", message, time=time.perf_counter() - begin)
        return Outcome(
            index,
            start,
            fit.status,
            fit.message,
            float(fit.log_likelihood),
            fit.parameters.to_dict(),
            {name: e.std_error for name, e in fit.parameters.items()},
            fit.iterations,
            time.perf_counter() - begin,
        )

    def single_threaded(self) -> Problem:
        """Return the problem with one thread, for a worker beside others, unless a number of threads was asked for.

        The results are the same.
        """
        if isinstance(self.transcription, FilterError):  # which has none
            return self
        threads = self.transcription.threads or 1
        return replace(self, transcription=replace(self.transcription, threads=threads))
