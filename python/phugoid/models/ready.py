"""Ready models of the packaged examples: the text that `phugoid example` writes, run and returned as a `Model`."""

from __future__ import annotations

import linecache
from importlib.resources import files
from typing import Any

from ..errors import OptionError, listing
from ..modelling.model import Model

__all__ = ["READY", "car", "hfb320", "model_text", "quadrotor", "servo", "tank", "uav", "unstable"]

READY = ("hfb320", "unstable", "quadrotor", "car", "uav", "servo", "tank")
"""Names of the packaged models."""


def model_text(name: str) -> str:
    """Return the Python code of a packaged model, which defines ``m``; raise OptionError for an unknown name."""
    if name not in READY:
        raise OptionError(f"there is no example '{name}'.{listing(name, READY)}")
    return files("phugoid").joinpath("cli", "examples", f"{name}.txt").read_text(encoding="utf-8")


def _made(name: str) -> Model:
    text = model_text(name)
    place = f"<phugoid example {name}>"
    # The line of an equation is found in messages though there is no such file.
    linecache.cache[place] = (len(text), None, text.splitlines(keepends=True), place)
    names: dict[str, Any] = {"__name__": f"phugoid_example_{name}"}
    exec(compile(text, place, "exec"), names)
    model: Model = names["m"]
    return model


def hfb320() -> Model:
    """Return the longitudinal motion of the HFB-320: states V, alpha, theta, q; inputs de (rad), T (N); 7 outputs.

    15 parameters: derivatives of lift, drag and pitching moment, and biases of sensors. (D. A. A. Dutra, AIAA Aviation
    2019.) Each call gives a new model; ``phugoid example hfb320`` writes its code.

    >>> hfb320().state_names
    ('V', 'alpha', 'theta', 'q')
    """
    return _made("hfb320")


def unstable() -> Model:
    """Return the short period of an aircraft that is unstable: states w, q; input de (rad); outputs w, q, az.

    6 parameters: the derivatives. (R. V. Jategaonkar, Flight Vehicle System Identification, ch. 9.)
    """
    return _made("unstable")


def quadrotor() -> Model:
    """Return the pitch axis of a quadrotor near hover: states u, theta, q, n (rotors); input command; outputs u, theta,
    q, ax.

    8 parameters, among them the time constant of the rotors, the delay of the command, and the drag of the rotors,
    which the accelerometer measures.
    """
    return _made("quadrotor")


def car() -> Model:
    """Return the single-track model of a car with tyres that saturate: states v, r; input delta (rad), condition V
    (m/s); outputs r, ay, beta.

    4 parameters: stiffness and greatest force of the tyres of each axle, by the magic formula (H. B. Pacejka, Tire and
    Vehicle Dynamics). The slip angles af, ar and the forces Ff, Fr are quantities.
    """
    return _made("car")


def uav() -> Model:
    """Return the longitudinal motion of a small fixed-wing aircraft: states V, alpha, theta, q; inputs de (rad), T (N);
    outputs V, alpha, theta, q, ax, az.

    10 parameters: the derivatives of lift, drag and pitching moment, and the bias of the gyro. Mass, inertia and areas
    are those of the example: write it with ``phugoid example uav`` and change them.
    """
    return _made("uav")


def servo() -> Model:
    """Return a servo with dry friction: states angle, rate; input volts; output angle.

    3 parameters: gain, time constant, dry friction over inertia.
    """
    return _made("servo")


def tank() -> Model:
    """Return two tanks, one above the other: states upper, lower (cm); input pump (V); output lower.

    3 parameters, of the pump and of the outflows, by Torricelli's law. (M. Schoukens and J. P. Noël, Three Benchmarks
    Addressing Open Challenges in Nonlinear System Identification, IFAC 2017.)
    """
    return _made("tank")
