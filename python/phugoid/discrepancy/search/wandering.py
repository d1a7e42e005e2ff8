"""Sensors that wander: a random walk of what an output reads, beside which a drift must be the likelier cause.

The sum of many small steps rises or falls over a record by chance, and a straight line fits it better than stationary
noise does, the more significantly the longer the record is (Granger and Newbold 1974, Durlauf and Phillips 1988). A
drift of a sensor, or of a parameter, is known for one only where the line is likelier than a walk.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...residual_noise.autoregression import Autoregression
from ...residual_noise.whitening import Whitening
from ...sensitivities.linearised import Linearised
from ...sensitivities.trajectory import Place
from ...sensitivities.whitened import RandomEffects, Whitened, at_knots
from ...solvers.solution import check_time
from .refit import Refit

__all__ = ["wandering"]

_Array = NDArray[np.float64]

# Knots of a walk, over all records.
_KNOTS = 100


def wandering(at: Refit, outputs: Sequence[str]) -> float:
    """Return by how much the log-likelihood of a refit's residuals, less the number of its parameters, rises where the
    noise of outputs is a random walk with white noise on it in place of an autoregression; of those where it does."""
    filter = at.own.filter
    assert isinstance(filter, Whitening)  # channel by channel
    linear, total = at.linear, 0.0
    alone = Whitened(linear, Whitening(filter.channels, linear.structure))
    names = linear.model.output_names
    lines, covariance = _lines(linear), _walk(linear)
    for output in outputs:
        check_time()
        which = names.index(output)
        channels = list(filter.channels)
        channels[which] = Autoregression((np.empty(0),), np.array([channels[which].power]))
        own = Whitening(channels, linear.structure)
        answers = linear.answers(Place("output", output), lines)
        walk = RandomEffects(linear, answers, own).with_correlation(covariance).maximised(np.ones(len(names)))
        total += max(walk.log_likelihood - own.parameters - 1.0 - alone.lenient_merit, 0.0)
    return total


def _knots(linear: Linearised) -> list[_Array]:
    """Return the times of the knots of each record."""
    spans = [float(p.t[-1] - p.t[0]) for p in linear.points]
    counts = [max(round(_KNOTS * s / sum(spans)), 2) for s in spans]
    return [np.linspace(p.t[0], p.t[-1], n) for p, n in zip(linear.points, counts, strict=True)]


def _lines(linear: Linearised) -> list[_Array]:
    """Return broken lines (k, n) of all knots along each record: zero in the others."""
    knots = _knots(linear)
    ends = np.cumsum([0, *(k.size for k in knots)])
    found = []
    for e, p in enumerate(linear.points):
        signals = np.zeros((int(ends[-1]), p.n))
        signals[ends[e] : ends[e + 1]] = at_knots(p.t, knots[e])
        found.append(signals)
    return found


def _walk(linear: Linearised) -> _Array:
    """Return the covariance (k, k) of walks of unit steps, one in each record."""
    knots = _knots(linear)
    out = np.zeros((sum(k.size for k in knots),) * 2)
    first = 0
    for k in knots:
        index = np.arange(1.0, k.size + 1.0)
        out[first : first + k.size, first : first + k.size] = np.minimum(index[:, None], index)
        first += k.size
    return out
