"""
What a model misses
===================

The flown vehicle has quadratic damping; its model is linear. The fit converges, with small
standard errors, and is wrong. Its residuals are not white, which shows it.
"""

import numpy as np

import phugoid as ph

m = ph.Model("pitch")
q, theta = m.states(q="rad/s", theta="rad")
(de,) = m.inputs(de="rad")
Mq, Mde = m.parameters(Mq=-1.0, Mde=-5.0)
m.dynamics(q=Mq * q + Mde * de, theta=q)
m.outputs(q=q, theta=theta)

flown = ph.candidates(m)["q':q|q|"].extended(m)
(hidden,) = set(flown.parameter_names) - set(m.parameter_names)
t = np.arange(0, 12, 0.05)
random = np.random.default_rng(0)


def fly(name: str, size: float) -> ph.Experiment:
    """A record of the flown vehicle, with noise."""
    run = ph.Experiment(t, {"de": size * np.sign(np.sin(1.5 * t)) * np.sin(0.4 * t)}, name=name)
    path = ph.simulate(flown, {"Mq": -2.0, "Mde": -6.0, hidden: -2.0}, run)
    noisy = {n: y + 0.004 * random.standard_normal(t.size) for n, y in path.outputs.items()}
    return run.with_outputs(noisy)


first, second = fly("first", 0.3), fly("second", 0.24)
fit = ph.estimate(m, first)
fit.parameters  # in truth Mq is -2

# %%
# Residuals over time, their spectrum, and what they follow:

figure, axes = ph.misfit(fit).plot()

# %%
# Every candidate is scored from one linearisation of the fit; the best are fitted in full, and
# must predict the second record:

diagnosis = ph.diagnose(fit, validation=second)
print(diagnosis.summary())
figures = diagnosis.figures()

# %%

extended = diagnosis.extend()
extended.model

# %%

extended.fit.parameters
