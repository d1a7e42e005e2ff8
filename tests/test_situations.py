"""A diagnosis of records in situations that no term of the physics describes: disturbances, faults of data, encoders.

The records are made by tests/hidden, which knows nothing of how they are looked at.
"""

from __future__ import annotations

import functools
import html

import numpy as np
import pytest
from hidden.situation import situation
from scipy.stats import multivariate_normal

import phugoid as ph
from phugoid.discrepancy.search.refit import Refit
from phugoid.residual_noise import resolution_of
from phugoid.residual_noise.whitening import Whitening
from phugoid.sensitivities import Place
from phugoid.sensitivities.tangents import collocated
from phugoid.sensitivities.whitened import RandomEffects, at_knots


@functools.cache
def diagnosed(what: str, system: str, seed: int) -> tuple[ph.Diagnosis, tuple[str, ...], dict[str, float]]:
    s = situation(what, system, seed)
    return ph.diagnose(ph.estimate(s.model, s.data), validation=s.validation), s.truth, s.sizes


@pytest.mark.parametrize(
    ("what", "system", "seed"),
    [
        ("gust", "servo", 502),
        ("gust", "uav", 501),
        ("noisy input", "servo", 503),
        ("noisy input", "lateral", 504),
        ("noisy input", "hfb320", 8100),
        ("noisy input", "duffing", 8101),
        ("event", "duffing", 505),
        ("event", "servo", 506),
        ("held input", "servo", 507),
        ("backlash", "servo", 508),
        ("rate limit", "servo", 201),
        ("rate limit", "uav", 9304),
        ("drift", "servo", 510),
        ("clipped", "duffing", 511),
        ("friction", "servo", 512),
        ("redundant", "duffing", 6101),
        ("unmeasured", "duffing", 83001),
    ],
)
def test_what_is_wrong_is_named_and_nothing_else(what: str, system: str, seed: int) -> None:
    d, truth, _ = diagnosed(what, system, seed)
    named = [f for f in d.findings if f.status == "named"]
    assert named, d.summary()
    assert all({*truth} & {f.cause, *f.aliases} for f in named), d.summary()


@pytest.mark.parametrize("what", ["white", "quantised", "growing", "outliers", "closed loop", "two rates"])
def test_nothing_is_found_where_nothing_is_wrong(what: str) -> None:
    d, _, _ = diagnosed(what, "servo", 520)
    assert not d.findings, d.summary()
    if what != "growing":  # noise that grows with the motion is not a white noise
        assert d.verdict == "nothing", d.summary()


@pytest.mark.parametrize("seed", [9304, 9308, 9311])
def test_a_fit_of_a_model_that_misses_much_converges(seed: int) -> None:
    """It crept along a ridge on which the noise of one output falls and that of the others grows."""
    s = situation("rate limit", "uav", seed)
    fit = ph.estimate(s.model, s.data)
    assert fit.converged, fit.message
    # With few iterations no other way is tried.
    assert ph.estimate(s.model, s.data, solver=ph.Newton(max_iterations=199)).status == "iteration limit"


@pytest.mark.parametrize(("system", "seed"), [("lateral", 9303), ("uav", 9304)])
def test_inputs_sampled_too_slowly_are_no_noise(system: str, seed: int) -> None:
    d, _, _ = diagnosed("coarse", system, seed)
    assert not d.found, d.summary()


@pytest.mark.parametrize("what", ["autoregressive", "pink", "random walk"])
def test_coloured_noise_of_sensors_is_no_disturbance(what: str) -> None:
    d, _, _ = diagnosed(what, "duffing", 530)
    assert not d.found, d.summary()


