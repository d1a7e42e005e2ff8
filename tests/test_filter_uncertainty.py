"""Profiles, bootstrap and bands of fits with process noise."""

from __future__ import annotations

import numpy as np
import pytest

import phugoid as ph

H, N = 0.1, 150
RATE, GAIN, Q, SIGMA = -0.8, 1.5, 0.4, 0.1
METHOD = ph.FilterError("x")


def model(bias: bool = False, a: ph.Parameter | float = 0.0) -> ph.Model:
    """One state after an input; with ``bias`` its sensor is off by a constant of each experiment."""
    m = ph.Model("first order")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    rate, gain = m.parameters(a=a, b=0.0)
    m.dynamics(x=rate * x + gain * u)
    if bias:
        (off,) = m.parameters(off=ph.Parameter(0.0, per_experiment=True, prior=(0.0, 1.0)))
        m.outputs(y=x + off, z=2.0 * x)
    else:
        m.outputs(y=x)
    return m


def flown(
    seed: int, rate: float = RATE, answer: float = 0.0, off: float | None = None
) -> tuple[ph.Experiment, np.ndarray]:
    """A record and the true state at its samples; ``answer`` feeds the state back to the input."""
    random = np.random.default_rng(seed)
    t = H * np.arange(N)
    reference = np.sign(np.sin(0.9 * t))
    phi = np.exp(rate * H)
    hold, spread = (phi - 1) / rate, Q * np.sqrt((phi**2 - 1) / (2 * rate))
    ramp = (hold - H) / (rate * H)
    x, u = np.zeros(N), np.zeros(N)
    u[0] = reference[0]
    for k in range(N - 1):
        u[k + 1] = reference[k + 1] - answer * x[k]
        forced = GAIN * (hold * u[k] + ramp * (u[k + 1] - u[k]))
        x[k + 1] = phi * x[k] + forced + spread * random.standard_normal()
    outputs = {"y": x + (off or 0.0) + SIGMA * random.standard_normal(N)}
    if off is not None:
        outputs["z"] = 2.0 * x + SIGMA * random.standard_normal(N)
    return ph.Experiment(t, {"u": u}, outputs, name=f"run {seed}"), x


@pytest.fixture(scope="module")
def fit() -> ph.Fit:
    found = ph.estimate(model(), flown(1)[0], transcription=METHOD)
    assert found.converged
    return found


def test_profile_of_the_marginal_likelihood(fit: ph.Fit) -> None:
    profiles = fit.profile("a")
    one = profiles["a"]
    assert one.ends == ("found", "found")
    # At its ends, a fit with the parameter held there has lost what chance allows.
    for end in one.interval:
        held = model(a=ph.Parameter(end, fixed=True))
        there = ph.estimate(held, fit.experiments, transcription=fit.transcription)
        assert fit.log_likelihood - there.log_likelihood == pytest.approx(one.threshold, rel=5e-3)
    error = fit.parameters["a"].std_error
    assert 3.0 * error < one.interval[1] - one.interval[0] < 5.5 * error


def test_bootstrap_draws_process_noise_anew(fit: ph.Fit) -> None:
    found = fit.bootstrap(60, seed=3)
    assert found.kind == "parametric" and found.failed <= 2
    for name in ("a", "b", "q_x", "sigma_y"):
        ratio = found.std_errors[name] / fit.parameters[name].std_error
        assert 0.7 < ratio < 1.5, (name, ratio)  # of 60 draws: 9 % by chance
    again = fit.bootstrap(3, seed=3)
    np.testing.assert_array_equal(again.estimates, found.estimates[:3])


def test_bootstrap_of_draws_with_the_statistics_of_the_model(fit: ph.Fit) -> None:
    """Many draws about one input: the variance of the state at the end is that of the equations."""
    from phugoid.uncertainty.bootstrap import ProcessNoiseResampler

    drawn = ProcessNoiseResampler.of(fit)
    random = np.random.default_rng(0)
    last = np.array([drawn.draw(random)[0]["y"][-1] for _ in range(400)])
    p = {n: e.value for n, e in fit.parameters.items()}
    expected = p["q_x"] ** 2 / (-2 * p["a"]) + p["sigma_y"] ** 2  # stationary by then
    assert last.var() == pytest.approx(expected, rel=0.2)  # 7 % by chance


