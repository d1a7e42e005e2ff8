"""HFB-320 as a model and an experiment of ours, from the same equations and arrays as the peers'."""

import hfb320_case as hfb

import phugoid as ph


def model():
    """The model with its 15 parameters, all starting at 0; the sigmas belong to the noise."""
    m = ph.Model("HFB-320 longitudinal")
    x, u = m.states(*hfb.STATES), m.inputs(*hfb.INPUTS)
    names = hfb.DERIVATIVES + hfb.BIASES
    p = dict(zip(names, m.parameters(*names), strict=True))
    m.dynamics(**dict(zip(hfb.STATES, hfb.dynamics(x, u, p, ph), strict=True)))
    m.outputs(**dict(zip(hfb.OUTPUTS, hfb.outputs(x, u, p, ph), strict=True)))
    return m


def experiment(t, u, z):
    """The record: `t` (N,) in s, inputs `u` (N, 2), measurements `z` (N, 7)."""
    inputs = dict(zip(hfb.INPUTS, u.T, strict=True))
    return ph.Experiment(t, inputs, dict(zip(hfb.OUTPUTS, z.T, strict=True)), name="HFB-320")
