"""All benchmarks in one run: callbacks, time to solution, random starts and start-up, for us and for peers.

    python benchmarks/compare.py [--quick] [--only kernels solution starts startup]

Peers that are not installed are skipped, with the reason printed.  Each part is a program of its own, too.
"""

import argparse

import kernels
import random_starts
import solution
import startup
from tables import attempt, console

PARTS = {
    "kernels": (kernels.run, {}, {"points": (601,), "rounds": 5, "target": 0.02}),
    "solution": (solution.run, {}, {"repeats": 2, "shooting": False}),
    "starts": (random_starts.run, {}, {"ours": 10, "casadi": 3, "scipy": 1}),
    "startup": (startup.run, {}, {"repeats": 3}),
}
"""Name -> function, its options, its options for --quick."""


def main():
    """Run the chosen parts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer repetitions and starts, no single shooting")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), help="parts to run")
    arguments = parser.parse_args()
    for name in arguments.only:
        function, full, quick = PARTS[name]
        console.rule(name)
        attempt(name, lambda f=function, o=quick if arguments.quick else full: f(**o))


if __name__ == "__main__":
    main()
