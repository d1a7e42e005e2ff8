"""Ready models: linear systems (the modal form, for structural dynamics, and general state spaces), and the kinematics
of a flight (`flight_path`), which needs nothing of what follows; and the models of the packaged examples, such as
`quadrotor` and `car`, complete with parameters.

A record of inputs and outputs determines the transfer function of a linear system; states may be transformed at will
(x -> T x), so of the n^2 + n (m + p) numbers in A, B and C (n states, m inputs, p outputs) n^2 are arbitrary. Each form
here fixes as many of them, or says that it does not. Start values come from numbers, say of `phugoid.linear.subspace`:

    fit = ph.estimate(ph.models.modal(start=ph.linear.subspace(run, order=8)), run)

A parameter that is fixed by a form has ``fixed`` set in the fit; all others are estimated.
"""

from .flight_path import flight_path
from .general import car, hfb320, quadrotor, servo, state_space, tank, uav, unstable
from .modal import modal

__all__ = [
    "car",
    "flight_path",
    "hfb320",
    "modal",
    "quadrotor",
    "servo",
    "state_space",
    "tank",
    "uav",
    "unstable",
]
