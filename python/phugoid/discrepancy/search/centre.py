"""The centre of a function of one variable, or of a limit, estimated."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...residual_noise.whitening import Filter
from ..candidates.candidate import Candidate, Effect, has_unknown_centre, is_limit
from .refit import Refit, refit

__all__ = ["about_own_centre", "about_zero"]

# Of a trim that is estimated, in parts of the range of the variable: the step of the derivative, the longest step of
# the estimate; steps; and the gain in log-likelihood of a step that ends it.
_CENTRE_STEP, _FARTHEST_CENTRE, _CENTRINGS, _SETTLED = 0.02, 0.3, 8, 0.5


def about_own_centre(
    base: Refit, at: Refit, candidate: Candidate, least: float, filter: Filter, watch: Callable[[str], None]
) -> Refit:
    """Return the refit with a candidate about the centre that the data ask for, where that is a function about a
    trim that is not known, or a limit on either side of one, and gains more than ``least`` in log-likelihood so;
    else the refit as it is. ``filter`` is that of the noise: what a wrong centre leaves may be slow, and hide in a
    noise model made with it.

    The derivative by the centre is that of the function. With the trim a little off the rest would pass for another
    function of the same variable: c (x - a)|x - a| about 0 leaves -2 c a |x|.
    """
    needed = least
    for _ in range(_CENTRINGS):
        if not isinstance(candidate, Effect) or not (has_unknown_centre(candidate) or is_limit(candidate)):
            break
        step, gain = _centre_step(at, candidate, filter)
        if gain < needed:
            break
        farthest = _FARTHEST_CENTRE * candidate.scales.span(*candidate.variables)
        moved = candidate.moved(float(np.clip(step, -farthest, farthest)))
        if not moved.is_apt:
            break
        watch(f"fitting with {candidate.name} about another trim")
        found = refit(base.fit, [*at.beside([candidate]), moved], {}, at.fit, base.linear.points)
        if found is None or found.merit < at.merit + needed:
            break
        at, candidate, needed = found, moved, _SETTLED
    return at


def about_zero(base: Refit, at: Refit, candidate: Candidate, watch: Callable[[str], None]) -> Refit | None:
    """Return the refit with a function about zero, such as a rate of reaction or a drag has; None where zero is far
    from the record."""
    if not isinstance(candidate, Effect) or not has_unknown_centre(candidate):
        return None
    (name,) = candidate.variables
    if not candidate.scales.reaches_zero(name):
        return None
    moved = candidate.moved(-candidate.scales.centre(name))
    watch(f"fitting with {candidate.name} about zero")
    return refit(base.fit, [*at.beside([candidate]), moved], {}, at.fit, base.linear.points)


def _centre_step(at: Refit, candidate: Effect, filter: Filter) -> tuple[float, float]:
    """Return by how much the data ask the centre of a function to be moved, to first order, and the gain in
    log-likelihood by that; ``filter`` is that of the noise."""
    linear = at.linear
    moved = candidate.moved(_CENTRE_STEP * candidate.scales.span(*candidate.variables))
    step = moved.scales.centre(*moved.variables) - candidate.scales.centre(*candidate.variables)
    shape = {n: at.fit.parameters[n].value for n in candidate.shape_names}
    size = at.fit.parameters[candidate.coefficients[0]].value if candidate.coefficients else 1.0
    if not linear.reaches(candidate.place):
        return 0.0, 0.0
    signals = [size * (moved.signals(p, shape) - candidate.signals(p, shape)) for p in linear.points]
    seen = at.through(filter)
    (column,) = seen.beside(linear.answers(candidate.place, signals))
    power = max(float(column @ column), 1e-300)
    part = float(column @ seen.errors) / power
    return part * step, 0.5 * part * part * power
