"""
An unstable aircraft
====================

Single shooting simulates the whole record, and the simulation of an unstable aircraft soon departs from the
data. With collocation the states at all points are unknowns that start at their measured values: nothing is
simulated, and nothing diverges.
"""

import numpy as np

import phugoid as ph

m = ph.Model("unstable aircraft, short period")
w, q = m.states(w="m/s", q="rad/s")
(de,) = m.inputs(de="rad")
Zw, Zq, Zde, Mw, Mq, Mde = m.parameters("Zw Zq Zde Mw Mq Mde")
U0 = 44.5695  # m/s
m.dynamics(w=Zw * w + (U0 + Zq) * q + Zde * de, q=Mw * w + Mq * q + Mde * de)
m.outputs(w=w, q=q, az=(Zw * w + Zq * q + Zde * de, "m/s²"))

# %%
# Six seconds with a small doublet, during which the motion diverges, and with noise on the sensors:

truth = {"Zw": -1.4249, "Zq": -1.4768, "Zde": -6.2632, "Mw": 0.2163, "Mq": -3.7067, "Mde": -12.784}
t = np.arange(0, 6, 0.02)
de_t = 0.01 * (((t > 0.3) & (t < 0.8)) * 1.0 - ((t > 0.8) & (t < 1.4)))
blank = ph.Experiment(t, {"de": de_t}, name="run")
path = ph.simulate(m, truth, blank, initial={"w": 0, "q": 0})
random = np.random.default_rng(0)
sigma = {"w": 0.05, "q": 0.002, "az": 0.05}
noisy = {n: y + sigma[n] * random.standard_normal(t.size) for n, y in path.outputs.items()}
run = blank.with_outputs(noisy)

fit = ph.estimate(m, run)
print(fit.parameters)
print(ph.linear.modes(fit))
figure, axes = fit.plot()
