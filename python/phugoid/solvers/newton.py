"""Newton's method in the Rust crate, made for these problems: the default solver."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from numbers import Integral

import numpy as np
from numpy.typing import NDArray

import phugoid._core as _core

from ..errors import OptionError
from .limits import check_limits
from .solution import Iteration, Solution

__all__ = ["COUNTED", "Newton"]

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
    parameters in a trust region; None does so where states are neither measured nor given and there are few samples.
    ``restarts``: where there are few samples and the parameters determine all initial states, the estimation is
    repeated from the best optimum so far with some of the parameters drawn within their bounds, until so many restarts
    in succession have brought no gain. None: ten, and one for each parameter. 0: none; the optimum is that next to the
    start.
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
        history: list[Iteration] = []

        def line(number: int, value: float, defect: float, promise: float, step: float, trials: int) -> Iteration:
            return Iteration(number, value, defect, promise, step, trials)

        def each(*entries: float) -> None:
            assert watch is not None
            watch(line(*entries[:6]))  # type: ignore[arg-type]

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
        history += [line(*entries[:6]) for entries in found.history]
        at = found.xi
        none = np.zeros(problem.n)
        return Solution(
            xi=at,
            multipliers=found.multipliers,
            bound_multipliers=(none, none),
            status=found.status,
            message=found.message,
            iterations=found.iterations,
            time=found.time,
            history=history,
            evaluations=dict(zip(COUNTED, found.evaluations, strict=True)),
            flops=found.flops,
        )


COUNTED = (
    "objective",
    "gradient",
    "constraints",
    "jacobian",
    "hessian",
    "gauss_newton",
    "factorizations",
    "solutions",
)
