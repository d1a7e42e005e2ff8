"""``phugoid simulate``: the CSV, and where values come from."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cli_case import TRUTH, run

import phugoid as ph
from phugoid.cli.model_file import load_model

VALUES = [f"--parameters={name}={value}" for name, value in TRUTH.items()]


def test_simulation_is_that_of_the_library_to_the_bit(here: Path) -> None:
    done = run("simulate", "model.py", "run1.csv", *VALUES, "--initial", "x=0.5", "--out", "sim.csv")
    assert done.exit_code == 0, done.output
    assert "RMS of measured minus simulated 0.0" in done.stdout and "Written: sim.csv" in done.stdout
    expected = ph.simulate(load_model("model.py"), TRUTH, ph.read("run1.csv"), initial={"x": 0.5})
    found = ph.read("sim.csv")
    assert np.array_equal(found.channels["x"], expected.outputs["x"]) and found.units["u"] == "m/s"
    printed = run("simulate", "model.py", "run1.csv", *VALUES, "--initial", "x=0.5")
    assert printed.stdout == (here / "sim.csv").read_text()


def test_a_fit_brings_its_initial_states(here: Path) -> None:
    fit = ph.estimate(load_model("model.py"), ph.read("run1.csv"))
    fit.save("fit.json")
    done = run("simulate", "fit.json", "run1.csv", "--json")
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    np.testing.assert_allclose(found["columns"]["x"], fit.outputs["x"], atol=1e-6)
    other = run("simulate", "model.py", "run1.csv", "--parameters", "fit.json", "--parameters", "c=1", "--json")
    moved = np.array(json.loads(other.stdout)["columns"]["x"]) - fit.outputs["x"]
    np.testing.assert_allclose(moved, 1.0 - fit.parameters["c"].value, atol=1e-6)


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (VALUES[:2], "no value was given for c: give --parameters fit.json, or --parameters c=..."),
        ([*VALUES, "--parameters", "cc=1"], "--parameters: 'cc' is not a parameter. Did you mean 'c'?"),
        ([*VALUES, "--initial", "y=1"], "--initial: 'y' is not a state"),
        (["--parameters", "fit"], "'fit' is neither a saved fit (.json, .h5) nor of the form NAME=VALUE"),
        (["--parameters", "no.json"], "no.json: there is no such file"),
        (["--parameters", "a=-9e3,b=1,c=0"], "grows without limit"),
    ],
)
def test_bad_input(here: Path, args: list[str], words: str) -> None:
    done = run("simulate", "model.py", "run1.csv", *args)
    assert done.exit_code == 2 and words in done.stderr and done.stdout == "", done.output
