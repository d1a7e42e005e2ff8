"""The second and third stage of the search: candidates fitted with the model, and replaced by others that explain more;
which refit is confirmed by data held out, and its aliases.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..candidates.candidate import Candidate
from ..candidates.variation import CommonJump
from .admissibility import is_determined, is_physical
from .evidence import Assessment, Evidence
from .free_run import Explained
from .refit import HeldOut, Refit, is_structured
from .refit_cache import RefitCache
from .screen import RICH, Screen, complexity, is_as_good, is_equal, is_late

__all__ = [
    "Confirmation",
    "ConfirmationSettings",
    "Found",
    "Refitting",
    "RefittingSettings",
]


@dataclass(frozen=True)
class RefittingSettings:
    """How terms compete.

    again   alternatives that are refitted when a term is looked at again, of those with the greatest gains.
    alike   the same, of those whose effect is nearly the same.
    apart   estimates with a correlation below this are taken as independent.
    rounds  replacements at most.
    hopeless times what the last term gains in log-likelihood by which another is behind an earlier one without it: then
            it is not looked at again with it.
    simple  constants and linear terms, fitted whatever they gain to first order, that are then weighed: what leaves
            least.
    sure    standard errors that each of several parameters must change by that change at one time.
    """

    again: int = 4
    alike: int = 3
    apart: float = 0.3
    rounds: int = 4
    hopeless: float = 10.0
    simple: int = 12
    sure: float = 3.0


class Refitting:
    """Fits the model with candidates that a screen proposes."""

    def __init__(self, cache: RefitCache, screen: Screen, assessment: Assessment, settings: RefittingSettings) -> None:
        self._cache, self._screen, self._assessment, self.settings = cache, screen, assessment, settings

    def tries(self, at: Refit, simple: bool = False, times: int = 1) -> list[Refit]:
        """Return refits with one more candidate, of those that a screen proposes, ``times`` as many as usual, or of the
        simple ones."""
        chosen = self._screen.simple(at) if simple else self._screen.shortlist(at, times)
        refits = self._cache.refits([[*at.candidates, c] for c in chosen], at.fit, weighed=not simple)
        found = [self._with_sure_changes(t) for t in refits if t is not None]
        if simple:  # far from the fit what explains the misfit shows in the residuals themselves
            found = sorted(found, key=lambda t: -t.fit.log_likelihood)[: self.settings.simple]
            found = [t for t in found if self._cache.is_weighed(t)]
        return [t for t in found if self._assessment.is_admissible(at, t)]

    def _with_sure_changes(self, at: Refit) -> Refit:
        """Return the refit without parameters that change at a time with others by no more than their errors."""
        while isinstance(last := at.candidates[-1], CommonJump):
            sizes = at.parameters(last)
            sure = [c for c in last.coefficients if abs(sizes[c][0]) > self.settings.sure * sizes[c][1]]
            if len(sure) < 2 or len(sure) == len(last.coefficients):
                break
            fewer = self._cache.refit([*at.candidates[:-1], last.only(sure)], at.fit)
            if fewer is None:
                break
            self._cache.forget(at)
            at = fewer
        return at

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
            for r, _ in self.alternatives(at, candidate):
                if r is at:
                    break
                if without is not None and (assess.goes_before(without, at, r) or assess.is_worse(without, r, at)):
                    continue
                # Another must be significant itself, whatever the filter of the first makes of it.
                (new,) = r.beside(others)
                sure = without is None or assess.gain(without, r) > assess.needed(r, new)
                if sure and not any(n in rejected for n in r.names):
                    yield r
                    break

    def _is_hopeless(self, at: Refit, candidate: Candidate, other: Candidate) -> bool:
        """Return whether without the last term another candidate is behind the one that it would replace by many times
        of what the last term gains beside that."""
        if len(at.candidates) < 2 or candidate is at.candidates[-1]:
            return False
        before = at.candidates[:-1]
        instead = [other if c is candidate else c for c in before]
        first, second = self._cache.known(before), self._cache.known(instead)
        if first is None or second is None:
            return False
        behind, gained = (a.fit.log_likelihood - b.fit.log_likelihood for a, b in ((first, second), (at, first)))
        return behind > self.settings.hopeless * gained

    def _apart(self, at: Refit, one: Candidate, other: Candidate) -> bool:
        """Return whether the estimates of two candidates hardly depend on each other: none casts doubt on the other."""
        return at.own.correlation(one.parameters, other.parameters) < self.settings.apart

    def alternatives(self, at: Refit, candidate: Candidate, fit: bool = True) -> list[tuple[Refit, float]]:
        """Refits with another in place of a candidate, and how much more likely they are through the same filter, less
        what the thresholds differ; the best first. Without ``fit`` those that are known already."""
        others = [c for c in at.candidates if c is not candidate]
        without = self._cache.refit(others, at.fit)
        if without is None:
            return [(at, 0.0)]
        filter, s, assess = at.own.filter, self.settings, self._assessment
        if fit:
            wanted = self._screen.alternatives(without, candidate, filter, s.again, s.alike)
            wanted = [c for c in wanted if not self._is_hopeless(at, candidate, c)]
            self._cache.refits([[*others, c] for c in wanted], at.fit)
        refits = [r for r in self._cache.with_one_more(others) if self._is_admitted(without, r, at, candidate)]
        reference = at.through(filter).log_likelihood - assess.penalty(at, others) / 2

        def margin(r: Refit) -> float:
            return 2.0 * (r.through(filter).log_likelihood - reference) - assess.penalty(r, others)

        pairs = [(r, 0.0 if r.names == at.names else margin(r)) for r in refits]
        if not any(r is at for r, _ in pairs):
            pairs.append((at, 0.0))
        return sorted(pairs, key=lambda pair: (-pair[1], pair[0] is not at))

    def _is_admitted(self, without: Refit, other: Refit, at: Refit, candidate: Candidate) -> bool:
        """Return whether another refit takes part. What is exactly as likely as a force follows no noise of a sensor,
        for a force follows none."""
        if self._assessment.is_admissible(without, other):
            return True
        if candidate.place.kind not in ("equation", "quantity") or not is_equal(at, other):
            return False
        return all(is_determined(other, c) for c in other.beside(without.candidates))


# Part of the misfit of other data that is most of it.
_MOST = 0.5


@dataclass(frozen=True)
class ConfirmationSettings:
    """Set how far the confirmation goes.

    chances  next best candidates that are tried when the best gains nothing on held-out data.
    ringing  candidates that are refitted where residuals ring.
    vuong    an alternative is an alias unless Vuong's test distinguishes them by this, or it has less than half of the
             gain in log-likelihood and is ``far`` behind.
    equal    log-likelihood by which one may be behind that is the same, however certain that is.
    richer   log-likelihood by which one with more unknowns must be ahead to be an alias.
    left     times as much of the misfit that a term may leave that stands in place of one with more unknowns.
    alias    part of what a cause explains that an alternative explains, too, be it clearly less in free simulation.
    noise    part of the residuals' power that their past predicts, below which they pass for noise.
    beyond   log-likelihood by which an alternative that acts alike to first order may be behind where they do, and an
             alternative that is worse in free simulation on data held out.
    """

    chances: int = 3
    ringing: int = 2
    vuong: float = 2.0
    far: float = 30.0
    equal: float = 0.5
    richer: float = 6.0
    left: float = 1.1
    least: float = 0.01
    alias: float = 0.9
    noise: float = 0.05
    beyond: float = 8.0


@dataclass(frozen=True, eq=False)
class Found:
    """A candidate that was accepted, or a misfit that none explains (``candidate`` None).

    ringing   Hz, of modes of the model at which the residuals ring, where that is what none explains beyond doubt.
    gain      in log-likelihood over the model with the other candidates.
    threshold that it had to pass.
    alternatives    those that the data do not distinguish from it: name -> gain they would have instead, the likeliest
                    first.
    explained the part of the misfit that it explains in free simulation of held-out data, beside the others.
    alternatives_explained   the same of the alternatives, in its place.
    of_the_rest        the part that a minor one explains of the misfit that the others leave; NaN else.
    """

    candidate: Candidate | None
    gain: float
    threshold: float
    alternatives: Mapping[str, float]
    held_out: HeldOut
    ringing: tuple[float, ...] = ()
    explained: Explained | None = None
    alternatives_explained: Mapping[str, float] = field(default_factory=dict)
    of_the_rest: float = math.nan


class Confirmation:
    """Confirms refits, one candidate after the other."""

    def __init__(
        self,
        cache: RefitCache,
        screen: Screen,
        refitting: Refitting,
        assessment: Assessment,
        settings: ConfirmationSettings,
    ) -> None:
        self._cache, self._screen, self._refitting = cache, screen, refitting
        self._assessment, self.settings = assessment, settings
        # Of terms that were accepted, when they were.
        self.evidence: dict[str, Evidence] = {}

    def accepted(self, current: Refit, tries: Sequence[Refit]) -> tuple[Refit | None, Found | None]:
        """Return, of refits with one more term, the one whose new term is a finding, settled; else what remains
        unexplained, if anything does.

        Refits that simulate held-out data clearly worse than the best one does come last, whatever their likelihood
        with coloured noise; and drifts and disturbances after terms that other records confirm.
        """
        assess = self._assessment
        margins = {t.names: assess.margin(current, t) for t in tries}

        def urgency(t: Refit) -> float:
            # What is outside of what is physical stands in for something else: that is tried first.
            last = t.candidates[-1]
            return margins[t.names] - (0.0 if is_physical(t, last) else assess.needed(t, last))

        significant = sorted((t for t in tries if margins[t.names] > 0), key=lambda t: -urgency(t))
        behind = self._behind(current, significant)
        after = {t.names for t in significant if any(assess.goes_before(current, o, t) for o in significant)}
        significant.sort(key=lambda t: (t.names in behind) + (t.names in after))
        unexplained, chances = None, self.settings.chances
        rejected: set[str] = set()
        known: set[str] = set()
        for t in significant:
            if not chances:
                break
            if t.candidates[-1].name in rejected:
                continue
            settled = self._refitting.settled(t, rejected)
            new = settled.beside(current.candidates)
            kept = [c for c in settled.candidates if c.name in current.names]
            below = self._cache.refit(kept, settled.fit)
            # With the new term an earlier one may have become needless: then the two sets compete.
            fewer = len(kept) < len(current.candidates) and settled.own.merit <= current.own.merit
            if not new or below is None or fewer:
                continue
            evidence = assess.weigh(below, settled, new[0])
            if evidence.accepted:
                found = self.simplest(below, settled, new[0])
                if self._is_progress(current, found) and self._is_credible(current, found):
                    self.evidence |= dict.fromkeys((c.name for c in found.beside(current.candidates)), evidence)
                    return found, None
                continue
            if evidence.held_out is None:  # it is not even significant
                continue
            rejected |= {c.name for c in new}
            # What acts as another did is no further chance: of two that are alike one may still predict.
            chances -= not known.issuperset(c.name for c in new)
            known |= {a.name for c in new for a in self._screen.alike(current, c, settled.own.filter)}
            # A walk of a sensor is coloured noise: nothing about it is unexplained.
            if unexplained is None and evidence.gain > evidence.clear and not evidence.random_walk:
                alternatives = {c.name: evidence.gain / 2 for c in new}
                unexplained = Found(None, evidence.gain / 2, evidence.threshold / 2, alternatives, evidence.held_out)
        return None, unexplained

    def _is_progress(self, current: Refit, found: Refit) -> bool:
        """Return whether a refit has more than the current one: what explains next to nothing displaces no earlier
        finding, unless it explains most of what that leaves, or is likelier with plainer terms: a derivative of the
        input and one of a rate act together like the input with a lag."""
        names, assess = {*current.names}, self._assessment
        if names <= {*found.names}:
            return len(found.names) > len(names)
        if self._is_plainer(current, found) and found.merit > current.merit + self.settings.richer:
            return True
        explained = assess.explained(current, found)
        if explained is not None and explained.significant and explained.part > assess.settings.minor:
            return True
        return assess.explains_what_is_left(current, found)

    def _is_credible(self, current: Refit, found: Refit) -> bool:
        """Return whether the new terms of a refit are within what is physical, or explain more than a minor finding
        does: in what others leave, little is explained best by terms that no vehicle has."""
        if all(is_physical(found, c) for c in found.beside(current.candidates)):
            return True
        explained = self._assessment.explained(current, found)
        return explained is None or explained.part > self._assessment.settings.minor

    @staticmethod
    def _is_plainer(current: Refit, found: Refit) -> bool:
        """Return whether the terms that a refit has instead of those of another are plainer, with no more unknowns."""
        new, gone = found.beside(current.candidates), current.beside(found.candidates)
        unknowns = [sum(len(c.parameters) for c in terms) for terms in (new, gone)]
        return unknowns[0] <= unknowns[1] and max(map(complexity, new), default=-1) < min(map(complexity, gone))

    def _behind(self, current: Refit, tries: Sequence[Refit]) -> Collection[tuple[str, ...]]:
        """Return the names of refits that simulate held-out data clearly worse than the best of them does."""
        parts = {t: e.part for t in tries if (e := self._assessment.explained(current, t)) is not None}
        if not parts:
            return set()
        best = max(parts, key=lambda t: parts[t])
        return {t.names for t in tries if t not in parts or self._assessment.is_worse(current, t, best)}

    def simplest(self, below: Refit, at: Refit, candidate: Candidate) -> Refit:
        """Return a refit with the simplest term in place of a candidate that explains the data as well."""
        others, assess, rank = below.candidates, self._assessment, complexity(candidate)
        model = self._cache.base.fit.model
        constants = [c for c in self._cache.candidates if c.place == candidate.place and not complexity(c)]
        alike = [*self._screen.alike(below, candidate, at.own.filter), *constants]
        simpler = {c.name: c for c in alike if complexity(c) < rank}
        self._cache.refits([[*others, c] for c in simpler.values()], at.fit)
        gain, explained = assess.gain(below, at), assess.explained(below, at)
        if explained is None:
            return at

        def stands(r: Refit) -> bool:
            (new,) = r.beside(others)
            if complexity(new) >= rank or not is_physical(r, new) or is_late(new, model):
                return False
            if not assess.is_admissible(below, r):
                return False
            own = assess.gain(below, r)
            if own <= assess.needed(r, new):
                return False
            part = assess.explained(below, r)  # what it explains takes a fit to the data held out
            if part is None:
                return False
            # More unknowns leave a little less of any misfit.
            allowed = max(self.settings.left * (1.0 - explained.part), self.settings.least)
            if rank == RICH and 1.0 - part.part < allowed:
                return True
            return is_as_good(at, r, own / gain, (explained.part, part.part)) and not assess.is_worse(below, r, at)

        found = [r for r in self._cache.with_one_more(others) if stands(r)]
        return min(found, key=lambda r: (complexity(r.beside(others)[0]), -r.own.merit), default=at)

    def ringing(self, current: Refit) -> Found | None:
        """Return a misfit that noise with the autocorrelation of the residuals would hide: they ring, and candidates
        that explain them with noise that does not ring halve them on validation data."""
        ringing, assess = self._cache.ringing(current), self._assessment
        if ringing is None or not self._cache.validation:
            return None
        chosen = self._screen.lasting(current, ringing.filter, self.settings.ringing)
        self._cache.refits([[*current.candidates, c] for c in chosen], current.fit)
        margins = {}
        for t in self._cache.with_one_more(current.candidates):
            (new,) = t.beside(current.candidates)
            if new.transferable:
                margins[t] = assess.steady_gain(current, t) - assess.penalty(t, current.candidates)
        likely = [t for t in sorted(margins, key=lambda t: -margins[t])[: self.settings.chances] if margins[t] > 0.0]
        better = [t for t in likely if assess.halves(current, t) and assess.predicts(assess.held_out(current, t))]
        if not better:
            return None
        gains = {t.beside(current.candidates)[0].name: assess.steady_gain(current, t) / 2 for t in better}
        gain, held = next(iter(gains.values())), assess.held_out(current, better[0])
        return Found(None, gain, assess.threshold() / 2, gains, held, ringing.frequencies)

    def explained(self, at: Refit, candidate: Candidate) -> Explained | None:
        """Return what a term explains beside the others of a refit."""
        return self._assessment.explained(self._without(at, candidate), at)

    def of_the_rest(self, at: Refit, candidate: Candidate, explained: Explained | None) -> float:
        """Return the part that a term explains of the misfit that the others of a refit leave; NaN where it is alone or
        explains more of all than a minor finding, where all together leave more than noise: then it may represent
        a part of what is still missing; and of what other records do not have, which cannot confirm it."""
        if len(at.candidates) < 2 or not candidate.transferable or not self._assessment.is_minor(explained):
            return math.nan
        if is_structured(at, self._assessment.settings.error):
            return math.nan
        return self._assessment.of_what_is_left(self._without(at, candidate), at)

    def _without(self, at: Refit, candidate: Candidate) -> Refit:
        others = [c for c in at.candidates if c.name != candidate.name]
        return self._cache.refit(others, at.fit) or self._cache.base

    def found(self, at: Refit, candidate: Candidate, named: bool) -> Found:
        """Return what is reported of a term in the end; alternatives of one that is not named are those that are
        known."""
        assess = self._assessment
        others, without = [c for c in at.candidates if c is not candidate], self._without(at, candidate)
        filter = at.own.filter
        mine = at.through(filter).log_densities
        alike = {c.name for c in self._screen.alike(without, candidate, filter)}
        alternatives, parts = {}, {}
        own, held = assess.explained(without, at), assess.held_out(without, at)
        # Where a term leaves nothing but noise, likelihoods show what the first order does not.
        clean = not is_structured(at, self.settings.noise)
        confirmed = bool(self._cache.validation) and candidate.transferable and own is not None and own.part > _MOST
        for r, _ in self._refitting.alternatives(at, candidate, fit=named):
            if r.names == at.names:
                continue
            (other,) = r.beside(others)
            # What other data confirm is not the same as what could be of this record alone.
            if confirmed and not other.transferable:
                continue
            d = mine - r.through(filter).log_densities
            d = d[np.isfinite(d)]
            gain = assess.gain(without, r) / 2
            # One with more unknowns can always be as good.
            richer = complexity(other) == RICH > complexity(candidate)
            whole = assess.gain(without, at) / 2
            if richer and gain < whole + self.settings.richer:
                continue
            # The test says little where few samples distinguish the two: this much less is no matter of chance.
            if gain < 0.5 * whole and whole - gain > self.settings.far:
                continue
            like = other.name in alike and gain > 0.5 * whole and not (clean and d.sum() > self.settings.beyond)
            apart = max(self.settings.vuong * float(np.sqrt(d.size) * d.std()), self.settings.equal)
            if not like and float(d.sum()) >= apart:
                continue
            explained = assess.explained(without, r)  # last, for it takes a fit to the data held out
            much = explained is None or own is None or explained.part > self.settings.alias * own.part
            # Two kinds of evidence are needed to distinguish them: coloured noise is part of what is simulated freely.
            behind = held.gain - assess.held_out(without, r).gain
            if not (like and much) and behind > self.settings.beyond and assess.is_worse(without, r, at):
                continue
            alternatives[other.name] = gain
            if explained is not None:
                parts[other.name] = explained.part
        return Found(
            candidate,
            assess.gain(without, at) / 2,
            assess.needed(at, candidate) / 2,
            alternatives,
            held,
            explained=own,
            alternatives_explained=parts,
            of_the_rest=self.of_the_rest(at, candidate, own),
        )
