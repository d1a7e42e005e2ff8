"""The HFB-320 Hansa Jet case shared by all benchmarks: data, model, published optimum, starting values.

The model is the longitudinal motion of collocation-oem.tex, section 'HFB-320': states (V, alpha, theta, q),
inputs (elevator, thrust), seven outputs, 22 parameters.  One thing differs from the paper's text and follows
the code behind its published numbers (github.com/dimasad/aviation-2019-code): the pitch rate is made
dimensionless with V_ref, not V.

The equations are written once, for any library with `sin` and `cos`: numpy, math, casadi, sympy.
"""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

STATES = ("V", "alpha", "theta", "q")
INPUTS = ("de", "T")
OUTPUTS = ("V", "alpha", "theta", "q", "aq", "ax", "az")

OPTIMUM = {
    "CD0": 0.05802198227121576, "CDV": -0.031609345096558036, "CDa": 0.2453480135927723,
    "CL0": 0.18081496655016374, "CLV": 0.20117806265996505, "CLa": 3.090429255239013,
    "Cm0": 0.11836017813192333, "CmV": 0.013661249826858497, "Cma": -0.9940542701262957,
    "Cmq": -28.651655181649204, "Cmde": -1.471386926974763,
    "b_q": -0.00010091594526686652, "b_aq": -4.9217064663231145e-06,
    "b_ax": -0.12084522355941345, "b_az": -0.010969637096449545,
    "sigma_V": 0.8685280159552249, "sigma_alpha": 0.0022700468575119655,
    "sigma_theta": 0.002042851155865991, "sigma_q": 0.002463907639197214,
    "sigma_aq": 0.007884887575017764, "sigma_ax": 0.024723104791353933, "sigma_az": 0.20590254560216117,
}  # fmt: skip
"""Published optimum for the trapezoid on the flight data, mesh = sample times."""

LOG_LIKELIHOOD = 15055.952975804
"""At that optimum, without the constant -N n_y ln(2 pi)/2."""

PARAMETERS = tuple(OPTIMUM)
DERIVATIVES, BIASES, SIGMAS = PARAMETERS[:11], PARAMETERS[11:15], PARAMETERS[15:]

START_RANGES = {
    "CD0": (0, 0.5), "CDV": (-0.5, 0.5), "CDa": (0, 1), "CL0": (0, 2), "CLV": (-2, 2), "CLa": (0, 10),
    "Cm0": (0, 0.5), "CmV": (0, 0.5), "Cma": (-5, 1), "Cmq": (-50, 0), "Cmde": (-10, 0),
}  # fmt: skip

G0, S_OVER_M, S_CBAR_OVER_IY, THRUST_MOMENT = 9.80665, 4.028e-3, 8.0027e-4, -7.0153e-6
V_REF, MASS, THRUST_ANGLE, RHO, HALF_CBAR = 104.67, 7472.0, 0.0524, 0.792, 1.215


@dataclass(frozen=True)
class Case:
    """One record: time `t` (N,) in s, inputs `u` (N, 2) in rad and N, measurements `z` (N, 7), its origin."""

    t: np.ndarray
    u: np.ndarray
    z: np.ndarray
    source: str

    @property
    def step(self):
        """Sample interval in s."""
        return self.t[1] - self.t[0]


def _coefficients(x, u, p):
    """CL, CD, Cm at states `x`, inputs `u` and a mapping `p` with the eleven derivatives."""
    dv = x[0] / V_REF - 1.0
    lift = p["CL0"] + p["CLV"] * dv + p["CLa"] * x[1]
    drag = p["CD0"] + p["CDV"] * dv + p["CDa"] * x[1]
    pitch = p["Cm0"] + p["CmV"] * dv + p["Cma"] * x[1] + p["Cmde"] * u[0]
    pitch = pitch + p["Cmq"] * (HALF_CBAR / V_REF) * x[3]
    return lift, drag, pitch


def dynamics(x, u, p, lib=np):
    """Right-hand side f(x, u, theta): a list of four derivatives; `lib` gives `sin` and `cos`."""
    speed, alpha, theta, q = x[0], x[1], x[2], x[3]
    thrust = u[1]
    lift, drag, pitch = _coefficients(x, u, p)
    pressure = (0.5 * RHO) * speed * speed
    gamma = theta - alpha
    return [
        -S_OVER_M * pressure * drag + thrust / MASS * lib.cos(alpha + THRUST_ANGLE) - G0 * lib.sin(gamma),
        -S_OVER_M * (0.5 * RHO) * speed * lift
        + (G0 * lib.cos(gamma) - thrust / MASS * lib.sin(alpha + THRUST_ANGLE)) / speed
        + q,
        q,
        S_CBAR_OVER_IY * pressure * pitch + THRUST_MOMENT * thrust,
    ]


