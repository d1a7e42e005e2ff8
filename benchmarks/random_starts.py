"""How many of the paper's random starts reach the optimum on HFB-320, for us and for peers.

A start succeeds where it ends within 0.01 in log-likelihood of what the same method reaches from the published
optimum, and the solver says that it has converged (of single shooting only the former is asked).

    python benchmarks/random_starts.py [--ours 50] [--casadi 10] [--scipy 5]
"""

import argparse
import time

import hfb320_case as hfb
from tables import attempt, console, median, seconds, show

CLOSE = 0.01
METIS = {"linear_pivot_order": 5}
"""MUMPS's ordering as ours has it; with its default one a start can take CasADi a minute."""


def ours(case, **options):
    """Function of a start that solves from it: (log-likelihood, iterations, converged)."""
    from phugoid_hfb320 import solve

    def from_start(start):
        result = solve(start=start, case=case, **options)
        return result["log_likelihood"], result["iterations"], result["status"] == "converged"

    return from_start


def casadi(case, **options):
    """The same with CasADi and Ipopt."""
    from casadi_hfb320 import solve

    def from_start(start):
        result = solve(start=start, case=case, **options)
        return result["log_likelihood"], result["iterations"], result["status"] == "Solve_Succeeded"

    return from_start


def scipy(case):
    """The same with single shooting; its finite differences in one batch, which is the faster way."""
    from scipy_single_shooting import fit

    def from_start(start):
        result = fit(case, hfb.start_parameters(start), batched=True)
        return result["log_likelihood"], result["calls"], True

    return from_start


PEERS = {
    "phugoid, order 2": ("ours", ours, {}),
    "phugoid, order 2, sigmas from 1": ("ours", ours, {"sigmas": True}),
    "CasADi, paper's scaling": ("casadi", casadi, {"scaling": "paper", **METIS}),
    "CasADi, gradient scaling": ("casadi", casadi, {"scaling": "gradient", **METIS}),
    "scipy single shooting, batched": ("scipy", scipy, {}),
}


def measure(name, make, case, options, starts):
    """Row of the table, and the numbers of the starts that failed."""
    from_start = make(case, **options)
    best, *_ = from_start("optimum")
    spent, iterations, failed = [], [], []
    for number in range(starts):
        begin = time.perf_counter()
        try:
            reached, count, converged = from_start(number)
        except (ArithmeticError, ValueError, RuntimeError):  # a start where the equations are not finite
            reached, count, converged = float("nan"), 0, False
        spent.append(time.perf_counter() - begin)
        if converged and abs(reached - best) < CLOSE:
            iterations.append(count)
        else:
            failed.append(number)
    middle = f"{median(iterations):g}" if iterations else "-"
    row = [name, f"{starts - len(failed)} of {starts}", middle, seconds(median(spent)), seconds(max(spent))]
    return row, failed


def run(ours=50, casadi=10, scipy=5):
    """Measure and print."""
    case, numbers = hfb.load_case(), {"ours": ours, "casadi": casadi, "scipy": scipy}
    rows = []
    for name, (group, make, options) in PEERS.items():
        found = attempt(name, measure, name, make, case, options, numbers[group]) if numbers[group] else None
        if found:
            rows.append(found[0])
            if found[1]:
                console.print(f"{name}: failed from {', '.join(map(str, found[1]))}")
    show(
        f"HFB-320 ({case.source}) from the paper's random starts",
        ["", "successes", "iterations", "time", "longest"],
        rows,
        "iterations (calls, for single shooting): median of the successes; time: median of all, from arrays to result",
    )


def main():
    """From the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name, number in (("ours", 50), ("casadi", 10), ("scipy", 5)):
        parser.add_argument(f"--{name}", type=int, default=number, help=f"starts (default {number})")
    run(**vars(parser.parse_args()))


if __name__ == "__main__":
    main()
