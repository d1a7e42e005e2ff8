"""Models: declarations, equations, delays."""
