"""A fit tried on other experiments: what is held and what is found anew, and what the numbers say."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import attas
import hfb320
import numpy as np
import pytest
import turbulence
from records import find
from scipy.signal import lsim
from scipy.stats import binom, chi2, kstest

import phugoid as ph
from phugoid import DataError, Gaussian, ModelError, OptionError, Parameter
from phugoid.frozen_model import biases

TRUTH = {"k": 2.0, "c": 0.5, "b": 0.3}
SIGMA = {"x": 0.05, "v": 0.1}
FIRST = {"x": 0.3, "v": -0.2}


def oscillator(held: bool = False, local: bool = False) -> ph.Model:
    """Position and speed, the latter with a sensor's bias; derivatives known and fixed, if so asked."""
    m = ph.Model("oscillator")
    x, v = m.states(x="m", v="m/s")
    (u,) = m.inputs(u="m/s²")
    k, c = m.parameters(**{n: Parameter(TRUTH[n] if held else 1.0, fixed=held) for n in ("k", "c")})
    (b,) = m.parameters(b=Parameter(unit="m/s", per_experiment=local))
    m.dynamics(x=v, v=u - k * x - c * v)
    m.outputs(x=x, v=v + b)
    return m


def record(seed: int, name: str = "other", bias: float = TRUTH["b"], n: int = 120) -> ph.Experiment:
    t = 0.1 * np.arange(n)
    e = ph.Experiment(t, {"u": np.sign(np.sin(0.7 * t + 0.01 * seed))}, name=name)
    path = ph.simulate(oscillator(), {**TRUTH, "b": bias}, e, initial=FIRST, rtol=1e-8)
    random = np.random.default_rng(seed)
    return e.with_outputs({n: path.outputs[n] + s * random.standard_normal(t.size) for n, s in SIGMA.items()})


@pytest.fixture(scope="module")
def true_fit() -> ph.Fit:
    """A fit whose derivatives and noise are the truth."""
    return ph.estimate(oscillator(held=True), record(1000, "first"), noise=Gaussian(SIGMA))


@pytest.fixture(scope="module")
def fit() -> ph.Fit:
    return ph.estimate(oscillator(), record(1000, "first"))


@pytest.fixture(scope="module")
def trials(true_fit: ph.Fit) -> list[ph.results.Validation]:
    found = [true_fit.validate(record(seed)) for seed in range(30)]
    assert all(v.converged and not v.warnings for v in found)
    return found


# What is held, and what is found anew


def test_chi_square_of_the_true_model_is_chi_square(trials: list[ph.results.Validation]) -> None:
    assert {v.degrees_of_freedom for v in trials} == {2 * 120 - 3}
    total, freedom = sum(v.chi_square for v in trials), sum(v.degrees_of_freedom for v in trials)
    assert 1e-4 < chi2.cdf(total, freedom) < 1 - 1e-4
    assert kstest([v.chi_square for v in trials], chi2(2 * 120 - 3).cdf).pvalue > 1e-3


def test_log_likelihood_is_that_of_the_chi_square(trials: list[ph.results.Validation]) -> None:
    for v in trials:
        by_hand = -0.5 * v.chi_square - 120 * sum(math.log(s) for s in SIGMA.values())
        assert v.log_likelihood == pytest.approx(by_hand, abs=1e-8)


def test_standard_errors_cover_the_truth(trials: list[ph.results.Validation]) -> None:
    """Initial states and bias: squares of the errors in units of the standard error, and 95 % intervals."""
    for name, truth in {**FIRST, "b": TRUTH["b"]}.items():
        each = [v.re_estimated[name] if name == "b" else v.initial_states["other"][name] for v in trials]
        z = np.array([(e.value - truth) / e.std_error for e in each])
        assert 1e-4 < chi2.cdf(float(z @ z), z.size) < 1 - 1e-4, name
        inside = int((np.abs(z) < 1.96).sum())
        assert binom.cdf(inside, z.size, 0.95) > 1e-4, name


