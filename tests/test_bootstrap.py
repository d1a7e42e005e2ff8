"""The bootstrap: what is drawn, and that standard errors are those of repeated experiments."""

from __future__ import annotations

import itertools
import math
import signal
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from oscillator import SIGMA, TRUE, measured, model
from scipy import stats

import phugoid as ph
from phugoid.uncertainty.resample import Blocks, ColouredNoise, Parametric, block_length


@pytest.fixture(scope="module")
def white() -> ph.Fit:
    return ph.estimate(model(), measured(200, (0.0, 0.0), 0))


@pytest.fixture(scope="module")
def coloured() -> ph.Fit:
    return ph.estimate(model(), measured(300, (0.9, 0.5), 0))


def test_parametric_errors_are_those_of_the_fit_for_white_noise(white: ph.Fit) -> None:
    b = white.bootstrap(120)
    assert b.estimates.shape == (120, len(white.parameters)) and b.status == "complete" and b.failed == 0
    assert list(b.std_errors.values()) == pytest.approx(white.parameters.std_errors_array, rel=0.25)
    for name in TRUE:
        e = white.parameters[name]
        assert abs(b.bias[name]) < 0.4 * e.std_error
        for method in ("percentile", "basic"):
            low, high = b.intervals(method=method)[name]
            assert (high - low) / (2 * 1.96 * e.std_error) == pytest.approx(1.0, abs=0.25)
            assert low < e.value < high
    assert "120 of 120 runs converged" in b.summary()


@pytest.mark.parametrize("kind", ["coloured", "block"])
def test_coloured_noise_gives_larger_errors_than_white(coloured: ph.Fit, kind: Any) -> None:
    """Both agree with the corrected standard errors, in different ways; blocks fall a little short, as is known."""
    b = coloured.bootstrap(100, kind)
    ratios = [b.std_errors[n] / coloured.robust().parameters[n].std_error for n in TRUE]
    assert all(0.6 < ratio < 1.4 for ratio in ratios)
    assert all(b.std_errors[n] > 1.5 * coloured.parameters[n].std_error for n in TRUE)


def test_basic_mirrors_percentile(white: ph.Fit) -> None:
    b = white.bootstrap(20)
    low, high = b.intervals(0.9)["k"]
    value = white.parameters["k"].value
    assert b.intervals(0.9, "basic")["k"] == pytest.approx((2 * value - high, 2 * value - low))
    assert np.quantile(b.estimates[:, 0], [0.05, 0.95]) == pytest.approx((low, high))


def test_draws_depend_on_the_seed_and_number_alone(white: ph.Fit) -> None:
    first, more = white.bootstrap(4, seed=1), white.bootstrap(8, seed=1)
    assert np.array_equal(first.estimates, more.estimates[:4])
    assert not np.allclose(first.estimates, white.bootstrap(4, seed=2).estimates)
    for pool in (ProcessPoolExecutor(1), ThreadPoolExecutor(3)):
        with pool:
            there = white.bootstrap(4, seed=1, executor=pool)
        assert there.estimates == pytest.approx(first.estimates, rel=1e-9)


def test_interrupt_keeps_what_is_done(white: ph.Fit) -> None:
    seen: list[Any] = []

    def stop(outcome: Any) -> None:
        seen.append(outcome)
        if len(seen) == 5:
            signal.raise_signal(signal.SIGINT)

    b = white.bootstrap(50, progress=stop)
    assert b.status == "interrupted" and len(b.estimates) == 5 and b.n == 50


def test_missing_samples_stay_missing() -> None:
    run = measured(200, (0.5, 0.5), 0)
    x = run.output("x").copy()
    x[50:80] = np.nan
    fit = ph.estimate(model(), run.with_outputs({"x": x, "v": run.output("v")}))
    for resampler in (Parametric.of(fit), ColouredNoise.of(fit), Blocks.of(fit, 10)):
        (drawn,) = resampler.draw(np.random.default_rng(0))
        assert np.array_equal(np.isnan(drawn["x"]), np.isnan(x)) and np.isfinite(drawn["v"]).all()