@pytest.mark.parametrize(
    ("system", "seed", "variable"),
    [("duffing", 7000, "v"), ("servo", 7001, "rate"), ("lateral", 7000, "r"), ("uav", 7001, "w")],
)
def test_a_term_that_no_library_has_is_shown_as_a_function(system: str, seed: int, variable: str) -> None:
    """Terms near to it were named in its place: v^3, |rate|, |r| with its sign, |w| with the scale of a sensor."""
    d, _, _ = diagnosed("outside", system, seed)
    assert not d.found and d.verdict == "unexplained", d.summary()
    (f,) = [f for f in d.findings if f.curve]
    assert f.aliases[0].endswith(f":f({variable})") and f.explained > 0.2
    extended = d.extend(minor=True)
    assert not d.extend().added and extended.added == f.aliases[:1]
    assert extended.gain.held_out > 0.0
    before, after = extended.gain.held_out_rms_before, extended.gain.held_out_rms_after
    assert sum(after[n] < before[n] for n in before) > len(before) / 2


def test_the_curve_of_an_unknown_function_is_the_function() -> None:
    """A bump in the damping of a mass: the curve and the estimated damping together are the true force."""

    def bump(v: object) -> object:
        return -0.8 * ph.exp(-(((v - 0.6) / 0.3) ** 2))

    def model(hidden: bool) -> ph.Model:
        m = ph.Model("mass")
        (u,), (x, v) = m.inputs("u"), m.states(x="m", v="m/s")
        k, c = m.parameters(k=2.0, c=0.4)
        m.dynamics(x=v, v=u - k * x - c * v + (bump(v) if hidden else 0.0))
        m.outputs(x=x, v=v)
        return m

    rng, records = np.random.default_rng(3), []
    t = np.arange(0.0, 60.0, 0.05)
    for seed in (0, 1):
        u = 1.5 * np.sin(1.1 * t + 0.013 * t**2 + seed) + np.sin(0.37 * t + 2.0 * seed)
        run = ph.simulate(
            model(True), {"k": 2.0, "c": 0.4}, ph.Experiment(t, {"u": u}, {}), initial={"x": 0.0, "v": 0.0}
        )
        y = {
            n: z + s * rng.standard_normal(t.size) for (n, z), s in zip(run.outputs.items(), (0.01, 0.02), strict=True)
        }
        records.append(ph.Experiment(t, {"u": u}, y, name=f"record {seed}"))
    d = ph.diagnose(ph.estimate(model(False), records[0]), validation=records[1])
    (f,) = d.findings
    assert f.status == "unexplained" and f.aliases[0] == "v':f(v)" and f.explained > 0.95
    v = np.array(f.curve["at"])
    seen = records[0].outputs["v"]
    inside = (v > np.quantile(seen, 0.02)) & (v < np.quantile(seen, 0.98))
    c = d.extend(minor=True).fit.parameters["c"].value
    found, truth = np.array(f.curve["value"]) - c * v, -0.8 * np.exp(-(((v - 0.6) / 0.3) ** 2)) - 0.4 * v
    assert np.abs(found - truth)[inside].max() < 0.08  # a tenth of the bump


def test_a_fit_beside_strong_gusts_converges() -> None:
    """The weight of the defects rose and fell for ever there, and two points were each better than the other."""
    s = situation("gust", "servo", 501)
    fit = ph.estimate(s.model, s.data)
    assert fit.status == "converged" and fit.iterations < 150


def test_an_event_is_told_with_its_time() -> None:
    d, _, sizes = diagnosed("event", "duffing", 505)
    (event,) = [f for f in d.findings if f.cause.endswith(":event")]
    t, size = np.array(event.curve["at"]), np.abs(event.curve["value"])
    assert t[0] - 0.5 < sizes["time"] < t[-1]
    assert t[np.argmax(size)] == pytest.approx(sizes["time"], abs=4.0)


def test_the_intensity_of_gusts_is_that_of_the_filter_error_method() -> None:
    s = situation("gust", "servo", 502)
    d, _, _ = diagnosed("gust", "servo", 502)
    f = d.findings[-1]
    assert "rate':noise" in (f.cause, *f.aliases)
    filtered = ph.estimate(s.model, s.data, transcription=ph.FilterError("rate"))
    if f.cause == "rate':noise" and f.unit == "rad/s/√s":
        assert f.coefficient == pytest.approx(filtered.parameters["q_rate"].value, rel=0.05)
    assert "FilterError" in f.advice
    # The model stays as it is: process noise is not a part of it.
    assert not d.extend().added


