"""`validate` and `diagnose` read a file as the record of the fit was read: names, units, time."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import phugoid as ph
from phugoid.cli import app

MODEL = """import phugoid as ph
model = ph.Model("motor")
(w,) = model.states(w="rad/s")
(volts,) = model.inputs(volts="V")
k, b = model.parameters("k b")
model.dynamics(w=k * volts - b * w)
model.outputs(w=w)
"""
OPTIONS = ["--rename", "Motor Voltage=volts", "--rename", "Speed=w", "--convert", "--time", "Clock"]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("model.py").write_text(MODEL)
    t = np.arange(0.0, 10.0, 0.02)
    for seed in (0, 1):
        u = np.where(t % 3 < 1.5, 5.0 + seed, -5.0)
        w, rng = np.zeros_like(t), np.random.default_rng(seed)
        for i in range(t.size - 1):
            w[i + 1] = w[i] * np.exp(-0.06) + (1 - np.exp(-0.06)) * 4.0 * u[i]
        rpm = (w + 0.05 * rng.standard_normal(t.size)) * 30 / np.pi
        rows = "\n".join(f"{a:.2f};{b:.3f};{c:.4f}" for a, b, c in zip(t, u, rpm, strict=True))
        Path(f"run{seed}.csv").write_text(f"Clock [s];Motor Voltage [V];Speed [rpm]\n{rows}\n")
    assert run("fit", "model.py", "run0.csv", *OPTIONS, "--save", "fit.json").exit_code == 0
    return tmp_path


def run(*arguments: str):  # type: ignore[no-untyped-def]
    return CliRunner().invoke(app, arguments)


def test_the_options_of_the_fit_are_those_of_its_validation(here: Path) -> None:
    found = run("validate", "fit.json", "run1.csv", "--json")
    assert found.exit_code == 0, found.stderr
    few = run("validate", "fit.json", "run1.csv", "--initial-samples", "50", "--json")
    assert few.exit_code == 0 and json.loads(few.stdout)["log_likelihood"] != json.loads(found.stdout)["log_likelihood"]
    assert run("simulate", "fit.json", "run1.csv", "--out", "out.csv").exit_code == 0
    assert json.loads(found.stdout)["matches"]["w"]["r_squared"] > 0.99


def test_a_file_with_other_names_is_read_as_asked_for(here: Path) -> None:
    text = Path("run1.csv").read_text().replace("Motor Voltage", "U").replace("Clock", "t")
    Path("other.csv").write_text(text)
    found = run("validate", "fit.json", "other.csv", "--rename", "U=volts", "--rename", "Speed=w", "--time", "t")
    assert found.exit_code == 0, found.stderr
    Path("own.csv").write_text(text.replace("U [", "volts [").replace("Speed [rpm]", "w [rad/s]"))
    assert run("validate", "fit.json", "own.csv").exit_code in (0, 1)


def test_a_fit_saved_in_python_remembers_as_well(here: Path) -> None:
    fit = ph.load("fit.json")
    rename = {"Motor Voltage": "volts", "Speed": "w"}
    again = ph.read("run0.csv", time="Clock", rename=rename, units={"Speed": ("rpm", "rad/s")}).window(0.0, 8.0)
    ph.estimate(fit.model, again).save("own.h5")
    assert run("validate", "own.h5", "run1.csv").exit_code == 0


def test_missing_names_are_answered_with_the_option(here: Path) -> None:
    found = run("fit", "model.py", "run0.csv", "--time", "Clock")
    assert found.exit_code == 2 and "Use --rename OLD=NEW where names differ" in found.stderr
