"""Noise of sensors that is not white, and not what `Colour` draws."""

from __future__ import annotations

import numpy as np

__all__ = ["NOISES", "filtered", "noise"]

NOISES = ("white", "quantised", "growing", "outliers", "autoregressive", "pink", "random walk")


def noise(kind: str, n: int, rng: np.random.Generator) -> np.ndarray:
    """(n,) of unit size, as a channel has it."""
    e = rng.standard_normal(n)
    if kind == "outliers":
        return np.where(rng.random(n) < 0.03, 8.0 * e, e)
    if kind == "autoregressive":
        a = rng.uniform(0.6, 0.95)
        return filtered(e, a) * np.sqrt(1 - a * a)
    if kind == "pink":
        f = np.fft.rfftfreq(n)
        f[0] = f[1]
        x = np.fft.irfft(np.fft.rfft(e) / np.sqrt(f), n)
        return x / x.std()
    if kind == "random walk":
        return e + 0.1 * np.cumsum(rng.standard_normal(n))
    return e


def filtered(e: np.ndarray, a: float) -> np.ndarray:
    """(n,) of a first-order autoregression driven by white noise, stationary from the first on."""
    x = np.empty(e.size)
    now = e[0] / np.sqrt(1 - a * a)
    for k, each in enumerate(e):
        now = a * now + each if k else now
        x[k] = now
    return x
