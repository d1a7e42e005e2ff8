"""
Turbulence
==========

Gusts disturb the equations of motion, not only the sensors. The output-error method attributes all of it to
measurement noise; the filter-error method has process noise, over which it integrates, and estimates its
intensity.
"""

import numpy as np

import phugoid as ph

m = ph.Model("pitch in gusts")
q, theta = m.states(q="rad/s", theta="rad")
(de,) = m.inputs(de="rad")
Mq, Mde, Mt = m.parameters("Mq Mde Mt")
m.dynamics(q=Mq * q + Mt * theta + Mde * de, theta=q)
m.outputs(q=q, theta=theta)

# %%
# A record, with white noise on the pitch acceleration, 0.05 rad/s²/√Hz, and little noise on the
# sensors. It is simulated in ten steps between two samples:

h, n, steps = 0.02, 1000, 10
random = np.random.default_rng(2)
t = h * np.arange(n)
de_t = 0.05 * np.sign(np.sin(1.1 * t))
x = np.zeros((n, 2))
A = np.array([[-2.0, -4.0], [1.0, 0.0]])
for k in range(n - 1):
    x[k + 1] = x[k]
    for i in range(steps):
        elevator = de_t[k] + (de_t[k + 1] - de_t[k]) * i / steps
        gust = 0.05 * np.sqrt(h / steps) * random.standard_normal()
        drift = A @ x[k + 1] + np.array([-6.0 * elevator, 0.0])
        x[k + 1] += h / steps * drift + np.array([gust, 0.0])
measured = x + 0.002 * random.standard_normal((n, 2))
run = ph.Experiment(t, {"de": de_t}, {"q": measured[:, 0], "theta": measured[:, 1]}, name="gusts")

# %%
# The sensors are so precise that the likelihood must include what the noise does *between* two samples, where
# it passes from ``q`` to ``theta``. With noise that acts at the samples only, the damping would be wrong by about
# 10 %.

plain = ph.estimate(m, run)
gusts = ph.estimate(m, run, transcription=ph.FilterError(states=("q",)))
for name, true in {"Mq": -2.0, "Mt": -4.0, "Mde": -6.0}.items():
    print(f"{plain.parameters[name]!s:24} filter error: {gusts.parameters[name]!s:24} true: {true}")
print(gusts.parameters["q_q"], "  true: 0.05")

# %%
# The estimates of the output-error method are many of their standard errors away from the truth; those of the
# filter-error method agree with it within theirs, which are larger. The residuals below are small, since they are
# those of the smoothed states:

figure, axes = gusts.plot()
