"""Sensitivities of the outputs of a fit: to its parameters and first states, and to terms that it does not have."""
