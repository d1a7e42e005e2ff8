"""
How accurate the estimates are
==============================

Residuals of flight records are coloured: each is correlated with those before it. Standard errors for
white residuals are then too small. Here the noise is simulated with a known autocorrelation, so that the
true scatter is known.
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
    """Return noise with a lag-1 autocorrelation of 0.9."""
    noise = sigma * random.standard_normal(t.size)
    for k in range(1, t.size):
        noise[k] = 0.9 * noise[k - 1] + np.sqrt(1 - 0.9**2) * noise[k]
    return noise


run = blank.with_outputs({n: y + coloured(0.01) for n, y in path.outputs.items()})
fit = ph.estimate(m, run)
print(fit.robust().summary())

# %%
# A parametric bootstrap: records are simulated with noise that has the autocorrelation of the residuals,
# and the parameters are estimated from each. Their scatter agrees with the corrected standard errors.

bootstrap = fit.bootstrap(60, "coloured", seed=1)
print(bootstrap.summary())

# %%
# Residuals over time, with their autocorrelation and power spectrum:

figure, axes = fit.plot_residuals()

# %%
# The profile likelihood of each parameter, with all others re-estimated, and its interval of 95 %,
# corrected for residual autocorrelation:

figure, axes = fit.profile(coloured=True).plot()
