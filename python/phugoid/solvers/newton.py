"""The default solver, Newton's method in the Rust crate, and a quasi-Newton method with bounds for few unknowns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from numbers import Integral

import numpy as np
from numpy.typing import NDArray

import phugoid._core as _core

from ..errors import OptionError
from . import Deadline, Iteration, Solution, check_limits

__all__ = ["Minimum", "Newton", "bounded_step", "minimise", "solution_of"]

_Array = NDArray[np.float64]


@dataclass(frozen=True)
class Newton:
    """Gauss-Newton with profiled standard deviations, then Newton with the exact Hessian.

    Its linear algebra exploits that a trajectory is a chain of segments, so an iteration costs time proportional to
    the length of the record. It needs no other package.

    ``tolerance``: distance from the optimum, in standard errors, at which the last step is taken (what is left
    after it is about the square of that).
    ``regression``: start with a regression of the parameters on the measured states and outputs; None does so where
    every state is measured or its start is given. Where the model is not linear in its parameters, the linear ones are
    projected out (Golub & Pereyra 1973) and other start values are tried, too, unless a fit is the start.
    ``gauss_newton`` False uses the exact Hessian from the start.
    ``paths``: start with steps between paths that satisfy the equations, integrated again after each step, with the
    parameters in a trust region; None does so where states are neither measured nor given and there are few samples,
    and, from the fit of another model, where 20 iterations do not lead near an optimum.
    ``restarts``: where there are few samples and the parameters determine all initial states, the estimation is
    repeated from the best optimum so far with some of the parameters drawn within their bounds, until so many restarts
    in succession have brought no gain. None: twenty, and two for each parameter, or eight in succession that end at the
    same optimum; the latter do not count where the model matches an output worse than a constant does. 0: none; the
    optimum is that next to the start. In any other estimation by collocation a number asks for at most so many restarts
    where neither the start values nor the other ways from them lead to an optimum that matches the outputs well: their
    parameters are the start values multiplied by random factors from a tenth to ten. None: none.
    ``time_limit`` in seconds, for the whole estimation; the best point so far is the result.
    """

    max_iterations: int = 200
    tolerance: float = 1e-4
    time_limit: float | None = None
    regression: bool | None = None
    gauss_newton: bool = True
    paths: bool | None = None
    restarts: int | None = None

    def __post_init__(self) -> None:
        check_limits("Newton", self.max_iterations, self.tolerance, self.time_limit)
        for name in ("regression", "paths"):
            if getattr(self, name) not in (None, True, False):
                raise OptionError(f"Newton: {name} is True, False or None, not {getattr(self, name)!r}")
        if self.restarts is not None and (not isinstance(self.restarts, Integral) or self.restarts < 0):
            raise OptionError(f"Newton: restarts is a whole number from 0, or None, not {self.restarts!r}")

    def solve(
        self,
        problem: _core.Problem,
        xi: _Array,
        warm: Solution | None = None,
        watch: Callable[[Iteration], None] | None = None,
        states_known: bool = False,
        near: bool = False,
        sparse: bool = False,
        stop: Callable[[], bool] | None = None,
    ) -> Solution:
        """Minimise from ``xi``; ``warm`` gives start values of multipliers, ``watch`` is called with each iteration,
        ``stop`` now and then, and ends the run where it returns True.

        ``states_known``: the states in ``xi`` are measured, so that a regression on them makes sense.
        ``sparse``: they are not, and there are few samples, so that steps between consistent paths make sense.
        ``near``: they and the parameters are those of a fit, so that there is no need to look elsewhere.

        Raises EvaluationError where a function is not finite at the start.
        """

        def each(*entries: float) -> None:
            assert watch is not None
            watch(Iteration(*entries[:6]))  # type: ignore[arg-type]

        regression = states_known if self.regression is None else self.regression
        found = _core.newton(
            problem,
            xi,
            warm.multipliers if warm else None,
            int(self.max_iterations),
            float(self.tolerance),
            None if self.time_limit is None else float(self.time_limit),
            self.gauss_newton,
            bool(regression and not warm),
            not near,
            each if watch is not None else None,
            stop,
            bool((sparse if self.paths is None else self.paths) and not regression and not warm),
        )
        return solution_of(found)


_COUNTED = (
    "objective",
    "gradient",
    "constraints",
    "jacobian",
    "hessian",
    "gauss_newton",
    "factorizations",
    "solutions",
)


def solution_of(found: _core.NewtonSolution) -> Solution:
    """Return the solution of the core's solver."""
    low, high = found.bound_multipliers
    return Solution(
        xi=found.xi,
        multipliers=found.multipliers,
        bound_multipliers=(low, high),
        status=found.status,
        message=found.message,
        iterations=found.iterations,
        time=found.time,
        history=[Iteration(*line[:6]) for line in found.history],
        evaluations=dict(zip(_COUNTED, found.evaluations, strict=True)),
        flops=found.flops,
    )


# Value and gradient, or None where there is none.
Function = Callable[[_Array], "tuple[float, _Array] | None"]

