"""Named terms that are surrogates of something that no candidate describes, and whether residuals are a motion that the
model does not have, or noise of a sensor.

Of a misfit that has its cause outside of all candidates, the nearest of some hundred explains a part, significantly,
and data held out confirm that part. It is distinguished from a cause by the remaining residuals. Beside a cause they
are noise, or another cause is found; beside a surrogate they are a motion that the model does not have, larger than
what it explains.

A motion persists over the time in which the vehicle itself hardly moves, noise of a sensor does not. The prediction
from one sample to the next says less: of two records of one motion that with more samples is the better predicted,
and so is its noise where that is coloured. A lag in seconds, which follows from the fitted motion, is the same at any
sampling rate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...residual_noise import UniformSegment
from . import Search, SearchResult
from .confirmation import Found
from .refit import Refit
from .remainder import Remainder

__all__ = [
    "SurrogateSettings",
    "is_motion",
    "persistence",
    "without_surrogates",
]


_Array = NDArray[np.float64]

# Of the autocorrelation of a fitted output what it loses over the lag: a sine loses that in a sixth of a radian.
_LOST = 0.015


def is_motion(at: Refit, least: float) -> bool:
    """Return whether the residuals of any output persist so much, above the resolution of its sensor."""
    linear = at.linear
    for name, line, lasting in zip(linear.model.output_names, linear.rows, persistence(at), strict=True):
        power = float(np.mean(linear.residuals[line[0].start : line[-1].stop] ** 2))
        if power > linear.rounding[name] ** 2 and lasting > least:
            return True
    return False


def persistence(at: Refit) -> list[float]:
    """Return the autocorrelation of each output's residuals over a lag in which the fitted output keeps 98.5 %."""
    linear = at.linear
    return [
        _autocorrelation(linear.residuals, segments, _lag(at, name))
        for name, segments in zip(linear.model.output_names, linear.structure.segments, strict=True)
    ]


def _lag(at: Refit, output: str) -> float:
    """Return the lag, s, after which a fitted output differs from itself by so much; infinite where it never does."""
    records = at.fit.records
    step = min(float(np.median(np.diff(r.t))) for r in records)
    paths = [np.interp(np.arange(r.t[0], r.t[-1], step), r.t, r.outputs[output]) for r in records]
    spread = float(np.concatenate(paths).var())
    before = 0.0
    for k in range(1, max(p.size for p in paths)):
        change = np.concatenate([p[k:] - p[:-k] for p in paths if p.size > k])
        lost = float(np.mean(change**2)) / (2.0 * spread) if spread > 0.0 else 0.0
        if lost > _LOST:
            share = (_LOST - before) / (lost - before)
            return step * (k - 1 + share if k > 1 else float(np.sqrt(share)))
        before = lost
    return float("inf")


def _autocorrelation(residuals: _Array, segments: Sequence[UniformSegment], lag: float) -> float:
    """Return the autocorrelation of residuals (n_rows,) about zero over a lag, s: between whole numbers of steps by a
    straight line; within the first step by a parabola through the first two, for that of a motion begins so."""
    step = max(s.step for s in segments)
    steps = min(lag / step, max(s.size for s in segments) / 4.0)
    if steps < 1.0:
        one, two = (_at_lag(residuals, segments, k) for k in (1, 2))
        return one + (one - two) / 3.0 * (1.0 - steps**2)
    whole = int(steps)
    near, far = (_at_lag(residuals, segments, k) for k in (whole, whole + 1))
    return near + (steps - whole) * (far - near)


def _at_lag(residuals: _Array, segments: Sequence[UniformSegment], steps: int) -> float:
    """Return the autocorrelation at a number of steps, of all segments together."""
    grids = [s.on_grid(residuals[s.rows]) for s in segments]
    products = np.concatenate([np.zeros(0), *(g[steps:] * g[: g.size - steps] for g in grids if g.size > steps)])
    products = products[np.isfinite(products)]
    power = float(np.nanmean(np.concatenate(grids) ** 2))
    return float(products.mean()) / power if products.size and power > 0.0 else 0.0


@dataclass(frozen=True)
class SurrogateSettings:
    """Set what terms must explain beside residuals that are error of the model.

    most        part of the misfit that all named terms explain together beyond doubt, else something else is larger.
    sure        part of it that one term explains beyond doubt, beside which a likelier description of the rest is no
                better answer.
    persistent  autocorrelation of an output's residuals over a lag in which the output itself hardly moves, from which
                on they are a motion rather than noise of a sensor (`persistence`).
    """

    most: float = 0.5
    sure: float = 0.8
    persistent: float = 0.94


def without_surrogates(
    search: Search, result: SearchResult, remainder: Remainder | None, settings: SurrogateSettings | None = None
) -> tuple[SearchResult, Remainder | None]:
    """Return a search's result with terms that stand in for something else listed as surrogates, and in the full model
    alone; and what is left, but for a random disturbance that was found beside such terms: what these stand in for is
    in it."""
    s, final = settings or SurrogateSettings(), result.final
    named = [f for f in result.found if f.candidate is not None and f.candidate.name in final.names]
    if not named:
        return result, remainder
    unknown = remainder is not None and remainder.is_unknown
    if not (unknown or is_motion(final, s.persistent)):
        return result, remainder
    together = search.assessment.explained(search.cache.base, final)
    doubtful = together is None or together.interval[0] < s.most
    # A function that has no name is the better part of the answer where it is so much likelier.
    gain = remainder.gain if remainder is not None and unknown else -np.inf
    lost = {
        f.candidate.name
        for f in named
        if f.candidate is not None
        and ((doubtful and not _of_its_own(f, s.most)) or (f.gain < gain and not _is_sure(f, s.sure)))
    }
    if not lost:
        return result, remainder
    kept = search.cache.refit([c for c in final.candidates if c.name not in lost], final.fit)
    if remainder is not None and remainder.is_noise and not lost.isdisjoint(remainder.at.names):
        remainder = None
    return replace(result, final=kept or search.cache.base, surrogates=result.surrogates | lost), remainder


def _is_sure(found: Found, sure: float) -> bool:
    return found.explained is not None and found.explained.interval[0] >= sure


def _of_its_own(found: Found, most: float) -> bool:
    """Return whether a term of one output explains that much of the misfit there: what is wrong with the others is no
    business of a sensor's."""
    c = found.candidate
    if c is None or c.place.kind != "output" or found.explained is None:
        return False
    return found.explained.outputs.get(c.place.name, 0.0) >= most
