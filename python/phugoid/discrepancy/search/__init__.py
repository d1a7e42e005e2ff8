"""The search for what is missing: screen, refit, confirm, until nothing significant is left."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product

import numpy as np

from ...data.experiment import Experiment
from ...errors import joined
from ...sensitivities.linearised import Linearised
from ...time_unit import TimeUnit
from ..candidates.candidate import Candidate, Effect, added_by_centre
from .admissibility import is_free_motion, is_physical, is_plausible
from .centre import about_own_centre, about_zero
from .confirmation import Confirmation, ConfirmationSettings, Found, Refitting, RefittingSettings
from .evidence import Assessment, AssessmentSettings
from .finding import ExtensionResult, Gain
from .refit import HeldOut, Refit, is_structured
from .refit_cache import RefitCache
from .screen import Screen, ScreenSettings, complexity, is_equal, plausibility

__all__ = [
    "Search",
    "SearchResult",
    "SearchSettings",
]


@dataclass(frozen=True)
class SearchSettings:
    """Settings of all stages, and ``most`` findings: what is left then is for another diagnosis, of the extended
    model. The search ends after ``minor`` steps one after the other that explain next to nothing. Where the screen
    proposes nothing that is confirmed, though the part ``error`` of the residuals' power is predictable, constants and
    linear terms are tried all, and where the part ``doubt`` is, twice as many as the screen proposes, and those that
    are confirmed beside one of the ``pairs`` likeliest that are not. Where no more
    than ``structure`` is predictable, nothing is unexplained. The trim of a function of one variable is estimated where
    that gains more than ``centre`` in log-likelihood, and with it a term less is as good within ``same``.
    A cause gives way to another one that is ahead of it by ``ahead`` in twice the log-likelihood beside the others, and
    one whose size is not physical to one that explains the part ``nearly`` of what it does."""

    screen: ScreenSettings = field(default_factory=ScreenSettings)
    refitting: RefittingSettings = field(default_factory=RefittingSettings)
    confirmation: ConfirmationSettings = field(default_factory=ConfirmationSettings)
    assessment: AssessmentSettings = field(default_factory=AssessmentSettings)
    most: int = 4
    minor: int = 2
    pairs: int = 2
    error: float = 0.5
    doubt: float = 0.3
    structure: float = 0.05
    half: float = 0.5
    centre: float = 8.0
    same: float = 3.0
    ahead: float = 6.0
    nearly: float = 0.9


@dataclass(frozen=True, eq=False)
class SearchResult:
    """Hold what a search found.

    final        the model with all causes that are named, fitted.
    found        what that is, minor findings and surrogates beside it, and a misfit that nothing explains.
    full         the model with minor findings and surrogates too.
    remarks      what is to be said of it, in words.
    interrupted  whether the search was ended early.
    surrogates   name of a term that stands in for something that no candidate describes -> what shows it, in words.
    """

    final: Refit
    full: Refit
    found: tuple[Found, ...] = ()
    remarks: tuple[str, ...] = ()
    interrupted: bool = False
    surrogates: Mapping[str, str] = field(default_factory=dict)

    def of(self, candidate: Candidate) -> Refit:
        """Return the refit that a finding is reported from."""
        return self.final if candidate.name in self.final.names else self.full


class Search:
    """A search at a base fit, by three stages that share what is known of sets of candidates."""

    def __init__(
        self,
        base: Refit,
        candidates: Sequence[Candidate],
        validation: Sequence[Experiment] = (),
        watch: Callable[[str], None] = lambda _: None,
        biases: Sequence[str] | None = None,
        settings: SearchSettings | None = None,
        diagnosed: tuple[Refit, Linearised | None] | None = None,
    ) -> None:
        self.settings = s = settings or SearchSettings()
        self._listed = candidates
        self.cache = RefitCache(base, candidates, validation, watch, biases, diagnosed)
        self.assessment = Assessment(self.cache, s.assessment)
        self.screen = Screen(self.cache, self.assessment.threshold, s.screen)
        self.refitting = Refitting(self.cache, self.screen, self.assessment, s.refitting)
        self.confirmation = Confirmation(self.cache, self.screen, self.refitting, self.assessment, s.confirmation)

    def on(
        self,
        base: Refit,
        validation: Sequence[Experiment] | None = None,
        biases: Sequence[str] | None = None,
        diagnosed: tuple[Refit, Linearised | None] | None = None,
    ) -> Search:
        """Return the same search at another fit; with other data held out, other biases, and another model whose misfit
        is diagnosed, where they are given."""
        cache = self.cache
        data, free = cache.validation if validation is None else validation, cache.biases if biases is None else biases
        search = Search(base, self._listed, data, cache.watch, free, self.settings, diagnosed or cache.diagnosed)
        search.cache.proposed = cache.proposed
        return search

    def propose(self, near: Refit, candidates: Sequence[Candidate]) -> None:
        """Have the candidates that do most to first order about a fit whose motion is nearer to the records refitted,
        too, and begun there."""
        there = Search(near, candidates, watch=self.cache.watch, settings=self.settings)
        self.cache.proposed = {c.name: there.cache.start(c.name) for c in there.screen.plainest(near)}

    def without_noise(self, base: Refit, validation: Sequence[Experiment]) -> Search:
        """Return the same search on records whose inputs were freed of noise: what is left of that is still part of the
        misfit of the model that was diagnosed."""
        cache = self.cache
        return self.on(base, validation, diagnosed=cache.diagnosed or (cache.base, cache.on_validation(cache.base)))

    def run(self) -> SearchResult:
        """Screen, refit and confirm, one term after the other."""
        at = [self.cache.base]
        try:
            result = self._ended(at, self._searched(at))
            if not self._stands_in(result):
                return result
            # What fits there stands in for something else, which to first order need not show: the fit may be far off
            # in its parameters.
            others = [self.cache.base]
            first = self._plain(others[0])
            if first is None or first.names == result.full.names[: len(first.names)]:
                return result
            others.append(first)
            other = self._ended(others, self._searched(others))
            return other if not self._stands_in(other) else result
        except KeyboardInterrupt:
            return self._interrupted(at[-1])

    def _stands_in(self, result: SearchResult) -> bool:
        """Return whether terms fit that are not named, and those that are named do less than half of what the model is
        wrong by."""
        base, full, final = self.cache.base, result.full, result.final
        if full.names == final.names or not is_structured(base, self.settings.error):
            return False
        return self.named_part(final) < self.settings.half

    def named_part(self, final: Refit) -> float:
        """Return the part of the misfit that named terms explain together; 0 where there are none, or that is not
        known."""
        part = self.assessment.explained(self.cache.base, final) if final.names else None
        return 0.0 if part is None else part.part

    def _searched(self, steps: list[Refit]) -> Found | None:
        """Append refits with one term more each, as long as one is accepted; return what remains unexplained."""
        unexplained = None
        seen: set[tuple[str, ...]] = set()
        minor = 0
        while len((current := steps[-1]).candidates) < self.settings.most:
            tries = self.refitting.tries(current)
            following, unexplained = self.confirmation.accepted(current, tries)
            if following is None and not current.candidates and is_structured(current, self.settings.error):
                # What a candidate does to first order says little of what a fit with it does.
                following = self._plain(current)
            elif following is not None and not current.candidates and self._is_beyond_reason(following):
                plain = self._plain(current)
                if plain is not None and not self._is_beyond_reason(plain):
                    following = following if self.assessment.is_worse(current, plain, following) else plain
            if following is None and is_structured(current, self.settings.doubt):
                further, _ = self.confirmation.accepted(current, self.refitting.tries(current, times=2))
                # Only causes are searched for so far, no minor findings.
                following = further if further is not None and not self._is_minor(current, further) else None
                following = following or self._pair(current, tries)
            if following is None or following.names in seen:
                break
            seen.add(following.names)
            # Beside a term that is not the cause the next one may not show.
            following = self._of_physical_size(self._centred(following))
            minor = minor + 1 if self._is_minor(current, following) else 0
            steps.append(following)
            if minor == self.settings.minor:  # what comes next would be less
                break
        return unexplained

    def _pair(self, current: Refit, tries: Sequence[Refit]) -> Refit | None:
        """Return the refit with two more terms that are confirmed together, where none of the refits with one is
        confirmed alone; None where there are none. Of two causes one may hide the other: a lag of a sensor is what
        coloured noise does not explain, and simulates no better as long as a large error of the forces is in the
        simulation, which coloured noise explains.
        """
        likely = [t for t in tries if t.candidates[-1].transferable]
        margins = {t.names: self.assessment.margin(current, t) for t in likely}
        likely = [t for t in likely if margins[t.names] > 0.0 and is_physical(t, t.candidates[-1])]
        for first in sorted(likely, key=lambda t: -margins[t.names])[: self.settings.pairs]:
            found, _ = self.confirmation.accepted(first, self.refitting.tries(first))
            if found is not None and len(found.beside(current.candidates)) == 2 and not self._is_minor(current, found):
                return found
        return None

    def _centred(self, at: Refit) -> Refit:
        """Return the refit with its last function of a variable about the trim that the data ask for; without a term
        that was needed only since a function was about another trim, as a constant beside a square."""
        square = self._as_square(at)
        if square is not None:
            return square
        last = at.candidates[-1]
        # The square about another centre adds a linear term, which may be missing in its own right.
        tried = [(at, last)] if getattr(last, "family", "") != "square" else []
        for c, other in [(c, o) for c in at.candidates for o in at.candidates if added_by_centre(c, o)]:
            fewer = self.cache.refit([o for o in at.candidates if o is not other], at.fit)
            tried += [(fewer, c)] if fewer is not None else []
        least = at.merit - self.settings.same
        for begun, c in tried:
            found = about_zero(self.cache.base, begun, c, self.cache.watch) if begun is not at else None
            if found is None or found.merit < least:
                found = about_own_centre(
                    self.cache.base, begun, c, self.settings.centre, at.own.filter, self.cache.watch
                )
            if found is not begun and found.merit > least:
                assert isinstance(c, Effect)
                self.cache.adopt(found, c)
                return found
        return at

    def _as_square(self, at: Refit) -> Refit | None:
        """Return the refit with the square of a variable in place of a constant and x|x| on one side of its trim, where
        it is as good: both are a square."""
        effects = [c for c in at.candidates if isinstance(c, Effect)]
        for constant, bent in product(effects, effects):
            if (constant.family, bent.family) != ("bias", "quadratic"):
                continue
            wanted = "square", bent.place, bent.variables
            known = [c for c in self.cache.candidates if isinstance(c, Effect) and c.name not in at.names]
            square = next((c for c in known if (c.family, c.place, c.variables) == wanted), None)
            if square is None:
                continue
            found = self.cache.refit([*at.beside([constant, bent]), square], at.fit)
            if found is not None and found.merit > at.merit - self.settings.same:
                return found
        return None

    def _with_stall(self, at: Refit) -> Refit:
        """Return the refit with stall in place of all terms with the angle of attack in the same place, where it is
        likelier by more than it has unknowns: powers of the angle, which are simpler, stand for a part of it each."""
        for c in [c for c in self.cache.candidates if isinstance(c, Effect) and c.family == "stall"]:
            effects = [o for o in at.candidates if isinstance(o, Effect)]
            own = [o for o in effects if o.place == c.place and c.variables[0] in o.variables]
            if not own or c.name in at.names:
                continue
            # From the fit of the base: that with the other terms is at another optimum.
            found = self.cache.refit([*at.beside(own), c])
            if found is None or not is_physical(found, c):
                continue
            if found.merit - self.chances(found) > at.merit - self.chances(at):
                at = found
        return at

    def _plain(self, at: Refit) -> Refit | None:
        """Return the refit with one more constant or linear term, of all that there are, that is confirmed."""
        return self.confirmation.accepted(at, self.refitting.tries(at, simple=True))[0]

    def _is_beyond_reason(self, at: Refit) -> bool:
        """Return whether a term has a size that is not physical: about a fit that is far off in its parameters it may
        undo that."""
        return any(not is_physical(at, c) for c in at.candidates)

    def _ended(self, steps: list[Refit], unexplained: Found | None) -> SearchResult:
        """Return the result of a search of some steps."""
        current = self._pruned(self._with_stall(steps[-1]))
        if not is_structured(current, self.settings.structure):
            unexplained = None  # what is left passes for noise
        unexplained = unexplained or self.confirmation.ringing(current)
        left = self.cache.ringing(current) if not (unexplained and unexplained.ringing) else None
        remarks = [_rest_rings(left.frequencies, current.fit.model.time_unit)] if left else []
        if self.assessment.fed_back:
            remarks.append(_fed_back([*self.assessment.fed_back]))
        return self.concluded(current, unexplained, tuple(remarks))

    def _interrupted(self, current: Refit) -> SearchResult:
        """Return what had been accepted, by the evidence of that time: beside what came later it may be other."""
        nan = float("nan")
        found = []
        for c in current.candidates:
            e = self.confirmation.evidence.get(c.name)
            needed = self.assessment.threshold(c) / 2
            if e is None or e.held_out is None:
                found.append(Found(c, nan, needed, {}, HeldOut(nan, 0.0, nan)))
            else:
                found.append(Found(c, e.gain / 2, needed, {}, e.held_out, explained=e.explained))
        weak = {f.candidate.name for f in found if f.candidate and self.assessment.is_minor(f.explained)}
        final = self.cache.known([c for c in current.candidates if c.name not in weak])
        return SearchResult(final or current, current, tuple(found), interrupted=True)

    def chances(self, at: Refit) -> float:
        """Return the log-likelihood that a refit's terms must gain, as many as were tried."""
        return sum(self.assessment.needed(at, c) for c in at.candidates) / 2.0

    def concluded(self, at: Refit, unexplained: Found | None = None, remarks: tuple[str, ...] = ()) -> SearchResult:
        """Return what is reported of a refit's terms, and of a misfit that none explains.

        Terms that are not named and make the simulation of data held out no better are not reported.
        """
        at = self._centred(at) if at.candidates else at
        at = self._of_physical_size(at)
        at = self._preferred(at, self._named(at).names)
        at, final = self._simplified(at, self._named(at))
        named = {c.name: c for c in final.candidates}
        while True:
            explained = {c.name: self.confirmation.explained(at, c) for c in at.candidates if c.name not in named}
            useful = [c for c in at.candidates if (e := explained.get(c.name)) is None or e.part > 0.0]
            if len(useful) == len(at.candidates):
                break
            at = self.cache.refit(useful, at.fit) or final
        found = [
            self.confirmation.found(final if c.name in named else at, named.get(c.name, c), c.name in named)
            for c in at.candidates
        ]
        return SearchResult(final, at, (*found, unexplained) if unexplained else tuple(found), remarks)

    def _pruned(self, at: Refit) -> Refit:
        """Return the refit without terms that later ones have made needless, the least significant first. A term stays
        that explains a part of the misfit of data held out that is more than minor: beside others coloured noise may
        stand in for it, which follows a lightly damped mode, say, but does not simulate it."""
        while len(at.candidates) > 1:
            margins = {}
            for c in at.candidates:
                without = self.cache.again([other for other in at.candidates if other is not c], at.fit)
                if without is not None:
                    margins[without] = self.assessment.gain(without, at) - self.assessment.needed(at, c)
            needless = (r for r in sorted(margins, key=lambda r: margins[r]) if margins[r] <= 0.0)
            fewer = next((r for r in needless if not self._explains(r, at)), None)
            if fewer is None:
                break
            at = fewer
        return at

    def _explains(self, base: Refit, more: Refit) -> bool:
        """Return whether a refit explains more than a minor part of the misfit of data held out."""
        explained = self.assessment.explained(base, more)
        return explained is not None and not self.assessment.is_minor(explained)

    def _preferred(self, at: Refit, names: Collection[str]) -> Refit:
        """Return the refit with the most plausible of causes that are the same but for rounding, so that rounding does
        not decide which is named; and with causes that are likelier beside what came later, and no richer."""
        for name in names:
            candidate = next(c for c in at.candidates if c.name == name)
            others = [c for c in at.candidates if c is not candidate]
            best, rank = at, plausibility(candidate, self.cache.base.fit.model)
            for r, ahead in self.refitting.alternatives(at, candidate):
                if r is at or r.names == at.names:
                    continue
                (new,) = r.beside(others)
                own = plausibility(new, self.cache.base.fit.model)
                # With more unknowns it would be as likely by being able to be many things.
                richer = len(new.parameters) > len(candidate.parameters) or complexity(new) > complexity(candidate)
                likelier = best is at and ahead > self.settings.ahead
                sized = is_physical(r, new) or not is_physical(best, *best.beside(others))
                if richer or not sized or not (likelier or (own < rank and is_equal(best, r))):
                    continue
                if self.assessment.is_named(r, new, self.confirmation.explained(r, new)):
                    best, rank = r, own
            at = best
        return at

    def _of_physical_size(self, at: Refit) -> Refit:
        """Return the refit with another cause in place of each whose size is not physical, where one that is explains
        nearly as much: a lag of the input in place of a huge lagged damping, say."""
        for name in at.names:
            candidate = next(c for c in at.candidates if c.name == name)
            if is_physical(at, candidate):
                continue
            own = self.confirmation.explained(at, candidate)
            if own is None or is_plausible(at, candidate, own):
                continue
            others = [c for c in at.candidates if c is not candidate]
            for r, _ in self.refitting.alternatives(at, candidate):
                if r is at or r.names == at.names:
                    continue
                (new,) = r.beside(others)
                if not is_physical(r, new):
                    continue
                explained = self.confirmation.explained(r, new)  # last, for it takes a fit to the data held out
                if explained is None or explained.part < self.settings.nearly * own.part:
                    continue
                if not self._is_chance(r, new) and self.assessment.is_named(r, new, explained):
                    at = r
                    break
        return at

    def _named(self, full: Refit) -> Refit:
        """Return the refit with causes that are named only.

        Among terms that are no cause, the one that is needed least is left out first: beside it another may look
        needless.
        """
        at = full
        while True:
            explained = {c.name: self.confirmation.explained(at, c) for c in at.candidates}
            assess = self.assessment
            rest = {c.name: self.confirmation.of_the_rest(at, c, explained[c.name]) for c in at.candidates}
            weak = [
                c
                for c in at.candidates
                if not assess.is_named(at, c, explained[c.name], rest[c.name])
                or self._is_random_walk(at, c)
                or self._is_chance(at, c)
                or self._follows_noise(at, c)
                or is_free_motion(at, c)
            ]
            if not weak:
                return at
            # Of terms that stand for each other what is of a physical size stays, then the simpler one, of those alike
            # what is likelier without the other; where one set cannot be fitted another may.
            sets = [[c for c in at.candidates if c is not w] for w in weak]
            self.cache.refits(sets, at.fit)
            refits = [self.cache.again(s, at.fit) for s in sets]
            fitted = [
                (not self._is_beyond_reason(r), complexity(w), r)
                for w, r in zip(weak, refits, strict=True)
                if r is not None
            ]
            following = max(fitted, key=lambda f: (*f[:2], f[2].merit), default=(False, 0, None))[2]
            if following is None:
                following = self.cache.refit([c for c in at.candidates if c not in weak], at.fit)
            if following is None:
                return at
            at = following

    def _simplified(self, full: Refit, final: Refit) -> tuple[Refit, Refit]:
        """Return the refits with all terms and with those that are named, with the simplest named ones that explain the
        data as well: beside minor findings, and beside terms that are needless now, others seemed to explain more."""
        minor = full.beside(final.candidates)
        for candidate in final.candidates:
            below = self._without(final, candidate)
            simple = final if below is None else self.confirmation.simplest(below, final, candidate)
            if simple is not final:
                final = simple
                both = self.cache.refit([*final.candidates, *minor], final.fit)
                both = None if both is None else self._pruned(both)
                full = both if both is not None and {*final.names} <= {*both.names} else final
                minor = full.beside(final.candidates)
        return full, final

    def _without(self, at: Refit, candidate: Candidate) -> Refit | None:
        """Return the refit without a candidate."""
        return self.cache.refit([c for c in at.candidates if c is not candidate], at.fit)

    def _is_chance(self, at: Refit, candidate: Candidate) -> bool:
        """Return whether a term, beside the others, gains no more in likelihood than chance gives."""
        without = self._without(at, candidate)
        return without is not None and self.assessment.gain(without, at) <= self.assessment.needed(at, candidate)

    def _follows_noise(self, at: Refit, candidate: Candidate) -> bool:
        """Return whether a term of an output, beside the others, follows the noise of that output."""
        without = self._without(at, candidate)
        return without is not None and self.assessment.follows_noise(without, at, candidate)

    def _is_random_walk(self, at: Refit, candidate: Candidate) -> bool:
        """Return whether a term of this record alone, beside the others, is no likelier than random walks of the
        sensors."""
        if candidate.transferable:
            return False
        without = self._without(at, candidate)
        return without is not None and self.assessment.is_random_walk(without, at, candidate)

    def shared(self, at: Refit) -> Refit:
        """Return the refit without disturbances and drifts with which, as they were fitted, the simulation of the
        validation records is no better: they are of the records of the fit alone, and no part of a model for others."""
        for c in [c for c in at.candidates if not c.transferable] if self.cache.validation else []:
            without = self._without(at, c)
            if without is None:
                continue
            before, after = self.assessment.held_out_rms(without), self.assessment.held_out_rms(at)
            if not after or sum(float(np.log(after[n] / before[n])) for n in before) >= 0.0:
                at = without
        return at

    def _is_minor(self, before: Refit, after: Refit) -> bool:
        """Return whether the last step explains less of the misfit than is worth a name."""
        explained = self.assessment.explained(before, after)
        return explained is None or explained.part < self.assessment.settings.minor

    def extension(self, final: Refit, known: bool = False) -> ExtensionResult:
        """Return the model with all terms that were found, its fit, and the gain over the base model. With ``known``
        nothing more is fitted to validation data."""
        base, assess = self.cache.base, self.assessment
        before, after = (assess.held_out_rms(r, known) for r in (base, final))
        held_out = 0.0
        if final.candidates:
            missing = known and self.cache.validation and not (before and after)
            held_out = float("nan") if missing else assess.held_out_as_fitted(base, final)
        gain = Gain(
            log_likelihood=0.0,
            bic=0.0,
            log_likelihood_whitened=assess.gain(base, final) / 2 if final.candidates else 0.0,
            held_out=held_out,
            rms_before=base.rms,
            rms_after=final.rms,
            held_out_rms_before=before,
            held_out_rms_after=after,
        )
        gain = gain.as_fitted(base.fit, final.fit, base.linear.n_rows)
        return ExtensionResult(final.fit.model, final.fit, final.names, gain)


def _fed_back(outputs: Sequence[str]) -> str:
    return (
        f"An input follows the noise of {joined(outputs)} from sample to sample: a controller acts on what is measured "
        "there. Terms of inputs that seem to predict this noise were rejected."
    )


def _rest_rings(frequencies: Sequence[float], time: TimeUnit) -> str:
    at = time.per(", ".join(f"{f:.3g}" for f in frequencies))
    return (
        f"The remaining residuals ring at {at}, a lightly damped mode of the model. Disturbances that excite the "
        "mode cause this, and so does a missing term; noise at this frequency hides either."
    )
