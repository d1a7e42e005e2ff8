"""Who takes part in kernels.py, and at which values: each peer is a function of a Mesh."""

from dataclasses import dataclass
from functools import cache

import hfb320_case as hfb
import numpy as np

KINDS = ("defects", "defects and Jacobian", "Hessian")
C, VM = "CasADi, generated C -O3", "CasADi, virtual machine"
OURS = {threads: f"phugoid, {threads} thread" + "s" * (threads > 1) for threads in (1, 2)}
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
    # Of the size that they have at the optimum, or the dynamics would hardly show in the Hessian.
    sigma = [hfb.OPTIMUM[f"sigma_{state}"] for state in hfb.STATES]
    multipliers = np.random.default_rng(0).standard_normal((n - 1, 4)) / sigma
    p = np.array(list(hfb.OPTIMUM.values()))
    return Mesh(z[:, :4].copy(), np.ascontiguousarray(case.u[index]), z, p, multipliers, case.step)


@cache
def _casadi_functions(n, step):
    from casadi_kernels import nlp_functions

    return nlp_functions(n, step)


@cache
def _compiled(n, step, flags):
    from casadi_kernels import compiled

    return compiled(_casadi_functions(n, step), flags)


def casadi_kernels(mesh, flags=None):
    """CasADi's three callbacks, by its virtual machine or from C compiled with `flags`, and their places."""
    from casadi_kernels import bind, places

    n = len(mesh.x)
    functions = _compiled(n, mesh.step, flags) if flags else _casadi_functions(n, mesh.step)
    arguments = [mesh.x, mesh.p, mesh.u, mesh.z, mesh.multipliers, 1.0]
    return [bind(function, arguments[: function.n_in()]) for function in functions], places(n)


def opty_kernels(mesh):
    """opty's two callbacks (midpoint rule: other values, so no places)."""
    from opty_kernels import constraint_functions

    return [*constraint_functions(mesh), None], None


@cache
def ours(n, threads):
    from phugoid_kernels import Callbacks

    return Callbacks(make_mesh(n), threads)


def phugoid_kernels(mesh, threads):
    """Our three callbacks, and their places."""
    callbacks = ours(len(mesh.x), threads)
    return callbacks.kinds(), callbacks.places()


PEERS = {
    VM: casadi_kernels,
    C: lambda mesh: casadi_kernels(mesh, ("-O3",)),
    C + " -march=native": lambda mesh: casadi_kernels(mesh, ("-O3", "-march=native")),
    OPTY: opty_kernels,
    OURS[1]: lambda mesh: phugoid_kernels(mesh, 1),
    OURS[2]: lambda mesh: phugoid_kernels(mesh, 2),
}
"""Name -> function of a Mesh that returns callables without arguments, in the order of KINDS, each of which
evaluates and returns a list of arrays (None where the peer has no such callback); and the places of their
entries."""
