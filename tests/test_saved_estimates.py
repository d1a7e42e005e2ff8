"""The saved estimates that the Rust crate's tests repeat are what Python estimates today.

rust/core/tests/saved_estimates.rs reads the same file: together they say that the same model and data give the same
estimates in both languages.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
import saved_estimates

import phugoid as ph

SAVED = json.loads(saved_estimates.FIXTURE.read_text(encoding="utf-8"))


def experiment(saved: dict[str, Any]) -> ph.Experiment:
    outputs = {n: np.array(z, dtype=float) for n, z in saved["outputs"].items()}
    kind = "cubic" if saved["cubic"] else "linear"
    return ph.Experiment(saved["t"], saved["inputs"], outputs, name=saved["name"], interpolation=kind)  # type: ignore[arg-type]


def test_all_cases_are_there() -> None:
    """Their models are those of the script, to the letter."""
    named = {case["name"]: case for case in SAVED["cases"]}
    expected = list(saved_estimates.cases())
    assert list(named) == [name for name, *_ in expected]
    for name, model, of, said in expected:
        case = named[name]
        assert (case["model"], case["records"], case["options"]) == (json.loads(model.to_json()), of, said), name


@pytest.mark.parametrize("case", SAVED["cases"], ids=lambda case: str(case["name"]))
def test_estimates_are_those_saved(case: dict[str, Any]) -> None:
    model = ph.Model.from_json(json.dumps(case["model"]))
    runs = [experiment(saved) for saved in SAVED["records"][case["records"]]]
    fit = ph.estimate(model, runs, **saved_estimates.options(case["options"]))
    assert fit.converged and fit.iterations == case["iterations"]
    assert fit.log_likelihood == pytest.approx(case["log_likelihood"], rel=1e-10)
    assert list(fit.parameters) == list(case["estimates"])
    for name, (value, error) in case["estimates"].items():
        assert fit.parameters[name].value == pytest.approx(value, rel=1e-9, abs=1e-12), name
        if error is None:
            assert np.isnan(fit.parameters[name].std_error), name
        else:
            assert fit.parameters[name].std_error == pytest.approx(error, rel=1e-8), name
