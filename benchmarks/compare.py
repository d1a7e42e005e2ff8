"""All benchmarks in one run: callbacks, time to solution, random starts, length of record and start-up.

    python benchmarks/compare.py [--quick] [--only kernels solution random_starts scaling startup]

Peers that are not installed are skipped, with the reason printed.  Each part is a program of its own, too.
Linear algebra runs on one thread, for every peer alike, unless OMP_NUM_THREADS says otherwise: on these small
matrices a second thread mostly waits, and times vary more.
"""

import argparse
import importlib
import os

from tables import attempt, console

PARTS = {
    "kernels": ({}, {"points": (601,), "rounds": 5, "target": 0.02}),
    "solution": ({}, {"repeats": 2, "newton": 10, "shooting": False}),
    "random_starts": ({}, {"ours": 50, "stall": 10, "ipopt": 5, "casadi": 3, "scipy": 1}),
    "scaling": ({}, {"newton": (600, 6_000), "ipopt": (600,), "repeats": 1}),
    "startup": ({}, {"repeats": 3}),
}
"""Name of a module -> options of its `run`, and those for --quick."""


def run(name, options):
    """Import and run a part."""
    importlib.import_module(name).run(**options)


def main():
    """Run the chosen parts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer repetitions and starts, no single shooting")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), help="parts to run")
    arguments = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # read when numpy and Ipopt are loaded, so before that
    for name in arguments.only:
        console.rule(name.replace("_", " "))
        attempt(name, run, name, PARTS[name][arguments.quick])


if __name__ == "__main__":
    main()
