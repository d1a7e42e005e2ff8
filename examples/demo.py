"""The demonstration that `make demo` runs: fit, validation, diagnosis, extension, and two pages of HTML.

The model of the paper is fitted to the HFB-320 flight record, where that is found. Then it is fitted to the elevator
3-2-1-1 of the first 20 s alone, must predict the rest, and is diagnosed. Otherwise two manoeuvres are simulated, with a
delayed elevator and an angle-of-attack vane of a wrong scale, which the model does not have: the diagnosis finds them.

    python examples/demo.py [--out out]
"""

from __future__ import annotations

import argparse
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import hfb320
import missing_physics
from records import find

import phugoid as ph

SPLIT = 20.0  # s


def records() -> tuple[ph.Experiment, ph.Experiment, ph.Experiment, str]:
    """Return the whole record, the part to diagnose, that to validate on, and a sentence on where they come from."""
    path = find(hfb320.RECORD)
    if path is None:
        hidden = " and ".join(f"{name} = {value:g}" for name, value in missing_physics.HIDDEN.items())
        about = f"{hfb320.RECORD} is not there (see README). Two manoeuvres are simulated, with {hidden} hidden."
        first, second = missing_physics.twins()
        return first, first, second, about
    flight = hfb320.experiment(path)
    first, second = flight.window(0.0, SPLIT, name="3-2-1-1"), flight.window(SPLIT, flight.t[-1], name="second part")
    return flight, first, second, f"Flight record {path}"


def brief(fit: ph.Fit) -> str:
    """Return how a fit ended, with the derivatives of the pitching moment and the lift slope."""
    lines = [f"{fit.status} after {fit.iterations} iterations, {1e3 * fit.time:.0f} ms; all derivatives started at 0"]
    estimates = fit.robust().parameters
    shown = [f"{n} = {estimates[n].value:.4g} ± {estimates[n].std_error:.2g}" for n in ("CLa", "Cma", "Cmq", "Cmde")]
    return "\n".join([*lines, ", ".join(shown) + "  (± corrected for residual autocorrelation)"])


def main() -> None:
    """Run the four steps, each with the time at which it began, and write the pages."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder for results")
    args = parser.parse_args()
    args.out.mkdir(exist_ok=True)
    began = time.perf_counter()

    def step(title: str) -> None:
        print(f"\n== {title} ({time.perf_counter() - began:.0f} s)", flush=True)

    step("1 of 4: fit")
    record, first, second, about = records()
    print(about)
    fit = ph.estimate(hfb320.model(), record)
    print(brief(fit))
    fit.save(args.out / "hfb320.json")

    step("2 of 4: validation")
    base = fit
    if first is not record:
        print(f"The model is fitted to the first {SPLIT:g} s and must predict the rest.")
        base = ph.estimate(hfb320.model(), first)
    check = base.validate(second)
    print(check.summary())

    pages = args.out / "hfb320.html", args.out / "hfb320_missing.html"
    # The page of the fit is drawn by a process of its own meanwhile: a diagnosis uses one core for most of its time.
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as beside:
        page_of_fit = beside.submit(fit.report, pages[0], validation=check if base is fit else None)

        step("3 of 4: diagnosis, among some 250 candidates")
        diagnosis = ph.diagnose(base, validation=second, progress=True)
        print(diagnosis.summary())

        # Where no cause is named there may be an unknown function or a minor finding, which `minor` adds to the model.
        minor = not diagnosis.extend().added
        extended = diagnosis.extend(minor=minor)
        step(f"4 of 4: extension by {', '.join(extended.added) or 'nothing'}")
        print(extended.gain.summary())

        diagnosis.report(pages[1], minor=minor)
        page_of_fit.result()
    step("done")
    print(f"{pages[0].resolve()}  the fit")
    print(f"{pages[1].resolve()}  what the model misses, and its new equations")


if __name__ == "__main__":
    main()
