"""A diagnosis names what explains the error of a free simulation of data held out; what explains little of it is minor.

The situations are those of laboratory records: little noise beside the error of the model, relays, clipped sensors.
"""

from __future__ import annotations

import numpy as np
import pytest

import phugoid as ph
from phugoid.discrepancy.search.free_run import Misfitting, Simulated


def pendulum(complete: bool = False) -> ph.Model:
    m = ph.Model("pendulum")
    phi, w = m.states(phi="rad", w="rad/s")
    w2, c = m.parameters(w2=30.0, c=0.03)
    missing = 0.0
    if complete:
        f, d = m.parameters(f=0.2, d=0.0005)
        missing = f * ph.smooth_sign(w, 0.01) + d * w * abs(w)
    m.dynamics(phi=w, w=-w2 * ph.sin(phi) - c * w - missing)
    m.outputs(phi=phi)
    return m


def swinging(first: float, seed: int, name: str) -> ph.Experiment:
    """A pendulum with dry friction and little air drag, by an encoder of 2,000 counts."""
    t = np.arange(0.0, 14.0, 0.02)
    run = ph.Experiment(t, {}, name=name)
    values = {"w2": 30.8, "c": 0.01, "f": 0.2, "d": 0.0005}
    r = ph.simulate(pendulum(complete=True), values, run, initial={"phi": first, "w": 0.0})
    count = 2.0 * np.pi / 2000.0
    noise = 0.2 * count * np.random.default_rng(seed).standard_normal(t.size)
    return run.with_outputs({"phi": count * np.round((r.outputs["phi"] + noise) / count)})


@pytest.fixture(scope="module")
def friction() -> ph.Diagnosis:
    fit = ph.estimate(pendulum(), swinging(2.2, 0, "large"))
    return ph.diagnose(fit, validation=swinging(1.2, 1, "small"))


def test_dry_friction_is_named_and_what_is_left_is_minor(friction: ph.Diagnosis) -> None:
    first, *others = friction.findings
    assert friction.verdict == "named" and friction.found
    assert first.cause == "w':sign(w)" and first.status == "named"
    assert first.coefficient == pytest.approx(-0.2, abs=0.04)
    assert first.explained > 0.8 and first.explained_interval[0] > 0.7
    assert all(f.status != "named" for f in others)


def test_only_what_is_named_extends_the_model(friction: ph.Diagnosis) -> None:
    named = tuple(f.cause for f in friction.findings if f.status == "named")
    listed = tuple(f.cause for f in friction.findings if f.cause)
    extension = friction.extend()
    assert extension.added == named
    assert set(friction.extend(minor=True).added) == {*listed}
    # What is told of a cause is what is fitted.
    (name,) = friction.findings[0].parameters
    assert extension.fit.parameters[name].value == pytest.approx(friction.findings[0].coefficient, rel=1e-2)


def test_what_a_finding_explains_is_what_the_extension_gains(friction: ph.Diagnosis) -> None:
    gain = friction.extend().gain
    part = 1.0 - (gain.held_out_rms_after["phi"] / gain.held_out_rms_before["phi"]) ** 2
    (found,) = (f for f in friction.findings if f.status == "named")
    assert found.explained_outputs["phi"] == pytest.approx(part, abs=0.01)
    # Of the misfit alone, without the noise, it is more.
    assert part < found.explained <= 1.0


def cart(seed: int, start: float, name: str, push: float = 0.13) -> tuple[ph.Model, ph.Experiment]:
    """A cart on a rail that slopes, whose motor is switched by a relay; the rail is uneven, which the model is not."""
    m = ph.Model("cart")
    (i,) = m.inputs(i="A")
    x, v = m.states(x="m", v="m/s")
    (c,) = m.parameters(c=1.0)
    m.dynamics(x=v, v=0.53 * i - c * v)
    m.outputs(x=x)
    t = np.arange(0.0, 8.0, 0.01)
    current, position, velocity, xs = 4.0, start, 0.0, np.empty(t.size)
    inputs = np.empty(t.size)
    for k in range(t.size):
        if k % 3 == 0:  # the relay is read at a lower rate
            current = -4.0 if position > 0.0 else 4.0
        inputs[k], xs[k] = current, position
        for _ in range(10):
            uneven = 0.02 * np.sin(400.0 * position)
            velocity += 1e-3 * (0.53 * current - 8.0 * velocity + push + uneven)
            position += 1e-3 * velocity
    noise = 2e-5 * np.random.default_rng(seed).standard_normal(t.size)
    return m, ph.Experiment(t, {"i": inputs}, {"x": xs + noise}, name=name, interpolation="hold")


