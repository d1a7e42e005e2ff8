"""Equation error: regression on measured states."""
