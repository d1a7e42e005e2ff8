"""Tolerances that are so much, or such a part of what is measured, whichever is greater."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import phugoid as ph
from phugoid.cli.options import tolerances
from phugoid.figures.fit import plot_fit
from phugoid.parameters import Estimates
from phugoid.records import Record


def record(measured: np.ndarray, residual: np.ndarray) -> Record:
    t = np.arange(measured.size, dtype=float)
    return Record(
        name="run",
        t=t,
        inputs={},
        outputs={"V": measured - residual},
        states={},
        measured={"V": measured},
        residuals={"V": residual},
        units={"V": "m/s"},
    )


def test_the_greater_part_holds_at_each_sample() -> None:
    z = np.array([0.0, 10.0, -40.0, 100.0, np.nan])
    np.testing.assert_array_equal(ph.Tolerance(absolute=1.5, relative=0.05).at(z), [1.5, 1.5, 2.0, 5.0, np.nan])
    np.testing.assert_array_equal(ph.Tolerance(relative=0.05).at(z), [0.0, 0.5, 2.0, 5.0, np.nan])
    np.testing.assert_array_equal(ph.Tolerance(1.5).at(z), [1.5, 1.5, 1.5, 1.5, np.nan])


def test_inside_counts_by_the_tolerance_of_each_sample() -> None:
    r = record(np.array([10.0, 10.0, 100.0, 100.0, np.nan]), np.array([1.4, -1.6, 4.9, 5.1, np.nan]))
    both = ph.match(r, "V", tolerance=ph.Tolerance(1.5, 0.05))
    assert both.inside == 0.5 and both.samples == 4 and both.tolerance == ph.Tolerance(1.5, 0.05)
    assert ph.match(r, "V", tolerance=ph.Tolerance(relative=0.05)).inside == 0.25
    number = ph.match(r, "V", tolerance=1.5)
    assert number.inside == 0.25 and number.tolerance == ph.Tolerance(1.5)


def test_text_has_units_and_percent() -> None:
    assert ph.Tolerance(1.5, 0.05).text("m/s") == "±1.5 m/s or ±5 %"
    assert ph.Tolerance(relative=0.1).text("m/s") == "±10 %"
    assert ph.Tolerance(0.02).text("1") == ph.Tolerance(0.02).text() == "±0.02"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "give an absolute or a relative part above 0"),
        ({"relative": 5}, "0.05 for 5 %, not 5"),
        ({"absolute": -1.0}, "absolute is a number from 0, not -1.0"),
        ({"absolute": math.inf}, "absolute is a number from 0, not inf"),
        ({"relative": math.nan}, "relative is a number from 0, not nan"),
        ({"absolute": "wide"}, "absolute is a number from 0, not 'wide'"),
        ({"absolute": True}, "absolute is a number from 0, not True"),
    ],
)
def test_what_is_none_is_refused(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ph.OptionError, match=words):
        ph.Tolerance(**options)


def test_match_refuses_a_tolerance_that_is_none() -> None:
    with pytest.raises(ph.OptionError, match="match: the tolerance must be positive and finite, not 0"):
        ph.match(record(np.ones(3), np.zeros(3)), "V", tolerance=0)


def test_the_bands_follow_the_measurements() -> None:
    z = np.linspace(10.0, 100.0, 50)
    r = record(z, 2.0 * np.sin(np.arange(50.0)))
    _, axes = plot_fit(_Fitted([r]), tolerances={"V": ph.Tolerance(1.5, 0.05)})
    (band,) = (c for c in axes["V"].collections if c.get_label() == "tolerance")
    corners = np.concatenate([path.vertices for path in band.get_paths()])
    wide = np.maximum(1.5, 0.05 * z)
    for t, low, high in zip(r.t, z - wide, z + wide, strict=True):
        for edge in (low, high):
            assert np.hypot(*(corners - [t, edge]).T).min() < 1e-9
    limits = [line for line in axes["V residual"].get_lines() if line.get_linestyle() == "--"]
    np.testing.assert_allclose([line.get_ydata() for line in limits], [-wide, wide])
    assert axes["V residual"].get_ylim()[1] > 5.0
    inside = 100.0 * np.mean(np.abs(r.residuals["V"]) <= wide)
    assert 50.0 < inside < 100.0
    assert axes["V"].get_title(loc="right") == f"{inside:.1f} % within ±1.5 m/s or ±5 %"


def test_limits_that_would_flatten_the_residuals_are_left_out() -> None:
    z = np.linspace(50.0, 100.0, 50)
    _, axes = plot_fit(_Fitted([record(z, 0.1 * np.sin(np.arange(50.0)))]), tolerances={"V": ph.Tolerance(0.0, 0.5)})
    assert axes["V residual"].get_ylim()[1] < 0.2
    assert not [line for line in axes["V residual"].get_lines() if line.get_linestyle() == "--"]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("V=1.5", ph.Tolerance(1.5)),
        ("V=5%", ph.Tolerance(relative=0.05)),
        ("V=1.5/5%", ph.Tolerance(1.5, 0.05)),
        ("V= 1.5 / 5 %", ph.Tolerance(1.5, 0.05)),
    ],
)
def test_the_command_line_reads_them(text: str, expected: ph.Tolerance) -> None:
    found = tolerances([text])["V"]
    assert found.absolute == expected.absolute and found.relative == pytest.approx(expected.relative)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("V=5%/1.5", "is not of the form OUTPUT=VALUE, OUTPUT=PART% or OUTPUT=VALUE/PART%"),
        ("V=1/2", "is not of the form"),
        ("V=wide", "'wide' is not a finite number"),
        ("V=x%", "'x' is not a finite number"),
        ("V=500%", "--tolerance V=500%: Tolerance: relative"),
        ("V=-1", "absolute is a number from 0, not -1.0"),
        ("V=0", "--tolerance V=0: Tolerance: give an absolute or a relative part"),
    ],
)
def test_the_command_line_says_what_is_wrong(text: str, words: str) -> None:
    with pytest.raises(ph.OptionError, match=words.replace("(", "\\(")):
        tolerances([text])


class _Fitted:
    def __init__(self, records: list[Record]) -> None:
        self.records = records
        self.parameters, self.noise, self.model = Estimates([]), ph.Gaussian(), SimpleNamespace(name="m")