def test_a_constant_force_on_a_relay_s_limit_cycle() -> None:
    """Any function of an input with two levels is a constant and a linear part: none other is offered; of terms that
    explain the same, the simplest is named."""
    model, data = cart(0, 0.002, "one")
    d = ph.diagnose(ph.estimate(model, data), validation=cart(1, -0.004, "other")[1])
    assert d.findings[0].cause == "v':bias" and d.findings[0].status == "named"
    assert d.findings[0].coefficient == pytest.approx(0.13, abs=0.02)
    tried = {s.name for s in d.ranking}
    assert not tried & {"i:saturation", "i:deadband", "v':i^2", "v':i^3", "v':i|i|", "v':|i|", "v':sign(i)"}
    assert [f.cause for f in d.findings if f.status == "named"] == ["v':bias"]


def tank(seed: int, name: str, limit: float) -> tuple[ph.Model, ph.Experiment]:
    m = ph.Model("tanks")
    h1, h2 = m.states("h1 h2")
    (u,) = m.inputs("u")
    a, b, c = m.parameters(a=0.5, b=0.3, c=0.2)
    m.dynamics(h1=a * u - b * h1, h2=b * h1 - c * h2)
    m.outputs(h2=h2)
    random = np.random.default_rng(seed)
    t = np.arange(0.0, 150.0, 0.25)
    run = ph.Experiment(t, {"u": np.repeat(random.uniform(0.5, 5.0, 30), 20)}, name=name)
    r = ph.simulate(m, {"a": 0.6, "b": 0.25, "c": 0.15}, run, initial={"h1": 2.0, "h2": 5.0})
    return m, run.with_outputs({"h2": np.minimum(r.outputs["h2"] + 0.02 * random.standard_normal(t.size), limit)})


def test_a_clipped_sensor_is_named() -> None:
    model, data = tank(1, "one", 10.0)
    d = ph.diagnose(ph.estimate(model, data), validation=tank(2, "other", 10.0)[1])
    assert [f.cause for f in d.findings] == ["h2:clipped"]
    assert d.findings[0].coefficient == pytest.approx(10.0, abs=0.02)
    assert d.findings[0].explained > 0.98


def test_a_sensor_that_is_not_clipped_is_not_blamed() -> None:
    model, data = tank(1, "one", np.inf)
    d = ph.diagnose(ph.estimate(model, data), validation=tank(2, "other", np.inf)[1])
    assert d.verdict == "nothing" and not d.findings


def test_structure_without_a_cause_is_unexplained() -> None:
    """A motion that no candidate makes: the verdict is not that nothing is missing."""
    model, data = tank(1, "one", np.inf)
    wander = np.cumsum(np.random.default_rng(5).standard_normal(data.n))
    data = data.with_outputs({"h2": data.outputs["h2"] + 0.05 * wander / wander.std()})
    d = ph.diagnose(ph.estimate(model, data))
    if not d.found:
        assert d.verdict == "unexplained" and "No effect that these data" not in d.summary()
    assert d.structured_outputs == ("h2",)


def test_the_part_explained_of_known_errors() -> None:
    """Half of an error's amplitude less is three quarters of its power, whatever the scale of the outputs."""
    random = np.random.default_rng(0)
    n = 4000
    output = np.repeat([0, 1], n // 2)
    block = np.tile(np.arange(n // 2) * 20 // (n // 2), 2)
    wrong = np.sin(np.arange(n) / 9.0) * np.where(output == 0, 1.0, 100.0)
    noise = 0.1 * random.standard_normal(n) * np.where(output == 0, 1.0, 100.0)

    def simulated(errors: np.ndarray) -> Simulated:
        return Simulated(("a", "b"), errors, output, block)

    before = simulated(wrong + noise)
    powers = np.array([np.mean(before.errors[output == i] ** 2) for i in (0, 1)])
    misfit = Misfitting(before.errors, powers, 1.0 - np.array([0.01, 100.0]) / powers)
    half = simulated(0.5 * wrong + noise).explained(before, misfit)
    assert half.part == pytest.approx(0.75, abs=0.02) and half.significant and not half.worse
    assert half.interval[0] < 0.75 < half.interval[1]
    nothing = simulated(wrong + noise + 1e-3 * noise[::-1]).explained(before, misfit)
    assert abs(nothing.part) < 0.01 and not nothing.significant
    worse = simulated(1.1 * wrong + noise).explained(before, misfit)
    assert worse.worse and worse.part == pytest.approx(-0.21, abs=0.02)
