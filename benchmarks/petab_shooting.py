"""Single shooting with scipy as a peer of `petab_problems`: LSODA, and a trust region in logarithms of parameters.

Residuals are e/σ and √(2 ln σ + C), whose squares sum up to the likelihood when σ is estimated, too (Raue et al. 2013).
The steps are those of `scipy.optimize.least_squares` (trust region, reflective at bounds), its derivatives differences.
"""

import contextlib
import time
import warnings
from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from phugoid.modelling.compiled import CompiledExpressions, CompiledModel

# C above, so that the root exists for σ of 1e-10 and more; a residual where there is no solution.
SHIFT, NONE = 50.0, 1e6
# Most time for one integration, s.
LONGEST = 2.0


class TooLong(Exception):
    """The integration takes too long."""


class SingleShooting:
    """The residuals of a PEtab problem as a function of its parameters."""

    def __init__(self, problem):
        self.problem, self.model = problem, problem._with_sigmas()
        self.compiled = CompiledModel(self.model)
        first = {state: value for end, state, value, *_ in self.model._core.conditions if end == "initial"}
        self.first = CompiledExpressions(
            [first[n] for n in self.model.state_names], self.model.parameter_names, self.model.input_names
        )
        self.declared = problem.model.declared_parameters
        self.logarithmic = np.array([p.transform == "log" for p in self.declared.values()])
        low, high = np.array([p.bounds for p in self.declared.values()]).T
        self.bounds = self.scaled(low), self.scaled(high)

    def scaled(self, values):
        """Return parameters on the scale of the search."""
        return np.where(self.logarithmic, np.log10(np.where(self.logarithmic, values, 1.0)), values)

    def values(self, z):
        """Return parameters from the scale of the search."""
        return np.where(self.logarithmic, 10.0 ** np.where(self.logarithmic, z, 0.0), z)

    def outputs(self, p, e):
        """Return the outputs at the samples of an experiment, its inputs held from sample to sample."""
        u = np.array([e.input(n) for n in self.model.input_names]).reshape(-1, e.n)
        x = self.first(p, np.concatenate([[e.t[0]], u[:, 0]])[:, None]).ravel()
        states = [x]
        until = time.process_time() + LONGEST
        jumps = [0, *(1 + np.flatnonzero((np.diff(u[:, :-1], axis=1) != 0.0).any(axis=0))), e.n - 1]
        for a, b in pairwise(jumps):

            def slopes(t, x, held=u[:, a]):
                if time.process_time() > until:
                    raise TooLong
                return self.compiled.dynamics(p, np.concatenate([[t], held, x])[:, None]).ravel()

            if not np.isfinite(states[-1]).all():
                raise TooLong
            run = solve_ivp(slopes, (e.t[a], e.t[b]), states[-1], "LSODA", e.t[a + 1 : b + 1], rtol=1e-8, atol=1e-10)
            if not run.success:
                raise TooLong
            states += list(run.y.T)
        return self.compiled.outputs(p, np.vstack([e.t, u, np.array(states).T]))

    def residuals(self, z):
        """Return all residuals; a large number each where there is no solution."""
        found = []
        names = list(self.model.output_names)
        p = self.values(z)
        for e in self.problem.experiments:
            there = {n: np.isfinite(e.output(n)) for n in e.outputs}
            try:
                y = self.outputs(p, e)
            except TooLong:
                y = np.full((len(names), e.n), np.nan)
            for n, k in there.items():
                sigma = y[names.index(f"sigma of {n}")][k]
                with np.errstate(all="ignore"):
                    found += [(e.output(n)[k] - y[names.index(n)][k]) / sigma, np.sqrt(2 * np.log(sigma) + SHIFT)]
        found = np.concatenate(found)
        return np.where(np.isfinite(found), found, NONE)

    def value(self, values):
        """Return the negative log-likelihood at parameters by name; NaN where it cannot be simulated."""
        residuals = self.residuals(self.scaled(np.array([values[n] for n in self.declared])))
        if (residuals == NONE).any():
            return np.nan
        return 0.5 * (residuals @ residuals) - 0.25 * SHIFT * residuals.size - self.problem.constant

    def minimise(self, start, limit):
        """Return negative log-likelihood and parameters where a start ends; NaN where it cannot be simulated."""
        z = np.clip(self.scaled(np.array([start[n] for n in self.declared])), *self.bounds)
        if (self.residuals(z) == NONE).any():
            return np.nan, None
        until, best = time.process_time() + limit, [np.inf, z]

        def residuals(z):
            if time.process_time() > until:
                raise TooLong
            r = self.residuals(z)
            cost = 0.5 * (r @ r)
            if cost < best[0]:
                best[:] = cost, z.copy()
            return r

        with warnings.catch_warnings(), contextlib.suppress(TooLong):
            warnings.simplefilter("ignore")
            least_squares(residuals, z, bounds=self.bounds, x_scale=1.0, max_nfev=200)
        found = dict(zip(self.declared, self.values(best[1]).tolist(), strict=True))
        return self.value(found), found


def run(problem, starts, seconds, limit):
    """Yield the end of each start, until the time is used."""
    shooting = SingleShooting(problem)
    began = time.process_time()
    for start in starts:
        before = time.process_time()
        value, found = shooting.minimise(start, min(limit, seconds - (before - began)))
        yield {"value": float(value), "cpu": time.process_time() - before, "at": found}
        if time.process_time() - began > seconds:
            return
