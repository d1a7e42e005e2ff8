"""Saved fits: JSON and HDF5, with their data; files of older versions; files that are damaged."""

from __future__ import annotations

import json
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import phugoid as ph
from phugoid import DataError, MissingDependency
from phugoid.saving import files as io

VERSION_1 = Path(__file__).parent / "data" / "fit_version_1.json"
needs_h5py = pytest.mark.skipif(find_spec("h5py") is None, reason="HDF5 needs h5py")
SUFFIXES = ("json", pytest.param("h5", marks=needs_h5py))
T = 0.1 * np.arange(60)


def model(late: bool = False) -> ph.Model:
    m = ph.Model("lag")
    (x,) = m.states(x="m")
    (u,) = m.inputs(u="N")
    a, b, tau = m.parameters(
        a=ph.Parameter(1.0, bounds=(0.1, 5.0), unit="1/s"),
        b=ph.Parameter(0.0, unit="m", per_experiment=True),
        tau=ph.Parameter(0.02, bounds=(-0.1, 0.5), unit="s", fixed=not late),
    )
    m.dynamics(x=a * ((m.delay(u, tau) if late else u + 0 * tau) - x))
    m.outputs(x=(x + b, "m"))
    return m


def records(late: bool = False) -> list[ph.Experiment]:
    """Two records: one at even times with gaps, one whose channels have times of their own."""
    rng = np.random.default_rng(1)
    fine = 0.05 * np.arange(121)
    truth = {"a": 1.5, "b": 0.1, "tau": 0.1 if late else 0.0}
    even = ph.Experiment(T, {"u": np.sin(2 * T)}, name="run/1", units={"u": "N"}, channels={"spare": T})
    x = ph.simulate(model(late), truth, even).outputs["x"] + 0.02 * rng.standard_normal(T.size)
    x[[3, 17]] = np.nan
    even = even.with_outputs({"x": x})
    own = ph.multirate({"u": (fine, np.cos(2 * fine))}, {"x": (T[2:-2], T[2:-2])}, "run 2")
    y = ph.simulate(model(late), truth, own).outputs["x"]
    return [even, own.with_outputs({"x": y + 0.02 * rng.standard_normal(own.n)})]


@pytest.fixture(scope="module")
def fit() -> ph.Fit:
    return ph.estimate(model(), records(), transcription=ph.Collocation(order=3))


