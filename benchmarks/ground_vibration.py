"""The paper's ground vibration test at growing length, 24 states, order 4: time and memory of an iteration.

Twins of 1,000 to 30,001 samples (`examples/ground_vibration_twin.py`), the paper's modal form and start.  Newton here
and Ipopt with MUMPS solve the same program; both take a few iterations from the start, each in a process of its own.
Then the whole way to the estimate, by `fit_linear` and collocation of order 5, from the subspace method's start and
from the paper's.

    python benchmarks/ground_vibration.py [--newton 1000 1500 3000 6000 30001] [--ipopt 1000 1500 3000 6000] [--steps 6]
                                          [--whole 6001 30001]
"""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from phugoid_hfb320 import make_solver
from scaling import callback_seconds, memory
from tables import attempt, seconds, show

EXAMPLES = str(Path(__file__).resolve().parents[1] / "examples")
NEWTON, IPOPT, WHOLE = (1_000, 1_500, 3_000, 6_000, 30_001), (1_000, 1_500, 3_000, 6_000), (6_001, 30_001)


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


def measure_whole(start, samples):
    """The whole way from one of the starts, in this process."""
    sys.path.insert(0, EXAMPLES)
    import ground_vibration as example

    import phugoid as ph

    record, before = example.twin(samples), memory("VmRSS")
    began = time.perf_counter()
    linear = example.best_linear(record, start)
    between = time.perf_counter()
    fit = ph.estimate(ph.models.modal(start=linear), record.data, transcription=ph.Collocation(order=5))
    done = time.perf_counter()
    error, standard = (np.abs(each) for each in example.response_error(fit, record))
    modes = [row[0].frequency.std_error < 0.02 and max(map(abs, row[1:])) for row in example.compare(fit, record)]
    return {
        "linear": between - began,
        "collocation": done - between,
        "iterations": fit.iterations,
        "log_likelihood": fit.log_likelihood,
        "status": fit.status,
        "modes": max(m for m in modes if m is not False),
        "dB": [float(np.median(error)), float(np.quantile(error, 0.95)), float(error.max())],
        "standard": float(standard.max()),
        "kB": memory() - before,
    }


def run_whole(sizes):
    """Measure and print."""
    rows = []
    for samples in sizes:
        for start in ("subspace", "paper"):
            r = attempt(f"{start}, {samples:,}", in_new_process, "whole", start, samples)
            if r:
                rows.append(
                    [
                        f"{start}, {samples:,}",
                        seconds(r["linear"]),
                        seconds(r["collocation"]),
                        r["iterations"],
                        r["status"],
                        f"{r['log_likelihood']:.3f}",
                        f"{r['modes']:.1f}",
                        ", ".join(f"{x:.3f}" for x in r["dB"]),
                        f"{r['standard']:.1f}",
                        f"{r['kB'] / 1e6:.2f} GB",
                    ]
                )
    show(
        "Ground vibration test: the whole way, order 5",
        ["", "linear", "estimate", "it.", "status", "logL", "modes", "|H|, dB", "s.e.", "memory"],
        rows,
        "linear: subspace method, if any, and fit_linear; estimate: by collocation; modes: greatest error of "
        "frequencies and damping ratios of modes known to 0.02 Hz, in standard errors; |H|: errors of the response's "
        "magnitude over 6 to 32 Hz, median, 95 % and greatest in dB; greatest in standard errors",
    )


def in_new_process(*what):
    """A measurement there."""
    command = [sys.executable, __file__, "--measure", *map(str, what)]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(done.stderr.strip().split("\n")[-1] or f"ended with {done.returncode}")
    return json.loads(done.stdout.strip().split("\n")[-1])


def run(newton=NEWTON, ipopt=IPOPT, steps=6):
    """Measure and print."""
    found = {}
    for solver, sizes in (("newton", newton), ("ipopt", ipopt)):
        for samples in sizes:
            result = attempt(f"{solver}, {samples:,}", in_new_process, "steps", solver, samples, steps)
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
    parser.add_argument("--whole", type=int, nargs="*", default=list(WHOLE), help="samples")
    parser.add_argument("--measure", nargs="*", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.measure:
        what, name, *numbers = arguments.measure
        found = measure_whole if what == "whole" else measure
        print(json.dumps(found(name, *map(int, numbers))))
        return
    if arguments.newton or arguments.ipopt:
        run(tuple(arguments.newton), tuple(arguments.ipopt), arguments.steps)
    run_whole(arguments.whole)


if __name__ == "__main__":
    main()
