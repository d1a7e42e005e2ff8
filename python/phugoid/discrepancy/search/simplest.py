"""The simplest of several terms that explain the same data equally well."""

from __future__ import annotations

import numpy as np

from ...modelling.model import Model
from ...residual_noise.whitening import Whitening
from ..candidates.candidate import Candidate
from ..candidates.model_structure import ANGLES, ANGULAR_RATES
from .refit import Refit

__all__ = ["RICH", "complexity", "is_as_good", "is_equal", "plausibility"]

# A constant before a linear term before any other, and those with states of their own or two unknowns last.
RICH = 3
_ORDER = {"bias": 0, "linear": 1, "scale": 1, "stribeck": RICH, "hysteresis": RICH, "mode": RICH, "ripple": RICH}
_OTHER = 2
# Twice the difference in log-likelihood, of as many samples as coloured residuals are worth, below which two refits are
# equally good: chance exceeds it once in a hundred times with two parameters that differ.
_EQUAL = 9.2
# Where samples are worth less than this part of their number, the residuals are model error rather than noise, and
# their likelihood says little; equally good terms have this part of the gain elsewhere.
_MODEL_ERROR, _SIMILAR = 0.2, 0.8
# Log-likelihood by which two refits differ that are one and the same but for rounding.
_SAME = 1.0
# A term that explains most of a misfit leaves an error of the model that is small beside it: others that explain this
# part of what it does are as good.
_MOST, _AS_MUCH = 0.5, 0.95


def complexity(candidate: Candidate) -> int:
    """Return the rank of a candidate: 0 for constants, 1 for linear terms, 3 for those with more unknowns or
    states, 2 for others."""
    return _ORDER.get(getattr(candidate, "family", ""), _OTHER)


def plausibility(candidate: Candidate, model: Model) -> tuple[int, int, str]:
    """Return the rank of a candidate among others that say the same, the most plausible first: a lever arm of a sensor,
    which every vane and accelerometer away from the centre of gravity has; then what acts on the motion; the size of
    an input, which mass and actuators change; a sensor, which was calibrated; and what belongs to one record alone.
    Among equals fewer unknowns come first, then the name."""
    place = candidate.place
    rates = [n for n in getattr(candidate, "variables", ()) if model.units.get(n, "") in ANGULAR_RATES]
    family = getattr(candidate, "family", "")
    lever = place.kind == "output" and family in ("linear", "rate") and len(rates) == 1
    order = 0 if lever else {"quantity": 1, "equation": 1, "parameter": 1, "input": 2}.get(place.kind, 3)
    if lever and model.units.get(place.name, "") not in ("", *ANGLES) and family == "linear":
        order = 3  # of a rate no lever arm gives a part that goes with a rate
    if not candidate.transferable:
        order = 4
    return order, len(candidate.parameters) + (complexity(candidate) == RICH), candidate.name


def is_equal(one: Refit, other: Refit) -> bool:
    """Tell whether two refits are one and the same but for rounding: by the likelihood of white noise, and by that of
    noise with the autocorrelation of the residuals of the first."""
    if abs(one.fit.log_likelihood - other.fit.log_likelihood) > _SAME:
        return False
    filter = one.own.filter
    return abs(one.through(filter).log_likelihood - other.through(filter).log_likelihood) < _SAME


def is_as_good(best: Refit, other: Refit, gain: float, parts: tuple[float, float]) -> bool:
    """Tell whether another refit explains the data as well as the best, whose gain in likelihood with coloured noise it
    has the part ``gain`` of. ``parts``: what each explains of the misfit.

    Where residuals are noise, a test compares the mean squares of each output. With autocorrelation rho the mean square
    of n residuals is as uncertain as that of n / (1 + 2 sum rho_k^2) independent ones (Bartlett 1946). Where they are
    error of the model, what each explains is compared.
    """
    filter = Whitening.of(best.linear.residuals, best.linear.structure)
    statistic, worth = 0.0, []
    for line, other_line, colour in zip(best.linear.rows, other.linear.rows, filter.channels, strict=True):
        mine = best.linear.residuals[line[0].start : line[-1].stop]
        theirs = other.linear.residuals[other_line[0].start : other_line[-1].stop]
        longest = max(rows.stop - rows.start for rows in line)
        rho = colour.autocorrelation(max(longest, 2))[1:]
        worth.append(1.0 / (1.0 + 2.0 * float(rho @ rho)))
        before, after = float(np.mean(mine**2)), float(np.mean(theirs**2))
        if before > 0.0 and after > 0.0:
            statistic += mine.size * worth[-1] * float(np.log(after / before))
    if max(worth) < _MODEL_ERROR and parts[0] > _MOST:
        return parts[1] > _AS_MUCH * parts[0]
    return statistic < _EQUAL and gain > _SIMILAR