_SUFFICIENT, _FLAT = 1e-4, 0.9  # of weak Wolfe conditions
_TRIALS = 30


@dataclass
class Minimum:
    """The end point of `minimise`."""

    x: _Array
    value: float
    gradient: _Array
    metric: _Array
    status: str
    iterations: int
    history: list[Iteration] = field(default_factory=list)


def bounded_step(gradient: _Array, metric: _Array, low: _Array, high: _Array) -> _Array:
    """Return the minimiser of g d + d B d / 2 within ``low <= d <= high``, B positive definite, by an active-set
    method.

    A variable that a step would take past its bound is put on it, and is not freed again: near the solution, where
    it matters, few are.
    """
    step = np.clip(np.zeros_like(gradient), low, high)
    free = (low < high) & ~((low >= 0) & (gradient > 0)) & ~((high <= 0) & (gradient < 0))
    while free.any():
        rest = gradient + metric @ np.where(free, 0.0, step)
        # In units in which the diagonal is one: elimination of a badly scaled matrix would lose digits.
        scale = 1 / np.sqrt(np.diag(metric)[free])
        scaled = metric[np.ix_(free, free)] * np.outer(scale, scale)
        step[free] = scale * np.linalg.solve(scaled, -scale * rest[free])
        past = free & ((step < low) | (step > high))
        if not past.any():
            break
        step[past] = np.clip(step, low, high)[past]
        free &= ~past
    return step


def minimise(
    function: Function,
    x: _Array,
    first: tuple[float, _Array],
    metric: _Array,
    bounds: tuple[_Array, _Array],
    *,
    tolerance: float,
    max_iterations: int,
    watch: Callable[[Iteration], None] | None = None,
    number: int = 0,
) -> Minimum:
    """Minimise ``function`` from ``x``, where it is ``first``, by BFGS with Powell's damping, from the Hessian
    ``metric`` (Nocedal and Wright, *Numerical Optimization*, 2006, chapters 6 and 18).

    Ends where a step promises less than ``tolerance``. An interrupt, and the limit in force, end with the best point so
    far.
    """
    value, gradient = first
    lower, upper = bounds
    end = Minimum(x.copy(), value, gradient, metric.copy(), "iteration limit", number)
    try:
        while end.iterations < number + max_iterations:
            step = bounded_step(end.gradient, end.metric, lower - end.x, upper - end.x)
            slope = float(end.gradient @ step)
            promise = -0.5 * slope
            if not promise >= tolerance:
                end.status = "converged"
                break
            found = _search(function, end, step, slope, lower, upper)
            if found is None:
                # A metric without progress is reset once.
                start = np.diag(np.diag(metric))
                if np.array_equal(end.metric, start):
                    end.status = "failed"
                    break
                end.metric = start
                continue
            size, there, (new_value, new_gradient), trials = found
            end.metric = _updated(end.metric, there - end.x, new_gradient - end.gradient)
            end.x, end.value, end.gradient = there, new_value, new_gradient
            end.iterations += 1
            line = Iteration(end.iterations, -end.value, 0.0, promise, size, trials)
            end.history.append(line)
            if watch is not None:
                watch(line)
    except KeyboardInterrupt:
        end.status = Deadline(None).ended()
    return end


def _search(
    function: Function, at: Minimum, step: _Array, slope: float, lower: _Array, upper: _Array
) -> tuple[float, _Array, tuple[float, _Array], int] | None:
    """Find a step length by bisection; return (length, point, value and gradient there, trials)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        room = np.where(step > 0, (upper - at.x) / step, np.where(step < 0, (lower - at.x) / step, np.inf))
    longest = max(1.0, float(np.min(room)))
    low, high, size = 0.0, np.inf, 1.0
    best = None
    for trial in range(1, _TRIALS + 1):
        point = np.clip(at.x + size * step, lower, upper)
        here = function(point)
        # Rounding of the value must not refuse the last steps.
        slack = 1e-13 * abs(at.value)
        if here is None or here[0] > at.value + _SUFFICIENT * size * slope + slack:
            if best is not None:
                return best
            high = size
            size = 0.5 * (low + high) if here is not None else 0.25 * size
            continue
        best = (size, point, here, trial)
        if float(here[1] @ step) >= _FLAT * slope or size >= longest or high < np.inf:
            return best
        low = size
        size = min(2.0 * size, longest)
    return best


def _updated(metric: _Array, s: _Array, y: _Array) -> _Array:
    """Return the BFGS update, damped so that it stays positive definite."""
    bs = metric @ s
    sbs = float(s @ bs)
    if not sbs > 0:
        return metric
    sy = float(s @ y)
    if sy < 0.2 * sbs:
        share = 0.8 * sbs / (sbs - sy)
        y = share * y + (1 - share) * bs
        sy = float(s @ y)
    updated: _Array = metric - np.outer(bs, bs) / sbs + np.outer(y, y) / sy
    return 0.5 * (updated + updated.T)
