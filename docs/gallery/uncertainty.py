"""
How sure?
=========

Residuals of flight records are coloured: each is partly the one before it. Standard errors that take
them for white are then too small. Here the noise is coloured on purpose, so that the truth is known.
"""

import numpy as np

import phugoid as ph

m = ph.Model("pitch")
q, theta = m.states(q="rad/s", theta="rad")
(de,) = m.inputs(de="rad")
Mq, Mde = m.parameters(Mq=-1.0, Mde=-5.0)
m.dynamics(q=Mq * q + Mde * de, theta=q)
m.outputs(q=q, theta=theta)

random = np.random.default_rng(0)
t = np.arange(0, 20, 0.05)
blank = ph.Experiment(t, {"de": 0.1 * np.sign(np.sin(1.5 * t))}, name="run")
path = ph.simulate(m, {"Mq": -2.0, "Mde": -6.0}, blank)


def coloured(sigma: float) -> np.ndarray:
    """Noise of which each sample has 0.9 of the one before."""
    noise = sigma * random.standard_normal(t.size)
    for k in range(1, t.size):
        noise[k] = 0.9 * noise[k - 1] + np.sqrt(1 - 0.9**2) * noise[k]
    return noise


run = blank.with_outputs({n: y + coloured(0.01) for n, y in path.outputs.items()})
fit = ph.estimate(m, run)
print(fit.robust().summary())

# %%
# Many records of the same kind would scatter like this: each drawn with noise as coloured as the
# residuals, and estimated.

bootstrap = fit.bootstrap(60, "coloured", seed=1)
print(bootstrap.summary())

# %%
# Residuals over time, autocorrelation and spectrum show the colour:

figure, axes = fit.plot_residuals()

# %%
# The likelihood along each parameter, with all others estimated anew, its drop made larger by the
# colour, and the interval of 95 %:

figure, axes = fit.profile(coloured=True).plot()