DENSITIES = [
    (ph.Gaussian(), stats.norm()),
    (ph.StudentT(dof=3.0), stats.t(3.0)),
    (ph.Laplace(smoothing=0.001), stats.laplace()),
    (ph.Density(lambda r, s: -ph.log(1 + (r / s) ** 2) - ph.log(s)), stats.cauchy()),
]


@pytest.mark.parametrize(("noise", "expected"), DENSITIES, ids=lambda x: type(x).__name__)
def test_parametric_noise_has_the_density_of_the_fit(noise: ph.Gaussian, expected: Any) -> None:
    fit = ph.estimate(model(), measured(200, (0.0, 0.0), 0), noise=noise)
    resampler = Parametric.of(fit)
    random = np.random.default_rng(0)
    drawn = np.concatenate([resampler.noise(random, 0)["x"] for _ in range(20)]) / fit.parameters["sigma_x"].value
    assert stats.kstest(drawn, expected.cdf).pvalue > 0.01
    low, high = resampler.quantiles(0, "x", 0.025)
    scale = fit.parameters["sigma_x"].value
    assert (low / scale, high / scale) == pytest.approx((-expected.ppf(0.025), expected.ppf(0.975)), rel=0.01)


def test_parametric_noise_has_the_correlation_of_the_fit() -> None:
    fit = ph.estimate(model(), measured(300, (0.0, 0.0), 0, common=0.8), noise=ph.Gaussian(correlated=True))
    resampler = Parametric.of(fit)
    random = np.random.default_rng(0)
    noise = [resampler.noise(random, 0) for _ in range(20)]
    x, v = (np.concatenate([each[n] for each in noise]) for n in ("x", "v"))
    assert np.corrcoef(x, v)[0, 1] == pytest.approx(fit.parameters["corr_x_v"].value, abs=0.03)


def test_coloured_noise_has_the_autocorrelation_of_the_fit() -> None:
    fit = ph.estimate(model(), measured(600, (0.9, 0.5), 0, common=0.8))
    resampler = ColouredNoise.of(fit)
    random = np.random.default_rng(0)
    drawn = [resampler.noise(random, 0) for _ in range(60)]
    for name in SIGMA:
        series = np.array([each[name] for each in drawn])
        rho = fit.robust().autocorrelation[name][1]
        assert np.mean(series[:, 1:] * series[:, :-1]) / np.mean(series**2) == pytest.approx(rho, abs=0.03)
        assert np.sqrt(np.mean(series**2)) == pytest.approx(fit.parameters[f"sigma_{name}"].value, rel=0.2)
    # Innovations that are correlated by 0.8 make noise correlated by less, for it is of different colours.
    a, b = 0.9, 0.5
    expected = 0.8 * math.sqrt((1 - a**2) * (1 - b**2)) / (1 - a * b)
    x, v = (np.concatenate([each[n] for each in drawn]) for n in SIGMA)
    assert np.corrcoef(x, v)[0, 1] == pytest.approx(expected, abs=0.12)


def test_blocks_keep_channels_together_and_reach_over_no_gap() -> None:
    run = measured(200, (0.5, 0.5), 0)
    kept = np.r_[0:90, 120:200]  # times are missing
    cut = ph.Experiment(run.t[kept], {"u": run.input("u")[kept]}, {n: run.output(n)[kept] for n in SIGMA})
    fit = ph.estimate(model(), cut)
    resampler = Blocks.of(fit, 20)
    assert resampler.lengths == [20]
    begins = set(resampler.starts[0].tolist())
    assert begins == {*range(71), *range(90, 151)}
    noise = resampler.noise(np.random.default_rng(0), 0)
    table = resampler.residuals[0]
    places = [int(np.flatnonzero(table[:, 0] == value)[0]) for value in noise["x"]]
    assert np.array_equal(table[places, 1], noise["v"])
    assert sum(b == a + 1 for a, b in itertools.pairwise(places)) >= 160


def test_blocks_are_as_long_as_the_noise_remembers(white: ph.Fit, coloured: ph.Fit) -> None:
    assert block_length(white) < 6 < 12 < block_length(coloured) <= 50
    assert coloured.bootstrap(2, "block").block == block_length(coloured)
    assert coloured.bootstrap(2, "block", block=7).block == 7


