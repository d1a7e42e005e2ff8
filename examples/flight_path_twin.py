"""A simulated flight whose sensors err in known ways, for `flight_path.py`.

The aircraft flies in body axes (u, v, w), not in the variables of `phugoid.models.flight_path`, with short period and
Dutch roll of about ATTAS's size. What its sensors read is made from that by numpy.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

import phugoid as ph
from phugoid import cos, design, sin, tan

G, V0 = 9.80665, 128.5  # m/s^2, m/s
DERIVATIVES = {"Za": -1.0, "Zde": -0.084, "Ma": -4.95, "Mq": -1.5, "Mde": -7.2}
ERRORS = {
    "b_ax": 0.03, "b_ay": 0.02, "b_az": 0.08, "b_p": 0.001, "b_q": 0.0032, "b_r": 0.0012,
    "K_alpha": 0.92, "K_beta": 0.96, "tau_V": 0.42, "tau_alpha": 0.105, "tau_beta": 0.115,
}  # fmt: skip
NOISE = {"V": 0.05, "alpha": 5e-4, "beta": 5e-4, "phi": 3e-4, "theta": 3e-4, "psi": 3e-4}
INERTIAL = {"ax": 0.01, "ay": 0.01, "az": 0.02, "p": 2e-4, "q": 2e-4, "r": 2e-4}  # noise, m/s^2 and rad/s
T = 0.04 * np.arange(626)


def aircraft() -> ph.Model:
    """Body axes, with aerodynamics that are linear about level flight."""
    m = ph.Model("twin")
    u, v, w = m.states(u="m/s", v="m/s", w="m/s")
    p, q, r = m.states(p="rad/s", q="rad/s", r="rad/s")
    phi, theta, _ = m.states(phi="rad", theta="rad", psi="rad")
    de, da, dr = m.inputs(de="rad", da="rad", dr="rad")
    Za, Zde, Ma, Mq, Mde = m.parameters(**DERIVATIVES)
    alpha, beta, faster = w / u, v / u, (u - V0) / V0
    ax, ay, az = m.quantities(
        ax=-0.5 * faster - 3.0 * alpha**2, ay=V0 * -0.12 * beta, az=-G * (1 + 2 * faster) + V0 * (Za * alpha + Zde * de)
    )
    m.dynamics(
        u=ax - G * sin(theta) + r * v - q * w,
        v=ay + G * cos(theta) * sin(phi) + p * w - r * u,
        w=az + G * cos(theta) * cos(phi) + q * u - p * v,
        p=-3.5 * beta - 1.6 * p + 0.6 * r + 5.5 * da + 0.8 * dr,
        q=Ma * alpha + Mq * q + Mde * de,
        r=1.8 * beta - 0.06 * p - 0.3 * r - 1.1 * dr,
        phi=p + tan(theta) * (q * sin(phi) + r * cos(phi)),
        theta=q * cos(phi) - r * sin(phi),
        psi=(q * sin(phi) + r * cos(phi)) / cos(theta),
    )
    m.outputs(ax=ax, ay=ay, az=az)
    return m


def flown() -> ph.results.Record:
    """An elevator 3-2-1-1, and some aileron and rudder."""
    controls = {
        "de": design.three_two_one_one(T, -0.044, width=0.7, start=3.0, rise=0.2),
        "da": design.doublet(T, 0.02, width=1.0, start=12.0, rise=0.2),
        "dr": design.doublet(T, 0.03, width=1.7, start=15.0, rise=0.2),
    }
    return ph.simulate(aircraft(), DERIVATIVES, ph.Experiment(T, controls), initial={"u": V0, "psi": 0.25})


def measured(
    truth: ph.results.Record,
    seed: int | None = 0,
    inertial_noise: bool = True,
    name: str = "twin",
    boom: Sequence[float] | None = None,
) -> ph.Experiment:
    """What the sensors read. Without a seed there is no noise. Vanes are late; or, with the place of a ``boom`` (m from
    the centre of gravity), there and in time."""
    s, rng = truth.states, np.random.default_rng(seed)
    V = np.sqrt(s["u"] ** 2 + s["v"] ** 2 + s["w"] ** 2)
    alpha, beta = np.arctan2(s["w"], s["u"]), np.arcsin(s["v"] / V)

    def late(name: str, values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.interp(truth.t - ERRORS[f"tau_{name}"], truth.t, values))

    if boom is None:
        alpha, beta = late("alpha", alpha), late("beta", beta)
    else:
        u, v, w = np.array([s[n] for n in "uvw"]) + np.cross([s[n] for n in "pqr"], boom, axisa=0).T
        alpha, beta = np.arctan2(w, u), np.arctan2(v, u)
    read = {
        **{n: truth.outputs[n] + ERRORS[f"b_{n}"] for n in ("ax", "ay", "az")},
        **{n: s[n] + ERRORS[f"b_{n}"] for n in ("p", "q", "r")},
        "V": late("V", V),
        "alpha": ERRORS["K_alpha"] * alpha,
        "beta": ERRORS["K_beta"] * beta,
        **{n: s[n] for n in ("phi", "theta", "psi")},
    }  # fmt: skip
    if seed is not None:
        noise = NOISE | (INERTIAL if inertial_noise else {})
        read |= {n: read[n] + size * rng.standard_normal(truth.t.size) for n, size in noise.items()}
    return ph.Experiment(truth.t, dict(truth.inputs), channels=read, name=name)
