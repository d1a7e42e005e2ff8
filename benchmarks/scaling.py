"""How time and memory grow with the length of the record: HFB-320 with 600 to 600,000 samples, order 2.

The record is simulated: the twin's manoeuvre again and again, published parameters, seeded noise.  It is simulated by
the rule that the fit assumes, the trapezoid at the sample times, so that the true parameters are those of the model
however small the standard errors become.  Derivatives start 15 % off: from zero, the longer of these records lead
Ipopt, and Newton without its regression, to another, worse optimum.  Each measurement is a process of its own.

    python benchmarks/scaling.py [--newton 600 6000 60000 600000] [--ipopt 600 6000 60000] [--limit 120]
"""

import argparse
import json
import math
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import hfb320_case as hfb
import numpy as np
from phugoid_hfb320 import CALLBACKS, make_solver, starting_values
from tables import attempt, seconds, show

STEP, PERIOD = 0.1, 600
TRIM = (-0.008, 11_600.0)
FIRST = (105.24, 0.1103, 0.1058, -0.0021)
CLOSE = 4.0
"""Standard errors within which the true parameters must be found."""


def elevator(samples):
    """The twin's 3-2-1-1 and pulse, once a minute: (samples,) in rad."""
    t, once = STEP * np.arange(PERIOD), np.full(PERIOD, TRIM[0])
    for begin, end, sign in ((5, 8, 1), (8, 10, -1), (10, 11, 1), (11, 12, -1), (25, 41, 1)):
        once[(t >= begin) & (t < end)] += 0.012 * sign
    return np.resize(once, samples)


def trapezoid(inputs):
    """States (N, 4) of the published optimum by the trapezoidal rule, each step a fixed point to rounding."""
    x = list(FIRST)
    f, path = hfb.dynamics(x, inputs[0], hfb.OPTIMUM, math), [x]
    for now in inputs[1:]:
        half = [a + 0.5 * STEP * b for a, b in zip(x, f, strict=True)]
        x, change = [a + STEP * b for a, b in zip(x, f, strict=True)], 1.0
        while change > 1e-11:
            f = hfb.dynamics(x, now, hfb.OPTIMUM, math)
            before, x = x, [a + 0.5 * STEP * b for a, b in zip(half, f, strict=True)]
            change = max(abs(a - b) for a, b in zip(before, x, strict=True))
        path.append(x)
    return np.array(path)


def simulate(samples, seed=0):
    """Times (N,), inputs (N, 2) and measurements (N, 7)."""
    u = np.column_stack([elevator(samples), np.full(samples, TRIM[1])])
    states = trapezoid(u.tolist())
    clean = np.column_stack(hfb.outputs(states.T, u.T, hfb.OPTIMUM))
    noise = np.random.default_rng(seed).standard_normal(clean.shape) * [hfb.OPTIMUM[name] for name in hfb.SIGMAS]
    return STEP * np.arange(samples), u, clean + noise


def memory(which="VmHWM"):
    """Greatest (VmHWM) or present (VmRSS) memory of this process in kB; NaN where the system does not say."""
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
    except OSError:
        return math.nan
    return next((float(line.split()[1]) for line in lines if line.startswith(which)), math.nan)


def callback_seconds(problem, xi, multipliers):
    """{callback: fastest of three calls in s}."""
    more = {"hessian": (1.0, multipliers), "gauss_newton": (1.0,)}
    spent = {}
    for name in CALLBACKS:
        callback = getattr(problem, name)
        spent[name] = min(_time(callback, xi, *more.get(name, ())) for _ in range(3))
    return spent


def _time(function, *arguments):
    begin = time.perf_counter()
    function(*arguments)
    return time.perf_counter() - begin


def fitted(solver, limit, arrays):
    """A fit in this process: it, the log of its solver, and [(time, kB at most)] of start, each iteration and end."""
    from phugoid_model import experiment, model

    import phugoid as ph

    watched = make_solver(solver, count=True, time_limit=limit)
    start = starting_values(hfb.perturbed_start(), False)
    m, order, marks = model(), ph.Collocation(order=2), [(time.perf_counter(), memory("VmRSS"))]

    def mark(iteration=None):
        marks.append((time.perf_counter(), memory()))

    record = experiment(*arrays)
    fit = ph.estimate(m, record, transcription=order, start=start, solver=watched, progress=mark)
    mark()
    return fit, watched.log, marks


