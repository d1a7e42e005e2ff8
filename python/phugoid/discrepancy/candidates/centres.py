"""Candidates that act about a trim, about other trims too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .along import of
from .candidate import Candidate
from .effect import Effect
from .points import Points

__all__ = ["with_other_centres"]

# Centres of powers differ when they are further apart than this part of a variable's range.
_NEAR = 0.05


def with_other_centres(candidates: Sequence[Candidate], points: Sequence[Points]) -> list[Candidate]:
    """Candidates; and those that are centred at a trim once more about zero, where it lies within the record, and about
    the first values.

    A record does not say where its trim is: the scan does.
    """
    found: list[Candidate] = []
    for c in candidates:
        found.append(c)
        if not (isinstance(c, Effect) and c.centred):
            continue
        scales, tried = c.scales, [[c.scales.centre(n) for n in c.variables]]
        zero = [0.0 if scales.crosses(n) else scales.centre(n) for n in c.variables]
        first = [
            float(np.mean([of(p.values, n, p, "state, input or quantity")[0] for p in points])) for n in c.variables
        ]
        for centres in (zero, first):
            far = [
                any(abs(a - b) > _NEAR * scales.span(n) for a, b, n in zip(centres, t, c.variables, strict=True))
                for t in tried
            ]
            if all(far):
                tried.append(centres)
                trim = {**scales.trim, **dict(zip(c.variables, centres, strict=True))}
                found.append(c.on(replace(scales, trim=trim)))
    return found
