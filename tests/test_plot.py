"""Figures: which panels there are, what they show, and what is refused."""

from __future__ import annotations

import io
from types import SimpleNamespace
from typing import Any

import matplotlib
import numpy as np
import pytest
from matplotlib import pyplot as plt

import phugoid as ph
from phugoid import Gaussian
from phugoid.errors import DataError, OptionError, UnknownName
from phugoid.figures.fit import plot_fit, plot_record
from phugoid.parameters import Estimate, Estimates
from phugoid.records import Record

N = 60
SEVEN = ["V", "alpha", "theta", "q", "qdot", "ax", "az"]


def record(outputs: list[str], inputs: tuple[str, ...] = ("de", "thrust"), measured: bool = True) -> Record:
    rng = np.random.default_rng(1)
    t = np.linspace(0.0, 6.0, N)
    model = {name: np.sin((1 + i) * t) for i, name in enumerate(outputs)}
    residuals = {name: 0.1 * rng.standard_normal(N) for name in outputs} if measured else {}
    for residual in residuals.values():
        residual[10:15] = np.nan
    return Record(
        name="run1",
        t=t,
        inputs={name: np.cos(t) for name in inputs},
        outputs=model,
        states={"x": t},
        measured={name: model[name] + r for name, r in residuals.items()},
        residuals=residuals,
        units={"alpha": "rad", "de": "rad", "q": "1"},
    )


def fit(*records: Record) -> SimpleNamespace:
    return SimpleNamespace(
        records=list(records),
        parameters=Estimates([Estimate("sigma_alpha", 0.1)]),
        noise=Gaussian(),
        model=SimpleNamespace(name="a model worth $5"),
    )


def lines(axis: Any) -> dict[str, Any]:
    return {line.get_label(): line for line in axis.get_lines() if not line.get_label().startswith("_")}


def test_panels_in_order_each_output_with_its_strip() -> None:
    _, axes = plot_fit(fit(record(["alpha", "q"])))
    assert list(axes) == ["alpha", "alpha residual", "q", "q residual", "de", "thrust"]


def test_panel_shows_measured_points_and_model_line() -> None:
    r = record(["alpha"])
    _, axes = plot_fit(fit(r))
    shown = lines(axes["alpha"])
    np.testing.assert_array_equal(shown["measured"].get_ydata(), r.measured["alpha"])
    np.testing.assert_array_equal(shown["model"].get_ydata(), r.outputs["alpha"])
    assert (shown["measured"].get_linestyle(), shown["measured"].get_marker()) == ("None", ".")


def test_strip_shows_residual_about_zero() -> None:
    r = record(["alpha"])
    _, axes = plot_fit(fit(r))
    strip = axes["alpha residual"]
    np.testing.assert_array_equal(lines(strip)["residual"].get_ydata(), r.residuals["alpha"])
    low, high = strip.get_ylim()
    assert low == -high and high > np.nanmax(np.abs(r.residuals["alpha"]))


def test_band_of_two_sigma_only_where_sigma_is_known() -> None:
    _, axes = plot_fit(fit(record(["alpha", "q"])))
    assert len(axes["alpha residual"].patches) == 1
    assert len(axes["q residual"].patches) == 0


def test_sigma_may_be_known_or_of_one_experiment() -> None:
    f = fit(record(["alpha", "q", "V"]))
    f.parameters = Estimates([Estimate("sigma_q[run1]", 0.3), Estimate("sigma_V[run2]", 0.3)])
    f.noise = ph.Gaussian({"alpha": 0.2})
    _, axes = plot_fit(f)
    heights = {n: [p.get_height() for p in axes[f"{n} residual"].patches] for n in ("alpha", "q", "V")}
    assert heights == {"alpha": [0.8], "q": [1.2], "V": []}


def test_labels_carry_units() -> None:
    _, axes = plot_fit(fit(record(["alpha", "q"])))
    assert [axes[n].get_ylabel() for n in ("alpha", "q", "de", "thrust")] == [
        "alpha, rad",
        "q",
        "de, rad",
        "thrust",
    ]


def test_time_is_shared_and_labelled_at_the_foot_only() -> None:
    figure, axes = plot_fit(fit(record(["alpha", "q"])))
    assert {n for n, a in axes.items() if a.get_xlabel()} == {"thrust"}
    axes["alpha"].set_xlim(1.0, 2.0)
    assert axes["thrust"].get_xlim() == (1.0, 2.0)
    figure.savefig(io.BytesIO())


def test_more_than_six_outputs_take_two_columns() -> None:
    figure, axes = plot_fit(fit(record(SEVEN)))
    left = {n: a.get_position().x0 for n, a in axes.items()}
    assert len(set(left.values())) == 2
    assert left["V"] == left["q"] == left["de"] < left["qdot"] == left["az"] == left["thrust"]
    assert {n for n, a in axes.items() if a.get_xlabel()} == {"de", "thrust"}
    lowest_output = min(axes[n].get_position().y0 for n in SEVEN)
    assert max(axes[n].get_position().y1 for n in ("de", "thrust")) < lowest_output
    assert tuple(figure.get_size_inches() <= (7.3, 10.3)) == (True, True)


