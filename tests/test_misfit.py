"""The misfit of a fit: what is said of residuals whose structure is known, and of those that have none."""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections import Counter
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import attas
import hfb320
import numpy as np
import pytest
from matplotlib import pyplot as plt
from records import find
from scipy.signal import lfilter

import phugoid as ph
from phugoid.discrepancy.misfit import ChannelMisfit
from phugoid.discrepancy.misfit.misfit import misfit
from phugoid.errors import DataError, UnknownName
from phugoid.modelling.declared import rebuilt
from phugoid.records import Record
from phugoid.residual_noise.autoregression import burg, spectrum_of

N, DT = 600, 0.1
T = DT * np.arange(N)


def record(name: str = "run", n: int = N, **residuals: Any) -> Record:
    """A 3-2-1-1 and the answer of something like a short period; the residuals are given."""
    t = DT * np.arange(n)
    de = np.zeros(n)
    for begin, end, size in ((20, 50, 1), (50, 70, -1), (70, 80, 1), (80, 90, -1), (250, 270, 1), (400, 440, -1)):
        de[begin:end] = 0.01 * size
    q = lfilter([0.1], [1, -1.7, 0.78], de)
    return Record(
        name=name,
        t=t,
        inputs={"de": de},
        outputs={k: np.zeros(n) for k in residuals},
        states={"q": q, "alpha": lfilter([0.1], [1, -0.95], q)},
        residuals=residuals,
        units={"az": "m/s²", "q": "rad/s"},
    )


def fit(*records: Record) -> Any:
    names = tuple(records[0].residuals)
    return SimpleNamespace(records=records, converged=True, model=SimpleNamespace(output_names=names, units={}))


def channel(az: Any, **more: Any) -> ChannelMisfit:
    return misfit(fit(dataclasses.replace(record(n=len(az), az=az), **more))).channels["az"]


def white(seed: int = 0, n: int = N) -> Any:
    return np.random.default_rng(seed).standard_normal(n)


def coloured(seed: int, pole: float, n: int = N) -> Any:
    return lfilter([1], [1, -pole], white(seed, n + 300))[300:]


def claims(c: ChannelMisfit) -> list[str]:
    said = {
        "colour": c.coloured,
        "bias": c.biased,
        "span": c.spans,
        "tone": c.tones,
        "regime": c.regime,
        "follows": c.follows,
    }
    return [kind for kind, value in said.items() if value]


def test_of_white_noise_nothing_is_claimed() -> None:
    said: Counter[str] = Counter()
    for seed in range(50):
        found = misfit(fit(record(x=white(3 * seed), y=white(3 * seed + 1), z=white(3 * seed + 2))))
        for c in found.channels.values():
            said.update(claims(c))
            assert c.ratio == pytest.approx(1.0, abs=0.05)
    # 6 kinds of claims at 0.001 for 150 channels: 0.9 are expected, and 5 or more have a chance of 0.003.
    assert sum(said.values()) <= 4, said


@pytest.mark.parametrize("pole", [0.5, 0.9, 0.97])
def test_of_coloured_noise_only_the_colour_is_claimed(pole: float) -> None:
    said: Counter[str] = Counter()
    for seed in range(40):
        c = channel(coloured(seed, pole))
        said.update(claims(c))
        # A first-order process of unit innovations.
        assert c.noise == pytest.approx(1.0, abs=0.12)
    assert said.pop("colour") == 40
    assert sum(said.values()) <= 3, said


def test_nothing_found_is_said_so() -> None:
    c = channel(white())
    assert not c.structured
    assert c.summary() == "az: residual 1 m/s², equal to its noise; no structure found"


def test_a_burst_is_found_at_its_time() -> None:
    burst = 4 * np.sin(2 * np.pi * (T - 30) / 3) * ((T >= 30) & (T < 33))
    c = channel(white() + burst)
    (span,) = c.spans
    assert span.experiment == "run"
    assert 29.0 <= span.start <= 30.6 and 32.4 <= span.end <= 34.5
    assert span.times > 2.0
    assert f"strongest from {span.start:.1f} to {span.end:.1f} s" in c.summary()


