"""Suspects in the data of a search: sensors without a sign, recorded inputs, differences between records, disturbances.

Each ends with a search that goes on as if the data were as they were found to be.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..._core import Expr
from ...errors import PhugoidError
from ...estimation import estimate
from ...fit_result import ENDED_WELL, FitResult, dataset, mean_square
from ...frozen_model import freed_by_default
from ...functions import smooth_abs
from ..candidates.candidate import Candidate
from . import Search, SearchResult
from .disturbance import Disturbances
from .finding import ExtensionResult
from .record_change import RecordChange, record_changes
from .recorded_input import RecordedInput, SampledInputs, noise_of, recorded_input, sampled_inputs
from .refit import Refit, fitted_to
from .remainder import Remainder, RemainderSettings, remainder_of
from .segments import short_segments

__all__ = [
    "UnsignedSensor",
    "unsigned_sensor",
    "with_changes",
    "with_inputs_as_recorded",
    "with_inputs_as_sampled",
    "with_proposals",
    "with_record_changes",
    "with_recorded_input",
    "with_remainder",
    "words_of_inputs",
]

# What an actuator may do to an input that looks like each.
_RIVALS = {
    "hold": ("delay", "lag"),
    "cubic": ("delay", "lag"),
    "noise": ("deadband", "backlash", "saturation", "lag", "delay"),
    "clock": ("delay", "lag"),
}
_BEYOND = 1.25


# A sensor that may give no sign: no value below zero by more than so many times its noise, and dips to near zero, of
# which each side rises again to a part of the largest values.
_BELOW, _NEAR_ZERO, _RISES, _DIPS = 5.0, 0.1, 0.3, 2
# Part of the mean square of an output's residuals that a model of its size may leave.
_LEFT_BY_SIZE = 0.25
# Rounding of the size at zero, as a part of its largest values, beside the sensor's noise.
_ROUNDED_SIZE = 0.002


@dataclass(frozen=True, eq=False)
class UnsignedSensor:
    """An output that gives the size of what it measures, without its sign.

    name  of the output.
    fit   of the model whose output is that size.
    part  of the mean square of the output's residuals that this explains, in the records of the fit.
    """

    name: str
    fit: FitResult
    part: float

    @property
    def cause(self) -> str:
        """Canonical name."""
        return f"{self.name}:unsigned"


def unsigned_sensor(fit: FitResult) -> UnsignedSensor | None:
    """Return the output whose values can only be the size of what the model has for it; None where there is none.

    A model that is far from such a record says nothing of its motion: the estimation begins anew, where the model does.
    """
    data, model = dataset(fit), fit.model
    for name in model.output_names:
        measured = [y[np.isfinite(y)] for y in (e.output(name) for e in data)]
        measured = [y for y in measured if y.size]
        if not _may_be_size(measured):
            continue
        values = np.concatenate(measured)
        # A path that ended infeasible has no residuals.
        before = mean_square(fit, name) if fit.feasible else float(np.var(values))
        if before < _LEFT_BY_SIZE * float(np.var(values)):  # the model follows it as it is
            continue
        width = max(*map(noise_of, measured), _ROUNDED_SIZE * float(values.max()))
        equations = model._right_hand_sides()
        equations["output", name] = Expr(smooth_abs(equations["output", name], width))
        try:
            found = estimate(model._changed(equations=equations), data, noise=fit.noise)
        except (PhugoidError, np.linalg.LinAlgError):
            continue
        if found.status == "interrupted":
            raise KeyboardInterrupt
        if found.status in ENDED_WELL and (after := mean_square(found, name)) < _LEFT_BY_SIZE * before:
            return UnsignedSensor(name, found, 1.0 - after / before)
    return None


def _may_be_size(records: Sequence[NDArray[np.float64]]) -> bool:
    """Tell whether values are never negative but for noise, and often near zero between larger ones."""
    largest = max((float(y.max()) for y in records), default=0.0)
    if largest <= 0.0 or any(float(y.min()) < -_BELOW * noise_of(y) for y in records):
        return False
    dips = 0
    for y in records:
        level = np.where(y < _NEAR_ZERO * largest, -1, np.where(y > _RISES * largest, 1, 0))
        level = level[level != 0]
        turns = np.flatnonzero(np.diff(level))
        dips += int(np.sum(level[turns[:-1]] > 0)) if turns.size > 1 else 0
    return dips >= _DIPS


def with_proposals(search: Search, listed: Callable[[Refit], Sequence[Candidate]]) -> bool:
    """Have candidates tried that first order about short segments of the records proposes, where the model is far from
    the records. ``listed`` makes the candidates about a fit. Return whether that was interrupted."""
    try:
        near = short_segments(search.cache.base)
        if near is not None:
            search.propose(near, listed(near))
    except (PhugoidError, np.linalg.LinAlgError):
        pass
    except KeyboardInterrupt:
        return True
    return False


def with_recorded_input(search: Search) -> tuple[RecordedInput | None, bool]:
    """Return an input that acts otherwise than it is recorded and explains more so than what an actuator may do to it;
    and whether the comparison was interrupted."""
    cache = search.cache
    try:
        cache.watch("comparing inputs that are held between samples, recorded with noise, or by another clock")
        found = recorded_input(cache)
        if found is None:
            return None, False
        search.screen.shortlist(cache.base)
        inputs = found.clock.names if found.clock is not None else (found.name,)
        names = {f"{name}:{rival}" for name in inputs for rival in _RIVALS[found.kind]}
        if found.kind != "noise":
            # Half a sample of the input is a delay of all outputs; of one of them it need not be the input's.
            names |= {f"{y}:delay" for y in cache.base.fit.model.output_names}
        late = [c for c in cache.candidates if c.name in names]
        rivals = [r for r in cache.refits([[c] for c in late if cache.has_start(c.name)]) if r is not None]
        best = max((r.merit - len(r.candidates[0].parameters) for r in rivals), default=-np.inf)
        # Where the record has noise, a dead band takes away what of it is seen most: it must do more than that.
        needed = found.gain * (_BEYOND if found.kind == "noise" else 1.0)
        return (found if best < cache.base.merit + needed else None), False
    except PhugoidError:
        return None, False
    except KeyboardInterrupt:
        return None, True


def with_inputs_as_recorded(
    first: Search, search: Search, result: SearchResult, between: list[RecordedInput]
) -> tuple[Search, SearchResult, list[RecordedInput], bool]:
    """Return the search on the records as they are, where what was found is likelier with their inputs than with those
    that were thought to act, for half a sample of an input does a little of what many causes do; and whether it was
    interrupted."""
    if not between or not result.final.candidates:
        return search, result, between, False
    try:
        first.cache.watch("comparing what was found with the inputs as they are recorded")
        # Terms that came later may mend what an input that acts otherwise has done: the first alone is asked, too.
        terms = result.final.candidates
        as_thought = [r for k in {1, len(terms)} if (r := search.cache.refit(terms[:k])) is not None]
        records = dataset(first.cache.base.fit)
        if not any((same := fitted_to(r, records)) is not None and same.merit > r.merit for r in as_thought):
            return search, result, between, False
        again = first.run()
        better = again.final.merit - first.chances(again.final) > result.final.merit - search.chances(result.final)
        return (first, again, [], again.interrupted) if better else (search, result, between, False)
    except (PhugoidError, np.linalg.LinAlgError):
        return search, result, between, False
    except KeyboardInterrupt:
        return search, result, between, True


def with_record_changes(search: Search, result: SearchResult) -> tuple[Search, SearchResult, list[RecordChange], bool]:
    """Return the search once more with what differs from record to record, where that is likelier than what was found;
    what that is; and whether it was interrupted."""
    cache = search.cache
    try:
        cache.watch("comparing parameters and offsets that differ from record to record")
        base, changes, names = record_changes(search, result)
        if base is None:
            return search, result, [], False
        free = freed_by_default(cache.base.fit.model) if cache.biases is None else cache.biases
        # What is left beside them is part of the misfit of the model that was diagnosed.
        diagnosed = cache.diagnosed or (cache.base, cache.on_validation(cache.base))
        again = search.on(base, biases=[*free, *names], diagnosed=diagnosed)
        if cache.validation:
            again.cache.try_validation()
        following = again.run()
        return again, following, changes, following.interrupted
    except (PhugoidError, np.linalg.LinAlgError):
        return search, result, [], False
    except KeyboardInterrupt:
        return search, result, [], True


def with_changes(extension: ExtensionResult, before: Search, changes: Sequence[RecordChange]) -> ExtensionResult:
    """Return an extension whose gain is over the model without what differs from record to record."""
    base, gain = before.cache.base, extension.gain
    old = before.extension(base).gain
    white = extension.fit.log_likelihood - base.fit.log_likelihood
    more = len(extension.fit.parameters) - len(base.fit.parameters)
    gain = replace(
        gain,
        log_likelihood=white,
        log_likelihood_whitened=gain.log_likelihood_whitened + sum(c.gain for c in changes),
        bic=-2.0 * white + more * float(np.log(base.linear.n_rows)),
        rms_before=old.rms_before,
        held_out_rms_before=old.held_out_rms_before,
    )
    return replace(extension, added=(*(c.name for c in changes), *extension.added), gain=gain)


def with_inputs_as_sampled(
    search: Search, result: SearchResult
) -> tuple[Search, SearchResult, SampledInputs | None, bool]:
    """Return the search once more with inputs between samples as the outputs tell, where these say that they jumped
    there; what that was; and whether it was interrupted."""
    cache, full = search.cache, result.full
    least = full.merit - search.chances(full) + RemainderSettings().margin
    try:
        cache.watch("comparing inputs that jump between samples")
        fits = [full] if full is cache.base else [full, cache.base]
        each = [(s, s.merit - search.chances(at)) for at in fits if (s := sampled_inputs(at)) is not None]
        found, merit = max(each, key=lambda one: one[1], default=(None, -np.inf))
        if found is not None:  # noise on the record of an input looks like that, too
            noises = Disturbances(cache.base.fit.model).ranked(cache.base, white=True)
            least = max([least, *(d.merit for d in noises if d.place.kind == "input")])
        base = fitted_to(cache.base, found.records) if found is not None and merit > least else None
        if found is None or base is None:
            return search, result, None, False
        again = search.on(base, found.on(cache.validation, cache.biases))
        following = again.run()
        return again, following, found, following.interrupted
    except (PhugoidError, np.linalg.LinAlgError):
        return search, result, None, False
    except KeyboardInterrupt:
        return search, result, None, True


def with_remainder(search: Search, result: SearchResult) -> tuple[SearchResult, Remainder | None, bool]:
    """Return what is left beside the terms of a search, which fall where they stand in for it; and whether that was
    interrupted."""
    try:
        remainder = remainder_of(search, result)
    except (PhugoidError, np.linalg.LinAlgError):
        return result, None, False
    except KeyboardInterrupt:
        return result, None, True
    if remainder is None:
        return result, None, False
    if remainder.known is not None:
        return search.concluded(remainder.known, None, result.remarks), None, False
    kept = {c.name for c in remainder.at.candidates}
    found = tuple(f for f in result.found if f.candidate is not None and f.candidate.name in kept)
    full = remainder.fitted or remainder.at
    if len(found) == len(result.full.candidates):
        return replace(result, full=remainder.fitted or result.full, found=found), remainder, False
    final = search.cache.refit([c for c in result.final.candidates if c.name in kept], remainder.at.fit)
    return replace(result, final=final or search.cache.base, full=full, found=found), remainder, False


def words_of_inputs(between: Sequence[RecordedInput], sampled: SampledInputs | None) -> list[str]:
    """Return what was found of inputs between their samples, in words, but for those that are findings."""
    notes = [
        f"{b.name} is smooth between its samples: the search used cubic instead of linear interpolation "
        f"(interpolation={{'{b.name}': 'cubic'}})."
        for b in between
        if b.kind == "cubic"
    ]
    if sampled is not None:
        jumps = ", ".join(f"{name} in {count} intervals" for name, count in sampled.jumps.items())
        notes.append(
            f"Inputs change faster than they were sampled ({jumps} of up to {sampled.step:.3g} s): their values at the "
            "middle of these intervals were estimated, and the search used them. Record inputs at a higher rate."
        )
    return notes
