"""What users do between two fits: they change their model, name files, and predict runs with values of their own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import phugoid as ph

T = np.linspace(0.0, 6.0, 121)


def model() -> ph.Model:
    m = ph.Model("lag with trim")
    (x,), (u,) = m.states("x"), m.inputs("u")
    k, trim, b = m.parameters(k=1.0, trim=ph.Parameter(0.0, per_experiment=True), b=0.0)
    m.dynamics(x=k * (u - x) + trim)
    m.outputs(y=x + b, z=2.0 * x)
    return m


def run(name: str, trim: float, seed: int) -> ph.Experiment:
    u = np.sign(np.sin((1.0 + 0.2 * seed) * T))
    truth = {"k": 1.5, "trim": trim, "b": 0.05}
    path = ph.simulate(model(), truth, ph.Experiment(T, {"u": u}, name=name), initial={"x": 0.0})
    random = np.random.default_rng(seed)
    return ph.Experiment(
        T, {"u": u}, {n: y + 0.01 * random.standard_normal(T.size) for n, y in path.outputs.items()}, name
    )


@pytest.fixture
def fit() -> ph.Fit:
    return ph.estimate(model(), [run("one", 0.1, 0), run("two", -0.2, 1)])


def test_a_model_that_changes_after_a_fit_does_not_change_the_fit(tmp_path: Path) -> None:
    m, other = model(), run("three", 0.0, 2)
    fit = ph.estimate(m, run("one", 0.1, 0))
    before = fit.validate(other, biases=["trim", "b"])
    m.parameters("later")
    m.initial(x=0.5)
    m.noise(y=1e-3)
    after = fit.validate(other, biases=["trim", "b"])
    assert after.log_likelihood == before.log_likelihood and "later" not in fit.model.parameter_names
    fit.save(tmp_path / "fit.json")
    assert ph.load(tmp_path / "fit.json").parameters.to_dict() == fit.parameters.to_dict()
    assert len(ph.linear.modes(fit)) == 1


def test_a_copy_of_a_model_is_its_own() -> None:
    m = model()
    again = m.copy()
    m.parameters("later")
    assert str(again) == str(model()) and again.parameter_names == model().parameter_names
    assert "later" in m.parameter_names and again.noise_model is m.noise_model


@pytest.mark.parametrize("name", ["fit.pkl", "fit.pdf"])
def test_a_file_that_ends_in_something_else_is_refused(fit: ph.Fit, tmp_path: Path, name: str) -> None:
    with pytest.raises(ph.OptionError, match=r"a fit is written to a file that ends in \.json or \.h5 or \.hdf5"):
        fit.save(tmp_path / name)
    with pytest.raises(ph.OptionError, match=r"a report is written to a file that ends in \.html or \.htm"):
        fit.report(tmp_path / name)
    with pytest.raises(ph.OptionError, match=r"ends in \.html or \.htm, such as fit\.html"):
        fit.report(tmp_path / "fit")
    assert list(tmp_path.iterdir()) == []


def test_the_advice_of_validate_leads_on(fit: ph.Fit) -> None:
    other = run("three", 0.05, 2)
    with pytest.raises(ph.ModelError, match=r"biases=\['b', 'trim'\]"):
        fit.validate(other)
    found = fit.validate(other, biases=["b", "trim"])
    assert abs(found.re_estimated["trim"].value - 0.05) < 0.02


def test_a_prediction_takes_values_of_its_own_run(fit: ph.Fit) -> None:
    other = run("three", 0.05, 2)
    with pytest.raises(ph.ModelError, match="each experiment has its own trim, and 'three' has none"):
        fit.predict(other)
    found = fit.predict(other, {"trim": 0.05}, initial={"x": 0.0})
    assert float(np.std(found.outputs["y"] - other.output("y"))) < 0.02
