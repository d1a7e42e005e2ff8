"""Manoeuvres planned: their inputs, the standard errors to expect, and the best of a family."""
