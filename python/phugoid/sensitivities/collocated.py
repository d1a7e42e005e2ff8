"""Fits by collocation, which can be linearised, and fits estimated again so that they can."""

from __future__ import annotations

from ..errors import OptionError
from ..estimation.estimate import estimate
from ..fit_result import FitResult, dataset
from ..transcription.collocation import Collocation
from ..transcription.filter_error import FilterError

__all__ = ["cheap", "collocated", "collocated_for"]

# Numbers in tangents that take about as long as an estimation, and that fill some 400 MB.
_SOME, _MANY = 3_000_000, 50_000_000
# Elsewhere curvature says nothing about the data.
_ENDS = ("converged", "acceptable", "unidentifiable")


def collocated(fit: FitResult) -> FitResult:
    """Return the fit by collocation with its solution: re-estimated from the given fit where that is another."""
    inner = fit._moved or fit
    if isinstance(inner.transcription, Collocation) and inner.solution is not None:
        return fit
    return estimate(fit.model, dataset(fit), noise=fit.noise, start=fit)


def cheap(fit: FitResult, again: bool = False) -> bool:
    """Tell whether a fit can be linearised in about the time of an estimation, and without an estimation unless
    ``again``: the tangents of large systems are large."""
    inner = fit._moved or fit
    at_hand = bool(fit.experiments) and isinstance(inner.transcription, Collocation) and inner.solution is not None
    samples, n_x = sum(r.n for r in fit.records), len(fit.model.state_names)
    columns = len(fit.parameters) + 2 * n_x * len(fit.records)
    small = samples * (n_x + len(fit.model.output_names)) * columns <= (_MANY if again else _SOME)
    return small and (at_hand or again)


def collocated_for(fit: FitResult, caller: str) -> FitResult:
    """Return the fit by collocation, for a caller that linearises it.

    Raises OptionError for a fit with process noise, and for one that has not converged.
    """
    if isinstance(fit.transcription, FilterError):
        raise OptionError(
            f"{caller}: is not offered for fits with process noise (FilterError): their innovations are white where "
            "the model is right, and their standard errors hold as they are"
        )
    if fit.status not in _ENDS:
        raise OptionError(f"{caller}: the fit has not converged ({fit.status}): {fit.message or 'see its summary'}")
    return collocated(fit)
