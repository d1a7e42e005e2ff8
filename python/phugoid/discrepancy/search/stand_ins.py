"""Named terms that stand in for something that no candidate describes.

Of a misfit that has its cause outside of all candidates, the nearest of some hundred explains a part, significantly,
and data held out confirm that part. What tells it from a cause is what it leaves. Beside a cause noise is left, or
another cause is found; a stand-in leaves a motion that the model does not have, larger than what it explains.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .confirmation import Found
from .motion import is_motion
from .remainder import Remainder
from .search import Search, SearchResult

__all__ = ["StandInSettings", "without_stand_ins"]


@dataclass(frozen=True)
class StandInSettings:
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


def without_stand_ins(
    search: Search, result: SearchResult, remainder: Remainder | None, settings: StandInSettings | None = None
) -> tuple[SearchResult, Remainder | None]:
    """Return a search's result with terms that stand in for something else listed as surrogates, and in the full model
    alone; and what is left, but for a random disturbance that was found beside such terms: what these stand in for is
    in it."""
    s, final = settings or StandInSettings(), result.final
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
    """Tell whether a term of one output explains that much of the misfit there: what is wrong with the others is no
    business of a sensor's."""
    c = found.candidate
    if c is None or c.place.kind != "output" or found.explained is None:
        return False
    return found.explained.outputs.get(c.place.name, 0.0) >= most
