"""Estimation from many records on many machines."""
