"""The diagnosis: the search for what a fitted model is missing."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from ..data.experiment import Experiment
from ..errors import DataError, EvaluationError, joined
from ..fit_result import FitResult, dataset
from ..progress import steps_shown
from ..solvers import Deadline, check_time, interrupts, limited, one_blas_thread
from .arguments import candidates_given, check_fit, freed, validation_given
from .candidates.candidate import Candidate
from .candidates.collection import Candidates
from .candidates.terms import where
from .discrimination import advice_of
from .notes import notes_of_shared_terms, search_notes
from .prepared import PreparedRecords, prepared, within
from .search import Search, SearchResult
from .search.confirmation import Found
from .search.finding import DiagnosisResult, ExtensionResult, Finding, Scored
from .search.findings import (
    finding_of,
    finding_of_record_change,
    finding_of_recorded_input,
    finding_of_remainder,
    no_optimum,
)
from .search.other_laws import other_laws, words_of_laws
from .search.refit import Refit, is_structured
from .search.remainder import RemainderSettings
from .search.restart import of_shared_terms, with_optimum
from .search.segments import segments_of
from .search.stages import Inquiry, ranked, ranking_of, stages, words_of_inputs
from .search.surrogates import missing_in_all, with_held_out

__all__ = ["diagnose"]

_NOT_EXCITED = (
    "The validation records hardly excite {}: its gain on data held out is that of cross-validation within the records."
)
_OF_THESE_RECORDS = (
    "Only in the records of the fit: {}. With it, the simulation of the validation records does not improve; the "
    "extended model does not contain it."
)
_TOGETHER = (
    "No cause was found with the model estimated from the records of the fit alone, which misses those held out by far "
    "more. All records together showed one: the model was estimated from {}, and nothing was held out."
)
_MORE_TOGETHER = (
    "The records of the fit alone suggested {}. Estimated from all records together, the model with that still lacks a "
    "function of {} in {} (gain in log-likelihood {:+.1f}). Therefore {} were searched together, and nothing was held "
    "out."
)


# Part of the misfit that a tone, a drift or an event must explain where the validation records do not have it.
_ALONE = 0.2


def _is_minor(search: Search, result: SearchResult, found: Found, kept: Refit) -> bool:
    """Return whether a term that was found is not to be named: it explains too little, at the end or in an earlier
    step; more is required of a term that the validation records do not confirm (it is not ``kept``)."""
    name = found.candidate.name if found.candidate is not None else ""
    alone = name in result.final.names and name not in kept.names
    little = alone and found.explained is not None and found.explained.part < _ALONE
    minor = search.assessment.is_minor(found.explained, found.of_the_rest)
    return (bool(name) and name not in result.final.names) or little or minor


# Part of the residuals' power that is predictable in the records of the fit, at most, and in those held out, at least,
# and times the RMS of the former, for what is missing to be searched for in all records together.
_HIDDEN = 0.5, 0.5, 1.5


def diagnose(
    fit: FitResult,
    candidates: Candidates | Sequence[Candidate] | Mapping[str, Any] | None = None,
    validation: Experiment | Sequence[Experiment] | None = None,
    *,
    biases: Sequence[str] | None = None,
    progress: bool | Callable[[str], None] = False,
    time_limit: float | None = None,
) -> DiagnosisResult:
    """Find what a fitted model is missing; return its misfit, the causes, and the gain of each.

    Every candidate is scored from one linearisation of the fit, the best are fitted, and one is accepted where the gain
    in likelihood, with noise that has the autocorrelation of the residuals, is more than chance gives among so many,
    and where it predicts data that were held out. This is repeated with
    the cause in the model, until no candidate is significant.

    ``candidates``: those of `candidates` for the model unless given; or terms of your own that are added to these, as
    in ``{"Cm": [alpha*q**2]}``.
    ``validation``: other records of the same vehicle; with only initial states and biases free they measure the gain.
    Without any, blocks of the records are left out in turn.
    ``biases``: names of the parameters that are estimated again in the validation records, as for `Fit.validate`,
    such as the trim. None: sensor biases, and initial values with a value for each experiment. Parameters of the
    dynamics with a value for each experiment must be among them, since their value in another record is not known.
    ``progress``: True shows what is done; a function is called with it. Ctrl-C ends the search, and the
    result has what was found until then; pressed again, it ends without a ranking where there is none yet.
    ``time_limit``: in seconds. It ends the search as Ctrl-C does.

    A fit that ended at no optimum is estimated again: continued, with parameters fixed that the data do not determine,
    or begun from short segments of the records, and a note says so. Where none of these converges the misfit is
    unexplained, and the finding says what the status of the fit means, and with which terms there is an optimum. Where
    an output is the magnitude of what the model computes, the model with the magnitude is estimated and diagnosed;
    repeated samples of a sensor that is stuck or renewed at a lower rate are left out, and jumps of an angle by a full
    turn are removed. Where the model cannot be fitted to the validation records, blocks of the records are left out
    in turn as without them. Where nothing is named and the model fits its records but not the validation records, or
    where all records together show that more is missing than what is named, all are searched together, with nothing
    held out. Long records are searched in windows. Notes say so.

    Raises DataError for a fit that is exact or of too short a record, and for a validation record without the channels;
    OptionError and ModelError for candidates and biases that cannot be.
    """
    started = time.perf_counter()
    deadline = limited("diagnose", time_limit)
    check_fit(fit)
    others = validation_given(fit, validation)
    free = freed(fit, others, biases)
    declared = {*fit.model.quantity_names}
    if candidates is None or isinstance(candidates, Mapping):
        fit = within(deadline, partial(of_shared_terms, fit), fit)
    records = prepared(fit, others, deadline)
    if records.base is None:
        assert records.restart is not None
        none: list[Refit] = []
        likelier = within(deadline, partial(_with_optimum, records.fit, candidates), none)
        return no_optimum(records.given, records.restart.words, likelier, time.perf_counter() - started)
    with steps_shown("diagnose", progress) as watch, one_blas_thread():

        def step(text: str) -> None:
            check_time()
            watch(text)

        found = _searched(records, candidates, free, step, deadline)
        again = within(deadline, partial(_over_segments, found, step), None) if found.is_open else None
        if again is not None:
            other = _searched(again, candidates, free, step, deadline)
            found = found if other.is_open else other
        together = within(deadline, partial(_together, found, step), None)
        if together is not None:
            other = _searched(together, candidates, None, step, deadline)
            enough = other.explains_most if found.names_nothing else other.finds_something
            found = other if enough else found
        records, state = found.records, found.state
        reported = _reported(records, state, deadline)
    with interrupts():
        notes = (*notes_of_shared_terms(fit.model, declared), *_all_notes(found, reported))
        # An input that is held is a finding; one that was sampled slowly is none, nor what comes of it.
        corrected = state.sampled is not None or any(b.kind == "cubic" for b in state.inputs)
        whole = records.parts.whole.fit if records.parts is not None else records.fit
        return DiagnosisResult(
            fit=state.search.cache.base.fit if corrected else whole,
            findings=tuple(sorted(reported.findings, key=lambda f: f.status == "minor")),
            ranking=reported.ranking,
            threshold=state.search.assessment.threshold(),
            notes=notes,
            interrupted=reported.interrupted,
            seconds=time.perf_counter() - started,
            _extension=reported.extension,
            _full=reported.full,
            _inputs=(*records.causes, *(b.cause for b in state.inputs if b.kind != "cubic")),
            _validation=tuple(state.search.cache.validation),
        )


@dataclass(frozen=True, eq=False)
class _Searched:
    """Hold a search of records: the candidates that were ``listed``, what is ``free`` on the validation data, why these
    are ``unfitted`` ("" where they are not), and the ``state`` at its end."""

    records: PreparedRecords
    listed: Sequence[Candidate]
    free: Sequence[str] | None
    unfitted: str
    state: Inquiry

    @property
    def is_open(self) -> bool:
        """Return whether the search came to its end and nothing is named, nor is a disturbance or a function."""
        state, rest = self.state, self.state.remainder
        named = state.result.final.candidates or state.inputs or state.changes
        described = rest is not None and (rest.fitted is not None or not rest.is_unknown)
        return not (state.interrupted or named or described)

    @property
    def names_nothing(self) -> bool:
        """Return whether the search came to its end without a term, an input or a change that is found."""
        state = self.state
        found = state.result.final.candidates or state.inputs or state.sampled or state.changes
        return not (state.interrupted or found)

    @property
    def finds_something(self) -> bool:
        """Return whether the search came to its end and says that something is missing, be it without a name."""
        state = self.state
        return not state.interrupted and bool(state.result.found or state.inputs or state.remainder)

    @property
    def names_terms_only(self) -> bool:
        """Return whether the search came to its end and names terms, with the inputs and records as they are."""
        state = self.state
        others = state.inputs or state.sampled or state.changes
        return bool(state.result.final.candidates) and not (state.interrupted or others)

    @property
    def explains_most(self) -> bool:
        """Return whether terms are named that explain most of the misfit."""
        search = self.state.search
        return search.named_part(self.state.result.final) > search.settings.half


def _searched(
    records: PreparedRecords,
    candidates: Any,
    free: Sequence[str] | None,
    step: Callable[[str], None],
    deadline: Deadline,
) -> _Searched:
    """Return what the stages of a diagnosis find in records."""
    assert records.base is not None
    listed = candidates_given(records.fit, candidates, records.base)
    unfitted = ""
    search = Search(records.base, listed, records.others, step, free)
    try:
        with deadline.in_force():
            search.cache.try_validation()
    except DataError as error:
        unfitted = f"{str(error).removeprefix('diagnose: ')}: it is left out."
        free = None
        search = Search(records.base, listed, (), step, free)
    except KeyboardInterrupt:
        pass  # it is noticed again below
    with deadline.in_force():
        differ = records.segments is None and not (records.parts is not None and records.parts.several)
        about = partial(candidates_given, records.fit, candidates)
        state = Inquiry.begun(search).after(stages(about, differ))
    return _Searched(records, listed, free, unfitted, state)


def _over_segments(found: _Searched, step: Callable[[str], None]) -> PreparedRecords | None:
    """Return the records of a search that named nothing in segments, where the model drifts away from the whole; None
    where it does not."""
    records = found.records
    assert records.base is not None  # it was searched
    if records.segments is not None:
        return None
    step("estimating from segments of the records")
    pieces = segments_of(records.base, records.others, farthest=True)
    if pieces is None:
        return None
    return replace(records, fit=pieces.base.fit, base=pieces.base, others=pieces.validation, segments=pieces)


def _together(found: _Searched, step: Callable[[str], None]) -> PreparedRecords | None:
    """Return the records of a search together with those held out: where nothing is named, and the model fits its
    records but is wrong by more on those held out; or where all records together show that more is missing than what
    is named. None else. Records that hardly excite what is missing hide it, or show something that acts alike there,
    and so do parameters that stand in for it, with other values in each record."""
    records, search = found.records, found.state.first
    whole = records.parts is None and records.segments is None and not records.causes
    if not (whole and search.cache.validation):
        return None
    assert records.base is not None  # it was searched
    names = joined([e.name for e in (*dataset(records.base.fit), *search.cache.validation)])
    if found.names_nothing:
        own, elsewhere, times = _HIDDEN
        if is_structured(records.base, own) or not search.assessment.is_worse_elsewhere(records.base, elsewhere, times):
            return None
        step("estimating from all records together")
        base, why = with_held_out(search, records.base), _TOGETHER.format(names)
    elif found.names_terms_only:
        step("comparing what was found with all records together")
        final = found.state.result.final
        more = missing_in_all(search, final)
        if more is None:
            return None
        base, function = more.base, more.function
        terms, variables = joined(final.names), joined(function.variables)
        why = _MORE_TOGETHER.format(terms, variables, where(function.place), more.gain, names)
    else:
        return None
    return None if base is None else replace(records, fit=base.fit, base=base, others=(), together=why)


@dataclass(frozen=True, eq=False)
class _Reported:
    """Hold what is reported: findings, in their order, the extension by those that are kept, and that by all."""

    findings: Sequence[Finding]
    ranking: tuple[Scored, ...]
    kept: Refit
    laws: Sequence[str]
    extension: ExtensionResult
    full: ExtensionResult | None
    interrupted: bool
    ended: str


def _reported(records: PreparedRecords, state: Inquiry, deadline: Deadline) -> _Reported:
    """Return what is reported of a state, with what more is to be worked out for that within the time limit."""
    search, result = state.search, state.result
    ended = deadline.ended() if state.interrupted else ""
    with interrupts() as pressed:  # what was found is not lost to one more Ctrl-C
        kept = result.final if state.interrupted else search.shared(result.final)
        # Of long records the parts were searched.
        parts = records.parts
        every = parts.estimated(kept) if parts is not None and not state.interrupted else None
        margin = RemainderSettings().margin
        inputs = [b for b in state.inputs if b.kind != "cubic"]
        before = records.findings
        before += [finding_of_recorded_input(b, margin, records.fit.model) for b in inputs]
        before += [finding_of_record_change(c) for c in state.changes]
        terms = [finding_of(result, f, _is_minor(search, result, f, kept), every or kept) for f in result.found]
        rest = []
        if state.remainder is not None and not _is_of_inputs(state):
            rest.append(finding_of_remainder(state.remainder, records.fit, margin))
        extension = state.extension(kept)
        full = state.extension(result.full) if result.full is not kept else None
        if parts is not None:
            extension = parts.extension(extension, every)
        interrupted = state.interrupted or pressed() > 0
    ended = ended or ("interrupted" if interrupted else "")
    ranking, laws = state.ranking, list[str]()
    if not interrupted:
        with deadline.in_force():
            laws = words_of_laws(other_laws(search, kept))
            terms = [
                replace(each, advice=each.advice or advice_of(search, result, f.candidate, each.aliases))
                if each.status == "named"
                else each
                for each, f in zip(terms, result.found, strict=True)
            ]
    elif not ranking and not deadline.passed():
        ranking = replace(state, interrupted=False).after([ranked]).ranking
    with interrupts():
        if search.cache.base is not records.base and ranking and not ended:
            ranking = tuple(ranking_of(search, search.cache.scan(search.cache.base)))
    return _Reported([*before, *terms, *rest], ranking, kept, laws, extension, full, interrupted, ended)


def _is_of_inputs(state: Inquiry) -> bool:
    """Return whether the remainder is that of an input that was found, or comes from inputs that were sampled too
    slowly, which in white residuals has the same effect as noise of the input."""
    remainder = state.remainder
    assert remainder is not None
    known = {b.cause for b in state.inputs if b.kind != "cubic"}
    slowly = state.sampled is not None and not is_structured(state.search.cache.base, RemainderSettings().structure)
    return not known.isdisjoint((remainder.disturbance.name, *remainder.alternatives)) or (
        slowly and remainder.is_noise
    )


def _with_optimum(fit: FitResult, candidates: Any) -> list[Refit]:
    try:
        return with_optimum(fit, candidates_given(fit, candidates, Refit((), fit)))
    except EvaluationError:  # not to be linearised where it was left
        return []


def _all_notes(found: _Searched, reported: _Reported) -> tuple[str, ...]:
    """Return the notes: on the records, on the search, and on what it found."""
    records, state, unfitted = found.records, found.state, found.unfitted
    search, final = state.search, state.result.final
    scan = search.cache.scan(search.cache.base) if reported.ranking or not reported.ended else None
    alone = [c.name for c in final.candidates if c.name not in reported.kept.names]
    still = [c.name for c in final.candidates if c.name in search.assessment.not_excited]
    others = () if unfitted else records.others
    return (
        *([records.restart.words] if records.restart is not None else []),
        *([unfitted] if unfitted else []),
        *([records.together] if records.together else []),
        *search_notes(scan, final, found.listed, others, found.free, reported.ended, search.settings.most),
        *state.result.remarks,
        *reported.laws,
        *([_OF_THESE_RECORDS.format(", ".join(alone))] if alone else []),
        *([_NOT_EXCITED.format(", ".join(still))] if still and others else []),
        *words_of_inputs(state.inputs, state.sampled, final.fit.model.time_unit),
        *(each.note for each in (records.segments, records.parts, records.thin) if each is not None),
    )
