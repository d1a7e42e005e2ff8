"""The usual way, as a peer: simulate from the first sample with RK4, fit with scipy.optimize.least_squares.

Fixed-step RK4 at the sample times, inputs linear between samples, finite-difference Jacobian; the noise
variances are those of the residuals of the pass before, until they settle (iterated R).  19 unknowns: 11
derivatives, 4 biases, 4 initial states.  One trajectory is a loop over Python floats, which is faster than
numpy on four states; `--batched` carries the 20 trajectories of a Jacobian through one loop as numpy lanes.

    python benchmarks/scipy_single_shooting.py --starts 3
"""

import argparse
import math
import time
from itertools import pairwise

import hfb320_case as hfb
import numpy as np
from scipy.optimize import least_squares

NAMES = hfb.DERIVATIVES + hfb.BIASES
SCALE = np.array([abs(hfb.OPTIMUM[name]) for name in hfb.DERIVATIVES] + [1e-2] * 4 + [100.0, 0.1, 0.1, 0.01])
"""Sizes of the unknowns, for the trust region and the finite differences."""
DIVERGED = 1e6
"""Weighted residual in place of one that is not finite or greater."""


def _named(unknowns):
    """Derivatives and biases by name; the initial states behind them are left out."""
    return dict(zip(NAMES, unknowns, strict=False))


class Simulation:
    """Weighted residuals of single shooting, counting trajectories and calls."""

    def __init__(self, case, batched=False):
        self.case, self.batched = case, batched
        self.sigma = case.z.std(axis=0)
        self.calls = self.trajectories = 0

    def states(self, unknowns, initial, lib):
        """RK4 from `initial` (4 floats, or 4 arrays of lanes) over all samples: (N, 4) or (N, 4, lanes)."""
        p = _named(unknowns)
        h, inputs = self.case.step, self.case.u.tolist()
        x, path = list(initial), [list(initial)]
        for now, after in pairwise(inputs):
            middle = (0.5 * (now[0] + after[0]), 0.5 * (now[1] + after[1]))
            k1 = hfb.dynamics(x, now, p, lib)
            k2 = hfb.dynamics([x[i] + 0.5 * h * k1[i] for i in range(4)], middle, p, lib)
            k3 = hfb.dynamics([x[i] + 0.5 * h * k2[i] for i in range(4)], middle, p, lib)
            k4 = hfb.dynamics([x[i] + h * k3[i] for i in range(4)], after, p, lib)
            x = [x[i] + h / 6 * (k1[i] + 2 * (k2[i] + k3[i]) + k4[i]) for i in range(4)]
            path.append(x)
        return np.array(path)

    def misfit(self, unknowns):
        """Measured minus simulated outputs (N, 7); NaN where the simulation overflows."""
        self.trajectories += 1
        try:
            states = self.states(unknowns[: len(NAMES)].tolist(), unknowns[len(NAMES) :].tolist(), math)
        except (OverflowError, ValueError, ZeroDivisionError):  # what math does with too large numbers
            return np.full(self.case.z.shape, np.nan)
        p = _named(unknowns)
        return self.case.z - np.column_stack(hfb.outputs(states.T, self.case.u.T, p))

    def residuals(self, unknowns):
        """Weighted residuals, (7 N,)."""
        self.calls += 1
        return self._weighted(self.misfit(unknowns)).ravel()

    def jacobian(self, unknowns):
        """Forward differences of the residuals, all columns in one simulation of 20 lanes: (7 N, 19)."""
        steps = 1e-7 * SCALE
        lanes = unknowns[:, None] + np.column_stack([np.zeros(len(steps)), np.diag(steps)])
        self.trajectories += lanes.shape[1]
        states = self.states(lanes[: len(NAMES)], lanes[len(NAMES) :], np)
        p = _named(lanes)
        inputs = self.case.u.T[:, :, None]
        simulated = hfb.outputs(states.transpose(1, 0, 2), inputs, p)
        misfit = np.stack([z[:, None] - y for z, y in zip(self.case.z.T, simulated, strict=True)], axis=1)
        weighted = self._weighted(misfit.transpose(2, 0, 1)).reshape(lanes.shape[1], -1)
        return ((weighted[1:] - weighted[0]) / steps[:, None]).T

    def _weighted(self, misfit):
        return np.clip(np.nan_to_num(misfit / self.sigma, nan=DIVERGED), -DIVERGED, DIVERGED)


def fit(case, start, batched=False, max_passes=30, tolerance=1e-4):
    """Iterated-R output-error fit from the mapping `start`: a dict of results, times in seconds."""
    simulation = Simulation(case, batched)
    unknowns = np.array([*(start[name] for name in NAMES), *case.z[0, :4]])
    jacobian = simulation.jacobian if batched else "2-point"
    begin = time.perf_counter()
    for passes in range(1, max_passes + 1):  # noqa: B007
        with np.errstate(all="ignore"):
            solution = least_squares(simulation.residuals, unknowns, jacobian, x_scale=SCALE, max_nfev=100)
        unknowns, before = solution.x, simulation.sigma
        misfit = simulation.misfit(unknowns)
        if not np.isfinite(misfit).all():
            break
        simulation.sigma = np.sqrt(np.mean(misfit**2, axis=0))
        if np.allclose(simulation.sigma, before, rtol=tolerance):
            break
    parameters = dict(zip(NAMES + hfb.SIGMAS, [*unknowns[: len(NAMES)], *simulation.sigma], strict=True))
    weighted = misfit / simulation.sigma
    return {
        "seconds": time.perf_counter() - begin,
        "passes": passes,
        "calls": simulation.calls,
        "trajectories": simulation.trajectories,
        "log_likelihood": -0.5 * np.sum(weighted**2) - len(case.t) * np.sum(np.log(simulation.sigma)),
        "largest_error": hfb.largest_error(parameters),
        "parameters": parameters,
    }


def describe(label, result):
    """One line about a fit."""
    print(
        f"{label:<22} {result['seconds']:7.2f} s  {result['passes']:3d} passes  {result['calls']:6d} calls "
        f"{result['trajectories']:7d} trajectories  logL {result['log_likelihood']:12.3f}  "
        f"off the published optimum by {100 * result['largest_error']:.3g} %",
        flush=True,
    )


def main():
    """Fit from a good start, then from the paper's random ones, and count the successes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--starts", type=int, default=3, help="how many of the paper's random starts")
    parser.add_argument("--fraction", type=float, default=0.15, help="how far off the good start is")
    parser.add_argument("--batched", action="store_true", help="finite differences as numpy lanes")
    arguments = parser.parse_args()
    case = hfb.load_case()
    print(f"HFB-320, {case.source}; published logL (trapezoid) {hfb.LOG_LIKELIHOOD:.3f}")
    best = fit(case, hfb.OPTIMUM, arguments.batched)
    describe("published optimum", best)
    good = fit(case, hfb.perturbed_start(arguments.fraction), arguments.batched)
    describe(f"{100 * arguments.fraction:g} % off it", good)
    successes = 0
    for seed in range(arguments.starts):
        result = fit(case, hfb.random_start(seed), arguments.batched)
        describe(f"random start {seed}", result)
        successes += result["log_likelihood"] > best["log_likelihood"] - 0.1
    print(f"{successes} of {arguments.starts} random starts reach the optimum (within 0.1 in logL)")


if __name__ == "__main__":
    main()
