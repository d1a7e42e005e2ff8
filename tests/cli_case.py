"""A model file and data files for the tests of the command line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from typer.testing import CliRunner, Result

import phugoid as ph
from phugoid.cli import app

MODEL = """\
import phugoid as ph


def lag() -> ph.Model:
    print("building")  # goes to stderr
    m = ph.Model("lag")
    (x,) = m.states(x="m")
    (u,) = m.inputs(u="m/s")
    a, b, c = m.parameters(a=ph.Parameter(0.0, unit="1/s"), b=0.0, c=0.0)
    m.dynamics(x=-a * x + b * u)
    m.outputs(x=x + c)
    return m
"""
TRUTH = {"a": 1.5, "b": 2.0, "c": 0.1}


def write(folder: Path) -> None:
    """model.py, run1.csv and run2.csv."""
    (folder / "model.py").write_text(MODEL)
    scope: dict[str, object] = {}
    exec(MODEL, scope)
    model = scope["lag"]()  # type: ignore[operator]
    t = np.arange(81) * 0.1
    for seed, name in enumerate(("run1", "run2")):
        u = np.sign(np.sin((1.0 + 0.4 * seed) * t + 0.1))
        truth = ph.simulate(model, TRUTH, ph.Experiment(t, {"u": u}), initial={"x": 0.5})
        x = truth.outputs["x"] + 0.02 * np.random.default_rng(seed).standard_normal(t.size)
        np.savetxt(folder / f"{name}.csv", np.column_stack([t, u, x]), "%.9g", ",", header="t,u,x", comments="")


def run(*args: object) -> Result:
    """The command in this process; stdout and stderr apart."""
    return CliRunner().invoke(app, [str(a) for a in args])
