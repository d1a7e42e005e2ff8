"""Which outcomes of many starts are the same optimum."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from ..starts.outcome import Outcome

__all__ = ["LOG_LIKELIHOOD", "PARAMETERS", "Optimum", "group", "same"]

LOG_LIKELIHOOD = 1e-3
"""Outcomes of one optimum differ by no more than this in log-likelihood,"""
PARAMETERS = 0.01
"""and in each parameter by no more than this many standard errors, or this part of its value where it has none."""


@dataclass(frozen=True, eq=False)
class Optimum:
    """An optimum that one start or several reached.

    log_likelihood  the highest of its outcomes.
    parameters      name -> value, of the representative: the outcome with that log-likelihood.
    std_errors      name -> standard error, of the representative.
    index           number of the start that is the representative.
    indices         numbers of all starts that reached it, ascending.
    """

    log_likelihood: float
    parameters: Mapping[str, float]
    std_errors: Mapping[str, float]
    index: int
    indices: tuple[int, ...]

    @property
    def count(self) -> int:
        """How many starts reached it."""
        return len(self.indices)


def same(one: Outcome, other: Outcome, log_likelihood: float = LOG_LIKELIHOOD, parameters: float = PARAMETERS) -> bool:
    """Whether two outcomes are the same optimum; the standard errors are those of the first."""
    if not abs(one.log_likelihood - other.log_likelihood) <= log_likelihood:
        return False
    a, b, error = (
        np.fromiter(v.values(), dtype=np.float64) for v in (one.parameters, other.parameters, one.std_errors)
    )
    unit = np.where(error > 0, error, np.maximum(np.abs(a), np.abs(b)))
    return bool(np.all(np.abs(a - b) <= parameters * unit))


def group(
    outcomes: Iterable[Outcome], log_likelihood: float = LOG_LIKELIHOOD, parameters: float = PARAMETERS
) -> tuple[Optimum, ...]:
    """The optima among the converged outcomes, best first.

    From the highest log-likelihood downwards, an outcome joins the first optimum whose representative is the `same`,
    or starts a new one.
    """
    sound = (o for o in outcomes if o.converged and math.isfinite(o.log_likelihood))
    groups: list[list[Outcome]] = []
    first = 0  # groups before this one lie too high for all that still come
    for outcome in sorted(sound, key=lambda o: (-o.log_likelihood, o.index)):
        while first < len(groups) and groups[first][0].log_likelihood - outcome.log_likelihood > log_likelihood:
            first += 1
        for members in groups[first:]:
            if same(members[0], outcome, log_likelihood, parameters):
                members.append(outcome)
                break
        else:
            groups.append([outcome])
    return tuple(
        Optimum(
            members[0].log_likelihood,
            members[0].parameters,
            members[0].std_errors,
            members[0].index,
            tuple(sorted(o.index for o in members)),
        )
        for members in groups
    )