def same_experiment(one: ph.Experiment, other: ph.Experiment) -> None:
    assert (one.name, one.interpolation, one.history) == (other.name, other.interpolation, other.history)
    assert one.units == other.units
    np.testing.assert_array_equal(one.t, other.t)
    for group in ("inputs", "outputs", "channels"):
        np.testing.assert_equal(dict(getattr(one, group)), dict(getattr(other, group)))
    for name in other.inputs:
        np.testing.assert_equal(one.signal(name), other.signal(name))
    np.testing.assert_equal(one.mesh_times, other.mesh_times)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_saved_fit_is_the_same_fit(suffix: str, tmp_path: Path, fit: ph.Fit) -> None:
    fit.save(tmp_path / f"fit.{suffix}")
    again = ph.load(tmp_path / f"fit.{suffix}")
    again.save(tmp_path / f"again.{suffix}")
    assert (tmp_path / f"again.{suffix}").read_bytes() == (tmp_path / f"fit.{suffix}").read_bytes()
    assert again.summary() == fit.summary()
    assert again.parameters.to_dict() == fit.parameters.to_dict()
    np.testing.assert_array_equal(again.covariance, fit.covariance)
    for one, other in zip(again.records, fit.records, strict=True):
        assert one.units == other.units
        for group in ("inputs", "outputs", "states", "measured", "residuals", "mesh_states", "input_samples"):
            np.testing.assert_equal(getattr(one, group), dict(getattr(other, group)))
    for e, before in zip(again.experiments, fit.experiments, strict=True):
        same_experiment(e, before)
    assert again.experiments[0].history == ("outputs replaced: x",)
    assert again.solution is not None and fit.solution is not None
    np.testing.assert_array_equal(again.solution.xi, fit.solution.xi)
    np.testing.assert_array_equal(again.solution.multipliers, fit.solution.multipliers)
    np.testing.assert_equal(again.solution.bound_multipliers, fit.solution.bound_multipliers)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_what_needs_the_data_works_after_loading(suffix: str, tmp_path: Path, fit: ph.Fit) -> None:
    fit.save(tmp_path / f"fit.{suffix}")
    again = ph.load(tmp_path / f"fit.{suffix}")
    found = [ph.diagnose(f, [c for c in ph.candidates(f.model) if c.name.startswith("u:")]) for f in (again, fit)]
    assert [d.summary().splitlines()[1:] for d in found[:1]] == [d.summary().splitlines()[1:] for d in found[1:]]
    one, other = (f.validate(records()[0].window(0, 3, "held out")) for f in (again, fit))
    assert one.log_likelihood == other.log_likelihood
    assert ph.estimate(again.model, again.experiments, start=again, transcription=again.transcription).iterations <= 1


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_standard_errors_of_modes_where_parameters_trade_off(suffix: str, tmp_path: Path) -> None:
    """They are found from the data and the solution: b and c have no covariance, the mode has one."""
    m = ph.Model("lag with a gain twice")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    a, b, c = m.parameters(a=1.0, b=1.0, c=1.0)
    m.dynamics(x=-a * x + b * u)
    m.outputs(x=c * x)
    m.initial(x=0.0)
    e = ph.Experiment(T, {"u": np.sin(2 * T)})
    rng = np.random.default_rng(2)
    x1 = ph.simulate(m, {"a": 2.0, "b": 1.0, "c": 1.0}, e).outputs["x"] + 0.01 * rng.standard_normal(T.size)
    fit = ph.estimate(m, e.with_outputs({"x": x1}))
    fit.save(tmp_path / f"fit.{suffix}")
    before, after = ph.linear.modes(fit), ph.linear.modes(ph.load(tmp_path / f"fit.{suffix}"))
    assert np.isfinite(before[0].time_constant.std_error)
    assert str(after) == str(before)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_fit_with_a_delay_is_diagnosed_alike_after_loading(suffix: str, tmp_path: Path) -> None:
    fit = ph.estimate(model(late=True), records(late=True))
    fit.save(tmp_path / f"fit.{suffix}")
    again = ph.load(tmp_path / f"fit.{suffix}")
    again.save(tmp_path / f"again.{suffix}")
    assert (tmp_path / f"again.{suffix}").read_bytes() == (tmp_path / f"fit.{suffix}").read_bytes()
    assert ph.misfit(again).summary() == ph.misfit(fit).summary()


@needs_h5py
def test_hdf5_holds_arrays_with_units(tmp_path: Path, fit: ph.Fit) -> None:
    import h5py

    fit.save(tmp_path / "fit.hdf5")
    with h5py.File(tmp_path / "fit.hdf5") as file:
        assert (file.attrs["format"], file.attrs["version"]) == ("phugoid-fit", io.VERSION)
        x = file["records/0/outputs/x"]
        np.testing.assert_array_equal(x[()], fit.records[0].outputs["x"])
        assert x.attrs["units"] == "m"
        assert file["experiments/0/inputs/u"].attrs["units"] == "N"
        assert file["experiments/1/signals/u/0"].attrs["units"] == "s"
        assert file["records/1/mesh_t"].attrs["units"] == "s"
        assert "units" not in file["covariance"].attrs


@needs_h5py
def test_names_that_are_no_hdf5_paths(tmp_path: Path) -> None:
    names = ("a/b", "a∕b", ".", "..", "document", "é ü")
    e = ph.Experiment(T, channels={n: k * T for k, n in enumerate(names)}, outputs={"x": np.exp(-T)})
    m = ph.Model("decay")
    (x,) = m.states("x")
    (a,) = m.parameters(a=0.7)
    m.dynamics(x=-a * x)
    m.outputs(x=x)
    m.noise(x=0.1)
    fit = ph.estimate(m, e)
    fit.save(tmp_path / "fit.h5")
    same_experiment(ph.load(tmp_path / "fit.h5").experiments[0], e)


@needs_h5py
def test_hdf5_is_known_by_its_content(tmp_path: Path, fit: ph.Fit) -> None:
    fit.save(tmp_path / "fit.h5")
    (tmp_path / "fit.h5").rename(tmp_path / "fit.dat")
    assert ph.load(tmp_path / "fit.dat").summary() == fit.summary()


