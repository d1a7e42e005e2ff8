"""Refits and scans of sets of candidates at a base fit, each worked out once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextvars import copy_context
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...data.experiment import Experiment
from ...errors import EvaluationError, PhugoidError
from ...fit_result import FitResult
from ...frozen_model import freed_by_default
from ...residual_noise.whitening import Whitening
from ...sensitivities.linearised import Linearised
from ...solvers import check_time
from ..candidates.candidate import Candidate, Effect, is_limit, with_variants
from .centre import about_own_centre
from .refit import Refit, on_other_data, refit
from .ringing import Ringing, light_modes, ringing_of
from .scan import Scan
from .starts import SAME, SeveralStarts

__all__ = ["RefitCache"]

_Array = NDArray[np.float64]

# What one term less may cost in log-likelihood where that is hardly another optimum.
_NEARLY = 10.0
# Times the loss that the estimates of the terms left out make one expect, beyond which the optimum is another.
_TIMES_EXPECTED = 5.0
# Scans keep their effects as long as all have no more numbers together: half a gigabyte.
_NUMBERS = 60_000_000
# Refits side by side: the solver works without the interpreter's lock.
_WORKERS = 4
# The gain in log-likelihood by a free initial state of each record: chance exceeds it once in two thousand times.
_UNSTEADY = 6.0
# The gain in log-likelihood that the centre of a limit must promise, of which no trim need be the middle.
_CLEARLY = 8.0


@dataclass
class RefitCache:
    """What is known of sets of candidates at a base fit.

    ``validation`` is data for held-out gains. ``biases`` are the parameters of the base that are estimated again there;
    None: those of sensors. ``watch`` is called with what is done. ``diagnosed``: the model that was diagnosed, and
    the same on the validation data, where the base is that on mended records.
    """

    base: Refit
    candidates: Sequence[Candidate]
    validation: Sequence[Experiment] = ()
    watch: Callable[[str], None] = lambda _: None
    biases: Sequence[str] | None = None
    diagnosed: tuple[Refit, Linearised | None] | None = None

    def __post_init__(self) -> None:
        self._refits: dict[frozenset[str], Refit | None] = {frozenset(): self.base}
        self._scans: dict[frozenset[str], Scan] = {}
        # By the refits themselves: of tabulated functions several have one name.
        self._others: dict[Refit, Linearised | None] = {}
        self._as_fitted: dict[Refit, Linearised | None] = {}
        self._starts: dict[str, Mapping[str, float]] = {}
        self._modes = light_modes(self.base.fit)
        self._ringing: dict[Refit, Ringing | None] = {}
        self.candidates = with_variants(self.candidates, self.base.linear.points, self.base.fit.model)
        self._several = SeveralStarts(self.base, self._share, self.with_one_more)
        # Candidates to refit whatever a scan says of them -> where that starts.
        self.proposed: Mapping[str, Mapping[str, float]] = {}

    @property
    def tries(self) -> int:
        """Number of candidates, each shape counted."""
        return sum(len(c.shapes) for c in self.candidates)

    @property
    def by_name(self) -> dict[str, Candidate]:
        """Return the candidates by name, with those that came up in the search; of variants the first."""
        refitted = [c for r in self._refits.values() if r is not None for c in r.candidates]
        return {c.name: c for c in (*refitted, *reversed(self.candidates))}

    def known(self, candidates: Sequence[Candidate]) -> Refit | None:
        """Return the refit of a set where there is one already, else None."""
        return self._refits.get(frozenset(c.name for c in candidates))

    def refit(self, candidates: Sequence[Candidate], near: FitResult | None = None) -> Refit | None:
        """Return the refit of a set."""
        return self.refits([candidates], near)[0]

    def refits(
        self, sets: Sequence[Sequence[Candidate]], near: FitResult | None = None, weighed: bool = True
    ) -> list[Refit | None]:
        """Return the refits of several sets, side by side; ``weighed``: with the likelihoods of each with coloured
        noise, which are else worked out where they are asked for."""
        check_time()
        keys = [frozenset(c.name for c in candidates) for candidates in sets]
        new = {key: candidates for key, candidates in zip(keys, sets, strict=True) if key not in self._refits}

        def one(candidates: Sequence[Candidate]) -> Refit | None:
            starts: dict[str, float] = {}
            for c in candidates:
                starts |= self._starts.get(c.name, {})

            def likeliest(candidates: Sequence[Candidate]) -> Refit | None:
                elsewhere = self.proposed.get(candidates[-1].name) if candidates else None
                return self._several.likeliest(candidates, starts, near, elsewhere)

            found = likeliest(candidates)
            # Other records are to confirm both sides of a limit: one that is as likely alone says less.
            last = candidates[-1] if candidates else None
            others = [(last.lesser, _NEARLY), (last.otherwise, 0.0)] if last is not None else []
            for variant, less in others:
                if found is None or variant is None:
                    continue
                other = likeliest([*candidates[:-1], variant])
                if other is not None and other.fit.log_likelihood > found.fit.log_likelihood - less:
                    found = other
            found = self._begun_anywhere(found)
            try:
                if found is not None and candidates and is_limit(candidates[-1]):
                    found = about_own_centre(self.base, found, candidates[-1], _CLEARLY, found.own.filter, self.watch)
                _ = weighed and found and found.merit  # here, for it takes as long
            except EvaluationError:  # it cannot be linearised: nothing is known of its parameters
                return None
            return found

        for candidates in new.values():
            self.watch("fitting with " + ", ".join(c.name for c in candidates))
        # Those that begin at several places come last: what the others explain says whether that is worth while.
        for several in (False, True):
            part = {
                key: c for key, c in new.items() if any(o.several_starts or o.begins_measured for o in c) == several
            }
            self._refits |= dict(zip(part, _side_by_side(one, [*part.values()]), strict=True))
        return [self._refits[key] for key in keys]

    def _begun_anywhere(self, found: Refit | None) -> Refit | None:
        """Return a refit with states of its last candidate that begin anywhere, where the records show that the motion
        was not steady before them."""
        unsteady = found.candidates[-1].unsteady if found is not None and found.candidates else None
        if found is None or unsteady is None:
            return found
        points = self.base.linear.points
        other = refit(self.base.fit, [*found.candidates[:-1], unsteady], {}, found.fit, points)
        if other is None:
            return found
        known, left = (sum(kind == "initial" for kind, _ in r.fit.model._right_hand_sides()) for r in (found, other))
        needed = _UNSTEADY * (known - left) * len(found.fit.records)
        if other.fit.log_likelihood < found.fit.log_likelihood + needed:
            return found
        shape = {n: other.fit.parameters[n].value for n in unsteady.shape_names}
        begun = zip(other.fit.records, points, strict=True)
        return other if all(unsteady.begins_within(r.mesh_states, p, shape) for r, p in begun) else found

    def again(self, candidates: Sequence[Candidate], near: FitResult) -> Refit | None:
        """Return the refit of a set, begun once more from a fit with more terms where it may have ended at another
        optimum than the one that is near that fit."""
        key = frozenset(c.name for c in candidates)
        before = self.refit(candidates, near)
        lost = np.inf if before is None else near.log_likelihood - before.fit.log_likelihood
        many = any(c.several_starts or c.jumps for c in candidates)
        if lost < _NEARLY or not (many or lost > _NEARLY + _TIMES_EXPECTED * self._expected_loss(near, candidates)):
            return before
        self.watch("fitting with " + ", ".join(c.name for c in candidates) + " once more")
        found = refit(self.base.fit, candidates, {}, near, self.base.linear.points, patient=True)
        if found is None or (before is not None and found.fit.log_likelihood < before.fit.log_likelihood + SAME):
            return before
        self._scans.pop(key, None)
        self._refits[key] = found
        return found

    def _expected_loss(self, near: FitResult, candidates: Sequence[Candidate]) -> float:
        """Return the log-likelihood that a fit loses without the terms that it has beside some candidates, by their
        estimates and standard errors."""
        names = {*near.model.parameter_names}.difference(self.base.fit.model.parameter_names)
        left_out = names.difference(n for c in candidates for n in c.parameters)
        estimates = [near.parameters[n] for n in left_out if n in near.parameters]
        return sum(0.5 * (e.value / e.std_error) ** 2 for e in estimates if e.std_error > 0.0)

    def adopt(self, found: Refit, candidate: Effect) -> None:
        """Have a candidate about the centre that it has in a refit from here on, and forget what is known of others."""
        (new,) = (c for c in found.candidates if c.name == candidate.name)
        assert isinstance(new, Effect)
        for known in (self._refits, self._scans):
            for key in [key for key in known if candidate.name in key]:
                del known[key]
        self._refits[frozenset(found.names)] = found
        old, kept = candidate.scales, []
        for c in self.candidates:
            if c.name != candidate.name:
                kept.append(c)
            elif isinstance(c, Effect) and c.scales.centre(*c.variables) == old.centre(*c.variables):
                kept.append(c.on(new.scales))
        self.candidates = kept

    def _share(self, candidate: Candidate, among: Sequence[Candidate]) -> float:
        """Return the part of the residuals' power that a candidate explains to first order beside the others of a set;
        where that was not scanned, the greatest beside any."""
        beside = self._scans.get(frozenset(c.name for c in among if c is not candidate))
        scans = self._scans.values() if beside is None else [beside]
        return max((scan.share(candidate.name) for scan in scans), default=1.0)

    def scan(self, at: Refit) -> Scan:
        """Return the scan of all others at a set."""
        key = frozenset(at.names)
        if key not in self._scans:
            self.watch("scanning all candidates" + (" beside " + ", ".join(at.names) if at.names else ""))
            # With its terms a model may have more parameters than are asked what they move.
            others = [c for c in self.candidates if c.name not in key and (not c.beside or c.beside in key)]
            others = [c for c in others if at.linear.reaches(c.place)]
            self._scans[key] = Scan(at.linear, others)
        self._scans[key] = self._scans.pop(key)  # the last that was asked for
        size = 0
        for scan in reversed(self._scans.values()):
            size += scan.size
            if size > _NUMBERS and scan is not self._scans[key]:
                scan.forget()
        return self._scans[key]

    def is_weighed(self, at: Refit) -> bool:
        """Work out the likelihood of a refit with coloured noise; False where it cannot be linearised: then it takes no
        further part."""
        try:
            _ = at.merit
        except EvaluationError:
            self.forget(at)
            return False
        return True

    def forget(self, at: Refit) -> None:
        """Have a refit take no further part, and not be made again."""
        self._refits[frozenset(at.names)] = None

    def with_one_more(self, others: Sequence[Candidate]) -> list[Refit]:
        """Return the refits that are known of some candidates and one more."""
        base = frozenset(c.name for c in others)
        return [r for key, r in self._refits.items() if r and len(key) == len(base) + 1 and key > base]

    def ringing(self, at: Refit) -> Ringing | None:
        """Return what rings in the residuals of a set at lightly damped modes of the base; None where nothing does."""
        if at not in self._ringing:
            filter = at.own.filter
            assert isinstance(filter, Whitening)  # channel by channel
            found = ringing_of(filter, at.own.residuals, at.linear, self._modes) if self._modes.size else None
            self._ringing[at] = found
        return self._ringing[at]

    def try_validation(self) -> None:
        """Fits the base to the validation data, where there are any. Raises ModelError or DataError where they cannot
        serve: the user is to know before the search."""
        if self.validation:
            self.watch("fitting the validation data")
            self.on_validation(self.base)

    def on_validation(self, at: Refit, near: Linearised | None = None, known: bool = False) -> Linearised | None:
        """Return the refit's model on the validation data, linearised, from another's path there, by default that of
        the base; None without such data, and where it cannot be fitted to them. With ``known`` only what was worked
        out before."""
        if not self.validation or (known and at not in self._others):
            return None
        if at not in self._others:
            try:
                near = near or self._others.get(self.base)
                self._others[at] = on_other_data(at, self.validation, near, self.estimated_again(at))
            except PhugoidError:
                if at is self.base:
                    raise
                self._others[at] = None
        return self._others[at]

    def as_fitted(self, at: Refit, known: bool = False) -> Linearised | None:
        """Return the same with disturbances and drifts as fitted to the records, as `Fit.validate` has them."""
        if all(c.transferable for c in at.candidates):
            return self.on_validation(at, known=known)
        if not self.validation or (known and at not in self._as_fitted):
            return None
        if at not in self._as_fitted:
            try:
                found = on_other_data(
                    at, self.validation, self.on_validation(at), self.estimated_again(at), as_fitted=True
                )
            except PhugoidError:
                found = None
            self._as_fitted[at] = found
        return self._as_fitted[at]

    def estimated_again(self, at: Refit) -> Sequence[str]:
        """Return what is estimated again on other data: of the base what was asked for, and biases that were found."""
        by_default = freed_by_default(at.fit.model)
        if self.biases is None:
            return by_default
        base = self.base.fit.model.parameter_names
        return [*self.biases, *(n for n in by_default if n not in base)]

    def remember(self, candidate: Candidate, shape: Mapping[str, float], amplitude: _Array) -> None:
        """Return where a refit starts."""
        self._starts[candidate.name] = {
            **dict(zip(candidate.coefficients, amplitude.tolist(), strict=False)),
            **shape,
        }

    def start(self, name: str) -> Mapping[str, float]:
        """Return where a refit starts: parameters of a candidate -> values."""
        return self._starts.get(name, {})

    def start_as_proposed(self, name: str) -> None:
        """Have a refit start where it was proposed to, where nothing else is known of that."""
        self._starts.setdefault(name, self.proposed[name])

    def has_start(self, name: str) -> bool:
        """Return whether it is known where a refit with a candidate starts."""
        return name in self._starts


def _side_by_side(
    one: Callable[[Sequence[Candidate]], Refit | None], sets: Sequence[Sequence[Candidate]]
) -> list[Refit | None]:
    """Return what a function returns of each set, in threads where there are several."""
    if len(sets) < 2:
        return [one(candidates) for candidates in sets]
    from concurrent.futures import ThreadPoolExecutor  # not at import

    executor = ThreadPoolExecutor(min(len(sets), _WORKERS))
    try:
        # Each thread works within the limit in force here.
        tasks = [executor.submit(copy_context().run, one, candidates) for candidates in sets]
        return [task.result() for task in tasks]
    finally:
        executor.shutdown(cancel_futures=True)
