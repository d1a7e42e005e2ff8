"""Design of manoeuvres: inputs that excite the parameters, and the standard errors to expect from an experiment.

Inputs are steps, multisines and sweeps, as arrays over a time grid. Each is the distance of an input from its trim, in
the unit of ``amplitude``, at the times ``t`` (N,) in s; it is 0 before ``start``, and where the manoeuvre is over. Add
the trim, and make an experiment of it:

>>> import numpy as np
>>> from phugoid import Experiment, design
>>> t = np.arange(0.0, 10.0, 0.02)
>>> run = Experiment(t, {"de": -0.02 + design.three_two_one_one(t, 0.05, width=0.6, start=1.0)})

`plan` says which standard errors an experiment would give, `plans` compares several, `optimal_plan` seeks the best.
(V. Klein and E. A. Morelli, Aircraft System Identification, AIAA 2006, ch. 9; R. V. Jategaonkar, Flight Vehicle System
Identification, 2nd ed., AIAA 2015, ch. 2.)
"""

from .design_evaluation import optimal_plan, plan, plans
from .multisines import multisine, multisines, peak_factor, spectrum, step_width
from .steps import doublet, multistep, pulse, rate_limited, step, sweep, three_two_one_one

__all__ = [
    "doublet",
    "multisine",
    "multisines",
    "multistep",
    "optimal_plan",
    "peak_factor",
    "plan",
    "plans",
    "pulse",
    "rate_limited",
    "spectrum",
    "step",
    "step_width",
    "sweep",
    "three_two_one_one",
]
