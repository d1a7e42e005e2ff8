"""The heat map of correlations: the numbers of its cells, its names, and what is refused."""

from __future__ import annotations

import io
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from phugoid.errors import DataError, UnknownName
from phugoid.parameters import Estimate, Estimates
from phugoid.uncertainty.correlation import plot_correlation


def fit(n: int, *, fixed: int | None = None, seed: int = 0) -> Any:
    half = np.random.default_rng(seed).standard_normal((n, n + 3))
    covariance = half @ half.T
    names = [f"C_{i}" for i in range(n - 1)] + ["sigma_q"]
    if fixed is not None:
        covariance[fixed], covariance[:, fixed] = np.nan, np.nan
    estimates = Estimates(Estimate(name, 1.0, 1.0, fixed=i == fixed) for i, name in enumerate(names))
    return SimpleNamespace(
        parameters=estimates, covariance=covariance, noise_parameters={"sigma_q"}, model=SimpleNamespace(name="$m$")
    )


def test_cells_hold_the_correlations() -> None:
    f = fit(6)
    _, axes = plot_correlation(f)
    assert list(axes) == ["correlation", "scale"]
    shown = np.asarray(axes["correlation"].collections[0].get_array())
    expected = f.covariance / np.sqrt(np.outer(np.diag(f.covariance), np.diag(f.covariance)))
    for row in range(4):
        np.testing.assert_allclose(shown[row, : row + 1], expected[row + 1, : row + 1])
    assert [t.get_text() for t in axes["correlation"].get_yticklabels()] == ["C_1", "C_2", "C_3", "C_4"]
    assert [t.get_text() for t in axes["correlation"].get_xticklabels()] == ["C_0", "C_1", "C_2", "C_3"]
    written = [float(t.get_text().replace("−", "-")) for t in axes["correlation"].texts]
    np.testing.assert_allclose(written, expected[np.tril_indices(5, -1)], atol=0.0051)
    cells = axes["correlation"].collections[0]
    assert (cells.norm.vmin, cells.norm.vmax) == (-1.0, 1.0)


def test_strong_ones_are_bold() -> None:
    f = fit(4)
    f.covariance[:] = np.eye(4)
    f.covariance[:2, :2] = [[4.0, -1.9], [-1.9, 1.0]]
    weights = {t.get_text(): t.get_fontweight() for t in plot_correlation(f)[1]["correlation"].texts}
    assert weights["−.95"] == "bold" and list(weights.values()).count("bold") == 1


def test_thirty_parameters_can_be_read_at_print_size() -> None:
    figure, axes = plot_correlation(fit(31))
    figure.savefig(io.BytesIO())
    axis = axes["correlation"]
    assert figure.get_size_inches()[0] <= 7.3 and figure.get_size_inches()[1] <= 10.2
    assert len(axis.texts) == 30 * 29 // 2
    assert min(t.get_fontsize() for t in (*axis.texts, *axis.get_yticklabels())) >= 4.5
    drawn = figure.canvas.get_renderer()
    cell = axis.get_window_extent(drawn).width / 29
    assert max(t.get_window_extent(drawn).width for t in axis.texts) <= cell
    whole = figure.bbox
    for label in (*axis.get_xticklabels(), *axis.get_yticklabels(), *axes["scale"].get_xticklabels()):
        box = label.get_window_extent(drawn)
        assert box.x0 >= whole.x0 and box.y0 >= whole.y0 and box.x1 <= whole.x1


def test_a_hundred_parameters_have_colours_only() -> None:
    assert not plot_correlation(fit(101))[1]["correlation"].texts


def test_what_was_not_estimated_is_left_out() -> None:
    _, axes = plot_correlation(fit(5, fixed=1))
    assert [t.get_text() for t in axes["correlation"].get_yticklabels()] == ["C_2", "C_3"]


def test_names_choose_and_order() -> None:
    f = fit(5)
    _, axes = plot_correlation(f, ["sigma_q", "C_0"])
    value = f.covariance[4, 0] / np.sqrt(f.covariance[4, 4] * f.covariance[0, 0])
    assert np.asarray(axes["correlation"].collections[0].get_array()) == pytest.approx(np.array([[value]]))
    assert axes["correlation"].get_yticklabels()[0].get_text() == "C_0"


def test_bad_input_is_refused() -> None:
    f = fit(5, fixed=1)
    with pytest.raises(UnknownName, match="no parameter 'c_0'. Did you mean 'C_0'"):
        plot_correlation(f, ["c_0", "C_2"])
    with pytest.raises(DataError, match="'C_1' is fixed, so it has no correlation"):
        plot_correlation(f, ["C_0", "C_1"])
    with pytest.raises(DataError, match="takes two estimates or more, and here is 1"):
        plot_correlation(f, ["C_0"])
    with pytest.raises(DataError, match="is text"):
        plot_correlation(f, "C_0")
