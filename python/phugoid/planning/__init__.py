"""Evaluation of planned manoeuvres: standard errors to expect, weak directions, and excursions."""