def outputs(x, u, p, lib=np):
    """Outputs g(x, u, theta): a list of seven, in the order of OUTPUTS."""
    lift, drag, pitch = _coefficients(x, u, p)
    pressure = (0.5 * RHO) * x[0] * x[0]
    sin_alpha, cos_alpha = lib.sin(x[1]), lib.cos(x[1])
    thrust_x, thrust_z = np.cos(THRUST_ANGLE) / MASS * u[1], np.sin(THRUST_ANGLE) / MASS * u[1]
    return [
        x[0],
        x[1],
        x[2],
        x[3] + p["b_q"],
        S_CBAR_OVER_IY * pressure * pitch + THRUST_MOMENT * u[1] + p["b_aq"],
        S_OVER_M * pressure * (sin_alpha * lift - cos_alpha * drag) + thrust_x + p["b_ax"],
        -S_OVER_M * pressure * (cos_alpha * lift + sin_alpha * drag) - thrust_z + p["b_az"],
    ]


def find_data(name):
    """Path of a data file in $PHUGOID_DATA or in ../shared/data beside the checkout; None if absent."""
    beside_checkout = Path(__file__).resolve().parents[2] / "shared" / "data"
    folders = [Path(os.environ["PHUGOID_DATA"])] if "PHUGOID_DATA" in os.environ else []
    return next((folder / name for folder in [*folders, beside_checkout] if (folder / name).is_file()), None)


def load_case():
    """The flight record (601 samples, 0.1 s) or, where the file is absent, its simulated twin."""
    path = find_data("hfb320_1_10.asc")
    if path is None:
        return simulated_twin()
    table = np.loadtxt(path)
    return Case(0.1 * np.arange(len(table)), table[:, [1, 3]].copy(), table[:, 4:11].copy(), "flight data")


def simulated_twin(seed=0):
    """A record of the same shape from the published optimum: elevator 3-2-1-1 and pulse, constant thrust."""
    from scipy.integrate import solve_ivp

    t = 0.1 * np.arange(601)
    elevator = np.full(t.size, -0.008)
    for begin, end, sign in ((5, 8, 1), (8, 10, -1), (10, 11, 1), (11, 12, -1), (25, 41, 1)):
        elevator[(t >= begin) & (t < end)] += 0.012 * sign
    u = np.column_stack([elevator, np.full(t.size, 11_600.0)])
    solution = solve_ivp(
        lambda now, x: dynamics(x, (np.interp(now, t, elevator), u[0, 1]), OPTIMUM),
        (t[0], t[-1]), [105.24, 0.1103, 0.1058, -0.0021], t_eval=t, rtol=1e-8, atol=1e-10, max_step=0.1,
    )  # fmt: skip
    clean = np.column_stack(outputs(solution.y, u.T, OPTIMUM))
    noise = np.random.default_rng(seed).standard_normal(clean.shape) * [OPTIMUM[name] for name in SIGMAS]
    return Case(t, u, clean + noise, f"simulated twin, seed {seed}")


def perturbed_start(fraction=0.15, seed=0):
    """Derivatives off the optimum by `fraction`, each with a random sign; biases 0."""
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], len(DERIVATIVES))
    start = {name: OPTIMUM[name] * (1 + fraction * s) for name, s in zip(DERIVATIVES, signs, strict=True)}
    return start | dict.fromkeys(BIASES, 0.0) | dict.fromkeys(SIGMAS, 1.0)


def random_start(seed):
    """The paper's random start number `seed` (0 to 999): uniform in START_RANGES, biases 0, sigmas 1."""
    random = np.random.RandomState(seed)
    start = {name: random.uniform(*limits) for name, limits in START_RANGES.items()}
    return start | dict.fromkeys(BIASES, 0.0) | dict.fromkeys(SIGMAS, 1.0)


def zero_start():
    """Every derivative and bias zero: an aircraft that falls like a stone; sigmas 1."""
    return dict.fromkeys(DERIVATIVES + BIASES, 0.0) | dict.fromkeys(SIGMAS, 1.0)


def start_parameters(start):
    """Starting parameters from a mapping, 'zero', 'optimum', or the number of a random start of the paper."""
    if isinstance(start, dict):
        return start
    return {"zero": zero_start, "optimum": lambda: OPTIMUM}.get(start, lambda: random_start(int(start)))()


def counts(objective, gradient, constraints, jacobian, hessian, gauss_newton=0):
    """Text of how often a solver called what."""
    return f"{objective}/{gradient}/{constraints}/{jacobian}/{hessian}{f'+{gauss_newton}g' * bool(gauss_newton)}"


def largest_error(parameters, names=DERIVATIVES):
    """Largest relative deviation from the published optimum over `names`."""
    return max(abs(parameters[name] / OPTIMUM[name] - 1) for name in names)
