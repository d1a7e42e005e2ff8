"""The example of three formulations: near the optimum all agree, from zeros single shooting is lost on HFB-320."""

from __future__ import annotations

from pathlib import Path

import three_formulations
from three_formulations import Outcome


def test_near_the_optimum_all_arrive_and_from_zeros_single_shooting_does_not(tmp_path: Path) -> None:
    case = three_formulations.cases()[0]
    best = three_formulations.reference(case)
    outcomes: list[Outcome] = []
    for start in three_formulations.STARTS:
        outcomes += three_formulations.run(case, best, start)
    arrived = {(o.start, o.formulation): o.arrived for o in outcomes}
    assert all(arrived["near", name] for name in case.formulations())
    assert arrived["zeros", "collocation"] and arrived["zeros", "multiple shooting"]
    assert not arrived["zeros", "single shooting"]
    table = three_formulations.table(outcomes)
    assert table.count("HFB-320") == len(outcomes)
    three_formulations.draw(outcomes, {case.title: best}, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 10_000
