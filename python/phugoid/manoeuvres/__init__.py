"""Inputs for manoeuvres: steps, multisines and sweeps, as arrays over a time grid."""
