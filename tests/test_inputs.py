"""Inputs: steps at the right samples, spectra where they should be, orthogonal multisines with low peaks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import trapezoid

import phugoid as ph
from phugoid import design
from phugoid.linear.state_space import table_of

T = 0.02 * np.arange(1501)  # carries rounding, as times do


def test_a_3211_has_steps_of_the_right_lengths_and_signs() -> None:
    u = design.three_two_one_one(T, -0.1, width=0.3, start=1.0)
    ends = np.flatnonzero(np.diff(u)) + 1
    assert T[ends] == pytest.approx([1.0, 1.9, 2.5, 2.8, 3.1])
    assert u[ends] == pytest.approx([-0.1, 0.1, -0.1, 0.1, 0.0])
    assert u[0] == u[-1] == 0.0


def test_a_balanced_3211_has_no_area_and_the_usual_one_has() -> None:
    balanced = design.three_two_one_one(T, 1.0, width=0.3, start=1.0, balanced=True)
    assert trapezoid(balanced, T) == pytest.approx(0.0, abs=1e-9)
    assert trapezoid(design.three_two_one_one(T, 1.0, width=0.3, start=1.0), T) == pytest.approx(0.3, rel=1e-6)


def test_heights_of_ones_own() -> None:
    u = design.multistep(T, 2.0, (2, 1), width=1.0, heights=(0.5, -0.25), start=2.0)
    assert np.unique(u).tolist() == [-0.5, 0.0, 1.0]
    assert design.pulse(T, 3.0, width=0.5).sum() == pytest.approx(25 * 3.0)
    assert (design.step(T, 3.0, start=1.0) > 0).sum() == T.size - 50


def test_an_actuator_of_limited_rate_takes_its_time() -> None:
    u = design.doublet(T, 0.2, width=1.0, start=1.0, rise=0.5)
    assert np.abs(np.diff(u) / np.diff(T)).max() == pytest.approx(0.4)
    assert u.max() == pytest.approx(0.2) and u.min() == pytest.approx(-0.2) and u[-1] == 0.0
    assert design.rate_limited(T, design.doublet(T, 0.2, width=1.0, start=1.0), 0.4) == pytest.approx(u)


@pytest.mark.parametrize("kind", ["doublet", "pulse"])
def test_the_step_width_puts_the_greatest_energy_at_the_mode(kind: Any) -> None:
    # Of a pulse the length is searched, of a doublet the frequency: that is how each is defined.
    t = np.arange(0.0, 30.0, 0.002)
    width = design.step_width(0.8, kind)
    if kind == "doublet":
        f = np.linspace(0.3, 2.0, 400)
        _, energy = design.spectrum(t, design.doublet(t, 1.0, width=width, start=1.0), f)
        assert f[energy.argmax()] == pytest.approx(0.8, rel=0.01)
    else:
        widths = width * np.array([0.8, 0.9, 1.0, 1.1, 1.2])
        found = [design.spectrum(t, design.pulse(t, 1.0, width=w, start=1.0), 0.8)[1][0] for w in widths]
        assert int(np.argmax(found)) == 2


def test_the_step_width_of_a_3211_leaves_the_mode_within_its_spectrum() -> None:
    t = np.arange(0.0, 30.0, 0.005)
    width = design.step_width(table_of(np.array([-1 + 6j, -1 - 6j]))[0])
    mode = np.hypot(1.0, 6.0) / (2 * np.pi)
    assert width == pytest.approx(0.25 / mode)
    f, energy = design.spectrum(
        t, design.three_two_one_one(t, 1.0, width=width, start=1.0), np.linspace(0.02, 4.0, 800)
    )
    at_mode = np.interp(mode, f, energy) / energy.max()
    assert 0.7 < at_mode < 0.85


def test_the_spectrum_is_that_of_the_lines_between_samples() -> None:
    t = np.array([0.0, 0.3, 1.0, 1.2, 2.0])
    u = np.array([0.0, 1.0, -0.5, 0.2, 0.0])
    fine = np.linspace(0.0, 2.0, 200_001)
    f, energy = design.spectrum(t, u, [0.0, 1e-5, 0.3, 2.0])
    values = np.interp(fine, t, u)
    expected = [abs(trapezoid(values * np.exp(-2j * np.pi * each * fine), fine)) ** 2 for each in f]
    assert energy == pytest.approx(expected, rel=1e-7)


def test_multisines_are_orthogonal_flat_in_their_band_and_begin_and_end_at_zero() -> None:
    t = 0.02 * np.arange(2001)
    made = design.multisines(t, {"de": 0.05, "da": 0.1, "dr": 0.2}, band=(0.1, 2.0), period=20.0, phases="schroeder")
    u = np.array(list(made.values()))
    assert np.abs(u).max(axis=1) == pytest.approx([0.05, 0.1, 0.2], rel=0.01)
    once = u[:, :1000]
    products = once @ once.T / np.outer(*2 * [np.linalg.norm(once, axis=1)])
    assert products == pytest.approx(np.eye(3), abs=1e-12)
    assert u[:, 1000:2000] == pytest.approx(once, abs=1e-12)  # two periods
    assert u[:, [0, -1]] == pytest.approx(0.0, abs=1e-9)
    lines = np.abs(np.fft.rfft(once))
    for i in range(3):
        mine = np.arange(2 + i, 41, 3)
        assert lines[i, mine] == pytest.approx(lines[i, mine[0]])
        assert np.delete(lines[i], mine) == pytest.approx(0.0, abs=1e-9)


def test_optimised_phases_have_lower_peaks_than_schroeders_and_these_than_random_ones() -> None:
    t = 0.02 * np.arange(1001)
    peaks = [
        design.peak_factor(design.multisine(t, 1.0, band=(0.1, 1.5), phases=phases)[:-1])  # type: ignore[arg-type]
        for phases in ("optimised", "schroeder", "random")
    ]
    assert peaks[0] < 1.1 < peaks[1] < peaks[2]
    assert peaks[0] < 0.9 * peaks[1]


def test_power_follows_a_function_of_frequency() -> None:
    t = 0.02 * np.arange(1001)
    u = design.multisine(t, 1.0, band=(0.1, 1.0), power=lambda f: 1 / f, phases="schroeder")[:-1]
    lines = np.abs(np.fft.rfft(u))[2:21] ** 2
    assert lines * np.arange(2, 21) == pytest.approx(2 * lines[0])


@pytest.mark.parametrize("pace", ["log", "linear"])
def test_a_sweep_goes_through_its_band(pace: Any) -> None:
    t = 0.005 * np.arange(8001)
    u = design.sweep(t, 1.0, band=(0.2, 2.0), start=5.0, duration=30.0, pace=pace, fade=2.0)
    assert not u[t < 5.0].any() and not u[t > 35.0].any()
    crossings = t[1:][(u[:-1] < 0) & (u[1:] >= 0)]
    frequency, at = 1 / np.diff(crossings), 0.5 * (crossings[1:] + crossings[:-1])
    along = (at - 5.0) / 30.0
    expected = 0.2 * 10**along if pace == "log" else 0.2 + 1.8 * along
    assert frequency == pytest.approx(expected, rel=0.07)
    assert frequency[3:] == pytest.approx(expected[3:], rel=0.01)
    f, energy = design.spectrum(t, u, [0.05, 0.5, 1.0, 3.0])
    assert min(energy[1:3]) > 20 * max(energy[0], energy[3])


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: design.doublet(T, 1.0, width=20.0), "it ends at 40, but the times only run to 30"),
        (lambda: design.doublet(T, 1.0, width=0.001), "the shortest step lasts 0.001,"),
        (lambda: design.doublet(T[::-1], 1.0, width=1.0), "times in s that increase"),
        (lambda: design.doublet(T, "big", width=1.0), "amplitude is a number, not 'big'"),  # type: ignore[arg-type]
        (lambda: design.step(T, 1.0, start=40.0), "start is 40,"),
        (lambda: design.multistep(T, 1.0, (1, 2), width=1.0, heights=(1,)), "1 heights for 2 steps"),
        (lambda: design.multisine(T, 1.0), "the band, or the harmonics"),
        (lambda: design.multisine(T, 1.0, band=(1.0, 40.0)), "above half the sampling rate"),
        (lambda: design.multisine(T, 1.0, band=(1.0, 0.5)), r"band is \(lowest, highest\)"),
        (lambda: design.multisines(T, {"a": 1, "b": 1}, band=(0.1, 0.101)), "harmonics of 1/30 for 2"),
        (lambda: design.multisines(T, {"a": 1, "b": 1}, harmonics={"a": [1], "b": [1]}), "harmonic 1 is given to two"),
        (lambda: design.sweep(T, 1.0, band=(0.1, 1.0), pace="lin"), "Did you mean 'linear'"),  # type: ignore[arg-type]
        (lambda: design.sweep(T, 1.0, band=(0.1, 1.0), duration=60.0), "it ends at 60,"),
        (lambda: design.step_width(0.0), "positive number"),
        (lambda: design.step_width(1.0, "doublets"), "Did you mean 'doublet'"),  # type: ignore[arg-type]
        (lambda: design.step_width(table_of(np.array([-1.0 + 0j]))[0]), "does not oscillate"),
        (lambda: design.peak_factor([1.0, 1.0]), "does not move"),
    ],
)
def test_what_cannot_be_is_refused_in_words(make: Any, says: str) -> None:
    with pytest.raises(ph.OptionError, match=says):
        make()
