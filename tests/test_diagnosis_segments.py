"""A diagnosis of records over which the simulation drifts away from what was measured: they are cut into segments."""

from __future__ import annotations

import numpy as np
import pytest

import phugoid as ph
from phugoid.discrepancy.search.refit import Refit
from phugoid.discrepancy.search.segments import segments_of
from phugoid.fit_result import mean_square

STEPS = 4


def servo(seed: int, forward: float, backward: float, rate: float = 100.0) -> ph.Experiment:
    """A positioning servo under PD control with dry friction, by an encoder; the torque is known."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 6.0, 1.0 / rate)
    levels = rng.uniform(-1.0, 1.0, 12)
    angle, speed, slope, last, reference = 0.0, 0.0, 0.0, 0.0, 0.0
    torque, seen = np.empty(t.size), np.empty(t.size)
    count, step = 2 * np.pi / 4096, 1.0 / rate / STEPS
    for k, now in enumerate(t):
        reference += (levels[int(now / 0.6)] - reference) * min(30.0 / rate, 1.0)
        seen[k] = np.round(angle / count) * count
        slope += 0.3 * ((seen[k] - last) * rate - slope)
        last = seen[k]
        torque[k] = np.clip(3.0 * (reference - seen[k]) - 0.25 * slope, -1.5, 1.5)
        for _ in range(STEPS):
            way = np.sign(speed) or np.sign(torque[k])
            friction = forward if way > 0 else backward
            if speed == 0.0 and abs(torque[k]) < friction:
                continue
            following = speed + step * (torque[k] - 0.05 * speed - way * friction) / 0.02
            following = 0.0 if speed * following < 0.0 else following  # it sticks before it turns
            angle, speed = angle + step * (speed + following) / 2, following
    return ph.Experiment(t, {"tau": torque}, {"theta": seen}, name=f"run {seed}", interpolation="hold")


def model() -> ph.Model:
    m = ph.Model("servo")
    theta, w = m.states(theta="rad", w="rad/s")
    (tau,) = m.inputs(tau="N*m")
    gain, c = m.parameters(gain=ph.Parameter(40.0, unit="1/(kg*m^2)"), c=ph.Parameter(1.0, unit="1/s"))
    m.dynamics(theta=w, w=gain * tau - c * w)
    m.outputs(theta=theta)
    return m


@pytest.mark.parametrize("seed", [5])
def test_dry_friction_of_a_servo_in_closed_loop_is_named(seed: int) -> None:
    """Simulated as a whole, a term in the torque that holds the motion near the record looked like the cause."""
    fit = ph.estimate(model(), servo(seed, 0.1, 0.1))
    d = ph.diagnose(fit, validation=servo(seed + 50, 0.1, 0.1))
    named = {f.cause for f in d.findings if f.status == "named"}
    assert named == {"w':sign(w)"}, d.summary()
    assert any("segments" in note for note in d.notes)
    (friction,) = (f for f in d.findings if f.cause == "w':sign(w)")
    assert friction.coefficient == pytest.approx(-0.1 / 0.02, rel=0.15)
    assert d.extend().gain.change("theta", held_out=True) < -0.8


def test_a_system_that_forgets_its_first_states_is_simulated_as_a_whole() -> None:
    m = ph.Model("lag")
    (x,) = m.states(x="1")
    (u,) = m.inputs(u="1")
    (a,) = m.parameters(a=1.0)
    m.dynamics(x=u - a * x)
    m.outputs(x=x)
    cubic = ph.candidates(m)["x':x^3"].extended(m)
    (hidden,) = {*cubic.parameter_names} - {*m.parameter_names}
    rng = np.random.default_rng(4)
    t = np.arange(0.0, 40.0, 0.1)

    def record(name: str) -> ph.Experiment:
        run = ph.Experiment(t, {"u": np.repeat(rng.uniform(-2.0, 2.0, 20), 20)}, name=name)
        y = ph.simulate(cubic, {"a": 1.0, hidden: -0.5}, run).outputs["x"]
        return run.with_outputs({"x": y + 0.01 * rng.standard_normal(t.size)})

    d = ph.diagnose(ph.estimate(m, record("a")), validation=record("b"))
    assert not any("segments" in note for note in d.notes)
    assert "x':x^3" in {f.cause for f in d.findings if f.status == "named"}, d.summary()


def hover(seed: int) -> ph.Experiment:
    """A rotor in height hold near the ground, which adds to its thrust; height and specific force are measured."""
    rng = np.random.default_rng(seed)
    step, n = 0.02, 700
    t = step * np.arange(n)
    reference = np.repeat(rng.uniform(0.3, 1.4, 7), 100)
    height, speed, sum_, target = reference[0], 0.0, 0.0, reference[0]
    throttle, seen, force = np.empty(n), np.empty(n), np.empty(n)
    for k in range(n):
        target += 0.04 * (reference[k] - target)
        error = target - height + 0.006 * rng.standard_normal()
        sum_ += error * step
        throttle[k] = np.sqrt(np.clip((9.81 + 6.0 * error + 2.0 * sum_ - 3.5 * speed) / 14.5, 0.05, 1.6))
        for j in range(STEPS):
            thrust = 14.5 * throttle[k] ** 2 / (1.0 - (0.16 / max(height, 0.18)) ** 2)
            if j == 0:
                seen[k], force[k] = height, thrust - 0.3 * speed
            speed += step / STEPS * (thrust - 9.81 - 0.3 * speed)
            height += step / STEPS * speed
    outputs = {"h": seen + 0.012 * rng.standard_normal(n), "az": force + 0.12 * rng.standard_normal(n)}
    return ph.Experiment(t, {"u": throttle}, outputs, name=f"hover {seed}", interpolation="hold")


def test_segments_show_a_force_though_its_misfit_does_not_become_less_there() -> None:
    """Over whole records a wrong damping holds the height near the record. Over segments the height is
    right, and so are the parameters, with which the specific force shows what is missing."""
    m = ph.Model("hover")
    h, w = m.states(h="m", w="m/s")
    (u,) = m.inputs(u="")
    gain, d = m.parameters(gain=14.0, d=0.2)
    m.dynamics(h=w, w=gain * u**2 - 9.81 - d * w)
    m.outputs(h=h, az=gain * u**2 - d * w)
    base = Refit((), ph.estimate(m, hover(1)))
    assert segments_of(base, []) is None
    pieces = segments_of(base, [hover(2)], farthest=True)
    assert pieces is not None and len(pieces.validation) == 10
    assert mean_square(pieces.base.fit, "h") < 0.05 * mean_square(base.fit, "h")
    assert mean_square(pieces.base.fit, "az") > 0.9 * mean_square(base.fit, "az")
    off = [abs(r.fit.parameters["d"].value - 0.3) for r in (pieces.base, base)]
    assert off[0] < 0.3 < off[1]
