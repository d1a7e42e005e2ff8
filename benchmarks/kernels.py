"""Time per mesh point of the NLP callbacks on HFB-320, for us and for peers, in one process on one machine.

What is evaluated, for the trapezoid (LGL order 2) on N points, 4 states, the paper's 22 parameters:

* defects: all 4 (N - 1) of them;
* with Jacobian: the defects and every nonzero of their Jacobian, 35 per segment (12 and 12 for the states at
  its two ends, 11 for the parameters);
* Hessian: every nonzero of the lower triangle of the Hessian of the Lagrangian, objective included (the
  negative log-likelihood with its sigmas as variables): per point 9 among states and 46 between states and
  parameters, and 85 among parameters, which are sums over the points.

Every peer starts from the decision variables and the multipliers and writes into arrays allocated before,
where it allows that (CasADi does; opty allocates some).  Peers take turns, each long enough to be warm; times
are medians over the rounds, divided by N.  The sums of squares of what the peers return are compared, so that
one that computes something else is seen.

    python benchmarks/kernels.py [--points 601 100000] [--only casadi]
"""

import argparse
import time
from dataclasses import dataclass
from functools import cache

import hfb320_case as hfb
import numpy as np

KINDS = ("defects", "with Jacobian", "Hessian")
C, VM = "CasADi, generated C -O3 -march=native", "CasADi, virtual machine"
OPTY = "opty, Cython (midpoint rule)"


@dataclass(frozen=True)
class Mesh:
    """Where the callbacks are evaluated: arrays over N points, the parameters and the multipliers."""

    x: np.ndarray
    u: np.ndarray
    z: np.ndarray
    p: np.ndarray
    multipliers: np.ndarray
    step: float

    @property
    def xi(self):
        """Decision vector: the 22 parameters in the order of PARAMETERS, then the states point by point."""
        return np.concatenate([self.p, self.x.ravel()])


def make_mesh(n):
    """The record of the case, repeated until there are `n` points; parameters at the published optimum."""
    case = hfb.load_case()
    index = np.arange(n) % len(case.t)
    z = np.ascontiguousarray(case.z[index])
    multipliers = np.random.default_rng(0).standard_normal((n - 1, 4))
    p = np.array(list(hfb.OPTIMUM.values()))
    return Mesh(z[:, :4].copy(), np.ascontiguousarray(case.u[index]), z, p, multipliers, case.step)


@cache
def _casadi_functions(n, step):
    from casadi_kernels import nlp_functions

    return nlp_functions(n, step)


def casadi_kernels(mesh, flags=None):
    """CasADi's three callbacks: by its virtual machine, or from C compiled with `flags`."""
    from casadi_kernels import bind, compiled

    functions = _casadi_functions(len(mesh.x), mesh.step)
    arguments = [mesh.x, mesh.p, mesh.u, mesh.z, mesh.multipliers, 1.0]
    functions = compiled(functions, flags) if flags else functions
    return [bind(function, arguments[: function.n_in()]) for function in functions]


def opty_kernels(mesh):
    """opty's two callbacks (midpoint rule)."""
    from opty_kernels import constraint_functions

    return [*constraint_functions(mesh), None]


PEERS = {
    VM: casadi_kernels,
    C: lambda mesh: casadi_kernels(mesh, ("-O3", "-march=native")),
    "CasADi, generated C -O3": lambda mesh: casadi_kernels(mesh, ("-O3",)),
    OPTY: opty_kernels,
}
"""Name -> function of a Mesh that returns callables without arguments, in the order of KINDS, each of which
evaluates and returns a list of arrays; None where the peer has no such callback.  Ours are added here."""


def prepare(mesh, only=""):
    """{(peer, kind): callable}; prints which peers are skipped and whose values differ from the first's."""
    callables, squares = {}, {}
    for name, factory in PEERS.items():
        if only.lower() not in name.lower():
            continue
        try:
            callbacks = factory(mesh)
        except Exception as error:  # a benchmark without one of its peers is still one
            print(f"skipped {name}: {type(error).__name__}: {error}")
            continue
        for kind, callback in zip(KINDS, callbacks, strict=True):
            if callback is None:
                continue
            callables[name, kind] = callback
            square = sum(float(np.vdot(values, values)) for values in callback())
            if name != OPTY and not np.isclose(square, squares.setdefault(kind, square), rtol=1e-9):
                print(f"{name}: {kind}: sum of squares {square:.12g}, first peer's {squares[kind]:.12g}")
    return callables


def measure(callables, rounds=9, target=0.05):
    """{key: seconds per call}: medians over rounds in each of which every callable fills about `target` s."""
    times = {key: [] for key in callables}
    calls = dict.fromkeys(callables, 1)
    for _ in range(rounds + 1):
        for key, callback in callables.items():
            begin = time.perf_counter()
            for _ in range(calls[key]):
                callback()
            times[key].append((time.perf_counter() - begin) / calls[key])
            calls[key] = max(1, int(target / times[key][-1]))
    return {key: float(np.median(values[1:])) for key, values in times.items()}


def show(seconds, n):
    """Print ns per point, and how many times faster than CasADi's C and its virtual machine."""
    print(f"\nHFB-320, trapezoid, N = {n:,}: ns per mesh point (times faster than CasADi's C, its VM)")
    print(f"{'':<40}" + "".join(f"{kind:>24}" for kind in KINDS))
    for name in dict.fromkeys(peer for peer, _ in seconds):
        cells = []
        for kind in KINDS:
            mine = seconds.get((name, kind))
            bases = [seconds[base, kind] for base in (C, VM) if mine and (base, kind) in seconds]
            ratios = ", ".join(f"{base / mine:.2f}" for base in bases)
            cells.append(f"{1e9 * mine / n:8.1f}  ({ratios})" if mine else "-")
        print(f"{name:<40}" + "".join(f"{cell:>24}" for cell in cells))


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, nargs="+", default=[601, 100_000])
    parser.add_argument("--only", default="", help="only the peers whose name contains this")
    arguments = parser.parse_args()
    for n in arguments.points:
        show(measure(prepare(make_mesh(n), arguments.only)), n)


if __name__ == "__main__":
    main()
