"""Estimation while the data arrive."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import phugoid as ph

sys.path.insert(0, str(Path(__file__).parents[1] / "examples"))
import hfb320
import unstable_aircraft

SIGMA = {"w": 0.02, "q": 0.0005, "az": 0.01}


def lag() -> ph.Model:
    m = ph.Model("lag")
    (x,) = m.states(x="")
    (u,) = m.inputs(u="")
    (a,) = m.parameters(a=1.0)
    m.dynamics(x=a * (u - x))
    m.outputs(y=x)
    return m


def distances(fit: ph.Fit, history: ph.results.OnlineHistory) -> dict[str, float]:
    """Return the differences to a fit at the end of the record, in its standard errors."""
    return {
        name: (history.parameters[name][-1] - e.value) / e.std_error
        for name, e in fit.parameters.items()
        if name in history.parameters
    }


def test_hfb320_streamed_is_the_batch_fit() -> None:
    data, model = hfb320.twin(), hfb320.model()
    fit = ph.estimate(model, data, noise=ph.Gaussian(sigma=hfb320.SIGMA))
    spread = {name: 3 * max(abs(value), 0.01) for name, value in hfb320.PUBLISHED.items()}
    online = ph.Online(model, window=100, iterations=2, sigma=hfb320.SIGMA, parameter_errors=spread)
    off = distances(fit, online.run(data))
    assert max(abs(v) for v in off.values()) < 0.1, off


def test_the_unstable_aircraft_streamed_is_the_batch_fit() -> None:
    data, model = unstable_aircraft.twin().with_interpolation("linear"), unstable_aircraft.model()
    fit = ph.estimate(model, data, noise=ph.Gaussian(sigma=SIGMA))
    spread = {name: 3 * abs(value) for name, value in unstable_aircraft.PUBLISHED.items()}
    off = distances(fit, ph.Online(model, window=60, sigma=SIGMA, parameter_errors=spread).run(data))
    assert max(abs(v) for v in off.values()) < 0.1, off


def test_a_push_by_name_is_a_push_of_arrays() -> None:
    one, two = (ph.Online(lag(), sigma={"y": 0.1}) for _ in range(2))
    for k in range(20):
        one.push(0.1 * k, {"u": 1.0}, {"y": 1 - np.exp(-0.1 * k)} if k % 2 else {})
        two.push(0.1 * k, [1.0], [1 - np.exp(-0.1 * k) if k % 2 else np.nan])
    assert str(one.estimate) == str(two.estimate)
    assert one.estimate.covariance.shape == (2, 2)
    assert one.work > 100


def test_run_returns_what_pushes_leave() -> None:
    t = 0.1 * np.arange(50)
    data = ph.Experiment(t, {"u": np.sin(t)}, {"y": np.cos(t)}, name="run")
    one, two = (ph.Online(lag(), window=4, sigma={"y": 0.1}) for _ in range(2))
    history = one.run(data)
    for k in range(50):
        two.push(t[k], [np.sin(t[k])], [np.cos(t[k])])
    assert history.parameters["a"][-1] == two.estimate.parameters["a"]
    assert history.states["x"].shape == (50,)
    figure, axes = history.plot(reference={"a": 1.0})
    assert list(axes) == ["a"]
    with pytest.raises(ph.OptionError, match="'b' is not a parameter"):
        history.plot(["b"])


def test_a_lost_effectiveness_is_named() -> None:
    m = ph.Model("roll")
    (p,) = m.states(p="rad/s")
    (da,) = m.inputs(da="rad")
    Lp, Lda = m.parameters(Lp=-2.0, Lda=10.0)
    m.dynamics(p=Lp * p + Lda * da)
    m.outputs(p=p)
    t = np.arange(0, 80, 0.05)
    u = 0.1 * np.sign(np.sin(1.1 * t)) * (1 + 0.5 * np.sin(0.37 * t))
    empty = ph.Experiment(t, {"da": u * np.where(t < 40, 1, 0.6)}, name="run")
    y = ph.simulate(m, {"Lp": -2.0, "Lda": 10.0}, empty, initial={"p": 0}).outputs["p"]
    y = y + 0.02 * np.random.default_rng(2).standard_normal(t.size)
    detect = ph.Detect(1e6, after=10, watch=("Lda", "Lp"))
    online = ph.Online(m, window=5, sigma={"p": 0.02}, detect=detect)
    alarm = online.run(ph.Experiment(t, {"da": u}, {"p": y}, name="run")).alarm
    assert alarm is not None and alarm.kind == "parameter" and alarm.name == "Lda"
    assert 38 < alarm.since < 42 and 40 < alarm.noticed < 43
    assert (alarm.before + alarm.change) / alarm.before == pytest.approx(0.6, abs=0.1)
    assert "most likely Lda × 0." in str(alarm)
    online.acknowledge()
    t_next = float(t[-1]) + 0.05
    online.push(t_next, [0.0], [np.nan])
    assert online.estimate.alarm is None


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({}, "sigma={'y': ...}"),
        ({"sigma": {"z": 1.0}}, "the model has no output 'z'"),
        ({"sigma": {"y": 0.1}, "window": 0}, "window is a whole number"),
        ({"sigma": {"y": 0.1}, "forgetting": ("slow", 1.0)}, "forgetting is"),
        ({"sigma": {"y": 0.1}, "parameter_errors": {"b": 1.0}}, "no parameter 'b'"),
        ({"sigma": {"y": 0.1}, "detect": ph.Detect(-1.0)}, "mean_samples is -1"),
    ],
)
def test_wrong_options_are_named(options: dict[str, object], text: str) -> None:
    with pytest.raises(ph.OptionError, match="Online") as caught:
        ph.Online(lag(), **options)  # type: ignore[arg-type]
    assert text in str(caught.value)


def test_a_wrong_sample_is_named_and_changes_nothing() -> None:
    online = ph.Online(lag(), sigma={"y": 0.1})
    online.push(0.0, {"u": 1.0}, {"y": 0.0})
    before = str(online.estimate)
    for t, u, y, text in [
        (0.0, {"u": 1.0}, {"y": 0.0}, "a sample of t = 0 s already"),
        (0.1, {"u": np.nan}, {"y": 0.0}, "channel 'u' is NaN at t = 0.1 s"),
        (0.1, {"v": 1.0}, {"y": 0.0}, "no input 'v'"),
        (0.1, {}, {"y": 0.0}, "no value of input 'u'"),
        (0.1, {"u": 1.0}, {"z": 0.0}, "no output 'z'"),
    ]:
        with pytest.raises(ph.DataError, match=text):
            online.push(t, u, y)
    assert str(online.estimate) == before
