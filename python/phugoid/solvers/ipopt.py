"""Ipopt, through cyipopt: its Python module, the scaling of the problem, the callbacks that evaluate it, the solver."""

from __future__ import annotations

import importlib
import importlib.util
import math
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

import phugoid._core as _core

from ..errors import EvaluationError, MissingDependency, OptionError
from . import HINTS, Deadline, Iteration, Solution, check_limits, interrupts

__all__ = ["Ipopt"]

_Array = NDArray[np.float64]


def load_cyipopt() -> Any:
    """Return cyipopt's extension module alone; the full package also imports scipy.optimize, which takes ten times as
    long.

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


@dataclass(frozen=True)
class Scaling:
    """Factors that variables, constraints and the objective are multiplied by."""

    variables: _Array
    constraints: _Array
    objective: float


def scale_from_data(problem: _core.Problem, xi: _Array) -> Scaling:
    """Return the scaling for the steps towards the optimum, at the starting point ``xi``.

    States by their spread along the starting path (the measurements, where they are measured); defects by the
    spread of their state, so that a scaled defect is a fraction of what the state does; a parameter by the root
    mean square of its column of the scaled defects, and by its curvature.
    """
    states = xi[problem.n_theta :].reshape(-1, problem.n_states)
    size = np.abs(states).max(axis=0)
    spread = states.std(axis=0)
    spread = np.where(spread > 1e-12 * size, spread, size)  # a constant has rounding errors only
    units = 1 / np.where(spread > 0, spread, 1.0)
    outputs = [len(y) for e in range(len(problem.first_point) - 1) for y in problem.outputs(xi, e)]
    return _scaling(problem, xi, units, 1 / max(problem.m, 1), 1.0 / max(sum(outputs), 1))


def scale_from_curvature(problem: _core.Problem, xi: _Array, first: Scaling) -> Scaling:
    """Return the scaling for the last steps, near the optimum ``xi``: everything in units of its own uncertainty.

    A state by the root of the mean curvature of the log-likelihood with respect to it, a parameter by the norm of
    its column then. Gradients are then of order one whatever the noise: with noise eight orders below the signal,
    any scaling by the signal leaves them beyond the reach of rounding. States that no output depends on keep the
    units that they had.
    """
    n, n_theta, n_states = problem.n, problem.n_theta, problem.n_states
    units = first.variables[n_theta : n_theta + n_states]
    curvature = problem.gauss_newton(xi, 1.0)
    if curvature is not None:
        row, column = problem.hessian_structure()
        diagonal = row == column
        total = np.bincount(row[diagonal], curvature[diagonal], minlength=n)
        mean = total[n_theta:].reshape(-1, n_states).mean(axis=0)
        units = np.where(mean > 0, np.sqrt(np.maximum(mean, 0)), units)
    return _scaling(problem, xi, units, 1.0, 1.0)


def _scaling(problem: _core.Problem, xi: _Array, units: _Array, column_weight: float, objective: float) -> Scaling:
    """Return the scaling made of factors for the states; ``column_weight`` multiplies the squared column norms."""
    n_theta = problem.n_theta
    ends = problem.boundary_states
    constraints = np.concatenate(
        [np.tile(units, (problem.m - len(ends)) // units.size), units[np.array(ends, dtype=np.intp)]]
    )
    variables = np.concatenate([np.ones(n_theta), np.tile(units, (problem.n - n_theta) // units.size)])
    weight = np.zeros(n_theta)
    values = problem.jacobian(xi)
    if values is not None:
        row, column = problem.jacobian_structure()
        of_theta = column < n_theta
        scaled = values[of_theta] * constraints[row[of_theta]]
        weight += np.bincount(column[of_theta], scaled**2, minlength=n_theta) * column_weight
    curvature = problem.gauss_newton(xi, objective)
    if curvature is not None:
        row, column = problem.hessian_structure()
        diagonal = (row == column) & (row < n_theta)
        weight += np.abs(np.bincount(row[diagonal], curvature[diagonal], minlength=n_theta))
    # A column that is zero at the start has no information; its parameter is not scaled.
    variables[:n_theta] = np.where(weight > 0, np.sqrt(weight), 1.0)
    return Scaling(variables, constraints, objective)


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
    ) -> None:
        self.problem = problem
        self.failure = failure
        self.watch = watch
        self._deadline = deadline
        self.pressed: Callable[[], bool] = lambda: False
        """Return whether the user asks for an end."""
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
        self.stop = self.stop or self.pressed()
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
            # More than Ipopt takes is not a limit.
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
