"""Empirical frequency responses against true ones: of a simulated system, and what a real record is known to hold."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from scipy import signal

import phugoid as ph
from phugoid.linear.frequency import find_period
from phugoid.linear.response import plot_frequency_response

F16 = "f16_gvt_full_multisine_level1.csv.gz"

RATE, N = 100.0, 20000
B, A = signal.iirpeak(8.0, 10.0, fs=RATE)  # a resonance at 8 Hz, 0.8 Hz wide
B = 3.0 * B + 0.5 * np.array([1.0, -1.0, 0.0])


def true(f: np.ndarray) -> np.ndarray:
    return signal.freqz(B, A, f, fs=RATE)[1]


def random_run(noise: float = 0.02, n: int = N, seed: int = 0) -> ph.Experiment:
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(n)
    y = signal.lfilter(B, A, u) + noise * rng.standard_normal(n)
    t = np.arange(n) / RATE
    return ph.Experiment(t, {"u": u + 5.0}, {"y": y - 2.0}, name="shake", units={"u": "N", "y": "m/s²"})


def multisine(periods: int, length: int = 500, noise: float = 0.02) -> ph.Experiment:
    """Lines at 1 to 20 Hz; the record begins at rest."""
    rng = np.random.default_rng(5)
    k = np.arange(5, 101)
    one = np.cos(2 * np.pi * np.outer(np.arange(length), k) / length + rng.uniform(0, 6.28, k.size)).sum(axis=1)
    u = np.tile(one, periods)
    y = signal.lfilter(B, A, u)
    y += noise * y.std() * rng.standard_normal(y.size)
    return ph.Experiment(np.arange(u.size) / RATE, {"u": u}, {"y": y}, name="sines")


def relative(found: ph.results.FrequencyResponse) -> np.ndarray:
    return np.abs(found.response / true(found.frequencies_hz) - 1.0)


def test_h1_is_the_true_response_within_its_standard_errors() -> None:
    got = ph.linear.frequency_response(random_run(0.3), "u", "y", "h1", segment=1000)
    assert got.frequencies_hz[0] == pytest.approx(0.1) and got.unit == "m/s²/N"
    off = np.abs(got.response) - np.abs(true(got.frequencies_hz))
    inner = got.frequencies_hz > 1.0
    z = (off / got.std_error)[inner]
    assert 0.8 < np.sqrt(np.mean(z**2)) < 1.25
    assert np.median(relative(got.band(6, 10))) < 0.05
    assert got.label == "H1, segments of 1000 samples"


def test_h1_is_scipys() -> None:
    data = random_run()
    got = ph.linear.frequency_response(data, "u", "y", "h1", segment=512, floor_db=-200)
    f, suy = signal.csd(data.input("u"), data.output("y"), fs=RATE, nperseg=512)
    _, suu = signal.welch(data.input("u"), fs=RATE, nperseg=512)
    np.testing.assert_allclose(got.response, (suy / suu)[1:], rtol=1e-9)
    _, coherence = signal.coherence(data.input("u"), data.output("y"), fs=RATE, nperseg=512)
    np.testing.assert_allclose(got.coherence[5:], coherence[6:], rtol=1e-6)


def test_coherence_falls_with_noise() -> None:
    quiet, loud = (
        ph.linear.frequency_response(random_run(s), "u", "y", "h1").band(20, 40).coherence for s in (0.01, 1.0)
    )
    assert np.median(quiet) > 0.99 > 0.5 > np.median(loud)


def test_the_etfe_is_the_ratio_of_transforms() -> None:
    data = random_run(n=3000)
    got = ph.linear.frequency_response(data, "u", "y", floor_db=-300)
    u, y = (np.fft.rfft(z - z.mean()) for z in (data.input("u"), data.output("y")))
    np.testing.assert_allclose(got.response, (y / u)[1:], rtol=1e-9)
    np.testing.assert_allclose(got.frequencies_hz, np.fft.rfftfreq(3000, 0.01)[1:])
    assert got.coherence is None and got.std_error is None


def test_smoothing_brings_the_etfe_to_the_true_response() -> None:
    data = random_run(0.3)
    rough = ph.linear.frequency_response(data, "u", "y", band=(1, 45))
    smooth = ph.linear.frequency_response(data, "u", "y", smoothing=0.3, band=(1, 45))
    assert np.median(relative(smooth)) < 0.2 * np.median(relative(rough))
    z = (np.abs(smooth.response) - np.abs(true(smooth.frequencies_hz))) / smooth.std_error
    assert 0.8 < np.sqrt(np.mean(z**2)) < 1.3


def test_over_periods_there_is_no_leakage() -> None:
    for method in ("etfe", "h1"):
        clean = ph.linear.frequency_response(multisine(4, noise=0.0).window(5.0, 20.0), "u", "y", method, period=500)
        np.testing.assert_allclose(clean.frequencies_hz, np.arange(5, 101) / 5.0)
        assert relative(clean).max() < 1e-5  # all that is left is the transient of the first second


def test_the_last_whole_periods_are_used() -> None:
    """The transient lies in what is left over at the start: with 2.6 periods, 0.6 of one."""
    whole = multisine(3, noise=0.0)
    cut = whole.window(2.0, 15.0)
    assert relative(ph.linear.frequency_response(cut, "u", "y", period=500)).max() < 1e-3
    assert relative(ph.linear.frequency_response(whole, "u", "y", period=500)).max() > 1e-3


def test_periods_give_standard_errors() -> None:
    got = ph.linear.frequency_response(multisine(40).window(5.0, 200.0), "u", "y", period="auto")
    assert got.label == "ETFE, 39 periods of 500 samples"
    z = (np.abs(got.response) - np.abs(true(got.frequencies_hz))) / got.std_error
    assert 0.7 < np.sqrt(np.mean(z**2)) < 1.4


def test_the_period_is_the_shortest() -> None:
    assert find_period(multisine(9).input("u")) == 500
    t = np.arange(3000)
    assert find_period(np.sin(2 * np.pi * t / 41)) == 41


def test_filtered_records_have_the_same_response() -> None:
    data = random_run(0.0).band_pass(5, 12)
    assert relative(ph.linear.frequency_response(data, "u", "y", "h1", segment=2000, band=(5.5, 11.5))).max() < 0.05


def test_frequencies_without_input_are_left_out() -> None:
    got = ph.linear.frequency_response(random_run().band_pass(5, 12), "u", "y", "h1")
    assert 2.0 < got.frequencies_hz[0] < 5.0 and 12.0 < got.frequencies_hz[-1] < 30.0


def test_a_finer_input_is_taken_at_the_samples_of_the_output() -> None:
    data = random_run(0.0).low_pass(10).decimate(2, inputs=1)
    plain = random_run(0.0).low_pass(10).decimate(2)
    a, b = (ph.linear.frequency_response(d, "u", "y", "h1", segment=1000).response for d in (data, plain))
    np.testing.assert_array_equal(a, b)


# What is refused


@pytest.mark.parametrize(
    ("options", "kind", "words"),
    [
        ({"input": "U"}, ph.DataError, "experiment 'shake' has no input 'U'. Did you mean 'u'?"),
        ({"output": "u"}, ph.DataError, "It is there as an input"),
        ({"method": "h2"}, ph.OptionError, "method is 'etfe' or 'h1', not 'h2'"),
        ({"smoothing": 1.0, "method": "h1"}, ph.OptionError, "smoothing is for the ETFE"),
        ({"smoothing": 1.0, "period": 100}, ph.OptionError, "smoothing is for the ETFE"),
        ({"smoothing": 1e-3}, ph.OptionError, "'shake' shows 10001 frequencies, 0.005 apart; take at least 0.01"),
        ({"smoothing": -1}, ph.OptionError, "smoothing is a positive number, not -1"),
        ({"segment": 100}, ph.OptionError, "segment is for 'h1'"),
        ({"segment": 30000, "method": "h1"}, ph.DataError, "20000 samples are too few for segments of 30000"),
        ({"period": 1}, ph.OptionError, "period is a whole number from 2, not 1"),
        ({"period": 30000}, ph.DataError, "a period of 30000 samples is longer than the record of 20000"),
        ({"period": "auto"}, ph.DataError, "experiment 'shake', input 'u': does not repeat within half the record"),
        ({"band": (60, 70)}, ph.DataError, "no frequency lies between 60 and 70; they run from 0.005 to 50 Hz"),
    ],
)
def test_what_cannot_be(options: dict, kind: type, words: str) -> None:
    with pytest.raises(kind) as error:
        ph.linear.frequency_response(random_run(), **{"input": "u", "output": "y", **options})
    assert words in str(error.value)


def test_gaps_uneven_times_and_dead_inputs_are_refused() -> None:
    t, u = np.arange(100) / RATE, np.sin(np.arange(100.0))
    holed = np.where(np.arange(100) == 7, np.nan, u)
    for data, words in (
        (
            ph.Experiment(t, {"u": u}, {"y": holed}),
            r"output 'y': frequency_response needs a complete channel, but sample 7",
        ),
        (ph.Experiment(t**1.1, {"u": u}, {"y": u}), r"input 'u': frequency_response needs evenly spaced samples"),
        (ph.Experiment(t, {"u": np.ones(100)}, {"y": u}), r"input 'u': is constant"),
        (ph.multirate({"u": (t[::3], u[::3])}, {"y": (t, u)}), r"input 'u': is sampled more coarsely than output 'y'"),
    ):
        with pytest.raises(ph.DataError, match=words):
            ph.linear.frequency_response(data, "u", "y")


def test_a_response_checks_its_arrays() -> None:
    f, g = np.array([1.0, 2.0]), np.array([1.0, 1j])
    for wrong in (
        {"frequencies_hz": f[::-1]},
        {"frequencies_hz": -f},
        {"response": g[:1]},
        {"coherence": np.ones(3)},
    ):
        with pytest.raises(ph.DataError, match="frequency response u to y"):
            ph.results.FrequencyResponse(**{"frequencies_hz": f, "response": g, "input": "u", "output": "y", **wrong})
    with pytest.raises(ValueError, match="read-only"):
        ph.results.FrequencyResponse(f, g, "u", "y").response[0] = 0


# The figure


def test_the_figure_shows_points_and_lines_in_dB() -> None:
    got = ph.linear.frequency_response(multisine(4), "u", "y", period=500)
    f = np.linspace(0.5, 30, 400)
    model = ph.results.FrequencyResponse(f, true(f), "u", "y", "model")
    figure, axes = got.plot(model, phase=True, coherence=True)
    assert list(axes) == ["magnitude", "phase", "coherence"]
    lines = {line.get_label(): line for line in axes["magnitude"].get_lines()}
    np.testing.assert_allclose(lines["model"].get_ydata(), 20 * np.log10(np.abs(true(f))))
    np.testing.assert_allclose(lines[got.label].get_ydata(), got.magnitude_db)
    assert axes["magnitude"].get_xlim() == pytest.approx((1.0, 20.0))
    assert [a.get_xlabel() for a in axes.values()] == ["", "", "frequency, Hz"]
    figure.canvas.draw()
    boxes = [t.get_window_extent() for t in (figure.texts[0], figure.legends[0])]
    assert not boxes[0].overlaps(boxes[1]) and boxes[1].y0 > axes["magnitude"].get_window_extent().y1
    matplotlib.pyplot.close(figure)


def test_no_line_bridges_frequencies_that_are_not_there() -> None:
    f = np.r_[1.0:5.0:0.1, 9.0:12.0:0.1]
    figure, axes = ph.results.FrequencyResponse(f, np.ones(f.size), "u", "y", "e").plot()
    (line,) = axes["magnitude"].get_lines()
    assert np.isnan(line.get_ydata()).sum() == 1
    matplotlib.pyplot.close(figure)


def test_figures_of_what_does_not_belong_together_are_refused() -> None:
    f, g = np.array([1.0, 2.0]), np.array([1.0, 1j])
    one, other = ph.results.FrequencyResponse(f, g, "u", "y", "a"), ph.results.FrequencyResponse(f, g, "u", "z", "b")
    with pytest.raises(ph.DataError, match="'b' is the response of z to u, and 'a' that of y to u"):
        plot_frequency_response(one, other)
    with pytest.raises(ph.DataError, match="'a' has no coherence"):
        plot_frequency_response(one, coherence=True)


# The ground vibration test of an F-16 (Noël and Schoukens, Nonlinear System Identification Benchmarks, 2017)


def test_the_f16_has_its_resonances(published: Callable[[str], Path]) -> None:
    data = ph.read(published(F16), rate=400.0, inputs=["Force"], outputs=["Acceleration1", "Acceleration2"])
    assert (data.n, data.t[-1]) == (73728, pytest.approx(73727 / 400))
    got = ph.linear.frequency_response(data, "Force", "Acceleration2", period="auto", band=(1, 20))
    assert got.label == "ETFE, 9 periods of 8192 samples"
    # The multisine has all lines from 2 to 15 Hz.
    np.testing.assert_allclose(got.frequencies_hz, np.arange(41, 308) * 400 / 8192)
    assert np.median(got.coherence) > 0.999
    peaks = got.frequencies_hz[signal.find_peaks(got.magnitude_db, prominence=6)[0]]
    np.testing.assert_allclose(peaks, [3.47, 3.96, 5.18, 6.59, 7.32, 9.18], atol=0.06)
    h1 = ph.linear.frequency_response(data, "Force", "Acceleration2", "h1", segment=8192, band=(2, 15))
    np.testing.assert_allclose(h1.frequencies_hz[signal.find_peaks(h1.magnitude_db, prominence=6)[0]], peaks, atol=0.06)
