"""Starts of an estimation: what they are drawn from, what all of them share, and the outcome of each."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..data.experiment import Experiment
from ..errors import DataError, MissingDependency, ModelError, OptionError, PhugoidError, did_you_mean
from ..filter_error import FilterError
from ..fit_result import FitResult
from ..initialisation import check_names, parameter_start, spread, state_start
from ..modelling.model import Model
from ..modelling.noise import Noise, Sigma
from ..solvers.newton import Newton
from ..transcription import Transcription
from . import estimate_from_afar

__all__ = ["Draw", "Given", "Outcome", "Problem", "Range", "Uniform", "given", "plain", "stream", "uniform"]

# Faults of the call, which every start would meet alike: they end the whole.
_FAULTS = (DataError, MissingDependency, ModelError, OptionError)


@dataclass(frozen=True, eq=False)
class Outcome:
    """The outcome of one start of `multistart`; small, without time histories.

    index           number of the start, from 0.
    start           name -> starting value, as drawn or given for this start.
    status          of the fit ("converged", "iteration limit", ...); "error" where the run raised an exception;
                    "killed" where the worker process that ran it was lost time and again.
    message         what the status means, or the text of the exception.
    log_likelihood  where the run ended, of the integrated model where the fit has that (``integrated_log_likelihood``);
                    NaN where there is none.
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
        """Return whether the solver met its tolerances."""
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
        return estimate_from_afar(
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
        except BaseException as error:  # a panic in Rust is not an Exception
            message = f"{type(error).__name__}: {error}"
            return Outcome(index, start, "error", message, time=time.perf_counter() - begin)
        return Outcome(
            index,
            start,
            fit.status,
            fit.message,
            fit.ranked_log_likelihood,
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


Range = tuple[float, float]
Draw = Callable[[int, np.random.Generator], Mapping[str, Any]]


def stream(seed: int, index: int) -> np.random.Generator:
    """Return the random numbers of one start, which do not depend on other starts."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))


@dataclass(frozen=True)
class Uniform:
    """Starts drawn uniformly from ranges, by name in the model's order: parameters, sigmas, states.

    Of ``logarithmic`` names it is the logarithm that is drawn uniformly.
    """

    ranges: Mapping[str, Range]
    seed: int
    logarithmic: frozenset[str] = frozenset()

    def __call__(self, index: int) -> dict[str, Any]:
        """Return the start of that number."""
        random = stream(self.seed, index)

        def drawn(name: str, low: float, high: float) -> float:
            if name in self.logarithmic:
                return float(np.exp(random.uniform(np.log(low), np.log(high))))
            return float(random.uniform(low, high))

        # Rounding may carry a draw one bit past the ends.
        return {name: min(max(drawn(name, *pair), pair[0]), pair[1]) for name, pair in self.ranges.items()}


@dataclass(frozen=True)
class Given:
    """Starts as they were given."""

    starts: Sequence[dict[str, Any]]

    def __call__(self, index: int) -> dict[str, Any]:
        """Return the start of that number."""
        return self.starts[index]


def uniform(problem: Problem, ranges: Any, seed: int) -> Uniform:
    """Draw starts from ranges. Raises ModelError or OptionError for a range that cannot be right."""
    if not isinstance(ranges, Mapping) or not ranges:
        raise OptionError(f"ranges: give (low, high) by name, such as {{'Mw': (-1, 1)}}, not {ranges!r}")
    model = problem.model
    sigmas = [f"sigma_{name}" for name in model.output_names]
    known = [
        *dict.fromkeys([*model.parameter_names, *sigmas, *problem.noise.names(model.output_names)]),
        *model.state_names,
    ]
    for name in ranges:
        if name not in known:
            raise ModelError(f"ranges: '{name}' is not a parameter, sigma or state.{did_you_mean(str(name), known)}")
    declared = model.declared_parameters
    checked: dict[str, Range] = {}
    for name in known:
        if name not in ranges or name in checked:
            continue
        low, high = checked[name] = _pair(name, ranges[name])
        bounds = (-math.inf, math.inf)
        if name in declared:
            if declared[name].fixed:
                raise ModelError(
                    f"ranges: '{name}' is fixed at {declared[name].start:g}: take it out of the ranges, or free it"
                )
            bounds = declared[name].bounds
        elif name in sigmas:
            bounds = _sigma_bounds(problem, name, low)
        if not bounds[0] <= low < high <= bounds[1]:
            raise ModelError(
                f"ranges: '{name}' from {low:g} to {high:g} reaches outside its bounds "
                f"({bounds[0]:g}, {bounds[1]:g}); move one of them"
            )
    logarithmic = {n for n, p in declared.items() if p.transform == "log" and n in checked and checked[n][0] > 0.0}
    drawn = Uniform(checked, seed, frozenset(logarithmic))
    _check(problem, drawn(0), _spreads(problem))
    return drawn


def given(problem: Problem, starts: Any, n: int | None, seed: int) -> Given:
    """Take starts from a sequence, or from a function of number and random numbers, each checked."""
    if callable(starts):
        made: list[Any] = [starts(i, stream(seed, i)) for i in range(1000 if n is None else n)]
    elif isinstance(starts, Sequence) and not isinstance(starts, str) and starts:
        if n is not None and n > len(starts):
            raise OptionError(f"starts: there are {len(starts)}, but n = {n}: leave n out, or give more")
        made = list(starts)[:n]
    else:
        raise OptionError(
            "starts: give a list of start values by name, such as [{'Mw': 0.1}, {'Mw': 0.5}], "
            f"or a function (number, random generator) -> values by name, not {starts!r}"
        )
    spreads = _spreads(problem)
    for i, start in enumerate(made):
        if not isinstance(start, Mapping):
            raise OptionError(f"starts: number {i} holds no values by name, but is {start!r}")
        made[i] = {name: plain(value) for name, value in start.items()}
        try:
            _check(problem, made[i], spreads)
        except PhugoidError as error:
            raise type(error)(f"starts: number {i}: {error}") from None
    return Given(made)


def _spreads(problem: Problem) -> dict[str, float]:
    return {name: spread(problem.experiments, name) for name in problem.model.output_names}


def _check(problem: Problem, own: Mapping[str, Any], spreads: Mapping[str, float]) -> None:
    """Raise what `estimate` would for a start, without its work."""
    model, start = problem.model, {**problem.start, **own}
    check_names(model, start, problem.experiments, problem.noise.names(model.output_names))
    parameters = parameter_start(model, start)
    problem.noise.resolve(model.output_names, spreads, start)
    if not start.keys().isdisjoint(model.state_names):
        for experiment in problem.experiments:
            state_start(model, experiment, experiment.t, parameters, start)


def plain(value: Any) -> Any:
    """Convert to a float or an array of floats where possible; leave anything else for the checks to refuse."""
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        return value
    return float(array) if array.ndim == 0 else array


def _pair(name: str, value: Any) -> Range:
    try:
        low, high = (float(v) for v in value)
    except (TypeError, ValueError):
        raise OptionError(f"ranges: '{name}' is a pair of numbers (low, high), not {value!r}") from None
    if not (math.isfinite(low) and math.isfinite(high)):
        raise OptionError(f"ranges: '{name}' from {low:g} to {high:g} is not finite: nothing can be drawn from it")
    if low > high:
        raise OptionError(f"ranges: '{name}' from {low:g} to {high:g} is reversed: give (low, high)")
    if low == high:
        raise OptionError(f"ranges: '{name}' from {low:g} to {high:g} leaves no room: use start={{'{name}': {low:g}}}")
    return low, high


def _sigma_bounds(problem: Problem, name: str, low: float) -> Range:
    spec = problem.noise.sigma.get(name.removeprefix("sigma_"), Sigma())
    if not isinstance(spec, Sigma):
        raise ModelError(f"ranges: '{name}' is known ({spec:g}): take it out of the ranges")
    if low <= 0:
        raise OptionError(f"ranges: '{name}' starts at {low:g}: a standard deviation is positive")
    return spec.bounds or (0.0, math.inf)
