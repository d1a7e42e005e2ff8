"""Find what a fitted model is missing, after checks of what is given."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

import numpy as np

from ..data.experiment import Experiment, as_experiments
from ..errors import DataError, EvaluationError, ModelError, OptionError, did_you_mean, some
from ..filter_error import FilterError
from ..fit_result import ENDED_WELL, FitResult
from ..progress import StatusLine
from ..sensitivities.tangents import collocated
from ..solvers import Deadline, check_time, interrupts, limited, one_blas_thread
from ..validation import shared
from .candidates.candidate import Candidate
from .candidates.collection import Candidates
from .candidates.library import candidates as library
from .discrimination import advice_of
from .search import Search, SearchResult
from .search.confirmation import Found
from .search.data_suspects import (
    unsigned_sensor,
    with_changes,
    with_inputs_as_recorded,
    with_inputs_as_sampled,
    with_proposals,
    with_record_changes,
    with_recorded_input,
    with_remainder,
    words_of_inputs,
)
from .search.finding import DiagnosisResult, Scored
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
from .search.parts import parts_of
from .search.record_change import RecordChange
from .search.recorded_input import RecordedInput, SampledInputs
from .search.refit import Refit, is_structured
from .search.remainder import Remainder, RemainderSettings
from .search.restart import Restart, restarted, with_optimum
from .search.scan import NEARLY, Scan
from .search.segments import segments_of, thinned
from .search.sensor_fault import SensorFault, sensor_faults, without_faults
from .search.stand_ins import without_stand_ins

__all__ = [
    "candidates_given",
    "check_fit",
    "check_size",
    "diagnose",
    "freed",
    "validation_given",
]


# Samples that every output is to have, and rows for each unknown: fewer do not tell noise from misfit.
_FEWEST, _EACH = 40, 5
# Of an output's spread: a residual below it is rounding.
_EXACT = 1e-9


_Found = TypeVar("_Found")


def check_fit(fit: Any) -> None:
    """Raise OptionError for what is no fit by output error, DataError for a fit without residuals."""
    if not isinstance(fit, FitResult):
        raise OptionError(f"diagnose: the first argument is a fit, as estimate gives it, not {type(fit).__name__}")
    if isinstance(fit.transcription, FilterError):
        raise OptionError(
            "diagnose: a fit with process noise explains every misfit by it; estimate without FilterError and "
            "diagnose that"
        )
    for name in fit.model.output_names:
        measured = np.concatenate([r.measured[name] for r in fit.records])
        residual = np.concatenate([r.residuals[name] for r in fit.records])
        there = np.isfinite(measured) & np.isfinite(residual)
        spread = float(np.std(measured[there])) if there.any() else 0.0
        if float(np.sqrt(np.mean(residual[there] ** 2))) <= _EXACT * max(spread, 1e-300):
            raise DataError(
                f"diagnose: the residuals of output '{name}' are all zero: the data are those of the model itself, and "
                "there is no noise that a misfit could be measured against"
            )


def check_size(base: Refit) -> None:
    """Raise DataError for records too short to tell noise from misfit."""
    linear = base.linear
    for name, count in zip(linear.model.output_names, linear.counts, strict=True):
        if count < _FEWEST:
            raise DataError(
                f"diagnose: output '{name}' has {count} samples, too few to distinguish noise from misfit ({_FEWEST})"
            )
    unknowns = linear.n_unknowns
    if linear.n_rows < _EACH * unknowns:
        raise DataError(
            f"diagnose: the record is too short: {linear.n_rows} measurements for {unknowns} unknowns leave nothing to "
            f"judge a misfit by (at least {_EACH} for each)"
        )


def validation_given(fit: FitResult, given: Any) -> Sequence[Experiment]:
    """Return the validation records; raise DataError for one without the channels, or that the fit was made on."""
    if given is None:
        return ()
    others = as_experiments(given, "diagnose: validation")
    for e in others:
        e.check_for(
            fit.model.input_names, fit.model.output_names, fit.model.output_names, conditions=fit.model.condition_names
        )
        if any(shared(fit.model, record, e) == e.n == record.n for record in fit.records):
            raise DataError(
                f"diagnose: the validation record '{e.name}' is one that the fit was made on: give another, or none"
            )
    return others


def freed(fit: FitResult, others: Sequence[Experiment], given: Any) -> tuple[str, ...] | None:
    """Return the parameters to re-estimate in validation records, None where not given; raise OptionError or ModelError
    for what is no list of parameters."""
    if given is None:
        return None
    if not others:
        raise OptionError("diagnose: biases are estimated again in validation records: give validation too")
    if isinstance(given, str) or not isinstance(given, Iterable):
        raise OptionError(f"diagnose: biases is a list of names, such as ['b_q'], or () for none, not {given!r}")
    names = fit.model.parameter_names
    for name in (found := tuple(dict.fromkeys(map(str, given)))):
        if name not in names:
            base = name.partition("[")[0]
            hint = f" Say '{base}', for all experiments." if base in names else did_you_mean(name, names)
            raise ModelError(f"diagnose: biases: '{name}' is no parameter of the model.{hint}")
    return found


def _with_optimum(fit: FitResult, candidates: Any) -> list[Refit]:
    try:
        return with_optimum(fit, candidates_given(fit, candidates, Refit((), fit)))
    except EvaluationError:  # not to be linearised where it was left
        return []


def candidates_given(fit: FitResult, given: Any, base: Refit) -> list[Candidate]:
    """Return the candidates as given, or those of the library; raise OptionError for what cannot be one."""
    points = base.linear.points
    if given is None or isinstance(given, Mapping):
        return list(library(fit.model, points=points, terms=given))
    if isinstance(given, Candidates):
        given = given.on(points)
    if isinstance(given, str) or not isinstance(given, Iterable):
        raise OptionError(f"diagnose: candidates holds Candidates, or terms by place, not {given!r}")
    listed = list(given)
    places = base.linear.places
    for c in listed:
        if not isinstance(c, Candidate):
            raise OptionError(
                f"diagnose: candidates holds {c!r}, which is no Candidate: make them by ph.candidates(model)"
            )
        if c.place not in places:
            raise OptionError(
                f"diagnose: candidate '{c.name}' acts on {c.place.kind} '{c.place.name}', which the model has not"
            )
    names = [c.name for c in listed]
    twice = [n for n in dict.fromkeys(names) if names.count(n) > 1]
    if twice:
        raise OptionError(f"diagnose: candidate '{twice[0]}' is given twice")
    return listed


_OF_THESE_RECORDS = (
    "Only in the records of the fit: {}. With it, the simulation of the validation records does not improve; the "
    "extended model does not contain it."
)


# Part of the misfit that a tone, a drift or an event must explain where the validation records do not have it.
_ALONE = 0.2


def _is_minor(search: Search, result: SearchResult, found: Found, kept: Refit) -> bool:
    """Tell whether what was found is no cause that is named: it explains too little, at the end or on the way there; of
    what the validation records do not confirm (it is not ``kept``) more is asked."""
    name = found.candidate.name if found.candidate is not None else ""
    alone = name in result.final.names and name not in kept.names
    little = alone and found.explained is not None and found.explained.part < _ALONE
    return (bool(name) and name not in result.final.names) or little or search.assessment.is_minor(found.explained)


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


# How a search ended before its end, in words.
_EARLY = {"interrupted": "The search was interrupted", "time limit": "The search reached its time limit"}
# Candidates without a direction of their own that a note names.
_LOST_NAMED = 12


def diagnose(
    fit: FitResult,
    candidates: Candidates | Sequence[Candidate] | Mapping[str, Any] | None = None,
    validation: Experiment | Sequence[Experiment] | None = None,
    *,
    biases: Sequence[str] | None = None,
    progress: bool | Callable[[str], None] = False,
    time_limit: float | None = None,
) -> DiagnosisResult:
    """Return what a fitted model is missing: its misfit, the causes, and what each gains.

    Every candidate is scored from one linearisation of the fit, the best are fitted, and one is accepted where the gain
    in likelihood, with noise that has the autocorrelation of the residuals, is more than chance gives among so many,
    and where it predicts data that were held out. Then again, until nothing significant is left.

    ``candidates``: those of `candidates` for the model unless given; or terms of your own that are added to these, as
    in ``{"Cm": [alpha*q**2]}``.
    ``validation``: other records of the same vehicle; with only first states and biases free they measure the gain.
    Without any, blocks of the records are left out in turn.
    ``biases``: names of the parameters that are estimated again in the validation records, as for `Fit.validate`: trim,
    say. None: biases of sensors, and initial values that each experiment has its own of. Parameters of the dynamics
    with a value for each experiment must be among them, for which one another record has is not known.
    ``progress``: True shows what is done; a function is called with it. Ctrl-C ends the search with what was found, and
    goes on to what is quick; once more, it leaves out the ranking where there is none yet.
    ``time_limit``: in seconds. It ends the search as Ctrl-C does.

    A fit that ended at no optimum is estimated again: continued, with parameters fixed that the data do not determine,
    or begun from short segments of the records, and a note says so. Where none of these converges the misfit is
    unexplained, and the finding says what the status of the fit means, and with which terms there is an optimum. Where
    an output is the size of what the model has for it, without its sign, the model with that is estimated and
    diagnosed; samples that a sensor which is stuck or slowly renewed repeats are left out, and jumps of an angle by a
    turn are taken away. Where the model cannot be fitted to the validation records, blocks of the records are left out
    in turn as without them. Long records are searched in windows, and a note says so.

    Raises DataError for a fit that is exact or of too short a record, and for a validation record without the channels;
    OptionError and ModelError for candidates and biases that cannot be.
    """
    started = time.perf_counter()
    deadline = limited("diagnose", time_limit)
    check_fit(fit)
    others = validation_given(fit, validation)
    free = freed(fit, others, biases)
    no_faults: tuple[list[SensorFault], FitResult] = ([], fit)
    faults, fit = _within(deadline, partial(sensor_faults, fit), no_faults)
    others = without_faults(others, faults) if faults else others
    unsigned = _within(deadline, partial(unsigned_sensor, fit), None)
    fit = unsigned.fit if unsigned is not None else fit
    begun = collocated(fit) if fit.status in ENDED_WELL else fit
    restart = None
    if begun.status not in ENDED_WELL:
        not_again = f"The fit ended as '{begun.status}', and the diagnosis before it could be estimated again"
        restart = _within(deadline, partial(restarted, begun, others), Restart(None, not_again))
    if restart is not None:
        if restart.fit is None:
            none: list[Refit] = []
            likelier = _within(deadline, partial(_with_optimum, begun, candidates), none)
            return no_optimum(fit, restart.words, likelier, time.perf_counter() - started)
        fit = begun = restart.fit
    base = Refit((), begun)
    check_size(base)
    thin = thinned(base, others) if restart is None else None
    if thin is not None:
        base, others, fit = thin.base, thin.validation, thin.base.fit
    parts = parts_of(base, others) if restart is None or restart.segments is None else None
    if parts is not None:
        base, others, fit = parts.base, parts.validation, parts.base.fit
    segments = restart.segments if restart is not None and restart.segments else segments_of(base, others)
    if segments is not None:
        base, others, fit = segments.base, segments.validation, segments.base.fit
    listed = candidates_given(fit, candidates, base)
    unfitted = ""
    with _shown(progress) as watch, one_blas_thread():

        def step(text: str) -> None:
            check_time()
            watch(text)

        search = Search(base, listed, others, step, free)
        try:
            search.cache.try_validation()
        except DataError as error:
            unfitted = f"{str(error).removeprefix('diagnose: ')}: it is left out."
            others, free = (), None
            search = Search(base, listed, others, step, free)
        except KeyboardInterrupt:
            pass  # it is noticed again below
        result = SearchResult(base, base)
        remainder: Remainder | None = None
        between: list[RecordedInput] = []
        sampled: SampledInputs | None = None
        changes: list[RecordChange] = []
        with deadline.in_force():
            # Now, while what the search needs next is at hand.
            ranking, interrupted = _ranked(search, base)
            if not interrupted:
                interrupted = with_proposals(search, lambda near: candidates_given(fit, candidates, near))
            as_recorded = search
            if not interrupted:
                following, interrupted = with_recorded_input(search)
                while following is not None:
                    # All else is sought with the input as it acts.
                    between.append(following)
                    on = search.without_noise if following.kind == "noise" else search.on
                    search = on(following.refit, following.validation)
                    result = SearchResult(following.refit, following.refit)
                    following, interrupted = with_recorded_input(search)
            if not interrupted:
                result = search.run()
                interrupted = result.interrupted
            if not interrupted:
                search, result, between, interrupted = with_inputs_as_recorded(as_recorded, search, result, between)
            before = search
            if not interrupted and segments is None and not (parts is not None and parts.several):
                search, result, changes, interrupted = with_record_changes(search, result)
            if not interrupted:
                search, result, sampled, interrupted = with_inputs_as_sampled(search, result)
            if not interrupted:
                result, remainder, interrupted = with_remainder(search, result)
            if not interrupted:
                result, remainder = without_stand_ins(search, result, remainder)
        ended = deadline.ended() if interrupted else ""
        with interrupts() as pressed:  # what was found is not lost to one more Ctrl-C
            final, found = result.final, result.found
            kept = final if interrupted else search.shared(final)
            # Of long records the parts were searched.
            every = parts.estimated(kept) if parts is not None and not interrupted else None
            findings = [finding_of(result, f, _is_minor(search, result, f, kept), every or kept) for f in found]
            told = [b for b in between if b.kind != "cubic"]
            units, margin = fit.model.units, RemainderSettings().margin
            held = [finding_of_recorded_input(b, margin, units.get(b.name, "")) for b in told]
            held += [finding_of_record_change(c) for c in changes]
            held[:0] = [finding_of_unsigned_sensor(unsigned)] if unsigned is not None else []
            held[:0] = [finding_of_sensor_fault(f) for f in faults]
            findings[:0] = held
            # In white residuals inputs that were sampled too slowly leave what looks like noise of them.
            slowly = sampled is not None and not is_structured(search.cache.base, RemainderSettings().structure)
            known = {b.cause for b in told}
            if (
                remainder is not None
                and known.isdisjoint((remainder.disturbance.name, *remainder.rivals))
                and not (slowly and remainder.is_noise)
            ):
                findings.append(finding_of_remainder(remainder, fit, RemainderSettings().margin))
            extension = search.extension(kept, known=interrupted)
            full = search.extension(result.full, known=interrupted) if result.full is not kept else None
            if parts is not None:
                extension = parts.extension(extension, every)
            if changes:
                extension = with_changes(extension, before, changes)
                full = full and with_changes(full, before, changes)
            interrupted = interrupted or pressed() > 0
        ended = ended or ("interrupted" if interrupted else "")
        laws: list[str] = []
        if not interrupted:
            with deadline.in_force():
                laws = words_of_laws(other_laws(search, kept))
                first = len(held)
                findings[first : first + len(found)] = [
                    replace(each, advice=each.advice or advice_of(search, result, f.candidate, each.aliases))
                    if each.status == "named"
                    else each
                    for each, f in zip(findings[first:], found, strict=False)
                ]
        elif not ranking and not deadline.passed():
            ranking, _ = _ranked(search, base)
    with interrupts():
        corrected = search.cache.base
        if corrected is not base and ranking and not ended:
            ranking = tuple(ranking_of(search, search.cache.scan(corrected)))
        scan = search.cache.scan(corrected) if ranking or not ended else None
        notes = (*_notes(scan, final, listed, others, free, ended, search.settings.most), *result.remarks, *laws)
        alone = [c.name for c in final.candidates if c.name not in kept.names]
        if alone:
            notes = (*notes, _OF_THESE_RECORDS.format(", ".join(alone)))
        notes = (
            *notes,
            *words_of_inputs(between, sampled),
            *([segments.note] if segments else []),
            *([parts.note] if parts else []),
            *([thin.note] if thin else []),
        )
        notes = (*([restart.words] if restart else []), *([unfitted] if unfitted else []), *notes)
        # An input that is held is a finding; one that was sampled slowly is none, nor what comes of it.
        diagnosed = corrected.fit if sampled or any(b.kind == "cubic" for b in between) else fit
        if parts is not None and diagnosed is fit:
            diagnosed = parts.whole.fit
        return DiagnosisResult(
            fit=diagnosed,
            findings=tuple(findings),
            ranking=ranking,
            threshold=search.assessment.threshold(),
            notes=notes,
            interrupted=interrupted,
            seconds=time.perf_counter() - started,
            _extension=extension,
            _full=full,
            _inputs=(
                *(f.cause for f in faults),
                *([unsigned.cause] if unsigned is not None else []),
                *(b.cause for b in told),
            ),
            _validation=tuple(search.cache.validation),
        )


def _within(deadline: Deadline, work: Callable[[], _Found], otherwise: _Found) -> _Found:
    """Return what is found within the time limit, or what there is where that, or the user, ends it."""
    try:
        with deadline.in_force():
            return work()
    except KeyboardInterrupt:
        return otherwise


def _ranked(search: Search, base: Refit) -> tuple[tuple[Scored, ...], bool]:
    """Return the first scan, and whether it was interrupted: then there is none."""
    try:
        search.cache.try_validation()
        return tuple(ranking_of(search, search.cache.scan(base))), False
    except KeyboardInterrupt:
        return (), True


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
    finally:
        line.keep()


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
            f"Gains were computed on {', '.join(e.name for e in others)}, with initial states and {what} re-estimated."
        )
    else:
        notes.append(
            "Gains were computed by cross-validation: each quarter of the record was predicted from the others."
        )
    if len(final.candidates) >= most:
        notes.append(f"The search ends after {most} findings: diagnose the extended fit to continue.")
    if not final.fit.model.quantity_names:
        notes.append(
            "The model declares no quantities. Candidates for a force or a moment are tried, in all equations at once, "
            "where it is declared by m.quantities(...)."
        )
    if ended:
        notes.append(f"{_EARLY[ended]}: the results up to then are given.")
    return tuple(notes)
