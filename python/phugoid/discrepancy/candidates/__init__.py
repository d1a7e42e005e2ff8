"""Candidates for what a model may be missing."""
