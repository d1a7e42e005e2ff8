"""Solvers of the nonlinear program: Newton's method of the crate, and Ipopt."""

from .ipopt import Ipopt
from .newton import Newton
from .solution import HINTS, Iteration, Solution

__all__ = ["HINTS", "Ipopt", "Iteration", "Newton", "Solution"]
