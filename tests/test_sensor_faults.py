"""A sensor that stays at its last value is told by samples that its noise would not leave the same."""

from __future__ import annotations

import numpy as np
import pytest

import phugoid as ph
from phugoid.discrepancy.search.sensor_fault import SensorFault

STEP = 0.02


def short_period() -> ph.Model:
    m = ph.Model("short period")
    (de,) = m.inputs(de="rad")
    alpha, q = m.states(alpha="rad", q="rad/s")
    za, ma, mq, md = m.parameters(Za=-1.0, Ma=-5.0, Mq=-2.0, Md=-8.0)
    m.dynamics(alpha=za * alpha + q, q=ma * alpha + mq * q + md * de)
    m.outputs(alpha=alpha, q=q)
    return m


def record(seed: int, stuck: tuple[tuple[float, float], ...] = (), rounded: float = 0.0) -> ph.Experiment:
    """Return steps of the elevator, a vane that is stuck at times, or rounded and without noise."""
    rng = np.random.default_rng(seed)
    t = STEP * np.arange(700)
    de = 0.05 * np.repeat(rng.choice([-1.0, 0.0, 1.0], 20), 35)
    de[:100] = 0.0
    truth = {"Za": -1.3, "Ma": -8.0, "Mq": -2.4, "Md": -13.0}
    y = ph.simulate(short_period(), truth, ph.Experiment(t, {"de": de})).outputs
    alpha = y["alpha"] + (0.0 if rounded else 0.002) * rng.normal(size=t.size)
    alpha = np.round(alpha / rounded) * rounded if rounded else alpha
    for begin, end in stuck:
        inside = (t >= begin) & (t <= end)
        alpha[inside] = alpha[inside][0]
    return ph.Experiment(t, {"de": de}, {"alpha": alpha, "q": y["q"] + 0.003 * rng.normal(size=t.size)}, name="flight")


def test_a_vane_that_freezes_is_named_with_its_spans_and_left_out() -> None:
    model = short_period()
    spans = ((5.7, 7.0), (9.0, 10.2))
    fit = ph.estimate(model, record(1, spans))
    d = ph.diagnose(fit, validation=record(2, ((4.0, 5.0),)))
    assert d.verdict == "named"
    (found,) = d.findings
    assert found.cause == "alpha:stuck"
    assert "5.7 to 7 s" in found.explanation and "9 to 10.18 s" in found.explanation, found.explanation
    assert "NaN" in found.advice
    rms = float(np.sqrt(np.nanmean(d.fit.records[0].residuals["alpha"] ** 2)))
    assert 0.0018 < rms < 0.0022
    assert int(np.isnan(d.fit.records[0].measured["alpha"]).sum()) == 124


def test_a_rounded_vane_at_rest_is_not_stuck() -> None:
    fit = ph.estimate(short_period(), record(3, rounded=0.005))
    d = ph.diagnose(fit, validation=record(4, rounded=0.005))
    assert not any(f.cause.endswith(":stuck") for f in d.findings), d.summary()


def test_a_vane_with_noise_is_not_stuck() -> None:
    d = ph.diagnose(ph.estimate(short_period(), record(5)), validation=record(6))
    assert d.verdict == "nothing", d.summary()


def test_samples_that_a_link_repeats_are_left_out() -> None:
    lost = record(7)
    alpha, rng = lost.output("alpha").copy(), np.random.default_rng(8)
    for k in np.sort(rng.choice(np.arange(5, 690), 40, replace=False)):
        alpha[k : k + 3] = alpha[k - 1]
    d = ph.diagnose(ph.estimate(short_period(), lost.with_channels({"alpha": alpha})), validation=record(6))
    (found,) = d.findings
    assert found.cause == "alpha:stuck" and "more spans" in found.explanation
    assert float(np.nanstd(d.fit.records[0].residuals["alpha"])) < 0.0022


def test_the_interval_of_a_slow_sensor_need_be_no_multiple() -> None:
    y = np.random.default_rng(4).standard_normal(400)
    begins = np.ceil(np.arange(0.0, 400.0, 6.25)).astype(int)
    held = y[begins[np.searchsorted(begins, np.arange(400), side="right") - 1]]
    own = np.flatnonzero(np.isfinite(SensorFault("h", "held").mended(held)))
    assert own.tolist() == begins.tolist()


def test_a_slow_sensor_that_is_repeated_keeps_only_its_own_samples() -> None:
    fast = record(9)
    held = fast.output("alpha")[np.arange(700) // 10 * 10]
    d = ph.diagnose(ph.estimate(short_period(), fast.with_channels({"alpha": held})), validation=record(6))
    (found,) = d.findings
    assert found.cause == "alpha:held" and "every 0.2 s" in found.explanation
    assert int(np.isfinite(d.fit.records[0].measured["alpha"]).sum()) == 70


def test_an_encoder_that_turns_evenly_is_not_held() -> None:
    fault = SensorFault("th", "held")
    even = np.floor(np.arange(300) / 5.0) * 0.001
    assert np.isfinite(fault.mended(even)).all()


@pytest.mark.parametrize("turn", [2.0 * np.pi, 360.0])
def test_an_angle_that_wraps_is_unwrapped(turn: float) -> None:
    m = ph.Model("heading")
    (delta,) = m.inputs(delta="")
    psi, r = m.states(psi="", r="")
    k, a = m.parameters(K=1.0, a=0.3)
    m.dynamics(psi=r, r=k * delta - a * r)
    m.outputs(psi=psi)

    def sailed(seed: int) -> ph.Experiment:
        rng, t = np.random.default_rng(seed), 0.2 * np.arange(600)
        u = turn / 6.0 * np.repeat(rng.uniform(-0.05, 0.12, 20), 30)
        y = ph.simulate(m, {"K": 1.2, "a": 0.4}, ph.Experiment(t, {"delta": u})).outputs["psi"]
        y = y + 0.001 * turn * rng.normal(size=t.size)
        return ph.Experiment(t, {"delta": u}, {"psi": (y + turn / 2.0) % turn - turn / 2.0}, name="turn")

    d = ph.diagnose(ph.estimate(m, sailed(1)), validation=sailed(2))
    assert [f.cause for f in d.findings] == ["psi:wrapped"], d.summary()
    assert float(np.std(d.fit.records[0].residuals["psi"])) < 0.0012 * turn


def test_a_record_without_noise_that_begins_at_rest_is_not_stuck() -> None:
    t = STEP * np.arange(700)
    de = np.where(t > 1.0, 0.05 * np.sin(2.0 * t), 0.0)
    y = ph.simulate(
        short_period(), {"Za": -1.3, "Ma": -8.0, "Mq": -2.4, "Md": -13.0}, ph.Experiment(t, {"de": de})
    ).outputs
    assert np.isfinite(SensorFault("alpha", "stuck").mended(y["alpha"])).all()


def test_a_sensor_at_the_lower_end_of_its_range_is_clipped_and_not_stuck() -> None:
    speed = 25.0 + 10.0 * np.sin(0.05 * np.arange(600)) + 0.1 * np.random.default_rng(1).normal(size=600)
    read = np.maximum(speed, 20.0)
    assert np.isfinite(SensorFault("V", "stuck").mended(read)).all()
