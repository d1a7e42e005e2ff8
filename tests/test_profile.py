"""Intervals by profile likelihood: against likelihoods known in closed form, at bounds, without end, in parallel."""

from __future__ import annotations

import math
import signal
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest
from matplotlib import pyplot as plt
from oscillator import measured, model

import phugoid as ph
from phugoid import OptionError

Z = 1.959963984540054


def linear(**parameters: ph.Parameter) -> ph.Fit:
    """A line with known noise: least squares, whose likelihood is a parabola."""
    m = ph.Model("line")
    (x,) = m.states("x")
    a, b = m.parameters(**{"a": ph.Parameter(0.0), "b": ph.Parameter(0.0), **parameters})
    m.dynamics(x=0.0 * x)
    m.outputs(y=x + a * m.time, z=b + 0.0 * x)
    m.initial(x=0.0)
    t = np.linspace(0.0, 1.0, 50)
    random = np.random.default_rng(0)
    outputs = {"y": 2.0 * t + 0.1 * random.standard_normal(50), "z": 0.5 + 0.1 * random.standard_normal(50)}
    return ph.estimate(m, ph.Experiment(t, outputs=outputs), noise=ph.Gaussian({"y": 0.1, "z": 0.1}))


def test_parabola_gives_the_interval_of_the_standard_error() -> None:
    fit = linear()
    for level, z in ((0.95, Z), (0.6826894921370859, 1.0)):
        profiles = fit.profile(level=level)
        assert list(profiles) == ["a", "b"] and profiles.status == "complete"
        for p in profiles.values():
            assert p.interval == pytest.approx((p.value - z * p.std_error, p.value + z * p.std_error), rel=1e-3)
            assert p.ends == ("found", "found") and p.remark == ""
            assert p.asymmetry == pytest.approx(1.0, abs=0.01)
            assert p.drops == pytest.approx(0.5 * ((p.values - p.value) / p.std_error) ** 2, abs=1e-3)


def squared() -> ph.Fit:
    """y = a**2 with known noise: the interval of a is that of a**2, mapped."""
    m = ph.Model("square")
    (x,) = m.states("x")
    (a,) = m.parameters(a=0.5)
    m.dynamics(x=0.0 * x)
    m.outputs(y=a**2 + x)
    m.initial(x=0.0)
    run = ph.Experiment(np.arange(4.0), outputs={"y": [0.1, 0.5, 0.2, 0.4]})
    return ph.estimate(m, run, noise=ph.Gaussian({"y": 0.25}))


def test_interval_follows_a_likelihood_that_is_no_parabola() -> None:
    fit = squared()
    mean, error = fit.parameters["a"].value ** 2, 0.25 / 2.0
    expected = tuple(math.sqrt(mean + side * Z * error) for side in (-1, 1))
    p = fit.profile("a")["a"]
    assert p.interval == pytest.approx(expected, rel=2e-3)
    assert p.asymmetry < 0.9
    wald = (p.value - Z * p.std_error, p.value + Z * p.std_error)
    assert abs(wald[0] - expected[0]) > 0.05


def test_a_likelihood_that_stays_high_has_no_end() -> None:
    """Of a saturation far beyond the data only a lower bound is known."""
    m = ph.Model("saturation")
    (x,) = m.states("x")
    (s,) = m.parameters(s=ph.Parameter(2.0, transform="log"))
    m.dynamics(x=0.0 * x)
    m.outputs(y=s * ph.tanh(m.time / s) + x)
    m.initial(x=0.0)
    t = np.linspace(0.0, 1.0, 30)
    z = 3.0 * np.tanh(t / 3.0) + 0.08 * np.random.default_rng(0).standard_normal(30)
    fit = ph.estimate(m, ph.Experiment(t, outputs={"y": z}), noise=ph.Gaussian({"y": 0.08}))
    p = fit.profile()["s"]
    assert p.ends == ("found", "open") and p.interval[1] == math.inf
    assert 0.8 < p.interval[0] < 3.0
    assert "no end" in p.remark and "upper end no end" in fit.profile().summary()


def test_an_interval_ends_at_a_bound() -> None:
    fit = linear(b=ph.Parameter(0.49, bounds=(0.485, 1.0)))
    p = fit.profile("b")["b"]
    assert p.ends[1] == "found"
    assert (p.interval[0], p.ends[0]) == (0.485, "bound")
    assert "lower end at its bound" in p.remark


def test_priors_take_part() -> None:
    """Of a line with a prior: the posterior is a parabola of the fit's standard error."""
    fit = linear(a=ph.Parameter(0.0, prior=(1.9, 0.02)))
    p = fit.profile("a")["a"]
    assert p.interval == pytest.approx((p.value - Z * p.std_error, p.value + Z * p.std_error), rel=1e-3)


def test_coloured_residuals_widen_it() -> None:
    fit = ph.estimate(model(), measured(200, (0.9, 0.9), 0))
    plain, wide = fit.profile("k")["k"], fit.profile("k", coloured=True)["k"]
    ratio = fit.robust().inflation["k"]
    assert wide.inflation == ratio > 1.5
    assert np.diff(wide.interval)[0] == pytest.approx(ratio * np.diff(plain.interval)[0], rel=0.1)


