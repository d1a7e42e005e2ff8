"""Inputs for manoeuvres that tell parameters: steps, multisines and sweeps, as arrays over a time grid."""
