"""A stall that is nonlinear in its parameters, for random starts beside HFB-320, which is linear in its own.

Longitudinal motion of a light aircraft with Kirchhoff's flow separation: states (V, alpha, theta, q), inputs
(elevator, thrust), six outputs, twelve parameters. The point X up to which the flow over the wing is attached
goes from 1 to 0 around alpha_star, the faster the greater a1; lift falls, drag and pitching moment change with it.
Nonlinear are a1 and alpha_star (in the exponential), e (in the denominator of induced drag), CL0 and CLa (squared in
it). The record is simulated: two stalls and a 3-2-1-1.

    python benchmarks/nonlinear_case.py --starts 30

The equations are written once, for any library with `sin`, `cos`, `exp` and `sqrt`.
"""

import argparse
import functools
import time

import numpy as np

STATES = ("V", "alpha", "theta", "q")
INPUTS = ("de", "T")
OUTPUTS = ("V", "alpha", "theta", "q", "ax", "az")
UNITS = {"V": "m/s", "alpha": "rad", "theta": "rad", "q": "rad/s", "ax": "m/s²", "az": "m/s²", "de": "rad", "T": "N"}

TRUTH = {
    "CL0": 0.25, "CLa": 4.8, "a1": 20.0, "alpha_star": 0.28,
    "CD0": 0.035, "e": 0.75, "CDX": 0.15,
    "Cm0": 0.08, "Cma": -0.7, "Cmq": -14.0, "Cmde": -1.3, "CmX": -0.08,
}  # fmt: skip

RANGES = {
    "CL0": (-0.5, 1.5), "CLa": (0.5, 10), "a1": (3, 60), "alpha_star": (0.1, 0.6),
    "CD0": (0, 0.3), "e": (0.2, 2), "CDX": (-0.3, 1),
    "Cm0": (-0.5, 0.5), "Cma": (-4, 2), "Cmq": (-60, 10), "Cmde": (-5, 1), "CmX": (-0.5, 0.5),
}  # fmt: skip
"""Where random starts lie."""

BOUNDS = {"a1": (1, 200), "alpha_star": (0.02, 1.2), "e": (0.05, 5)}
"""What is physically sensible of the parameters that are not linear; used where asked for."""

SIGMA = {"V": 0.3, "alpha": 0.004, "theta": 0.003, "q": 0.004, "ax": 0.1, "az": 0.3}
"""Noise of the record."""

G0, RHO, MASS, AREA, CHORD, INERTIA, ASPECT = 9.80665, 1.1, 1100.0, 16.0, 1.5, 1800.0, 7.5
STEP, SAMPLES = 0.05, 1201
CLOSE = 0.01
"""A start succeeds where it ends within this of the optimum's log-likelihood."""


def coefficients(x, u, p, lib=np):
    """CL, CD, Cm at states `x`, inputs `u` and a mapping `p` of parameters."""
    speed, alpha, _, q = x
    # X = (1 - tanh z)/2 = 1/(1 + exp 2z): in this form its root stays smooth where X is zero to rounding.
    root = 1 / lib.sqrt(1 + lib.exp(2 * p["a1"] * (alpha - p["alpha_star"])))
    separated = 1 - root * root
    lift = p["CL0"] + p["CLa"] * ((1 + root) / 2) ** 2 * alpha
    drag = p["CD0"] + lift * lift / (np.pi * ASPECT * p["e"]) + p["CDX"] * separated
    pitch = p["Cm0"] + p["Cma"] * alpha + p["Cmq"] * q * CHORD / (2 * speed) + p["Cmde"] * u[0] + p["CmX"] * separated
    return lift, drag, pitch


def dynamics(x, u, p, lib=np):
    """Right-hand side f(x, u, theta): a list of four derivatives."""
    speed, alpha, theta, q = x
    lift, drag, pitch = coefficients(x, u, p, lib)
    force = 0.5 * RHO * AREA * speed * speed
    gamma = theta - alpha
    return [
        (u[1] * lib.cos(alpha) - force * drag) / MASS - G0 * lib.sin(gamma),
        q - (force * lift + u[1] * lib.sin(alpha)) / (MASS * speed) + G0 * lib.cos(gamma) / speed,
        q,
        force * CHORD / INERTIA * pitch,
    ]


def outputs(x, u, p, lib=np):
    """Outputs g(x, u, theta): a list of six, in the order of OUTPUTS."""
    lift, drag, _ = coefficients(x, u, p, lib)
    specific = 0.5 * RHO * AREA / MASS * x[0] * x[0]
    sin_alpha, cos_alpha = lib.sin(x[1]), lib.cos(x[1])
    return [
        *x,
        specific * (lift * sin_alpha - drag * cos_alpha) + u[1] / MASS,
        -specific * (lift * cos_alpha + drag * sin_alpha),
    ]


