"""Random starts on problems in the PEtab format, against pyPESTO with Fides, and scipy by single shooting.

    python benchmarks/petab_problems.py FOLDER [--starts 100] [--limit 60] [--only Boehm Rahman] [--peer PYTHON]
                                        [--results FILE] [--figure FILE]

FOLDER holds problems as the benchmark collection has them (a folder each, its YAML file of the same name); it does
not ship with phugoid. Starts are a Latin hypercube within the bounds, of logarithms where the table says so. Each
peer takes the same starts, then further ones, until it has used the processor time that ours used for all of its
starts. No start has more than `--limit` seconds of it. `--peer`: an interpreter that has pyPESTO, Fides and AMICI, or
RoadRunner in its place (see `petab_pypesto`).

The end of each start of ours is what an adaptive integration gives at its parameters, not what the collocation
claims. The best known value is the better of the nominal point and of all that was found; a start that ends within
0.1 of it counts. The best end of each program is integrated again by LSODA of scipy. `--results`: a JSON file that
keeps all ends; what it has already is not run again.
"""

import argparse
import json
import math
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import petab_shooting
from tables import show

import phugoid as ph

ENOUGH = 0.1
# Further starts for the peers: batches of as many as ours has, at most so many.
BATCHES = 50
# In the figure, differences are drawn within these limits.
SHOWN = (1e-4, 1e4)


def ours(problem, starts, limit):
    """Yield the end of each start: negative log-likelihood by integration, processor time, parameters."""

    def cut(*_):
        raise KeyboardInterrupt

    signal.signal(signal.SIGPROF, cut)  # a limit on processor time, where the solver's own is on wall time
    for start in starts:
        before = time.process_time()
        found = None
        try:
            signal.setitimer(signal.ITIMER_PROF, limit)
            fit = ph.estimate(problem.model, problem.experiments, start=start, transcription=ph.Collocation(threads=1))
            found = {n: e.value for n, e in fit.parameters.items() if n in problem.nominal}
        except (ph.EvaluationError, KeyboardInterrupt) as error:
            print(f"  {type(error).__name__}: {str(error)[:100]}", flush=True)
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        cpu = time.process_time() - before
        yield {"value": math.nan if found is None else integrated(problem, found), "cpu": cpu, "at": found}


def integrated(problem, values):
    """Return the negative log-likelihood at parameters, by integration; NaN where there is none."""
    try:
        return -problem.log_likelihood(values, time_limit=30.0)
    except ph.PhugoidError:
        return math.nan


