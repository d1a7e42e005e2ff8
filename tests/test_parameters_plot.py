"""The figure of intervals: their ends, their scale, several fits side by side, and what is refused."""

from __future__ import annotations

import io
import math
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from phugoid.errors import DataError, OptionError, UnknownName
from phugoid.figures.estimates import plot_parameters
from phugoid.parameters import Estimate, Estimates


def fit(name: str = "m", **estimates: tuple[float, float]) -> Any:
    found = Estimates(Estimate(n, v, s, unit="1/s", fixed=math.isnan(s)) for n, (v, s) in estimates.items())
    return SimpleNamespace(
        parameters=found, noise_parameters={"sigma_q"} & set(found), model=SimpleNamespace(name=name), records=()
    )


def bars(axis: Any) -> list[tuple[float, float, float]]:
    """Low end, high end and height of the intervals, from top to bottom."""
    lines = [x for x in axis.get_lines() if x.get_linewidth() == 1.5 and len(x.get_xdata()) == 2]
    return sorted(((*x.get_xdata(), x.get_ydata()[0]) for x in lines), key=lambda b: b[2])


def test_one_fit_in_per_cent_of_the_estimate() -> None:
    _, axes = plot_parameters([fit(a=(-2.0, 0.1), b=(40.0, 4.0), sigma_q=(1.0, 0.1))])
    axis = axes["parameters"]
    assert [t.get_text() for t in axis.get_yticklabels()] == ["a", "b"]
    found = bars(axis)
    np.testing.assert_allclose([b[:2] for b in found], [(-9.8, 9.8), (-19.6, 19.6)], rtol=1e-4)
    assert axis.get_xlabel() == "95 % interval, % of the estimate"
    assert [t.get_text() for t in axis.texts] == ["−2.00 ± 0.10 1/s", "40 ± 4 1/s"]
    assert axis.yaxis_inverted()


def test_an_interval_that_holds_zero_ends_in_arrows_with_its_size() -> None:
    _, axes = plot_parameters([fit(a=(1.0, 0.3), b=(1.0, 2.0), c=(0.0, 1.0))])
    axis = axes["parameters"]
    assert [b[:2] for b in bars(axis)[1:]] == [(-100.0, 100.0)] * 2
    assert [x.get_marker() for x in axis.get_lines()].count(">") == 2
    assert {"±392 %", "more than 100 000 %"} <= {t.get_text().removeprefix("±more").strip() for t in axis.texts} | {
        t.get_text().replace("±more", "more") for t in axis.texts
    }


def test_intervals_of_very_different_size_get_a_logarithmic_scale() -> None:
    figure, axes = plot_parameters([fit(a=(1.0, 0.001), b=(1.0, 0.002), c=(1.0, 0.3))])
    assert axes["parameters"].get_xscale() == "symlog"
    assert "logarithmic beyond" in axes["parameters"].get_xlabel()
    figure.savefig(io.BytesIO())
    _, axes = plot_parameters([fit(a=(1.0, 0.1), b=(1.0, 0.2))])
    assert axes["parameters"].get_xscale() == "linear"


def test_tiny_intervals_are_in_millionths() -> None:
    figure, axes = plot_parameters([fit(a=(1.0, 1e-6), b=(1.0, 2e-6))])
    figure.canvas.draw()
    assert "millionths" in axes["parameters"].get_xlabel()
    largest = max(float(t.get_text().replace("−", "-")) for t in axes["parameters"].get_xticklabels())
    assert 2.0 <= largest <= 6.0


def test_several_fits_in_standard_errors_of_the_first() -> None:
    one, two = fit("first", a=(1.0, 0.1), b=(5.0, 1.0)), fit("second", a=(1.3, 0.2), c=(7.0, 0.5))
    figure, axes = plot_parameters([one, two])
    axis = axes["parameters"]
    assert [t.get_text() for t in axis.get_yticklabels()] == ["a", "b", "c"]
    own = 1.959964
    expected = [(-own, own), (3.0 - 2.0 * own, 3.0 + 2.0 * own), (-own, own), (-own, own)]
    np.testing.assert_allclose([b[:2] for b in bars(axis)], expected, rtol=1e-5)
    assert "'first', in its standard errors" in axis.get_xlabel()
    assert [t.get_text() for t in figure.legends[0].get_texts()] == ["first", "second"]
    markers = {x.get_marker() for x in axis.get_lines() if x.get_label() == "estimate"}
    assert markers == {"o", "s"}  # told apart in grey, too


def test_what_is_far_off_does_not_flatten_the_others() -> None:
    ones = {f"p{i}": (1.0, 0.1) for i in range(6)}
    off = {**ones, "p3": (1001.0, 0.1)}
    axis = plot_parameters([fit("first", **ones), fit("second", **off)])[1]["parameters"]
    assert axis.get_xlim()[1] < 20.0
    assert "+1e+04" in [t.get_text() for t in axis.texts]


def test_eighty_parameters_fit_a_page() -> None:
    figure, axes = plot_parameters([fit(**{f"p{i}": (1.0, 0.1) for i in range(80)})])
    assert figure.get_size_inches()[1] <= 10.3
    drawn = figure.canvas.get_renderer()
    figure.draw(drawn)
    boxes = [t.get_window_extent(drawn) for t in axes["parameters"].get_yticklabels()]
    assert all(a.y0 >= b.y1 - 1.0 for a, b in pairwise(boxes))


def test_what_has_no_error_is_named_at_the_foot() -> None:
    figure, axes = plot_parameters([fit(a=(1.0, 0.1), held=(2.0, math.nan))])
    assert [t.get_text() for t in axes["parameters"].get_yticklabels()] == ["a"]
    assert figure.get_supxlabel() == "without a standard error: held"
    # Held in one fit, and estimated in the other: a point.
    axis = plot_parameters([fit("x", a=(1.0, 0.1)), fit("y", a=(1.2, math.nan))])[1]["parameters"]
    points = [x.get_xdata()[0] for x in axis.get_lines() if x.get_label() == "estimate"]
    assert len(bars(axis)) == 1 and points == pytest.approx([0.0, 2.0])


def test_bad_input_is_refused() -> None:
    f = fit(a=(1.0, 0.1), held=(2.0, math.nan))
    with pytest.raises(UnknownName, match="no parameter 'A'. Did you mean 'a'"):
        plot_parameters([f], ["A"])
    with pytest.raises(DataError, match="no parameter has a standard error"):
        plot_parameters([f], ["held"])
    with pytest.raises(DataError, match="is text"):
        plot_parameters([f], "a")
    with pytest.raises(DataError, match="give fits, .* not a float"):
        plot_parameters([f, 3.0])
    with pytest.raises(DataError, match="one fit or several"):
        plot_parameters([])
    with pytest.raises(OptionError, match="a list of 2, one for each fit"):
        plot_parameters([f, f], labels=["one"])
    assert [t.get_text() for t in plot_parameters([f, f])[0].legends[0].get_texts()] == ["fit 1", "fit 2"]
