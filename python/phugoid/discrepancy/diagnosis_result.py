"""The data that a diagnosis gives: the misfit, its causes, and the model that has them."""

from __future__ import annotations

from dataclasses import dataclass

from ..errors import OptionError
from ..fit_result import FitResult
from .misfit.misfit import Misfit
from .search.finding import ExtensionResult, Finding, Scored

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
    _extension: ExtensionResult | None = None  # None where it comes from a file, and nothing was named

    @property
    def found(self) -> bool:
        """Whether anything significant is missing."""
        return bool(self.findings)

    def extend(self) -> ExtensionResult:
        """Return the model with all terms that were found, its fit, and the gain over the base model."""
        if self._extension is None:
            raise OptionError("extend: nothing was named when this diagnosis was saved, so there is no extended model")
        return self._extension

    def __repr__(self) -> str:
        what = ", ".join(f.cause or f.status for f in self.findings) or "nothing"
        return f"<Diagnosis of '{self.fit.model.name}': {what}>"
