"""What importing phugoid, and a first estimate, leave unimported: start-up time is felt at every run."""

from __future__ import annotations

import subprocess
import sys

HEAVY = (
    "scipy", "matplotlib", "pandas", "rich", "sympy", "h5py", "pyarrow", "polars", "xarray", "pyulog", "pymavlink",
    "control", "fmpy", "jinja2",
)  # fmt: skip


def loaded_after(code: str) -> list[str]:
    """Which of the heavy packages a fresh Python has loaded after the code."""
    code += f"\nimport sys\nprint(*[name for name in {HEAVY!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def test_importing_stays_light() -> None:
    assert loaded_after("import phugoid") == []


def test_every_module_stays_light() -> None:
    # Not the command line, which prints with rich.
    code = """
import importlib, pkgutil, phugoid
for module in pkgutil.walk_packages(phugoid.__path__, "phugoid."):
    if not module.name.startswith(("phugoid.cli", "phugoid.__main__")):
        importlib.import_module(module.name)
"""
    assert loaded_after(code) == []


SETUP = """
import phugoid as ph
m = ph.Model("lag")
(x,) = m.states("x")
(a,) = m.parameters("a")
m.dynamics(x=-a * x)
m.outputs(x=x)
e = ph.Experiment([0.0, 1.0, 2.0, 3.0], outputs={"x": [1.0, 0.4, 0.1, 0.05]})
"""


def test_building_a_model_stays_light() -> None:
    assert loaded_after(SETUP + "m.check(); str(m)") == []


def test_the_iterations_need_numpy_and_ipopt_only() -> None:
    code = SETUP + (
        "import sys\n"
        "def stop(iteration):\n"
        f"    print(*[name for name in {HEAVY!r} if name in sys.modules])\n"
        "    sys.stdout.flush(); import os; os._exit(0)\n"
        "ph.estimate(m, e, progress=stop)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stdout.split()) == (0, []), done.stderr


def test_a_fit_stays_light() -> None:
    # scipy.special alone takes longer to import than this fit, and a time limit counts it.
    assert loaded_after(SETUP + "ph.estimate(m, e)") == []
