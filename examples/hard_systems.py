"""Four systems that defeat single shooting: unstable, chaotic, stiff, and one with many cycles.

Each record is simulated, with noise, and fitted twice from the same poor start. Collocation (`ph.estimate`) has the
states at all times for unknowns, starts them from the measurements, and so never simulates with wrong parameters.
Single shooting does nothing else, though it is told how large the noise is.

    python examples/hard_systems.py

Prints a table and writes out/hard_systems.png (half a minute, nearly all of it single shooting's).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import single_shooting
from hard_systems_cases import RELAXED, SYSTEMS, System
from scipy.integrate import solve_ivp
from single_shooting import Shot

import phugoid as ph


@dataclass(frozen=True)
class Result:
    """Both fits of one system.

    ``rms`` is collocation's root mean square of residuals over the true noise; ``rms_again`` that of a simulation
    from its estimate; ``line`` the values of one parameter and single shooting's cost there, all else at the optimum.
    """

    system: System
    data: ph.Experiment
    fit: ph.Fit
    shot: Shot
    shot_outputs: dict[str, np.ndarray]
    rms: float
    rms_again: float
    line: tuple[np.ndarray, np.ndarray]

    @property
    def verdict(self) -> str:
        """What became of single shooting."""
        if self.shot.rms < 1.01 * self.rms:
            return "ok"
        return "stuck far from the optimum" if self.shot.status == "stopped" else self.shot.status

    def errors(self, values: dict[str, float]) -> dict[str, float]:
        """Errors of parameters in collocation's standard errors."""
        found = self.fit.parameters
        return {n: (values[n] - truth) / found[n].std_error for n, truth in self.system.truth.items()}

    @property
    def collocation_errors(self) -> dict[str, float]:
        return self.errors({n: self.fit.parameters[n].value for n in self.system.truth})

    @property
    def shot_errors(self) -> dict[str, float]:
        return self.errors(self.shot_values)

    @property
    def shot_values(self) -> dict[str, float]:
        """Single shooting's parameters."""
        return dict(zip(self.system.truth, self.shot.unknowns.tolist(), strict=False))


def solve(system: System, seconds: float = 8.0) -> Result:
    """Simulates the record and fits it both ways; single shooting stops after so many ``seconds``."""
    data = system.record(system)
    fit = ph.estimate(system.model(), data, transcription=ph.Collocation(order=system.order))
    sigma = np.array(list(system.sigma.values()))
    z = np.array([data.output(n) for n in system.sigma])
    residuals = np.array([fit.residuals[n] for n in system.sigma])

    simulate = system.simulation(data)
    measured = [data.outputs[n][0] if n in data.outputs else 0.0 for n in system.states]
    start = np.array([*system.start.values(), *measured])
    scale = np.array([max(abs(v), 0.1) for v in system.truth.values()] + [1.0] * len(measured))
    shot = single_shooting.fit(simulate, z, sigma, start, scale, seconds)
    rms = partial(single_shooting.rms, simulate, z, sigma)

    initial = fit.initial_states[data.name]
    optimum = np.array([fit.parameters[n].value for n in system.truth] + [initial[n].value for n in system.states])
    line = slice_points(system, optimum[list(system.truth).index(system.slice[0])])
    lanes = np.tile(optimum[:, None], line.size)
    lanes[list(system.truth).index(system.slice[0])] = line
    return Result(
        system=system,
        data=data,
        fit=fit,
        shot=shot,
        shot_outputs=dict(zip(system.sigma, simulate(shot.unknowns[:, None])[:, :, 0], strict=True)),
        rms=float(np.sqrt(np.mean((residuals / sigma[:, None]) ** 2))),
        rms_again=float(rms(optimum[:, None])[0]),
        line=(line, rms(lanes)),
    )


def slice_points(system: System, centre: float) -> np.ndarray:
    """Values of the parameter of the slice: evenly spaced, and ever closer to the optimum."""
    _, low, high = system.slice
    near = np.geomspace(1e-7, 0.1, 25) * (high - low)
    even = np.linspace(low, high, 121 if system.stiff else 801)
    return np.sort(np.concatenate([even, centre + near, centre - near, [centre]]))


def table(results: Sequence[Result]) -> str:
    """Truth, start and both estimates, and how the two methods fared."""
    lines = []
    for r in results:
        s, fit, shot = r.system, r.fit, r.shot
        lines += [
            f"{s.title} ({s.name}), {r.data.n} samples",
            f"  collocation      {fit.status}, RMS/noise {r.rms:.3f}, {fit.iterations} iterations, {fit.time:.2f} s",
            f"  single shooting  {r.verdict}, RMS/noise {shot.rms:.4g}, {shot.evaluations} simulations, "
            f"{shot.time:.2f} s",
            f"  a simulation from collocation's estimate has RMS/noise {r.rms_again:.4g}",
            f"  {'':8s}{'truth':>9s}{'start':>9s}{'collocation':>24s}{'single shooting':>19s}",
        ]
        for name, truth in s.truth.items():
            found = fit.parameters[name]
            pair = f"{found.value:.5g} ± {found.std_error:.2g}"
            lines.append(f"  {name:8s}{truth:9.4g}{s.start[name]:9.4g}{pair:>24s}{r.shot_values[name]:19.4g}")
        lines.append("")
    return "\n".join(lines)


def run(seconds: float = 8.0) -> dict[str, Result]:
    """All four, by name."""
    return {system.name: solve(system, seconds) for system in SYSTEMS}


def explicit_methods(result: Result) -> str:
    """What explicit integrators make of the stiff system at its true values."""
    system, t = result.system, result.data.t
    p, x0 = np.array(list(system.truth.values())), np.array(RELAXED)
    path = single_shooting.rk4(system.rhs, p[:, None], x0[:, None], t, np.empty((0, t.size)))
    lost = t[~np.isfinite(path[0, :, 0])][0]
    tolerances = {"rtol": 1e-9, "atol": 1e-11}
    counts = {
        method: solve_ivp(
            lambda _, x: system.rhs(x.tolist(), (), p.tolist()), t[[0, -1]], x0, method, **tolerances
        ).nfev
        for method in ("RK45", "LSODA")
    }
    return (
        f"At the true values of the {system.title.lower()}, RK4 from sample to sample overflows at t = {lost:g} s.\n"
        f"For one simulation RK45 evaluates the equations {counts['RK45']} times, LSODA, used above, {counts['LSODA']}."
    )


def main() -> None:
    """Table on the screen, figure in out/."""
    import hard_systems_figure

    results = run()
    print(table(list(results.values())))
    print(explicit_methods(results["stiff"]))
    path = Path("out") / "hard_systems.png"
    path.parent.mkdir(exist_ok=True)
    hard_systems_figure.draw(list(results.values())).savefig(path, dpi=150)
    print(f"\nWritten: {path}")


if __name__ == "__main__":
    main()
