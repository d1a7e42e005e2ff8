"""Ipopt, through cyipopt."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

import phugoid._core as _core

from ..errors import EvaluationError, OptionError
from . import HINTS, Deadline, Iteration, Solution, check_limits, interrupts
from .ipopt_callbacks import (
    STATUS,
    Callbacks,
    Scaling,
    load_cyipopt,
    scale_from_curvature,
    scale_from_data,
)

__all__ = ["Ipopt"]

_Array = NDArray[np.float64]

_WARM_PUSHES = (
    "warm_start_bound_push",
    "warm_start_bound_frac",
    "warm_start_slack_bound_push",
    "warm_start_slack_bound_frac",
    "warm_start_mult_bound_push",
)
# Ipopt's tolerances of the unscaled program, besides `tol` of the scaled one.
_UNSCALED_TOLERANCES = (
    "dual_inf_tol",
    "constr_viol_tol",
    "compl_inf_tol",
    "acceptable_dual_inf_tol",
    "acceptable_constr_viol_tol",
    "acceptable_compl_inf_tol",
)
_NO_LIMIT = 1e300


@dataclass(frozen=True)
class Ipopt:
    """The interior-point solver Ipopt with exact derivatives.

    ``options`` sets every option of Ipopt by its own name and has precedence. ``scaling`` False leaves scaling to Ipopt
    (``nlp_scaling_method``); ``gauss_newton`` False uses the exact Hessian from the start.
    ``time_limit`` in seconds, for the whole estimation. It is checked between evaluations and iterations: a
    factorisation by Ipopt's linear solver (MUMPS) in progress is not interrupted, nor is it by Ctrl-C, so that a run
    may exceed its limit by the time of one factorisation, seconds with a thousand parameters. Needs the package
    cyipopt.
    """

    max_iterations: int = 1000
    tolerance: float = 1e-9
    time_limit: float | None = None
    scaling: bool = True
    gauss_newton: bool = True
    options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_limits("Ipopt", self.max_iterations, self.tolerance, self.time_limit)
        if not isinstance(self.options, Mapping):
            raise OptionError(f"Ipopt: options are values by name, such as {{'tol': 1e-8}}, not {self.options!r}")

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
        ``stop`` at each evaluation, and ends the run where it returns True.

        In stages, unless ``warm`` or ``gauss_newton`` False asks for the last alone: with the Gauss-Newton Hessian
        until the log-likelihood hardly changes, then with the exact Hessian. Scaled by the data at first and by the
        curvature of the log-likelihood from then on; scaled again each time that a standard deviation has come down
        far, or defects that are small beside the signal would be large beside the noise, and look like a better fit.

        ``states_known`` and ``near`` make no difference.

        Raises EvaluationError where a function is not finite at the start, MissingDependency without cyipopt.
        """
        wrapper = load_cyipopt()
        _check_start(problem, xi)
        started = time.perf_counter()
        deadline = Deadline(self.time_limit)
        if deadline.passed():
            none = np.zeros(problem.n)
            return Solution(xi, np.zeros(problem.m), (none, none), "time limit", HINTS["time limit"], 0, 0.0)
        scaling = scale_from_data(problem, xi)
        run = Callbacks(problem, wrapper.CyIpoptEvaluationError, watch, deadline)
        x = xi
        multipliers: Mapping[str, Any] | None = warm.multipliers_by_name() if warm else None
        run.near = warm is not None or not self.gauss_newton
        with interrupts() as pressed:
            run.pressed = lambda: pressed() > 0 or (stop is not None and stop())
            while True:
                final = run.near
                x, info = self._stage(wrapper, run, x, scaling, multipliers, started)
                if final or not run.goes_on(info["status"]):
                    break
                scaling = scale_from_curvature(problem, x, scaling)
                multipliers = info if run.near else None
        if run.error is not None:
            raise run.error
        status = STATUS.get(info["status"], "failed")
        if run.stop:
            status = "interrupted"
        elif run.late:
            status = "time limit"
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
        run: Callbacks,
        xi: _Array,
        scaling: Scaling,
        multipliers: Mapping[str, Any] | None,
        started: float,
    ) -> tuple[_Array, dict[str, Any]]:
        """Run Ipopt once."""
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

    def _configure(self, nlp: Any, scaling: Scaling, warm: bool, run: Callbacks, started: float) -> None:
        options: dict[str, Any] = {
            "print_level": 0,
            "sb": "yes",
            "max_iter": max(self.max_iterations - run.before, 0),
            "tol": self.tolerance,
            "linear_solver": "mumps",
            # METIS: three times faster on these long and narrow problems than the default ordering.
            "mumps_pivot_order": 5,
            # The only inequalities are distant bounds: adapting the barrier gains nothing.
            "mu_strategy": "monotone",
            # Ipopt widens bounds a little; its result is to lie within the user's.
            "honor_original_bounds": "yes",
        }
        if self.time_limit is not None:
            # More than Ipopt takes is no limit.
            left = self.time_limit - (time.perf_counter() - started)
            options["max_wall_time"] = min(max(left, 1e-3), 1e20)
        if self.scaling:
            options["nlp_scaling_method"] = "user-scaling"
            # Tolerances of the unscaled program depend on the user's units: the scaled one alone decides. For the
            # same reason a bound is infinite only where it is far beyond what any unit makes of a finite one.
            options.update(dict.fromkeys(_UNSCALED_TOLERANCES, _NO_LIMIT))
            options.update(nlp_lower_bound_inf=-_NO_LIMIT, nlp_upper_bound_inf=_NO_LIMIT)
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
