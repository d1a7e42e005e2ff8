"""
What a model misses
===================

The true vehicle has quadratic damping; its model is linear. The fit converges with small standard errors,
although the model is wrong. Residuals that are not white show this.
"""

import numpy as np

import phugoid as ph

m = ph.Model("pitch")
q, theta = m.states(q="rad/s", theta="rad")
(de,) = m.inputs(de="rad")
Mq, Mde = m.parameters(Mq=-1.0, Mde=-5.0)
m.dynamics(q=Mq * q + Mde * de, theta=q)
m.outputs(q=q, theta=theta)

true = ph.candidates(m)["q':q|q|"].extended(m)
(hidden,) = set(true.parameter_names) - set(m.parameter_names)
t = np.arange(0, 12, 0.05)
random = np.random.default_rng(0)


def record(name: str, size: float) -> ph.Experiment:
    """Return a record of the true vehicle, with noise."""
    run = ph.Experiment(t, {"de": size * np.sign(np.sin(1.5 * t)) * np.sin(0.4 * t)}, name=name)
    path = ph.simulate(true, {"Mq": -2.0, "Mde": -6.0, hidden: -2.0}, run)
    noisy = {n: y + 0.004 * random.standard_normal(t.size) for n, y in path.outputs.items()}
    return run.with_outputs(noisy)


first, second = record("first", 0.3), record("second", 0.24)
fit = ph.estimate(m, first)
fit.parameters  # in truth Mq is -2

# %%
# Residuals over time, their spectrum, and what they follow:

figure, axes = ph.misfit(fit).plot()

# %%
# Every candidate is scored from one linearisation of the fit; the best are fitted in full, and
# must predict the second record:

diagnosis = ph.diagnose(fit, validation=second)
diagnosis

# %%
# Which candidates explain the misfit, to first order:

figure, axes = diagnosis.plot_ranking()

# %%
# Which part of the misfit of held-out data the named one explains:

figure, axes = diagnosis.plot()

# %%

extended = diagnosis.extend()
extended.model

# %%

extended.fit.parameters
