"""Time from `import phugoid` to the first Ipopt iteration on HFB-320, each run in a new interpreter.

The clock starts just before `import phugoid`, with numpy imported and the arrays of the record loaded, as
after a user's own reading of data, and stops where `progress` is first called, which is when Ipopt reports
iteration 0: problem set up, starting point evaluated.  The time to the end of iteration 1, the first step, is
shown below it.  Nothing is compiled on the way.

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
"""Seconds to the first iteration that we want to stay below."""

SCRIPT = """
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

import phugoid.solvers.ipopt as solver
load = solver.load_cyipopt
def timed_load():
    mark("experiment, problem, start")
    loaded = load()
    mark("load Ipopt")
    return loaded
solver.load_cyipopt = timed_load

def progress(iteration):
    mark("to iteration 0" if iteration.number == 0 else f"iteration {iteration.number}")

ph.estimate(m, record, transcription=ph.Collocation(order=2), progress=progress)
mark("rest")
print(json.dumps(marks))
"""
PARTS = ("import phugoid", "model", "experiment, problem, start", "load Ipopt", "to iteration 0")


def once(paths):
    """{part: seconds} of one run."""
    folder = str(Path(__file__).parent)
    command = [sys.executable, "-c", SCRIPT, folder, *paths]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(done.stderr.strip().split("\n")[-1])
    marks = json.loads(done.stdout.strip().split("\n")[-1])
    return {what: end - begin for (_, begin), (what, end) in pairwise(marks) if what}


def run(repeats=5):
    """Measure and print."""
    case = hfb.load_case()
    with tempfile.TemporaryDirectory() as folder:
        paths = [str(Path(folder, f"{name}.npy")) for name in "tuz"]
        for path, array in zip(paths, (case.t, case.u, case.z), strict=True):
            np.save(path, array)
        runs = [once(paths) for _ in range(repeats)]
    totals = [sum(found[part] for part in PARTS) for found in runs]
    steps = [total + found["iteration 1"] for total, found in zip(totals, runs, strict=True)]
    listed = [(f"  {part}", [found[part] for found in runs]) for part in PARTS]
    listed += [("import phugoid to iteration 0", totals), ("import phugoid to the end of iteration 1", steps)]
    listed += [("(before: import numpy)", [found["import numpy"] for found in runs])]
    verdict = "within" if median(totals) < AIM else "MISSES"
    show(
        f"Start-up on HFB-320, {repeats} runs",
        ["", "fastest", "median"],
        [[name, seconds(min(values)), seconds(median(values))] for name, values in listed],
        f"import to iteration 0: {verdict} the aim of {seconds(AIM)}",
    )


def main():
    """From the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5)
    run(parser.parse_args().repeats)


if __name__ == "__main__":
    main()
