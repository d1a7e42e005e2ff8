"""Sensors that quantise, clip, pause, are slower than others, or whose noise grows with what they measure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

import phugoid as ph

from .system import System

__all__ = ["OF_SENSORS", "coarse", "sensed"]

OF_SENSORS = ("quantised", "growing", "clipped", "friction", "two rates", "gap")
"""Situations in which records go through `sensed`; friction is felt by an encoder."""

COARSE, SLOWER = 4, 3
"""Say of how many samples a coarse record keeps one, and the slower sensor of a record with two rates."""


def coarse(e: ph.Experiment) -> ph.Experiment:
    """A record of which only some samples are left."""
    inputs, outputs = ({n: v[::COARSE] for n, v in group.items()} for group in (e.inputs, e.outputs))
    return ph.Experiment(e.t[::COARSE], inputs, outputs, name=e.name)


def sensed(what: str, s: System, records: Sequence[Any], rng: np.random.Generator) -> Any:
    """Records through such sensors; names that may be said of these, and sizes."""
    y = str(rng.choice(list(s.outputs)))
    clean = records[0][1][y]
    high = float(np.quantile(clean, 0.97))
    limit = float(clean.max() - 0.25 * np.ptp(clean)) if what == "clipped" else np.inf
    limit = max(min(limit, high), float(np.median(clean)) + 3.0 * s.sigma[y])
    found = []
    for experiment, own in records:
        outputs = {}
        silent = rng.uniform(0.2, 0.7) * s.t[-1] if what == "gap" else np.inf
        for n in s.outputs:
            z = experiment.output(n)
            if what in ("quantised", "friction"):
                z = np.round(own[n] / (4.0 * s.sigma[n])) * 4.0 * s.sigma[n]
            elif what == "growing":
                z = own[n] + (z - own[n]) * (0.3 + 3.0 * np.abs(own[n] - own[n].mean()) / max(np.ptp(own[n]), 1e-12))
            elif what == "two rates":
                z = np.where((n != y) | (np.arange(z.size) % SLOWER == 0), z, np.nan)
            elif what == "gap":
                z = np.where((s.t >= silent) & (s.t < silent + 0.1 * s.t[-1]), np.nan, z)
            elif n == y:
                z = np.minimum(z, limit)
            outputs[n] = z
        found.append(ph.Experiment(s.t, experiment.inputs, outputs, name=experiment.name))
    truth = (f"{y}:clipped",) if what == "clipped" else ()
    return *found, truth, {"limit": limit} if truth else {}
