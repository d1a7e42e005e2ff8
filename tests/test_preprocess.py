"""Steps before estimation: filters, trends and rates are scipy's, are remembered, and refuse what they cannot do."""

from __future__ import annotations

import pickle
import warnings

import numpy as np
import pytest
from scipy import signal

from phugoid import DataError, Experiment, OptionError, multirate

RATE = 200.0
N = 2000
T = 5.0 + np.arange(N) / RATE


def noise(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(N)


def run(**options: object) -> Experiment:
    u, y = noise(1), noise(2) + 3.0
    return Experiment(T, {"force": u}, {"ax": y}, name="shake", units={"ax": "m/s²"}, **options)


def tone(frequency: float) -> np.ndarray:
    return np.sin(2 * np.pi * frequency * T)


# Filters


@pytest.mark.parametrize("zero_phase", [False, True])
@pytest.mark.parametrize(
    ("method", "corners", "kinds"),
    [
        ("band_pass", (6.0, 32.0), [("highpass", 6.0), ("lowpass", 32.0)]),
        ("low_pass", (20.0,), [("lowpass", 20.0)]),
        ("high_pass", (2.0,), [("highpass", 2.0)]),
    ],
)
def test_filters_are_scipys(method: str, corners: tuple[float, ...], kinds: list, zero_phase: bool) -> None:
    data = run()
    got = getattr(data, method)(*corners, order=4, zero_phase=zero_phase)
    for name, values in (("force", data.input("force")), ("ax", data.output("ax"))):
        expected = values
        for kind, corner in kinds:
            sos = signal.butter(4, corner, kind, fs=RATE, output="sos")
            if zero_phase:
                continue
            expected, _ = signal.sosfilt(sos, expected, zi=signal.sosfilt_zi(sos) * expected[0])
        if zero_phase:
            whole = np.vstack([signal.butter(4, corner, kind, fs=RATE, output="sos") for kind, corner in kinds])
            expected = signal.sosfiltfilt(whole, values)
        found = got.input(name) if name == "force" else got.output(name)
        np.testing.assert_allclose(found, expected, atol=1e-10)
    assert got.units == {"ax": "m/s²"} and got.name == "shake"
    np.testing.assert_array_equal(got.t, T)


def test_a_band_passes_what_lies_in_it() -> None:
    data = Experiment(T, {}, {name: tone(f) for name, f in (("slow", 0.5), ("kept", 14.0), ("fast", 80.0))})
    late = data.band_pass(6.0, 32.0).window(10.0, 15.0)
    size = {name: np.sqrt(2.0) * late.output(name).std() for name in ("slow", "kept", "fast")}
    assert size["kept"] == pytest.approx(1.0, abs=0.01)
    assert size["slow"] < 1e-4 and size["fast"] < 0.01


def test_the_corners_lose_3_dB_and_6_forward_and_backward() -> None:
    data = Experiment(T, {}, {"y": tone(20.0)})
    for zero_phase, gain in ((False, 0.5**0.5), (True, 0.5)):
        late = data.low_pass(20.0, zero_phase=zero_phase).window(8.0, 12.0)
        assert np.sqrt(2.0) * late.output("y").std() == pytest.approx(gain, rel=2e-3)


def test_a_record_at_rest_has_no_transient() -> None:
    still = Experiment(T, {"u": np.full(N, 7.0)}, {"y": np.full(N, -2.0)})
    np.testing.assert_allclose(still.low_pass(10.0).output("y"), -2.0, rtol=1e-9)
    np.testing.assert_allclose(still.band_pass(2.0, 10.0).input("u"), 0.0, atol=1e-9)


def test_channels_left_out_stay() -> None:
    data = run()
    got = data.low_pass(10.0, channels=["ax"])
    np.testing.assert_array_equal(got.input("force"), data.input("force"))
    assert not np.allclose(got.output("ax"), data.output("ax"))


def test_columns_not_told_apart_are_filtered() -> None:
    data = Experiment(T, channels={"a": noise()})
    expected = Experiment(T, {"a": noise()}).low_pass(10.0).input("a")
    np.testing.assert_array_equal(data.low_pass(10.0).output("a"), expected)


# Trends


def test_mean_and_line_are_removed_with_samples_missing_and_times_uneven() -> None:
    t = np.sort(np.random.default_rng(3).uniform(0.0, 10.0, 50))
    y = 3.0 - 2.0 * t
    y[[4, 30]] = np.nan
    data = Experiment(t, {"u": 1.0 + np.sin(t)}, {"y": y})
    line = data.detrend("linear")
    np.testing.assert_allclose(line.output("y")[np.isfinite(y)], 0.0, atol=1e-12)
    assert np.isnan(line.output("y")[[4, 30]]).all()
    constant = data.detrend()
    assert constant.input("u").mean() == pytest.approx(0.0, abs=1e-14)
    np.testing.assert_allclose(constant.output("y"), y - np.nanmean(y), atol=1e-12)


def test_the_trend_of_a_window_is_that_of_the_window() -> None:
    """Though an input's own samples reach beyond it."""
    data = Experiment(T, {"u": T**2}, {"y": T**2}).decimate(20, 5).window(6.0, 7.0).detrend()
    t, u = data.samples("u")
    inside = (t >= 6.0 - 1e-9) & (t <= 7.0 + 1e-9)
    assert t.size > inside.sum()
    assert u[inside].mean() == pytest.approx(0.0, abs=1e-10)
    assert data.output("y").mean() == pytest.approx(0.0, abs=1e-10)


# Rates


def test_decimation_takes_every_so_many_th_sample_and_inputs_finer() -> None:
    u, y = tone(1.0), tone(1.3)
    data = Experiment(T, {"u": u}, {"y": y}).decimate(20, inputs=5)
    np.testing.assert_array_equal(data.t, T[::20])
    np.testing.assert_array_equal(data.output("y"), y[::20])
    np.testing.assert_array_equal(data.input("u"), u[::20])
    times, values = data.samples("u")
    np.testing.assert_array_equal(times, T[::5])
    np.testing.assert_array_equal(values, u[::5])
    assert data.interpolation == "cubic"
    plain = Experiment(T, {"u": u}, {"y": y}).decimate(20)
    assert plain.interpolation == "linear" and plain.signal("u") is None


def test_what_would_be_folded_is_said_with_channel_and_share() -> None:
    # 1.0 and 0.5 in amplitude: a fifth of the power lies at 30 Hz, above the new Nyquist frequency of 10 Hz.
    data = Experiment(T, {"u": tone(1.0)}, {"y": tone(1.0) + 0.5 * tone(30.0)}, name="shake")
    with pytest.warns(UserWarning, match=r"'shake'.* 20 % of the power of y above 10 .*low_pass"):
        folded = data.decimate(10)
    assert "20 % of the power of y" in folded.history[-1]


@pytest.mark.parametrize("factor", [1, 10])
def test_what_is_band_limited_is_decimated_without_a_word(factor: int) -> None:
    drift = 100.0 * (T - T[0]) ** 2 + 50.0 * np.exp(-T)  # ends differ: leakage is not content
    data = Experiment(T, {"u": np.zeros(N)}, {"y": tone(3.0) + drift})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        data.decimate(factor)
        run().low_pass(5.0).decimate(10)


def test_inputs_are_judged_at_their_own_rate() -> None:
    data = Experiment(T, {"u": tone(30.0)}, {"y": tone(1.0)})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        data.decimate(10, inputs=2)
    with pytest.warns(UserWarning, match="of u above 20"):
        data.decimate(10, inputs=5)


def test_decimation_with_its_filter_is_scipys() -> None:
    data = run()
    got = data.decimate(10, filter=True)
    sos = signal.cheby1(8, 0.05, 0.8 / 10, output="sos")
    y = data.output("ax")
    expected, _ = signal.sosfilt(sos, y, zi=signal.sosfilt_zi(sos) * y[0])
    np.testing.assert_allclose(got.output("ax"), expected[::10], atol=1e-10)


def test_resampling_keeps_the_band_and_drops_what_is_above() -> None:
    """To 70 Hz from 200: of tones at 10 and 60 Hz the first is left, at the new times."""
    data = Experiment(T, {"u": tone(10.0)}, {"y": tone(10.0) + tone(60.0)}).resample(70.0)
    assert data.t[0] == T[0] and data.t[-1] <= T[-1] < data.t[-1] + 1 / 70.0
    np.testing.assert_allclose(np.diff(data.t), 1 / 70.0, rtol=1e-6)
    middle = slice(30, -30)
    wanted = np.sin(2 * np.pi * 10.0 * data.t)
    np.testing.assert_allclose(data.input("u")[middle], wanted[middle], atol=1e-3)
    np.testing.assert_allclose(data.output("y")[middle], wanted[middle], atol=1e-3)


@pytest.mark.parametrize("share", [0.1, 0.32, 0.43])
def test_upsampled_inputs_are_true_far_up_to_the_nyquist_frequency(share: float) -> None:
    """A tone at a share of the sampling rate, between samples; straight lines lose 30 % of it at 0.32."""
    k = np.arange(300)
    u = np.sin(2 * np.pi * share * k)
    data = Experiment(k / 50.0, {"u": u}, {"y": u}).upsample_inputs(4)
    times, values = data.samples("u")
    np.testing.assert_array_equal(values[::4], u)
    assert values.size == 4 * 299 + 1
    middle = slice(100, -100)
    np.testing.assert_allclose(values[middle], np.sin(2 * np.pi * share * 50.0 * times)[middle], atol=1e-3)
    assert data.interpolation == "cubic" and data.n == 300


def test_a_filter_reaches_the_inputs_own_samples() -> None:
    u = tone(1.0) + tone(12.0)
    with pytest.warns(UserWarning, match="50 % of the power of y"):
        data = Experiment(T, {"u": u}, {"y": u}).decimate(20, inputs=5)
    with pytest.warns(UserWarning, match=r"output 'y' is sampled at a rate of 10, .*'u' at 40:.*before \.decimate"):
        data.low_pass(4.0)
    got = data.low_pass(4.0, channels=["u"])
    expected = Experiment(T[::5], {"u": u[::5]}).low_pass(4.0).input("u")
    np.testing.assert_array_equal(got.samples("u")[1], expected)
    np.testing.assert_array_equal(got.input("u"), expected[::4])


# The record of what was done


def test_history_says_each_step_in_order_and_lasts() -> None:
    data = run()
    assert data.history == ()
    done = data.band_pass(6, 32).decimate(1).detrend("linear", ["ax"])
    assert done.history == (
        "band-pass 6 to 32, Butterworth of order 5 twice (high-pass, low-pass), causal, settles in 0.4: force, ax",
        "decimated by 1 to 200",
        "straight line removed: ax",
    )
    assert data.history == ()
    later = pickle.loads(pickle.dumps(done)).window(6.0, 10.0).rename({"ax": "a"}).with_outputs({"a": T[200:1001]})
    assert later.history == (*done.history, "window 6 to 10", "renamed ax to a", "outputs replaced: a")


def test_the_settling_time_is_when_a_step_has_died() -> None:
    data = Experiment(T, {}, {"y": np.where(T > 5.0, 1.0, 0.0)})
    done = data.high_pass(1.0)
    wait = float(done.history[0].split("settles in ")[1].split(":")[0])
    begin, early = (int(share * wait * RATE) for share in (1.2, 0.5))
    assert np.abs(done.output("y")[begin:]).max() < 0.02 < np.abs(done.output("y")[early:]).max()


# What is refused


def gap() -> Experiment:
    y = noise()
    y[[70, 90]] = np.nan
    return Experiment(T, {"force": noise()}, {"ax": y}, name="shake")


def uneven() -> Experiment:
    keep = np.r_[0:500, 510:N]
    return Experiment(T[keep], {"force": noise()[keep]}, {"ax": noise()[keep]}, name="shake")


@pytest.mark.parametrize(
    ("step", "words"),
    [
        (lambda d: d.band_pass(32, 6), "low (32) must lie below high (6)"),
        (lambda d: d.band_pass(6, 6), "low (6) must lie below high (6)"),
        (lambda d: d.band_pass(6, 100), "band_pass: 100 is not below the Nyquist frequency 100"),
        (lambda d: d.low_pass(-1), "low_pass: the corner frequency is a positive number, not -1"),
        (lambda d: d.low_pass("x"), "is a positive number, not 'x'"),
        (lambda d: d.high_pass(5, order=0), "high_pass: order is a whole number from 1, not 0"),
        (lambda d: d.detrend("cubic"), "detrend: kind is 'constant' or 'linear', not 'cubic'"),
        (lambda d: d.decimate(0), "decimate: factor is a whole number from 1, not 0"),
        (lambda d: d.decimate(2.5), "decimate: factor is a whole number from 1, not 2.5"),
        (lambda d: d.decimate(20, inputs=3), "inputs=3 must divide the factor 20"),
        (lambda d: d.decimate(N), "of the 2000 samples of experiment 'shake' a factor of 2000 leaves one"),
        (lambda d: d.low_pass(5).decimate(4, 1).decimate(4, 1), "the input 'force' of experiment 'shake' has samples"),
        (lambda d: d.low_pass(5).decimate(4, 1).resample(20), "'force' of experiment 'shake' has samples of its own"),
        (lambda d: d.resample(400), "upsample_inputs"),
        (lambda d: d.resample(0.7311), "is not a simple fraction of the rate 200"),
        (lambda d: d.upsample_inputs(1), "upsample_inputs: factor is a whole number from 2, not 1"),
    ],
)
def test_options_that_cannot_be(step, words: str) -> None:
    with pytest.raises(OptionError) as error:
        step(run())
    assert words in str(error.value)


@pytest.mark.parametrize(
    ("step", "words"),
    [
        (lambda: run().low_pass(5, channels=["Ax"]), "experiment 'shake' has no channel 'Ax'. Did you mean 'ax'?"),
        (lambda: run().detrend(channels="ax"), "channels='ax' is text: give a list"),
        (lambda: run().detrend(channels=[]), "channels is empty"),
        (
            lambda: gap().low_pass(5),
            "'shake', output 'ax': low_pass needs a complete channel, but sample 70 (t = 5.35)",
        ),
        (lambda: gap().resample(20), "output 'ax': resample needs a complete channel, but sample 70 (t = 5.35)"),
        (
            lambda: uneven().band_pass(5, 9),
            "input 'force': band_pass needs evenly spaced samples, but the interval after",
        ),
        (lambda: uneven().decimate(2), "the interval after t = 7.495 is 0.055 and others are 0.005"),
        (lambda: run().window(5, 5.1).high_pass(0.1), "input 'force': the record is 0.1 long (21 samples), but this"),
        (lambda: run().window(5, 5.1).low_pass(50, zero_phase=True), "needs 0.105 to settle"),
        (lambda: run().window(5, 5.05).upsample_inputs(2), "has 11 samples, too few to resample: at least 21"),
        (lambda: Experiment(T, {}, {"y": noise()}).upsample_inputs(2), "upsample_inputs finds no inputs"),
        (lambda: Experiment(T).detrend(), "has no channels"),
    ],
)
def test_records_that_cannot_be(step, words: str) -> None:
    with pytest.raises(DataError) as error:
        step()
    assert words in str(error.value)


def test_the_channel_with_gaps_may_be_left_out() -> None:
    assert "force" in gap().low_pass(5, channels=["force"]).history[0]


def test_channels_at_times_of_their_own_are_refused_by_name() -> None:
    data = multirate({"u": (T, noise())}, {"y": (T, noise()), "slow": (T[::4], noise()[::4])})
    with pytest.raises(
        DataError, match=r"output 'slow': low_pass needs a complete channel, but sample 1 \(t = 5.005\)"
    ):
        data.low_pass(5)


def test_an_input_with_a_gap_in_its_own_samples_is_not_estimated_from() -> None:
    u = np.zeros(N)
    u[33] = np.nan
    data = Experiment(T, channels={"u": u, "y": noise()}).low_pass(5, channels=["y"]).decimate(10, inputs=1)
    with pytest.raises(DataError, match=r"input 'u': sample 33 \(t = 5.165\) is nan"):
        data.check_for(["u"], ["y"])
