"""Estimation while the data arrive."""
