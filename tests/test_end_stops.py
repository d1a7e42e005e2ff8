"""Positions that may meet an end stop: where a candidate for one is offered, and where none is."""

from __future__ import annotations

import pytest
from hidden import SYSTEMS

import phugoid as ph


@pytest.mark.parametrize(
    ("system", "limits"),
    [("duffing", ["x:limit"]), ("servo", ["angle:limit"]), ("hfb320", []), ("lateral", []), ("uav", [])],
)
def test_positions_have_stops_and_attitudes_have_none(system: str, limits: list[str]) -> None:
    names = ph.candidates(SYSTEMS[system].model()).names
    assert [n for n in names if n.endswith(":limit")] == limits


def test_a_stop_acts_where_the_force_stands() -> None:
    """An accelerometer on what meets the stop feels it."""
    model = SYSTEMS["duffing"].model()
    extended = ph.candidates(model)["x:limit"].extended(model)
    assert "limit_of_x" in extended.quantity_expressions()["f"].symbols


def test_a_pendulum_has_no_stop() -> None:
    m = ph.Model("pendulum")
    phi, w = m.states(phi="rad", w="rad/s")
    k, c = m.parameters("k c")
    m.dynamics(phi=w, w=-k * ph.sin(phi) - c * w)
    m.outputs(phi=phi)
    assert not [n for n in ph.candidates(m).names if n.endswith(":limit")]
