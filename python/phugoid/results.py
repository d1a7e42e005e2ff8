"""What functions give back: for annotations and `isinstance`. Nobody makes these by hand."""

from .discrepancy.candidate import Candidate, Place
from .discrepancy.collection import Candidates
from .discrepancy.diagnosis import Diagnosis
from .discrepancy.extension import Extension, Gain
from .discrepancy.finding import Finding, Scored
from .discrepancy.misfit import Misfit
from .discrepancy.points import Points
from .equation_error import EquationError
from .integration import IntegrationError
from .match import Match
from .mode_table import Mode, Modes
from .multistart import Multistart
from .optima import Optimum
from .outcome import Outcome
from .parameters import Estimate
from .planning.plan import Excursion, Plan, Plans
from .reconstruction.reconstruct import Reconstruction
from .records import Record
from .refinement import Refinement
from .response import FrequencyResponse
from .solvers import Iteration
from .trim import Trim
from .uncertainty.bands import Bands
from .uncertainty.bootstrap import Bootstrap
from .uncertainty.coloured import Coloured
from .uncertainty.correlation import Correlation, WeakDirection
from .uncertainty.profile import Profile, Profiles
from .validation import Validation

__all__ = [
    "Bands",
    "Bootstrap",
    "Candidate",
    "Candidates",
    "Coloured",
    "Correlation",
    "Diagnosis",
    "EquationError",
    "Estimate",
    "Excursion",
    "Extension",
    "Finding",
    "FrequencyResponse",
    "Gain",
    "IntegrationError",
    "Iteration",
    "Match",
    "Misfit",
    "Mode",
    "Modes",
    "Multistart",
    "Optimum",
    "Outcome",
    "Place",
    "Plan",
    "Plans",
    "Points",
    "Profile",
    "Profiles",
    "Reconstruction",
    "Record",
    "Refinement",
    "Scored",
    "Trim",
    "Validation",
    "WeakDirection",
]
