"""Stages of a diagnosis: faults of the data, terms of the model, and the remaining misfit.

Each stage takes what is known so far and returns what is known after it; after a fault that is found in the data,
all that follows searches the corrected data.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ...errors import PhugoidError
from ...fit_result import dataset
from ..candidates.candidate import Candidate
from . import Search, SearchResult
from .disturbance import Disturbances
from .finding import ExtensionResult, Scored
from .record_change import RecordChange, record_changes
from .recorded_input import ALIKE_GAIN, RecordedInput, SampledInputs, recorded_input, sampled_inputs
from .refit import Refit, fitted_to
from .remainder import Remainder, RemainderSettings, remainder_of
from .scan import NEARLY, Scan
from .segments import short_segments
from .surrogates import without_surrogates

__all__ = [
    "Inquiry",
    "ranked",
    "ranking_of",
    "stages",
    "words_of_inputs",
]


# What an actuator may do to an input that looks like each.
_ALTERNATIVES = {
    "hold": ("delay", "lag"),
    "cubic": ("delay", "lag"),
    "noise": ("deadband", "backlash", "saturation", "lag", "delay"),
    "clock": ("delay", "lag"),
}
_BEYOND = 1.25


@dataclass(frozen=True, eq=False)
class Inquiry:
    """Hold what is known of a misfit.

    first        the search on the records as they are.
    search       the search as it stands, with the data as they were found to be.
    result       what that found.
    ranking      of the first scan; empty before.
    inputs       inputs that act otherwise than they are recorded.
    sampled      inputs that change faster than they were sampled; None where they do not.
    changes      what differs from record to record; ``unchanged``: the search before that.
    remainder    what is left beside the terms; None where that is noise.
    interrupted  whether the user or the time limit ended a stage.
    """

    first: Search
    search: Search
    result: SearchResult
    ranking: tuple[Scored, ...] = ()
    inputs: tuple[RecordedInput, ...] = ()
    sampled: SampledInputs | None = None
    changes: tuple[RecordChange, ...] = ()
    unchanged: Search | None = None
    remainder: Remainder | None = None
    interrupted: bool = False

    @staticmethod
    def begun(search: Search) -> Inquiry:
        """Return the state before all stages."""
        return Inquiry(search, search, SearchResult(search.cache.base, search.cache.base))

    def after(self, stages: Sequence[Stage]) -> Inquiry:
        """Return the state after stages; where Ctrl-C or the time limit ends one, that before it."""
        state = self
        for stage in stages:
            if state.interrupted:
                break
            try:
                state = stage(state)
            except KeyboardInterrupt:
                state = replace(state, interrupted=True)
        return state

    def searched(self, search: Search) -> Inquiry:
        """Return the state with what another search finds."""
        result = search.run()
        return replace(self, search=search, result=result, interrupted=result.interrupted)

    def extension(self, at: Refit) -> ExtensionResult:
        """Return an extension by a refit and by what differs from record to record, over the model without these."""
        extension = self.search.extension(at, known=self.interrupted)
        if self.unchanged is None:
            return extension
        base, gain = self.unchanged.cache.base, extension.gain
        gain = replace(
            gain.as_fitted(base.fit, at.fit, base.linear.n_rows),
            log_likelihood_whitened=gain.log_likelihood_whitened + sum(c.gain for c in self.changes),
            rms_before=base.rms,
            held_out_rms_before=self.unchanged.assessment.held_out_rms(base, self.interrupted),
        )
        return replace(extension, added=(*(c.name for c in self.changes), *extension.added), gain=gain)


Stage = Callable[[Inquiry], Inquiry]


def stages(listed: Callable[[Refit], Sequence[Candidate]], differ: bool) -> list[Stage]:
    """Return the stages of a diagnosis. ``listed`` makes the candidates about a fit; ``differ``: whether records may
    differ from each other, as parts of one record do not."""
    return [
        ranked,
        _optional(partial(_proposed, listed)),
        _with_recorded_inputs,
        lambda state: state.searched(state.search),
        _optional(_with_inputs_as_recorded),
        *([_optional(_with_record_changes)] if differ else []),
        _optional(_with_inputs_as_sampled),
        _optional(_with_remainder),
        _without_surrogates,
    ]


def _optional(stage: Stage) -> Stage:
    """Return a stage without which a diagnosis goes on: where a fit of it fails nothing is found."""

    def tried(state: Inquiry) -> Inquiry:
        try:
            return stage(state)
        except (PhugoidError, np.linalg.LinAlgError):
            return state

    return tried


def ranked(state: Inquiry) -> Inquiry:
    """Return the state with the first scan."""
    # Now, while what the search needs next is at hand.
    cache = state.search.cache
    cache.try_validation()
    return replace(state, ranking=tuple(ranking_of(state.search, cache.scan(cache.base))))


def ranking_of(search: Search, scan: Scan) -> list[Scored]:
    """Return all candidates, each at its best shape."""
    through = {"base": search.cache.base.own.filter, "clean": scan.clean(), "white": scan.white.filter}
    values = {which: scan.through(filter) for which, filter in through.items()}
    best: dict[str, int] = {}
    for i in np.argsort(-values["clean"].values):
        best.setdefault(scan.effects[i][0].name, int(i))
    found = []
    for name, i in best.items():
        candidate, shape = scan.effects[i]
        distinct = float(scan.distinct[i])
        remark = "nearly indistinguishable from parameters of the model" if distinct < NEARLY else ""
        amplitude = values["clean"].amplitudes[i].tolist()
        estimate = {**dict(zip(candidate.coefficients, amplitude, strict=False)), **shape}
        base, clean, white = (float(v.values[i]) for v in values.values())
        found.append(Scored(name, candidate.explanation, estimate, base, clean, white, distinct, remark))
    by_name = {c.name: c for c in search.cache.candidates}
    for name in scan.lost:
        remark = "indistinguishable from parameters of the model"
        found.append(Scored(name, by_name[name].explanation, {}, 0.0, 0.0, 0.0, 0.0, remark))
    return found


def _proposed(listed: Callable[[Refit], Sequence[Candidate]], state: Inquiry) -> Inquiry:
    """Have candidates tried that first order about short segments of the records proposes, where the model is far from
    the records."""
    near = short_segments(state.search.cache.base)
    if near is not None:
        state.search.propose(near, listed(near))
    return state


def _with_recorded_inputs(state: Inquiry) -> Inquiry:
    """Search with the inputs as they act, one after the other."""
    following = state
    while True:
        state = following
        following = state.after([_optional(_with_recorded_input)])
        if following is state or following.interrupted:
            return following


def _with_recorded_input(state: Inquiry) -> Inquiry:
    found = _recorded_input(state.search)
    if found is None:
        return state
    on = state.search.without_noise if found.kind == "noise" else state.search.on
    result = SearchResult(found.refit, found.refit)
    return replace(state, search=on(found.refit, found.validation), result=result, inputs=(*state.inputs, found))


def _recorded_input(search: Search) -> RecordedInput | None:
    """Return an input that acts otherwise than it is recorded, and explains more so than what an actuator may do to
    it; noise of its record more than any term."""
    cache = search.cache
    cache.watch("comparing inputs that are held between samples, recorded with noise, or by another clock")
    found = recorded_input(cache)
    if found is None:
        return None
    likely = search.screen.shortlist(cache.base)
    inputs = found.clock.names if found.clock is not None else (found.name,)
    names = {f"{name}:{alternative}" for name in inputs for alternative in _ALTERNATIVES[found.kind]}
    if found.kind != "noise":
        # Half a sample of the input is a delay of all outputs; of one of them it need not be the input's.
        names |= {f"{y}:delay" for y in cache.base.fit.model.output_names}
    else:  # an input of another size leaves residuals in proportion to it, and noise of a record takes its size away
        names |= {c.name for c in likely if c.transferable}
    late = [c for c in cache.candidates if c.name in names]
    alternatives = [r for r in cache.refits([[c] for c in late if cache.has_start(c.name)]) if r is not None]
    merits = {r.candidates[0].name: r.merit - len(r.candidates[0].parameters) - cache.base.merit for r in alternatives}
    best = max(merits.values(), default=-np.inf)
    # Where the record has noise, a dead band takes away what of it is seen most: it must do more than that.
    needed = found.gain * (_BEYOND if found.kind == "noise" else 1.0)
    if best >= needed:
        return None
    if found.kind == "hold":  # half a sample late on average
        alike = {name: m for name, m in sorted(merits.items(), key=lambda of: -of[1]) if m > found.gain - ALIKE_GAIN}
        return replace(found, alternatives=alike)
    return found


def _with_inputs_as_recorded(state: Inquiry) -> Inquiry:
    """Return what a search on the records as they are finds, where what was found is likelier with their inputs than
    with those that were thought to act: half a sample of an input does a little of what many causes do."""
    first, search, result = state.first, state.search, state.result
    if not state.inputs or not result.final.candidates:
        return state
    first.cache.watch("comparing what was found with the inputs as they are recorded")
    # Terms that came later may mend what an input that acts otherwise has done: the first alone is asked, too.
    terms = result.final.candidates
    as_thought = [r for k in {1, len(terms)} if (r := search.cache.refit(terms[:k])) is not None]
    records = dataset(first.cache.base.fit)
    if not any((same := fitted_to(r, records)) is not None and same.merit > r.merit for r in as_thought):
        return state
    again = state.searched(first)
    merit = again.result.final.merit - first.chances(again.result.final)
    return replace(again, inputs=()) if merit > result.final.merit - search.chances(result.final) else state


def _with_record_changes(state: Inquiry) -> Inquiry:
    """Return what the search finds once more with what differs from record to record, where that is likelier than what
    was found."""
    search, cache = state.search, state.search.cache
    cache.watch("comparing parameters and offsets that differ from record to record")
    base, changes = record_changes(search, state.result)
    if base is None:
        return state
    free = cache.estimated_again(cache.base)
    # What is left beside them is part of the misfit of the model that was diagnosed.
    diagnosed = cache.diagnosed or (cache.base, cache.on_validation(cache.base))
    again = search.on(base, biases=[*free, *(c.parameter for c in changes)], diagnosed=diagnosed)
    if cache.validation:
        again.cache.try_validation()
    found = state.searched(again)
    return replace(found, changes=tuple(c.beside(found.result.final) for c in changes), unchanged=search)


def _with_inputs_as_sampled(state: Inquiry) -> Inquiry:
    """Return what the search finds once more with inputs between samples estimated from the outputs, where these show
    that the inputs jumped there."""
    search, full = state.search, state.result.full
    cache = search.cache
    least = full.merit - search.chances(full) + RemainderSettings().margin
    cache.watch("comparing inputs that jump between samples")
    fits = [full] if full is cache.base else [full, cache.base]
    each = [(s, s.merit - search.chances(at)) for at in fits if (s := sampled_inputs(at)) is not None]
    found, merit = max(each, key=lambda one: one[1], default=(None, -np.inf))
    if found is not None:  # noise on the record of an input looks like that, too
        noises = Disturbances(cache.base.fit.model).ranked(cache.base, white=True)
        least = max([least, *(d.merit for d in noises if d.place.kind == "input")])
    base = fitted_to(cache.base, found.records) if found is not None and merit > least else None
    if found is None or base is None:
        return state
    return replace(state.searched(search.on(base, found.on(cache.validation, cache.biases))), sampled=found)


def _with_remainder(state: Inquiry) -> Inquiry:
    """Return the state with what is left beside the terms of a search, which fall where they stand in for it."""
    search, result = state.search, state.result
    remainder = remainder_of(search, result)
    if remainder is None:
        return state
    if remainder.known is not None:
        return replace(state, result=search.concluded(remainder.known, None, result.remarks))
    kept = {c.name for c in remainder.at.candidates}
    found = tuple(f for f in result.found if f.candidate is not None and f.candidate.name in kept)
    full = remainder.fitted or remainder.at
    if len(found) == len(result.full.candidates):
        result = replace(result, full=remainder.fitted or result.full, found=found)
    else:
        final = search.cache.refit([c for c in result.final.candidates if c.name in kept], remainder.at.fit)
        result = replace(result, final=final or search.cache.base, full=full, found=found)
    return replace(state, result=result, remainder=remainder)


def _without_surrogates(state: Inquiry) -> Inquiry:
    result, remainder = without_surrogates(state.search, state.result, state.remainder)
    return replace(state, result=result, remainder=remainder)


def words_of_inputs(between: Sequence[RecordedInput], sampled: SampledInputs | None, time: str) -> list[str]:
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
            f"Inputs change faster than they were sampled ({jumps} of up to {sampled.step:.3g} {time}): their values "
            "at the middle of these intervals were estimated, and the search used them. Record inputs at a higher rate."
        )
    return notes
