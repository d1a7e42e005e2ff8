"""Unstable aircraft, short period: output error without any stabilisation.

The data are simulated and almost free of noise, so standard deviations end eight orders of magnitude below the
signals; single shooting diverges on such a system. Estimated from all derivatives 0.

    python examples/unstable_aircraft.py

Uses the record unStabAC_sim.asc where it finds it, else a simulated twin. Writes out/unstable_aircraft.png.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from records import find

import phugoid as ph

RECORD = "unStabAC_sim.asc"
COLUMNS = ["t", "pilot", "w", "q", "de", "az"]
PUBLISHED = {
    "Zw": -1.4266610873826133, "Zq": -1.5450850965346954, "Zde": -6.263202600623347,
    "Mw": 0.21660638419854875, "Mq": -3.7017914082981997, "Mde": -12.768768280554982,
}  # fmt: skip


def model() -> ph.Model:
    """The paper's model (section Simulated unstable aircraft short period)."""
    m = ph.Model("unstable aircraft, short period")
    w, q = m.states(w="m/s", q="rad/s")
    (de,) = m.inputs(de="rad")
    Zw, Zq, Zde, Mw, Mq, Mde = m.parameters("Zw Zq Zde Mw Mq Mde")
    (U0,) = m.constants(U0=ph.Constant(44.5695, "m/s", "airspeed of the trim"))
    m.dynamics(w=Zw * w + (U0 + Zq) * q + Zde * de, q=Mw * w + Mq * q + Mde * de)
    m.outputs(w=w, q=q, az=(Zw * w + Zq * q + Zde * de, "m/s²"))
    return m


def experiment(path: str | Path) -> ph.Experiment:
    """The simulated record of the book."""
    data = ph.read(path, time="t", columns=COLUMNS)
    c = data.channels
    return ph.Experiment(
        0.05 * np.arange(data.n),
        {"de": c["de"]},
        {n: c[n] for n in ("w", "q", "az")},
        name="unstable aircraft",
    )


def twin(seed: int = 0) -> ph.Experiment:
    """A record of the same kind: a pilot's oscillation with feedback that keeps the unstable aircraft in the air."""
    from scipy.integrate import solve_ivp

    t = 0.05 * np.arange(251)
    p, U0 = PUBLISHED, 44.5695

    def elevator(time: float, w: float, q: float) -> float:
        pilot = 0.05 * np.sin(1.3 * time) * np.sin(np.pi * time / t[-1]) ** 2
        return float(pilot + 0.04 * w + 0.3 * q)

    def rhs(time: float, x: np.ndarray) -> list[float]:
        w, q = x
        de = elevator(time, w, q)
        return [p["Zw"] * w + (U0 + p["Zq"]) * q + p["Zde"] * de, p["Mw"] * w + p["Mq"] * q + p["Mde"] * de]

    w, q = solve_ivp(rhs, (0, t[-1]), [0, 0], t_eval=t, rtol=1e-10, atol=1e-12, max_step=0.05).y
    de = np.array([elevator(*each) for each in zip(t, w, q, strict=True)])
    az = p["Zw"] * w + p["Zq"] * q + p["Zde"] * de
    noise = np.random.default_rng(seed).standard_normal((3, t.size)) * [[0.02], [0.0005], [0.01]]
    outputs = {"w": w + noise[0], "q": q + noise[1], "az": az + noise[2]}
    return ph.Experiment(t, {"de": de}, outputs, name="unstable aircraft, twin", interpolation="cubic")


def main() -> None:
    """Fits with the trapezoid, as the paper does, and writes the figure."""
    path = find(RECORD)
    data = experiment(path) if path else twin()
    # The book's data were made with the trapezoid at the sample times: order 2 repeats them to nine digits.
    fit = ph.estimate(model(), data, transcription=ph.Collocation(order=2 if path else 4))
    print(fit.summary())
    for name, value in PUBLISHED.items():
        print(f"{name:4s} {fit.parameters[name].value:12.6f}   published {value:12.6f}")
    out = Path("out")
    out.mkdir(exist_ok=True)
    figure, _ = fit.plot()
    figure.savefig(out / "unstable_aircraft.png", dpi=150)


if __name__ == "__main__":
    main()
