"""What many starts tell about one end: that better optima are known, and which of its parameters are at bounds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from ..parameters import Parameter
from ..starts.outcome import Outcome
from .optima import LOG_LIKELIHOOD, Optimum

__all__ = ["at_bounds", "below_best", "local_optima"]

# A value is at a bound within this part of its size, as for a single fit.
_THERE = 1e-6


def below_best(outcome: Outcome, optima: Sequence[Optimum], starts: int) -> str:
    """Return what to say of an end at an optimum that is not the best one known; "" for all other ends."""
    if not optima or not outcome.at_optimum:
        return ""
    gap = optima[0].log_likelihood - outcome.log_likelihood
    if gap <= LOG_LIKELIHOOD:
        return ""
    count = sum(o.count for o in optima if optima[0].log_likelihood - o.log_likelihood <= LOG_LIKELIHOOD)
    return (
        f"this optimum is local: {count} of {starts} starts reached one whose log-likelihood is higher by {gap:.4g}, "
        f"such as start {optima[0].index}"
    )


def local_optima(optima: Sequence[Optimum], starts: int) -> str:
    """Return how many optima below the best one the starts reached, and with what share; "" where there is none."""
    others = [o for o in optima if optima[0].log_likelihood - o.log_likelihood > LOG_LIKELIHOOD]
    if not others:
        return ""
    count = sum(o.count for o in others)
    gap = optima[0].log_likelihood - others[0].log_likelihood
    are = "local optimum is" if len(others) == 1 else "local optima are"
    return (
        f"{len(others)} other {are} known, where {count} of {starts} starts ({100 * count / starts:.3g} %) ended; "
        f"log-likelihood lower by {gap:.4g}{'' if len(others) == 1 else ' or more'}"
    )


def at_bounds(values: Mapping[str, float], declared: Mapping[str, Parameter]) -> str:
    """Return all parameters whose values are at a bound, each with the bound; "" where there is none."""
    found = []
    for name, value in values.items():
        parameter = declared.get(name)
        if parameter is None or parameter.fixed:
            continue
        for side, bound in zip(("lower", "upper"), parameter.bounds, strict=True):
            if math.isfinite(bound) and abs(value - bound) <= _THERE * max(abs(value), abs(bound)):
                found.append(f"{name} ({side})")
    return ", ".join(found)
