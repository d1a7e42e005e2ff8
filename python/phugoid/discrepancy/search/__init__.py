"""The search for what is missing: linearise, scan, refit, hold out."""
