"""Records of linear systems, for tests of what identifies them."""

from __future__ import annotations

import numpy as np
from scipy.signal import butter, lfilter, lsim

import phugoid as ph

RATE = 50.0


def run(
    truth: ph.linear.StateSpace,
    n: int = 2000,
    noise: float = 0.02,
    seed: int = 0,
    name: str = "run",
    offset: float = 0.0,
) -> ph.Experiment:
    """Inputs linear between samples; noise in parts of the outputs."""
    random = np.random.default_rng(seed)
    t = np.arange(n) / RATE
    u = lfilter(*butter(2, 0.6), random.normal(size=(len(truth.inputs), n)))
    x0 = 0.3 * random.normal(size=truth.order)
    _, y, _ = lsim((truth.A, truth.B, truth.C, truth.D), u.T, t, X0=x0)
    y = y.reshape(n, -1).T
    y = y + noise * y.std(axis=1, keepdims=True) * random.normal(size=y.shape) + offset
    return ph.Experiment(t, dict(zip(truth.inputs, u, strict=True)), dict(zip(truth.outputs, y, strict=True)), name)
