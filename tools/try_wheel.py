"""Install a wheel into an environment of its own, without Rust, and use it as a new user would.

    python tools/try_wheel.py WHEEL [--versions lowest | newest] [--python PYTHON]

`lowest` installs the lowest versions of the packages that the wheel's metadata accepts, `newest` what pip finds. Then
the package is imported, a packaged example is written, fitted, validated and simulated from the command line, a small
model is diagnosed, and two threads fit at once. Prints one row of a Markdown table; ends with 1 where a step failed,
with what it printed. Needs nothing but Python 3.10.
"""

from __future__ import annotations

import argparse
import os
import platform
import re
import subprocess
import sys
import tempfile
import venv
import zipfile
from dataclasses import dataclass
from pathlib import Path

TITLES = ("wheel", "MB", "machine", "Python", "numpy", "scipy", "matplotlib", "import, s", "result")

# A first-order lag whose damping grows with the state, which the model has not: the diagnosis must say so.
DIAGNOSIS = """
import numpy as np
import phugoid as ph

def record(name, seed):
    t = np.arange(0.0, 20.0, 0.05)
    u = np.where(t % 8.0 < 4.0, 1.0, -1.0) * (1.0 + 0.5 * seed)
    m = ph.Model("truth")
    (x,), (v,) = m.states(x="m"), m.inputs(v="N")
    a, b, c = m.parameters("a b c")
    m.dynamics(x=a * x + b * v + c * x**3)
    m.outputs(x=x)
    blank = ph.Experiment(t, {"v": u}, {"x": np.zeros_like(t)}, name=name)
    y = ph.simulate(m, {"a": -0.5, "b": 1.0, "c": -0.4}, blank).outputs["x"]
    return blank.with_outputs({"x": y + 0.005 * np.random.default_rng(seed).standard_normal(t.size)})

m = ph.Model("lag")
(x,), (v,) = m.states(x="m"), m.inputs(v="N")
a, b = m.parameters("a b")
m.dynamics(x=a * x + b * v)
m.outputs(x=x)
found = ph.diagnose(ph.estimate(m, record("one", 0)), validation=record("two", 1))
assert [f.cause for f in found.findings] == ["x':x^3"], found.summary()
"""

# Two estimations at once give the same bits as one after the other; a free-threaded Python stays so.
THREADS = """
import sys, threading
import phugoid as ph

runs = [ph.read("hfb320.csv"), ph.read("hfb320_other.csv")]
model = ph.models.hfb320()

def fit(i, into):
    into[i] = ph.estimate(model, runs[i])

alone, together = {}, {}
for i in range(2):
    fit(i, alone)
threads = [threading.Thread(target=fit, args=(i, together)) for i in range(2)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
for i in range(2):
    one, two = (f[i].parameters for f in (alone, together))
    assert all(one[n].value == two[n].value and one[n].std_error == two[n].std_error for n in one), i
assert sys.version_info < (3, 13) or sys._is_gil_enabled() != ("free-threading" in sys.version), "the GIL is back"
"""

IMPORT = "import time; t = time.perf_counter(); import phugoid; print(time.perf_counter() - t)"
VERSIONS = "from importlib.metadata import version as v; print(v('numpy'), v('scipy'), v('matplotlib'))"


class Failed(Exception):
    """A step that ended with an error, and what it printed."""


@dataclass
class Environment:
    """A virtual environment in a folder, in which no other package and no compiler is found."""

    folder: Path
    python: str

    def __post_init__(self) -> None:
        self.scripts = self.folder / "env" / ("Scripts" if os.name == "nt" else "bin")
        # Found as the user finds it: commands of the environment see no other folders than the system's.
        asked = [self.python, "-c", "import sys; print(sys.executable)"]
        try:
            python = subprocess.run(asked, capture_output=True, text=True, check=True).stdout.strip()
        except (OSError, subprocess.CalledProcessError) as error:
            sys.exit(f"try_wheel: '{self.python}' does not run; give the path of a Python by --python ({error})")
        if Path(python).resolve() == Path(sys.executable).resolve():
            venv.create(self.folder / "env", with_pip=True)
        else:
            self.run(python, "-m", "venv", str(self.folder / "env"))

    def run(self, program: str, *arguments: str) -> str:
        """Return what a program prints: one of the environment by its name, or any by its path."""
        system = [os.environ.get("SYSTEMROOT", "") + r"\System32"] if os.name == "nt" else ["/usr/bin", "/bin"]
        # Nothing of the user's: neither cargo nor a checkout of the package must help.
        own = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "CARGO", "RUST", "VIRTUAL_ENV"))}
        path = os.pathsep.join([str(self.scripts), *system])
        here = self.scripts / (program + (".exe" if os.name == "nt" else ""))
        done = subprocess.run(
            [str(here) if here.exists() else program, *arguments],
            cwd=self.folder,
            env={**own, "PATH": path, "MPLBACKEND": "Agg", "PYTHONUTF8": "1", "PYTHONWARNINGS": "error::SyntaxWarning"},
            capture_output=True,
            text=True,
            encoding="utf-8",
            errors="replace",
        )
        if done.returncode:
            raise Failed(f"{program} {' '.join(arguments)[:200]}\n{done.stdout}{done.stderr}")
        return done.stdout


