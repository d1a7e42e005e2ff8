"""Short period in turbulence: output error misreads gusts, the filter-error method estimates them.

An aircraft flies an elevator manoeuvre through vertical gusts (Dryden's spectrum of first order: intensity 1.5 m/s,
scale length 150 m). Output error has no place for them but the measurement noise: its derivatives scatter, and by far
more than its standard errors say. With process noise in the gust's state, the estimates are many times closer, and so
is what is said of their errors; the gust is found too. Twenty records are simulated and fitted both ways.

    python examples/turbulence.py

Prints a table and writes out/turbulence.png (a few seconds).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.figure import Figure

import phugoid as ph

V = 44.57  # airspeed, m/s
RATE = V / 150.0  # of the gust, 1/s: airspeed over scale length
GUST = 1.5  # m/s
TRUTH = {"Zw": -1.4, "Zq": -1.5, "Zde": -6.3, "Mw": -0.15, "Mq": -2.7, "Mde": -12.8}
SIGMA = {"w": 0.1, "q": 0.003, "az": 0.05}
INTENSITY = GUST * np.sqrt(2 * RATE)  # of the white noise that gives such a gust, m/s/√s
STEP, SAMPLES, FINE = 0.05, 400, 20


def model(gust: bool) -> ph.Model:
    """The short period; with ``gust`` the vertical wind is a state, and the air flows at w - wg past the vane."""
    m = ph.Model("short period in turbulence" if gust else "short period")
    w, q = m.states(w="m/s", q="rad/s")
    (de,) = m.inputs(de="rad")
    Zw, Zq, Zde, Mw, Mq, Mde = m.parameters("Zw Zq Zde Mw Mq Mde")
    flow = w
    if gust:
        (wg,) = m.states(wg="m/s")
        flow = w - wg
    az = Zw * flow + Zq * q + Zde * de
    m.dynamics(w=az + V * q, q=Mw * flow + Mq * q + Mde * de)
    if gust:
        m.dynamics(wg=-RATE * wg)
    m.outputs(w=flow, q=q, az=(az, "m/s²"))
    return m


def record(seed: int, gust: float = GUST) -> tuple[ph.Experiment, np.ndarray]:
    """A simulated record, and the gust in it at the samples. The gust goes on between samples, too."""
    rng = np.random.default_rng(seed)
    p, h = TRUTH, STEP / FINE
    t = STEP * np.arange(SAMPLES)
    de = 0.05 * np.select([t < 1, t < 4, t < 6, t < 7, t < 8, t < 12, t < 13, t < 14], [0, 1, -1, 1, -1, 0, 1, -1], 0)
    A = np.array([[p["Zw"], V + p["Zq"], -p["Zw"]], [p["Mw"], p["Mq"], -p["Mw"]], [0, 0, -RATE]])
    B = np.array([p["Zde"], p["Mde"], 0])
    # A step with the gust's white noise within it (to first order in h), the elevator held: the steps are fine.
    phi = np.eye(3) + h * A + h * h / 2 * A @ A + h**3 / 6 * A @ A @ A
    gamma = (h * np.eye(3) + h * h / 2 * A + h**3 / 6 * A @ A) @ B
    x = np.array([0.0, 0.0, gust * rng.standard_normal()])
    states = [x]
    for k in range(SAMPLES - 1):
        for j in range(FINE):
            x = phi @ x + gamma * (de[k] + (j + 0.5) / FINE * (de[k + 1] - de[k]))
            x[2] += gust * np.sqrt(2 * RATE * h) * rng.standard_normal()
        states.append(x)
    w, q, wg = np.array(states).T
    outputs = {"w": w - wg, "q": q, "az": p["Zw"] * (w - wg) + p["Zq"] * q + p["Zde"] * de}
    noisy = {n: y + SIGMA[n] * rng.standard_normal(t.size) for n, y in outputs.items()}
    return ph.Experiment(t, {"de": de}, noisy, name=f"record {seed}"), wg


@dataclass(frozen=True)
class Pair:
    """One record, fitted both ways."""

    data: ph.Experiment
    gust: np.ndarray
    ordinary: ph.Fit
    filtered: ph.Fit


def solve(seed: int) -> Pair:
    """Simulates a record and fits it."""
    data, gust = record(seed)
    ordinary = ph.estimate(model(gust=False), data)
    method = ph.FilterError("wg", initial={"wg": (0.0, GUST)})
    start = {**ordinary.as_start(), "q_wg": 1.0}
    return Pair(data, gust, ordinary, ph.estimate(model(gust=True), data, transcription=method, start=start))


def errors(fits: list[ph.Fit], truth: Mapping[str, float]) -> dict[str, np.ndarray]:
    """Errors of the estimates in units of the standard errors that the fits state."""
    return {
        n: np.array([(f.parameters[n].value - v) / f.parameters[n].std_error for f in fits]) for n, v in truth.items()
    }


def table(pairs: list[Pair]) -> str:
    """Mean and scatter of the estimates, and what the fits themselves say of it."""
    lines = [
        f"{len(pairs)} records. error: of the mean estimate; scatter: standard deviation of the estimates;",
        "stated: mean standard error that the fits state; ratio: root mean square of error / stated error (1 is right)",
        f"{'':6s}{'truth':>8s} {'output error':^38s} {'filter error':^38s}",
        f"{'':14s} " + " ".join(["   error  scatter   stated      ratio "] * 2),
    ]
    for name, value in {**TRUTH, "q_wg": INTENSITY}.items():
        cells = []
        for fits in ([p.ordinary for p in pairs], [p.filtered for p in pairs]):
            if name not in fits[0].parameters:
                cells.append(" " * 38)
                continue
            found = np.array([f.parameters[name].value for f in fits])
            stated = np.array([f.parameters[name].std_error for f in fits])
            ratio = np.sqrt(np.mean(((found - value) / stated) ** 2))
            cells.append(f"{found.mean() - value:8.3f} {found.std(ddof=1):8.3f} {stated.mean():8.3f} {ratio:10.2f}  ")
        lines.append(f"{name:6s}{value:8.3f} {' '.join(cells)}")
    return "\n".join(lines)


def draw(pairs: list[Pair]) -> Figure:
    """Errors in stated standard errors, the gust of the first record, and how white what is left is."""
    figure, (top, middle, bottom) = plt.subplots(3, 1, figsize=(8, 10), layout="constrained")
    for offset, colour, label, each in (
        (-0.15, "tab:red", "output error", errors([p.ordinary for p in pairs], TRUTH)),
        (0.15, "tab:blue", "filter error", errors([p.filtered for p in pairs], TRUTH)),
    ):
        for i, values in enumerate(each.values()):
            top.plot(
                np.full(values.size, i + offset),
                values,
                "o",
                ms=4,
                alpha=0.6,
                color=colour,
                label=label if i == 0 else None,
            )
    top.axhspan(-2, 2, color="0.9", zorder=0)
    top.set_xticks(range(len(TRUTH)), list(TRUTH))
    top.set_ylabel("error / stated standard error")
    top.legend()

    first = pairs[0]
    run = first.filtered.records[0]
    middle.plot(run.t, first.gust, "k", lw=1, label="gust, simulated")
    middle.plot(run.t, run.states["wg"], color="tab:blue", lw=1, label="estimated, ± 2 standard deviations")
    spread = 2 * run.state_std["wg"]
    middle.fill_between(run.t, run.states["wg"] - spread, run.states["wg"] + spread, color="tab:blue", alpha=0.25, lw=0)
    middle.set_xlabel("time, s")
    middle.set_ylabel("vertical gust, m/s")
    middle.legend()

    white = run.innovations["q"] / run.innovation_std["q"]
    for r, colour, label in (
        (first.ordinary.residuals["q"], "tab:red", "output error: residuals"),
        (white, "tab:blue", "filter error: innovations"),
    ):
        lags = range(31)
        bottom.plot(lags, [r[k:] @ r[: r.size - k] / (r @ r) for k in lags], "o-", ms=3, color=colour, label=label)
    bound = 2 / np.sqrt(run.t.size)
    bottom.axhspan(-bound, bound, color="0.9", zorder=0)
    bottom.set_xlabel("lag, samples")
    bottom.set_ylabel("autocorrelation, q")
    bottom.legend()
    return figure


def main() -> None:
    """Table on the screen, figure in out/."""
    pairs = [solve(seed) for seed in range(20)]
    print(pairs[0].filtered.summary(), end="\n\n")
    print(table(pairs))
    path = Path("out") / "turbulence.png"
    path.parent.mkdir(exist_ok=True)
    draw(pairs).savefig(path, dpi=150)
    print(f"\nWritten: {path}")


if __name__ == "__main__":
    main()
