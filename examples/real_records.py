"""What the diagnosis says about real records, beside what is known of them.

Each record is fitted with a model that lacks something, is diagnosed with another part of it, or another record, held
out, and the verdict is printed beside what other sources say. None of the models was made for the diagnosis, and
none of the records was made by us:

hfb320      HFB-320 aircraft, elevator 3-2-1-1 and what follows it: the model of the textbook (Jategaonkar 2015).
attas       ATTAS aircraft, two elevator manoeuvres: a model with the vane at the centre of gravity. It is on a boom
            13.08 m ahead, which at this airspeed reads like a delay of 0.102 s.
pendulum1,  a free pendulum that swings down to rest, by an encoder of 2,000 counts: a model with viscous damping
pendulum2   alone.
cart2_...,  a cart on a rail in a limit cycle that a relay keeps up: a model with viscous friction alone. The friction
cart3_...   depends on the direction and on the place on the rail, which by one record is a constant force.
ball        a ball on a beam in a closed loop: a model with gain and offset.
f16         an F-16 on the ground, shaken by a multisine: six linear modes. The mounting of a payload has clearance and
            dry friction. Takes many minutes, and gigabytes of memory: only where it is named.

    python examples/real_records.py [hfb320 attas ...] [--out out/real_records]

The laboratory records are in no way part of this project: pendulums and carts by N. Skov (master's thesis, 2019,
github.com/nielsSkov/masterThesisMatlab, folder parameterEstimation/data), the ball and beam from the DaISy collection
(KU Leuven, ESAT-SISTA). They are looked for as known/*.csv in the folder of the other records; README says where that
is. Records that are not there are left out. Writes a page for each, and one with the table.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import attas
import f16_vibration as f16
import hfb320
import numpy as np
from records import find
from scipy.signal import find_peaks

import phugoid as ph


@dataclass(frozen=True)
class Case:
    """A model, the records to fit and to hold out, and what is known of what the model lacks: in words, and the causes
    any of which is right; None where that is open."""

    model: ph.Model
    fitted: Sequence[ph.Experiment]
    held_out: Sequence[ph.Experiment]
    known: str
    right: tuple[str, ...] | None = None
    biases: tuple[str, ...] | None = None


def hfb320_case() -> Case | None:
    """Return the first 20 s of the record to fit, the rest held out."""
    path = find(hfb320.RECORD)
    if path is None:
        return None
    run = hfb320.experiment(path)
    parts = run.window(0.0, 20.0, name="3-2-1-1"), run.window(20.0, run.t[-1], name="the rest")
    known = "Not known. Later models have unsteady lift and downwash."
    return Case(hfb320.model(), parts[:1], parts[1:], known)


def attas_case() -> Case | None:
    """Return one manoeuvre to fit, the other held out, with the vane taken to be at the centre of gravity."""
    paths = [find(name) for name in attas.RECORDS]
    if not all(paths):
        return None
    first, second = (attas.experiment(p, n) for p, n in zip(paths, ("first", "second"), strict=True) if p)
    known = "The vane is 13.08 m ahead: the angle of attack lacks -13.08 q / V = -0.102 s q."
    return Case(attas.model(vane=False), [first], [second], known, ("alpha:q",), attas.TRIM)


def pendulum(number: int) -> Case | None:
    """Return a pendulum with viscous damping; swings above 0.8 rad are fitted, the smaller ones held out."""
    rows = laboratory(f"pendulum{number}")
    if rows is None:
        return None
    t, phi = rows[:, 0], rows[:, 1] - np.pi
    turns, _ = find_peaks(np.abs(phi), prominence=10 * COUNT)
    begin, end = turns[0], turns[-1]
    split = next(k for k in turns if abs(phi[k]) < 0.8)
    m = ph.Model(f"pendulum {number}")
    angle, rate = m.states(phi=ph.State("rad", start=float(phi[begin])), w="rad/s")
    w2, c = m.parameters(w2=ph.Parameter(40.0, unit="1/s²"), c=ph.Parameter(0.05, unit="1/s"))
    m.dynamics(phi=rate, w=-w2 * ph.sin(angle) - c * rate)
    m.outputs(phi=angle)

    def part(first: int, last: int, name: str) -> ph.Experiment:
        return ph.Experiment(t[first:last] - t[first], {}, {"phi": phi[first:last]}, name=name)

    known = "Dry friction f sign(w) of the bearing (Skov); a swinging rod has some air drag, d w|w|."
    return Case(m, [part(begin, split, "large")], [part(split, end, "small")], known, ("w':sign(w)", "w':w|w|"))


def cart(series: int, place: str) -> Case | None:
    """Return a cart with viscous friction: pieces of 2 s of a limit cycle, each with a start of its own.

    Over whole cycles the mean velocity is zero, so that the mean of the current tells the force to one side without a
    fit.
    """
    rows = laboratory(f"cart{series}_0m{place}")
    if rows is None:
        return None
    m = ph.Model(f"cart at 0.{place} m")
    (current,) = m.inputs(i="A")
    x, v = m.states(x="m", v="m/s")
    (c,) = m.parameters(c=ph.Parameter(0.5, unit="1/s"))
    m.dynamics(x=v, v=PER_AMPERE * current - c * v)
    m.outputs(x=x)

    def piece(first: int) -> ph.Experiment:
        t, i, at = rows[first : first + 300, :3].T
        return ph.Experiment(t - t[0], {"i": i}, {"x": at}, name=f"row {first}", interpolation="hold")

    force = -PER_AMPERE * mean_over_cycles(rows[300:2700, 1])
    known = f"{FORCE} By the mean current that is {force:+.3f} m/s²."
    right = ("v':bias",) if abs(force) > SMALL_FORCE else ()
    return Case(m, [piece(k) for k in range(300, 1800, 300)], [piece(k) for k in range(1800, 2700, 300)], known, right)


def mean_over_cycles(current: np.ndarray) -> float:
    """Return the mean of a switched current from its first rise to its last."""
    rises = np.flatnonzero(np.diff(np.sign(current)) > 0) + 1
    return float(np.mean(current[rises[0] : rises[-1]]))


def ball_and_beam() -> Case | None:
    """Return a ball that rolls on a beam: pieces of 5 s, each with a start of its own."""
    rows = laboratory("ball_and_beam")
    if rows is None:
        return None
    m = ph.Model("ball and beam")
    (u,) = m.inputs(u="rad")
    y, v = m.states(y="m", v="m/s")
    gain, offset = m.parameters(K=ph.Parameter(5.0, unit="m/s²"), a0=ph.Parameter(0.0, unit="m/s²"))
    m.dynamics(y=v, v=gain * ph.sin(u) + offset)
    m.outputs(y=y)

    def piece(first: int) -> ph.Experiment:
        t, angle, at = rows[first : first + 50, :3].T
        return ph.Experiment(t - t[0], {"u": angle}, {"y": at}, name=f"row {first}")

    known = "A solid ball that rolls on its lowest point has K = (5/7) g = 7.0; nothing is known of the rig."
    return Case(m, [piece(k) for k in range(30, 551, 50)], [piece(k) for k in range(600, 951, 50)], known)


def f16_case() -> Case | None:
    """Return two periods of the force to fit and one held out, with six linear modes."""
    run = f16.recorded()
    if run is None:
        return None
    model, fitted, held_out = f16.diagnosed(run)
    parts = [e.window(e.t[0], e.t[-1], name=n) for e, n in ((fitted, "two periods"), (held_out, "another"))]
    known = "Clearance and friction of a mounting make the mode near 7.3 Hz, the fifth, nonlinear (Noël and Schoukens)."
    mode = ("x_5a':hysteresis_x_5b", "x_5b':hysteresis_x_5a", "x_5a':hysteresis_x_5a", "x_5b':hysteresis_x_5b")
    return Case(model, parts[:1], parts[1:], known, (*mode, *f16.SOFTENING, "x_5a':x_5b|x_5b|"))


def laboratory(name: str) -> np.ndarray | None:
    """Return the rows of a laboratory record; None where it is not there."""
    path = find(f"known/{name}.csv")
    return None if path is None else np.loadtxt(path, delimiter=",", skiprows=1)


COUNT = 2 * np.pi / 2000  # of the encoder of the pendulums, in rad
PER_AMPERE = 0.0934 / 0.028 / 6.28  # m/s²: torque constant, N m/A; radius of the wheel, m; mass, kg (Skov)
SMALL_FORCE = 0.01  # m/s², of a dry friction of about 0.4
FORCE = "Friction differs with direction and place (Skov): in one record the same as a force to one side."
CASES: dict[str, Callable[[], Case | None]] = {
    "hfb320": hfb320_case,
    "attas": attas_case,
    "pendulum1": lambda: pendulum(1),
    "pendulum2": lambda: pendulum(2),
    "cart2_08": lambda: cart(2, "08"),
    "cart2_42": lambda: cart(2, "42"),
    "cart2_60": lambda: cart(2, "60"),
    "cart3_08": lambda: cart(3, "08"),
    "cart3_42": lambda: cart(3, "42"),
    "cart3_60": lambda: cart(3, "60"),
    "ball": ball_and_beam,
    "f16": f16_case,
}


ONLY_BY_NAME = ("f16",)


def said(d: ph.Diagnosis) -> list[str]:
    """Return a line for each finding: its status, cause, estimates, and the part of the misfit that it explains."""
    lines = []
    for f in d.findings:
        values = ", ".join(f"{n} = {v:.3g} ± {s:.1g}" for n, (v, s) in f.parameters.items())
        part = "" if np.isnan(f.explained) else f"; explains {100 * f.explained:.0f} % of the misfit held out"
        others = f" (or {', '.join(f.aliases)})" if f.aliases else ""
        lines.append(f"{f.status}: {f.cause or 'a cause not established'}{others} {values}{part}")
    return lines or [d.verdict]


def judged(d: ph.Diagnosis, case: Case) -> str:
    """Return whether a diagnosis agrees with what is known: "agrees", "agrees in part", where it names something else
    as well, "does not agree", "does not name it", or "open" where nothing is known."""
    if case.right is None:
        return "open"
    named = [{f.cause, *f.aliases} for f in d.findings if f.status == "named"]
    hits = [bool(names & {*case.right}) for names in named]
    if not named:
        return "does not name it" if case.right else "agrees"
    return "agrees" if all(hits) else "agrees in part" if any(hits) else "does not agree"


def main() -> None:
    """Fit and diagnose the records that are there, print the table, and write the pages."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", choices=[*CASES, []], help="records; all that are there if none is named")
    parser.add_argument("--out", type=Path, default=Path("out/real_records"), help="folder for the pages")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for name in args.names or [n for n in CASES if n not in ONLY_BY_NAME]:
        case = CASES[name]()
        if case is None:
            print(f"\n{name}: the record is not there")
            continue
        began = time.perf_counter()
        fit = ph.estimate(case.model, list(case.fitted))
        d = ph.diagnose(fit, validation=list(case.held_out), biases=case.biases, progress=True)
        d.report(args.out / f"{name}.html")
        print(f"\n{name} ({time.perf_counter() - began:.0f} s): {d.verdict}; {judged(d, case)}", flush=True)
        for line in said(d):
            print(f"  {line}")
        print(f"  known: {case.known}")
        found = "<br>".join(escape(line) for line in said(d))
        rows.append(f'<tr><td><a href="{name}.html">{name}</a><td>{found}<td>{escape(case.known)}<td>{judged(d, case)}')
    page = args.out / "index.html"
    page.write_text(PAGE.replace("ROWS", "\n".join(rows)), encoding="utf-8")
    print(f"\n{page.resolve()}")


PAGE = """<!doctype html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>Real records</title>
<style>
body { font: 16px/1.5 sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; color-scheme: light dark }
td, th { text-align: left; vertical-align: top; padding: .4rem .8rem .4rem 0; border-top: 1px solid #8888 }
</style>
<h1>What the diagnosis says about real records</h1>
<table><tr><th>record<th>what the diagnosis says<th>what is known<th>
ROWS
</table></html>
"""


if __name__ == "__main__":
    main()
