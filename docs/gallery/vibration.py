"""
A vibration test
================

Three modes, two of them close together, are excited by a random force and measured by one accelerometer. The
subspace method finds them without start values; maximum likelihood refines them and gives standard errors.
"""

import numpy as np

import phugoid as ph

true = ph.models.modal(3, "force", "acc", frequencies_hz=[2.0, 2.2, 5.0])
values = {
    "sigma_1": -0.2, "omega_1": 12.6, "b_1": 1.0, "c_1a": 1.0, "c_1b": 0.5,
    "sigma_2": -0.25, "omega_2": 13.8, "b_2": 1.0, "c_2a": -0.6, "c_2b": 0.4,
    "sigma_3": -0.6, "omega_3": 31.4, "b_3": 1.0, "c_3a": -0.8, "c_3b": 0.3,
}  # fmt: skip
t = np.arange(3000) / 50
random = np.random.default_rng(1)
shaker = ph.Experiment(t, {"force": random.standard_normal(t.size)}, name="shaker")
path = ph.simulate(true, values, shaker, initial=dict.fromkeys(true.state_names, 0.0))
run = shaker.with_outputs({"acc": path.outputs["acc"] + 0.03 * random.standard_normal(t.size)})

system = ph.linear.subspace(run, order=6, feedthrough=False)
fit = ph.estimate(ph.models.modal(start=system), run)
print(ph.linear.modes(fit))

# %%
# The frequency response estimated from the record itself, and that of the fit:

measured = ph.linear.frequency_response(run, "force", "acc", method="h1", segment=1000)
model = ph.linear.frequency_response(fit, np.linspace(0.5, 10, 600), "force", "acc")
figure, axes = measured.plot(model, band=(0.5, 10))
