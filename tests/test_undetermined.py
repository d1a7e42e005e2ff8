"""What the data leave open has no standard error: every parameter and initial state of a trade is named."""

from typing import Any

import numpy as np
import pytest

import phugoid as ph

T = np.arange(0.0, 15.0, 0.05)


def pitch(**priors: Any) -> ph.Model:
    """Pitch motion with a bias of its attitude."""
    m = ph.Model("pitch")
    q, theta = m.states(q="rad/s", theta="rad")
    (de,) = m.inputs(de="rad")
    Mq, Mde, b = m.parameters(Mq=-1.0, Mde=-1.0, b=ph.Parameter(0.0, unit="rad", **priors))
    m.dynamics(q=Mq * q + Mde * de, theta=q)
    m.outputs(q=q, theta=theta + b)
    return m


def yaw(**options: Any) -> ph.Model:
    """Weathercock motion, its vane with a bias that trades off with the trims; sizes differ by orders of magnitude."""
    m = ph.Model("yaw")
    beta, r = m.states(beta="rad", r="rad/s")
    (dr,) = m.inputs(dr="rad")
    Y0, Yb, N0, Nb, Nr, Ndr, b = m.parameters(
        Y0=0.0, Yb=0.0, N0=ph.Parameter(0.0, **options), Nb=0.0, Nr=0.0, Ndr=0.0, b=0.0
    )
    m.dynamics(beta=(Y0 + Yb * beta) - r, r=0.01 * (N0 + Nb * beta) + Nr * r + Ndr * dr)
    m.outputs(beta=beta + b, r=r, ay=(100.0 * (Y0 + Yb * beta), "m/s²"))
    return m


def flown(m: ph.Model, truth: dict[str, float], noise: float, **start: float) -> ph.Experiment:
    (name,) = m.input_names
    run = ph.Experiment(T, {name: 0.1 * np.sign(np.sin(1.5 * T)) * (T > 1)}, name="run")
    path = ph.simulate(m, truth, run, initial=start)
    random = np.random.default_rng(0)
    return run.with_outputs({n: y + noise * random.standard_normal(T.size) for n, y in path.outputs.items()})


@pytest.fixture(scope="module")
def weathercock() -> ph.Experiment:
    truth = {"Y0": 0.02, "Yb": -0.3, "N0": 0.0, "Nb": 400.0, "Nr": -0.5, "Ndr": -2.0, "b": 0.01}
    return flown(yaw(), truth, 1e-3, beta=0.0, r=0.0)


def test_a_bias_and_the_first_state_that_it_hides_are_both_named() -> None:
    m = pitch()
    run = flown(m, {"Mq": -2.0, "Mde": -6.0, "b": 0.1}, 2e-3, q=0.0, theta=0.1)
    fit = ph.estimate(m, run)
    assert fit.status == "unidentifiable"
    (warning,) = fit.warnings
    assert warning.startswith("b, theta at t = 0 of 'run' cannot be distinguished")
    assert np.isnan(fit.parameters["b"].std_error)
    assert np.isnan(fit.initial_states["run"]["theta"].std_error)
    # Their sum is known, and what has no part in it has its error.
    assert fit.parameters["b"].value + fit.initial_states["run"]["theta"].value == pytest.approx(0.2, abs=2e-3)
    assert abs(fit.parameters["Mq"].value + 2.0) < 4 * fit.parameters["Mq"].std_error
    assert fit.initial_states["run"]["q"].std_error > 0


def test_all_that_trade_off_are_named_whatever_their_sizes(weathercock: ph.Experiment) -> None:
    fits = [ph.estimate(yaw(), weathercock, start={"b": b}) for b in (-0.03, 0.03)]
    assert fits[0].log_likelihood == pytest.approx(fits[1].log_likelihood, abs=1e-4)
    for name, (one, other) in ((n, [f.parameters[n] for f in fits]) for n in fits[0].parameters):
        if np.isnan(one.std_error):
            assert name in fits[0].message
        else:
            # Where a standard error is told, another start leads to the same estimate.
            assert abs(one.value - other.value) < 0.05 * one.std_error, name
    assert {n for n, p in fits[0].parameters.items() if np.isnan(p.std_error)} == {"Y0", "N0", "b"}
    assert np.isnan(fits[0].initial_states["run"]["beta"].std_error)


def test_holding_one_of_them_gives_errors_to_all_others(weathercock: ph.Experiment) -> None:
    fit = ph.estimate(yaw(fixed=True), weathercock)
    assert fit.status == "converged"
    for name, true in {"Y0": 0.02, "Yb": -0.3, "Nb": 400.0, "b": 0.01}.items():
        assert abs(fit.parameters[name].value - true) < 4 * fit.parameters[name].std_error, name


def test_a_parameter_without_influence_drags_no_other_along() -> None:
    m = pitch()
    run = flown(m, {"Mq": -2.0, "Mde": -6.0, "b": 0.1}, 2e-3, q=0.0, theta=0.1)
    silent = ph.Experiment(run.t, {"de": np.zeros(T.size)}, dict(run.outputs), name="no input")
    fit = ph.estimate(pitch(fixed=True), silent)
    assert fit.message.endswith("(Mde)")
    assert any(w.startswith("Mde has no influence") for w in fit.warnings)
    assert fit.parameters["Mq"].std_error > 0
