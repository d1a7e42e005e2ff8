"""How far estimates may be trusted: standard errors for coloured noise, correlations, profiles, bootstrap, bands."""
