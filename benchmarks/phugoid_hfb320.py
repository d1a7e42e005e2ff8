"""Ours on HFB-320, from end to end: `ph.estimate` with Newton or with Ipopt, its stages timed apart.

python benchmarks/phugoid_hfb320.py --order 2 4 --start zero 7 --solver newton ipopt
"""

import argparse
import time
from collections import Counter
from dataclasses import dataclass, field

import hfb320_case as hfb
from phugoid_model import experiment, model

import phugoid as ph

CALLBACKS = ("objective", "gradient", "constraints", "jacobian", "hessian", "gauss_newton")


class Counted:
    """A problem that counts the calls of its callbacks."""

    def __init__(self, problem):
        self._problem, self.calls = problem, Counter()

    def __getattr__(self, name):
        if name in CALLBACKS:
            self.calls[name] += 1
        return getattr(self._problem, name)


@dataclass(frozen=True)
class _Watch:
    """Notes in `log` with which problem the solver was entered, when, and when left."""

    log: dict = field(default_factory=dict)

    def solve(self, problem, *arguments, **keywords):
        """The solver's own, between two looks at the clock."""
        self.log["problem"], self.log["entered"] = problem, time.perf_counter()
        solution = super().solve(problem, *arguments, **keywords)
        self.log["left"] = time.perf_counter()
        self.log["calls"] = solution.evaluations
        return solution


@dataclass(frozen=True)
class Newton(_Watch, ph.Newton):
    """Newton, watched; it counts evaluations itself."""


@dataclass(frozen=True)
class Ipopt(_Watch, ph.Ipopt):
    """Ipopt, watched; its evaluations are counted if asked to."""

    count: bool = False

    def solve(self, problem, *arguments, **keywords):
        """The same with a problem that counts."""
        problem = Counted(problem) if self.count else problem
        solution = super().solve(problem, *arguments, **keywords)
        self.log["calls"] = problem.calls if self.count else {}
        return solution


def make_solver(solver="newton", regression=None, count=False, **options):
    """The watched solver of that name; `regression` is Newton's, `count` Ipopt's, which counts only if asked to."""
    if solver == "ipopt":
        return Ipopt(count=count, **options)
    return Newton(regression=regression, **options)


def starting_values(start, sigmas):
    """The values to start from, by name; without their sigmas, which then start from the data, unless `sigmas`."""
    start = hfb.start_parameters(start)
    return {name: value for name, value in start.items() if sigmas or name not in hfb.SIGMAS}


def solve(order=2, start="zero", sigmas=False, case=None, solver="newton", regression=None, count=False):
    """Solve and return a dict of status, iterations, log-likelihood, parameters, and times in seconds.

    `start` is a mapping, 'zero', 'optimum' or the number of a random start.  Its sigmas are left out, so that
    they start from the data as they do unasked, unless `sigmas`.  The rest is for `make_solver`.
    """
    case, start = case or hfb.load_case(), starting_values(start, sigmas)
    watched = make_solver(solver, regression, count)
    begin = time.perf_counter()
    record = experiment(case.t, case.u, case.z)
    fit = ph.estimate(model(), record, transcription=ph.Collocation(order=order), start=start, solver=watched)
    end = time.perf_counter()
    log = watched.log
    found = {name: fit.parameters[name].value for name in hfb.PARAMETERS}
    return {
        "status": fit.status,
        "iterations": fit.iterations,
        "evaluations": hfb.counts(*(log["calls"].get(n, 0) for n in CALLBACKS)) if log["calls"] else "",
        "factorizations": log["calls"].get("factorizations", 0),
        "flops": fit.solution.flops,
        "log_likelihood": fit.log_likelihood,
        "parameters": found,
        "largest_error": hfb.largest_error(found),
        "build_seconds": log["entered"] - begin,
        "solve_seconds": log["left"] - log["entered"],
        "after_seconds": end - log["left"],
    }


def main():
    """Solve for the chosen orders, starts and solvers, and print one line for each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--order", type=int, nargs="+", default=[2])
    parser.add_argument("--start", nargs="+", default=["zero"], help="zero, optimum, or a seed 0 to 999")
    parser.add_argument("--solver", nargs="+", choices=("newton", "ipopt"), default=["newton"])
    parser.add_argument("--sigmas", action="store_true", help="start the sigmas at 1, not from the data")
    parser.add_argument("--no-regression", action="store_true", help="Newton starts without one")
    arguments = parser.parse_args()
    case, regression = hfb.load_case(), False if arguments.no_regression else None
    print(f"HFB-320, {case.source}; published logL (order 2) {hfb.LOG_LIKELIHOOD:.6f}")
    for order in arguments.order:
        for start in arguments.start:
            for solver in arguments.solver:
                result = solve(order, start, arguments.sigmas, case, solver, regression, count=True)
                print(
                    f"{solver:<6}  order {order}  start {start:<8} build {result['build_seconds']:.4f} s, "
                    f"solve {result['solve_seconds']:.4f} s, after {result['after_seconds']:.4f} s  "
                    f"{result['iterations']:3d} iterations  {result['evaluations']}  "
                    f"logL {result['log_likelihood']:.6f}  "
                    f"off the published optimum by {100 * result['largest_error']:.2g} %  {result['status']}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
