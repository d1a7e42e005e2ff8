"""Linear systems and their modes: identified, fitted, linearised about a point, and compared in frequency."""

from .frequency import frequency_response
from .linear_fit import fit_linear
from .linearise import linearise, modes
from .state_space import StateSpace
from .subspace import subspace
from .trim import trim

__all__ = ["StateSpace", "fit_linear", "frequency_response", "linearise", "modes", "subspace", "trim"]
