"""Residual noise: autoregressive models of it, evenly sampled segments, whitening and spectra."""
