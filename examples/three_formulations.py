"""Single shooting, multiple shooting and collocation of the same model, on the same records, with the same solver.

Each record is fitted from a start near the optimum (published values, each off by up to 20 %) and from a poor one (all
derivatives 0). Only the formulation differs: what the unknowns are, and so what a poor start can spoil.

    python examples/three_formulations.py

Uses the records of HFB-320 and the unstable aircraft where it finds them, else simulated twins. Prints a table and
writes out/three_formulations.png.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import hfb320
import numpy as np
import unstable_aircraft
from records import find

import phugoid as ph

STARTS = ("near", "zeros")


@dataclass(frozen=True)
class Case:
    """A record with its model; ``optimum`` is about where it lies, ``shown`` the output in the figure."""

    title: str
    model: ph.Model
    data: ph.Experiment
    optimum: Mapping[str, float]
    segments: int
    shown: str

    def formulations(self) -> dict[str, ph.Collocation | ph.MultipleShooting | ph.SingleShooting]:
        """All with steps well below what the noise could tell apart."""
        return {
            "single shooting": ph.SingleShooting(integrator="dopri5", substeps=2),
            "multiple shooting": ph.MultipleShooting(self.segments, integrator="dopri5", substeps=2),
            "collocation": ph.Collocation(order=5),
        }

    def start(self, name: str, seed: int = 1) -> dict[str, float]:
        """Starting values of the derivatives; states start as measured."""
        if name == "zeros":
            return dict.fromkeys(self.model.parameter_names, 0.0)
        off = np.random.default_rng(seed).uniform(0.8, 1.2, len(self.optimum))
        return {n: float(v * f) for (n, v), f in zip(self.optimum.items(), off, strict=True)}


@dataclass(frozen=True)
class Outcome:
    """What became of one formulation from one start; ``fit`` is None where the start itself raised an error."""

    case: Case
    start: str
    formulation: str
    fit: ph.Fit | None
    message: str
    error: float
    """Greatest error of a parameter against the reference, in standard errors of the reference."""

    @property
    def arrived(self) -> bool:
        """Whether the optimum was found: all parameters within a tenth of a standard error."""
        return self.fit is not None and self.fit.converged and self.error < 0.1


def cases() -> list[Case]:
    """Both records, or their twins."""
    hfb, unstable = find(hfb320.RECORD), find(unstable_aircraft.RECORD)
    return [
        Case(
            "HFB-320" if hfb else "HFB-320 (twin)",
            hfb320.model(),
            hfb320.experiment(hfb) if hfb else hfb320.twin(),
            hfb320.PUBLISHED,
            60,
            "alpha",
        ),
        Case(
            "unstable aircraft" if unstable else "unstable aircraft (twin)",
            unstable_aircraft.model(),
            unstable_aircraft.experiment(unstable) if unstable else unstable_aircraft.twin(),
            unstable_aircraft.PUBLISHED,
            25,
            "w",
        ),
    ]


def reference(case: Case) -> ph.Fit:
    """Collocation of a higher order, from near."""
    return ph.estimate(case.model, case.data, transcription=ph.Collocation(order=8), start=case.start("near"))


def run(case: Case, best: ph.Fit, start: str) -> list[Outcome]:
    """The three formulations from a start. The regression that precedes collocation elsewhere is left out."""
    solver = ph.Newton(regression=False)
    found = []
    for name, transcription in case.formulations().items():
        try:
            fit = ph.estimate(
                case.model, case.data, transcription=transcription, start=case.start(start), solver=solver
            )
        except ph.EvaluationError as error:
            found.append(Outcome(case, start, name, None, str(error), float("inf")))
            continue
        off = [abs(fit.parameters[n].value - best.parameters[n].value) / best.parameters[n].std_error
               for n in case.model.parameter_names]  # fmt: skip
        found.append(Outcome(case, start, name, fit, fit.message, max(off)))
    return found


def table(outcomes: Sequence[Outcome]) -> str:
    """Status, iterations, log-likelihood, error in standard errors and time."""
    lines = [
        f"{'record':26s}{'start':7s}{'formulation':19s}{'status':17s}{'iterations':>10s}{'log-likelihood':>16s}"
        f"{'error/std':>11s}{'time, s':>9s}"
    ]
    for o in outcomes:
        head = f"{o.case.title:26s}{o.start:7s}{o.formulation:19s}"
        if o.fit is None:
            lines += [f"{head}no simulation at the start: {o.message}"]
            continue
        f = o.fit
        lines.append(f"{head}{f.status:17s}{f.iterations:10d}{f.log_likelihood:16.4f}{o.error:11.1e}{f.time:9.3f}")
    return "\n".join(lines)


def draw(outcomes: Sequence[Outcome], references: Mapping[str, ph.Fit], path: Path) -> None:
    """From zeros: how far the likelihood is below its maximum in each iteration, and what was fitted in the end."""
    from matplotlib.figure import Figure

    titles = list(references)
    figure = Figure(figsize=(11, 3.4 * len(titles)), layout="constrained")
    axes = figure.subplots(len(titles), 2, squeeze=False)
    colours = {"single shooting": "C3", "multiple shooting": "C1", "collocation": "C0"}
    for (left, right), title in zip(axes, titles, strict=True):
        own = [o for o in outcomes if o.case.title == title and o.start == "zeros"]
        case, best = own[0].case, references[title]
        z, t = case.data.output(case.shown), case.data.t
        right.plot(t, z, ".", color="0.7", label="measured")
        for o in own:
            if o.fit is None:
                left.plot([], [], color=colours[o.formulation], label=f"{o.formulation}: no simulation at the start")
                continue
            below = [best.log_likelihood - line.log_likelihood for line in o.fit.history]
            left.plot(np.abs(below), color=colours[o.formulation], label=f"{o.formulation}: {o.fit.status}")
            right.plot(t, o.fit.outputs[case.shown], color=colours[o.formulation], lw=1, label=o.formulation)
        left.set(yscale="log", xlabel="iteration", ylabel="|log-likelihood below its maximum|")
        left.set_title(f"{title}, from all derivatives 0")
        margin = 0.5 * np.ptp(z)
        right.set(ylim=(z.min() - margin, z.max() + margin), xlabel="t, s", ylabel=case.shown)
        left.legend(fontsize="small")
        right.legend(fontsize="small")
    path.parent.mkdir(exist_ok=True)
    figure.savefig(path, dpi=150)


def main() -> None:
    """Table on the screen, figure in out/."""
    outcomes: list[Outcome] = []
    references = {}
    for case in cases():
        references[case.title] = reference(case)
        for start in STARTS:
            outcomes += run(case, references[case.title], start)
    print(table(outcomes))
    path = Path("out") / "three_formulations.png"
    draw(outcomes, references, path)
    print(f"\nWritten: {path}")


if __name__ == "__main__":
    main()
