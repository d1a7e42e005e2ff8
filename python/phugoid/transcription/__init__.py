"""Transcriptions of an estimation problem: collocation, shooting, the filter-error method."""
