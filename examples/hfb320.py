"""HFB-320 Hansa Jet: longitudinal motion from an elevator 3-2-1-1 and pulse (28 unknowns).

The example of the paper: 4 states, 2 inputs, 7 measurements; 11 derivatives, 4 biases, 7 standard deviations and 4
initial states are estimated, from all derivatives and biases 0.

    python examples/hfb320.py [--order 2] [--progress]

Uses the real record hfb320_1_10.asc where it finds it, else a simulated twin of it. Writes out/hfb320.json and
out/hfb320.png.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from records import find

import phugoid as ph
from phugoid import cos, sin

RECORD = "hfb320_1_10.asc"
COLUMNS = [
    "t",
    "de",
    "pdyn",
    "T",
    "V",
    "alpha",
    "theta",
    "q",
    "aq",
    "ax",
    "az",
    "ay",
    "p",
    "r",
    "pdot",
    "rdot",
    "beta",
    "phi",
    "da",
    "dr",
]

# The optimum published with the paper (trapezoid): what the simulated twin is made from.
PUBLISHED = {
    "CD0": 0.05802198227121576, "CDV": -0.031609345096558036, "CDa": 0.2453480135927723,
    "CL0": 0.18081496655016374, "CLV": 0.20117806265996505, "CLa": 3.090429255239013,
    "Cm0": 0.11836017813192333, "CmV": 0.013661249826858497, "Cma": -0.9940542701262957,
    "Cmq": -28.651655181649204, "Cmde": -1.471386926974763,
    "b_q": -0.00010091594526686652, "b_aq": -4.9217064663231145e-06,
    "b_ax": -0.12084522355941345, "b_az": -0.010969637096449545,
}  # fmt: skip
SIGMA = {
    "V": 0.8685280159552249, "alpha": 0.0022700468575119655, "theta": 0.002042851155865991,
    "q": 0.002463907639197214, "aq": 0.007884887575017764, "ax": 0.024723104791353933, "az": 0.20590254560216117,
}  # fmt: skip


def model() -> ph.Model:
    """The paper's model (section HFB-320 Hansa Jet longitudinal motion)."""
    m = ph.Model("HFB-320 longitudinal")
    V, alpha, theta, q = m.states(V="m/s", alpha="rad", theta="rad", q="rad/s")
    de, T = m.inputs(de="rad", T="N")
    g, rho, mass, V_ref, c = m.constants(
        g=ph.Constant(9.80665, "m/s²", "acceleration of gravity"),
        rho=ph.Constant(0.792, "kg/m³", "density of the air"),
        mass=ph.Constant(7472.0, "kg", "of the aircraft"),
        V_ref=ph.Constant(104.67, "m/s", "reference airspeed"),
        c=ph.Constant(2.43, "m", "mean aerodynamic chord"),
    )
    S_m, Sc_Iy, lt_Iy, epsilon_T = m.constants(
        S_m=ph.Constant(4.028e-3, "m²/kg", "wing area over mass"),
        Sc_Iy=ph.Constant(8.0027e-4, "m/kg", "wing area times chord over moment of inertia"),
        lt_Iy=ph.Constant(-7.0153e-6, "1/(kg m)", "arm of the thrust over moment of inertia"),
        epsilon_T=ph.Constant(0.0524, "rad", "inclination of the thrust"),
    )
    CD0, CDV, CDa, CL0, CLV, CLa = m.parameters("CD0 CDV CDa CL0 CLV CLa")
    Cm0, CmV, Cma, Cmq, Cmde = m.parameters("Cm0 CmV Cma Cmq Cmde")
    b_q, b_aq, b_ax, b_az = m.parameters("b_q b_aq b_ax b_az")

    dV = V / V_ref - 1
    # The paper prints the pitch rate as q c/(2 V); its published optimum was found with q c/(2 Vref).
    CD, CL, Cm = m.quantities(
        CD=CD0 + CDV * dV + CDa * alpha,
        CL=CL0 + CLV * dV + CLa * alpha,
        Cm=Cm0 + CmV * dV + Cma * alpha + Cmq * (c / (2 * V_ref)) * q + Cmde * de,
    )
    pressure = 0.5 * rho * V**2
    q_dot = pressure * Sc_Iy * Cm + lt_Iy * T
    m.dynamics(
        V=-pressure * S_m * CD + T / mass * cos(alpha + epsilon_T) - g * sin(theta - alpha),
        alpha=-pressure * S_m / V * CL + (g * cos(theta - alpha) - T / mass * sin(alpha + epsilon_T)) / V + q,
        theta=q,
        q=q_dot,
    )
    m.outputs(
        V=V,
        alpha=alpha,
        theta=theta,
        q=(q + b_q, "rad/s"),
        aq=(q_dot + b_aq, "rad/s²"),
        ax=(pressure * S_m * (CL * sin(alpha) - CD * cos(alpha)) + T / mass * cos(epsilon_T) + b_ax, "m/s²"),
        az=(-pressure * S_m * (CL * cos(alpha) + CD * sin(alpha)) - T / mass * sin(epsilon_T) + b_az, "m/s²"),
    )
    return m


def experiment(path: str | Path) -> ph.Experiment:
    """The flight record."""
    data = ph.read(path, time="t", columns=COLUMNS)
    # The file rounds its last stamp to 60.00002 s; the sampling is 10 Hz throughout.
    channels = {name: data.channels[name] for name in ("de", "T", *SIGMA)}
    t = 0.1 * np.arange(data.n)
    return ph.Experiment(
        t, {n: channels[n] for n in ("de", "T")}, {n: channels[n] for n in SIGMA}, name="HFB-320 flight"
    )


def twin(seed: int = 0) -> ph.Experiment:
    """A simulated record of the same shape: elevator 3-2-1-1 and pulse, constant thrust, the published noise."""
    t = 0.1 * np.arange(601)
    de = np.full(t.size, -0.008)
    for begin, end, sign in ((2, 5, 1), (5, 7, -1), (7, 8, 1), (8, 9, -1), (25, 27, 1)):
        de[(t >= begin) & (t < end)] += 0.012 * sign
    inputs = {"de": de, "T": np.full(t.size, 11500.0)}
    initial = {"V": 106.0, "alpha": 0.112, "theta": 0.104, "q": -0.003}
    truth = ph.simulate(model(), PUBLISHED, ph.Experiment(t, inputs, name="twin"), initial=initial)
    rng = np.random.default_rng(seed)
    outputs = {n: truth.outputs[n] + SIGMA[n] * rng.standard_normal(t.size) for n in SIGMA}
    return ph.Experiment(t, inputs, outputs, name="HFB-320 simulated twin")


def main() -> None:
    """Fits, prints the summary, and writes the figure and the saved fit."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--order", type=int, default=4, help="points of a segment; 2 is the paper's trapezoid")
    parser.add_argument("--progress", action="store_true", help="show the iterations")
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder for results")
    args = parser.parse_args()

    path = find(RECORD)
    data = experiment(path) if path else twin()
    print(f"Record: {data.name} ({path or f'{RECORD} not found, see README'})\n")
    fit = ph.estimate(model(), data, transcription=ph.Collocation(order=args.order), progress=args.progress)
    print(fit.summary())

    args.out.mkdir(exist_ok=True)
    fit.save(args.out / "hfb320.json")
    figure, _ = fit.plot()
    figure.savefig(args.out / "hfb320.png", dpi=150)
    print(f"\nWritten: {args.out / 'hfb320.json'}, {args.out / 'hfb320.png'}")


if __name__ == "__main__":
    main()