def test_what_is_held_does_not_move(fit: ph.Fit) -> None:
    v = fit.validate(record(1))
    assert v.fixed == {name: fit.parameters[name].value for name in ("k", "c")}
    assert v.re_estimated.names == ("b",) and v.re_estimated["b"].value != fit.parameters["b"].value
    assert v.noise == Gaussian({n: fit.parameters[f"sigma_{n}"].value for n in SIGMA})
    path = ph.simulate(
        oscillator(),
        {**v.fixed, "b": v.re_estimated["b"]},
        record(1),
        initial={n: e.value for n, e in v.initial_states["other"].items()},
    )
    for name in SIGMA:
        assert v.records[0].outputs[name] == pytest.approx(path.outputs[name], abs=1e-6)


def test_initial_states_of_the_first_samples_then_simulation(fit: ph.Fit) -> None:
    """Later samples change neither the states nor the bias, but count in the match."""
    e = record(1)
    moved = {n: np.where(np.arange(120) < 30, e.output(n), e.output(n) + 5.0) for n in SIGMA}
    v = fit.validate(e, initial_samples=30)
    other = fit.validate(e.with_outputs(moved, name="other"), initial_samples=30)
    for name in SIGMA:
        assert other.records[0].outputs[name] == pytest.approx(v.records[0].outputs[name], abs=1e-6)
        assert v.residuals[name] == pytest.approx(e.output(name) - v.records[0].outputs[name])
        assert v.matches[name].samples == 120 and v.matches[name].rms < 2 * SIGMA[name] < other.matches[name].rms
    assert v.re_estimated["b"].std_error > 1.5 * fit.validate(e).re_estimated["b"].std_error
    # All measured values but two initial states and the bias; what the initial states are wrong by adds to chi-square.
    values = sum(np.isfinite(e.output(n)).sum() for n in SIGMA)
    assert v.degrees_of_freedom == values - 3 == fit.validate(e).degrees_of_freedom
    assert fit.validate(e).chi_square < v.chi_square < 2 * v.degrees_of_freedom < other.chi_square
    assert "from the first 30 samples of each experiment, simulated from there on" in v.summary()
    with pytest.raises(OptionError, match="initial_samples is a whole number from 1, not 0"):
        fit.validate(e, initial_samples=0)


def test_residuals_of_the_only_experiment(fit: ph.Fit) -> None:
    v = fit.validate(record(1))
    for name in SIGMA:
        expected = record(1).output(name) - v.records[0].outputs[name]
        assert v.residuals[name] == pytest.approx(expected, abs=1e-12)
    two = fit.validate([record(1), record(2, "third")])
    with pytest.raises(DataError, match=r"2 experiments \('other', 'third'\): use validation.records"):
        _ = two.residuals


def test_it_is_the_maximum_over_what_is_free(fit: ph.Fit) -> None:
    """No neighbour does better, by an independent simulation."""
    e = record(1)
    v = fit.validate(e)
    sigma = v.noise.known

    def log_likelihood(b: float, first: dict[str, float]) -> float:
        r = ph.simulate(oscillator(), {**v.fixed, "b": b}, e, initial=first).residuals
        return -sum(0.5 * float(np.sum((r[n] / s) ** 2)) + e.n * math.log(s) for n, s in sigma.items())

    first = {n: x.value for n, x in v.initial_states["other"].items()}
    best = log_likelihood(v.re_estimated["b"].value, first)
    assert v.log_likelihood == pytest.approx(best, abs=1e-5)
    for step in (-0.3, 0.3):
        assert log_likelihood(v.re_estimated["b"].value + step * v.re_estimated["b"].std_error, first) < best - 0.02
        for name, x in v.initial_states["other"].items():
            moved = {**first, name: x.value + step * x.std_error}
            assert log_likelihood(v.re_estimated["b"].value, moved) < best - 0.02


def test_no_bias_is_freed_if_so_asked(fit: ph.Fit) -> None:
    with_bias, without = fit.validate(record(1, bias=0.5)), fit.validate(record(1, bias=0.5), biases=())
    assert not without.re_estimated and without.fixed["b"] == fit.parameters["b"].value
    assert without.degrees_of_freedom == with_bias.degrees_of_freedom + 1
    assert without.log_likelihood < with_bias.log_likelihood - 20
    assert without.matches["v"].bias > 0.5 > with_bias.matches["v"].bias


def test_any_parameter_can_be_freed_by_name(fit: ph.Fit) -> None:
    v = fit.validate(record(1), biases=["k"])
    assert v.re_estimated.names == ("k",) and set(v.fixed) == {"c", "b"}
    assert v.log_likelihood > fit.validate(record(1), biases=()).log_likelihood


