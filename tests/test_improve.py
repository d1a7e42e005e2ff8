"""`ph.improve`: diagnose, put in what is named, diagnose again."""

from __future__ import annotations

import numpy as np
import pytest

import phugoid as ph


def model(complete: bool = False) -> ph.Model:
    m = ph.Model("stage")
    x, v = m.states(x="m", v="m/s")
    (u,) = m.inputs(u="N")
    k, c, b = m.parameters(k=4.0, c=0.6, b=1.0)
    m.dynamics(x=v, v=-k * x - c * v + b * u - (2.5 * x**3 if complete else 0.0))
    m.outputs(x=x, v=v)
    return m


def flown(seed: int, held: bool = False) -> ph.Experiment:
    random = np.random.default_rng(seed)
    t = np.arange(0.0, 24.0, 0.04)
    u = 2.0 * np.repeat(random.uniform(-1.0, 1.0, t.size // 15 + 1), 15)[: t.size]
    kind = "hold" if held else "linear"
    run = ph.Experiment(t, {"u": u}, name=f"run{seed}", interpolation=kind)
    r = ph.simulate(model(complete=True), {"k": 4.2, "c": 0.5, "b": 1.1}, run)
    noisy = {
        n: y + s * random.standard_normal(t.size) for (n, y), s in zip(r.outputs.items(), (0.004, 0.01), strict=True)
    }
    return ph.Experiment(t, {"u": u}, noisy, name=f"run{seed}")


def test_a_missing_term_is_put_in_and_then_nothing_is_missing() -> None:
    told: list[str] = []
    better = ph.improve(ph.estimate(model(), flown(1)), flown(2), progress=told.append)
    assert better.added == ("v':x^3",) and better.verdict == "nothing"
    first, last = better.steps
    assert first.added == ("v':x^3",) and not last.added
    assert first.gain is not None and first.gain.change("x", held_out=True) < -0.5
    (name,) = set(better.fit.model.parameter_names) - {"k", "c", "b"}
    assert better.fit.parameters[name].value == pytest.approx(-2.5, abs=4.0 * better.fit.parameters[name].std_error)
    assert "v':x^3" in better.summary() and "(nothing)" in better.summary()
    assert told
    assert repr(better) == "<Improvement of 'stage' by v':x^3>"
    assert better.fit.summary()  # a fit like any other


def test_a_held_input_is_held_from_then_on() -> None:
    fit = ph.estimate(model(complete=True), flown(3, held=True))
    better = ph.improve(fit, flown(4, held=True))
    assert better.added == ("u:hold",)
    assert better.fit.experiments[0].interpolation_of("u") == "hold"
    assert better.verdict == "nothing"


def test_with_nothing_missing_nothing_is_added() -> None:
    fit = ph.estimate(model(complete=True), flown(5))
    same = ph.improve(fit, flown(6))
    assert same.added == () and len(same.steps) == 1
    assert same.fit.parameters["k"].value == fit.parameters["k"].value


def test_steps_must_be_a_number() -> None:
    fit = ph.estimate(model(), flown(1))
    with pytest.raises(ph.errors.OptionError, match="improve: steps is a whole number from 1, not 0"):
        ph.improve(fit, steps=0)


@pytest.mark.parametrize("limit", [0, 0.01])
def test_time_ends_it_with_what_was_found(limit: float) -> None:
    better = ph.improve(ph.estimate(model(), flown(1)), flown(2), time_limit=limit)
    assert better.steps[0].diagnosis.interrupted and better.added == ()
    # Who reads the summary is to know, too.
    assert better.interrupted and "is preliminary" in better.summary() and "ended early" in repr(better)
