"""Cases that hide an effect: what a diagnosis is to find, made independently of how it looks for it."""

from .case import STRENGTHS, Case, Unreachable, draw, make, nothing
from .systems import SYSTEMS

__all__ = ["STRENGTHS", "SYSTEMS", "Case", "Unreachable", "draw", "make", "nothing"]
