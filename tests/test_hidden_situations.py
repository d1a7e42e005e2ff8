"""Records in situations: what is hidden in them is there, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from hidden import SYSTEMS, Unreachable
from hidden.situation import CONTACTS, SITUATIONS, situation
from hidden.twists import STOPPED


@pytest.mark.parametrize("what", SITUATIONS)
def test_every_situation_can_be_made(what: str) -> None:
    """Make it in two of the systems, which differ from situation to situation; `benchmarks/situations.py` makes all."""
    made, first = [], SITUATIONS.index(what) % len(SYSTEMS)
    for system in [*SYSTEMS][first:] + [*SYSTEMS][:first]:
        try:
            made.append(situation(what, system, 4))
        except Unreachable:
            continue
        if len(made) == 2:
            break
    assert made
    for s in made:
        records = s.data if isinstance(s.data, list) else [s.data]
        for e in (*records, s.validation):
            assert {*e.outputs} == {*s.model.output_names}
            assert all(np.isfinite(y).sum() > 30 for y in e.outputs.values())


@pytest.mark.parametrize("system", STOPPED)
def test_a_stop_is_met_several_times_and_hardly_passed(system: str) -> None:
    s = situation("end stop", system, 6201)
    x, limit = s.data.outputs[STOPPED[system][0]], s.sizes["limit"]
    noise = SYSTEMS[system].sigma[STOPPED[system][0]]
    assert np.sum(np.diff((x > limit).astype(int)) > 0) >= CONTACTS
    assert x.max() < limit + 0.25 * np.ptp(x) + 4.0 * noise


def test_a_second_sensor_measures_the_same_but_for_its_fault() -> None:
    s = situation("redundant", "duffing", 4)
    (cause,) = s.truth
    first = cause.partition(":")[0].removesuffix("_2")
    both = [s.data.outputs[n] for n in (first, f"{first}_2")]
    assert np.corrcoef(*both)[0, 1] > 0.9
    assert not np.array_equal(*both)


def test_one_parameter_differs_from_record_to_record() -> None:
    s = situation("other parameter", "servo", 4)
    assert len(s.data) > 2 and s.truth[0].endswith(":per_experiment")
    assert len({e.name for e in s.data} | {s.validation.name}) == len(s.data) + 1
