"""What the package returns with a fit in it holds a `Fit`, with all its methods, however the fit was made."""

from __future__ import annotations

import inspect
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hidden import make

import phugoid as ph

T = np.linspace(0.0, 5.0, 51)


def lag() -> ph.Model:
    m = ph.Model("lag")
    x, u, k = m.states("x")[0], m.inputs("u")[0], m.parameters(k=1.0)[0]
    m.dynamics(x=k * (u - x))
    m.outputs(y=x)
    return m


def run() -> ph.Experiment:
    u = np.sign(np.sin(2.0 * T))
    path = ph.simulate(lag(), {"k": 1.5}, ph.Experiment(T, {"u": u}), initial={"x": 0.0})
    y = path.outputs["y"] + 0.01 * np.random.default_rng(0).standard_normal(T.size)
    return ph.Experiment(T, {"u": u}, {"y": y}, name="run")


@pytest.fixture(scope="module")
def fit() -> ph.Fit:
    return ph.estimate(lag(), run())


@pytest.mark.parametrize(
    "transcription",
    [ph.Collocation(refine=True), ph.MultipleShooting(segments=5), ph.FilterError("x"), None],
    ids=["refined", "shooting", "filter error", "default"],
)
def test_an_estimate_is_a_fit(transcription: Any, tmp_path: Path) -> None:
    fit = ph.estimate(lag(), run(), transcription=transcription)
    assert type(fit) is ph.Fit and "k" in fit.summary()
    fit.save(tmp_path / "fit.json")
    assert type(ph.load(tmp_path / "fit.json")) is ph.Fit
    assert type(pickle.loads(pickle.dumps(fit))) is ph.Fit


def test_an_estimate_with_a_delay_is_a_fit() -> None:
    m = ph.Model("late")
    x, u = m.states("x")[0], m.inputs("u")[0]
    k, tau = m.parameters(k=1.0, tau=ph.Parameter(0.05, bounds=(0.0, 0.3)))
    m.dynamics(x=k * (m.delay(u, tau) - x))
    m.outputs(y=x)
    fit = ph.estimate(m, run())
    assert type(fit) is ph.Fit and fit._moved is not None


def test_the_best_of_many_starts_is_a_fit() -> None:
    assert type(ph.multistart(lag(), run(), n=2, ranges={"k": (0.5, 3.0)}).best) is ph.Fit


def test_a_reconstruction_holds_fits() -> None:
    t = np.linspace(0.0, 10.0, 101)
    random = np.random.default_rng(1)
    channels = {
        "ax": 9.81 * np.sin(0.05) + 0.1 * np.sin(t),
        "az": -9.81 * np.cos(0.05) + 0.3 * np.sin(0.7 * t),
        "q": 0.02 * np.cos(t),
        "V": 100.0 + 0.05 * random.standard_normal(t.size),
        "alpha": 0.05 + 0.01 * np.sin(t) + 1e-3 * random.standard_normal(t.size),
        "theta": 0.05 + 0.02 * np.sin(t) + 1e-3 * random.standard_normal(t.size),
    }
    found = ph.reconstruct(ph.Experiment(t, channels=channels), ["V", "alpha", "theta"], longitudinal=True)
    assert type(found.fit) is ph.Fit and found.places is not None and type(found.places.fit) is ph.Fit


def test_a_diagnosis_and_its_extension_hold_fits(tmp_path: Path) -> None:
    case = make("duffing", ("f:x^3",), "strong", "white", 1)
    base = ph.estimate(case.model, case.data)
    found = ph.diagnose(base)
    assert found.fit is base
    found.save(tmp_path / "d.json")
    for each in (found, ph.load(tmp_path / "d.json")):
        assert type(each) is ph.results.Diagnosis and type(each.fit) is ph.Fit
        assert type(each.extend()) is ph.results.Extension and type(each.extend().fit) is ph.Fit
    again = pickle.loads(pickle.dumps(found.extend()))
    assert type(again) is ph.results.Extension and type(again.fit) is ph.Fit
    assert found.extend().fit.validate(case.validation).converged


def test_public_functions_keep_name_signature_and_docstring() -> None:
    for function, name in ((ph.estimate, "Fit | FleetFit"), (ph.diagnose, "Diagnosis")):
        assert pickle.loads(pickle.dumps(function)) is function
        assert inspect.signature(function).return_annotation == name
        assert function.__doc__ and "Raises" in function.__doc__
    assert [*inspect.signature(ph.estimate).parameters][:2] == ["model", "data"]


def test_coloured_errors_are_computed_once_for_a_fit(fit: ph.Fit) -> None:
    assert fit.robust() is fit.robust()
    other = replace(fit, covariance=4.0 * fit.covariance)
    assert type(other) is ph.Fit and other.robust() is not fit.robust()
