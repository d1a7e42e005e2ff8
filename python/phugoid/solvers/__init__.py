"""Solvers of the nonlinear program: what they take and what they give back."""

from .ipopt import Ipopt
from .solution import HINTS, Iteration, Solution

__all__ = ["HINTS", "Ipopt", "Iteration", "Solution"]