def model(bounded=False):
    """The case as phugoid takes it, with BOUNDS if `bounded`; parameters start in the middle of RANGES."""
    import phugoid as ph

    m = ph.Model("stall of a light aircraft")
    x = m.states(**{name: UNITS[name] for name in STATES})
    u = m.inputs(**{name: UNITS[name] for name in INPUTS})
    limits = BOUNDS if bounded else {}
    declared = {
        name: ph.Parameter(0.5 * (low + high), bounds=limits.get(name, (-np.inf, np.inf)))
        for name, (low, high) in RANGES.items()
    }
    p = dict(zip(declared, m.parameters(**declared), strict=True))
    m.dynamics(**dict(zip(STATES, dynamics(x, u, p), strict=True)))
    m.outputs(**{name: (y, UNITS[name]) for name, y in zip(OUTPUTS, outputs(x, u, p), strict=True)})
    return m


@functools.cache
def record():
    """Times (N,), inputs (2, N) and true states (4, N): a pilot follows pitch angles, into the stall and out.

    He sees the aircraft at the samples and moves the elevator linearly to the next: as a fit assumes, so that the
    integration over each interval, to 11 digits, is the record that the true model gives.
    """
    from scipy.integrate import solve_ivp

    t = STEP * np.arange(SAMPLES)
    knots = [0, 4, 18, 26, 27, 30, 35, 41, 46, 54, 55, 58, 60]
    wanted = np.interp(t, knots, [0.08, 0.08, 0.32, 0.36, -0.2, -0.2, 0.08, 0.08, 0.4, 0.45, -0.2, -0.1, 0])
    stir = np.zeros(SAMPLES)
    pulses = ((23, 23.5, 1), (23.5, 24, -1), (36, 37.2, 1), (37.2, 38, -1), (38, 38.4, 1), (38.4, 38.8, -1))
    for begin, end, sign in pulses:
        stir[(t >= begin) & (t < end)] = 0.06 * sign
    u = np.array([np.zeros(SAMPLES), np.interp(t, [0, 4, 5, 27, 29, 41, 42], [1000, 1000, 300, 300, 1500, 1500, 300])])
    x = np.empty((4, SAMPLES))
    x[:, 0] = 45.0, 0.075, 0.075, 0.0
    u[0, 0] = 0.02
    for k in range(SAMPLES - 1):
        u[0, k + 1] = 0.06 - 0.4 * x[1, k] + 0.6 * (x[2, k] - wanted[k]) + 0.3 * x[3, k] + stir[k]

        def slope(now, state, k=k):
            share = (now - t[k]) / STEP
            return dynamics(state, (1 - share) * u[:, k] + share * u[:, k + 1], TRUTH)

        x[:, k + 1] = solve_ivp(slope, t[k : k + 2], x[:, k], "DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    return t, u, x


def experiment(seed=0):
    """The record with noise, as phugoid takes it."""
    import phugoid as ph

    t, u, x = record()
    rng = np.random.default_rng(seed)
    clean = dict(zip(OUTPUTS, outputs(x, u, TRUTH), strict=True))
    measured = {name: y + SIGMA[name] * rng.standard_normal(t.size) for name, y in clean.items()}
    return ph.Experiment(t, dict(zip(INPUTS, u, strict=True)), measured, name=f"stall, seed {seed}")


def random_start(number):
    """Random start `number`: uniform in RANGES; sigmas and states start as the estimation has them."""
    random = np.random.RandomState(number)
    return {name: random.uniform(*limits) for name, limits in RANGES.items()}


def measure(starts, seed=0, solver=None, bounded=False):
    """From each random start: (number, status, iterations, seconds, log-likelihood below the optimum)."""
    import phugoid as ph

    m, data = model(bounded), experiment(seed)
    options = {"solver": solver} if solver else {}
    best = ph.estimate(m, data, start=TRUTH, **options)
    rows = []
    for number in range(starts):
        begin = time.perf_counter()
        try:
            fit = ph.estimate(m, data, start=random_start(number), **options)
            status, iterations, reached = fit.status, fit.iterations, fit.log_likelihood
        except ph.EvaluationError:  # the equations are not finite at this start
            status, iterations, reached = "no start", 0, float("-inf")
        rows.append((number, status, iterations, time.perf_counter() - begin, best.log_likelihood - reached))
    return best, rows


def main():
    """Estimates from the truth, then from random starts, and counts how many reach the same optimum."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--starts", type=int, default=30, help="how many random starts")
    parser.add_argument("--seed", type=int, default=0, help="of the noise")
    parser.add_argument("--bounded", action="store_true", help="with bounds of a1, alpha_star and e")
    arguments = parser.parse_args()
    best, rows = measure(arguments.starts, arguments.seed, bounded=arguments.bounded)
    print(best.summary(), "\n")
    for name, truth in TRUTH.items():
        found = best.parameters[name]
        print(f"{name:12s} {(found.value - truth) / found.std_error:6.2f} standard errors from the truth {truth:g}")
    print("\nstart  status            iterations  seconds  below the optimum")
    for number, status, iterations, seconds, below in rows:
        print(f"{number:5d}  {status:16s}  {iterations:10d}  {seconds:7.2f}  {below:17.4g}")
    good = [row for row in rows if row[1] == "converged" and abs(row[4]) < CLOSE]
    print(f"\n{len(good)} of {len(rows)} random starts converge to the optimum near the truth", end="")
    print(f", in {np.median([row[2] for row in good]):g} iterations (median)" if good else "")


if __name__ == "__main__":
    main()