def pypesto(python, path, starts, seconds, limit):
    """Return the ends of pyPESTO in another interpreter, and what it calls itself."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "starts.json"
        file.write_text(json.dumps(starts))
        script = Path(__file__).with_name("petab_pypesto.py").resolve()
        command = [python, str(script), str(Path(path).resolve()), str(file), str(seconds), str(limit)]
        done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    if not lines:
        print(f"  pyPESTO failed: {done.stderr.strip().splitlines()[-1:]}")
        return [], {}
    return lines[1:], lines[0]


def further(problem, starts, seed):
    """Return the starts of the peers: ours, then further batches."""
    return [*starts, *(s for i in range(1, BATCHES) for s in problem.starts(len(starts), seed=seed + 1000 * i))]


def measured(folder, problem, options, kept, save):
    """Return the ends of all programs on a problem, those that are kept already as they are; saves after each."""
    starts = problem.starts(options.starts, seed=options.seed)
    if "phugoid" not in kept:
        kept["phugoid"] = list(ours(problem, starts, options.limit))
        save()
    seconds = sum(end["cpu"] for end in kept["phugoid"])
    more = further(problem, starts, options.seed)
    if options.peer and "pyPESTO" not in kept:
        path = folder / f"{folder.name}.yaml"
        kept["pyPESTO"], about = pypesto(options.peer, path, more, seconds, options.limit)
        print(f"{folder.name}: pyPESTO {about}", flush=True)
        save()
    if not options.no_scipy and "scipy" not in kept:
        kept["scipy"] = list(petab_shooting.run(problem, more, seconds, options.limit))
        save()
    return kept


def best_known(nominal, found):
    """Return the best value of the nominal point and all ends."""
    return min([nominal, *(end["value"] for ends in found.values() for end in ends if math.isfinite(end["value"]))])


def rows_of(name, problem, nominal, found):
    """Return the rows of a problem: shares, times, and the best ends by another integrator."""
    best = best_known(nominal, found)
    shooting = petab_shooting.SingleShooting(problem)
    for program, ends in found.items():
        cpu = sum(end["cpu"] for end in ends)
        hits = [i for i, end in enumerate(ends) if end["value"] <= best + ENOUGH]
        first = f"{sum(end['cpu'] for end in ends[: hits[0] + 1]):.1f}" if hits else "-"
        top = min((end for end in ends if math.isfinite(end["value"])), key=lambda end: end["value"], default=None)
        again = "-" if top is None or not top["at"] else f"{shooting.value(top['at']):.3f}"
        yield [
            name, program, f"{nominal:.3f}", "-" if top is None else f"{top['value']:.3f}", again,
            f"{len(hits)} of {len(ends)}", f"{cpu:.0f}", f"{cpu / max(len(ends), 1):.2f}",
            f"{60 * len(hits) / max(cpu, 1e-9):.1f}", first,
        ]  # fmt: skip


def main():
    """Print a table of all problems."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--starts", type=int, default=100)
    parser.add_argument("--limit", type=float, default=60.0, help="most seconds for a start")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", default=[])
    parser.add_argument("--peer", help="an interpreter with pyPESTO, Fides and AMICI, or RoadRunner")
    parser.add_argument("--no-scipy", action="store_true")
    parser.add_argument("--results", type=Path, help="a JSON file that keeps all ends, and is gone on with")
    parser.add_argument("--figure", type=Path)
    options = parser.parse_args()
    kept = json.loads(options.results.read_text()) if options.results and options.results.exists() else {}
    rows, ends = [], {}

    def save():
        if options.results:
            options.results.write_text(json.dumps(kept))

    for folder in sorted(p for p in options.folder.iterdir() if (p / f"{p.name}.yaml").exists()):
        if options.only and not any(folder.name.startswith(n) for n in options.only):
            continue
        try:
            problem = ph.read_petab(folder / f"{folder.name}.yaml")
            nominal = -problem.log_likelihood()
        except ph.PhugoidError as error:
            print(f"{folder.name}: {error}", flush=True)
            continue
        name = folder.name.split("_")[0]
        ends[name] = nominal, measured(folder, problem, options, kept.setdefault(folder.name, {}), save)
        for row in rows_of(name, problem, *ends[name]):
            rows.append(row)
            print("  ".join(row), flush=True)
    columns = ["problem", "program", "nominal", "best", "by LSODA", "at best", "s in all", "s a start"]
    columns += ["at best a minute", "s to the first"]
    show("Starts that end at the best known value", columns, rows, "processor time; peers have as much as ours used")
    if options.figure:
        figure(ends, options.figure)
    return 0


def figure(ends, path):
    """Draw the waterfalls: how far above the best known value each start ended, in order, in parts of all starts."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    columns = min(len(ends), 4)
    rows = -(-len(ends) // columns)
    size = 2.6 * columns, 2.8 * rows
    fig, axes = plt.subplots(rows, columns, figsize=size, squeeze=False, sharey=True, constrained_layout=True)
    for axis, (name, (nominal, found)) in zip(axes.flat, ends.items(), strict=False):
        best = best_known(nominal, found)
        for program, runs in found.items():
            each = np.array([end["value"] for end in runs])
            gaps = np.sort(each[np.isfinite(each)] - best)
            share = np.arange(1, gaps.size + 1) / max(each.size, 1)
            axis.plot(share, np.clip(gaps, *SHOWN), "o-", ms=3, lw=0.8, label=program)
        axis.set_yscale("log")
        axis.axhline(ENOUGH, color="0.7", lw=0.8)
        axis.set_title(name, fontsize=9)
        axis.set_xlabel("share of starts, best first")
    for axis in axes.flat[len(ends) :]:
        axis.set_visible(False)
    for row in axes:
        row[0].set_ylabel("above the best known")
    axes[0][0].legend(fontsize=7)
    fig.savefig(path, dpi=150)


if __name__ == "__main__":
    sys.exit(main())