def test_outliers_are_no_burst_and_told_of() -> None:
    r = white()
    r[[100, 300]] = 40.0, -1e6
    c = channel(r)
    assert not c.structured and c.rms < 1.2
    assert c.notes == ("az has 2 outliers, the first at 10 s of 'run', which are left out here",)


def test_heavy_tails_are_no_bursts() -> None:
    said = [channel(np.random.default_rng(seed).standard_t(4, N)).spans for seed in range(40)]
    assert sum(map(bool, said)) <= 4


def test_an_effect_in_one_regime_is_found_there() -> None:
    q = record(az=white()).states["q"]
    threshold = 0.4 * q.max()
    c = channel(white() + 2.0 * (q > threshold))
    assert c.regime is not None and c.regime.variable == "q"
    out = [b for b in c.regime.bins if b.stands_out]
    assert out and all(b.high > threshold for b in out)
    assert max(b.mean for b in out) == pytest.approx(2.0, abs=0.6)
    assert "biased where q > " in c.summary()


def test_standard_error_of_a_bin_counts_blocks_of_like_samples() -> None:
    """Means of bins of residuals with a pole at 0.9 scatter as their standard errors say, far more than white ones."""
    z, naive = [], []
    for seed in range(60):
        regime = next(r for r in channel(coloured(seed, 0.9)).regimes if r.variable == "alpha")
        for b in regime.bins:
            z.append(b.mean / b.std_error)
            naive.append(b.mean / (2.29 / math.sqrt(b.n)))
    assert 0.8 < np.std(z) < 1.25
    assert np.std(naive) > 2.0


@pytest.mark.parametrize(("frequency", "amplitude"), [(1.5, 0.5), (0.3, 1.0), (4.2, 0.6), (2.07, 3.0)])
def test_a_tone_is_found_at_its_frequency(frequency: float, amplitude: float) -> None:
    c = channel(white() + amplitude * np.sin(2 * np.pi * frequency * T + 0.4))
    assert c.tones and c.tones[0].frequency == pytest.approx(frequency, abs=0.005)
    assert c.tones[0].amplitude == pytest.approx(amplitude, rel=0.3)
    assert "a tone at" in c.summary()


def test_a_tone_is_found_in_coloured_noise() -> None:
    c = channel(coloured(2, 0.95) + 1.0 * np.sin(2 * np.pi * 2.5 * T))
    assert [round(tone.frequency, 1) for tone in c.tones] == [2.5]


def test_slow_residuals_are_called_slow() -> None:
    c = channel(coloured(1, 0.95))
    assert c.spectrum is not None and c.spectrum.most_below < 0.6
    assert "slow, 80 % of its power below" in c.summary()


def test_spectrum_has_the_power_of_the_residuals() -> None:
    """By Parseval's theorem; a gap does not make them quieter."""
    r = white(n=4000)
    for gap in (0, 1200):
        r[1000 : 1000 + gap] = np.nan
        c = channel(r)
        assert c.spectrum is not None
        step = c.spectrum.frequency[1] - c.spectrum.frequency[0]
        assert c.spectrum.density.sum() * step == pytest.approx(c.rms**2, rel=0.1)
        assert c.spectrum.level == pytest.approx(2.0 * DT, rel=0.1)


def test_what_residuals_follow_is_named_with_its_sign() -> None:
    q = record(az=white()).states["q"]
    up, down = channel(white() + q / q.std()), channel(white() - q / q.std())
    assert up.follows is not None and up.follows.variable == "q"
    assert up.follows.r == pytest.approx(math.sqrt(0.5), abs=0.08)
    assert "correlated with q (r = 0.6" in up.summary() or "correlated with q (r = 0.7" in up.summary()
    assert down.follows is not None and down.follows.r < 0 and "correlated with q (r = -0" in down.summary()


