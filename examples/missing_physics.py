"""What a model misses: from a fit to a cause, an extended model and a page for a colleague.

A simulated twin of the HFB-320 record differs from the paper's model: its elevator has a delay, and its vane reads
too much, as one in the upwash ahead of a wing does. The model, which knows neither, fits the record well enough to be
believed: all parameters converge, with small standard errors, and are wrong. `diagnose` is told nothing of this. It
reads the residuals, tries some 250 candidates, and comes to one of three ends:

    named         the model misses a cause, or "one of" several that these data do not tell apart (its aliases);
    unexplained   the residuals are more than noise, but no candidate improves the prediction of held-out data;
    nothing       no effect that these data and candidates could show is missing.

A second manoeuvre of the same aircraft is held out: what is found must predict it, with only initial states and sensor
biases free.

    python examples/missing_physics.py            the twin, where the truth is known
    python examples/missing_physics.py --real     the flight record hfb320_1_10.asc, where it is not (takes minutes)

Writes out/missing_physics.html (or out/missing_physics_real.html), and the extended model as JSON beside it.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import hfb320
import numpy as np
from records import find

import phugoid as ph

# What the twin has and the model has not, by canonical name.
HIDDEN = {"alpha:scale": 0.08, "de:delay": 0.08}  # parts of the angle; s
# Of the flight record's standard deviations most is not noise of the sensors.
SIGMA = {name: 0.5 * sigma for name, sigma in hfb320.SIGMA.items()}


@dataclass(frozen=True)
class Walk:
    """The fit of the model as it was, and its diagnosis."""

    fit: ph.Fit
    diagnosis: ph.results.Diagnosis


def truth() -> ph.Model:
    """The paper's model with the two effects, put in as a user would: by extending it."""
    library, model = ph.candidates(hfb320.model()), hfb320.model()
    for name in HIDDEN:
        model = library[name].extended(model)
    return model


def manoeuvre(pulses: list[tuple[float, float, float]], seed: int, name: str) -> ph.Experiment:
    """A simulated record: pulses (begin, end, size in rad) of the elevator, and thrust that changes once."""
    t = 0.1 * np.arange(601)
    de = np.full(t.size, -0.008)
    for begin, end, size in pulses:
        de[(t >= begin) & (t < end)] += size
    thrust = np.where(t < 40, 11500.0, 12500.0)
    run = ph.Experiment(t, {"de": de, "T": thrust}, name=name)
    model = truth()
    new = [n for n in model.parameter_names if n not in hfb320.PUBLISHED]
    values = dict(zip(new, HIDDEN.values(), strict=True))
    initial = {"V": 106.0, "alpha": 0.112, "theta": 0.104, "q": 0.0}
    clean = ph.simulate(model, hfb320.PUBLISHED | values, run, initial=initial)
    rng = np.random.default_rng(seed)
    return run.with_outputs({n: y + SIGMA[n] * rng.standard_normal(t.size) for n, y in clean.outputs.items()})


def twins() -> tuple[ph.Experiment, ph.Experiment]:
    """The record to fit, with an elevator 3-2-1-1 and a pulse, and one to hold out, with two doublets."""
    fitted = manoeuvre(
        [(2, 5, 0.012), (5, 7, -0.012), (7, 8, 0.012), (8, 9, -0.012), (25, 27, 0.012)], 0, "simulated twin"
    )
    other = manoeuvre([(3, 5, 0.015), (5, 7, -0.015), (30, 31, -0.015), (31, 32, 0.015)], 1, "second manoeuvre")
    return fitted, other


def walk(data: ph.Experiment, validation: ph.Experiment | None, progress: bool = False) -> Walk:
    """Fits the paper's model and asks what it misses."""
    fit = ph.estimate(hfb320.model(), data)
    return Walk(fit, ph.diagnose(fit, validation=validation, progress=progress))


def compare(w: Walk, extended: ph.results.Extension) -> str:
    """Derivatives before and after beside those that the twin was made with."""
    lines = [f"{'':5s}{'as it was':>19s}{'extended':>19s}{'truth':>10s}"]
    for name, true in hfb320.PUBLISHED.items():
        if name.startswith("Cm"):
            before, after = w.fit.parameters[name], extended.fit.parameters[name]
            texts = "".join(f"{e.value:10.4f} ± {e.std_error:6.4f}" for e in (before, after))
            lines.append(f"{name:5s}{texts}{true:10.4f}")
    return "\n".join(lines)


def main() -> None:
    """Fit, diagnosis, extension, page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--real", action="store_true", help="the flight record instead of the twin")
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder for results")
    args = parser.parse_args()

    if args.real:
        path = find(hfb320.RECORD)
        if path is None:
            parser.exit(
                1, f"{hfb320.RECORD} is neither in $PHUGOID_DATA nor in ../shared/data: README says where it is\n"
            )
        w = walk(hfb320.experiment(path), None, progress=True)
    else:
        w = walk(*twins(), progress=True)
    print(w.diagnosis.summary())

    args.out.mkdir(exist_ok=True)
    stem = args.out / ("missing_physics_real" if args.real else "missing_physics")
    w.diagnosis.report(stem.with_suffix(".html"))
    print(f"\nWritten: {stem.with_suffix('.html')}")
    if not w.diagnosis.found:
        return
    extended = w.diagnosis.extend()
    print(f"\nWhat adding {', '.join(extended.added)} gains\n\n{extended.gain.summary()}")
    if not args.real:
        print(f"\nPitching moment: as fitted without what was hidden, and with it\n\n{compare(w, extended)}")
    extended.model.save(stem.with_suffix(".json"))
    print(f"\nWritten: {stem.with_suffix('.json')}")


if __name__ == "__main__":
    main()