def test_a_value_may_be_given(fit: ph.Fit) -> None:
    v = fit.validate(record(1), values={"k": 3.0, "b": 0.3})
    assert v.fixed["k"] == 3.0 and v.fixed["b"] == 0.3 and not v.re_estimated
    assert v.log_likelihood < fit.validate(record(1)).log_likelihood - 100


def test_a_parameter_at_its_bound_is_held_there() -> None:
    m = ph.Model("lag")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    (a,) = m.parameters(a=Parameter(0.5, bounds=(0.1, 0.8)))
    m.dynamics(x=a * (u - x))
    m.outputs(x=x)
    t = np.linspace(0, 10, 60)
    e = ph.Experiment(t, {"u": np.sign(np.sin(t))}, name="fast")
    path = ph.simulate(m, {"a": 2.0}, e, initial={"x": 0.0})
    run = e.with_outputs({"x": path.outputs["x"] + 0.01 * np.cos(37 * t)})
    fit = ph.estimate(m, run.window(0, 6))
    assert fit.parameters["a"].bounds_active == "upper"
    v = fit.validate(run.window(6.1, 10, name="rest"))
    assert v.converged and v.fixed["a"] == fit.parameters["a"].value


# The record that the fit was made on must give the fit back: held parameters are at their optimum


def _gaps(e: ph.Experiment) -> ph.Experiment:
    v = e.output("v").copy()
    v[20:40] = np.nan
    v[::3] = np.nan
    return e.with_outputs({"x": e.output("x"), "v": v})


def _multirate(e: ph.Experiment) -> ph.Experiment:
    fast = np.linspace(e.t[0], e.t[-1], 400)
    u = np.interp(fast, e.t, e.input("u"))
    return ph.multirate(
        {"u": (fast, u)}, {"x": (e.t, e.output("x")), "v": (e.t[::4] + 0.03, e.output("v")[::4])}, name=e.name
    )


def _log_density(r: Any, sigma: Any, a: Any) -> Any:
    return -(1 + a) * ph.log(1 + (r / sigma) ** 2) - ph.log(sigma)


CUSTOM = ph.Density(_log_density, parameters={"a": Parameter(0.5, fixed=True)})
SHARED: dict[str, Callable[[], ph.Fit]] = {
    "independent": lambda: ph.estimate(oscillator(), record(3)),
    "some known": lambda: ph.estimate(oscillator(), record(3), noise=Gaussian({"x": 0.05})),
    "correlated": lambda: ph.estimate(oscillator(), record(3), noise=Gaussian(correlated=True)),
    "covariance": lambda: ph.estimate(
        oscillator(), record(3), noise=Gaussian(covariance=[[0.003, 0.001], [0.001, 0.01]])
    ),
    "correlated, gaps": lambda: ph.estimate(oscillator(), _gaps(record(3)), noise=Gaussian(correlated=True)),
    "Student's": lambda: ph.estimate(oscillator(), record(3), noise=ph.StudentT(dof={"x": None, "v": 5.0})),
    "Huber's": lambda: ph.estimate(oscillator(), record(3), noise=ph.Huber()),
    "Laplace's": lambda: ph.estimate(oscillator(), record(3), noise=ph.Laplace(smoothing=0.5)),
    "a density": lambda: ph.estimate(oscillator(), record(3), noise=CUSTOM),
    "by output": lambda: ph.estimate(
        oscillator(), record(3), noise=ph.PerOutput({"v": ph.StudentT(dof=None)}, {"x": 0.06})
    ),
    "by experiment": lambda: ph.estimate(oscillator(), record(3), noise=ph.PerExperiment(Gaussian(correlated=True))),
    "gaps": lambda: ph.estimate(oscillator(), _gaps(record(3))),
    "multirate": lambda: ph.estimate(oscillator(), _multirate(record(3))),
    "single shooting": lambda: ph.estimate(
        oscillator(), record(3), transcription=ph.SingleShooting(steps=240), start=TRUTH
    ),
    "multiple shooting": lambda: ph.estimate(oscillator(), record(3), transcription=ph.MultipleShooting(segments=12)),
    "segments": lambda: ph.estimate(oscillator(), record(3), transcription=ph.Collocation(segments=60)),
    "substeps": lambda: ph.estimate(oscillator(), record(3), transcription=ph.Collocation(order=2, substeps=2)),
    "segment ends": lambda: ph.estimate(
        oscillator(), record(3), transcription=ph.Collocation(segments=0.05 * np.arange(239))
    ),
    "refined": lambda: ph.estimate(
        oscillator(), record(3), transcription=ph.Collocation(order=3, refine=True, tolerance=1e-5)
    ),
    "biases apart": lambda: ph.estimate(oscillator(local=True), [record(3, "one"), record(4, "two", bias=-0.4)]),
}