def test_runs_that_fail_are_counted(white: ph.Fit, monkeypatch: pytest.MonkeyPatch) -> None:
    from dataclasses import replace

    from phugoid.uncertainty import bootstrap as module

    original, calls = module.estimate, []

    def sometimes(*args: Any, **options: Any) -> ph.Fit:
        calls.append(1)
        fit = original(*args, **options)
        return replace(fit, status="iteration limit", message="no") if len(calls) == 2 else fit

    monkeypatch.setattr(module, "estimate", sometimes)
    b = white.bootstrap(4)
    assert b.failed == 1 and len(b.estimates) == 3
    assert "1 of 4 runs did not converge" in b.warnings[0] and "1 of 4" in b.summary()


def test_delays_and_experiments_with_biases() -> None:
    m = ph.Model("late")
    x, v = m.states("x v")
    (u,) = m.inputs("u")
    k, c, b, tau, bias = m.parameters(
        k=4.0,
        c=1.0,
        b=2.0,
        tau=ph.Parameter(0.0, bounds=(-0.3, 0.3)),
        bias=ph.Parameter(0.0, per_experiment=True),
    )
    m.dynamics(x=v, v=-k * x - c * v + b * m.delay(u, tau))
    m.outputs(x=x + bias, v=v)
    runs = [measured(150, (0.5, 0.5), i, name=name) for i, name in enumerate(("one", "two"))]
    fit = ph.estimate(m, runs)
    for kind in ("parametric", "coloured", "block"):
        b = fit.bootstrap(6, kind)
        assert b.names == fit.parameters.names and len(b.estimates) == 6
        spread = np.abs(b.estimates - fit.parameters.values_array) / fit.robust().parameters.std_errors_array
        assert 0.1 < spread.max() < 6.0


def test_bad_input(white: ph.Fit) -> None:
    for options, message in [
        ({"n": 0}, "n is a whole number"),
        ({"kind": "wild"}, "'parametric', 'coloured', 'block'"),
        ({"block": 5}, 'block is for kind="block"'),
        ({"kind": "block", "block": 1000}, "from 1 to 200"),
        ({"seed": -1}, "seed is a whole number"),
        ({"executor": 3}, "Executor"),
    ]:
        with pytest.raises(ph.errors.OptionError, match=message):
            white.bootstrap(**{"n": 5, **options})
    with pytest.raises(ph.errors.OptionError, match="percentile"):
        white.bootstrap(2).intervals(method="bca")
    robust = ph.estimate(model(), measured(200, (0.0, 0.0), 0), noise=ph.StudentT())
    with pytest.raises(ph.errors.OptionError, match='use kind="block"'):
        robust.bootstrap(2, "coloured")
    filtered = ph.estimate(model(), measured(80, (0.0, 0.0), 0), transcription=ph.FilterError(states=("v",)))
    with pytest.raises(ph.errors.OptionError, match="process noise.*innovations are white"):
        filtered.bootstrap(2, "block")


def test_the_figure_shows_the_distribution_of_each_parameter() -> None:
    fit = ph.estimate(model(), measured(200, (0.0, 0.0), 3))
    found = fit.bootstrap(12)
    figure, axes = found.plot()
    assert list(axes) == list(found.names)
    low, high = found.intervals()["k"]
    lines = [line.get_xdata()[0] for line in axes["k"].lines]
    assert {fit.parameters["k"].value, low, high} <= {*lines}
    assert axes["k"].patches and [*found.plot(["c"])[1]] == ["c"]
    with pytest.raises(ph.errors.UnknownName, match="there is no parameter 'z'"):
        found.plot(["z"])


def test_runs_are_draws_for_arviz(white: ph.Fit) -> None:
    pytest.importorskip("arviz_base")
    b = white.bootstrap(6)
    drawn = b.to_arviz()["posterior"]
    for name, values in zip(b.names, b.estimates.T, strict=True):
        assert np.array_equal(np.asarray(drawn[name]), values[np.newaxis])
