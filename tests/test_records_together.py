"""Records of which one alone does not show what is missing are searched together."""

from __future__ import annotations

from typing import Any

import numpy as np
from rigs import named, steps

import phugoid as ph


def motor(limit: float = np.inf, own_offset: bool = False) -> ph.Model:
    m = ph.Model("motor")
    (volts,) = m.inputs(volts="V")
    rate, angle = m.states(rate="rad/s", angle="rad")
    a, b = m.parameters(a=2.0, b=5.0)
    applied: Any = volts if np.isinf(limit) else ph.maximum(-limit, ph.minimum(volts, limit))
    m.dynamics(rate=b * applied - a * rate, angle=rate)
    offset: Any = 0.0
    if own_offset:  # else the first angle would stand for it
        m.initial(angle=0.0)
        (offset,) = m.parameters(offset=0.0)
    m.outputs(rate=rate, angle=angle + offset)
    return m


def record(amplitude: float, seed: int, limit: float, name: str) -> ph.Experiment:
    """Return a record of steps that change in size."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, 20.0, 0.02)
    u = steps(rng, t, -amplitude, amplitude, 1.0)
    run = ph.simulate(
        motor(limit), {"a": 2.0, "b": 5.0}, ph.Experiment(t, {"volts": u}, {}), initial={"rate": 0.0, "angle": 0.0}
    )
    noise = {"rate": 0.05, "angle": 0.02}
    return ph.Experiment(
        t,
        {"volts": u},
        {n: y + noise[n] * rng.standard_normal(t.size) for n, y in run.outputs.items()},
        name=name,
    )


def diagnosed(limit: float) -> ph.Diagnosis:
    first, second = record(1.5, 1, limit, "gentle"), record(3.0, 2, limit, "hard")
    return ph.diagnose(ph.estimate(motor(), first), validation=second)


def test_what_only_the_records_held_out_excite_is_found_in_all_together() -> None:
    d = diagnosed(1.6)
    (found,) = named(d)
    assert found.cause == "volts:saturation"
    assert abs(found.coefficient - 1.6) < 0.05
    assert any("estimated from gentle and hard, and nothing was held out" in note for note in d.notes)
    assert [e.name for e in d.extend().fit.experiments] == ["gentle", "hard"]


def test_an_offset_of_each_record_is_no_difference_of_the_model() -> None:
    m = motor(own_offset=True)
    first, second = record(1.5, 1, 1.6, "gentle"), record(3.0, 2, 1.6, "hard")
    shifted = second.with_outputs({**second.outputs, "angle": second.outputs["angle"] + 0.5})
    d = ph.diagnose(ph.estimate(m, first), validation=shifted, biases=["offset"])
    assert [f.cause for f in named(d)] == ["volts:saturation"], d.summary()


def test_records_of_a_model_that_lacks_nothing_are_not_taken_together() -> None:
    d = diagnosed(np.inf)
    assert d.verdict == "nothing" and not any("nothing was held out" in note for note in d.notes)
