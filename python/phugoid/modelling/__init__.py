"""Models: declarations, equations, noise, delays."""
