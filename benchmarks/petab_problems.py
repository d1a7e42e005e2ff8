"""Random starts on problems in the PEtab format, against scipy by single shooting, and pyPESTO with Fides on AMICI.

    python benchmarks/petab_problems.py FOLDER [--starts 100] [--only Boehm Rahman] [--peer PYTHON] [--figure FILE]

FOLDER holds problems as the benchmark collection has them (a folder each, its YAML file of the same name); it does
not ship with phugoid. Starts are a Latin hypercube within the bounds, of logarithms where the table says so, the same
for all. Each start of ours has 60 s. A peer has the processor time that ours used for all starts, and no more starts
than these. `--peer`: an interpreter that has pyPESTO, Fides and AMICI (see `petab_pypesto`). The best known value is
the better of the nominal point and of all that was found; a start that ends within 0.1 of it counts.
"""

import argparse
import json
import math
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
LIMIT = 60.0


def ours(problem, starts):
    """Negative log-likelihood and processor time of each start."""
    for start in starts:
        before = time.process_time()
        try:
            fit = ph.estimate(problem.model, problem.experiments, start=start, solver=ph.Newton(time_limit=LIMIT))
            value = -(fit.log_likelihood + problem.constant)
        except ph.EvaluationError:
            value = math.nan
        yield value, time.process_time() - before


def pypesto(python, path, starts, seconds):
    """The same by pyPESTO in another interpreter."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "starts.json"
        file.write_text(json.dumps(starts))
        script = Path(__file__).with_name("petab_pypesto.py")
        command = [python, str(script), str(Path(path).resolve()), str(file), str(seconds)]
        done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    if not lines:
        print(f"  pyPESTO failed: {done.stderr.strip().splitlines()[-1:]}")
    return [(line["nllh"], line["cpu"]) for line in lines]


def main():
    """Print a table of all problems."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--starts", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", default=[])
    parser.add_argument("--peer", help="an interpreter with pyPESTO, Fides and AMICI")
    parser.add_argument("--no-scipy", action="store_true")
    parser.add_argument("--figure", type=Path)
    options = parser.parse_args()
    rows, ends = [], {}
    for folder in sorted(p for p in options.folder.iterdir() if (p / f"{p.name}.yaml").exists()):
        if options.only and not any(folder.name.startswith(n) for n in options.only):
            continue
        path = folder / f"{folder.name}.yaml"
        try:
            problem = ph.read_petab(path)
            nominal = -problem.log_likelihood()
        except ph.PhugoidError as error:
            print(f"{folder.name}: {error}", flush=True)
            continue
        starts = problem.starts(options.starts, seed=options.seed)
        found = {"phugoid": list(ours(problem, starts))}
        seconds = sum(cpu for _, cpu in found["phugoid"])
        if options.peer:
            found["pyPESTO"] = pypesto(options.peer, path, starts, seconds)
        if not options.no_scipy:
            found["scipy"] = list(petab_shooting.run(problem, starts, seconds))
        best = min([nominal, *(v for runs in found.values() for v, _ in runs if math.isfinite(v))])
        ends[folder.name] = (best, found)
        for name, runs in found.items():
            cpu = sum(c for _, c in runs)
            at_best = [i for i, (v, _) in enumerate(runs) if v <= best + ENOUGH]
            first = sum(c for _, c in runs[: at_best[0] + 1]) if at_best else math.nan
            row = [folder.name.split("_")[0], name, f"{nominal:.3f}", f"{best:.3f}", f"{len(at_best)} of {len(runs)}"]
            row += [f"{cpu / max(len(runs), 1):.2f}", f"{60 * len(at_best) / max(cpu, 1e-9):.1f}", f"{first:.1f}"]
            rows.append(row)
            print("  ".join(row), sorted(round(v, 2) for v, _ in runs if math.isfinite(v))[:12], flush=True)
    columns = ["problem", "program", "nominal", "best", "at best", "s a start", "at best a minute", "s to the first"]
    show("Starts that end at the best known value", columns, rows, "processor time; equal for all programs at most")
    if options.figure:
        figure(ends, options.figure)
    return 0


def figure(ends, path):
    """Draw the waterfalls: how far above the best known value each start ended, in order."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    fig, axes = plt.subplots(1, len(ends), figsize=(2.6 * len(ends), 3.0), squeeze=False, constrained_layout=True)
    for axis, (name, (best, found)) in zip(axes[0], ends.items(), strict=True):
        for label, runs in found.items():
            gaps = np.sort([v - best for v, _ in runs if math.isfinite(v)])
            axis.plot(np.arange(1, gaps.size + 1), np.maximum(gaps, 1e-4), "o-", ms=3, lw=0.8, label=label)
        axis.set_yscale("log")
        axis.axhline(ENOUGH, color="0.7", lw=0.8)
        axis.set_title(name.split("_")[0], fontsize=9)
        axis.set_xlabel("starts, best first")
    axes[0][0].set_ylabel("above the best known")
    axes[0][0].legend(fontsize=7)
    fig.savefig(path, dpi=150)


if __name__ == "__main__":
    sys.exit(main())
