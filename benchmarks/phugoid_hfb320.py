"""Ours with Ipopt and MUMPS on HFB-320, from end to end: `ph.estimate`, its stages timed apart.

python benchmarks/phugoid_hfb320.py --order 2 4 --start zero 7
"""

import argparse
import time
from collections import Counter
from dataclasses import dataclass, field

import hfb320_case as hfb
from phugoid_model import experiment, model

import phugoid as ph

CALLBACKS = ("objective", "gradient", "constraints", "jacobian", "hessian", "gauss_newton")


class _Counted:
    """A problem that counts the calls of its callbacks."""

    def __init__(self, problem):
        self._problem, self.calls = problem, Counter()

    def __getattr__(self, name):
        if name in CALLBACKS:
            self.calls[name] += 1
        return getattr(self._problem, name)


@dataclass(frozen=True)
class _Watched(ph.Ipopt):
    """Ipopt that notes in `log` when it was entered and left and, if asked to, counts evaluations."""

    count: bool = False
    log: dict = field(default_factory=dict)

    def solve(self, problem, *arguments, **keywords):
        problem = _Counted(problem) if self.count else problem
        self.log["entered"] = time.perf_counter()
        solution = super().solve(problem, *arguments, **keywords)
        self.log["left"] = time.perf_counter()
        self.log["calls"] = problem.calls if self.count else {}
        return solution


def solve(order=2, start="zero", sigmas=False, case=None, count=False):
    """Solve and return a dict of status, iterations, log-likelihood, parameters, and times in seconds.

    `start` is a mapping, 'zero', 'optimum' or the number of a random start.  Its sigmas are left out, so that
    they start from the data as they do unasked, unless `sigmas`.
    """
    case = case or hfb.load_case()
    start = dict(hfb.start_parameters(start))
    if not sigmas:
        start = {name: value for name, value in start.items() if name not in hfb.SIGMAS}
    begin = time.perf_counter()
    record, solver = experiment(case.t, case.u, case.z), _Watched(count=count)
    fit = ph.estimate(model(), record, transcription=ph.Collocation(order=order), start=start, solver=solver)
    end = time.perf_counter()
    log = solver.log
    found = {name: fit.parameters[name].value for name in hfb.PARAMETERS}
    return {
        "status": fit.status,
        "iterations": fit.iterations,
        "evaluations": hfb.counts(*(log["calls"].get(n, 0) for n in CALLBACKS)) if count else "",
        "log_likelihood": fit.log_likelihood,
        "parameters": found,
        "largest_error": hfb.largest_error(found),
        "build_seconds": log["entered"] - begin,
        "solve_seconds": log["left"] - log["entered"],
        "after_seconds": end - log["left"],
    }


def main():
    """Solve for the chosen orders and starts, and print one line for each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--order", type=int, nargs="+", default=[2])
    parser.add_argument("--start", nargs="+", default=["zero"], help="zero, optimum, or a seed 0 to 999")
    parser.add_argument("--sigmas", action="store_true", help="start the sigmas at 1, not from the data")
    arguments = parser.parse_args()
    case = hfb.load_case()
    print(f"HFB-320, {case.source}; published logL (order 2) {hfb.LOG_LIKELIHOOD:.6f}")
    for order in arguments.order:
        for start in arguments.start:
            result = solve(order, start, arguments.sigmas, case)
            print(
                f"order {order}  start {start:<8} build {result['build_seconds']:.3f} s, "
                f"solve {result['solve_seconds']:.3f} s, after {result['after_seconds']:.3f} s  "
                f"{result['iterations']:4d} iterations  logL {result['log_likelihood']:.6f}  "
                f"off the published optimum by {100 * result['largest_error']:.2g} %  {result['status']}",
                flush=True,
            )


if __name__ == "__main__":
    main()
