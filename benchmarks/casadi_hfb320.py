"""CasADi with Ipopt and MUMPS, as a peer: the same collocation problem, solved from end to end.

Segments of Legendre-Gauss-Lobatto points, one per sample interval (order 2 is the trapezoid), inputs linear
between samples, the negative log-likelihood with its seven sigmas as variables; collocation-oem.tex, section
'Collocation implementation'.  The model is an SX function mapped over the mesh, the problem is expanded to SX
(CasADi is fastest so) and gives exact derivatives.  The paper's scaling is the robust one; Ipopt's own takes
fewer iterations where it converges, but fails from many of the random starts.  From zero at orders 3 and 4
neither reaches the optimum.

    python benchmarks/casadi_hfb320.py --order 2 --start zero --scaling paper gradient
"""

import argparse
import time

import casadi as ca
import hfb320_case as hfb
import numpy as np
from numpy.polynomial import Legendre, Polynomial

STATE_SCALE = np.array([1e-2, 20.0, 20.0, 30.0])
"""Factors of the states and of their defects in the code behind the paper."""
SIGMA_SCALE = 1 / np.array([0.2, 0.03, 0.002, 0.001, 0.025, 0.03, 0.03])
LOWER = {"V": 2.0, "CD0": 0.0, "sigma_V": 1e-3} | dict.fromkeys(hfb.SIGMAS[1:], 1e-4)


def lobatto(order):
    """Legendre-Gauss-Lobatto nodes on [0, 1]; C[j, k], basis polynomial j integrated from node k to k + 1."""
    inner = Legendre.basis(order - 1).deriv().roots()
    nodes = (np.concatenate([[-1.0], np.sort(inner.real), [1.0]]) + 1) / 2
    weights = np.empty((order, order - 1))
    for j in range(order):
        basis = Polynomial.fromroots(np.delete(nodes, j))
        weights[j] = np.diff((basis / basis(nodes[j])).integ()(nodes))
    return nodes, weights


def collocation(case, order):
    """Mesh (n,) in s, and MX states (4, n), parameters, negative log-likelihood and defects (4, n - 1)."""
    nodes, weights = lobatto(order)
    samples, inner = len(case.t), order - 1
    mesh = np.concatenate([(case.t[:-1, None] + case.step * nodes[:-1]).ravel(), case.t[-1:]])
    inputs = np.array([np.interp(mesh, case.t, u) for u in case.u.T])
    model, cost = _model_functions()
    x, p = ca.MX.sym("x", 4, len(mesh)), ca.MX.sym("p", len(hfb.PARAMETERS))
    f = model.map(len(mesh))(x, ca.DM(inputs), p)

    def at(values, node):
        """Columns of `values` at one node of every segment."""
        return values[:, node : len(mesh) - inner + node : inner]

    defects = []
    for k in range(inner):
        integral = sum(case.step * weights[j, k] * at(f, j) for j in range(order))
        defects.append(at(x, k + 1) - at(x, k) - integral)
    costs = cost.map(samples)(x[:, ::inner], ca.DM(case.u.T), ca.DM(case.z.T), p)
    return mesh, x, p, ca.sum2(costs), ca.horzcat(*defects)


def _model_functions():
    """SX functions f(x, u, p) and cost(x, u, z, p), the negative log-likelihood of one sample."""
    x, u, z, p = ca.SX.sym("x", 4), ca.SX.sym("u", 2), ca.SX.sym("z", 7), ca.SX.sym("p", len(hfb.PARAMETERS))
    named = dict(zip(hfb.PARAMETERS, ca.vertsplit(p), strict=True))
    f = hfb.dynamics(ca.vertsplit(x), ca.vertsplit(u), named, ca)
    g = hfb.outputs(ca.vertsplit(x), ca.vertsplit(u), named, ca)
    sigma = p[-len(hfb.SIGMAS) :]
    cost = ca.sum1(ca.log(sigma)) + 0.5 * ca.sum1(((z - ca.vertcat(*g)) / sigma) ** 2)
    return ca.Function("f", [x, u, p], [ca.vertcat(*f)]), ca.Function("cost", [x, u, z, p], [cost])


