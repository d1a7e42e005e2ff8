"""What a fit says of its model: the misfit, its causes, and the model that has them."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..errors import DataError, OptionError
from ..estimate import estimate
from ..experiment import Experiment, as_experiments
from ..filter_error import FilterError
from ..result import Fit
from .candidate import Candidate
from .candidates import Candidates, candidates as library, trim_of
from .finding import Finding, Scored
from .held_out import on_other_data
from .linearised import Linearised, collocated, dataset
from .refit import Refit
from .search import Found, Search

__all__ = ["Diagnosis", "diagnose"]

# Samples that an output is to have for its noise to be told from a misfit.
_FEWEST = 40


def diagnose(
    fit: Fit,
    candidates: Sequence[Candidate] | None = None,
    validation: Experiment | Sequence[Experiment] | None = None,
) -> Diagnosis:
    return None  # type: ignore