def _own(fit: ph.Fit) -> list[ph.Experiment]:
    """The data of a fit by its records."""
    return [ph.Experiment(r.t, r.inputs, r.measured, r.name) for r in fit.records]


@pytest.mark.parametrize("kind", SHARED)
def test_on_its_own_record_it_is_the_fit(kind: str) -> None:
    fit = SHARED[kind]()
    assert fit.converged
    data: Any = _multirate(record(3)) if kind == "multirate" else _own(fit)
    v = fit.validate(data)
    assert v.converged
    # The multirate mesh and the refined one are found anew; others are the same.
    assert v.log_likelihood == pytest.approx(fit.log_likelihood, abs=1e-3 if kind == "refined" else 1e-5)
    for name, e in v.re_estimated.items():
        assert abs(e.value - fit.parameters[name].value) < 1e-3 * e.std_error
        assert e.std_error <= fit.parameters[name].std_error * 1.0001
    assert all("the fit was made on" in w for w in v.warnings) and len(v.warnings) == len(fit.records)


@pytest.mark.parametrize(
    "transcription",
    [
        ph.Collocation(segments=119),
        ph.Collocation(segments=400),
        ph.Collocation(order=2, substeps=10),
        ph.Collocation(segments=0.05 * np.arange(239)),
        ph.MultipleShooting(segments=12),
        ph.MultipleShooting(segments=0.7 * np.arange(18), integrator="dopri5"),
        ph.SingleShooting(substeps=2),
        ph.SingleShooting(steps=238),
        ph.SingleShooting(step=0.05),
    ],
    ids=str,
)
def test_the_mesh_follows_a_record_of_another_length(fit: ph.Fit, transcription: Any) -> None:
    """Whatever says how fine the fit's mesh was, it is as fine on this record: inputs bend at its samples."""
    e = record(1, n=173)
    fine = fit.validate(e)
    v = replace(fit, transcription=transcription).validate(e)
    assert v.log_likelihood == pytest.approx(fine.log_likelihood, abs=0.02)
    two = [e, record(2, "more", n=101)]
    both = replace(fit, transcription=transcription).validate(two)
    assert both.log_likelihood == pytest.approx(fit.validate(two).log_likelihood, abs=0.04)


def test_long_segments_stay_as_long(fit: ph.Fit) -> None:
    """40 segments of 0.2975 s, on a record of 17.2 s."""
    v = replace(fit, transcription=ph.Collocation(order=3, segments=40)).validate(e := record(1, n=173))
    ends = v.records[0].mesh_t[::2]
    assert ends.size == math.ceil(17.2 / 0.2975) + 1
    # Each ends at a sample.
    assert np.abs(ends[:, None] - e.t).min(axis=1).max() < 1e-9


def test_process_noise_is_held() -> None:
    """In gusts: predictions from the samples before are as good as the fit says, and white; output error's are not."""
    pair, other = turbulence.solve(0), turbulence.record(1)[0]
    own = pair.filtered.validate(pair.data)
    assert own.log_likelihood == pytest.approx(pair.filtered.log_likelihood, abs=1e-6)
    v, ordinary = pair.filtered.validate(other), pair.ordinary.validate(other)
    assert v.converged and v.fixed["q_wg"] == pair.filtered.parameters["q_wg"].value
    assert v.log_likelihood > ordinary.log_likelihood + 1000
    for m in v.matches.values():
        assert 0.85 < m.rms / m.sigma < 1.15 and m.whiteness > 1e-3
        assert ordinary.matches[m.output].whiteness < 1e-6
    assert math.isnan(v.chi_square) and "predictions from the samples before" in v.summary()