def test_an_unstable_vehicle_is_not_simulated_without_its_controller() -> None:
    closed = ph.estimate(model(), flown(2, rate=0.9, answer=1.5)[0], transcription=METHOD)
    assert closed.converged and closed.parameters["a"].value > 0.3
    with pytest.raises(ph.errors.OptionError, match="times as far as in the record.*Use profile"):
        closed.bootstrap(5)
    assert closed.profile("a")["a"].ends == ("found", "found")


@pytest.mark.parametrize("kind", ["coloured", "block"])
def test_kinds_for_coloured_residuals_are_refused(fit: ph.Fit, kind: str) -> None:
    with pytest.raises(ph.errors.OptionError, match=r"innovations are white.*kind=\"parametric\""):
        fit.bootstrap(2, kind)  # type: ignore[arg-type]
    with pytest.raises(ph.errors.OptionError, match="innovations are white"):
        fit.profile("a", coloured=True)


def test_bands_hold_the_true_outputs(fit: ph.Fit) -> None:
    inside, measured, without = [], [], []
    for seed in range(20):
        e, x = flown(100 + seed)
        here = ph.estimate(model(), e, transcription=METHOD)
        bands = here.prediction_bands()
        low, high = bands.model["y"]
        inside.append(np.mean((low < x) & (x < high)))
        low, high = bands.measurement["y"]
        again = x + SIGMA * np.random.default_rng(seed).standard_normal(x.size)
        measured.append(np.mean((low < again) & (again < high)))
        # Parameters add to what the smoother leaves open.
        without.append(np.mean(here.records[0].state_std["x"] / bands.std_errors["y"]))
        assert (bands.std_errors["y"] >= here.records[0].state_std["x"] * (1 - 1e-9)).all() and not bands.coloured
    assert 0.92 < np.mean(inside) < 0.98, np.mean(inside)
    assert 0.92 < np.mean(measured) < 0.98, np.mean(measured)
    assert np.mean(without) < 0.999


def test_bands_elsewhere(fit: ph.Fit) -> None:
    e, x = flown(7)
    bands = fit.prediction_bands(e)
    low, high = bands.model["y"]
    assert 0.88 < np.mean((low < x) & (x < high)) <= 1.0
    # On the record of the fit itself: the same as of the fit.
    own, same = fit.prediction_bands(), fit.prediction_bands(fit.experiments[0])
    np.testing.assert_allclose(same.std_errors["y"], own.std_errors["y"], rtol=1e-4)
    _ = fit.prediction_bands().plot()


def test_biases_found_anew_follow_the_parameters() -> None:
    """With a bias on an output: bands there are wider, by the bias, than of what has none."""
    found = ph.estimate(model(bias=True), [flown(1, off=0.2)[0], flown(2, off=-0.1)[0]], transcription=METHOD)
    assert found.converged
    own = found.prediction_bands("run 1")
    e, _ = flown(3, off=0.3)
    bands = found.prediction_bands(e)
    alone = ph.estimate(model(bias=True), e, transcription=METHOD)
    assert bands.std_errors["y"].mean() == pytest.approx(own.std_errors["y"].mean(), rel=0.1)
    # The bias alone is known to about the noise of both outputs over the root of their number.
    error = alone.parameters["off"].std_error
    assert 0.5 * error < bands.std_errors["y"].min() < 3.0 * error + bands.std_errors["z"].max()


def test_a_fit_that_did_not_converge_has_none() -> None:
    short = ph.estimate(model(), flown(1)[0], transcription=ph.FilterError("x", max_iterations=1))
    assert not short.converged
    for call in (short.prediction_bands, short.bootstrap, short.profile):
        with pytest.raises(ph.errors.OptionError, match="has not converged"):
            call()


def test_misfit_and_validation_ask_innovations(fit: ph.Fit) -> None:
    """Of a path that follows the measurements, residuals are small whatever the model."""
    record = fit.records[0]
    rms = float(np.sqrt(np.mean(record.innovations["y"] ** 2)))
    assert ph.misfit(fit).channels["y"].rms == pytest.approx(rms, rel=1e-6)
    assert rms > 1.2 * np.sqrt(np.mean(record.residuals["y"] ** 2))
    other = fit.validate(flown(9)[0])
    assert other.status == "converged" and other.matches["y"].rms == pytest.approx(rms, rel=0.3)
    with pytest.raises(ph.errors.OptionError, match="process noise explains every misfit"):
        ph.diagnose(fit)
