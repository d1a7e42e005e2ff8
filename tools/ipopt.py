"""Install cyipopt, and Ipopt with it, for the Python that runs this script.

cyipopt is published as source only and must be compiled against an Ipopt that is already there. Two ways:

1. The CasADi wheel carries a recent Ipopt, with MUMPS and METIS, and its headers. cyipopt is built against
   that copy and finds it at run time relative to itself. It takes a C compiler, and no administrator.
2. Ipopt from the system, as pkg-config reports it, which is older. On Debian, as root, its packages are
   installed first.

A small problem is solved before this script is content, and nothing is done where that works already.
"""

import importlib.util
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Callable
from pathlib import Path

CASADI = "casadi>=3.7,<4"
CYIPOPT = "cyipopt>=1.4"
COMPILER_PACKAGES = ["gcc", "libc6-dev", "python3-dev"]
IPOPT_PACKAGES = ["coinor-libipopt-dev", "gfortran", "liblapack-dev", "libblas-dev", "pkg-config"]

# Problem 71 of Hock and Schittkowski. METIS (5) orders the linear systems, where it is built in.
TRIAL = """
import numpy as np, cyipopt
class Problem71:
    def objective(self, x): return x[0] * x[3] * (x[0] + x[1] + x[2]) + x[2]
    def gradient(self, x):
        s = x[0] + x[1] + x[2]
        return np.array([x[3] * (s + x[0]), x[0] * x[3], x[0] * x[3] + 1, x[0] * s])
    def constraints(self, x): return np.array([x.prod(), x @ x])
    def jacobian(self, x): return np.concatenate([x.prod() / x, 2 * x])
bounds = dict(lb=[1] * 4, ub=[5] * 4, cl=[25, 40], cu=[1e20, 40])
problem = cyipopt.Problem(n=4, m=2, problem_obj=Problem71(), **bounds)
options = dict(hessian_approximation="limited-memory", mumps_pivot_order=5, print_level=0, sb="yes")
for name, value in options.items():
    problem.add_option(name, value)
x, info = problem.solve(np.array([1.0, 5.0, 5.0, 1.0]))
assert info["status"] == 0 and abs(info["obj_val"] - 17.0140173) < 1e-6, info
print("cyipopt", cyipopt.__version__, "with Ipopt", ".".join(map(str, cyipopt.IPOPT_VERSION)), "works")
"""


def pip(*arguments: str, env: dict[str, str] | None = None) -> None:
    subprocess.run([sys.executable, "-m", "pip", "install", "--quiet", *arguments], check=True, env=env)


def install_cyipopt(**env: str) -> None:
    # Uncached: a wheel is only good beside the Ipopt that it was linked with.
    options = ["--no-cache-dir", "--force-reinstall", "--no-deps"]
    pip(*options, CYIPOPT, env=os.environ | env)


def apt_install(packages: list[str]) -> None:
    if not shutil.which("apt-get") or os.geteuid() != 0:
        raise RuntimeError(f"please install these packages, or their like: {' '.join(packages)}")
    env = os.environ | {"DEBIAN_FRONTEND": "noninteractive"}
    subprocess.run(["apt-get", "update", "-qq"], check=True, env=env)
    subprocess.run(["apt-get", "install", "-qq", "-y", "--no-install-recommends", *packages], check=True, env=env)


def works() -> bool:
    if importlib.util.find_spec("cyipopt") is None:
        return False
    return subprocess.run([sys.executable, "-W", "ignore", "-c", TRIAL]).returncode == 0


def need_compiler() -> None:
    header = Path(sysconfig.get_path("include"), "Python.h")
    if not shutil.which("cc") or not header.exists():
        apt_install(COMPILER_PACKAGES)


def from_casadi_wheel() -> None:
    pip(CASADI)
    importlib.invalidate_caches()
    casadi = Path(importlib.util.find_spec("casadi").origin).parent
    if not (casadi / "libipopt.so").exists():
        raise RuntimeError("this CasADi wheel carries no Ipopt")
    with tempfile.TemporaryDirectory() as folder:
        # cyipopt asks pkg-config. This stand-in answers, so that none need be installed; the link keeps
        # blanks in the path of the environment out of the answer.
        link = Path(folder, "ipopt")
        link.symlink_to(casadi)
        answer = Path(folder, "pkg-config")
        answer.write_text(f"#!/bin/sh\necho -I{link}/include/coin-or -L{link} -lipopt\n")
        answer.chmod(0o755)
        path = f"{folder}{os.pathsep}{os.environ['PATH']}"
        install_cyipopt(PATH=path, LDFLAGS="-Wl,-rpath,$ORIGIN/../casadi")


def from_system() -> None:
    if not shutil.which("pkg-config") or subprocess.run(["pkg-config", "--exists", "ipopt"]).returncode != 0:
        apt_install(IPOPT_PACKAGES)
    install_cyipopt()


def attempt(way: Callable[[], None]) -> bool:
    try:
        need_compiler()
        way()
    except (RuntimeError, OSError, subprocess.CalledProcessError) as error:
        print(f"tools/ipopt.py: {way.__name__.replace('_', ' ')}: {error}", file=sys.stderr)
        return False
    return works()


def main() -> int:
    if works() or attempt(from_casadi_wheel) or attempt(from_system):
        return 0
    print("tools/ipopt.py: no cyipopt; all but `phugoid.Ipopt` works without it", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