def test_delays_are_held() -> None:
    m = ph.Model("late")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    T, tau, late, b = m.parameters(T=1.0, tau=Parameter(0.1, bounds=(0, 1)), late=0.0, b=0.0)
    m.dynamics(x=(m.delay(u, tau) - x) / T)
    m.outputs(x=x, y=2 * x + b)
    m.sensor_delay(y=late)
    assert biases(m) == ("b",)

    def run(name: str, shift: float) -> ph.Experiment:
        t = 0.05 * np.arange(200)
        e = ph.Experiment(t, {"u": np.sin(0.8 * t + shift) + np.sin(2.1 * t)}, name=name, interpolation="cubic")
        path = ph.simulate(m, {"T": 0.7, "tau": 0.21, "late": 0.13, "b": 0.5}, e, initial={"x": 0.1})
        random = np.random.default_rng(7)
        return e.with_outputs({n: y + 0.01 * random.standard_normal(t.size) for n, y in path.outputs.items()})

    fit = ph.estimate(m, run("first", 0.0))
    own = fit.validate(run("first", 0.0))
    assert own.log_likelihood == pytest.approx(fit.log_likelihood, abs=1e-4)
    v = fit.validate(run("second", 1.0))
    assert (
        v.converged
        and v.fixed["tau"] == fit.parameters["tau"].value
        and v.fixed["late"] == fit.parameters["late"].value
    )
    assert abs(v.re_estimated["b"].value - 0.5) < 4 * v.re_estimated["b"].std_error
    # The first samples of the late sensor reach back before the record, which leaves its residuals without them.
    samples = sum(int(np.isfinite(r).sum()) for r in v.records[0].residuals.values())
    assert 1e-4 < chi2.cdf(v.chi_square, samples - 2) < 1 - 1e-4
    assert v.degrees_of_freedom == samples - 2 < 2 * 200 - 2


def test_noise_of_each_experiment_is_averaged() -> None:
    data = [record(3, "one", n=80), record(4, "two")]
    fit = ph.estimate(oscillator(), data, noise=ph.PerExperiment())
    v = fit.validate(record(5))
    for name in SIGMA:
        first, second = (fit.parameters[f"sigma_{name}[{run}]"].value for run in ("one", "two"))
        assert v.noise.known[name] == pytest.approx(math.sqrt((80 * first**2 + 120 * second**2) / 200))
    assert any("its own noise" in w for w in v.warnings)
    several = ph.estimate(oscillator(), data, noise=ph.PerExperiment(ph.StudentT(dof=None)))
    with pytest.raises(OptionError, match="own dof_x"):
        several.validate(record(5))


def test_several_experiments_with_biases_of_their_own() -> None:
    """Nothing is shared then, and each is as it is alone."""
    fit = ph.estimate(oscillator(local=True), [record(3, "one"), record(4, "two", bias=-0.4)])
    data = [record(5, "three", bias=0.1), record(6, "four", bias=-0.2, n=90)]
    both, alone = fit.validate(data), [fit.validate(e) for e in data]
    assert both.log_likelihood == pytest.approx(sum(v.log_likelihood for v in alone), abs=1e-6)
    assert both.re_estimated.names == ("b[three]", "b[four]")
    for v, e in zip(alone, data, strict=True):
        assert both.re_estimated[f"b[{e.name}]"].value == pytest.approx(v.re_estimated["b"].value, abs=1e-7)
        for name in SIGMA:
            assert both.by_experiment[e.name][name].rms == pytest.approx(v.matches[name].rms, abs=1e-7)
    assert both.matches["x"].samples == 210
    assert "three alone" in both.summary() and "b[four]" in both.summary()


