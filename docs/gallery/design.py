"""
Which manoeuvre?
================

Four inputs for the short period of an aircraft are compared before the flight: which standard errors of the
derivatives are to be expected, and does each input stay within the limits?
"""

import numpy as np

import phugoid as ph
from phugoid import design

m = ph.Model("short period")
alpha, q = m.states(alpha="rad", q="rad/s")
(de,) = m.inputs(de="rad")
Za, Ma, Mq, Mde = m.parameters(Za=-0.9, Ma=-4.0, Mq=-1.4, Mde=-6.0)
m.dynamics(alpha=Za * alpha + q, q=Ma * alpha + Mq * q + Mde * de)
m.outputs(alpha=alpha, q=q)

# %%
# The width of a step comes from the mode that it is to excite:

mode = ph.linear.modes(m, {"Za": -0.9, "Ma": -4.0, "Mq": -1.4, "Mde": -6.0})[0]
t = np.arange(0, 15, 0.02)
doublet = design.doublet(t, 0.05, width=design.step_width(mode, "doublet"), start=1)
width = design.step_width(mode, "3-2-1-1")
shapes = {
    "doublet": doublet,
    "3-2-1-1": design.three_two_one_one(t, 0.04, width=width, start=1, rise=0.1),
    "multisine": design.multisine(t, 0.05, band=(0.1, 1.5), start=1),
    "sweep": design.sweep(t, 0.045, band=(0.1, 1.5), start=1, fade=1),
}
manoeuvres = {name: ph.Experiment(t, {"de": u}, name=name) for name, u in shapes.items()}
limits = {"alpha": 0.06, "q": 0.2, "de": 0.05}
plans = design.plans(m, manoeuvres, noise={"alpha": 0.01, "q": 0.01}, limits=limits)
print(plans.summary())
figure, axes = plans.plot()
