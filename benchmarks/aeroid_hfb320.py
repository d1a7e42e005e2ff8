"""aeroid as a peer: output error by single shooting, scipy's adaptive Runge-Kutta and least_squares.

It estimates neither sigmas nor initial states by itself.  Here it is given the published sigmas as weights, and
initial states as four more parameters.

    python benchmarks/aeroid_hfb320.py
"""

import math
import time

import aeroid
import hfb320_case as hfb
import numpy as np

NAMES = hfb.DERIVATIVES + hfb.BIASES
INITIAL = tuple(f"{state}_0" for state in hfb.STATES)
SMALL = 1e-3
"""Start of a bias: aeroid measures every parameter by its start, so none may start at 0."""


class FreeStart(aeroid.Model):
    """A model whose initial states are parameters."""

    def simulate(self, time, controls, x0, parameters=None, **options):
        """As in aeroid, but from the parameters INITIAL."""
        merged = {**self.parameters, **(parameters or {})}
        return super().simulate(time, controls, [merged[name] for name in INITIAL], parameters, **options)


def _dynamics(t, x, u, p):
    x = x if x[0] else [1.0, *x[1:]]  # aeroid tries the equations at zero, where speed divides
    return np.array(hfb.dynamics([float(value) for value in x], u.tolist(), p, math))


def fit(case, start):
    """Fit from the mapping `start`: a dict of results, times in seconds."""
    parameters = {name: start[name] or SMALL for name in NAMES}
    parameters |= dict(zip(INITIAL, case.z[0, :4].tolist(), strict=True))
    outputs = {f"{name} measured": case.z[:, i] for i, name in enumerate(hfb.OUTPUTS)}
    inputs = dict(zip(hfb.INPUTS, case.u.T, strict=True))
    weights = {f"{name} measured": 1 / hfb.OPTIMUM[f"sigma_{name}"] for name in hfb.OUTPUTS}
    begin = time.perf_counter()
    model = FreeStart(
        states=hfb.STATES, controls=hfb.INPUTS, parameters=parameters, dynamics=_dynamics,
        outputs=tuple(outputs), measurement=lambda t, x, u, p: hfb.outputs(x, u, p),
    )  # fmt: skip
    data = aeroid.FlightData(case.t, inputs | outputs)
    x0 = case.z[0, :4]
    result = aeroid.identify(model, data, [*NAMES, *INITIAL], weights=weights, x0=x0)
    sigma = np.array([hfb.OPTIMUM[name] for name in hfb.SIGMAS])
    return {
        "solve_seconds": time.perf_counter() - begin,
        "iterations": "-",
        "evaluations": f"{result.n_evaluations} simulations",
        "log_likelihood": -result.cost - len(case.t) * float(np.log(sigma).sum()),
        "largest_error": hfb.largest_error(result.parameters),
        "status": "settled" if result.success else "not settled",
        "parameters": result.parameters,
    }


def main():
    """Fit from 15 % off the published optimum."""
    case = hfb.load_case()
    result = fit(case, hfb.perturbed_start(0.15))
    print({name: value for name, value in result.items() if name != "parameters"})


if __name__ == "__main__":
    main()
