"""Noise of a sensor that a controller feeds back into the inputs.

Where a controller acts on a measurement, the input has a part that goes with the noise of that measurement at the same
sample. A term of the input in that output then seems to predict the noise; but the input follows the noise, and not the
output the input. What of the input was determined before the sample tells them apart: noise does not go with it,
a term in the output does (Ljung 1999, section 13.4, on identification in closed loop).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..candidates.candidate import Candidate
from .refit import Refit

__all__ = ["follows_noise"]

_Array = NDArray[np.float64]

# Samples before, from which the signal of a candidate is predicted; parts of the signal's power that must be predicted,
# and not, for the two to be told apart.
_LAGS, _EACH = 10, 1e-4
# By how much twice the log-likelihood of noise that is fed back must be ahead of that of a term.
_AHEAD = 4.0


def follows_noise(base: Refit, more: Refit, candidate: Candidate) -> bool:
    """Tell whether the signal of a candidate in an output goes with the noise of that output only by what was not
    determined before each sample, so that it follows the noise: of two coefficients in place of one, for what its past
    and that of the residuals predict and for the rest, the first is likelier to be zero than to equal the second."""
    if candidate.place.kind != "output" or len(candidate.coefficients) != 1:
        return False
    linear, seen = base.linear, base.own
    shape = {n: more.fit.parameters[n].value for n in candidate.shape_names}
    signals = [candidate.signals(p, shape) for p in linear.points]
    (signal,) = seen.filter(linear.answers(candidate.place, signals))
    line = linear.rows[linear.model.output_names.index(candidate.place.name)]
    parts = [(signal[rows], seen.errors[rows]) for rows in line if rows.stop - rows.start > 4 * _LAGS]
    if not parts:
        return False
    past = np.vstack([np.hstack([_lagged(f), _lagged(e)]) for f, e in parts])
    now, noise = (np.concatenate([p[k][_LAGS:] for p in parts]) for k in (0, 1))
    predicted = past @ np.linalg.lstsq(past, now, rcond=None)[0]
    rest = now - predicted
    powers = float(predicted @ predicted), float(rest @ rest)
    if min(powers) < _EACH * sum(powers):
        return False
    both = np.column_stack([predicted, rest])
    found = np.linalg.lstsq(both, noise, rcond=None)[0]
    left = noise - both @ found
    squares = float(left @ left) / left.size * np.diag(np.linalg.inv(both.T @ both))
    # A term has one coefficient for both parts, noise that is fed back none for the first.
    of_term, of_noise = (found[0] - found[1]) ** 2 / squares.sum(), found[0] ** 2 / squares[0]
    return bool(of_term > of_noise + _AHEAD)


def _lagged(x: _Array) -> _Array:
    """Return the values (n - lags, lags) before each value but the first ones."""
    return np.lib.stride_tricks.sliding_window_view(x, _LAGS)[: x.size - _LAGS]
