"""Tasks on any executor: starts of an estimation, their outcomes, and what becomes of lost workers."""