def test_a_fit_of_version_1_is_read() -> None:
    """Made by phugoid as it was when the format had version 1."""
    fit = ph.load(VERSION_1)
    assert json.loads(VERSION_1.read_text(encoding="utf-8"))["version"] == 1
    assert fit.converged and [r.name for r in fit.records] == ["run 1", "run 2"]
    assert fit.parameters["a"].value == 1.538849399931116
    assert fit.parameters["b[run 2]"].std_error == 0.0045682025509934665
    assert fit.log_likelihood == 116.16658345713637
    assert np.isnan(fit.records[1].measured["x"][4]) and fit.records[0].states["x"].size == 16
    assert fit.experiments == () and fit.solution is None
    assert ph.misfit(fit).summary()
    found = ph.estimate(fit.model, [ph.Experiment(r.t, r.inputs, r.measured, r.name) for r in fit.records], start=fit)
    assert found.log_likelihood == pytest.approx(fit.log_likelihood, rel=1e-2)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_file_cut_short_is_refused(suffix: str, tmp_path: Path, fit: ph.Fit) -> None:
    path = tmp_path / f"fit.{suffix}"
    fit.save(path)
    whole = path.read_bytes()
    for size in (0, 4, 100, len(whole) // 2, len(whole) - 10):
        path.write_bytes(whole[:size])
        with pytest.raises(DataError, match=rf"fit\.{suffix}: .*(damaged|cut short)"):
            ph.load(path)


@needs_h5py
def test_damaged_arrays_are_found_out(tmp_path: Path, fit: ph.Fit) -> None:
    """A bit that flips in a dataset is caught by its checksum."""
    import h5py

    path = tmp_path / "fit.h5"
    fit.save(path)
    with h5py.File(path) as file:
        chunk = file["records/0/states/x"].id.get_chunk_info(0)
    raw = bytearray(path.read_bytes())
    raw[chunk.byte_offset + chunk.size // 2] ^= 1
    path.write_bytes(raw)
    with pytest.raises(DataError, match=r"fit\.h5: is damaged"):
        ph.load(path)


@needs_h5py
def test_other_hdf5_files_and_newer_versions_are_refused(tmp_path: Path, fit: ph.Fit) -> None:
    import h5py

    path = tmp_path / "fit.h5"
    with h5py.File(path, "w") as file:
        file["x"] = T
    with pytest.raises(DataError, match="is not a fit saved by phugoid"):
        ph.load(path)
    fit.save(path)
    with h5py.File(path, "r+") as file:
        text = file["document"][0].decode().replace(f'"version": {io.VERSION}', '"version": 99', 1)
        del file["document"]
        file["document"] = np.array([text.encode()])
    with pytest.raises(DataError, match="install a newer phugoid"):
        ph.load(path)
    fit.save(path)
    with h5py.File(path, "r+") as file:
        del file["records/0/t"]
    with pytest.raises(DataError, match="is damaged"):
        ph.load(path)


def test_version_2_without_its_data_is_damaged(tmp_path: Path, fit: ph.Fit) -> None:
    path = tmp_path / "fit.json"
    for key in ("experiments", "solution", "moved"):
        fit.save(path)
        document = json.loads(path.read_text(encoding="utf-8"))
        del document[key], document["checksum"]  # as an earlier release, which wrote none, might have damaged it
        path.write_text(json.dumps(document), encoding="utf-8")
        with pytest.raises(DataError, match=key):
            ph.load(path)


@needs_h5py
def test_a_failed_save_leaves_the_old_file(tmp_path: Path, fit: ph.Fit) -> None:
    fit.save(tmp_path / "fit.h5")
    before = (tmp_path / "fit.h5").read_bytes()
    with pytest.raises(DataError, match="no folder"):
        fit.save(tmp_path / "absent" / "fit.h5")
    with pytest.raises(DataError, match="has no place in JSON"):
        io.save_fit_dict(tmp_path / "fit.h5", {"x": T, "odd": object()})
    assert (tmp_path / "fit.h5").read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["fit.h5"]


@needs_h5py
def test_without_h5py_the_command_to_install_it_is_told(
    tmp_path: Path, fit: ph.Fit, monkeypatch: pytest.MonkeyPatch
) -> None:
    fit.save(tmp_path / "fit.h5")
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(MissingDependency, match=r'pip install "phugoid\[hdf5\]"'):
        fit.save(tmp_path / "other.h5")
    with pytest.raises(MissingDependency, match=r'pip install "phugoid\[hdf5\]"'):
        ph.load(tmp_path / "fit.h5")
