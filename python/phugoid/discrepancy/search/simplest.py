"""The simplest of several terms that explain the same data equally well."""

from __future__ import annotations

import numpy as np

from ...residual_noise.whitening import Whitening
from ..candidates.candidate import Candidate
from .refit import Refit

__all__ = ["RICH", "complexity", "is_as_good"]

# A constant before a linear term before any other, and those with states of their own or two unknowns last.
RICH = 3
_ORDER = {"bias": 0, "linear": 1, "scale": 1, "stribeck": RICH, "hysteresis": RICH, "mode": RICH}
_OTHER = 2
# Twice the difference in log-likelihood, of as many samples as coloured residuals are worth, below which two refits are
# equally good: chance exceeds it once in a hundred times with two parameters that differ.
_EQUAL = 9.2
# Where samples are worth less than this part of their number, the residuals are model error rather than noise, and
# their likelihood says little; equally good terms have this part of the gain elsewhere.
_MODEL_ERROR, _SIMILAR = 0.2, 0.8
# A term that explains most of a misfit leaves an error of the model that is small beside it: others that explain this
# part of what it does are as good.
_MOST, _AS_MUCH = 0.5, 0.95


def complexity(candidate: Candidate) -> int:
    """Return the rank of a candidate: 0 for constants, 1 for linear terms, 3 for those with more unknowns or
    states, 2 for others."""
    return _ORDER.get(getattr(candidate, "family", ""), _OTHER)


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
