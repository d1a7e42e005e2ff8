"""Ours for kernels.py: the callbacks of the order-2 collocation problem, as a solver calls them from Python.

Each call goes through the Python binding, releases the interpreter lock, and allocates and returns a new
numpy array; CasADi's write into arrays allocated before.  The decision variables hold 1/sigma where CasADi's
hold sigma, so the entries of the Hessian that belong to the noise differ; there are as many of them.  An
entry of the Hessian to which both the dynamics and the outputs contribute is returned in two parts.
"""

import hfb320_case as hfb
import numpy as np
from phugoid_model import experiment, model

import phugoid as ph

N_MODEL = len(hfb.DERIVATIVES + hfb.BIASES)
TAPES = ("f", "first derivatives of f", "Hessian of f", "log-likelihood", "its gradient", "its Hessian")


class Callbacks:
    """The problem on the points of `mesh`, with its callbacks bound to where they are evaluated."""

    def __init__(self, mesh, threads):
        record = experiment(mesh.step * np.arange(len(mesh.x)), mesh.u, mesh.z)
        m = model()
        start = {name: hfb.OPTIMUM[name] for name in hfb.SIGMAS}
        noise = m.noise_model.resolve(m.output_names, dict.fromkeys(m.output_names, np.inf), start)
        self.problem = ph.Collocation(order=2, threads=threads).problem(m, [record], noise)
        self.xi = mesh.xi
        self.xi[N_MODEL : len(hfb.PARAMETERS)] **= -1
        self.multipliers = mesh.multipliers.ravel()

    def kinds(self):
        """The three callables that are compared with the peers'."""
        p, xi = self.problem, self.xi
        return [
            lambda: [p.constraints(xi)],
            lambda: [p.constraints(xi), p.jacobian(xi)],
            lambda: [p.hessian(xi, 1.0, self.multipliers)],
        ]

    def apart(self):
        """Name -> callable, for every callback."""
        p, xi = self.problem, self.xi
        return {
            "objective": lambda: p.objective(xi),
            "gradient": lambda: p.gradient(xi),
            "constraints": lambda: p.constraints(xi),
            "Jacobian": lambda: p.jacobian(xi),
            "Hessian": lambda: p.hessian(xi, 1.0, self.multipliers),
            "Gauss-Newton Hessian": lambda: p.gauss_newton(xi, 1.0),
        }

    def places(self):
        """Rows and columns of the entries of the Jacobian, and of the Hessian's lower triangle."""
        return self.problem.jacobian_structure(), self.problem.hessian_structure()

    def instructions(self):
        """Tape -> number of instructions on lanes, which no machine changes."""
        return dict(zip(TAPES, self.problem.instructions(), strict=True))