def requirements(metadata: str, lowest: bool) -> list[str]:
    """Return what a wheel needs without extras, by its metadata: any version that fits, or the lowest one of each.

    >>> requirements("Requires-Dist: numpy>=1.24\\nRequires-Dist: h5py>=3.7 ; extra == 'hdf5'", lowest=True)
    ['numpy==1.24']
    """
    found = [line.strip() for line in re.findall(r"^Requires-Dist:(.*)$", metadata, flags=re.M) if ";" not in line]
    return [r.replace(">=", "==") if lowest else r for r in found]


def metadata(wheel: Path) -> str:
    """Return the metadata in a wheel."""
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (n for n in archive.namelist() if n.endswith(".dist-info/METADATA"))
        return archive.read(name).decode()


def steps(e: Environment) -> float:
    """Use the package from the command line and from Python; return the seconds that its import takes."""
    seconds = min(float(e.run("python", "-c", IMPORT)) for _ in range(3))
    e.run("phugoid", "--version")
    e.run("phugoid", "example", "hfb320")
    e.run("phugoid", "fit", "hfb320.py", "hfb320.csv", "--save", "fit.json", "--report", "fit.html")
    e.run("phugoid", "validate", "fit.json", "hfb320_other.csv")
    e.run("phugoid", "simulate", "hfb320.py", "hfb320_other.csv", "--parameters", "fit.json", "--out", "out.csv")
    for name, least in (("fit.html", 100_000), ("out.csv", 1000)):
        if (e.folder / name).stat().st_size < least:
            raise Failed(f"{name} is too short")
    e.run("python", "-c", DIAGNOSIS)
    e.run("python", "-c", THREADS)
    return seconds


def main() -> int:
    """Try the wheel, and print the row and what failed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("wheel", type=Path)
    parser.add_argument("--versions", choices=("lowest", "newest"), default="newest")
    parser.add_argument("--python", default=sys.executable)
    parser.add_argument("--titles", action="store_true", help="prints the titles of the table's columns first")
    given = parser.parse_args()
    wheel = given.wheel.resolve()
    if given.titles:
        print(f"| {' | '.join(TITLES)} |\n|{'---|' * len(TITLES)}")
    with tempfile.TemporaryDirectory() as folder:
        e, failure = Environment(Path(folder), given.python), ""
        version = e.run("python", "-c", "import platform; print(platform.python_version())").strip()
        facts, seconds = ["", "", ""], ""
        try:
            # A source distribution among what is needed would ask for a compiler.
            needed = requirements(metadata(wheel), given.versions == "lowest")
            e.run("python", "-m", "pip", "install", "--quiet", "--only-binary", ":all:", str(wheel), *needed)
            facts = e.run("python", "-c", VERSIONS).split()
            seconds = f"{steps(e):.3f}"
        except Failed as error:
            failure = str(error)
        size = f"{wheel.stat().st_size / 1e6:.1f}"
        machine = f"{platform.system()} {platform.machine()}"
        tags = "-".join(wheel.stem.split("-")[2:])
        cells = [tags, size, machine, version, *facts, seconds, "failed" if failure else "passed"]
        print(f"| {' | '.join(cells)} |", flush=True)
    if failure:
        print(failure, file=sys.stderr)
    return int(bool(failure))


if __name__ == "__main__":
    sys.exit(main())
