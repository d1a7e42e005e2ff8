"""Validation of a fit on data that it was not made on."""
