"""The callbacks of cyipopt, and the record of the iterations."""

from __future__ import annotations

import math
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _core
from .limits import Deadline
from .solution import Iteration

__all__ = ["STATUS", "Callbacks", "interruptible"]

_Array = NDArray[np.float64]


# The exact Hessian takes over once an iteration changes the log-likelihood by less than this (so the parameters by
# a small part of their standard errors) and the scaled defects are below that.
_NEAR = 1.0
_NEAR_DEFECT = 1e-3
# The program is scaled again when a standard deviation has come down by this factor.
_SMALLER = 100.0
# Ipopt's return codes, as statuses of ours.
STATUS = {
    0: "converged",
    1: "acceptable",
    2: "infeasible",
    3: "failed",  # search direction becomes too small
    4: "diverging",
    5: "interrupted",
    6: "converged",  # feasible point of a square problem
    -1: "iteration limit",
    -2: "failed",  # restoration failed
    -3: "failed",  # error in step computation
    -4: "time limit",
    -5: "time limit",
    -13: "failed",  # invalid number detected
}


class Callbacks:
    """The functions of the program as cyipopt calls them, and the record of the iterations."""

    def __init__(
        self,
        problem: _core.Problem,
        failure: type[Exception],
        watch: Callable[[Iteration], None] | None,
        deadline: Deadline,
        pressed: Callable[[], bool] | None = None,
    ) -> None:
        self.problem = problem
        self.failure = failure
        self.watch = watch
        self._deadline, self._pressed = deadline, pressed
        self.late = False
        """Whether the time limit ended it."""
        self.history: list[Iteration] = []
        self.before = 0
        """Iterations of earlier stages."""
        self.near = False
        """Whether the optimum is near and the exact Hessian in use."""
        self.rescale = False
        """Whether the noise has come down so far that the scaling no longer serves."""
        self.stop = False
        self.error: BaseException | None = None
        # 1/sigma of the outputs, in xi
        self._roots = problem.precision_roots
        self._roots_at_start = np.empty(0)
        self._latest = np.empty(0)
        self._jacobian_structure = problem.jacobian_structure()
        self._hessian_structure = problem.hessian_structure()

    def begin_stage(self, xi: _Array) -> None:
        """Begin a stage: iterations are counted on from the stage before."""
        self.before = self.history[-1].number if self.history else 0
        self.rescale = False
        self._roots_at_start = xi[self._roots].copy()

    def goes_on(self, code: int) -> bool:
        """Return whether another stage follows one that ended with Ipopt's ``code``."""
        if self.stop or self.late or self.error is not None or STATUS.get(code) in ("iteration limit", "time limit"):
            return False
        if not self.rescale:
            self.near = True  # arrived, or stuck: the exact Hessian decides
        return True

    def _ask(self) -> None:
        """Refuse all evaluations once the run is to end: Ipopt then stops at its present point."""
        self.stop = self.stop or (self._pressed is not None and self._pressed())
        self.late = self.late or self._deadline.passed()
        if self.stop or self.late:
            raise self.failure()

    def _finite(self, values: _Array | None) -> _Array:
        if values is None:
            raise self.failure()
        return values

    def objective(self, x: _Array) -> float:
        self._ask()
        value = self.problem.objective(x)
        if not math.isfinite(value):
            raise self.failure()
        return value

    def gradient(self, x: _Array) -> _Array:
        self._ask()
        self._latest = x[self._roots].copy()  # Ipopt asks for the gradient at accepted points
        return self._finite(self.problem.gradient(x))

    def constraints(self, x: _Array) -> _Array:
        self._ask()
        return self._finite(self.problem.constraints(x))

    def jacobianstructure(self) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
        return self._jacobian_structure

    def jacobian(self, x: _Array) -> _Array:
        self._ask()
        return self._finite(self.problem.jacobian(x))

    def hessianstructure(self) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
        return self._hessian_structure

    def hessian(self, x: _Array, lagrange: _Array, obj_factor: float) -> _Array:
        self._ask()
        if self.near:
            return self._finite(self.problem.hessian(x, obj_factor, lagrange))
        return self._finite(self.problem.gauss_newton(x, obj_factor))

    def intermediate(
        self,
        alg_mod: int,
        iter_count: int,
        obj_value: float,
        inf_pr: float,
        inf_du: float,
        mu: float,
        d_norm: float,
        regularization_size: float,
        alpha_du: float,
        alpha_pr: float,
        ls_trials: int,
    ) -> bool:
        if iter_count == 0 and self.before:
            return not self.stop  # the last point of the stage before
        line = Iteration(self.before + iter_count, -obj_value, inf_pr, inf_du, alpha_pr, ls_trials)
        arrived = False
        if not self.near and self.history:
            change = abs(line.log_likelihood - self.history[-1].log_likelihood)
            arrived = change < _NEAR and inf_pr < _NEAR_DEFECT
            self.rescale = bool(np.any(self._latest > _SMALLER * self._roots_at_start))
        self.history.append(line)
        try:
            if self.watch is not None:
                self.watch(line)
        except KeyboardInterrupt:
            self.stop = True
        except Exception as error:  # an error of the user's callback must not vanish in C
            self.error = error
            return False
        self.near = self.near or (arrived and not self.rescale)
        return not (self.stop or arrived or self.rescale)


@contextmanager
def interruptible(callbacks: Callbacks) -> Iterator[None]:
    """Let Ctrl-C end the run after the iteration in progress, keeping the point reached; a second one raises."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def on_interrupt(number: int, frame: Any) -> None:
        callbacks.stop = True
        signal.signal(signal.SIGINT, before)

    before = signal.signal(signal.SIGINT, on_interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