def test_slow_series_have_few_effective_samples() -> None:
    def effective(r: Any) -> float:
        return next(c.n_effective for c in channel(r).correlations if c.variable == "alpha")

    assert effective(white()) > 400
    assert effective(coloured(0, 0.97)) < 60


def test_a_bias_is_told_once() -> None:
    c = channel(white() + 0.4)
    assert c.biased and c.mean == pytest.approx(0.4, abs=0.12)
    assert c.regime is None and c.follows is None


@pytest.mark.parametrize("coefficients", [[0.9], [1.6, -0.8], [0.5, 0.0, 0.3]])
def test_noise_is_what_cannot_be_predicted(coefficients: list[float]) -> None:
    r = lfilter([0.3], [1, *(-a for a in coefficients)], white(5, 5000))
    model = burg([r])
    assert model.deviation([r]) == pytest.approx(0.3, rel=0.04)
    assert model.coefficients[: len(coefficients)] == pytest.approx(coefficients, abs=0.06)


def test_noise_beneath_a_slow_misfit() -> None:
    """White noise of 0.1 under a wave of 1: an AR model of 12 lags comes near to it."""
    c = channel(0.1 * white() + np.sin(2 * np.pi * 0.05 * T))
    assert 0.08 < c.noise < 0.16 and c.predictable > 0.95


def test_model_autocorrelation_is_that_of_its_process() -> None:
    model = burg([coloured(0, 0.9, 20_000)])
    assert model.autocorrelation(20) == pytest.approx(model.coefficients[0] ** np.arange(20), abs=0.05)


def test_the_worst_channel_comes_first() -> None:
    found = misfit(fit(record(x=white(0), y=coloured(1, 0.97), z=coloured(2, 0.7))))
    assert found.worst == ("y", "z", "x")
    assert [line.partition(":")[0] for line in found.summary().split("\n")] == ["y", "z", "x"]


def test_gaps_neither_hide_nor_make_structure() -> None:
    r = white(4)
    r[100:160] = np.nan
    r[np.random.default_rng(0).random(N) < 0.2] = np.nan
    quiet = channel(r)
    assert not quiet.structured and quiet.n == int(np.isfinite(r).sum())
    loud = channel(r + 5.0 * ((T >= 40) & (T < 43)))
    assert len(loud.spans) == 1 and abs(loud.spans[0].start - 40.0) < 0.7
    tone = channel(r + 1.5 * np.sin(2 * np.pi * 0.8 * T))
    assert tone.tones[0].frequency == pytest.approx(0.8, abs=0.01)


def test_noise_of_coloured_residuals_with_gaps() -> None:
    r = coloured(0, 0.9)
    r[np.random.default_rng(1).random(N) < 0.3] = np.nan
    assert channel(r).noise == pytest.approx(1.0, abs=0.2)


def test_each_channel_is_seen_at_its_own_rate() -> None:
    slow = white(1) + 1.5 * np.sin(2 * np.pi * 0.8 * T)
    slow[np.arange(N) % 4 != 0] = np.nan
    found = misfit(fit(record(fast=white(0), slow=slow)))
    c = found.channels["slow"]
    assert c.n == 150 and c.lags[1] == pytest.approx(4 * DT)
    assert c.tones[0].frequency == pytest.approx(0.8, abs=0.01)
    assert not found.channels["fast"].structured


def test_an_experiment_that_is_worse_is_named() -> None:
    runs = [record(f"run {k}", 300, az=white(k, 300) * (4 if k == 2 else 1)) for k in range(4)]
    c = misfit(fit(*runs)).channels["az"]
    assert {span.experiment for span in c.spans} == {"run 2"}
    assert "of 'run 2'" in c.summary()
    assert not c.coloured  # louder is not colour


