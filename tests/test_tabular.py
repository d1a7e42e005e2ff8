"""Results as tables of pandas and datasets of xarray."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import phugoid as ph
from phugoid import DataError, MissingDependency

pd = pytest.importorskip("pandas", reason="tables need pandas")
xr = pytest.importorskip("xarray", reason="datasets need xarray")

T = 0.1 * np.arange(40)
FINE = 0.04 * np.arange(100)


def model() -> ph.Model:
    m = ph.Model("lag")
    (x,) = m.states(x="m")
    (u,) = m.inputs(u="N")
    a, b = m.parameters(a=ph.Parameter(1.0, bounds=(0.1, 5.0), unit="1/s"), b=ph.Parameter(0.1, unit="m", fixed=True))
    m.dynamics(x=a * (u - x))
    m.outputs(x=x + b, rate=(a * (u - x), "m/s"))
    return m


def record(name: str, own: bool = False) -> ph.Experiment:
    """Outputs at different times, and the input at its own where ``own``."""
    rng = np.random.default_rng(len(name))
    inputs = {"u": (FINE, np.sin(2 * FINE))} if own else {"u": (T, np.sin(2 * T))}
    blank = ph.multirate(inputs, {"x": (T[:39], T[:39]), "rate": (T[::3], T[::3])}, name, units={"u": "N", "x": "m"})
    y = ph.simulate(model(), {"a": 1.5, "b": 0.1}, blank).outputs
    gaps = {n: np.where(np.isnan(blank.output(n)), np.nan, v) for n, v in y.items()}
    return blank.with_outputs({n: v + 0.01 * rng.standard_normal(v.size) for n, v in gaps.items()})


@pytest.fixture(scope="module")
def fit() -> ph.Fit:
    return ph.estimate(model(), record("run 1"))


@pytest.fixture(scope="module")
def two() -> ph.Fit:
    return ph.estimate(model(), [record("run 1"), record("second", own=True).window(0.5, 3.0)])


def test_parameters_as_a_table(fit: ph.Fit) -> None:
    table = fit.to_pandas()
    assert list(table.index) == list(fit.parameters) and table.index.name == "parameter"
    a, b = table.loc["a"], table.loc["b"]
    e = fit.parameters["a"]
    assert (a.value, a.std_error, a.unit, a.start, a.lower, a.upper) == (e.value, e.std_error, "1/s", 1.0, 0.1, 5.0)
    assert a.relative_std_error == e.relative_std_error
    assert b.fixed and not a.fixed and np.isnan(b.std_error) and b.lower == -np.inf
    assert table.value.dtype == table.upper.dtype == np.float64 and table.fixed.dtype == bool
    assert fit.initial_states["run 1"].to_pandas().loc["x", "unit"] == "m"
    assert ph.parameters.Estimates().to_pandas().empty


def test_a_record_as_a_table(fit: ph.Fit) -> None:
    r = fit.records[0]
    table = r.to_pandas()
    np.testing.assert_array_equal(table.index, r.t)
    for group in ("inputs", "states", "outputs", "measured", "residuals"):
        for name, values in getattr(r, group).items():
            np.testing.assert_array_equal(table[group, name], values)
    assert np.isnan(table["measured", "rate"]).sum() > 20
    assert table.attrs["units"]["rate"] == "m/s"


def test_a_table_has_rows_for_inputs_at_their_own_times(two: ph.Fit) -> None:
    for table in (two.records[1].to_pandas()["inputs"], two.experiments[1].to_pandas()):
        u = table["u"].dropna()
        np.testing.assert_allclose(u.index, FINE, rtol=1e-15)
        np.testing.assert_array_equal(u, np.sin(2 * FINE))
    e = two.experiments[1]
    table = e.to_pandas()
    assert np.diff(table.index).min() > 0.01  # 3 * 0.2 and 6 * 0.1 are one time
    assert list(table.columns) == ["u", "x", "rate"]
    np.testing.assert_array_equal(table.loc[e.t, "x"], e.output("x"))
    assert np.isnan(table["x"]).sum() == np.isnan(e.output("x")).sum() + len(table) - e.n
    assert table.attrs["history"] == list(e.history) and table.attrs["name"] == "second"


def test_a_record_as_a_dataset(fit: ph.Fit) -> None:
    data = fit.to_xarray()
    r = fit.records[0]
    assert data["time"].attrs["units"] == "s"
    np.testing.assert_array_equal(data["time"], r.t)
    np.testing.assert_array_equal(data["output_rate"], r.outputs["rate"])
    np.testing.assert_array_equal(data["measured_rate"] - data["output_rate"], r.residuals["rate"])
    np.testing.assert_array_equal(data["state_x"].sel(time=r.t[3]), r.states["x"][3])
    units = {name: data[name].attrs["units"] for name in ("input_u", "state_x", "residual_rate")}
    assert units == {"input_u": "N", "state_x": "m", "residual_rate": "m/s"}
    assert data.attrs["experiment"] == "run 1" and data.attrs["log_likelihood"] == fit.log_likelihood
    assert float(data["estimate"].sel(parameter="a")) == fit.parameters["a"].value
    assert float(data["std_error"].sel(parameter="a")) == fit.parameters["a"].std_error
    variance = data["covariance"].sel(parameter="a", parameter_other="a")
    assert float(variance) == pytest.approx(fit.parameters["a"].std_error ** 2)


def test_several_experiments_are_along_an_axis(two: ph.Fit) -> None:
    data = two.to_xarray()
    assert list(data["experiment"].values) == ["run 1", "second"]
    for r in two.records:
        one = data.sel(experiment=r.name)
        np.testing.assert_array_equal(one["output_x"].sel(time=r.t), r.outputs["x"])
        assert int(one["output_x"].notnull().sum()) == r.n
    assert data["output_x"].attrs["units"] == "m"
    assert data["input_u"].dims == ("experiment", "time_u")
    u = data["input_u"].sel(experiment="second").dropna("time_u")
    np.testing.assert_array_equal(u["time_u"], FINE)
    assert two.records[0].to_xarray()["input_u"].dims == ("time_u",)  # as multirate has it
    assert two.records[1].to_xarray()["input_u"].dims == ("time_u",)


def test_an_experiment_goes_through_a_dataset(two: ph.Fit) -> None:
    e = two.experiments[1]
    data = e.to_xarray()
    np.testing.assert_array_equal(data["time_u"], FINE)
    assert (data["u"].attrs, data["x"].attrs) == ({"units": "N", "role": "input"}, {"units": "m", "role": "output"})
    again = ph.read(data, inputs=["u"], outputs=["x", "rate"])
    np.testing.assert_array_equal(again.samples("u")[0], FINE)
    np.testing.assert_array_equal(again.samples("u")[1], np.sin(2 * FINE))
    at = np.searchsorted(again.t, e.t)
    for name in ("x", "rate"):
        np.testing.assert_array_equal(again.output(name)[at], e.output(name))
    assert again.units["u"] == "N"


def test_an_input_and_an_output_of_one_name() -> None:
    alike = ph.Experiment(T, {"u": T}, {"u": T, "x": T})
    assert list(alike.to_pandas().columns) == ["u", "x"]
    unlike = ph.Experiment(T, {"u": T}, {"u": 2 * T, "x": T}, name="flight")
    for convert in (unlike.to_pandas, unlike.to_xarray):
        with pytest.raises(DataError, match="'flight': the input 'u' and the output 'u' differ"):
            convert()


def test_a_simulation_as_a_table() -> None:
    table = ph.simulate(model(), {"a": 1.5, "b": 0.1}, ph.Experiment(T, {"u": T})).to_pandas()
    assert list(table.columns) == [("inputs", "u"), ("states", "x"), ("outputs", "x"), ("outputs", "rate")]


@pytest.mark.parametrize("package", ["pandas", "xarray"])
def test_without_the_package_the_command_is_told(package: str, fit: ph.Fit, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    for of in (fit, fit.records[0], fit.experiments[0]):
        with pytest.raises(MissingDependency, match=rf"pip install phugoid\[{package}\]"):
            getattr(of, f"to_{package}")()
