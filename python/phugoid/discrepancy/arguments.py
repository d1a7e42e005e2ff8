"""Check what a diagnosis is given: the fit, validation records, parameters to re-estimate there, and candidates."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ..data.experiment import Experiment, as_experiments
from ..errors import DataError, ModelError, OptionError, did_you_mean
from ..filter_error import FilterError
from ..fit_result import FitResult
from ..validation import shared
from .candidates.candidate import Candidate
from .candidates.collection import Candidates
from .candidates.library import candidates as library
from .search.refit import Refit

__all__ = ["candidates_given", "check_fit", "check_size", "freed", "validation_given"]

# Samples that every output is to have, and rows for each unknown: fewer do not distinguish noise from misfit.
_FEWEST, _EACH = 40, 5
# Of an output's spread: a residual below it is rounding.
_EXACT = 1e-9


def check_fit(fit: Any) -> None:
    """Raise OptionError for what is not a fit by output error, DataError for a fit without residuals."""
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
    """Raise DataError for records too short to distinguish noise from misfit."""
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
    for what is not a list of parameters."""
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
            raise ModelError(f"diagnose: biases: '{name}' is not a parameter of the model.{hint}")
    return found


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
                f"diagnose: candidates holds {c!r}, which is not a Candidate: make them by ph.candidates(model)"
            )
        if c.place not in places:
            raise OptionError(
                f"diagnose: candidate '{c.name}' acts on {c.place.kind} '{c.place.name}', which the model does not have"
            )
    names = [c.name for c in listed]
    twice = [n for n in dict.fromkeys(names) if names.count(n) > 1]
    if twice:
        raise OptionError(f"diagnose: candidate '{twice[0]}' is given twice")
    return listed
