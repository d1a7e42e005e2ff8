"""Diagnosis with a validation record where trim is each experiment's own: it is used, or refused, never left out."""

from __future__ import annotations

import functools

import numpy as np
import pytest

import phugoid as ph

TRUTH = {"k": -4.0, "c": -0.8, "b": 3.0}


def model(cubic: bool = False) -> ph.Model:
    """A mass on a spring; the force that it rests at is each experiment's own."""
    m = ph.Model("spring")
    x, v = m.states(x="m", v="m/s")
    (u,) = m.inputs("u")
    k, c, b = m.parameters(k=-3.0, c=-0.5, b=2.0)
    (trim,) = m.parameters(trim=ph.Parameter(0.0, per_experiment=True))
    force = k * x + c * v + b * u + trim
    m.dynamics(x=v, v=force - 1.5 * x**3 if cubic else force)
    m.outputs(x=x, v=v)
    return m


def record(name: str, trim: float, seed: int) -> ph.Experiment:
    t = 0.05 * np.arange(500)
    u = ph.design.multisine(t, 1.0, band=(0.05, 0.8), phases="random", seed=seed)
    e = ph.Experiment(t, {"u": u}, name=name)
    path = ph.simulate(model(cubic=True), {**TRUTH, "trim": trim}, e, initial={"x": 0.1, "v": 0.0})
    rng = np.random.default_rng(10 + seed)
    return e.with_outputs({n: y + 0.01 * rng.standard_normal(t.size) for n, y in path.outputs.items()})


RECORDS = [("first", 0.5, 1), ("second", -0.5, 2), ("third", 1.5, 3)]


@functools.cache
def fit(number: int) -> ph.Fit:
    return ph.estimate(model(), [record(*r) for r in RECORDS[:number]])


@pytest.mark.parametrize("number", [1, 2], ids=["one record", "two records"])
def test_the_validation_record_is_used_with_its_own_trim(number: int) -> None:
    d = ph.diagnose(fit(number), validation=record(*RECORDS[2]), biases=["trim"])
    assert d.findings[0].cause == "v':x^3" and d.findings[0].held_out_gain > 100
    assert "Gains were computed on third, with initial states and trim re-estimated." in d.notes
    assert d.extend().gain.held_out_rms_before


@pytest.mark.parametrize("number", [1, 2], ids=["one record", "two records"])
def test_without_its_trim_it_is_refused_and_not_left_out(number: int) -> None:
    with pytest.raises(
        ph.ModelError, match=r"own 'trim', and which value the validation record has .* biases=\['trim'\]"
    ):
        ph.diagnose(fit(number), validation=record(*RECORDS[2]))


def test_biases_that_cannot_be() -> None:
    third = record(*RECORDS[2])
    with pytest.raises(ph.OptionError, match="biases are estimated again in validation records: give validation"):
        ph.diagnose(fit(1), biases=["trim"])
    with pytest.raises(ph.ModelError, match="biases: 'trimm' is not a parameter of the model. Did you mean 'trim'"):
        ph.diagnose(fit(1), validation=third, biases=["trimm"])
    with pytest.raises(ph.ModelError, match="Say 'trim', for all experiments"):
        ph.diagnose(fit(2), validation=third, biases=["trim[first]"])
    with pytest.raises(ph.OptionError, match="biases is a list of names"):
        ph.diagnose(fit(1), validation=third, biases="trim")
