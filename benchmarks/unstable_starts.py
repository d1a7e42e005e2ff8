"""Count the random starts that reach the optimum on the simulated unstable aircraft of `examples/unstable_aircraft.py`.

All six derivatives start uniformly between -20 and 20. A start succeeds that converges to within 1e-5 of the optimum
that the published values lead to.

    python benchmarks/unstable_starts.py [--starts 1000] [--record unStabAC_sim.asc]

Without a record its simulated twin takes its place.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

import phugoid as ph

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "examples"))
import unstable_aircraft as case

EXACT = 1e-5
RANGE = (-20.0, 20.0)


def successes(record, order, starts, **options):
    """Return the number of starts that reach the optimum."""
    model, transcription = case.model(), ph.Collocation(order=order, threads=1)
    best = ph.estimate(model, record, start=case.PUBLISHED, transcription=transcription).parameters
    count = 0
    for seed in range(starts):
        random = np.random.RandomState(seed)
        start = {name: float(random.uniform(*RANGE)) for name in case.PUBLISHED}
        fit = ph.estimate(model, record, start=start, transcription=transcription, solver=ph.Newton(**options))
        off = max(abs(fit.parameters[name].value - best[name].value) for name in start)
        count += fit.status == "converged" and off < EXACT
    return count


def main():
    """Measure with and without the regression, and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--starts", type=int, default=1000)
    parser.add_argument("--record", type=Path)
    options = parser.parse_args()
    # The book's record was made with the trapezoid rule at the sample times.
    record, order = (case.experiment(options.record), 2) if options.record else (case.twin(), 4)
    for name, chosen in (("with a regression", {}), ("without", {"regression": False})):
        print(f"{name}: {successes(record, order, options.starts, **chosen)} of {options.starts}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
