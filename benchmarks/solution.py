"""Time to solution on HFB-320, for us and for peers, and whether they arrive at the published optimum.

Collocation starts with every derivative and bias at 0, the states as measured; single shooting cannot, and
starts 15 % off the published optimum.  Build: from the arrays to a problem that a solver takes.  After:
standard errors and the result's tables, which of these only ours computes.  Total: all of them.

    python benchmarks/solution.py [--repeats 5] [--no-shooting]
"""

import argparse

import hfb320_case as hfb
from tables import attempt, median, seconds, show, times

OURS = "phugoid, order 2"
STAGES = ("build_seconds", "solve_seconds", "after_seconds")


def ours(case, **options):
    """One run of ours."""
    from phugoid_hfb320 import solve

    return solve(case=case, **options)


def casadi(case, **options):
    """One run of CasADi with Ipopt."""
    from casadi_hfb320 import solve

    return solve(case=case, **options)


def scipy(case, batched):
    """One run of the usual way, from 15 % off."""
    from scipy_single_shooting import fit

    result = fit(case, hfb.perturbed_start(0.15), batched)
    return {
        "solve_seconds": result["seconds"],
        "iterations": f"{result['passes']} passes",
        "evaluations": f"{result['trajectories']} simulations",
        "log_likelihood": result["log_likelihood"],
        "largest_error": result["largest_error"],
        "status": "settled" if result["passes"] < 30 else "not settled",
    }


def aeroid(case):
    """One run of aeroid, from 15 % off, with the published sigmas."""
    from aeroid_hfb320 import fit

    return fit(case, hfb.perturbed_start(0.15))


COLLOCATION = {
    OURS: (ours, {}),
    "phugoid, order 2, sigmas from 1": (ours, {"sigmas": True}),
    "phugoid, order 4 (its default)": (ours, {"order": 4}),
    "CasADi, paper's scaling": (casadi, {"scaling": "paper"}),
    "CasADi, paper's scaling, METIS": (casadi, {"scaling": "paper", "linear_pivot_order": 5}),
    "CasADi, gradient scaling": (casadi, {"scaling": "gradient"}),
    "CasADi, gradient scaling, METIS": (casadi, {"scaling": "gradient", "linear_pivot_order": 5}),
}
SHOOTING = {
    "scipy single shooting": (scipy, {"batched": False}),
    "scipy single shooting, batched": (scipy, {"batched": True}),
    "aeroid single shooting": (aeroid, {}),
}


def collect(case, repeats, shooting=True):
    """{peer: results}: `repeats` runs of each collocation, in turns, after one to warm up; single shooting once."""
    found = {}
    for name, (peer, options) in COLLOCATION.items():
        warm = attempt(name, lambda peer=peer, options=options: peer(case, **options))
        found |= {name: []} if warm else {}
    for _ in range(repeats):
        for name in found:
            peer, options = COLLOCATION[name]
            found[name].append(peer(case, **options))
    for name, (peer, options) in SHOOTING.items() if shooting else ():
        result = attempt(name, lambda peer=peer, options=options: peer(case, **options))
        found |= {name: [result]} if result else {}
    return found


def run(repeats=5, shooting=True):
    """Measure and print."""
    case = hfb.load_case()
    found = collect(case, repeats, shooting)
    spent = {name: _medians(results) for name, results in found.items()}
    base = spent.get(OURS)
    show(
        f"Time to solution on HFB-320 ({case.source}), medians of {repeats} (single shooting: one run)",
        ["", "build", "solve", "after", "total", "solve/ours", "total/ours"],
        [
            [
                name,
                *(seconds(stages[stage] or None) for stage in (*STAGES, "total")),
                *(times(stages[stage], base and base[stage]) for stage in ("solve_seconds", "total")),
            ]
            for name, stages in spent.items()
        ],
        "after: standard errors, residuals and tables, which only ours (and aeroid, in its solve) computes",
    )
    rows = []
    for name, results in found.items():
        last, counted = results[-1], results[-1]
        if name.startswith("phugoid"):
            counted = ours(case, count=True, **COLLOCATION[name][1])
        rows.append([
            name,
            last["iterations"],
            counted["evaluations"],
            f"{last['log_likelihood']:.5f}",
            f"{100 * last['largest_error']:.1e} %",
            last["status"].replace("_", " ").lower(),
        ])  # fmt: skip
    show(
        "Where they arrive, and at how many evaluations",
        ["", "iterations", "evaluations", "logL", "error", "status"],
        rows,
        "evaluations: objective/gradient/constraints/Jacobian/Hessian, those of the start and of the scaling "
        "included; g: Gauss-Newton.  error: largest relative deviation of a derivative from the published "
        f"optimum (order 2, logL {hfb.LOG_LIKELIHOOD:.5f}); order 4 and single shooting integrate the equations "
        "more accurately and have another optimum.",
    )


def _medians(results):
    stages = {stage: median([result.get(stage, 0.0) for result in results]) for stage in STAGES}
    return stages | {"total": median([sum(result.get(stage, 0.0) for stage in STAGES) for result in results])}


def main():
    """From the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--no-shooting", action="store_true", help="leave out single shooting, which is slow")
    arguments = parser.parse_args()
    run(arguments.repeats, not arguments.no_shooting)


if __name__ == "__main__":
    main()
