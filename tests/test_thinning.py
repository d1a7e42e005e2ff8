"""Oversampled records: thinned as far as motion and residuals allow, with inputs as they were."""

from __future__ import annotations

import functools

import numpy as np
import pytest

import phugoid as ph
from phugoid.discrepancy.search.refit import Refit
from phugoid.discrepancy.search.segments import Thinned, thinned

STEP, LAST = 0.001, 8.0


@functools.cache
def model(friction: float = 0.0) -> ph.Model:
    m = ph.Model("motor")
    (u,), (angle, rate) = m.inputs("u"), m.states(angle="rad", rate="rad/s")
    d, b = m.parameters(d=5.0, b=12.0)
    m.dynamics(angle=rate, rate=b * u - d * rate - friction * ph.tanh(rate / 0.05))
    m.outputs(angle=angle, rate=rate)
    return m


def record(seed: int, every: int = 1, friction: float = 0.0, tone: float = 0.0) -> ph.Experiment:
    """Steps of a voltage, one sample in ``every``; a tone of 200 Hz may be on the rate."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, LAST, STEP)
    # Steps that a slower record has, too: each is a ramp over 20 samples.
    slow = np.arange(0.0, LAST + 20 * STEP, 20 * STEP)
    u = np.interp(t, slow, rng.uniform(-2.0, 2.0, 21)[(slow / LAST * 20).astype(int)])
    run = ph.simulate(
        model(friction),
        {"d": 5.0, "b": 12.0},
        ph.Experiment(t, {"u": u}),
        initial=dict.fromkeys(("angle", "rate"), 0.0),
    )
    y = {"angle": run.outputs["angle"], "rate": run.outputs["rate"] + tone * np.sin(2 * np.pi * 200.0 * t)}
    y = {n: z + {"angle": 0.01, "rate": 0.1}[n] * rng.standard_normal(t.size) for n, z in y.items()}
    return ph.Experiment(t[::every], {"u": u[::every]}, {n: z[::every] for n, z in y.items()}, name=f"record {seed}")


def of(e: ph.Experiment, validation: tuple[ph.Experiment, ...] = ()) -> tuple[Refit, Thinned | None]:
    base = Refit((), ph.estimate(model(), e))
    return base, thinned(base, validation)


def test_means_say_as_much_as_the_samples() -> None:
    further = record(2).with_channels({"current": np.zeros(record(2).n)}, units={"current": "A"})  # the model has none
    base, found = of(record(1), (further,))
    assert found is not None and found.factor > 8 and found.rate == pytest.approx(1.0 / STEP / found.factor)
    for name in ("d", "b"):
        before, after = (r.fit.parameters[name] for r in (base, found.base))
        assert after.value == pytest.approx(before.value, abs=0.5 * before.std_error)
        assert after.std_error == pytest.approx(before.std_error, rel=0.15)
    sigma = {n: np.nanstd(found.base.fit.records[0].residuals[n]) * np.sqrt(found.factor) for n in ("angle", "rate")}
    assert sigma == pytest.approx({"angle": 0.01, "rate": 0.1}, rel=0.1)
    (other,) = found.validation
    assert other.n == found.base.fit.records[0].t.size and other.t[[0, -1]] == pytest.approx(record(2).t[[0, -1]])


def test_what_is_quick_is_kept() -> None:
    """A tone that blocks would hide, and samples that are none too many."""
    _, found = of(record(1, tone=0.2))
    assert found is None or found.rate > 400.0
    assert of(record(1, every=20))[1] is None


def test_uneven_and_missing_samples_stay() -> None:
    e = record(1)
    t = e.t.copy()
    t[1:-1:2] += 0.3 * STEP
    assert of(ph.Experiment(t, e.inputs, e.outputs))[1] is None
    slower = np.where(np.arange(e.n) % 3, np.nan, e.output("angle"))
    assert of(ph.Experiment(e.t, e.inputs, {**e.outputs, "angle": slower}))[1] is None


@pytest.mark.parametrize("every", [1, 20])
def test_the_verdict_is_that_of_a_slower_record(every: int) -> None:
    fit = ph.estimate(model(), record(1, every, friction=1.0))
    d = ph.diagnose(fit, validation=record(2, every, friction=1.0))
    assert [f.cause for f in d.findings if f.status == "named"] == ["rate':sign(rate)"], d.summary()
    assert any("means over" in note for note in d.notes) == (every == 1)
