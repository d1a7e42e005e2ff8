"""Refits and scans of sets of candidates at a base fit, each worked out once."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from contextvars import copy_context
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...data.experiment import Experiment
from ...errors import EvaluationError, PhugoidError
from ...fit_result import FitResult, mean_square
from ...frozen_model import freed_by_default
from ...residual_noise.whitening import Filter, Whitening
from ...sensitivities.linearised import Linearised
from ...solvers import check_time
from ..candidates.candidate import Candidate, Effect, has_unknown_centre, is_limit, with_variants
from .refit import Refit, is_structured, on_other_data, refit
from .ringing import Ringing, light_modes, ringing_of
from .scan import Scan

__all__ = ["RefitCache"]

_Array = NDArray[np.float64]

# Parts of a start at which candidates begin, too, that may end at several optima: where they explain this part of the
# power of the base's residuals or more to first order, for small effects are nearly linear.
# Where it is so evident, they begin at all of them, be the first ends alike.
_STARTS, _LARGE, _EVIDENT = (0.4, 1.6, 0.25, 0.65), 0.1, 0.3
# Parts of a value of first order at which a shape is held in turn.
_PROFILE = (0.4, 0.6, 0.8, 1.0, 1.3, 1.7)
# Part of an output's variance that a fit leaves with which next to nothing about it is true.
_USELESS = 0.5
# Part of the residuals' power of an output beside noise that is a misfit; part of a misfit that is next to nothing.
_STRUCTURED, _NEXT_TO_NOTHING = 0.2, 0.01
# Two ends at the likeliest optimum so far, alike to this in log-likelihood, or so many starts that come to no end,
# leave little to be found.
_SAME, _FAILED = 0.5, 3
# What one term less may cost in log-likelihood where that is hardly another optimum.
_NEARLY = 10.0
# Times the loss that the estimates of the terms left out make one expect, beyond which the optimum is another.
_TIMES_EXPECTED = 5.0
# An end that gains less than this part of what the scan promises is none; so many shapes are tried then.
_LITTLE, _OTHERS = 0.1, 4
# Scans keep their effects as long as all have no more numbers together: half a gigabyte.
_NUMBERS = 60_000_000
# Refits side by side: the solver works without the interpreter's lock.
_WORKERS = 4
# Of a trim that is estimated, in parts of the range of the variable: the step of the derivative, the longest step of
# the estimate; steps; and the gain in log-likelihood of a step that ends it.
_CENTRE_STEP, _FARTHEST_CENTRE, _CENTRINGS, _SETTLED = 0.02, 0.3, 8, 0.5
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
        # Outputs of which the base leaves most, and not since they are mostly noise.
        structured = is_structured(self.base, _USELESS)
        self._unexplained = _unexplained(self.base.fit, self.base.fit.model.output_names) if structured else []
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
            found = self._likeliest(candidates, starts, near)
            # Other records are to confirm both sides of a limit: one that is as likely alone says less.
            last = candidates[-1] if candidates else None
            others = [(last.lesser, _NEARLY), (last.otherwise, 0.0)] if last is not None else []
            for variant, less in others:
                if found is None or variant is None:
                    continue
                other = self._likeliest([*candidates[:-1], variant], starts, near)
                if other is not None and other.fit.log_likelihood > found.fit.log_likelihood - less:
                    found = other
            found = self._begun_anywhere(found)
            try:
                if found is not None and candidates and is_limit(candidates[-1]):
                    found = self.about_own_centre(found, candidates[-1], _CLEARLY, found.own.filter)
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
        if found is None or (before is not None and found.fit.log_likelihood < before.fit.log_likelihood + _SAME):
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

    def about_own_centre(self, at: Refit, candidate: Candidate, least: float, filter: Filter) -> Refit:
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
            self.watch(f"fitting with {candidate.name} about another trim")
            found = refit(self.base.fit, [*at.beside([candidate]), moved], {}, at.fit, self.base.linear.points)
            if found is None or found.merit < at.merit + needed:
                break
            at, candidate, needed = found, moved, _SETTLED
        return at

    def about_zero(self, at: Refit, candidate: Candidate) -> Refit | None:
        """Return the refit with a function about zero, such as a rate of reaction or a drag has; None where zero is far
        from the record."""
        if not isinstance(candidate, Effect) or not has_unknown_centre(candidate):
            return None
        (name,) = candidate.variables
        if not candidate.scales.reaches_zero(name):
            return None
        moved = candidate.moved(-candidate.scales.centre(name))
        self.watch(f"fitting with {candidate.name} about zero")
        return refit(self.base.fit, [*at.beside([candidate]), moved], {}, at.fit, self.base.linear.points)

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

    def _likeliest(
        self, candidates: Sequence[Candidate], starts: Mapping[str, float], near: FitResult | None
    ) -> Refit | None:
        """Return the likeliest refit of a set from several starts of candidates that need them and are new."""
        known = near.parameters if near else {}
        points = self.base.linear.points
        left = self._left(near)
        shares = {c.name: left * self._share(c, candidates) for c in candidates}
        # Of friction that rests, first order about a motion that never does says little.
        much = {c.name for c in candidates if shares[c.name] > _LARGE or (c.jumps and c.coefficients)}
        new = [c for c in candidates if c.several_starts and c.shape_names[0] not in known and c.name in much]
        best = refit(self.base.fit, candidates, starts, near, points)
        elsewhere = self.proposed.get(candidates[-1].name) if candidates else None
        if elsewhere is not None:
            other = refit(self.base.fit, candidates, {**starts, **elsewhere}, near, points, patient=best is None)
            if other is not None and (best is None or other.fit.log_likelihood > best.fit.log_likelihood):
                best = other
        if self._is_explained(candidates):
            return best
        if best is None:
            # About a start far off the linearisation that gave it says little: two others, or from nothing.
            last = candidates[-1] if candidates else None
            if last is not None and last.coefficients and (last.jumps or not last.shape_names):
                nothing = dict.fromkeys(last.coefficients, 0.0)
                best = refit(self.base.fit, candidates, {**starts, **nothing}, near, points)
            elif last is not None and last.unit_amplitude and not last.several_starts and len(last.shapes) > 2:
                for k in (0, len(last.shapes) // 2):
                    best = best or refit(self.base.fit, candidates, {**starts, **last.shapes[k]}, near, points)
        ends = [best, *self._profiled(candidates, starts, near, much)]
        # About a path that has little to do with the measured one a refit may end where the base did.
        lost = self._unexplained and (best is None or _unexplained(best.fit, self._unexplained))
        jumping = left > _LARGE and any(c.begins_measured and c.shape_names[0] not in known for c in candidates)
        # A candidate that contradicts the path of the fit may fit the measured one.
        ended_nowhere = best is None and bool(candidates) and candidates[-1].name in much
        if lost or jumping or ended_nowhere:
            # What is proposed is proposed about the measured motion.
            ends.append(refit(self.base.fit, candidates, {**starts, **(elsewhere or {})}, near, measured=True))
        for c in new:
            name = c.shape_names[0]
            # Ends from one and the same value, on two paths, say nothing of other values.
            begun_here = _best(ends)
            ends = ends if begun_here is None else [begun_here]
            for factor in _STARTS if name in starts else ():
                if _enough(ends, often=shares[c.name] > _EVIDENT):
                    break
                ends.append(refit(self.base.fit, candidates, {**starts, name: factor * starts[name]}, near, points))
        begun = (near or self.base.fit).log_likelihood
        for c in new:
            # Far from the base the linearisation may ask for a shape that does nothing, such as a limit never reached.
            asked = begun + _LITTLE * 0.5 * shares[c.name] * self.base.linear.n_rows
            failed = sum(r is None for r in ends)
            for shape in c.shapes[:: max(len(c.shapes) // _OTHERS, 1)]:
                if failed >= _FAILED or any(r is not None and r.fit.log_likelihood > asked for r in ends):
                    break
                ends.append(refit(self.base.fit, candidates, {**starts, **shape}, near, points))
                failed += ends[-1] is None
        return _best(ends)

    def _is_explained(self, candidates: Sequence[Candidate]) -> bool:
        """Return whether another candidate in the place of the last of a set explains next to all of the misfit: then
        few starts will do."""
        others = self.with_one_more(candidates[:-1]) if candidates else []
        return any(self._left(r.fit) < _NEXT_TO_NOTHING for r in others)

    def _profiled(
        self,
        candidates: Sequence[Candidate],
        starts: Mapping[str, float],
        near: FitResult | None,
        much: Collection[str],
    ) -> list[Refit]:
        """Return the refit of a set that begins at the likeliest of several values at which the shape of its last
        candidate is held, where this is to be asked and the candidate explains much; empty else."""
        last = candidates[-1] if candidates else None
        if last is None or not last.is_profiled or last.name not in much:
            return []
        (name,) = last.shape_names
        if name not in starts or (near is not None and name in near.parameters):
            return []
        points, base = self.base.linear.points, self.base.fit
        values = [{**starts, name: part * starts[name]} for part in _PROFILE]
        along = _best([refit(base, candidates, each, near, points, held=[name]) for each in values])
        if along is None:
            return []
        begin = float(along.fit.model.declared_parameters[name].start)
        found = refit(base, candidates, {**starts, name: begin}, along.fit, points)
        return [found] if found is not None else []

    def _left(self, near: FitResult | None) -> float:
        """Return the part of the misfit of the base that a fit leaves in the output in which it leaves most of it."""
        if near is None:
            return 1.0
        left = []
        filter = self.base.own.filter
        assert isinstance(filter, Whitening)  # channel by channel
        for name, channel in zip(self.base.fit.model.output_names, filter.channels, strict=True):
            # What the past of the residuals does not predict is noise: of an output without a misfit that is left.
            power = mean_square(self.base.fit, name)
            if (misfit := power - channel.power) > _STRUCTURED * power:
                left.append((mean_square(near, name) - channel.power) / misfit)
        return min(max(left, default=1.0), 1.0)

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


def _unexplained(fit: FitResult, names: Sequence[str]) -> list[str]:
    """Return the outputs of which a fit leaves most of what they do."""
    found = []
    for name in names:
        measured = [y for y in (r.measured[name] for r in fit.records) if np.isfinite(y).any()]
        moved = np.concatenate([np.zeros(0), *(y - np.nanmean(y) for y in measured)])
        if moved.size and mean_square(fit, name) > _USELESS * float(np.nanmean(moved**2)):
            found.append(name)
    return found


def _best(ends: Sequence[Refit | None]) -> Refit | None:
    """Return the likeliest of the refits that came to an end."""
    return max((r for r in ends if r is not None), key=lambda r: r.fit.log_likelihood, default=None)


def _enough(ends: Sequence[Refit | None], often: bool) -> bool:
    """Return whether refits from several starts have shown what there is to find; ``often``: though some are alike."""
    found = sorted((r.fit.log_likelihood for r in ends if r is not None), reverse=True)
    alike = len(found) > 1 and found[0] - found[1] < _SAME
    return (alike and not often) or (not found and len(ends) >= _FAILED)
