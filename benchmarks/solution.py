"""Time to solution on HFB-320, for us and for peers, and whether they arrive at the published optimum.

Collocation starts with every derivative and bias at 0, the states as measured; single shooting cannot, and
starts 15 % off the published optimum.  Build: from the arrays to a problem that a solver takes.  After:
standard errors and the result's tables, which of these only ours computes.  Total: all of them.  Newton takes
milliseconds, so it runs more often than the others.

    python benchmarks/solution.py [--repeats 5] [--newton 30] [--no-shooting]
"""

import argparse

import hfb320_case as hfb
from tables import attempt, console, median, seconds, show, times

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


NEWTON = {
    OURS: (ours, {}),
    "phugoid, order 2, sigmas from 1": (ours, {"sigmas": True}),
    "phugoid, order 2, no regression": (ours, {"regression": False}),
    "phugoid, order 2, no regression, σ 1": (ours, {"sigmas": True, "regression": False}),
    "phugoid, order 4 (its default)": (ours, {"order": 4}),
}
COLLOCATION = {
    "phugoid with Ipopt, order 2": (ours, {"solver": "ipopt"}),
    "phugoid with Ipopt, order 4": (ours, {"solver": "ipopt", "order": 4}),
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
PEERS = NEWTON | COLLOCATION | SHOOTING
AIMS = {"the best of Ipopt, ours or CasADi's": (tuple(COLLOCATION), 20)}
AIMS |= {name: ((name,), 300) for name in SHOOTING if name.startswith("scipy")}
"""Whom we want to be so many times faster than in solving."""


def collect(case, repeats, newton, shooting=True):
    """{peer: results}: runs in turns, after one to warm up; of single shooting one run without."""
    found = {}
    for name in (*NEWTON, *COLLOCATION):
        found |= {name: []} if attempt(name, _once, name, case) else {}
    for turn in range(repeats):
        for name in found:
            often = len(range(turn, newton, repeats)) if name in NEWTON else 1
            found[name] += [_once(name, case) for _ in range(often)]
    for name in SHOOTING if shooting else ():
        result = attempt(name, _once, name, case)
        found |= {name: [result]} if result else {}
    return found


def _once(name, case, **more):
    peer, options = PEERS[name]
    return peer(case, **options, **more)


def run(repeats=5, newton=30, shooting=True):
    """Measure and print."""
    case = hfb.load_case()
    found = collect(case, repeats, newton, shooting)
    spent = {name: _medians(results) for name, results in found.items()}
    _show_times(f"({case.source}), medians of {repeats}, of {newton} for Newton", spent)
    _show_ends(case, found)
    _show_flops({name: found[name] for name in NEWTON if name in found}, spent)


def _show_times(title, spent):
    base = spent.get(OURS, {})
    columns = ("build_seconds", "solve_seconds", "fastest", "after_seconds", "total")
    show(
        f"Time to solution on HFB-320 {title} (single shooting: one run)",
        ["", "build", "solve", "fastest", "after", "total", "solve/ours", "total/ours"],
        [
            [
                name,
                *(seconds(stages[column] or None) for column in columns),
                *(times(stages[stage], base.get(stage)) for stage in ("solve_seconds", "total")),
            ]
            for name, stages in spent.items()
        ],
        f"ours: {OURS}, its start-up regression included.  fastest: of the times to solve.  after: standard errors, "
        "residuals and tables, which only ours (and aeroid, in its solve) computes",
    )
    for whom, (names, aim) in AIMS.items():
        measured = [spent[name]["solve_seconds"] for name in names if name in spent]
        if measured and base:
            ratio = min(measured) / base["solve_seconds"]
            verdict = "reached" if ratio >= aim else "MISSED"
            console.print(f"aim: solve {aim} times faster than {whom}: {ratio:.1f} times, {verdict}")
    console.print()


def _show_ends(case, found):
    rows = []
    for name, results in found.items():
        last = results[-1]
        counted = last["evaluations"] or _once(name, case, count=True)["evaluations"]
        rows.append([
            name,
            last["iterations"],
            counted,
            f"{last['log_likelihood']:.5f}",
            f"{100 * last['largest_error']:.1e} %",
            last["status"].removeprefix("Solve_").replace("_", " ").lower(),
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


def _show_flops(found, spent):
    rows = []
    for name, results in found.items():
        one, many, time = results[-1]["flops"], results[-1]["factorizations"], spent[name]["solve_seconds"]
        counts = [results[-1]["iterations"], many, f"{one / 1e6:.2f}", f"{one * many / 1e6:.1f}"]
        rows.append([name, *counts, seconds(time), f"{one * many / time / 1e9:.2f}"])
    show(
        "Newton's own count of floating-point operations",
        ["", "iterations", "factorised", "Mflop each", "Mflop in all", "solve", "Gflop/s"],
        rows,
        "of factorisations only; Gflop/s: these over the whole time to solve, evaluations and all",
    )


def _medians(results):
    stages = {stage: median([result.get(stage, 0.0) for result in results]) for stage in STAGES}
    total = median([sum(result.get(stage, 0.0) for stage in STAGES) for result in results])
    return stages | {"total": total, "fastest": min(result["solve_seconds"] for result in results)}


def main():
    """From the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--newton", type=int, default=30, help="runs of Newton")
    parser.add_argument("--no-shooting", action="store_true", help="leave out single shooting, which is slow")
    arguments = parser.parse_args()
    run(arguments.repeats, arguments.newton, not arguments.no_shooting)


if __name__ == "__main__":
    main()
