"""Estimations: output-error and filter-error method, their starts, and starts run on any executor."""
