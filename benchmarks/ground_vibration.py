"""The paper's ground vibration test at growing length, 24 states, order 4: time and memory of an iteration.

Twins of 1,000 to 30,001 samples (`examples/ground_vibration_twin.py`), the paper's modal form and start.  Newton here
and Ipopt with MUMPS solve the same program; both take a few iterations from the start, each in a process of its own.

    python benchmarks/ground_vibration.py [--newton 1000 1500 3000 6000 30001] [--ipopt 1000 1500 3000 6000] [--steps 6]
"""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

from phugoid_hfb320 import make_solver
from scaling import callback_seconds, memory
from tables import attempt, seconds, show

EXAMPLES = str(Path(__file__).resolve().parents[1] / "examples")
NEWTON, IPOPT = (1_000, 1_500, 3_000, 6_000, 30_001), (1_000, 1_500, 3_000, 6_000)


def measure(solver, samples, steps):
    """Times in s, counts and memory of `steps` iterations in this process."""
    sys.path.insert(0, EXAMPLES)
    from ground_vibration_twin import paper_model, twin

    import phugoid as ph

    (model, start), record = paper_model(), twin(samples)
    watched = make_solver(solver, count=True, max_iterations=steps)
    marks, before = [], memory("VmRSS")

    def mark(iteration):
        marks.append(time.perf_counter())

    fit = ph.estimate(
        model, record.data, transcription=ph.Collocation(order=4), start=start, solver=watched, progress=mark
    )
    log, at = watched.log, fit.solution
    one, calls = callback_seconds(log["problem"], at.xi, at.multipliers), log["calls"]
    each = (marks[-1] - marks[0]) / max(len(marks) - 1, 1)
    # The callbacks of an iteration, without those of the start.
    evaluation = sum(one[name] * calls.get(name, 0) for name in one) / max(fit.iterations + 1, 1)
    return {
        "unknowns": int(at.xi.size),
        "iterations": fit.iterations,
        "first": marks[0] - log["entered"],
        "each": each,
        "evaluation": evaluation,
        "flops": at.flops,
        "kB": memory() - before,
    }


def in_new_process(solver, samples, steps):
    """`measure` there."""
    command = [sys.executable, __file__, "--measure", solver, str(samples), str(steps)]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(done.stderr.strip().split("\n")[-1] or f"ended with {done.returncode}")
    return json.loads(done.stdout.strip().split("\n")[-1])


def run(newton=NEWTON, ipopt=IPOPT, steps=6):
    """Measure and print."""
    found = {}
    for solver, sizes in (("newton", newton), ("ipopt", ipopt)):
        for samples in sizes:
            result = attempt(f"{solver}, {samples:,}", in_new_process, solver, samples, steps)
            if result:
                found[solver, samples] = result
    rows = []
    for (solver, samples), r in found.items():
        ours = found.get(("newton", samples))
        ratio = f"{r['each'] / ours['each']:.1f}" if ours and solver != "newton" else ""
        rows.append(
            [
                f"{solver.capitalize()}, {samples:,}",
                f"{r['unknowns']:,}",
                r["iterations"],
                seconds(r["first"]),
                seconds(r["each"]),
                ratio,
                f"{100 * min(r['evaluation'] / r['each'], 1):.0f} %",
                f"{r['flops'] / 1e9:.2f}" if r["flops"] else "-",
                f"{r['kB'] / 1e6:.2f} GB",
            ]
        )
    show(
        "Ground vibration test, 24 states, order 4, from the paper's start",
        ["", "unknowns", "iterations", "first step", "an iteration", "times ours", "evaluation", "Gflop", "memory"],
        rows,
        "first step: all that comes before it is taken; an iteration: the mean of those after it; evaluation: part of "
        "it in the callbacks, the rest is linear algebra; Gflop: of one factorisation, counted; memory: peak above the "
        "process with its modules and the record loaded",
    )


def main():
    """From the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--newton", type=int, nargs="*", default=list(NEWTON), help="samples")
    parser.add_argument("--ipopt", type=int, nargs="*", default=list(IPOPT), help="samples")
    parser.add_argument("--steps", type=int, default=6, help="iterations")
    parser.add_argument("--measure", nargs=3, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.measure:
        solver, samples, steps = arguments.measure
        print(json.dumps(measure(solver, int(samples), int(steps))))
        return
    run(tuple(arguments.newton), tuple(arguments.ipopt), arguments.steps)


if __name__ == "__main__":
    main()
