"""Products that change with a variable: what a diagnosis names where a rate depends on the temperature, say."""

from __future__ import annotations

import numpy as np
import pytest
from rigs import integrated, levels, named

import phugoid as ph

_Array = np.ndarray
_TIMES = np.arange(0.0, 100.0, 0.25)


def _levels(rng: np.random.Generator, low: float, high: float) -> _Array:
    """Return levels (N,) that change every few seconds."""
    return levels(rng, _TIMES, low, high, (4.0, 12.0), 30)


def _reactor(seed: int, name: str) -> ph.Experiment:
    """A stirred tank whose rate of reaction doubles with every 11 K."""
    rng = np.random.default_rng(seed)
    jacket = _levels(rng, 45.0, 65.0)

    def f(x: _Array, u: _Array) -> _Array:
        rate = 0.12 * np.exp(0.063 * (x[1] - 60.0)) * x[0]
        return np.array([0.1 * (2.0 - x[0]) - rate, 0.1 * (40.0 - x[1]) + 0.25 * (u[0] - x[1]) + 18.0 * rate])

    x = integrated(f, np.array([1.0, 55.0]), _TIMES, jacket[:, None])
    outputs = {
        "c": x[:, 0] + 0.01 * rng.standard_normal(_TIMES.size),
        "T": x[:, 1] + 0.15 * rng.standard_normal(_TIMES.size),
    }
    return ph.Experiment(_TIMES, {"Tj": jacket}, outputs, interpolation="hold", name=name)


def test_a_rate_of_reaction_changes_with_the_temperature() -> None:
    m = ph.Model("reactor")
    c, temperature = m.states(c="mol/L", T="°C")
    (jacket,) = m.inputs(Tj="°C")
    k, u, h = m.parameters(k=0.1, U=0.2, H=10.0)
    (rate,) = m.quantities(rate=k * c)
    m.dynamics(c=0.1 * (2.0 - c) - rate, T=0.1 * (40.0 - temperature) + u * (jacket - temperature) + h * rate)
    m.outputs(c=c, T=temperature)
    (found,) = named(ph.diagnose(ph.estimate(m, _reactor(1, "a")), validation=_reactor(2, "b")))
    assert found.cause == "rate:scale*T"
    assert "exponentially" in found.explanation
    assert found.coefficient == pytest.approx(0.063, abs=4.0 * found.std_error)
    assert found.explained > 0.95


def _carriage(seed: int, name: str) -> ph.Experiment:
    """A vehicle with a fin, whose moment goes with the square of the airspeed."""
    rng = np.random.default_rng(seed)
    fin, speed = _levels(rng, -0.2, 0.2), 20.0 + 6.0 * np.sin(0.13 * _TIMES + seed)
    u = np.stack([fin, speed], axis=1)
    x = integrated(lambda x, u: np.array([-0.4 * x[0] + 0.005 * u[1] ** 2 * u[0]]), np.zeros(1), _TIMES, u)
    outputs = {"r": x[:, 0] + 0.01 * rng.standard_normal(_TIMES.size)}
    return ph.Experiment(_TIMES, {"fin": fin, "V": speed}, outputs, interpolation="hold", name=name)


def test_a_parameter_changes_with_a_condition_where_an_exponent_is_wrong() -> None:
    m = ph.Model("carriage")
    (r,) = m.states(r="rad/s")
    (fin,) = m.inputs(fin="rad")
    (speed,) = m.conditions(V="m/s")
    a, b = m.parameters(a=1.0, b=0.01)
    m.dynamics(r=-a * r + b * speed * fin)
    m.outputs(r=r)
    (found,) = named(ph.diagnose(ph.estimate(m, _carriage(1, "a")), validation=_carriage(2, "b")))
    assert found.cause == "b:V"
    # b V = 0.005 V^2: the derivative of b is that number.
    assert found.coefficient == pytest.approx(0.005, abs=4.0 * found.std_error)
    assert found.explained > 0.95
    assert "b changes with V" in found.explanation


def _digester(seed: int, name: str) -> ph.Experiment:
    """A reactor that is fed with a substrate, which is taken up by Michaelis and Menten's law."""
    feed = _levels(np.random.default_rng(seed), 0.0, 6.0)
    x = integrated(lambda x, u: np.array([0.3 * u[0] - 1.6 * x[0] / (2.5 + x[0])]), np.ones(1), _TIMES, feed[:, None])
    outputs = {"S": x[:, 0] + 0.05 * np.random.default_rng(seed + 9).standard_normal(_TIMES.size)}
    return ph.Experiment(_TIMES, {"feed": feed}, outputs, interpolation="hold", name=name)


def test_an_uptake_saturates_with_the_substrate() -> None:
    m = ph.Model("digester")
    (s,) = m.states(S="g/L")
    (feed,) = m.inputs(feed="g/L/h")
    k, q = m.parameters(k=0.5, q=0.2)
    m.dynamics(S=k * feed - q * s)
    m.outputs(S=s)
    (found,) = named(ph.diagnose(ph.estimate(m, _digester(1, "a")), validation=_digester(2, "b")))
    assert found.cause == "q:saturating_S"
    half, error = found.parameters["K_q_S"]
    assert half == pytest.approx(2.5, abs=4.0 * error)
    assert error < 0.5
    assert found.explained > 0.95


def test_nothing_saturates_that_does_not_vanish_with_the_store() -> None:
    m = ph.Model("oven")
    (t,) = m.states(T="°C")
    (u,) = m.inputs(u="kW")
    k, b = m.parameters(k=0.1, b=1.0)
    m.dynamics(T=b * u - k * (t - 20.0))
    m.outputs(T=t)
    assert not [n for n in ph.candidates(m).names if ":saturating_" in n]


def _ferment(seed: int, name: str) -> ph.Experiment:
    """Growth that its product inhibits, along a straight line down to nothing at 60 g/L."""
    rng = np.random.default_rng(seed)
    washed = _levels(rng, 0.02, 0.25)

    def f(x: _Array, u: _Array) -> _Array:
        growth = 0.4 * x[0] * (1.0 - x[1] / 60.0)
        return np.array([growth - u[0] * x[0], 4.0 * growth - u[0] * x[1]])

    x = integrated(f, np.array([5.0, 20.0]), _TIMES, washed[:, None])
    outputs = {"X": x[:, 0] + 0.05 * rng.standard_normal(_TIMES.size)}
    outputs["P"] = x[:, 1] + 0.2 * rng.standard_normal(_TIMES.size)
    return ph.Experiment(_TIMES, {"D": washed}, outputs, interpolation="hold", name=name)


def test_growth_is_inhibited_along_a_straight_line() -> None:
    m = ph.Model("ferment")
    cells, product = m.states(X="g/L", P="g/L")
    (washed,) = m.inputs(D="1/h")
    k, y = m.parameters(k=0.2, Y=4.0)
    (growth,) = m.quantities(growth=k * cells)
    m.dynamics(X=growth - washed * cells, P=y * growth - washed * product)
    m.outputs(X=cells, P=product)
    (found,) = named(ph.diagnose(ph.estimate(m, _ferment(1, "a")), validation=_ferment(2, "b")))
    assert found.cause == "growth:scale*P"
    assert "along a straight line" in found.explanation
    assert found.explained > 0.95
