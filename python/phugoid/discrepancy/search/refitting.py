"""The second stage of the search: candidates fitted with the model, and replaced by others that explain more."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

from ..candidates.candidate import Candidate
from .evidence import Assessment
from .refit import Refit
from .refit_cache import RefitCache
from .screen import Screen

__all__ = ["Refitting", "RefittingSettings"]


@dataclass(frozen=True)
class RefittingSettings:
    """How terms compete.

    again   rivals that are refitted when a term is looked at again, of those with the greatest gains.
    alike   the same, of those whose effect is nearly the same.
    apart   estimates with a correlation below this are taken as independent.
    rounds  replacements at most.
    """

    again: int = 4
    alike: int = 3
    apart: float = 0.3
    rounds: int = 4


class Refitting:
    """Fits the model with candidates that a screen proposes."""

    def __init__(self, cache: RefitCache, screen: Screen, assessment: Assessment, settings: RefittingSettings) -> None:
        self._cache, self._screen, self._assessment, self.settings = cache, screen, assessment, settings

    def tries(self, at: Refit, simple: bool = False, times: int = 1) -> list[Refit]:
        """Return refits with one more candidate, of those that a screen proposes, ``times`` as many as usual, or of the
        simple ones."""
        chosen = self._screen.simple(at) if simple else self._screen.shortlist(at, times)
        return [t for t in self._cache.refits([[*at.candidates, c] for c in chosen], at.fit) if t is not None]

    def settled(self, at: Refit, rejected: Collection[str] = ()) -> Refit:
        """Return a refit with terms replaced by better ones where there are any, until nothing changes; without those
        that are no longer significant."""
        for _ in range(self.settings.rounds):
            following = next((r for r in self._better(at, rejected) if r is not at), at)
            if following is at:
                break
            at = following
        return at

    def _better(self, at: Refit, rejected: Collection[str]) -> Iterator[Refit]:
        """Yield, for each term, the best refit with another one, or with none, in its place; the last term first."""
        assess = self._assessment
        for candidate in reversed(at.candidates):
            others = [c for c in at.candidates if c is not candidate]
            if others and candidate is not at.candidates[-1] and self._apart(at, candidate, at.candidates[-1]):
                continue
            without = self._cache.refit(others, at.fit)
            if others and without is not None and assess.gain(without, at) < assess.threshold(candidate):
                yield without
            for r, _ in self.rivals(at, candidate):
                if r is at:
                    break
                if without is not None and assess.goes_before(without, at, r):
                    continue
                # Another must be significant itself, whatever the filter of the first makes of it.
                (new,) = r.beside(others)
                sure = without is None or assess.gain(without, r) > assess.needed(r, new)
                if sure and not any(n in rejected for n in r.names):
                    yield r
                    break

    def _apart(self, at: Refit, one: Candidate, other: Candidate) -> bool:
        """Tell whether the estimates of two candidates hardly depend on each other: none casts doubt on the other."""
        return at.own.correlation(one.parameters, other.parameters) < self.settings.apart

    def rivals(self, at: Refit, candidate: Candidate, fit: bool = True) -> list[tuple[Refit, float]]:
        """Refits with another in place of a candidate, and how much more likely they are through the same filter, less
        what the thresholds differ; the best first. Without ``fit`` those that are known already."""
        others = [c for c in at.candidates if c is not candidate]
        without = self._cache.refit(others, at.fit)
        if without is None:
            return [(at, 0.0)]
        filter, s, assess = at.own.filter, self.settings, self._assessment
        if fit:
            wanted = self._screen.rivals(without, candidate, filter, s.again, s.alike)
            self._cache.refits([[*others, c] for c in wanted], at.fit)
        refits = self._cache.with_one_more(others)
        reference = at.through(filter).log_likelihood - assess.penalty(at, others) / 2

        def margin(r: Refit) -> float:
            return 2.0 * (r.through(filter).log_likelihood - reference) - assess.penalty(r, others)

        pairs = [(r, 0.0 if r.names == at.names else margin(r)) for r in refits]
        if not any(r is at for r, _ in pairs):
            pairs.append((at, 0.0))
        return sorted(pairs, key=lambda pair: (-pair[1], pair[0] is not at))
