"""Noise of the measurements: Gaussian and other densities, of each output and experiment."""
