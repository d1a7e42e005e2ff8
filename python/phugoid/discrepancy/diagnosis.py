"""What a fit says of its model: the misfit, its causes, and the model that has them."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import DataError, OptionError, PhugoidError
from ..experiment import Experiment, as_experiments
from ..filter_error import FilterError
from ..result import Fit
from ..validate import shared
from .candidate import Candidate
from .candidates import candidates as library
from .collection import Candidates
from .extension import Extension, Gain
from .figures import findings_figure, gain_figure, misfit_figure, ranking_figure
from .finding import Finding, Scored
from .linearised import collocated
from .misfit import Misfit, misfit
from .page import report
from .refit import Refit
from .scan import NEARLY, Scan
from .search import MOST, Found, Search, is_physical
from .telling import telling_manoeuvre
from .words import diagnosis_summary

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Diagnosis", "diagnose"]

# Samples that every output is to have, and rows for each unknown: fewer do not tell noise from misfit.
_FEWEST, _EACH = 40, 5
# Aliases that are named beside a cause.
_ALIASES = 3
# Of an output's spread: a residual below it is rounding.
_EXACT = 1e-9
_INTERVAL = 1.959963984540054  # 95 % of a normal distribution


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis:
    """What `diagnose` finds.

    fit         that was diagnosed.
    misfit      what it gets wrong: per channel, when, in which regime, at which frequencies.
    findings    what is missing, in the order in which it was found.
    ranking     all candidates of the first scan with their statistics, in the order of `Scored.ranking`.
    threshold   that twice the gain in log-likelihood of a candidate with one coefficient has to pass; findings have
                theirs, in log-likelihood itself.
    notes       what was done, in words.
    seconds     that it took.
    """

    fit: Fit
    misfit: Misfit
    findings: tuple[Finding, ...]
    ranking: tuple[Scored, ...]
    threshold: float
    notes: tuple[str, ...]
    seconds: float
    _search: Search
    _final: Refit

    @property
    def found(self) -> bool:
        """Whether anything significant is missing."""
        return bool(self.findings)

    def extend(self) -> Extension:
        """The model with all terms that were found, its fit, and the gain over the base model."""
        return self._extension

    @cached_property
    def _extension(self) -> Extension:
        base, final, search = self._search.base, self._final, self._search
        n = base.linear.n_rows
        more = len(final.fit.model.parameter_names) - len(base.fit.model.parameter_names)
        white = final.fit.log_likelihood - base.fit.log_likelihood
        names = base.fit.model.output_names
        gain = Gain(
            log_likelihood=white,
            log_likelihood_whitened=search.gain(base, final) / 2,
            bic=-2.0 * white + more * float(np.log(n)),
            held_out=search.held_out(base, final)[0] if final.candidates else 0.0,
            rms_before=_rms(base.fit.records, names),
            rms_after=_rms(final.fit.records, names),
            held_out_rms_before=search.held_out_rms(base),
            held_out_rms_after=search.held_out_rms(final),
        )
        return Extension(final.fit.model, final.fit, final.names, gain)

    def summary(self) -> str:
        """What was found, in plain words."""
        return diagnosis_summary(self)

    def plot(self) -> list[Figure]:
        """Figures: the misfit, the ranking of candidates; where something was found, what it explains and gains."""
        figures = [misfit_figure(self.misfit, self.fit)[0]]
        if self.ranking:
            figures.append(ranking_figure(self.ranking, self.threshold)[0])
        if self._final.candidates:
            extension = self.extend()
            figures.append(findings_figure(self.fit, extension)[0])
            figures.append(gain_figure(extension.gain, self.fit.model.units)[0])
        return figures

    def report(self, path: str | os.PathLike[str]) -> None:
        """Writes one HTML page that a colleague understands: what was wrong, the evidence, the cause and its rivals,
        the new equation, the gain."""
        report(self, path)

    def __repr__(self) -> str:
        what = ", ".join(f.cause or f.status for f in self.findings) or "nothing"
        return f"<Diagnosis of '{self.fit.model.name}': {what}>"

    def __str__(self) -> str:
        return self.summary()


def diagnose(
    fit: Fit,
    candidates: Candidates | Sequence[Candidate] | Mapping[str, Any] | None = None,
    validation: Experiment | Sequence[Experiment] | None = None,
    *,
    progress: bool | Callable[[str], None] = False,
) -> Diagnosis:
    """What a fitted model is missing: shows the misfit, names its causes, measures what each gains.

    Every candidate is scored from one linearisation of the fit, the best are fitted, and one is accepted where the gain
    in likelihood, with noise as coloured as the residuals are, is more than chance gives among so many, and where it
    predicts data that were held out. Then again, until nothing significant is left.

    ``candidates``: those of `candidates` for the model unless given; or terms of your own that are added to these, as
    in ``{"Cm": [alpha*q**2]}``.
    ``validation``: other records of the same vehicle; with only first states and sensor biases free they measure the
    gain. Without any, blocks of the records are left out in turn.
    ``progress``: True shows what is done; a function is called with it. Ctrl-C ends the search with what was found.

    Raises DataError for a fit that has not converged, that is exact, or of too short a record, and for a validation
    record without the channels; OptionError and ModelError for candidates that cannot be.
    """
    started = time.perf_counter()
    _check(fit)
    others = _validation(fit, validation)
    base = Refit((), collocated(fit))
    _check_size(base)
    listed = _candidates(fit, candidates, base)
    with _shown(progress) as watch:
        search = Search(base, listed, others, watch)
        final, interrupted = base, False
        found: list[Found] = []
        try:
            # Now, while what the search needs next is at hand.
            ranking = tuple(_ranking(search, search.scan(base)))
        except KeyboardInterrupt:
            interrupted = True
        else:
            final, found, interrupted = search.run()
        findings = tuple(_finding(search, final, f) for f in found)
    scan = search.scan(base)
    if interrupted and not final.candidates:
        ranking = tuple(_ranking(search, scan))
    notes = (*_notes(scan, final, listed, others if not search.notes else (), interrupted), *search.notes)
    return Diagnosis(
        fit=fit,
        misfit=misfit(fit),
        findings=findings,
        ranking=ranking,
        threshold=search.threshold(),
        notes=notes,
        seconds=time.perf_counter() - started,
        _search=search,
        _final=final,
    )


def _check(fit: Any) -> None:
    if not isinstance(fit, Fit):
        raise OptionError(f"diagnose: the first argument is a fit, as estimate gives it, not {type(fit).__name__}")
    if isinstance(fit.transcription, FilterError):
        raise OptionError(
            "diagnose: a fit with process noise explains every misfit by it; estimate without FilterError and "
            "diagnose that"
        )
    if fit.status not in ("converged", "acceptable"):
        raise DataError(
            f"diagnose: the fit ended as '{fit.status}': {fit.message}. What is missing shows at an optimum only: "
            "mend the fit first"
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


def _check_size(base: Refit) -> None:
    linear = base.linear
    for name, count in zip(linear.model.output_names, linear.counts, strict=True):
        if count < _FEWEST:
            raise DataError(
                f"diagnose: output '{name}' has {count} samples, too few to tell noise from misfit ({_FEWEST})"
            )
    unknowns = linear.tangents.shape[1]
    if linear.n_rows < _EACH * unknowns:
        raise DataError(
            f"diagnose: the record is too short: {linear.n_rows} measurements for {unknowns} unknowns leave nothing to "
            f"judge a misfit by (at least {_EACH} for each)"
        )


def _validation(fit: Fit, given: Any) -> Sequence[Experiment]:
    if given is None:
        return ()
    others = as_experiments(given, "diagnose: validation")
    for e in others:
        e.check_for(fit.model.input_names, fit.model.output_names, fit.model.output_names)
        if any(shared(fit.model, record, e) == e.n == record.n for record in fit.records):
            raise DataError(
                f"diagnose: the validation record '{e.name}' is one that the fit was made on: give another, or none"
            )
    return others


def _candidates(fit: Fit, given: Any, base: Refit) -> list[Candidate]:
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
        raise OptionError(f"diagnose: candidate '{twice[0]}' is there twice")
    return listed


def _shown(progress: Any) -> Any:
    """A context that gives what to call with each step."""
    if callable(progress):
        return nullcontext(progress)
    if not progress:
        return nullcontext(lambda _: None)
    return _Status()


class _Status:
    def __enter__(self) -> Callable[[str], None]:
        from rich.console import Console  # not at import: it takes its time

        self._status = Console(stderr=True).status("diagnose")
        self._status.__enter__()
        return lambda text: self._status.update(text)

    def __exit__(self, *error: Any) -> None:
        self._status.__exit__(*error)


def _finding(search: Search, final: Refit, found: Found) -> Finding:
    aliases = tuple(found.rivals)[:_ALIASES]
    if found.candidate is None:
        nothing = float("nan")
        return Finding(
            cause="",
            aliases=aliases,
            status="unexplained",
            coefficient=nothing,
            std_error=nothing,
            interval=(nothing, nothing),
            unit="",
            parameters={},
            gain=found.gain,
            held_out_gain=found.held_out[0],
            threshold=found.threshold,
            explanation="the residuals hold more than noise, but no candidate predicts data that were held out",
            rivals=dict(found.rivals),
        )
    c = found.candidate
    parameters = final.parameters(c)
    name = next(iter(parameters))
    value, error = parameters[name]
    return Finding(
        cause=c.name,
        aliases=aliases,
        status="named" if is_physical(final, c) else "surrogate",
        coefficient=value,
        std_error=error,
        interval=(value - _INTERVAL * error, value + _INTERVAL * error),
        unit=final.fit.parameters[name].unit,
        parameters=parameters,
        gain=found.gain,
        held_out_gain=found.held_out[0],
        threshold=found.threshold,
        explanation=c.explanation,
        units={n: final.fit.parameters[n].unit for n in parameters},
        advice=_advice(search, final, c, aliases),
        rivals=dict(found.rivals),
    )


def _advice(search: Search, final: Refit, candidate: Candidate, aliases: Sequence[str]) -> str:
    """Which manoeuvre would tell a candidate from its aliases."""
    others = [c for c in final.candidates if c is not candidate]
    named = {c.name: c for c in reversed(search.candidates)}
    refits = [search.refit([*others, named[name]], final.fit) for name in aliases]
    rivals = [r for r in refits if r is not None]
    if not rivals:
        return ""
    search.watch(f"looking for a manoeuvre that tells {candidate.name} from {', '.join(aliases)}")
    try:
        return telling_manoeuvre(final, rivals)
    except (PhugoidError, np.linalg.LinAlgError, KeyboardInterrupt):
        return ""  # advice only: what was found stays


def _ranking(search: Search, scan: Scan) -> list[Scored]:
    """The candidates at their best shapes."""
    through = {"base": search.base.own.filter, "clean": scan.clean(), "white": scan.white.filter}
    values = {which: scan.through(filter) for which, filter in through.items()}
    best: dict[str, int] = {}
    for i in np.argsort(-values["clean"].values):
        best.setdefault(scan.effects[i][0].name, int(i))
    found = []
    for name, i in best.items():
        candidate, shape = scan.effects[i]
        distinct = float(scan.distinct[i])
        remark = "hardly to be told from the parameters already there" if distinct < NEARLY else ""
        amplitude = values["clean"].amplitudes[i].tolist()
        estimate = {**dict(zip(candidate.coefficients, amplitude, strict=False)), **shape}
        base, clean, white = (float(v.values[i]) for v in values.values())
        found.append(Scored(name, candidate.explanation, estimate, base, clean, white, distinct, remark))
    by_name = {c.name: c for c in search.candidates}
    for name in scan.lost:
        remark = "cannot be told from the parameters already there"
        found.append(Scored(name, by_name[name].explanation, {}, 0.0, 0.0, 0.0, 0.0, remark))
    return found


def _notes(
    scan: Scan, final: Refit, listed: Sequence[Candidate], others: Sequence[Experiment], interrupted: bool
) -> tuple[str, ...]:
    notes = [f"{len(listed)} candidates, {len(scan.effects)} with their shapes, were scanned."]
    if scan.lost:
        notes.append(f"Cannot be told from the parameters already there: {', '.join(scan.lost)}.")
    if others:
        notes.append(
            f"Gains were measured on {', '.join(e.name for e in others)}, with first states and sensor biases free."
        )
    else:
        notes.append("Gains were measured on a quarter of the record at a time, predicted from the others.")
    if len(final.candidates) >= MOST:
        notes.append(f"The search ends after {MOST} findings: diagnose the extended fit for what is left.")
    if interrupted:
        notes.append("The search was interrupted: what it had found until then is here.")
    return tuple(notes)


def _rms(records: Any, names: Sequence[str]) -> dict[str, float]:
    """Over all records."""
    found = {}
    for name in names:
        r = np.concatenate([record.residuals[name] for record in records])
        found[name] = float(np.sqrt(np.nanmean(r**2)))
    return found
