"""The README's code runs as it stands."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pages
import pytest

import phugoid as ph

README = pages.ROOT / "README.md"


def blocks() -> list[str]:
    return [b.code for b in pages.blocks(README, "python")]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the run1.csv that the README reads: a simulated record with noise and empty cells."""
    monkeypatch.chdir(tmp_path)
    import unstable_aircraft

    e = unstable_aircraft.twin()
    rows = np.column_stack([e.t, e.input("de"), *(e.output(n) for n in ("w", "q", "az"))])
    lines = ["t,de,w,q,az", *(",".join(f"{v:.9g}" for v in row) for row in rows)]
    cells = lines[50].split(",")
    lines[50] = ",".join([*cells[:3], "", cells[4]])
    (tmp_path / "run1.csv").write_text("\n".join(lines) + "\n")
    return tmp_path


def test_first_example_estimates_plots_and_saves(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names: dict[str, object] = {}
    exec(blocks()[0], names)
    fit = names["fit"]
    assert isinstance(fit, ph.Fit) and fit.converged
    assert abs(fit.parameters["Mw"].value - 0.2166) < 4 * fit.parameters["Mw"].std_error
    assert "Mw" in capsys.readouterr().out
    assert np.isnan(fit.residuals["q"]).sum() == 1
    assert ph.load("fit.json").parameters["Mw"].value == fit.parameters["Mw"].value


def test_second_example_takes_several_runs_and_options(folder: Path) -> None:
    names: dict[str, object] = {}
    exec(blocks()[0], names)
    data = names["data"]
    assert isinstance(data, ph.Experiment)
    names.update(run1=data.window(0, 7, name="run1"), run2=data.window(7.05, 12.5, name="run2"))
    exec(blocks()[1], names)
    fit = names["fit"]
    assert isinstance(fit, ph.Fit) and fit.converged
    assert [r.name for r in fit.records] == ["run1", "run2"]
    assert "sigma_az" not in fit.parameters


def test_flights_with_biases_and_a_late_actuator(capsys: pytest.CaptureFixture[str]) -> None:
    (block,) = (b for b in blocks() if "m.delay" in b)
    t = np.arange(0, 10, 0.05)
    de = 0.1 * np.sign(np.sin(1.5 * t))
    names: dict[str, object] = {"ph": ph}
    exec(block[: block.index("fit =")], names)
    m = names["m"]
    assert isinstance(m, ph.Model)
    random = np.random.default_rng(0)
    truth = {"Mq": -2.0, "Mde": -6.0, "tau": 0.12}
    for name, bias in (("run1", 0.02), ("run2", -0.01), ("run3", 0.03)):
        e = ph.Experiment(t, {"de": de}, name=name)
        path = ph.simulate(m, {**truth, "b": bias}, e, initial={"theta": 0.1})
        z = {n: y + 0.002 * random.standard_normal(t.size) for n, y in path.outputs.items()}
        names[name] = e.with_outputs(z)
    exec(block[block.index("fit =") :], names)
    fit = names["fit"]
    assert isinstance(fit, ph.Fit) and fit.converged
    for name, true in {**truth, "b[run1]": 0.02, "b[run2]": -0.01}.items():
        assert abs(fit.parameters[name].value - true) < 4 * fit.parameters[name].std_error, name
    exec(next(b for b in blocks() if "fit.coloured" in b), names)
    said = capsys.readouterr().out
    assert "ratio" in said and "profile likelihood, complete" in said and "50 of 50 runs converged" in said
    assert names["axes"].keys() == {"q", "theta"}  # type: ignore[attr-defined]


def test_a_diagnosis_names_what_the_model_misses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The flights have a damping that grows with the rate, which their model has not."""
    monkeypatch.chdir(tmp_path)
    (block,) = (b for b in blocks() if "m.delay" in b)
    t = np.arange(0, 10, 0.05)
    de = 0.3 * np.sign(np.sin(1.5 * t)) * np.sin(0.4 * t)
    names: dict[str, object] = {"ph": ph}
    exec(block[: block.index("fit =")], names)
    m = names["m"]
    assert isinstance(m, ph.Model)
    true = ph.candidates(m)["q':q|q|"].extended(m)
    (damping,) = {*true.parameter_names} - {*m.parameter_names}
    random = np.random.default_rng(0)
    for name, bias in (("run1", 0.02), ("run2", -0.01), ("run3", 0.03)):
        e = ph.Experiment(t, {"de": (1 if name == "run1" else 0.8) * de}, name=name)
        path = ph.simulate(true, {"Mq": -2.0, "Mde": -6.0, "tau": 0.12, "b": bias, damping: -2.0}, e)
        names[name] = e.with_outputs({n: y + 0.002 * random.standard_normal(t.size) for n, y in path.outputs.items()})
    exec(block[block.index("fit =") :], names)
    exec(next(b for b in blocks() if "ph.diagnose" in b), names)
    extended = names["extended"]
    assert isinstance(extended, ph.results.Extension) and extended.added == ("q':q|q|",)
    assert extended.gain.held_out > 10
    assert abs(extended.fit.parameters[damping].value + 2.0) < 4 * extended.fit.parameters[damping].std_error
    printed = capsys.readouterr().out
    assert "The model misses" in printed and "q':q|q|" in printed and damping in printed
    assert (tmp_path / "missing.html").exists()
