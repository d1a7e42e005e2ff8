"""A validation record that does not excite what is missing."""

from __future__ import annotations

import numpy as np
from rigs import integrated, levels, named

import phugoid as ph

_TIMES = np.arange(0.0, 40.0, 0.05)


def _boat(seed: int, size: float, name: str) -> ph.Experiment:
    """A boat whose drag has a part that goes with the cube of the speed."""
    rng = np.random.default_rng(seed)
    thrust = size * levels(rng, _TIMES, -1.0, 1.0, (1.0, 4.0), 40)
    x = integrated(lambda x, u: np.array([u[0] - 0.5 * x[0] - 0.1 * x[0] ** 3]), np.zeros(1), _TIMES, thrust[:, None])
    outputs = {"v": x[:, 0] + 0.01 * rng.standard_normal(_TIMES.size)}
    return ph.Experiment(_TIMES, {"T": thrust}, outputs, interpolation="hold", name=name)


def _diagnosed(size: float) -> ph.Diagnosis:
    m = ph.Model("boat")
    (v,) = m.states(v="m/s")
    (thrust,) = m.inputs(T="m/s²")
    b, d = m.parameters(b=0.8, d=0.3)
    m.dynamics(v=b * thrust - d * v)
    m.outputs(v=v)
    return ph.diagnose(ph.estimate(m, _boat(1, 2.0, "fast")), validation=_boat(2, size, "other"))


def test_it_neither_confirms_a_cause_nor_speaks_against_it() -> None:
    d = _diagnosed(size=0.003)
    (found,) = named(d)
    assert found.cause == "v':v^3"
    assert any("hardly excite v':v^3" in note for note in d.notes)


def test_one_that_does_is_used() -> None:
    d = _diagnosed(size=1.5)
    (found,) = named(d)
    assert found.cause == "v':v^3"
    assert not any("hardly excite" in note for note in d.notes)
