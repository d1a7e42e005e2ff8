"""Public names: the namespaces, what has moved and warns, and methods of a fit that are functions elsewhere."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

import phugoid as ph
from phugoid.parameters import Estimates

MOVED = {
    **{name: ("linear", name) for name in ph.linear.__all__},
    **{name: ("design", name) for name in ("plan", "plans", "optimal_plan")},
}


@pytest.fixture(scope="module")
def fit() -> ph.Fit:
    m = ph.Model("lag")
    (x,), (u,), (k,) = m.states("x"), m.inputs("u"), m.parameters(k=ph.Parameter(1.0, bounds=(0.0, 5.0)))
    m.dynamics(x=k * (u - x))
    m.outputs(y=x)
    t = np.linspace(0.0, 5.0, 101)
    run = ph.Experiment(t, {"u": np.sign(np.sin(2.0 * t))})
    path = ph.simulate(m, {"k": 1.5}, run, initial={"x": 0.0})
    y = path.outputs["y"] + 0.01 * np.random.default_rng(0).standard_normal(t.size)
    return ph.estimate(m, ph.Experiment(t, {"u": run.input("u")}, {"y": y}, name="run"))


@pytest.mark.parametrize("name", MOVED)
def test_a_name_that_has_moved_warns_and_works(name: str) -> None:
    place, own = MOVED[name]
    with pytest.warns(DeprecationWarning, match=rf"phugoid\.{name} is now phugoid\.{place}\.{own}"):
        assert getattr(ph, name) is getattr(getattr(ph, place), own)
    assert name not in dir(ph)


def test_inputs_are_in_design() -> None:
    with pytest.warns(DeprecationWarning, match=r"phugoid\.inputs is now phugoid\.design"):
        from phugoid import inputs
    assert inputs.doublet is ph.design.doublet


@pytest.mark.parametrize(
    ("kind", "old", "new"),
    [
        ("Finding", "rivals", "alternatives"),
        ("Finding", "rivals_explained", "alternatives_explained"),
        ("Reconstruction", "places", "vane_positions"),
        ("Validation", "held", "fixed"),
        ("Validation", "freed", "re_estimated"),
    ],
)
def test_an_attribute_that_was_renamed_warns_and_works(kind: str, old: str, new: str) -> None:
    result = getattr(ph.results, kind)
    some = object.__new__(result)
    vars(some)[new] = "the value"
    with pytest.warns(DeprecationWarning, match=rf"{kind}\.{old} is now {kind}\.{new}"):
        assert getattr(some, old) == "the value"


@pytest.mark.parametrize(("old", "new"), [("Coloured", "CorrectedErrors"), ("VanePlaces", "VanePositions")])
def test_a_result_that_was_renamed_warns_and_works(old: str, new: str) -> None:
    with pytest.warns(DeprecationWarning, match=rf"phugoid\.results\.{old} is now phugoid\.results\.{new}"):
        assert getattr(ph.results, old) is getattr(ph.results, new)
    assert old not in dir(ph.results)


def test_a_name_that_never_was_is_an_error() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'estimat'"):
        _ = ph.estimat


def test_importing_warns_of_nothing() -> None:
    code = "import phugoid as ph; from phugoid import *; [getattr(ph, name) for name in dir(ph)]"
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_functions_are_at_the_top_too() -> None:
    assert all(getattr(ph, name) is getattr(ph.functions, name) for name in ph.functions.__all__)


def test_a_confidence_interval_is_an_estimate_and_standard_errors(fit: ph.Fit) -> None:
    e = fit.parameters["k"]
    assert fit.conf_int()["k"] == pytest.approx((e.value - 1.959964 * e.std_error, e.value + 1.959964 * e.std_error))
    low, high = fit.conf_int(0.5, robust=True)["k"]
    assert high - low == pytest.approx(2 * 0.67449 * fit.robust().parameters["k"].std_error, rel=1e-4)
    assert set(fit.conf_int()) == {"k", "sigma_y"}
    with pytest.raises(ph.OptionError, match="level is between 0 and 1, not 95"):
        fit.conf_int(95)


def test_an_interval_ends_at_a_bound() -> None:
    wide = ph.results.Estimate("k", 1.0, 2.0, "", 0.0, (0.0, 5.0))
    held = ph.results.Estimate("m", 1.0, float("nan"), "", 1.0, (0.0, 5.0), True)
    assert Estimates([wide, held]).conf_int(0.99) == {"k": (0.0, 5.0)}


def test_robust_was_a_property(fit: ph.Fit) -> None:
    with pytest.warns(DeprecationWarning, match=r"method Fit\.robust\(\)"):
        assert fit.coloured is fit.robust()


def test_methods_are_the_functions(fit: ph.Fit) -> None:
    run = fit.experiments[0]
    assert fit.misfit().summary() == ph.misfit(fit).summary()
    assert np.array_equal(fit.predict(run).outputs["y"], ph.simulate(fit.model, fit, run).outputs["y"])
    found = fit.diagnose(time_limit=60.0)
    assert type(found) is ph.results.Diagnosis and found.verdict == ph.diagnose(fit).verdict
    assert type(fit.improve(time_limit=60.0)) is ph.results.Improvement
