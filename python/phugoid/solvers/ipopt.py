"""Ipopt, through cyipopt."""

from __future__ import annotations

import importlib
import importlib.util
import math
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from numbers import Integral, Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..errors import EvaluationError, MissingDependency, OptionError
from .scaling import Scaling, scale_from_curvature, scale_from_data
from .solution import HINTS, Iteration, Solution

__all__ = ["Ipopt"]

_Array = NDArray[np.float64]

_WARM_PUSHES = (
    "warm_start_bound_push",
    "warm_start_bound_frac",
    "warm_start_slack_bound_push",
    "warm_start_slack_bound_frac",
    "warm_start_mult_bound_push",
)

# The exact Hessian takes over once an iteration changes the log-likelihood by less than this (so the parameters by
# a small part of their standard errors) and the scaled defects are below that.
_NEAR = 1.0
_NEAR_DEFECT = 1e-3
# Scaled anew when a standard deviation has come down by this factor.
_SMALLER = 100.0

# Ipopt's return codes, as statuses of ours.
_STATUS = {
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


@dataclass(frozen=True)
class Ipopt:
    """The interior-point solver Ipopt with exact derivatives.

    ``options`` reaches every option of Ipopt by its own name and has the last word. ``scaling`` False leaves
    scaling to Ipopt (``nlp_scaling_method``); ``gauss_newton`` False uses the exact Hessian from the start. Needs
    the package cyipopt.
    """

    max_iterations: int = 1000
    tolerance: float = 1e-9
    time_limit: float | None = None
    scaling: bool = True
    gauss_newton: bool = True
    options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        whole = isinstance(self.max_iterations, Integral) and not isinstance(self.max_iterations, bool)
        if not whole or self.max_iterations < 0:
            raise OptionError(f"Ipopt: max_iterations is a whole number from 0, not {self.max_iterations!r}")
        if not isinstance(self.tolerance, Real) or not 0 < self.tolerance < 1:
            raise OptionError(f"Ipopt: tolerance is a number between 0 and 1, not {self.tolerance!r}")
        if self.time_limit is not None and not (isinstance(self.time_limit, Real) and self.time_limit > 0):
            raise OptionError(f"Ipopt: time_limit is a positive number of seconds, not {self.time_limit!r}")
        if not isinstance(self.options, Mapping):
            raise OptionError(f"Ipopt: options are values by name, such as {{'tol': 1e-8}}, not {self.options!r}")

    def solve(
        self,
        problem: _core.Problem,
        xi: _Array,
        warm: Solution | None = None,
        watch: Callable[[Iteration], None] | None = None,
        states_known: bool = False,
    ) -> Solution:
        """Minimises from ``xi``; ``warm`` gives multipliers to start with, ``watch`` sees each iteration.

        In stages, unless ``warm`` or ``gauss_newton`` False asks for the last alone: with the Gauss-Newton Hessian
        until the log-likelihood hardly changes, then with the exact Hessian. Scaled by the data at first and by the
        curvature of the log-likelihood from then on; scaled anew each time that a standard deviation has come down
        far, or defects that are small beside the signal would be large beside the noise, and pass for a better fit.

        ``states_known`` makes no difference.

        Raises EvaluationError where a function is not finite at the start, MissingDependency without cyipopt.
        """
        wrapper = load_cyipopt()
        _check_start(problem, xi)
        started = time.perf_counter()
        scaling = scale_from_data(problem, xi)
        run = _Callbacks(problem, wrapper.CyIpoptEvaluationError, watch)
        x = xi
        multipliers: Mapping[str, Any] | None = warm.multipliers_by_name() if warm else None
        run.near = warm is not None or not self.gauss_newton
        with _interruptible(run):
            while True:
                final = run.near
                x, info = self._stage(wrapper, run, x, scaling, multipliers, started)
                if final or not run.goes_on(info["status"]):
                    break
                scaling = scale_from_curvature(problem, x, scaling)
                multipliers = info if run.near else None
        if run.error is not None:
            raise run.error
        status = "interrupted" if run.stop else _STATUS.get(info["status"], "failed")
        said = info["status_msg"]
        said = (said.decode() if isinstance(said, bytes) else str(said)).strip().rstrip(".")
        message = HINTS[status]
        if status in ("acceptable", "infeasible", "diverging", "failed"):
            message += f" (Ipopt: {said})"
        if status in ("failed", "infeasible") and problem.m:
            message += f"; {_worst_defect(problem, x, scaling)}"
        return Solution(
            xi=x,
            multipliers=np.asarray(info["mult_g"]),
            bound_multipliers=(np.asarray(info["mult_x_L"]), np.asarray(info["mult_x_U"])),
            status=status,
            message=message,
            iterations=len(run.history) and run.history[-1].number,
            time=time.perf_counter() - started,
            history=run.history,
        )

    def _stage(
        self,
        wrapper: Any,
        run: _Callbacks,
        xi: _Array,
        scaling: Scaling,
        multipliers: Mapping[str, Any] | None,
        started: float,
    ) -> tuple[_Array, dict[str, Any]]:
        """One run of Ipopt."""
        problem = run.problem
        lower, upper = problem.bounds()
        zeros = np.zeros(problem.m)
        nlp = wrapper.Problem(n=problem.n, m=problem.m, problem_obj=run, lb=lower, ub=upper, cl=zeros, cu=zeros)
        run.begin_stage(xi)
        self._configure(nlp, scaling, multipliers is not None, run, started)
        start = {}
        if multipliers is not None:
            start = {
                "lagrange": multipliers["mult_g"],
                "zl": multipliers["mult_x_L"],
                "zu": multipliers["mult_x_U"],
            }
        x, info = nlp.solve(xi, **start)
        return np.asarray(x), info

    def _configure(self, nlp: Any, scaling: Scaling, warm: bool, run: _Callbacks, started: float) -> None:
        options: dict[str, Any] = {
            "print_level": 0,
            "sb": "yes",
            "max_iter": max(self.max_iterations - run.before, 0),
            "tol": self.tolerance,
            "linear_solver": "mumps",
            # METIS: three times faster on these long and narrow problems than the default ordering.
            "mumps_pivot_order": 5,
            # The only inequalities are bounds far away: nothing is won by adapting the barrier.
            "mu_strategy": "monotone",
            # Ipopt widens bounds a little; what comes back lies within the user's.
            "honor_original_bounds": "yes",
        }
        if self.time_limit is not None:
            options["max_wall_time"] = max(self.time_limit - (time.perf_counter() - started), 1e-3)
        if self.scaling:
            options["nlp_scaling_method"] = "user-scaling"
            nlp.set_problem_scaling(scaling.objective, scaling.variables, scaling.constraints)
        if not run.near:
            # Gauss-Newton needs no multipliers: their estimates would cost a factorisation.
            options["constr_mult_init_max"] = 0.0
        if warm:
            options["warm_start_init_point"] = "yes"
            # The point is good: do not push it off its bounds, nor start the barrier over.
            options.update(dict.fromkeys(_WARM_PUSHES, 1e-9), mu_init=1e-9)
        options.update(self.options)
        for name, value in options.items():
            try:
                nlp.add_option(name, value)
            except TypeError:
                if name == "max_wall_time":  # Ipopt before 3.14
                    nlp.add_option("max_cpu_time", value)
                    continue
                raise OptionError(f"Ipopt has no option '{name}' that takes {value!r}") from None


class _Callbacks:
    """The program as cyipopt wants it, and what happened on the way."""

    def __init__(
        self, problem: _core.Problem, failure: type[Exception], watch: Callable[[Iteration], None] | None
    ) -> None:
        self.problem = problem
        self.failure = failure
        self.watch = watch
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
        """Iterations are counted on from the stage before."""
        self.before = self.history[-1].number if self.history else 0
        self.rescale = False
        self._roots_at_start = xi[self._roots].copy()

    def goes_on(self, code: int) -> bool:
        """Whether another stage follows one that ended with Ipopt's ``code``."""
        if self.stop or self.error is not None or _STATUS.get(code) in ("iteration limit", "time limit"):
            return False
        if not self.rescale:
            self.near = True  # arrived, or stuck: the exact Hessian decides
        return True

    def _finite(self, values: _Array | None) -> _Array:
        if values is None:
            raise self.failure()
        return values

    def objective(self, x: _Array) -> float:
        value = self.problem.objective(x)
        if not math.isfinite(value):
            raise self.failure()
        return value

    def gradient(self, x: _Array) -> _Array:
        self._latest = x[self._roots].copy()  # Ipopt asks for the gradient at accepted points
        return self._finite(self.problem.gradient(x))

    def constraints(self, x: _Array) -> _Array:
        return self._finite(self.problem.constraints(x))

    def jacobianstructure(self) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
        return self._jacobian_structure

    def jacobian(self, x: _Array) -> _Array:
        return self._finite(self.problem.jacobian(x))

    def hessianstructure(self) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
        return self._hessian_structure

    def hessian(self, x: _Array, lagrange: _Array, obj_factor: float) -> _Array:
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
def _interruptible(callbacks: _Callbacks) -> Iterator[None]:
    """Ctrl-C ends the run after the iteration in progress; the point reached is kept. A second one is as ever."""
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


def _check_start(problem: _core.Problem, xi: _Array) -> None:
    fine = (
        math.isfinite(problem.objective(xi))
        and problem.constraints(xi) is not None
        and problem.jacobian(xi) is not None
        and problem.gradient(xi) is not None
    )
    if not fine:
        what = problem.explain(xi) or "a function of the model is not finite"
        raise EvaluationError(f"at the starting point, {what}; give other start values, or bounds")


def _worst_defect(problem: _core.Problem, xi: _Array, scaling: Scaling) -> str:
    defects = problem.constraints(xi)
    if defects is None:
        return problem.explain(xi) or "a function of the model is not finite there"
    worst = int(np.argmax(np.abs(defects) * scaling.constraints))
    return f"the largest is the {problem.constraint_name(worst)}: {defects[worst]:.2e}"


def load_cyipopt() -> Any:
    """cyipopt's extension module, without the rest of cyipopt: that imports scipy.optimize, ten times as long.

    Raises MissingDependency where cyipopt is not installed or its Ipopt cannot be loaded.
    """
    try:
        return _extension()
    except ImportError as error:
        raise MissingDependency(
            f'the solver Ipopt needs cyipopt ({error}): pip install "phugoid[ipopt]", or see README'
        ) from error


def _extension() -> Any:
    if "cyipopt" in sys.modules:
        return importlib.import_module("cyipopt.ipopt_wrapper")
    spec = importlib.util.find_spec("cyipopt")
    if spec is None:
        raise ModuleNotFoundError("No module named 'cyipopt'")
    # The bare package: a path, with nothing executed. A later `import cyipopt` is the full one.
    sys.modules["cyipopt"] = importlib.util.module_from_spec(spec)
    try:
        return importlib.import_module("cyipopt.ipopt_wrapper")
    except ModuleNotFoundError:
        return importlib.import_module("ipopt_wrapper")  # before 1.7
    finally:
        del sys.modules["cyipopt"]
