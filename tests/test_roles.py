"""Measured conditions are inputs that nobody commands: models remember them, and no tool moves them."""

from __future__ import annotations

import copy
import json
import pickle
from pathlib import Path

import numpy as np
import pytest

import phugoid as ph
from phugoid import _core
from phugoid.discrepancy.discrimination.candidate_manoeuvres import CandidateManoeuvres
from phugoid.discrepancy.search.refit import Refit
from phugoid.modelling.declared import Delays
from phugoid.sensitivities.tangents import collocated

T = np.arange(0.0, 12.0, 0.05)


def roll(late: bool = False) -> ph.Model:
    """Roll with an airspeed that scales its derivatives; the airspeed changes in the record."""
    m = ph.Model("roll")
    (p,) = m.states(p="rad/s")
    (da,) = m.inputs(da="rad")
    (V,) = m.conditions(V="m/s")
    Lp, Lda = m.parameters(Lp=-2.0, Lda=10.0)
    if late:
        V = m.delay(V, *m.parameters(tau=ph.Parameter(0.1, bounds=(0.0, 0.5), unit="s")))
    m.dynamics(p=(V / 50) * (Lp * p + Lda * da))
    m.outputs(p=p)
    return m


def record(model: ph.Model) -> ph.Experiment:
    u = 0.05 * np.sign(np.sin(1.3 * T)) * (T > 1)
    empty = ph.Experiment(T, {"da": u, "V": 50 + 8 * np.sin(0.4 * T)}, name="rolls")
    y = ph.simulate(model, {n: p.start for n, p in model.declared_parameters.items()}, empty, initial={"p": 0.0})
    return empty.with_outputs({"p": y.outputs["p"] + 0.005 * np.random.default_rng(1).standard_normal(T.size)})


@pytest.fixture(scope="module")
def fit() -> ph.Fit:
    return ph.estimate(roll(), record(roll()))


def test_conditions_are_inputs_with_a_role() -> None:
    m = roll()
    assert m.input_names == ("da", "V") and m.condition_names == ("V",)
    assert m.declared_inputs == {"da": "rad", "V": "m/s"}
    assert m.is_condition("V") and not m.is_condition("da")
    assert m.end_conditions == ()


def test_a_delayed_condition_is_one_too() -> None:
    m = roll(late=True)
    assert m.condition_names == ("V",) and m.is_condition("V_delayed")


def test_every_model_made_from_a_model_remembers_them(tmp_path: Path) -> None:
    m = roll()
    m.save(tmp_path / "m.json")
    p, late = _core.Expr.symbol("p"), roll(late=True)
    others = {
        "json": ph.Model.from_json(m.to_json()),
        "file": ph.Model.load(tmp_path / "m.json"),
        "pickle": pickle.loads(pickle.dumps(m)),
        "copy": copy.deepcopy(m),
        "parameters": m.with_parameters(Lp=-3.0),
        "terms": m.with_terms({"p'": _core.Expr.symbol("k") * p**3}, {"k": 0.0}),
        "noise": m.with_noise(p=0.1),
        "delays": late._around(late._core.at_delays(late.delays.spec, [("tau", 0.1)]), Delays()),
        **{c.name: c.extended(m) for c in ph.candidates(m)},
    }
    lost = [name for name, other in others.items() if other.condition_names != ("V",)]
    assert not lost
    assert str(others["json"]) == str(m) and others["json"].latex() == m.latex()


def test_models_without_conditions_are_saved_as_before_and_read() -> None:
    m = ph.Model("lag")
    (x,) = m.states("x")
    m.dynamics(x=-x)
    m.outputs(x=x)
    assert "measured_conditions" not in json.loads(m.to_json())
    assert ph.Model.from_json(m.to_json()).condition_names == ()


def test_the_crate_reads_a_model_with_conditions() -> None:
    assert [name for name, _ in _core.Model.from_json(roll().to_json()).inputs] == ["da", "V"]


@pytest.mark.parametrize("wrong", ["V", [1], ["W"], ["V", "V"], {"V": 1}, 3, None, [["V"]]])
def test_saved_conditions_must_be_inputs(wrong: object) -> None:
    text = json.dumps({**json.loads(roll().to_json()), "measured_conditions": wrong})
    with pytest.raises(ph.ModelError, match="measured_conditions"):
        ph.Model.from_json(text)


def test_fits_and_diagnoses_are_saved_with_them(fit: ph.Fit, tmp_path: Path) -> None:
    assert fit.model.condition_names == ("V",)
    for name in ("fit.json", "fit.h5"):
        fit.save(tmp_path / name)
        assert ph.load(tmp_path / name).model.condition_names == ("V",)