def test_a_bias_of_one_experiment() -> None:
    m = ph.Model("biased")
    x, v = m.states("x v")
    (u,) = m.inputs("u")
    k, c, b, bias = m.parameters(k=4.0, c=1.0, b=2.0, bias=ph.Parameter(0.0, per_experiment=True))
    m.dynamics(x=v, v=-k * x - c * v + b * u)
    m.outputs(x=x + bias, v=v)
    runs = [measured(150, (0.0, 0.0), i, name=name) for i, name in enumerate(("one", "two"))]
    fit = ph.estimate(m, runs)
    p = fit.profile(["bias[two]"])["bias[two]"]
    e = fit.parameters["bias[two]"]
    assert p.interval == pytest.approx((e.value - Z * e.std_error, e.value + Z * e.std_error), rel=0.05)
    assert p.value == e.value


def test_a_delay() -> None:
    m = ph.Model("late")
    x, v = m.states("x v")
    (u,) = m.inputs("u")
    k, c, b, tau = m.parameters(k=4.0, c=1.0, b=2.0, tau=ph.Parameter(0.0, bounds=(-0.3, 0.3)))
    m.dynamics(x=v, v=-k * x - c * v + b * m.delay(u, tau))
    m.outputs(x=x, v=v)
    fit = ph.estimate(m, measured(200, (0.0, 0.0), 0))
    p = fit.profile("k")["k"]
    e = fit.parameters["k"]
    assert p.interval == pytest.approx((e.value - Z * e.std_error, e.value + Z * e.std_error), rel=0.02)


def test_in_parallel_it_is_the_same() -> None:
    fit = ph.estimate(model(), measured(150, (0.5, 0.5), 0))
    seen = []
    here = fit.profile(["k", "c"], progress=seen.append)
    with ProcessPoolExecutor(1) as pool:
        there = fit.profile(["k", "c"], executor=pool)
    assert len(seen) == 4
    for name in ("k", "c"):
        assert there[name].interval == pytest.approx(here[name].interval, rel=1e-9)


def test_interrupt_keeps_what_is_done() -> None:
    fit = ph.estimate(model(), measured(150, (0.5, 0.5), 0))

    def stop(outcome: object) -> None:
        signal.raise_signal(signal.SIGINT)

    profiles = fit.profile(progress=stop)
    assert profiles.status == "interrupted"
    p = profiles["k"]
    assert p.ends[0] == "found" and p.ends[1] == "missing" and math.isnan(p.interval[1])
    assert "interrupted" in profiles.summary()


def test_figure() -> None:
    fit = ph.estimate(model(), measured(150, (0.5, 0.5), 0))
    profiles = fit.profile()
    figure, axes = profiles.plot()
    assert list(axes) == ["k", "c", "b"]
    figure, axes = profiles.plot(["c"])
    assert list(axes) == ["c"]
    plt.close("all")
    with pytest.raises(ph.errors.UnknownName, match="'q'"):
        profiles.plot(["q"])


def test_bad_input() -> None:
    fit = ph.estimate(model(), measured(150, (0.5, 0.5), 0))
    with pytest.raises(ph.errors.OptionError, match="belongs to the noise"):
        fit.profile("sigma_x")
    with pytest.raises(ph.errors.OptionError, match="'kk' is not a parameter"):
        fit.profile(["kk"])
    with pytest.raises(ph.errors.OptionError, match="level"):
        fit.profile(level=95)
    with pytest.raises(ph.errors.OptionError, match="Executor"):
        fit.profile("k", executor=4)
    with pytest.raises(ph.errors.OptionError, match="progress"):
        fit.profile("k", progress="yes")
    unfinished = ph.estimate(
        model(), measured(150, (0.5, 0.5), 0), solver=ph.Newton(max_iterations=1), start={"k": 1.0}
    )
    with pytest.raises(ph.errors.OptionError, match="has not converged"):
        unfinished.profile()


def test_draws_for_arviz_have_the_intervals_of_the_profile() -> None:
    pytest.importorskip("arviz_base")
    profiles = linear().profile()
    drawn = profiles.to_arviz(n=4000)["posterior"]
    for name, p in profiles.items():
        values = np.asarray(drawn[name])
        assert values.shape == (1, 4000)
        assert np.quantile(values, [0.025, 0.975]) == pytest.approx(p.interval, abs=0.02 * p.std_error)
        assert values.std() == pytest.approx(p.std_error, rel=0.02)
    assert abs(np.corrcoef(np.asarray(drawn["a"])[0], np.asarray(drawn["b"])[0])[0, 1]) < 0.05
    with pytest.raises(OptionError, match="two or more, not 1"):
        profiles.to_arviz(1)


def test_quantiles_follow_a_likelihood_that_is_no_parabola() -> None:
    (p,) = squared().profile().values()
    low, high = p.interval
    assert p.quantiles([0.025, 0.5, 0.975]) == pytest.approx([low, p.value, high], rel=1e-3)
