"""Public functions that return a `Diagnosis`: those of the search, whose results get their methods here.

They are not in `api`, since a diagnosis takes several times as long to import as an estimation.
"""

from __future__ import annotations

from .api import with_facade
from .diagnosis import Diagnosis, Improvement
from .discrepancy.diagnose import diagnose as _diagnose
from .discrepancy.improve import ImprovementResult
from .discrepancy.improve import improve as _improve
from .discrepancy.search.finding import DiagnosisResult
from .result import Fit

__all__ = ["diagnose", "improve"]


def _diagnosis(found: DiagnosisResult) -> Diagnosis[Fit]:
    return Diagnosis._of(found, Fit)


def _improvement(found: ImprovementResult) -> Improvement[Fit]:
    return Improvement._of(found, Fit)


diagnose = with_facade(_diagnosis, "Diagnosis", _diagnose, __name__)
improve = with_facade(_improvement, "Improvement", _improve, __name__)
