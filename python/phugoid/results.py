"""Result classes, for annotations and `isinstance`; they are returned by functions, not constructed by users."""

import warnings
from typing import TYPE_CHECKING, Any

from .design.manoeuvre_list import Manoeuvre, Manoeuvres
from .design.plan import Excursion, Plan, Plans
from .diagnosis import Diagnosis, Extension, Improvement
from .discrepancy.candidates.candidate import Candidate
from .discrepancy.candidates.collection import Candidates
from .discrepancy.misfit.misfit import Misfit
from .discrepancy.search.finding import Finding, Gain, Scored
from .estimation.starts import Outcome
from .fit_result import FitResult, Refinement, Smoothing
from .fleet.missing import MissingEffect, MissingEffects
from .fleet.population import Population
from .fleet.result import FleetFit, FlightResult, Unlike
from .goodness_of_fit import Match
from .linear.response import FrequencyResponse
from .linear.state_space import Mode, Modes
from .linear.trim import Trim
from .many_starts import Multistart
from .many_starts.optima import Optimum
from .online.estimate import Alarm, OnlineEstimate
from .online.history import OnlineHistory
from .parameters import Estimate
from .petab.problem import PetabProblem
from .reconstruction import Reconstruction, VanePositions
from .records import Record
from .regression.equation_error import EquationError
from .regression.term_selection import SelectedTerms, SelectionStep
from .sensitivities import Place, Points
from .simulation import IntegrationError
from .solvers import Iteration
from .uncertainty.bands import Bands
from .uncertainty.bootstrap import Bootstrap
from .uncertainty.coloured import CorrectedErrors
from .uncertainty.correlation import Correlation, WeakDirection
from .uncertainty.profile import Profile, Profiles
from .validation import Validation

__all__ = [
    "Alarm",
    "Bands",
    "Bootstrap",
    "Candidate",
    "Candidates",
    "CorrectedErrors",
    "Correlation",
    "Diagnosis",
    "EquationError",
    "Estimate",
    "Excursion",
    "Extension",
    "Finding",
    "FitResult",
    "FleetFit",
    "FlightResult",
    "FrequencyResponse",
    "Gain",
    "Improvement",
    "IntegrationError",
    "Iteration",
    "Manoeuvre",
    "Manoeuvres",
    "Match",
    "Misfit",
    "MissingEffect",
    "MissingEffects",
    "Mode",
    "Modes",
    "Multistart",
    "OnlineEstimate",
    "OnlineHistory",
    "Optimum",
    "Outcome",
    "PetabProblem",
    "Place",
    "Plan",
    "Plans",
    "Points",
    "Population",
    "Profile",
    "Profiles",
    "Reconstruction",
    "Record",
    "Refinement",
    "Scored",
    "SelectedTerms",
    "SelectionStep",
    "Smoothing",
    "Trim",
    "Unlike",
    "Validation",
    "VanePositions",
    "WeakDirection",
]

_RENAMED = {"Coloured": "CorrectedErrors", "VanePlaces": "VanePositions"}

if not TYPE_CHECKING:  # for type checkers, a name that is not imported above is an error

    def __getattr__(name: str) -> Any:
        """Return a class by its former name, with a DeprecationWarning that gives the present one."""
        if name not in _RENAMED:
            raise AttributeError(f"module 'phugoid.results' has no attribute '{name}'")
        warnings.warn(
            f"phugoid.results.{name} is now phugoid.results.{_RENAMED[name]}", DeprecationWarning, stacklevel=2
        )
        return globals()[_RENAMED[name]]