def test_experiments_are_not_joined() -> None:
    """What ends one record and begins the next is not a neighbour."""
    whole = coloured(3, 0.9, 1200)
    parts = [record(f"{k}", 200, az=whole[200 * k : 200 * k + 200]) for k in range(6)]
    assert misfit(fit(*parts)).channels["az"].noise == pytest.approx(1.0, abs=0.1)


def test_other_rates_are_left_out_and_told_of() -> None:
    other = record("b", 200, az=white(1, 200))
    other = dataclasses.replace(other, t=0.02 * np.arange(200))
    c = misfit(fit(record("a", az=white()), other)).channels["az"]
    assert c.lags[1] == pytest.approx(DT)
    assert c.notes == ("az is sampled at another rate in 'b', which is used for spans of large residuals only",)


@pytest.mark.parametrize("n", [3, 12, 29])
def test_short_records_say_that_they_are_short(n: int) -> None:
    c = channel(white(0, n))
    assert math.isnan(c.noise) and not c.structured
    assert c.summary().endswith("too few samples to say more")
    assert c.notes == (f"az has {n} samples: too few to distinguish noise from misfit (30 are needed)",)


def test_middling_records_go_without_regimes() -> None:
    c = channel(white(0, 45))
    assert c.noise > 0 and c.regimes == () and "too few for regimes" in c.notes[0]


def test_channels_that_never_change() -> None:
    found = misfit(fit(record(exact=np.zeros(N), off=np.full(N, 0.3), az=white())))
    assert found.channels["exact"].summary() == "exact: no residual, matched exactly"
    assert found.channels["off"].summary() == "off: residual 0.3, without measurable noise; mean off by 0.3"
    assert not found.channels["az"].structured


def test_variables_that_never_change_are_left_out() -> None:
    c = channel(white(), inputs={"de": np.ones(N)}, states={"q": np.zeros(N)})
    assert c.regimes == () and [x.variable for x in c.correlations] == ["time"]