def test_six_outputs_take_one_column_of_a_page() -> None:
    figure, axes = plot_fit(fit(record(SEVEN[:6])))
    assert len({a.get_position().x0 for a in axes.values()}) == 1
    assert figure.get_size_inches()[1] <= 10.3


def test_panels_do_not_overlap() -> None:
    _, axes = plot_fit(fit(record(SEVEN)))
    boxes = [a.get_position() for a in axes.values()]
    for i, a in enumerate(boxes):
        for b in boxes[:i]:
            assert a.x0 >= b.x1 or b.x0 >= a.x1 or a.y0 >= b.y1 or b.y0 >= a.y1


def test_channels_select_outputs_inputs_and_states() -> None:
    _, axes = plot_fit(fit(record(["alpha", "q"])), channels=["q", "x", "de"])
    assert list(axes) == ["q", "q residual", "x", "de"]
    assert list(lines(axes["x"])) == ["state"]


def test_record_is_chosen_by_index_or_name() -> None:
    one, two = record(["alpha"]), record(["q"])
    object.__setattr__(two, "name", "run2")
    for which in (1, -1, "run2"):
        assert "q" in plot_fit(fit(one, two), record=which)[1]


@pytest.mark.parametrize(("which", "words"), [(2, "no record 2: the fit has 1"), ("run", "Did you mean 'run1'")])
def test_unknown_record_is_refused(which: int | str, words: str) -> None:
    with pytest.raises(UnknownName, match=words):
        plot_fit(fit(record(["alpha"])), record=which)


def test_unknown_channel_is_refused() -> None:
    with pytest.raises(UnknownName, match=r"'run1' has no channel 'Alpha'\. Did you mean 'alpha'"):
        plot_fit(fit(record(["alpha"])), channels=["Alpha"])


def test_text_for_the_channels_is_refused() -> None:
    with pytest.raises(DataError, match=r"channels=\['alpha'\]"):
        plot_fit(fit(record(["alpha"])), channels="alpha")


def test_own_axes_are_drawn_into() -> None:
    figure, (top, bottom) = plt.subplots(2)
    given = {"alpha": top, "alpha residual": bottom}
    result, axes = plot_fit(fit(record(["alpha", "q"])), axes=given)
    assert result is figure and axes == given
    assert set(lines(top)) == {"measured", "model"} and set(lines(bottom)) == {"residual"}


def test_simulated_record_needs_no_measurement() -> None:
    _, axes = plot_record(record(["alpha"], inputs=(), measured=False))
    assert list(axes) == ["alpha"]
    assert list(lines(axes["alpha"])) == ["model"]


def test_empty_record_is_refused() -> None:
    with pytest.raises(DataError, match="no channel to plot"):
        plot_record(record([], inputs=()))


def test_residual_missing_throughout_does_no_harm() -> None:
    r = record(["q"])
    r.residuals["q"][:] = np.nan
    figure, _ = plot_fit(fit(r))
    figure.savefig(io.BytesIO())


def test_tolerances_are_bands_and_the_part_within() -> None:
    r = record(["alpha", "q"])
    figure, axes = plot_fit(fit(r), tolerances={"q": 0.12})
    bands = [c for c in axes["q"].collections if c.get_label() == "tolerance"]
    corners = np.concatenate([path.vertices for band in bands for path in band.get_paths()])
    assert corners[:, 1].max() == pytest.approx(np.nanmax(r.measured["q"]) + 0.12)
    assert corners[:, 1].min() == pytest.approx(np.nanmin(r.measured["q"]) - 0.12)
    inside = 100.0 * np.mean(np.abs(r.residuals["q"][np.isfinite(r.residuals["q"])]) <= 0.12)
    assert 0.0 < inside < 100.0
    assert axes["q"].get_title(loc="right") == f"{inside:.1f} % within ±0.12"
    assert {line.get_ydata()[0] for line in axes["q residual"].get_lines()} >= {-0.12, 0.12}
    assert not axes["alpha"].get_title(loc="right") and not axes["alpha"].collections
    assert "tolerance" in [text.get_text() for text in figure.legends[0].get_texts()]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"Alpha": 1.0}, "tolerance of 'Alpha', which is not an output. Did you mean 'alpha'"),
        ({"alpha": -1.0}, "must be positive and finite, not -1.0"),
        ({"alpha": "wide"}, "must be a number, or a Tolerance"),
        (0.1, "given by output"),
    ],
)
def test_tolerances_that_are_none_are_refused(given: Any, words: str) -> None:
    with pytest.raises(OptionError, match=words):
        plot_fit(fit(record(["alpha"])), tolerances=given)


def test_residuals_of_a_channel_with_every_other_sample_are_seen() -> None:
    r = record(["q"])
    r.residuals["q"][::2] = np.nan
    _, axes = plot_fit(fit(r))
    drawn = np.asarray(lines(axes["q residual"])["residual"].get_ydata())
    seen = np.isfinite(drawn[1:]) & np.isfinite(drawn[:-1])
    assert seen.sum() > 0.7 * np.isfinite(r.residuals["q"]).sum()


def test_style_of_the_user_is_left_alone() -> None:
    before = dict(matplotlib.rcParams)
    plot_fit(fit(record(["alpha"])))
    assert dict(matplotlib.rcParams) == before
