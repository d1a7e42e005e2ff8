"""Causes that say the same: which one is named does not depend on rounding, and the others are told beside it."""

from __future__ import annotations

import numpy as np

import phugoid as ph

T = np.arange(0.0, 12.0, 0.02)


def cart(gain: float, friction: float = 0.8) -> ph.Model:
    m = ph.Model("cart")
    (i,), (x, v) = m.inputs(i="A"), m.states(x="m", v="m/s")
    (c,) = m.parameters(c=ph.Parameter(friction, unit="1/s"))
    m.dynamics(x=v, v=gain * i - c * v)
    m.outputs(x=x)
    return m


def test_the_size_of_an_input_comes_before_that_of_a_calibrated_sensor() -> None:
    """In a linear model the two are the same, and the encoder was blamed for the constant of a motor."""

    def record(seed: int) -> ph.Experiment:
        rng = np.random.default_rng(seed)
        i = 2.0 * np.sin(2.0 * np.pi * (0.7 * T + rng.uniform())) + rng.uniform(-1.0, 1.0, 25)[(T / 0.5).astype(int)]
        e = ph.Experiment(T, {"i": i}, interpolation="hold", name=f"record {seed}")
        r = ph.simulate(cart(0.5 * 1.06), {"c": 0.9}, e, initial={"x": 0.0, "v": 0.0})
        noisy = r.outputs["x"] + 5e-4 * rng.standard_normal(T.size)
        return ph.Experiment(T, {"i": i}, {"x": noisy}, interpolation="hold", name=f"record {seed}")

    d = ph.diagnose(ph.estimate(cart(0.5), record(1)), validation=record(2))
    (f,) = [f for f in d.findings if f.status == "named"]
    assert f.cause == "i:scale" and "x:scale" in f.aliases, d.summary()
    assert abs(f.coefficient - 0.06) < 0.01
    assert "i:scale" in d.extend().added  # what is told is what is fitted


def tyres(sliding: float) -> ph.Model:
    """A single-track car at 25 m/s; ``sliding`` is the part of the force that a slip of 0.1 rad loses."""
    m = ph.Model("car")
    (delta,), (vy, r) = m.inputs(delta="rad"), m.states(vy="m/s", r="rad/s")
    cf, cr = m.parameters(cf=50.0, cr=55.0)
    af, ar = m.quantities(af=delta - (vy + 1.2 * r) / 25.0, ar=(1.5 * r - vy) / 25.0)
    lost = 100.0 * sliding
    yf, yr = m.quantities(Yf=cf * (af - lost * af**3 if lost else af), Yr=cr * ar)
    m.dynamics(vy=yf + yr - 25.0 * r, r=0.6 * (1.2 * yf - 1.5 * yr))
    m.outputs(r=r, ay=yf + yr)
    return m


def test_a_term_in_a_declared_quantity_is_offered_and_found() -> None:
    """A tyre's force bends with its slip, which the model has as a quantity of its own."""

    def record(seed: int) -> ph.Experiment:
        rng = np.random.default_rng(seed)
        delta = 0.07 * np.repeat(rng.uniform(-1.0, 1.0, 20), 30)[: T.size]
        e = ph.Experiment(T, {"delta": delta}, name=f"record {seed}")
        run = ph.simulate(tyres(0.5), {"cf": 53.0, "cr": 60.0}, e, initial={"vy": 0.0, "r": 0.0})
        sizes = {"r": 0.002, "ay": 0.05}
        noisy = {n: y + sizes[n] * rng.standard_normal(T.size) for n, y in run.outputs.items()}
        return ph.Experiment(T, {"delta": delta}, noisy, name=f"record {seed}")

    offered = ph.candidates(tyres(0.0)).names
    assert {"Yf:af^3", "Yf:af|af|", "Yr:ar^3"} <= {*offered}
    assert "Yf:af" not in offered  # the model has that
    d = ph.diagnose(ph.estimate(tyres(0.0), record(1)), validation=record(2))
    (f,) = [f for f in d.findings if f.status == "named"]
    assert f.cause == "Yf:af^3", d.summary()
    assert abs(f.coefficient + 53.0 * 50.0) < 5.0 * f.std_error + 100.0
