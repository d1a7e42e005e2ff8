"""Estimates from many starts, their optima, and the journal that they can go on from."""