def test_states_that_no_output_measures_are_found() -> None:
    """Speed at 0 would divide by 0: it starts at its mean along the fit."""
    m = ph.Model("phugoid")
    V, gamma, h = m.states(V="m/s", gamma="rad", h="m")
    (T,) = m.inputs("T")
    cd, cl, b = m.parameters(cd=0.02, cl=0.005, b=0.0)
    m.dynamics(V=T - cd * V**2 / 100 - 9.8 * ph.sin(gamma), gamma=cl * V - 9.8 * ph.cos(gamma) / V, h=V * ph.sin(gamma))
    m.outputs(rate=V * ph.sin(gamma), h=h + b)

    def run(name: str, level: float, seed: int) -> ph.Experiment:
        t = 0.5 * np.arange(120)
        e = ph.Experiment(t, {"T": 0.5 + level * np.sin(0.2 * t)}, name=name)
        truth = {"cd": 0.02, "cl": 0.0039, "b": 0.0}
        path = ph.simulate(m, truth, e, initial={"V": 50.0, "gamma": 0.02, "h": 100.0})
        random = np.random.default_rng(seed)
        return e.with_outputs({n: y + 0.1 * random.standard_normal(t.size) for n, y in path.outputs.items()})

    # Height and its bias cannot be distinguished, so that bias is held.
    fit = ph.estimate(m, run("first", 0.3, 0), start={"V": 45.0, "cd": 0.03, "cl": 0.004, "b": 0.0, "gamma": 0.0})
    v = fit.validate(run("second", -0.4, 1), biases=())
    assert v.converged
    for name, truth in {"V": 50.0, "gamma": 0.02}.items():
        e = v.initial_states["second"][name]
        assert abs(e.value - truth) < 5 * e.std_error


# What is refused, and warned of


