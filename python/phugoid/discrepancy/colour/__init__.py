"""Coloured residuals: their spectrum, and how they are made white."""
