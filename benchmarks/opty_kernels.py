"""opty as a peer for kernels.py: the Cython that it generates for its constraints and their Jacobian.

opty has no trapezoid; its 'midpoint' rule also costs one evaluation of f per segment, so the times compare
but the values do not.  Its Jacobian holds the structural zeros of each 4 x (8 + 11) block too.  There is no
Hessian.
"""

import sys
import types

import hfb320_case as hfb
import numpy as np


def _import_collocator():
    """opty's ConstraintCollocator; only its Problem class needs cyipopt, so go on where it is missing."""
    try:
        import cyipopt  # noqa: F401
    except ImportError:
        sys.modules["cyipopt"] = types.SimpleNamespace(Problem=object)
    from opty.direct_collocation import ConstraintCollocator

    return ConstraintCollocator


def constraint_functions(mesh):
    """Callables without arguments (constraints, constraints and Jacobian) at the values of `mesh`."""
    collocator_class = _import_collocator()
    import sympy

    t = sympy.Symbol("t")
    states = [sympy.Function(name)(t) for name in hfb.STATES]
    inputs = [sympy.Function(name)(t) for name in hfb.INPUTS]
    parameters = dict(zip(hfb.DERIVATIVES, sympy.symbols(hfb.DERIVATIVES), strict=True))
    rates = hfb.dynamics(states, inputs, parameters, sympy)
    collocator = collocator_class(
        sympy.Matrix([state.diff(t) - rate for state, rate in zip(states, rates, strict=True)]),
        states,
        len(mesh.x),
        mesh.step,
        known_trajectory_map={symbol: mesh.u[:, i].copy() for i, symbol in enumerate(inputs)},
        time_symbol=t,
        integration_method="midpoint",
    )
    names = [str(symbol) for symbol in collocator.unknown_parameters]
    free = np.concatenate([mesh.x.T.ravel(), [hfb.OPTIMUM[name] for name in names]])
    constraints, jacobian = collocator.generate_constraint_function(), collocator.generate_jacobian_function()
    return lambda: [constraints(free)], lambda: [constraints(free), jacobian(free)]
