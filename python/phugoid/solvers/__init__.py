"""Solvers of the nonlinear program: ours, and Ipopt."""

from .ipopt import Ipopt
from .newton import Newton
from .solution import HINTS, Iteration, Solution

__all__ = ["HINTS", "Ipopt", "Iteration", "Newton", "Solution"]
