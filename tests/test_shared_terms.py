"""Terms that several equations share: a spring between two masses, the side force of a tyre."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import phugoid as ph
from phugoid.discrepancy.candidates.shared_terms import with_shared_terms


def _two_masses() -> ph.Model:
    m = ph.Model("two masses")
    a, v, b, w = m.states(a="m", v="m/s", b="m", w="m/s")
    (u,) = m.inputs("u")
    k, c, d = m.parameters(
        k=ph.Parameter(10.0, bounds=(0.1, 500.0)), c=ph.Parameter(0.2, bounds=(0.0, 5.0)), d=ph.Parameter(0.3)
    )
    force = k * (a - b) + c * (v - w)
    m.dynamics(a=v, v=u - force - d * v, b=w, w=force / 1.5)
    m.outputs(a=a, b=b)
    return m


def _car() -> ph.Model:
    m = ph.Model("car")
    v, r = m.states("v r")
    (delta,) = m.inputs("delta")
    front, rear, mass = m.parameters(front=60e3, rear=60e3, mass=1500.0)
    force = front * (delta - (v + 1.2 * r) / 22.0), rear * (-(v - 1.5 * r) / 22.0)
    m.dynamics(v=(force[0] + force[1]) / mass - 22.0 * r, r=(1.2 * force[0] - 1.5 * force[1]) / 2500.0)
    m.outputs(r=r, ay=(force[0] + force[1]) / mass)
    return m


def _values(model: ph.Model, at: dict[str, float]) -> list[float]:
    equations = {**model.state_expressions(), **model.output_expressions()}
    return [e.evaluate(at) for e in equations.values()]


@pytest.mark.parametrize(
    ("model", "declared"),
    [
        (_two_masses(), ["a_minus_b", "k_term", "v_minus_w", "c_term"]),
        (_car(), ["front_argument", "front_term", "rear_argument", "rear_term"]),
    ],
    ids=["two masses", "car"],
)
def test_the_equations_stay_what_they_are(model: ph.Model, declared: list[str]) -> None:
    changed = with_shared_terms(model)
    assert changed.quantity_names == tuple(declared)
    rng = np.random.default_rng(0)
    names = (*model.state_names, *model.input_names, *model.parameter_names)
    for _ in range(20):
        at = dict(zip(names, rng.uniform(-2.0, 2.0, len(names)).tolist(), strict=True))
        assert _values(changed, at) == pytest.approx(_values(model, at), rel=1e-9, abs=1e-9)


def test_a_model_whose_equations_share_nothing_is_the_same() -> None:
    m = ph.Model("aircraft")
    w, q = m.states("w q")
    (de,) = m.inputs("de")
    zw, mw, mq, md = m.parameters("zw mw mq md")
    m.dynamics(w=zw * w + 60.0 * q, q=mw * w + mq * q + md * de)
    m.outputs(w=w, q=q)
    assert with_shared_terms(m) is m


def _record(seed: int, amplitude: float) -> ph.Experiment:
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 20.0, 0.04)
    u = amplitude * np.repeat(rng.choice([-1.0, -0.5, 0.5, 1.0], t.size // 25 + 1), 25)[: t.size]

    def rates(now: float, x: np.ndarray) -> list[float]:
        a, v, b, w = x
        force = 20.0 * (a - b) + 900.0 * (a - b) ** 3 + 0.3 * (v - w)
        held = u[min(int(now / 0.04 + 1e-9), t.size - 1)]
        return [v, held - force - 0.3 * v, w, force / 1.5]

    x = solve_ivp(rates, (0.0, t[-1]), [0.0] * 4, t_eval=t, max_step=0.02, rtol=1e-8).y
    y = {n: x[i] + 5e-4 * rng.standard_normal(t.size) for n, i in (("a", 0), ("b", 2))}
    return ph.Experiment(t, {"u": u}, y, interpolation="hold")


def test_a_spring_that_hardens_is_named_though_no_quantity_is_declared() -> None:
    fit = ph.estimate(_two_masses(), _record(1, 2.0))
    diagnosis = ph.diagnose(fit, validation=_record(2, 1.6))
    assert [f.cause for f in diagnosis.findings if f.status == "named"] == ["k_term:a_minus_b^3"]
    (named,) = (f for f in diagnosis.findings if f.status == "named")
    assert abs(named.coefficient - 900.0) < 0.1 * 900.0
    assert any("a_minus_b = a - b" in note for note in diagnosis.notes)
