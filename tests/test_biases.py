"""Which parameters are biases of sensors."""

from __future__ import annotations

import hfb320

import phugoid as ph
from phugoid import Parameter
from phugoid.frozen_model import biases, freed_by_default


def test_biases_of_the_hfb320_are_those_of_its_sensors() -> None:
    assert biases(hfb320.model()) == freed_by_default(hfb320.model()) == ("b_q", "b_aq", "b_ax", "b_az")


def test_biases_are_found_from_the_equations() -> None:
    m = ph.Model("biases")
    x, y = m.states("x y")
    (u,) = m.inputs("u")
    names = "plain scaled inside K drift product p q both start known tau square"
    s = dict(zip(names.split(), m.parameters(names), strict=True))
    (total,) = m.quantities(total=x + s["both"])
    m.dynamics(x=u - x, y=-total)
    m.outputs(
        a=x + s["plain"] + 3.0,
        b=s["K"] * (y + s["inside"]) - 2.0 * s["scaled"],
        c=x + s["drift"] * m.time + s["product"] * u,
        d=y + s["p"] * s["q"],
        e=total,
        f=x + s["start"] + s["square"] ** 2,
        g=m.delay(u, s["tau"]) + s["tau"],
    )
    m.initial(x=s["start"])
    assert biases(m) == ("plain", "scaled", "inside")


def test_initial_values_of_each_experiment_are_free() -> None:
    m = ph.Model("start")
    (x,) = m.states("x")
    x0, shared, a = m.parameters(x0=Parameter(per_experiment=True), shared=0.0, a=0.5)
    m.dynamics(x=-a * x + shared)
    m.outputs(x=x)
    m.initial(x=x0)
    assert biases(m) == () and freed_by_default(m) == ("x0",)


def test_a_bias_declared_fixed_stays() -> None:
    m = ph.Model("fixed")
    (x,) = m.states("x")
    a, b = m.parameters(a=0.5, b=Parameter(0.2, fixed=True))
    m.dynamics(x=-a * x)
    m.outputs(x=x + b)
    assert biases(m) == ("b",) and freed_by_default(m) == ()
