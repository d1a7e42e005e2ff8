"""The diagnosis: the search for what a fitted model is missing."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

from ..data.experiment import Experiment
from ..errors import DataError, EvaluationError, joined, some
from ..fit_result import ENDED_WELL, FitResult, dataset
from ..modelling.model import Model
from ..progress import StatusLine
from ..sensitivities.tangents import collocated
from ..solvers import Deadline, check_time, interrupts, limited, one_blas_thread
from .arguments import candidates_given, check_fit, check_size, freed, validation_given
from .candidates.candidate import Candidate
from .candidates.collection import Candidates
from .discrimination import advice_of
from .search import Search, SearchResult
from .search.confirmation import Found
from .search.finding import DiagnosisResult, ExtensionResult, Finding, Scored
from .search.findings import (
    finding_of,
    finding_of_record_change,
    finding_of_recorded_input,
    finding_of_remainder,
    finding_of_sensor_fault,
    finding_of_unsigned_sensor,
    no_optimum,
)
from .search.other_laws import other_laws, words_of_laws
from .search.parts import Parts, parts_of
from .search.refit import Refit, is_structured
from .search.remainder import RemainderSettings
from .search.restart import Restart, of_shared_terms, restarted, with_optimum
from .search.scan import Scan
from .search.segments import Segments, Thinned, segments_of, thinned
from .search.sensor_fault import SensorFault, UnsignedSensor, sensor_faults, unsigned_sensor, without_faults
from .search.stages import Inquiry, ranked, ranking_of, stages, words_of_inputs
from .search.surrogates import with_held_out

__all__ = ["diagnose"]

_Found = TypeVar("_Found")

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

# How a search ended before its end, in words.
_EARLY = {"interrupted": "The search was interrupted", "time limit": "The search reached its time limit"}
# Candidates without a direction of their own that a note names.
_LOST_NAMED, _RECORDS_NAMED = 12, 4


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
    in turn as without them. Where nothing is named and the model fits its records but not the validation records,
    all are searched together, with nothing held out. Long records are searched in windows. Notes say so.

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
        fit = _within(deadline, partial(of_shared_terms, fit), fit)
    records = _prepared(fit, others, deadline)
    if records.base is None:
        assert records.restart is not None
        none: list[Refit] = []
        likelier = _within(deadline, partial(_with_optimum, records.fit, candidates), none)
        return no_optimum(records.given, records.restart.words, likelier, time.perf_counter() - started)
    with _shown(progress) as watch, one_blas_thread():

        def step(text: str) -> None:
            check_time()
            watch(text)

        found = _searched(records, candidates, free, step, deadline)
        again = _within(deadline, partial(_over_segments, found, step), None) if found.is_open else None
        if again is not None:
            other = _searched(again, candidates, free, step, deadline)
            found = found if other.is_open else other
        together = _within(deadline, partial(_together, found, step), None)
        if together is not None:
            other = _searched(together, candidates, None, step, deadline)
            found = other if other.explains_most else found
        records, state = found.records, found.state
        reported = _reported(records, state, deadline)
    with interrupts():
        notes = (*_notes_of_shared_terms(fit.model, declared), *_all_notes(found, reported))
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
class _Records:
    """Hold what is searched: the records without the faults of their sensors, or parts of them.

    given     the fit to diagnose, of the records without these faults; ``fit``: of what is searched.
    base      the same, at an optimum; None where there is none.
    others    the validation records, like the records.
    faults, unsigned, restart, thin, parts, segments   what was done to come to this; None or empty where not needed.
    together   whether the records held out are searched as well, and nothing is held out.
    """

    given: FitResult
    fit: FitResult
    base: Refit | None
    others: Sequence[Experiment]
    faults: Sequence[SensorFault] = ()
    unsigned: UnsignedSensor | None = None
    restart: Restart | None = None
    thin: Thinned | None = None
    parts: Parts | None = None
    segments: Segments | None = None
    together: bool = False

    @property
    def causes(self) -> list[str]:
        """Return the causes that were found in the samples themselves."""
        return [f.cause for f in self.faults] + ([self.unsigned.cause] if self.unsigned is not None else [])

    @property
    def findings(self) -> list[Finding]:
        """Return what is reported of these."""
        faults = [finding_of_sensor_fault(f, self.fit.model.time_unit) for f in self.faults]
        return faults + ([finding_of_unsigned_sensor(self.unsigned)] if self.unsigned is not None else [])


def _prepared(fit: FitResult, others: Sequence[Experiment], deadline: Deadline) -> _Records:
    """Return what is searched of a fit and the validation records."""
    no_faults: tuple[list[SensorFault], FitResult] = ([], fit)
    faults, fit = _within(deadline, partial(sensor_faults, fit), no_faults)
    others = without_faults(others, faults) if faults else others
    unsigned = _within(deadline, partial(unsigned_sensor, fit), None)
    fit = unsigned.fit if unsigned is not None else fit
    begun = collocated(fit) if fit.status in ENDED_WELL else fit
    records = _Records(fit, begun, None, others, faults, unsigned)
    if begun.status not in ENDED_WELL:
        not_again = f"The fit ended as '{begun.status}', and the diagnosis before it could be estimated again"
        restart = _within(deadline, partial(restarted, begun, others), Restart(None, not_again))
        records = replace(records, restart=restart)
        if restart.fit is None:
            return records
        begun = restart.fit
    base = Refit((), begun)
    check_size(base)
    again = records.restart is not None
    thin = None if again else _within(deadline, partial(thinned, base, others), None)
    base, others = (base, others) if thin is None else (thin.base, thin.validation)
    segments = records.restart.segments if records.restart is not None else None
    parts = _within(deadline, partial(parts_of, base, others), None) if segments is None else None
    base, others = (base, others) if parts is None else (parts.base, parts.validation)
    segments = segments or _within(deadline, partial(segments_of, base, others), None)
    base, others = (base, others) if segments is None else (segments.base, segments.validation)
    # That of a fit as it was given is the user's own, on its own mesh.
    own = fit if not again and thin is None and parts is None and segments is None else base.fit
    return replace(records, fit=own, base=base, others=others, thin=thin, parts=parts, segments=segments)


@dataclass(frozen=True, eq=False)
class _Searched:
    """Hold a search of records: the candidates that were ``listed``, what is ``free`` on the validation data, why these
    are ``unfitted`` ("" where they are not), and the ``state`` at its end."""

    records: _Records
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
    def explains_most(self) -> bool:
        """Return whether terms are named that explain most of the misfit."""
        search = self.state.search
        return search.named_part(self.state.result.final) > search.settings.half


def _searched(
    records: _Records,
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


def _over_segments(found: _Searched, step: Callable[[str], None]) -> _Records | None:
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


def _together(found: _Searched, step: Callable[[str], None]) -> _Records | None:
    """Return the records of a search that named nothing together with those held out, where the model fits the former
    and is wrong by more on the latter; None where it does not. Records that hardly excite what is missing hide it, and
    so do parameters that stand in for it, with other values in each record."""
    records, search = found.records, found.state.first
    whole = records.parts is None and records.segments is None and not records.causes
    if not (whole and found.names_nothing and search.cache.validation):
        return None
    assert records.base is not None  # it was searched
    own, elsewhere, times = _HIDDEN
    if is_structured(records.base, own) or not search.assessment.is_worse_elsewhere(records.base, elsewhere, times):
        return None
    step("estimating from all records together")
    base = with_held_out(search, records.base)
    return None if base is None else replace(records, fit=base.fit, base=base, others=(), together=True)


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


def _reported(records: _Records, state: Inquiry, deadline: Deadline) -> _Reported:
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


def _within(deadline: Deadline, work: Callable[[], _Found], otherwise: _Found) -> _Found:
    """Return what is found within the time limit, or what there is where that, or the user, ends it."""
    try:
        with deadline.in_force():
            return work()
    except KeyboardInterrupt:
        return otherwise


def _shown(progress: Any) -> Any:
    """Return a context that gives what to call with each step."""
    if callable(progress):
        return nullcontext(progress)
    if not progress:
        return nullcontext(lambda _: None)
    return _steps_shown()


# Seconds between steps that are shown where each takes a line.
_EVERY = 5.0


@contextmanager
def _steps_shown() -> Iterator[Callable[[str], None]]:
    """Yield a function to call with each step of a diagnosis: it shows the step, and the time since the first."""
    line, began, shown = StatusLine(), time.monotonic(), -math.inf

    def show(text: str) -> None:
        nonlocal shown
        now = time.monotonic()
        if line.is_overwritten or now - shown > _EVERY:
            shown = now
            line.show(f"diagnose, {now - began:.0f} s: {text}")

    try:
        yield show
        line.show(f"diagnose: done after {time.monotonic() - began:.1f} s")
    finally:
        line.keep()


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
        *([_TOGETHER.format(joined([e.name for e in dataset(records.fit)]))] if records.together else []),
        *_notes(scan, final, found.listed, others, found.free, reported.ended, search.settings.most),
        *state.result.remarks,
        *reported.laws,
        *([_OF_THESE_RECORDS.format(", ".join(alone))] if alone else []),
        *([_NOT_EXCITED.format(", ".join(still))] if still and others else []),
        *words_of_inputs(state.inputs, state.sampled, final.fit.model.time_unit),
        *(each.note for each in (records.segments, records.parts, records.thin) if each is not None),
    )


def _notes_of_shared_terms(model: Model, declared: Collection[str]) -> list[str]:
    """Return what the quantities stand for that were declared for the search."""
    added = [f"{n} = {e}" for n, e in model.quantity_expressions().items() if n not in declared]
    return [f"Quantities were declared for what equations share: {'; '.join(added)}."] if added else []


def _shares(model: Model) -> bool:
    """Return whether several state equations have a parameter in common."""
    right = model._right_hand_sides()
    within = [{*e.symbols} for (kind, _), e in right.items() if kind == "equation"]
    return any(sum(n in symbols for symbols in within) > 1 for n in model.parameter_names)


def _notes(
    scan: Scan | None,
    final: Refit,
    listed: Sequence[Candidate],
    others: Sequence[Experiment],
    free: Sequence[str] | None,
    ended: str,
    most: int,
) -> tuple[str, ...]:
    if scan is None:
        return (f"{_EARLY[ended]} before the {len(listed)} candidates were scanned: only the misfit is reported.",)
    notes = [f"{len(listed)} candidates were scanned, with {len(scan.effects)} values of their shape parameters."]
    if scan.lost:
        notes.append(f"Indistinguishable from parameters of the model: {some(scan.lost, _LOST_NAMED)}.")
    if others:
        what = "sensor biases" if free is None else ", ".join(free) or "nothing else"
        notes.append(
            f"Gains were computed on {some([e.name for e in others], _RECORDS_NAMED)}, with initial states and {what} "
            "re-estimated."
        )
    else:
        notes.append(
            "Gains were computed by cross-validation: each quarter of the record was predicted from the others."
        )
    if len(final.candidates) >= most:
        notes.append(f"The search ends after {most} findings: diagnose the extended fit to continue.")
    if not final.fit.model.quantity_names and _shares(final.fit.model):
        notes.append(
            "The model declares no quantities. Of a force, a flow or a rate that several equations share, candidates "
            "act on all of them at once where it is declared by m.quantities(...)."
        )
    if ended:
        notes.append(f"{_EARLY[ended]}: the results up to then are given.")
    return tuple(notes)
