"""The figure of the solver's way: its four panels against the iteration table, and restarts."""

from __future__ import annotations

import io
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from phugoid.errors import DataError
from phugoid.figures.estimates import plot_convergence
from phugoid.solvers import Iteration


def fit(history: Sequence[Iteration]) -> Any:
    return SimpleNamespace(
        history=history, model=SimpleNamespace(name="m"), status="converged", iterations=len(history), time=0.1
    )


LINES = [
    Iteration(0, -50.0, 0.5, 1e3, 0.0, 0),
    Iteration(1, 130.0, 1e-2, 1e1, 0.25, 3),
    Iteration(2, 99.0, 1e-7, 1e-2, 1.0, 1),
    Iteration(3, 100.0, 0.0, 1e-9, 1.0, 1),
]


def curve(axis: Any) -> np.ndarray:
    return np.asarray(max(axis.get_lines(), key=lambda x: len(x.get_xdata())).get_xydata())


def test_panels_show_the_table() -> None:
    figure, axes = plot_convergence(fit(LINES))
    assert list(axes) == ["log-likelihood", "defect", "optimum", "step"]
    np.testing.assert_allclose(curve(axes["log-likelihood"]), [(0, 150.0), (1, 30.0), (2, 1.0)])
    np.testing.assert_allclose(curve(axes["defect"]), [(0, 0.5), (1, 1e-2), (2, 1e-7), (3, np.nan)])
    np.testing.assert_allclose(curve(axes["optimum"])[:, 1], [1e3, 1e1, 1e-2, 1e-9])
    np.testing.assert_allclose(curve(axes["step"]), [(1, 0.25), (2, 1.0), (3, 1.0)])
    assert {name: axis.get_yscale() for name, axis in axes.items()} == {
        "log-likelihood": "log", "defect": "log", "optimum": "log", "step": "linear",
    }  # fmt: skip
    assert "100" in axes["log-likelihood"].get_title(loc="left")
    figure.savefig(io.BytesIO())


def test_points_above_the_end_are_hollow_and_retried_steps_ringed() -> None:
    _, axes = plot_convergence(fit(LINES))
    hollow = [x for x in axes["log-likelihood"].get_lines() if x.get_markerfacecolor() == "white"]
    assert [tuple(p) for x in hollow for p in x.get_xydata()] == [(1.0, 30.0)]
    rings = [x for x in axes["step"].get_lines() if x.get_label() == "retried"]
    assert [tuple(p) for x in rings for p in x.get_xydata()] == [(1.0, 0.25)]


def test_a_table_that_starts_anew_goes_on_being_counted() -> None:
    _, axes = plot_convergence(fit([*LINES, *LINES]))
    np.testing.assert_array_equal(curve(axes["optimum"])[:, 0], np.arange(8))
    marks = [x.get_xdata()[0] for x in axes["optimum"].get_lines() if x.get_linestyle() == "--"]
    assert marks == [3.5]


def test_shooting_has_no_defects() -> None:
    figure, axes = plot_convergence(fit([Iteration(i, -1.0 / (1 + i), 0.0, 1.0, 1.0, 1) for i in range(3)]))
    assert [t.get_text() for t in axes["defect"].texts] == ["zero, or none, throughout"]
    figure.savefig(io.BytesIO())


def test_a_fit_without_a_table_is_refused() -> None:
    with pytest.raises(DataError, match="no history"):
        plot_convergence(fit([]))
