"""Fits that ended at no optimum: they are estimated again, or the diagnosis says what their status means."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hidden import Case, make

import phugoid as ph
from phugoid.discrepancy.search import restart


@functools.cache
def servo() -> Case:
    return make("servo", "torque:sign(rate)", "strong", "white", 1)


def test_a_fit_that_was_broken_off_is_continued() -> None:
    broken_off = ph.estimate(servo().model, servo().data, solver=ph.Newton(max_iterations=1))
    assert broken_off.status == "iteration limit"
    d = ph.diagnose(broken_off, validation=servo().validation)
    assert [f.cause for f in d.findings if f.status == "named"] == ["torque:sign(rate)"]
    assert "ended as 'iteration limit'" in d.notes[0]
    assert d.fit.status == "converged"


def test_parameters_that_the_data_do_not_determine_are_fixed() -> None:
    """Two gains of one input are determined by their sum alone."""
    t = np.arange(0.0, 20.0, 0.05)
    m = ph.Model("two gains")
    (u,), (x,) = m.inputs(u="V"), m.states(x="m")
    a, b, c = m.parameters(a=0.5, b=0.4, c=0.5)
    m.dynamics(x=(a + b) * u - c * x)
    m.outputs(x=x)

    def record(seed: int) -> ph.Experiment:
        rng = np.random.default_rng(seed)
        v = np.repeat(rng.uniform(-1.0, 1.0, 20), 20)
        plan = ph.Experiment(t, {"u": v}, name=f"record {seed}")
        lacking = m.with_terms({"x'": -ph.Expr.symbol("d") * ph.Expr.symbol("x") ** 3}, {"d": 0.5})
        run = ph.simulate(lacking, {"a": 0.6, "b": 0.5, "c": 0.5, "d": 0.5}, plan, initial={"x": 0.0})
        return plan.with_outputs({"x": run.outputs["x"] + 0.01 * rng.standard_normal(t.size)})

    fit = ph.estimate(m, record(1))
    assert fit.status == "unidentifiable"
    d = ph.diagnose(fit, validation=record(2))
    assert any(f.cause == "x':x^3" or "x':x^3" in f.aliases for f in d.findings if f.status == "named"), d.summary()
    assert "which the data do not determine" in d.notes[0]


def test_a_fit_that_cannot_be_brought_to_an_optimum(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Nothing is named, and what the status means is the finding: it is reported, saved and read as any other."""

    def fails(*args: Any, **options: Any) -> Any:
        raise ph.DataError("no start")

    fit = dataclasses.replace(ph.estimate(servo().model, servo().data), status="infeasible", message="")
    monkeypatch.setattr(restart, "estimate", fails)
    monkeypatch.setattr(restart, "fitted_to_segments", lambda base: (None, 0))
    d = ph.diagnose(fit, validation=servo().validation)
    (finding,) = d.findings
    assert (d.verdict, d.found, finding.status) == ("unexplained", False, "unexplained")
    assert "'infeasible'" in finding.explanation and "Check units, signs, start values" in finding.explanation
    assert "infeasible" in d.summary()
    assert d.extend().added == ()
    d.report(tmp_path / "d.html")
    d.save(tmp_path / "d.json")
    read = ph.load(tmp_path / "d.json")
    assert read.findings[0].explanation == finding.explanation and read.verdict == "unexplained"


def test_validation_records_that_the_model_cannot_be_fitted_to_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    from phugoid.discrepancy.search import refit_cache

    def fails(*args: Any, **options: Any) -> Any:
        raise ph.DataError("diagnose: the model cannot be fitted to the validation record: it diverges")

    fit = ph.estimate(servo().model, servo().data)
    monkeypatch.setattr(refit_cache, "on_other_data", fails)
    d = ph.diagnose(fit, validation=servo().validation)
    assert "torque:sign(rate)" in [f.cause for f in d.findings if f.status == "named"]
    assert "it is left out" in d.notes[0]
