"""The output-error estimate."""
