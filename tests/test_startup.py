"""What importing phugoid, and a first estimate, leave unimported: start-up time is felt at every run."""

from __future__ import annotations

import ast
import importlib
import inspect
import subprocess
import sys
from pathlib import Path
from typing import Any

import phugoid as ph
from phugoid.cli import COMMANDS

HEAVY = (
    "scipy", "matplotlib", "pandas", "rich", "sympy", "h5py", "pyarrow", "polars", "xarray", "pyulog", "pymavlink",
    "control", "fmpy", "jinja2", "threadpoolctl",
)  # fmt: skip


def loaded_after(code: str) -> list[str]:
    """Which of the heavy packages a fresh Python has loaded after the code."""
    code += f"\nimport sys\nprint(*[name for name in {HEAVY!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def own_modules_after(code: str) -> list[str]:
    """The package's own modules, and numpy, that a fresh Python has loaded after the code."""
    code += "\nprint(*sorted(n for n in sys.modules if n.split('.')[0] in ('phugoid', 'numpy') and n.count('.') < 2))"
    done = subprocess.run([sys.executable, "-c", "import sys\n" + code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()[-1].split()


def test_importing_stays_light() -> None:
    assert loaded_after("import phugoid") == []
    # The core, and nothing else: names are imported when they are asked for.
    assert own_modules_after("import phugoid; dir(phugoid)") == ["phugoid", "phugoid._core"]


def test_a_name_brings_what_it_needs() -> None:
    found = own_modules_after("import phugoid; phugoid.DataError")
    assert found == ["phugoid", "phugoid._core", "phugoid.errors"]
    found = own_modules_after("import phugoid; phugoid.Model; phugoid.read")
    assert not {"phugoid.result", "phugoid.estimation", "phugoid.discrepancy", "phugoid.cli"} & {*found}


def test_the_list_of_commands_needs_nothing_of_the_package() -> None:
    for option in ("--help", "--version"):
        code = f"""
import contextlib, io, phugoid.cli
with contextlib.redirect_stdout(io.StringIO()) as shown:
    phugoid.cli.app(["{option}"], standalone_mode=False)
assert shown.getvalue()
"""
        assert own_modules_after(code) == ["phugoid", "phugoid._core", "phugoid.cli"] and loaded_after(code) == []


def test_lines_on_commands_are_those_of_the_commands() -> None:
    for name, (module, line) in COMMANDS.items():
        command = getattr(importlib.import_module(f"phugoid.cli.{module}"), name)
        assert (inspect.getdoc(command) or "").splitlines()[0] == line


def test_types_are_those_of_the_names() -> None:
    """What type checkers see is imported from the same modules."""
    assert ph.__file__ is not None
    tree = ast.parse(Path(ph.__file__).read_text(encoding="utf-8"))
    (checked,) = (
        node.body for node in tree.body if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
    )
    imports: dict[str, Any] = {
        name: node.module
        for node in checked
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
        for name in (ph.functions.__all__ if alias.name == "*" else [alias.name])
    }
    namespaces = {name for name, module in imports.items() if module is None}
    assert {name: module for name, module in imports.items() if module} == ph._MODULES
    assert namespaces == {*ph._NAMESPACES}
    assert {*ph.__all__} == {*imports, "Expr", "__version__"}
    assert {name for name, place in ph._MOVED.items() if place.startswith("linear.")} == {*ph.linear.__all__}


def test_no_module_hides_a_name() -> None:
    """A module that is imported becomes an attribute of the package, in place of a function of its name."""
    folder = Path(ph.__file__ or "").parent
    modules = {path.stem for path in folder.iterdir()} - {"__init__"}
    assert modules & {*ph._MODULES} == set()


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
    # Nor does it need what can be asked of it: a diagnosis takes several times as long to import.
    asked = {"discrepancy", "diagnosis", "uncertainty", "sensitivities", "validation", "linear", "export", "report"}
    assert not {f"phugoid.{name}" for name in asked} & {*own_modules_after(SETUP + "ph.estimate(m, e)")}
