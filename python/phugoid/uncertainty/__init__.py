"""Uncertainty of estimates: standard errors for coloured noise, correlations, profiles, bootstrap, bands."""