def measure(solver, limit, paths):
    """The same as a dict of what the table shows, times in s."""
    fit, log, marks = fitted(solver, limit, [np.load(path) for path in paths])
    (begin, before), first, *_, last, (end, whole) = marks
    at, calls, found = fit.solution, log["calls"], fit.parameters
    one = callback_seconds(log["problem"], at.xi, at.multipliers)
    return {
        "status": fit.status,
        "iterations": fit.iterations,
        "solve": log["left"] - log["entered"],
        "first": first[0] - log["entered"],
        "iterating": last[0] - first[0],
        "total": end - begin,
        "callbacks": sum(one[name] * calls.get(name, 0) for name in CALLBACKS),
        "flops": at.flops * calls.get("factorizations", 0),
        "solving_kB": last[1] - before,
        "whole_kB": whole - before,
        "off": max(abs(found[n].value - true) / found[n].std_error for n, true in hfb.OPTIMUM.items()),
    }


def in_new_process(solver, limit, paths):
    """`measure` there."""
    command = [sys.executable, __file__, "--measure", solver, str(limit), *paths]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(done.stderr.strip().split("\n")[-1] or f"ended with {done.returncode}")
    return json.loads(done.stdout.strip().split("\n")[-1])


def rows_of(label, samples, result):
    """The rows of both tables."""
    name, solve = f"{label}, {samples:,}", result["solve"]
    one = result["iterating"] / max(result["iterations"], 1)
    part = min(result["callbacks"] / solve, 1.0)
    rate = f"{result['flops'] / (1 - part) / solve / 1e9:.2f}" if result["flops"] and part < 1 else "-"
    spent = [name, result["iterations"], *(seconds(value) for value in (solve, result["first"], one))]
    spent += [f"{1e6 * one / samples:.2f}", f"{100 * (1 - part):.0f} %", rate, seconds(result["total"])]
    ends = [name, result["status"], f"{result['off']:.2f}", "yes" if result["off"] < CLOSE else "NO"]
    ends += [f"{result[which] / samples:.2f}" for which in ("solving_kB", "whole_kB")]
    return spent, [*ends, f"{result['whole_kB'] / 1e3:.0f} MB"]


def collect(sizes, limit, repeats):
    """[(label, samples, result)] of the sizes of each solver; of Newton the fastest of `repeats`."""
    arrays, found = simulate(max(max(asked, default=2) for asked in sizes.values())), []
    with tempfile.TemporaryDirectory() as folder:
        paths = [str(Path(folder, f"{name}.npy")) for name in "tuz"]
        for solver, asked in sizes.items():
            for samples in asked:
                for path, array in zip(paths, arrays, strict=True):
                    np.save(path, array[:samples])
                times = repeats if solver == "newton" else 1
                name = f"{solver}, {samples:,}"
                results = [attempt(name, in_new_process, solver, limit, paths) for _ in range(times)]
                if all(results):
                    found.append((solver.capitalize(), samples, min(results, key=lambda result: result["solve"])))
    return found


def run(newton=(600, 6_000, 60_000, 600_000), ipopt=(600, 6_000, 60_000), limit=120.0, repeats=3):
    """Measure and print."""
    found = collect({"newton": newton, "ipopt": ipopt}, limit, repeats)
    rows = [rows_of(*entry) for entry in found]
    show(
        f"HFB-320, order 2, samples from 600 on: time, Newton's the fastest of {repeats}",
        ["", "iterations", "solve", "first step", "an iteration", "µs/point", "linear", "Gflop/s", "whole fit"],
        [spent for spent, _ in rows],
        "first step: all that comes before it is taken, regression and first factorisation; an iteration: the mean of "
        "those after it; µs/point: of an iteration, for each sample; linear: part of solve that is not in the "
        "callbacks (time of one call times their number): linear algebra, vectors, regression; Gflop/s: Newton's count "
        f"of the factorisations over that part.  Ipopt may take {limit:g} s.",
    )
    show(
        "Where it arrives, and memory",
        ["", "status", "off", f"below {CLOSE:g}", "kB/point, solving", "kB/point, whole fit", "whole fit"],
        [rest for _, rest in rows],
        "off: the parameter, or sigma, farthest from the truth, in its standard errors; kB: peak above what the "
        "process had with its modules and the record loaded",
    )


def main():
    """From the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--newton", type=int, nargs="*", default=[600, 6_000, 60_000, 600_000], help="samples")
    parser.add_argument("--ipopt", type=int, nargs="*", default=[600, 6_000, 60_000], help="samples")
    parser.add_argument("--limit", type=float, default=120.0, help="s for a solve, checked between iterations")
    parser.add_argument("--repeats", type=int, default=3, help="processes for each size of Newton")
    parser.add_argument("--measure", nargs=5, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.measure:
        solver, limit, *paths = arguments.measure
        print(json.dumps(measure(solver, float(limit), paths)))
    else:
        run(arguments.newton, arguments.ipopt, arguments.limit, arguments.repeats)


if __name__ == "__main__":
    main()
