"""``phugoid diagnose``: the finding, and exit codes."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from cli_case import MODEL, run

import phugoid as ph
from phugoid.cli.commands import _code
from phugoid.cli.model_file import load_model


def hidden(seed: int) -> None:
    """Writes hidden<seed>.csv, of a system with friction that the model has not."""
    Path("friction.py").write_text(MODEL.replace("-a * x", "-a * x - 1.5 * x * abs(x)"))
    t = np.arange(301) * 0.1
    u = np.sign(np.sin((0.8 + 0.4 * seed) * t + 0.1)) * (1.0 + 0.5 * np.sin(0.3 * t))
    inputs = ph.Experiment(t, {"u": u})
    x = ph.simulate(load_model("friction.py"), {"a": 0.5, "b": 2.0, "c": 0.1}, inputs, initial={"x": 0.5}).outputs["x"]
    x = x + 0.01 * np.random.default_rng(seed).standard_normal(t.size)
    np.savetxt(f"hidden{seed}.csv", np.column_stack([t, u, x]), "%.9g", ",", header="t,u,x", comments="")


def test_a_hidden_cause_is_named(here: Path) -> None:
    hidden(1)
    hidden(2)
    ph.estimate(load_model("model.py"), ph.read("hidden1.csv")).save("fit.json")
    done = run("diagnose", "model.py", "hidden1.csv", "--fit", "fit.json", "--validation", "hidden2.csv",
               "--report", "d.html", "--json")  # fmt: skip
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    named = [name for f in found["findings"] for name in (f["cause"], *f["aliases"])]
    assert "x':x|x|" in named and found["fit"]["converged"] and "</html>" in (here / "d.html").read_text()


def test_nothing_missing_is_a_conclusion(here: Path) -> None:
    ph.estimate(load_model("model.py"), ph.read("run1.csv")).save("fit.json")
    done = run("diagnose", "fit.json")
    assert done.exit_code == 0 and "No effect that these data" in done.stdout, done.output


def test_a_fit_that_has_not_converged_is_exit_code_1(here: Path) -> None:
    done = run("diagnose", "model.py", "run1.csv", "--iterations", 0)
    assert done.exit_code == 1 and "There is nothing to diagnose" in done.stdout


@pytest.mark.parametrize(
    ("verdict", "interrupted", "code"),
    [
        ("nothing", False, 0),
        ("named", False, 0),
        ("minor", False, 0),
        ("surrogate", False, 0),
        ("unexplained", False, 1),
        ("interrupted", True, 130),
    ],
)
def test_exit_codes(verdict: str, interrupted: bool, code: int) -> None:
    found: Any = SimpleNamespace(verdict=verdict, interrupted=interrupted)
    assert _code(found) == code


def test_a_model_needs_data(here: Path) -> None:
    done = run("diagnose", "model.py")
    assert done.exit_code == 2 and "model.py is a model: give data files" in done.stderr
