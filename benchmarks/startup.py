"""Time from `import phugoid` to a whole fit of HFB-320, and to Ipopt's first iteration, each in a new interpreter.

The clock starts just before `import phugoid`, with numpy imported and the arrays of the record loaded, as
after a user's own reading of data.  With Newton it stops when `estimate` returns, standard errors and all.  With
Ipopt it stops where `progress` is first called, which is when Ipopt reports iteration 0: problem set up, starting
point evaluated; the time to the end of iteration 1, the first step, is shown below it.  Nothing is compiled on the
way.

    python benchmarks/startup.py [--repeats 5]
"""

import argparse
import json
import subprocess
import sys
import tempfile
from itertools import pairwise
from pathlib import Path

import hfb320_case as hfb
import numpy as np
from tables import median, seconds, show

AIM = 0.2
"""Seconds to the first iteration, and to a whole fit with Newton, that we want to stay below."""

BEGIN = """
import json, sys, time
marks = [("", time.perf_counter())]
def mark(what): marks.append((what, time.perf_counter()))

import numpy as np
mark("import numpy")
sys.path.insert(0, sys.argv[1])
import hfb320_case
arrays = [np.load(path) for path in sys.argv[2:]]
marks.append((None, time.perf_counter()))

import phugoid as ph
mark("import phugoid")
import phugoid_model
m = phugoid_model.model()
mark("model")
record = phugoid_model.experiment(*arrays)
progress = False
"""
NEWTON = """
class Timed(ph.Newton):
    def solve(self, *arguments, **keywords):
        mark("experiment, problem, start")
        solution = super().solve(*arguments, **keywords)
        mark("solve")
        return solution
chosen = Timed()
"""
IPOPT = """
import phugoid.solvers.ipopt as solver
load = solver.load_cyipopt
def timed_load():
    mark("experiment, problem, start")
    loaded = load()
    mark("load Ipopt")
    return loaded
solver.load_cyipopt = timed_load
chosen = ph.Ipopt()

def progress(iteration):
    mark("to iteration 0" if iteration.number == 0 else f"iteration {iteration.number}")
"""
END = """
ph.estimate(m, record, transcription=ph.Collocation(order=2), solver=chosen, progress=progress)
mark("standard errors, residuals, tables")
print(json.dumps(marks))
"""
SCRIPTS = {"Newton": BEGIN + NEWTON + END, "Ipopt": BEGIN + IPOPT + END}
FIRST = ("import phugoid", "model", "experiment, problem, start")
PARTS = {
    "Newton": (*FIRST, "solve", "standard errors, residuals, tables"),
    "Ipopt": (*FIRST, "load Ipopt", "to iteration 0"),
}
ENDS = {"Newton": "import phugoid to the whole fit", "Ipopt": "import phugoid to iteration 0"}


def once(script, paths):
    """{part: seconds} of one run."""
    folder = str(Path(__file__).parent)
    done = subprocess.run([sys.executable, "-c", script, folder, *paths], capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(done.stderr.strip().split("\n")[-1])
    marks = json.loads(done.stdout.strip().split("\n")[-1])
    return {what: end - begin for (_, begin), (what, end) in pairwise(marks) if what}


def collect(repeats):
    """{solver: [{part: seconds}]}, the solvers in turns."""
    case = hfb.load_case()
    with tempfile.TemporaryDirectory() as folder:
        paths = [str(Path(folder, f"{name}.npy")) for name in "tuz"]
        for path, array in zip(paths, (case.t, case.u, case.z), strict=True):
            np.save(path, array)
        runs = [{solver: once(script, paths) for solver, script in SCRIPTS.items()} for _ in range(repeats)]
    return {solver: [found[solver] for found in runs] for solver in SCRIPTS}


def run(repeats=5):
    """Measure and print."""
    for solver, runs in collect(repeats).items():
        parts, end = PARTS[solver], ENDS[solver]
        totals = [sum(found[part] for part in parts) for found in runs]
        listed = [(f"  {part}", [found[part] for found in runs]) for part in parts] + [(end, totals)]
        if solver == "Ipopt":
            steps = [total + found["iteration 1"] for total, found in zip(totals, runs, strict=True)]
            listed.append(("import phugoid to the end of iteration 1", steps))
        listed.append(("(before: import numpy)", [found["import numpy"] for found in runs]))
        verdict = "within" if median(totals) < AIM else "MISSES"
        show(
            f"Start-up on HFB-320, {solver}, {repeats} runs",
            ["", "fastest", "median"],
            [[name, seconds(min(values)), seconds(median(values))] for name, values in listed],
            f"{end}: {verdict} the aim of {seconds(AIM)}",
        )


def main():
    """From the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5)
    run(parser.parse_args().repeats)


if __name__ == "__main__":
    main()