def test_findings_of_disturbances_are_saved_and_shown(tmp_path: object) -> None:
    d, _, _ = diagnosed("event", "servo", 506)
    d.save(f"{tmp_path}/d.json")
    (found,) = ph.load(f"{tmp_path}/d.json").findings
    (event,) = d.findings
    assert (found.cause, found.aliases, found.status) == (event.cause, event.aliases, event.status)
    assert found.curve == event.curve and found.explanation == event.explanation
    shown = [axes.get_ylabel() for figure in d.figures() for axes in figure.axes]
    assert any(label.startswith("added to") for label in shown)
    d.report(f"{tmp_path}/d.html")
    with open(f"{tmp_path}/d.html") as page:
        assert event.cause in html.unescape(page.read())


def test_a_marginal_likelihood_is_that_of_a_normal_distribution() -> None:
    """Against the density of the residuals with the covariance written out."""
    s = situation("gust", "servo", 502)
    fit = ph.estimate(s.model, s.data)
    linear = Refit((), collocated(fit)).linear
    (p,) = linear.points
    knots = np.linspace(p.t[0], p.t[-1], 30)
    answers = linear.answers(Place("equation", "rate"), [at_knots(p.t, knots)])
    index = np.arange(30)
    correlation = np.exp(-np.abs(index[:, None] - index) / 4.0)
    noise = np.array([0.02**2, 0.2**2])
    found = RandomEffects(linear, answers).with_correlation(correlation).at(0.7, noise)
    v = np.concatenate([np.full(line[-1].stop - line[0].start, n) for line, n in zip(linear.rows, noise, strict=True)])
    covariance = 0.7 * answers.T @ correlation @ answers + np.diag(v)
    root = np.linalg.cholesky(covariance)
    t, r = np.linalg.solve(root, linear.tangents), np.linalg.solve(root, linear.residuals)
    left = linear.residuals - linear.tangents @ np.linalg.lstsq(t, r, rcond=None)[0]
    expected = multivariate_normal(cov=covariance).logpdf(left) + 0.5 * left.size * np.log(2.0 * np.pi)
    assert found.log_likelihood == pytest.approx(expected, rel=1e-6)
    # With coloured noise, whitened by hand; a factor of 2 of the variance of each output.
    filter = Whitening.of(linear.residuals, linear.structure)
    e = RandomEffects(linear, answers, filter).with_correlation(correlation).at(0.7, np.array([2.0, 2.0]))
    g, rest = filter(np.ascontiguousarray(answers)), filter(linear.residuals)
    covariance = 0.7 * g.T @ correlation @ g + 2.0 * np.eye(rest.size)
    root, tangents = np.linalg.cholesky(covariance), filter(np.ascontiguousarray(linear.tangents.T)).T
    left = (
        rest - tangents @ np.linalg.lstsq(np.linalg.solve(root, tangents), np.linalg.solve(root, rest), rcond=None)[0]
    )
    expected = multivariate_normal(cov=covariance).logpdf(left) + 0.5 * left.size * np.log(2.0 * np.pi)
    expected += float(filter.log_densities(np.zeros(rest.size)).sum())
    assert e.log_likelihood == pytest.approx(expected, rel=1e-6)
    # At the maximum no other variance is likelier.
    best = RandomEffects(linear, answers).with_correlation(correlation).maximised(noise)
    for factor in (0.8, 1.25):
        other = RandomEffects(linear, answers).with_correlation(correlation).at(factor * best.variance, best.noise)
        assert other.log_likelihood < best.log_likelihood


@pytest.mark.parametrize("step", [0.1, 0.0123, 2.0 * np.pi / 2000.0])
def test_the_steps_of_an_encoder_are_seen(step: float) -> None:
    t = np.arange(0.0, 10.0, 0.01)
    z = step * np.round(10.0 * np.sin(t)) + 1.7
    assert resolution_of([z]) == pytest.approx(step, rel=1e-6)
    noise = np.random.default_rng(0).standard_normal(t.size)
    assert resolution_of([z + 1e-2 * step * noise]) == 0.0
    assert resolution_of([np.round(np.sin(t) + noise, 4)]) == 0.0  # digits of a text file
