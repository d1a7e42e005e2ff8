"""Decide whether a term can be a cause at all: its size is physical, the data determine it, and it follows no noise.

Where a controller acts on a measurement, the input has a part that follows the noise of that measurement at the same
sample. A term of the input in that output then seems to predict the noise; but the input follows the noise, and not the
output the input. The two are distinguished by the part of the input that was determined before the sample: noise
is not correlated with it, a term in the output is (Ljung 1999, section 13.4, on identification in closed loop).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...residual_noise.whitening import Whitening
from ...sensitivities import Place
from ..candidates.candidate import Candidate, place_range
from ..candidates.model_structure import addends
from ..candidates.scales import evaluated
from .free_run import Explained
from .refit import Refit, is_structured

__all__ = ["follows_noise", "is_determined", "is_physical", "is_plausible"]

_Array = NDArray[np.float64]

# Part of the power of an output's residuals that their past does not predict, from which on they are noise.
_NOISE = 0.5
# Samples before, from which the signal of a candidate is predicted; parts of the signal's power that must be predicted,
# and not, to distinguish the two: what is less is rounding. Noise is a small part of a signal that is hardly ever zero.
_LAGS, _EACH = 10, 1e-9
# By how much twice the log-likelihood of noise that is fed back must be ahead of that of a term; and below what its own
# loss must be, for where both are there noise alone does not explain the signal. But where the coefficient that was
# estimated is mostly owed to the noise, what the term does besides is less than this part of it.
_AHEAD, _ALONE, _OWED = 4.0, 9.0, 0.5


def follows_noise(base: Refit, more: Refit, candidate: Candidate) -> bool:
    """Return whether the signal of a candidate in an output is correlated with the noise of that output only by what
    was not determined before each sample, so that it follows the noise: of two coefficients in place of one, for what
    its past and that of the residuals predict and for the rest, the first is likelier to be zero than to equal the
    second."""
    if candidate.place.kind != "output" or len(candidate.coefficients) != 1:
        return False
    linear, seen = base.linear, base.own
    shape = {n: more.fit.parameters[n].value for n in candidate.shape_names}
    estimate = more.fit.parameters[candidate.coefficients[0]].value
    signals = [candidate.signals(p, shape) for p in linear.points]
    (signal,) = seen.filter(linear.answers(candidate.place, signals))
    output = linear.model.output_names.index(candidate.place.name)
    line, filter = linear.rows[output], seen.filter
    assert isinstance(filter, Whitening)  # channel by channel
    power = float(np.mean(linear.residuals[line[0].start : line[-1].stop] ** 2))
    # Of an error of the model the past of the residuals predicts most: that is no noise to follow.
    if filter.channels[output].power < _NOISE * power:
        return False
    longer = [rows for rows in line if rows.stop - rows.start > 4 * _LAGS]
    if not longer:
        return False
    past = np.vstack([np.hstack([_lagged(signal[rows]), _lagged(seen.errors[rows])]) for rows in longer])
    at = np.concatenate([np.arange(rows.start + _LAGS, rows.stop) for rows in longer])
    predicted = past @ np.linalg.lstsq(past, signal[at], rcond=None)[0]
    powers = float(predicted @ predicted), float(np.sum((signal[at] - predicted) ** 2))
    if min(powers) < _EACH * sum(powers):
        return False
    both = np.zeros((signal.size, 2))
    both[at] = np.column_stack([predicted, signal[at] - predicted])
    # Parameters of the model may have taken up a part of what is correlated with either.
    both -= seen.basis @ (seen.basis.T @ both)
    found = np.linalg.lstsq(both, seen.errors, rcond=None)[0]
    left = seen.errors - both @ found
    covariance = float(left @ left) / left.size * np.linalg.inv(both.T @ both)
    # A term has one coefficient for both parts, noise that is fed back none for the first.
    apart = covariance[0, 0] + covariance[1, 1] - 2.0 * covariance[0, 1]
    of_term, of_noise = (found[0] - found[1]) ** 2 / apart, found[0] ** 2 / covariance[0, 0]
    owed = found[0] * np.sign(estimate) < _OWED * abs(estimate)
    return bool(of_term > of_noise + _AHEAD and (of_noise < _ALONE or owed))


def _lagged(x: _Array) -> _Array:
    """Return the values (n - lags, lags) before each value but the first ones."""
    return np.lib.stride_tricks.sliding_window_view(x, _LAGS)[: x.size - _LAGS]


def is_physical(at: Refit, candidate: Candidate) -> bool:
    """Return whether all parameters of a candidate lie within what is physical, or have a reason not to."""
    limits = candidate.physical(at.linear.points)
    values = {n: at.own.parameter(n)[0] for n in limits}

    def are_within(wider: float) -> bool:
        by = {n: wider if n in candidate.coefficients else 1.0 for n in limits}
        return all(by[n] * low <= values[n] <= by[n] * high for n, (low, high) in limits.items())

    return are_within(1.0) or are_within(_cancelling(at, candidate.place)) or candidate.has_reason(values)


# Part of the misfit that a cause of any size explains which leaves nothing but noise.
_ALL, _WHITE = 0.95, 0.05


def is_plausible(at: Refit, candidate: Candidate, explained: Explained | None) -> bool:
    """Return whether a candidate is of a size that is physical, or leaves nothing but noise of a large misfit, in free
    simulation too: where large parts of an equation balance each other, one of them is large beside what is left."""
    if is_physical(at, candidate):
        return True
    return explained is not None and explained.interval[0] >= _ALL and not is_structured(at, _WHITE)


# Families with a size that says nothing where its error is larger: such a lag or limit holds an input where it was.
_SIZED = ("lag", "rate_limit", "backlash", "deadband", "saturation")


def is_determined(at: Refit, candidate: Candidate) -> bool:
    """Return whether the data determine the size of a lag or of a limit. If it may have any size, it only shows that
    its input has no effect."""
    if getattr(candidate, "family", "") not in _SIZED or not candidate.shape_names:
        return True
    value, error = at.parameters(candidate)[candidate.shape_names[0]]
    return not error > abs(value)


# Ratio of the frequencies of a mode and of its free motion, at most: a line of a record of few periods is wide.
_OF_A_MODE = 1.25


def is_free_motion(at: Refit, candidate: Candidate) -> bool:
    """Return whether a periodic disturbance may be the free motion of a lightly damped mode that a refit has beside it:
    the mode begins at rest, and in the records it need not have."""
    if getattr(candidate, "family", "") != "periodic":
        return False
    modes = [c for c in at.candidates if getattr(c, "family", "") == "mode"]
    (own,) = candidate.shape_names
    ratios = [at.own.parameter(c.shape_names[0])[0] / at.own.parameter(own)[0] for c in modes]
    return any(1.0 / _OF_A_MODE < ratio < _OF_A_MODE for ratio in ratios)


def _cancelling(at: Refit, place: Place) -> float:
    """Return how much more a known part of what stands at a place varies than all of it: where known parts nearly
    cancel each other, as a turn rate and gravity in the sideslip of a turn, others may be as large; 1 at least."""
    if place.kind not in ("equation", "quantity"):
        return 1.0
    model, points = at.fit.model, at.linear.points
    known = {*model.state_names, *model.declared_inputs}
    sums = [e for e in addends(model._right_hand_sides()[place.kind, place.name]) if known.issuperset(e.symbols)]
    spans = [float(np.ptp(np.concatenate([evaluated(e, p) for p in points]))) for e in sums if e.symbols]
    return max([1.0, *(span / place_range(place, points) for span in spans)])