def test_odd_records_raise_no_warning() -> None:
    rng = np.random.default_rng(0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for n in (2, 5, 30, 31, 61, 64, 100):
            for r in (white(1, n), np.sin(T[:n]), np.round(white(2, n)), np.where(rng.random(n) < 0.4, np.nan, 1.0)):
                if np.isfinite(r).sum() > 1:
                    channel(r)
        channel(white(), t=np.cumsum(rng.exponential(0.1, N)))


def test_a_fit_without_residuals_is_refused() -> None:
    with pytest.raises(DataError, match="no output has two residuals"):
        misfit(fit(record(az=np.full(N, np.nan))))
    with pytest.raises(DataError, match="give a fit, as estimate returns it, not a Record"):
        misfit(record(az=white()))


def test_a_fit_that_is_no_optimum_is_told_of() -> None:
    f = fit(record(az=white()))
    f.converged, f.status = False, "iteration limit"
    assert "Note: the fit is not at an optimum (iteration limit)" in misfit(f).summary()


def test_of_process_noise_innovations_are_looked_at() -> None:
    c = channel(coloured(0, 0.95), innovations={"az": white()})
    assert not c.structured


def test_bands_need_more_than_chance() -> None:
    from phugoid.residual_noise import channel_series

    said = [spectrum_of(channel_series([record(az=white(seed))], "az"), 1e-3).bands for seed in range(40)]
    assert sum(map(bool, said)) <= 1


def test_figure_shows_the_channels_asked_for() -> None:
    f = fit(record("a", az=coloured(0, 0.9), q=white(1)), record("b", 200, az=white(2, 200), q=white(3, 200)))
    found = misfit(f)
    figure, axes = found.plot(["az"])
    assert list(axes) == ["az time a", "az time b", "az autocorrelation", "az spectrum", "az regime"]
    line = next(x for x in axes["az time a"].get_lines() if len(x.get_ydata()) == N)
    np.testing.assert_array_equal(line.get_ydata(), f.records[0].residuals["az"])
    with pytest.raises(UnknownName, match="no channel 'Az'. Did you mean 'az'"):
        found.plot(["Az"])
    plt.close(figure)


def test_figure_takes_what_could_not_be_told() -> None:
    f = fit(record(n=20, az=white(0, 20), zero=np.zeros(20)))
    figure, axes = misfit(f).plot()
    figure.canvas.draw()
    assert len(axes) == 8
    plt.close(figure)


def hidden(term: Callable[[ph.Model], Any]) -> ph.Fit:
    """The fit of a model without a term of the pitching moment that the record has."""
    twin = hfb320.twin()
    base = hfb320.model()
    added = term(base)

    def change(key: tuple[str, str], e: ph.Expr) -> ph.Expr:
        return e + added if key == ("quantity", "Cm") else e

    core = rebuilt(base._core, base._core.inputs, lambda core, declared: core.parameter(*declared), change)
    truth = base._around(core, base.delays)
    initial = {"V": 106.0, "alpha": 0.112, "theta": 0.104, "q": -0.003}
    simulated = ph.simulate(truth, hfb320.PUBLISHED, ph.Experiment(twin.t, twin.inputs), initial=initial)
    rng = np.random.default_rng(7)
    outputs = {n: simulated.outputs[n] + s * rng.standard_normal(twin.n) for n, s in hfb320.SIGMA.items()}
    return ph.estimate(hfb320.model(), ph.Experiment(twin.t, twin.inputs, outputs))


def test_a_hidden_disturbance_shows_in_the_fit() -> None:
    found = misfit(hidden(lambda m: 0.004 * ph.sin(9.0 * m.time)))
    assert set(found.worst[:2]) == {"aq", "q"}
    for name in ("aq", "q"):
        assert found.channels[name].tones[0].frequency == pytest.approx(9.0 / (2 * np.pi), abs=0.005)


def test_a_hidden_curvature_shows_in_the_fit() -> None:
    """Slow residuals may be noise: it is said when they are large and what they go with, and that they may be."""
    found = misfit(hidden(lambda m: 30.0 * (ph.Expr.symbol("alpha") - 0.11) ** 2))
    for name in ("alpha", "q", "ax"):
        c = found.channels[name]
        assert c.ratio > 1.2 and c.main_regime is not None and c.main_regime.variable == "alpha"
        assert " with alpha" in c.summary()


def test_of_a_model_that_misses_nothing_nothing_is_claimed() -> None:
    assert not misfit(hidden(lambda m: 0.0)).structured


def test_a_late_vane_shows_in_the_fit() -> None:
    """ATTAS, or its twins: the vane measures alpha with a delay, so that its residual opposes the rate."""
    runs = attas.records()
    without = misfit(ph.estimate(attas.model(vane=False), runs)).channels["alpha"]
    assert without.follows is not None and without.follows.variable == "q" and without.follows.r < -0.8
    assert without.regime is not None and without.regime.share > 0.5
    with_it = misfit(attas.estimate(runs)).channels["alpha"]
    assert with_it.rms < 0.5 * without.rms and with_it.ratio < 0.5 * without.ratio
    assert with_it.follows is None


def test_the_hfb320_record() -> None:
    path = find(hfb320.RECORD)
    if path is None:
        pytest.skip(f"the record {hfb320.RECORD} is neither in $PHUGOID_DATA nor in ../shared/data")
    found = misfit(ph.estimate(hfb320.model(), hfb320.experiment(path)))
    assert all(c.coloured for c in found.channels.values())  # as of any real record
    assert found.worst[0] == "V"
    # All of the short period is worst in the 3-2-1-1, which lasts from about 1 to 9 s.
    for name in ("alpha", "q", "az"):
        assert 1.0 < found.channels[name].spans[0].start < found.channels[name].spans[0].end < 9.0