@pytest.mark.parametrize(
    ("options", "error", "text"),
    [
        ({"biases": "b"}, OptionError, "list of names"),
        ({"biases": ["bb"]}, ModelError, "Did you mean 'b'"),
        ({"biases": ["sigma_x"]}, ModelError, "belongs to the noise"),
        ({"biases": ["b"], "values": {"b": 1.0}}, OptionError, "leave one out"),
        ({"values": {"K": 1.0}}, ModelError, "not a parameter.*Did you mean 'k'"),
        ({"values": {"k": "much"}}, OptionError, "value of 'k' is 'much'"),
        ({"values": 3.0}, OptionError, "by parameter"),
        ({"tolerances": {"z": 1.0}}, OptionError, "not an output"),
        ({"tolerances": {"x": 0.0}}, OptionError, "positive"),
        ({"tolerances": 0.1}, OptionError, "by output"),
    ],
)
def test_options_that_cannot_be_right(fit: ph.Fit, options: Any, error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        fit.validate(record(1), **options)


def test_a_record_of_other_channels_is_refused(fit: ph.Fit) -> None:
    t = np.linspace(0, 1, 20)
    other = ph.Experiment(t, {"w": t}, {"x": t, "y": t}, name="elsewhere")
    with pytest.raises(DataError, match=r"'elsewhere' lacks .*input 'u', output 'v'\. There are: w, x, y"):
        fit.validate(other)
    with pytest.raises(DataError, match="validate: data is an Experiment"):
        fit.validate({"t": t})  # type: ignore[arg-type]


def test_a_record_that_is_too_short_is_refused(fit: ph.Fit) -> None:
    short = record(1, n=2)
    with pytest.raises(DataError, match="too short: it has 2 samples, and 2 initial states and 1 biases"):
        fit.validate(short)
    assert fit.validate(record(1, n=4), biases=()).degrees_of_freedom == 6


def test_a_parameter_of_each_experiment_that_is_no_bias_needs_a_value() -> None:
    m = ph.Model("trim")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    a, x0 = m.parameters(a=1.0, x0=Parameter(per_experiment=True))
    m.dynamics(x=-a * x + u + x0)
    m.outputs(x=x)

    def run(name: str, trim: float) -> ph.Experiment:
        t = np.linspace(0, 10, 100)
        e = ph.Experiment(t, {"u": np.sign(np.sin(t))}, name=name)
        path = ph.simulate(m, {"a": 1.3, "x0": trim}, e, initial={"x": 0.0})
        return e.with_outputs({"x": path.outputs["x"] + 0.01 * np.cos(41 * t)})

    fit = ph.estimate(m, [run("one", 0.2), run("two", -0.1)])
    with pytest.raises(ModelError, match=r"its own 'x0'.*values=\{'x0': \.\.\.\}.*biases=\['x0'\]"):
        fit.validate(run("three", 0.4))
    given, freed = fit.validate(run("three", 0.4), values={"x0": 0.4}), fit.validate(run("three", 0.4), biases=["x0"])
    assert given.fixed["x0"] == 0.4 and freed.re_estimated.names == ("x0",)
    assert abs(freed.re_estimated["x0"].value - 0.4) < 0.01 < freed.log_likelihood - given.log_likelihood + 0.02
    with pytest.raises(ModelError, match="Say 'x0', for all"):
        fit.validate(run("three", 0.4), biases=["x0[three]"])


def test_the_record_of_the_fit_is_warned_of(fit: ph.Fit) -> None:
    own, more = record(1000, "first"), record(1, n=180)
    tail = {n: np.concatenate([own.output(n), more.output(n)[120:]]) for n in SIGMA}
    u = np.concatenate([own.input("u"), more.input("u")[120:]])
    longer = ph.Experiment(more.t, {"u": u}, tail, name="longer")
    for e, text in (
        (own, "experiment 'first' is the record 'first' that the fit was made on"),
        (own.window(5.0, 8.0, name="part"), "'part' is part of the record 'first'"),
        (longer, "'longer' shares 120 samples with the record 'first'"),
    ):
        (warning,) = fit.validate(e).warnings
        assert text in warning
    # The same input at the same times is another record, if one that a constant would match better.
    (warning,) = fit.validate(own.with_outputs(record(1).outputs, name="again")).warnings
    assert "the fit was made on" not in warning


def test_a_fit_that_has_not_converged_is_warned_of() -> None:
    fit = ph.estimate(oscillator(), record(1000, "first"), solver=ph.Newton(max_iterations=1))
    assert not fit.converged
    v = fit.validate(record(1))
    assert v.converged and fit.status in v.warnings[0] and "not converged" in v.warnings[0]
    assert f"Warning: {v.warnings[0]}" in v.summary()


def test_a_saved_fit_validates_alike(fit: ph.Fit, tmp_path: Path) -> None:
    fit.save(tmp_path / "fit.json")
    loaded = ph.load(tmp_path / "fit.json").validate(record(1))
    assert loaded.log_likelihood == pytest.approx(fit.validate(record(1)).log_likelihood, abs=1e-9)


# What is shown


def test_an_output_without_measurements_is_named(fit: ph.Fit) -> None:
    assert ph.match(fit.records, "v").rms == ph.match(fit.records[0], "v").rms == fit.records[0].rms()["v"]
    with pytest.raises(KeyError, match="'first' has no measured 'V'. Did you mean 'v'"):
        ph.match(fit.records, "V")


def test_summary_says_it_in_words(fit: ph.Fit) -> None:
    printed = fit.validate(record(1, bias=0.5), biases=(), tolerances={"v": 0.25}).summary()
    text = re.sub("\n  (?! )", " ", printed)  # lines that were broken
    assert "validated on    'other': 240 measured values" in text
    assert "fitted to       'first'" in text and "fixed           k, c, b" in text
    assert "of the samples lie within ±0.25 m/s; the error is mostly a constant offset" in text
    assert "x: RMS is" in text and "its residuals are not significantly coloured" in text
    assert max(map(len, printed.split("\n"))) < 140


def test_plot_shows_the_bands(fit: ph.Fit) -> None:
    e = _gaps(record(1))
    v = fit.validate(e, tolerances={"v": 0.2, "x": 40.0})
    figure, axes = v.plot("other")
    assert list(axes) == ["x", "x residual", "v", "v residual", "u"]
    there = np.isfinite(e.output("v"))
    vertices = np.concatenate([band.get_paths()[0].vertices for band in axes["v"].collections])
    for side in (-0.2, 0.2):
        for t, z in zip(e.t[there], e.output("v")[there] + side, strict=True):
            assert np.hypot(*(vertices - [t, z]).T).min() < 1e-9
    # The gap of 2 s splits the band.
    assert len(axes["v"].collections) == 2
    dashed = [line.get_ydata()[0] for line in axes["v residual"].get_lines() if line.get_linestyle() == "--"]
    assert dashed == [-0.2, 0.2]
    # One far away is no reason to flatten the residuals, nor the panel.
    assert axes["x residual"].get_ylim()[1] < 1.0 and axes["x"].get_ylim()[1] < 5.0
    assert "tolerance" in [text.get_text() for text in figure.legends[0].get_texts()]
    assert not v.plot(0, ["x"])[1].keys() - {"x", "x residual"}


# Flight records

needs_attas = pytest.mark.skipif(
    not all(find(name) for name in attas.RECORDS), reason=f"the records {', '.join(attas.RECORDS)} are not there"
)


@needs_attas
def test_attas_record_one_on_record_two() -> None:
    first, second = attas.records()
    own, there = attas.estimate(first), attas.estimate(second)
    v = own.validate(second, biases=["Z0", "M0", "b_az"], tolerances={"alpha": math.radians(1.5)})
    assert v.converged and not v.warnings
    assert all(m.r_squared > 0.99 and m.theil_about_mean < 0.05 for m in v.matches.values())
    assert v.matches["alpha"].inside == 1.0
    # The best that the second record allows is its own fit, at noise of the same size.
    same_noise = Gaussian({n: own.parameters[f"sigma_{n}"].value for n in attas.OUTPUTS})
    best = ph.estimate(attas.model(), second, noise=same_noise, start=there)
    assert v.log_likelihood < best.log_likelihood
    for name in ("Z0", "M0", "b_az"):
        assert abs(v.re_estimated[name].value - there.parameters[name].value) < 0.05
    # Flight residuals are coloured, and the test says so.
    assert all(m.lag_one > 0.5 and m.whiteness < 1e-3 for m in v.matches.values())


@needs_attas
def test_attas_asks_for_the_trim_of_the_other_record() -> None:
    first, second = attas.records()
    fit = attas.estimate([first, second])
    with pytest.raises(ModelError, match="own 'Z0', 'M0'"):
        fit.validate(first.window(0.4, 10.0, name="third"))


@pytest.mark.skipif(find(hfb320.RECORD) is None, reason=f"the record {hfb320.RECORD} is not there")
def test_hfb320_second_half_of_the_record() -> None:
    path = find(hfb320.RECORD)
    assert path
    data = hfb320.experiment(path)
    fit = ph.estimate(hfb320.model(), data.window(0, 25, "first half"))
    v = fit.validate(data.window(25.1, 60, "second half"))
    assert v.converged and not v.warnings and v.re_estimated.names == ("b_q", "b_aq", "b_ax", "b_az")
    # Angle of attack and pitch rate hold; pitch attitude, which integrates the rate's error, drifts off.
    sizes = {n: m.rms / m.sigma for n, m in v.matches.items()}
    assert sizes["alpha"] < 1 and sizes["q"] < 1 < 3 < sizes["theta"]
    assert v.matches["theta"].bias > 0.5


def test_no_length_of_record_is_infeasible() -> None:
    """A state that nothing measures starts at a constant: its mean over many points has rounding errors, which were
    taken for the unit of the state."""
    m = ph.Model("resonance")
    x, v = m.states("x v")
    (u,) = m.inputs("u")
    k, c = m.parameters(k=1.9e5, c=43.0)
    m.dynamics(x=v, v=k * (u - x) - c * v)
    m.outputs(y=x)
    random = np.random.default_rng(0)

    def made(n: int) -> ph.Experiment:
        t = np.arange(n) / 610.35
        u = np.convolve(random.standard_normal(n), np.ones(8) / 8, "same")
        system = [[0, 1], [-1.9e5, -43.0]], [[0], [1.9e5]], [[1, 0]], [[0]]
        _, y, _ = lsim(system, u, t)
        return ph.Experiment(t, {"u": u}, {"y": y + 1e-3 * random.standard_normal(n)})

    fit = ph.estimate(m, made(2000))
    for n in (1000, 10_000, 15_000, 20_000):
        result = fit.validate(made(n))
        assert result.status == "converged"
        assert 0.9e-3 < result.matches["y"].rms < 1.1e-3


def test_progress_is_that_of_an_estimation(fit: ph.Fit, capsys: pytest.CaptureFixture[str]) -> None:
    other = record(1)
    lines: list[ph.results.Iteration] = []
    assert fit.validate(other, progress=lines.append).converged
    assert [line.number for line in lines] == list(range(len(lines))) and len(lines) > 1
    fit.validate(other, progress=True)
    assert "iteration" in capsys.readouterr().err
    for call in (fit.validate, fit.prediction_bands):
        with pytest.raises(ph.OptionError, match="progress is True, False or a function, not 'yes'"):
            call(other, progress="yes")
