"""Public functions that return a `Diagnosis`: those of the search, whose results get their methods here.

They are not in `api`, since a diagnosis takes several times as long to import as an estimation.
"""

from __future__ import annotations

from functools import partial

from .api import with_facade
from .diagnosis import Diagnosis, Improvement
from .discrepancy.diagnose import diagnose as _diagnose
from .discrepancy.improve import improve as _improve
from .result import Fit

__all__ = ["diagnose", "improve"]


diagnose = with_facade(partial(Diagnosis._of, fits=Fit), "Diagnosis", _diagnose, __name__)
improve = with_facade(partial(Improvement._of, fits=Fit), "Improvement", _improve, __name__)
