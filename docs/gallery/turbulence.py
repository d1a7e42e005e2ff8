"""
Turbulence
==========

In gusts the equations of motion are disturbed, not only the sensors. Output error has no place for
that but the measurement noise; the filter-error method integrates the gusts out, and estimates how
strong they are.
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
# The sensors are so good that it matters what the noise does *between* two samples, where it goes
# from ``q`` into ``theta``. That is part of the likelihood: noise that comes at the samples alone
# would have the damping come out a tenth too small here.

plain = ph.estimate(m, run)
gusts = ph.estimate(m, run, transcription=ph.FilterError(states=("q",)))
for name, true in {"Mq": -2.0, "Mt": -4.0, "Mde": -6.0}.items():
    print(f"{plain.parameters[name]!s:24} filter error: {gusts.parameters[name]!s:24} true: {true}")
print(gusts.parameters["q_q"], "  true: 0.05")

# %%
# Output error is many of its standard errors from the truth; the filter-error method says how
# uncertain it is. Residuals are those of the smoothed states, hence small:

figure, axes = gusts.plot()
