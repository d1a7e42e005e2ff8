"""Problems in the PEtab format: an SBML model, conditions, measurements and parameters in tables."""

from .problem import PetabProblem, read_petab

__all__ = ["PetabProblem", "read_petab"]