def solve(order=2, start="zero", scaling="paper", linear_pivot_order=None, case=None, tol=1e-6):
    """Solve and return a dict of status, iterations, log-likelihood, parameters, and times in seconds.

    `scaling` is 'paper' (the variables and defects multiplied by hand, Ipopt's own scaling off), 'gradient'
    (Ipopt's) or 'none'; `linear_pivot_order` is MUMPS's (0 AMD, 5 METIS, 6 QAMD, 7 its choice).
    """
    case = case or hfb.load_case()
    begin = time.perf_counter()
    mesh, x, p, cost, defects = collocation(case, order)
    by_hand = scaling == "paper"
    state_scale = STATE_SCALE if by_hand else np.ones(4)
    p_scale = np.concatenate([np.ones(15), SIGMA_SCALE if by_hand else np.ones(7)])
    scale = np.concatenate([p_scale, np.tile(state_scale, len(mesh))])

    variables = ca.MX.sym("xi", len(scale))
    physical = variables / scale
    split = [physical[: len(p_scale)], ca.reshape(physical[len(p_scale) :], 4, len(mesh))]
    scaled_defects = ca.vec(ca.diag(state_scale) @ defects)
    scaled_cost, scaled_defects = ca.Function("nlp", [p, x], [cost, scaled_defects])(*split)
    options = {"tol": tol, "print_level": 0, "sb": "yes", "max_iter": 300, "linear_solver": "mumps"}
    options["nlp_scaling_method"] = "gradient-based" if scaling == "gradient" else "none"
    if linear_pivot_order is not None:
        options["mumps_pivot_order"] = linear_pivot_order
    solver = ca.nlpsol(
        "solver", "ipopt", {"x": variables, "f": scaled_cost, "g": scaled_defects},
        {"expand": True, "print_time": False, "ipopt": options},
    )  # fmt: skip
    built = time.perf_counter()

    lower = np.full(len(scale), -np.inf)
    lower[: len(p_scale)] = [LOWER.get(name, -np.inf) for name in hfb.PARAMETERS]
    lower[len(p_scale) :: 4] = LOWER["V"]
    states = np.array([np.interp(mesh, case.t, z) for z in case.z.T[:4]])
    parameters = hfb.start_parameters(start)
    guess = np.concatenate([[parameters[name] for name in hfb.PARAMETERS], states.T.ravel()])
    solution = solver(x0=guess * scale, lbx=lower * scale, lbg=0, ubg=0)
    solved = time.perf_counter()

    stats = solver.stats()
    calls = [stats.get(f"n_call_nlp_{name}", 0) for name in ("f", "grad_f", "g", "jac_g", "hess_l")]
    callbacks = sum(value for name, value in stats.items() if name.startswith("t_wall_nlp"))
    found = dict(zip(hfb.PARAMETERS, (np.array(solution["x"]).ravel() / scale).tolist(), strict=False))
    return {
        "status": stats["return_status"],
        "iterations": stats["iter_count"],
        "evaluations": hfb.counts(*calls),
        "log_likelihood": -float(solution["f"]),
        "parameters": found,
        "largest_error": hfb.largest_error(found),
        "build_seconds": built - begin,
        "solve_seconds": solved - built,
        "callback_seconds": callbacks,
    }


def main():
    """Solve for the chosen orders, starts and scalings, and print one line for each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--order", type=int, nargs="+", default=[2])
    parser.add_argument("--start", nargs="+", default=["zero"], help="zero, optimum, or a seed 0 to 999")
    parser.add_argument("--scaling", nargs="+", default=["paper", "gradient"], help="paper, gradient, none")
    parser.add_argument("--pivot-order", type=int, help="MUMPS's pivot order")
    arguments = parser.parse_args()
    case = hfb.load_case()
    print(f"HFB-320, {case.source}; published logL (order 2) {hfb.LOG_LIKELIHOOD:.6f}")
    for order in arguments.order:
        for start in arguments.start:
            for scaling in arguments.scaling:
                result = solve(order, start, scaling, arguments.pivot_order, case)
                print(
                    f"order {order}  start {start:<8} scaling {scaling:<9} {result['solve_seconds']:7.2f} s "
                    f"(callbacks {result['callback_seconds']:.2f}, build {result['build_seconds']:.2f})  "
                    f"{result['iterations']:4d} iterations  logL {result['log_likelihood']:.6f}  "
                    f"off the published optimum by {100 * result['largest_error']:.2g} %  {result['status']}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
