"""CasADi as a peer for kernels.py: its virtual machine, and the C that it generates.

The point functions are SX expressions, evaluated once per mesh point through `map(..., 'serial')`; an MX
function around them combines the points into the trapezoid's defects, Jacobian and Hessian.  Both peers
evaluate these same MX functions, with no numpy in between, into preallocated buffers.
"""

import os
import subprocess
import tempfile
from pathlib import Path

import casadi as ca
import hfb320_case as hfb
import numpy as np

N_P = len(hfb.PARAMETERS)


def _nonzeros(matrix):
    return ca.vertcat(*matrix.nonzeros())


def _point_functions():
    """SX functions of a point, and the places of what they return.

    Functions: f; f, f_x, f_p; Hessian of factor * cost + weight' f.  I is stored with the pattern of f_x.
    Places: (rows, columns) of f_x, f_p, the Hessian's rows of the states, its rows of the parameters.
    """
    x, u, z = ca.SX.sym("x", 4), ca.SX.sym("u", 2), ca.SX.sym("z", 7)
    p, weight, factor = ca.SX.sym("p", N_P), ca.SX.sym("weight", 4), ca.SX.sym("factor")
    named = dict(zip(hfb.PARAMETERS, ca.vertsplit(p), strict=True))
    f = ca.vertcat(*hfb.dynamics(ca.vertsplit(x), ca.vertsplit(u), named, ca))
    g = ca.vertcat(*hfb.outputs(ca.vertsplit(x), ca.vertsplit(u), named, ca))
    sigma = p[-len(hfb.SIGMAS) :]
    cost = ca.sum1(ca.log(sigma)) + 0.5 * ca.sum1(((z - g) / sigma) ** 2)

    pattern = ca.jacobian(f, x).sparsity() + ca.Sparsity.diag(4)
    hessian = ca.tril(ca.hessian(factor * cost + ca.dot(weight, f), ca.vertcat(p, x))[0])
    jacobians = [ca.project(ca.jacobian(f, x), pattern), ca.jacobian(f, p)]
    hessians = [hessian[N_P:, :], hessian[:N_P, :N_P]]
    options = {"cse": True}
    functions = (
        ca.Function("point_f", [x, p, u], [f], options),
        ca.Function("point_jacobian", [x, p, u], [f, *map(_nonzeros, jacobians)], options),
        ca.Function("point_hessian", [x, p, u, z, weight, factor], [*map(_nonzeros, hessians)], options),
    )
    places = [np.array(part.sparsity().get_triplet()) for part in jacobians + hessians]
    return *functions, _nonzeros(ca.project(ca.DM.eye(4), pattern)), places


def nlp_functions(n, step):
    """MX functions: defects, defects and Jacobian, Hessian of the trapezoid on `n` points, `step` s apart."""
    point_f, point_jacobian, point_hessian, unit, _ = _point_functions()
    x, u, z = ca.MX.sym("x", 4, n), ca.MX.sym("u", 2, n), ca.MX.sym("z", 7, n)
    p, multipliers, factor = ca.MX.sym("p", N_P), ca.MX.sym("multipliers", 4, n - 1), ca.MX.sym("factor")

    def defects(f):
        return x[:, 1:] - x[:, :-1] - (step / 2) * (f[:, 1:] + f[:, :-1])

    # map(name, how, n, inputs that all points share, outputs that are summed over the points)
    f = point_f.map("map_f", "serial", n, [1], [])(x, p, u)
    f_too, f_x, f_p = point_jacobian.map("map_jacobian", "serial", n, [1], [])(x, p, u)
    f_x *= -step / 2
    identity = ca.repmat(ca.MX(unit), 1, n - 1)
    jacobian = [f_x[:, :-1] - identity, f_x[:, 1:] + identity, (-step / 2) * (f_p[:, 1:] + f_p[:, :-1])]
    zero = ca.DM.zeros(4, 1)
    weights = (-step / 2) * (ca.horzcat(multipliers, zero) + ca.horzcat(zero, multipliers))
    hessian = point_hessian.map("map_hessian", "serial", n, [1, 5], [1])(x, p, u, z, weights, factor)
    return (
        ca.Function("defects", [x, p, u], [defects(f)]),
        ca.Function("defects_and_jacobian", [x, p, u], [defects(f_too), *jacobian]),
        ca.Function("lagrangian_hessian", [x, p, u, z, multipliers, factor], list(hessian)),
    )


def places(n):
    """Rows and columns of the entries of the Jacobian and of the Hessian, in the order returned."""
    *_, (f_x, f_p, of_states, of_parameters) = _point_functions()
    points = np.arange(n)[:, None]
    segments, first_state = points[:-1], N_P
    rows = 4 * segments + f_x[0]
    left = (rows, first_state + 4 * segments + f_x[1])
    right = (rows, left[1] + 4)
    shared = (4 * segments + f_p[0], f_p[1] + 0 * segments)
    row, column = of_states
    own = (first_state + 4 * points + row, column + 4 * points * (column >= N_P))
    return _joined(left, right, shared), _joined(own, of_parameters)


def _joined(*parts):
    """One pair of rows and columns from several."""
    return tuple(np.concatenate([part[i].ravel() for part in parts]) for i in (0, 1))


def compiled(functions, flags=("-O3", "-march=native")):
    """The same functions from generated C, compiled with `flags` by $CC (cc where unset)."""
    with tempfile.TemporaryDirectory() as folder:
        generator = ca.CodeGenerator("kernels.c")
        for function in functions:
            generator.add(function)
        source = Path(folder, generator.generate(folder + os.sep)).resolve()
        library = source.with_suffix(".so")
        compiler = [os.environ.get("CC", "cc"), *flags, "-shared", "-fPIC"]
        subprocess.run([*compiler, "-o", str(library), str(source), "-lm"], check=True)
        return [ca.external(function.name(), str(library)) for function in functions]


def bind(function, arguments):
    """A callable without arguments that evaluates `function` into preallocated arrays and returns them."""
    buffer, evaluate = function.buffer()
    inputs = [np.ascontiguousarray(argument, dtype=float).ravel() for argument in arguments]
    results = [np.zeros(function.nnz_out(i)) for i in range(function.n_out())]
    for i, values in enumerate(inputs):
        buffer.set_arg(i, memoryview(values))
    for i, values in enumerate(results):
        buffer.set_res(i, memoryview(values))

    def call(_keep_alive=(buffer, inputs)):
        evaluate()
        return results

    return call