def test_they_are_printed() -> None:
    assert repr(roll()) == "<Model 'roll': 1 state, 1 input, 1 condition, 1 output, 2 parameters>"
    assert str(roll()).endswith("conditions: V (m/s)")
    assert r"\text{conditions: } & V" in roll().latex()


def test_a_report_names_them(fit: ph.Fit, tmp_path: Path) -> None:
    fit.report(tmp_path / "fit.html")
    assert "V is a measured condition" in (tmp_path / "fit.html").read_text(encoding="utf-8")


def test_no_actuator_is_blamed_for_a_condition() -> None:
    families = {c.name.partition(":")[2] for c in ph.candidates(roll()) if c.name.startswith("V:")}
    assert families <= {"scale", "bias", "delay"} and "delay" in families
    late = {c.name for c in ph.candidates(roll(late=True)) if c.name.startswith("V:")}
    assert late <= {"V:scale", "V:bias"}
    of_control = {c.name for c in ph.candidates(roll()) if c.name.startswith("da:")}
    assert {"da:deadband", "da:saturation", "da:backlash", "da:rate_limit", "da:lag", "da:delay"} <= of_control


def test_no_manoeuvre_of_a_condition_is_advised(fit: ph.Fit) -> None:
    listed = CandidateManoeuvres(Refit((), collocated(fit))).manoeuvres
    assert {m.input for m in listed} == {"da"}


def test_plans_hold_conditions(fit: ph.Fit) -> None:
    from phugoid import design

    def make(width: float = 1.0) -> ph.Experiment:
        return ph.Experiment(T, {"da": design.doublet(T, 0.05, width=width, start=1.0)}, name="doublet")

    plan = ph.design.plan(fit, make())
    V = np.mean(fit.records[0].inputs["V"])
    assert plan.records[0].inputs["V"] == pytest.approx(V) and not plan.warnings
    best = ph.design.optimal_plan(fit, make, {"width": (0.5, 2.0)}, generations=1)
    assert np.ptp(best.records[0].inputs["V"]) == 0.0
    given = ph.Experiment(T, {**make().inputs, "V": 50 + T}, name="accelerated")
    (warning,) = ph.design.plan(fit, given).warnings
    assert "'V' is a measured condition" in warning and "50 to 61.95 in 'accelerated'" in warning
    with pytest.raises(ph.DataError, match="has no condition 'V'"):
        ph.design.plan(roll(), make(), noise={"p": 0.01})


def test_errors_name_the_role(fit: ph.Fit) -> None:
    run = record(roll())
    without = ph.Experiment(T, {"da": run.input("da")}, {"p": run.output("p")}, name="rolls")
    with pytest.raises(ph.DataError, match="experiment 'rolls' has no condition 'V'"):
        ph.estimate(roll(), without)
    with pytest.raises(ph.DataError, match="has no condition 'V'"):
        ph.simulate(roll(), {"Lp": -2.0, "Lda": 10.0}, without)
    with pytest.raises(ph.DataError, match="lacks what the model has: condition 'V'"):
        fit.validate(without)
    as_output = ph.Experiment(T, {"da": run.input("da")}, {"p": run.output("p"), "V": run.input("V")}, name="rolls")
    with pytest.raises(ph.DataError, match="give it among the inputs too if the model uses it as a condition"):
        ph.estimate(roll(), as_output)
    gap = np.where(np.arange(T.size) == 40, np.nan, run.input("V"))
    holed = ph.Experiment(T, {"da": run.input("da")}, {"p": run.output("p")}, channels={"V": gap})
    with pytest.raises(ph.DataError, match="condition 'V'"):
        ph.estimate(roll(), holed)
    knots = ph.Experiment(T, run.inputs, run.outputs, units={"V": "ft/s"})
    with pytest.raises(ph.DataError, match="condition 'V' of experiment 'experiment' is in 'ft/s'"):
        ph.estimate(roll(), knots)
    with pytest.raises(ph.ModelError, match="conditions: names are text"):
        ph.Model("m").conditions(3)  # type: ignore[arg-type]
    m = roll()
    with pytest.raises(ph.ModelError, match="'da'"):
        m.conditions("da")
    assert m.condition_names == ("V",)


def test_conditions_work_where_the_model_is_rebuilt_for_several_records() -> None:
    """Parameters of each experiment become inputs where filters estimate process noise."""
    m = roll().with_parameters(Lda=ph.Parameter(10.0, per_experiment=True))
    a, b = record(roll()).window(0.0, 5.0, "a"), record(roll()).window(5.5, 11.0, "b")
    found = ph.estimate(m, [a, b], transcription=ph.FilterError("p"))
    assert found.model.condition_names == ("V",)
