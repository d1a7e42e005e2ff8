"""Table, figure and progress of many starts."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from many import run

import phugoid as ph
from phugoid.results import Multistart, Outcome


def test_table_for_pandas(rugged: Multistart) -> None:
    pytest.importorskip("pandas")
    table = rugged.to_pandas()
    assert list(table.columns)[:6] == ["optimum", "status", "log_likelihood", "iterations", "time", "message"]
    assert list(table.columns)[6:] == ["a", "sigma_y", "std_error_a", "std_error_sigma_y", "start_a"]
    assert table.index.name == "start" and list(table.index) == list(range(60))
    assert (table["optimum"] == 1).sum() == rugged.optima[0].count
    assert table["optimum"].isna().sum() == sum(not o.converged for o in rugged.outcomes)
    assert table["start_a"].tolist() == [o.start["a"] for o in rugged.outcomes]


def test_table_without_pandas_says_what_to_install(twins: Multistart, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ph.MissingDependency, match=r'pip install "phugoid\[pandas\]"'):
        twins.to_pandas()


def plateaus(axis: Any) -> list[tuple[float, float]]:
    """Level and number of starts of each thick line."""
    thick = [line for line in axis.get_lines() if line.get_linewidth() == 4]
    return [(line.get_ydata()[0], float(np.diff(line.get_xdata())[0])) for line in thick]


def test_waterfall_of_two_optima_has_two_plateaus(twins: Multistart, pyplot: Any) -> None:
    figure, axes = twins.plot()
    assert list(axes) == ["gap"] and figure.axes == [axes["gap"]]
    counts = [o.count for o in twins.optima]
    assert [count for _, count in plateaus(axes["gap"])] == counts
    assert [t.get_text() for t in axes["gap"].texts] == [f"{counts[0]} starts", f"×{counts[1]}"]
    assert [level for level, _ in plateaus(axes["gap"])] == pytest.approx([0.0, 0.0], abs=1e-6)


def test_waterfall_shows_every_start_once(rugged: Multistart, pyplot: Any) -> None:
    figure, axes = rugged.plot()
    several = [o for o in rugged.optima if o.count > 1]
    best = rugged.optima[0].log_likelihood
    assert plateaus(axes["gap"]) == [(best - o.log_likelihood, o.count) for o in several]
    ranks: list[float] = []
    for axis in axes.values():
        for dots in (line for line in axis.get_lines() if line.get_linestyle() == "None"):
            ranks += dots.get_xdata().tolist()
    assert ranks == list(range(1, 61))
    rows = [t.get_text() for t in axes["not converged"].get_yticklabels()]
    assert rows == [f"{status}, {count}" for status, count in rugged.counts.items() if status != "converged"]
    assert axes["gap"].get_ylim()[0] < 0 < best - rugged.optima[-1].log_likelihood < axes["gap"].get_ylim()[1]
    assert axes["gap"].texts[0].get_text() == f"{several[0].count} starts"
    figure.canvas.draw()


def test_counts_that_are_written_do_not_overlap(rugged: Multistart, pyplot: Any) -> None:
    figure, axes = rugged.plot()
    boxes = [text.get_window_extent(figure.canvas.get_renderer()) for text in axes["gap"].texts]
    assert len(boxes) >= 3
    assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])


def test_waterfall_without_any_optimum(pyplot: Any) -> None:
    figure, axes = run(2, solver=ph.Ipopt(max_iterations=1)).plot()
    assert list(axes) == ["gap", "not converged"]
    assert axes["gap"].texts[0].get_text() == "no start converged"
    figure.canvas.draw()


def test_progress_function_sees_each_outcome_once(tmp_path: Path) -> None:
    seen: list[Outcome] = []
    result = run(3, progress=seen.append, journal=tmp_path / "j")
    assert tuple(seen) == result.outcomes
    run(4, progress=seen.append, journal=tmp_path / "j")
    assert [o.index for o in seen] == [0, 1, 2, 3]


def test_progress_bar(capfd: pytest.CaptureFixture[str]) -> None:
    result = run(3, progress=True)
    out, err = capfd.readouterr()
    assert out == ""
    assert "lag with a squared gain" in err and "3/3" in err
    assert f"best logL {result.optima[0].log_likelihood:.3f}" in err


def test_quiet_unless_asked(capfd: pytest.CaptureFixture[str]) -> None:
    run(2)
    assert capfd.readouterr() == ("", "")


def test_error_of_the_progress_function_comes_out() -> None:
    def fail(_: Outcome) -> None:
        raise RuntimeError("from the callback")

    with pytest.raises(RuntimeError, match="from the callback"):
        run(2, progress=fail)
