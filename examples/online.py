"""Estimation while the data arrive, against recursive least squares and an augmented extended Kalman filter.

A simulated record of the HFB-320 with known parameters is streamed. Three estimators start from all derivatives 0:

- `ph.Online`, as an iterated extended Kalman filter (a window of one sample), and on a moving horizon;
- recursive least squares on the equation error (V. Klein and E. A. Morelli, Aircraft System Identification, chapter 8):
  angular acceleration and specific forces are regressed on measured states;
- an extended Kalman filter with the parameters as further states (R. V. Jategaonkar, Flight Vehicle System
  Identification, chapter 7), with a covariance, Jacobians by finite differences and no iterations.

    python examples/online.py

Writes out/online.png, the error over time, and out/online_parameters.png. Prints the errors at the end of the record.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np
from hfb320 import PUBLISHED, SIGMA, model, twin
from numpy.typing import NDArray

import phugoid as ph

Array = NDArray[np.float64]

G, RHO, MASS, V_REF, CHORD = 9.80665, 0.792, 7472.0, 104.67, 2.43
S_M, SC_IY, LT_IY, EPSILON = 4.028e-3, 8.0027e-4, -7.0153e-6, 0.0524
NAMES = list(PUBLISHED)
DERIVATIVES = NAMES[:11]
# Standard deviations of the start values: what an engineer knows of a jet before its first flight.
SPREAD = {name: 3 * max(abs(value), 0.01) for name, value in PUBLISHED.items()}


def coefficients(x: Array, u: Array, p: Array) -> tuple[float, float, float]:
    """Return CD, CL and Cm."""
    dv = x[0] / V_REF - 1
    cd = p[0] + p[1] * dv + p[2] * x[1]
    cl = p[3] + p[4] * dv + p[5] * x[1]
    cm = p[6] + p[7] * dv + p[8] * x[1] + p[9] * CHORD / (2 * V_REF) * x[3] + p[10] * u[0]
    return float(cd), float(cl), float(cm)


def slope(x: Array, u: Array, p: Array) -> Array:
    """Return the slopes of V, alpha, theta and q."""
    cd, cl, cm = coefficients(x, u, p)
    pressure, pull = 0.5 * RHO * x[0] ** 2, u[1] / MASS
    gamma = x[2] - x[1]
    return np.array(
        [
            -pressure * S_M * cd + pull * np.cos(x[1] + EPSILON) - G * np.sin(gamma),
            -pressure * S_M / x[0] * cl + (G * np.cos(gamma) - pull * np.sin(x[1] + EPSILON)) / x[0] + x[3],
            x[3],
            pressure * SC_IY * cm + LT_IY * u[1],
        ]
    )


def outputs(x: Array, u: Array, p: Array) -> Array:
    """Return V, alpha, theta, q, aq, ax and az."""
    cd, cl, cm = coefficients(x, u, p)
    pressure, pull = 0.5 * RHO * x[0] ** 2, u[1] / MASS
    sin, cos = np.sin(x[1]), np.cos(x[1])
    aq = pressure * SC_IY * cm + LT_IY * u[1] + p[12]
    ax = pressure * S_M * (cl * sin - cd * cos) + pull * np.cos(EPSILON) + p[13]
    az = -pressure * S_M * (cl * cos + cd * sin) - pull * np.sin(EPSILON) + p[14]
    return np.array([*x[:3], x[3] + p[11], aq, ax, az])


def extended_kalman_filter(t: Array, u: Array, y: Array, spread: Array) -> Array:
    """Return the parameters after each sample (N, 15), which are states of a filter without iterations."""
    sigma = np.array(list(SIGMA.values()))

    def ahead(z: Array, k: int) -> Array:
        x, p, h = z[:4], z[4:], t[k + 1] - t[k]
        middle = 0.5 * (u[k] + u[k + 1])
        k1 = slope(x, u[k], p)
        k2 = slope(x + 0.5 * h * k1, middle, p)
        k3 = slope(x + 0.5 * h * k2, middle, p)
        k4 = slope(x + h * k3, u[k + 1], p)
        return np.concatenate([x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4), p])

    def measured(z: Array, k: int) -> Array:
        return outputs(z[:4], u[k], z[4:])

    def jacobian(function: Callable[[Array, int], Array], z: Array, k: int) -> Array:
        steps = 1e-6 * np.maximum(np.abs(z), 1e-2)
        pairs = zip(np.diag(steps), steps, strict=True)
        columns = [(function(z + d, k) - function(z - d, k)) / (2 * s) for d, s in pairs]
        return np.stack(columns, axis=1)

    z = np.concatenate([y[0, :4], np.zeros(15)])
    covariance = np.diag(np.concatenate([(10 * sigma[:4]) ** 2, spread**2]))
    found = np.empty((t.size, 15))
    for k in range(t.size):
        if k:
            a = jacobian(ahead, z, k - 1)
            z = ahead(z, k - 1)
            covariance = a @ covariance @ a.T
        h = jacobian(measured, z, k)
        gain = np.linalg.solve(h @ covariance @ h.T + np.diag(sigma**2), h @ covariance).T
        z = z + gain @ (y[k] - measured(z, k))
        left = np.eye(19) - gain @ h
        covariance = left @ covariance @ left.T + gain @ np.diag(sigma**2) @ gain.T  # Joseph's form
        found[k] = z[4:]
    return found


def recursive_least_squares(u: Array, y: Array, spread: Array) -> Array:
    """Return the derivatives after each sample (N, 11), by regression of measured accelerations on measured states."""
    # A regression cannot tell the biases of sensors from CD0, CL0 and Cm0: it is given them.
    V, alpha, _, q, aq, ax, az = (y - np.array([0, 0, 0, *(PUBLISHED[n] for n in NAMES[11:])])).T
    pressure, pull, one, dv = 0.5 * RHO * V**2, u[:, 1] / MASS, np.ones_like(V), V / V_REF - 1
    fx, fz = ax - pull * np.cos(EPSILON), az + pull * np.sin(EPSILON)
    drag = -(fx * np.cos(alpha) + fz * np.sin(alpha)) / (pressure * S_M)
    lift = (fx * np.sin(alpha) - fz * np.cos(alpha)) / (pressure * S_M)
    moment = (aq - LT_IY * u[:, 1]) / (pressure * SC_IY)
    longitudinal = np.stack([one, dv, alpha], axis=1)
    rotation = np.stack([one, dv, alpha, CHORD / (2 * V_REF) * q, u[:, 0]], axis=1)
    scales = [
        SIGMA["ax"] / np.mean(pressure * S_M),
        SIGMA["az"] / np.mean(pressure * S_M),
        SIGMA["aq"] / np.mean(pressure * SC_IY),
    ]
    found, first = [], 0
    for target, regressors, scale in zip(
        (drag, lift, moment), (longitudinal, longitudinal, rotation), scales, strict=True
    ):
        size = regressors.shape[1]
        theta, p = np.zeros(size), np.diag((spread[first : first + size] / scale) ** 2)
        rows = []
        for row, value in zip(regressors, target, strict=True):
            gain = p @ row / (1 + row @ p @ row)
            theta = theta + gain * (value - row @ theta)
            p = p - np.outer(gain, row @ p)
            rows.append(theta)
        found.append(np.array(rows))
        first += size
    return np.concatenate(found, axis=1)


def main() -> None:
    """Stream the record through all estimators, print their errors, and write the figures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder for results")
    parser.add_argument("--seed", type=int, default=0, help="of the noise")
    args = parser.parse_args()
    data = twin(args.seed)
    u = np.stack([data.input(n) for n in ("de", "T")], axis=1)
    y = np.stack([data.output(n) for n in SIGMA], axis=1)
    spread = np.array(list(SPREAD.values()))
    truth = np.array([PUBLISHED[n] for n in DERIVATIVES])

    fit = ph.estimate(model(), data, noise=ph.Gaussian(sigma=SIGMA))
    errors = np.array([fit.parameters[n].std_error for n in DERIVATIVES])
    histories = {
        window: ph.Online(model(), window=window, first_window=first, sigma=SIGMA, parameter_errors=SPREAD).run(data)
        for window, first in ((1, 0), (60, 0), (2, 100))
    }

    def derivatives(history: ph.results.OnlineHistory) -> Array:
        return np.stack([history.parameters[n] for n in DERIVATIVES], axis=1)

    series = {
        "recursive least squares, equation error": recursive_least_squares(u, y, spread),
        "augmented extended Kalman filter": extended_kalman_filter(data.t, u, y, spread)[:, :11],
        "Online, window of 1": derivatives(histories[1]),
        "Online, window of 2, first one of 100": derivatives(histories[2]),
        "Online, window of 60": derivatives(histories[60]),
    }
    batch = np.array([fit.parameters[n].value for n in DERIVATIVES])
    print("Root mean square over the 11 derivatives at the end of the record, in standard errors of the batch fit:")
    print(f"{'':42}{'from the truth':>16}{'from the batch fit':>20}")
    for name, values in series.items():
        off = [float(np.sqrt(np.mean(((values[-1] - to) / errors) ** 2))) for to in (truth, batch)]
        print(f"{name:42}{off[0]:16.2f}{off[1]:20.2f}")
    print(f"{'batch fit':42}{np.sqrt(np.mean(((batch - truth) / errors) ** 2)):16.2f}")

    import matplotlib.pyplot as plt

    args.out.mkdir(exist_ok=True)
    colours = ("#999999", "#E69F00", "#0072B2", "#009E73", "#D55E00")
    figure, (above, below) = plt.subplots(
        2, 1, figsize=(7.2, 4.6), height_ratios=(3, 1), sharex=True, layout="constrained"
    )
    for (name, values), colour in zip(series.items(), colours, strict=True):
        off = np.sqrt(np.mean(((values - truth) / errors) ** 2, axis=1))
        above.semilogy(data.t, off, color=colour, lw=1.3, label=name)
    final = float(np.sqrt(np.mean(((batch - truth) / errors) ** 2)))
    above.axhline(final, color="black", lw=0.8, ls="--", label="batch fit of the whole record")
    above.set_ylabel("error of 11 derivatives,\nstandard errors of the batch fit")
    above.legend(fontsize=7, frameon=False)
    below.plot(data.t, np.degrees(u[:, 0]), color="black", lw=0.9)
    below.set_ylabel("elevator, deg")
    below.set_xlabel("t, s")
    figure.savefig(args.out / "online.png", dpi=150)
    figure, _ = histories[60].plot(DERIVATIVES, reference=PUBLISHED)
    figure.savefig(args.out / "online_parameters.png", dpi=150)
    print(f"\nWritten: {args.out / 'online.png'}, {args.out / 'online_parameters.png'}")


if __name__ == "__main__":
    main()
