"""The data that a diagnosis gives: the misfit, its causes, and the model that has them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..errors import OptionError
from ..fit_result import FitResult
from .misfit.misfit import Misfit
from .search.finding import ExtensionResult, Finding, Gain, Scored
from .search.refit import Refit
from .search.search import Search

__all__ = ["DiagnosisResult"]


@dataclass(frozen=True, eq=False, repr=False)
class DiagnosisResult:
    """The data of a `Diagnosis`, which says what each attribute is."""

    fit: FitResult
    misfit: Misfit
    findings: tuple[Finding, ...]
    ranking: tuple[Scored, ...]
    threshold: float
    notes: tuple[str, ...]
    interrupted: bool
    seconds: float
    _search: Search | None = None
    _final: Refit | None = None
    _saved: ExtensionResult | None = None  # where it comes from a file

    @property
    def found(self) -> bool:
        """Whether anything significant is missing."""
        return bool(self.findings)

    def extend(self) -> ExtensionResult:
        """Return the model with all terms that were found, its fit, and the gain over the base model."""
        return self._extension

    @cached_property
    def _extension(self) -> ExtensionResult:
        if self._saved is not None:
            return self._saved
        if self._search is None or self._final is None:
            raise OptionError("extend: nothing was named when this diagnosis was saved, so there is no extended model")
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
        return ExtensionResult(final.fit.model, final.fit, final.names, gain)

    def __repr__(self) -> str:
        what = ", ".join(f.cause or f.status for f in self.findings) or "nothing"
        return f"<Diagnosis of '{self.fit.model.name}': {what}>"


def _rms(records: Any, names: Sequence[str]) -> dict[str, float]:
    """Over all records."""
    found = {}
    for name in names:
        r = np.concatenate([record.residuals[name] for record in records])
        found[name] = float(np.sqrt(np.nanmean(r**2)))
    return found
