"""Without cyipopt everything works but the solver Ipopt, which says what to install."""

from __future__ import annotations

import subprocess
import sys

SCRIPT = """
import sys
sys.modules["cyipopt"] = None          # as if it were not installed
import numpy as np
import phugoid as ph

m = ph.Model("lag")
x, = m.states("x")
u, = m.inputs("u")
a, = m.parameters("a")
m.dynamics(x=a*(u - x))
m.outputs(x=x)
t = np.linspace(0, 1, 20)
record = ph.simulate(m, {"a": 1.0}, ph.Experiment(t, {"u": t}), initial={"x": 0.0})
print("simulated", record.outputs["x"].size)
data = ph.Experiment(t, {"u": t}, {"x": record.outputs["x"] + 1e-3*np.sin(100*t)})
print("estimated", round(ph.estimate(m, data).parameters["a"].value, 2))
try:
    ph.estimate(m, data, solver=ph.Ipopt())
except ph.MissingDependency as error:
    print("refused", error)
"""


def test_estimation_works_and_ipopt_says_what_to_install() -> None:
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True)
    simulated, estimated, refused = done.stdout.strip().splitlines()
    assert simulated == "simulated 20"
    assert estimated == "estimated 1.0"
    assert refused.startswith("refused the solver Ipopt needs cyipopt") and 'pip install "phugoid[ipopt]"' in refused
