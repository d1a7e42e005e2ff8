"""Standard deviations that are expressions of the model, and outputs that one experiment never measures."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import laplace, norm

import phugoid as ph

T = np.linspace(0.0, 4.0, 120)
TRUTH = {"k": 0.8, "a": 0.05, "b": 0.1}


def decay(**parameters: ph.Parameter) -> ph.Model:
    """A decay whose noise grows with the state, and is shared by two outputs."""
    m = ph.Model("decay")
    (x,) = m.states("x")
    start = {
        "k": ph.Parameter(0.5, transform="log"),
        "a": ph.Parameter(0.2, bounds=(1e-6, 10.0)),
        "b": ph.Parameter(0.3),
    }
    k, a, b = m.parameters(**{**start, **parameters})
    (size,) = m.quantities(size=a + b * x)
    m.dynamics(x=-k * x)
    m.outputs(y=x, z=2.0 * x)
    m.noise(y=size, z=a)
    return m


def record(seed: int = 1, name: str = "run") -> ph.Experiment:
    random = np.random.default_rng(seed)
    x = 3.0 * np.exp(-TRUTH["k"] * T)
    y = x + (TRUTH["a"] + TRUTH["b"] * x) * random.standard_normal(T.size)
    return ph.Experiment(T, outputs={"y": y, "z": 2.0 * x + TRUTH["a"] * random.standard_normal(T.size)}, name=name)


def by_hand(e: ph.Experiment, density=norm) -> tuple[np.ndarray, float]:
    """The optimum (k, a, b, x0) and its log-likelihood, without the constant, by a direct search."""

    def cost(p: np.ndarray) -> float:
        x = p[3] * np.exp(-p[0] * T)
        sigma = p[1] + p[2] * x
        if sigma.min() <= 0.0 or p[1] <= 0.0:
            return 1e10
        total = density.logpdf(e.outputs["y"], x, sigma).sum() + norm.logpdf(e.outputs["z"], 2.0 * x, p[1]).sum()
        return -float(total) - T.size * np.log(2.0 * np.pi)

    at = np.array([0.8, 0.05, 0.1, 3.0])
    for _ in range(4):
        found = minimize(cost, at, method="Nelder-Mead", options={"maxiter": 4000, "xatol": 1e-10, "fatol": 1e-11})
        at = found.x
    return at, -float(found.fun)


@pytest.mark.parametrize("transcription", [ph.Collocation(), ph.MultipleShooting(), ph.SingleShooting()])
def test_the_optimum_is_that_of_a_direct_search(transcription: object) -> None:
    e = record()
    fit = ph.estimate(decay(), e, transcription=transcription)
    at, best = by_hand(e)
    assert fit.converged
    assert fit.log_likelihood == pytest.approx(best, abs=1e-5)
    assert [fit.parameters[n].value for n in ("k", "a", "b")] == pytest.approx(at[:3].tolist(), rel=1e-3)
    assert fit.noise_parameters == frozenset()


def test_standard_errors_are_those_of_repeated_records() -> None:
    found = [ph.estimate(decay(), record(seed)).parameters for seed in range(60)]
    for name in TRUTH:
        values = np.array([p[name].value for p in found])
        told = np.mean([p[name].std_error for p in found])
        # The spread of 60 values is known to 9 %.
        assert values.std() == pytest.approx(told, rel=0.3)
        assert abs(values.mean() - TRUTH[name]) < 4.0 * told / np.sqrt(60)


@pytest.mark.parametrize("seed", [17, 23, 38])
def test_no_standard_deviation_is_led_to_zero_by_states_that_are_their_measurements(seed: int) -> None:
    e = record(seed)
    fit = ph.estimate(decay(k=ph.Parameter(0.5)), e)
    assert fit.converged
    assert fit.log_likelihood == pytest.approx(by_hand(e)[1], abs=1e-5)
    assert all(np.isfinite(p.std_error) for p in fit.parameters.values())


def test_other_densities_take_expressions_too() -> None:
    random = np.random.default_rng(5)
    x = 3.0 * np.exp(-0.8 * T)
    y = x + (0.05 + 0.1 * x) * random.laplace(size=T.size)
    e = ph.Experiment(T, outputs={"y": y, "z": 2.0 * x + 0.05 * random.standard_normal(T.size)})
    m = decay()
    a, b, x_ = (ph.Expr.symbol(n) for n in ("a", "b", "x"))
    m.noise(ph.PerOutput({"y": ph.Laplace({"y": a + b * x_}, 1e-3)}, {"z": a}))
    fit = ph.estimate(m, e)
    _, best = by_hand(e, laplace)
    assert fit.log_likelihood == pytest.approx(best, abs=0.02)  # smoothed by 1e-3


def test_the_noise_is_saved_with_model_and_fit(tmp_path) -> None:
    m, e = decay(), record()
    assert repr(ph.Model.from_json(m.to_json()).noise_model) == repr(m.noise_model)
    fit = ph.estimate(m, e)
    fit.save(tmp_path / "fit.json")
    again = ph.load(tmp_path / "fit.json")
    assert ph.estimate(again.model, e).log_likelihood == fit.log_likelihood
    assert "a + b*x" in str(again.noise) or "size" in str(again.noise)


def test_a_fit_with_noise_of_the_model_is_validated() -> None:
    fit = ph.estimate(decay(), record(1))
    again, other = fit.validate(record(1)), fit.validate(record(2, "other"))
    assert again.log_likelihood == pytest.approx(fit.log_likelihood, rel=1e-9)
    assert other.converged and set(other.matches) == {"y", "z"} and "other" in other.summary()


def test_what_cannot_be_is_refused() -> None:
    m = decay()
    with pytest.raises(ph.ModelError, match="noise of output y: symbol 'c' is not declared"):
        m.noise(y=ph.Expr.symbol("c"))
        m.check()
    with pytest.raises(ph.ModelError, match="correlated noise has all of them known"):
        ph.Gaussian({"y": ph.Expr.symbol("a")}, correlated=True)
    with pytest.raises(ph.ModelError, match="sigma_y is given by an expression"):
        ph.estimate(decay(), record(), start={"sigma_y": 0.1})
    with pytest.raises(ph.OptionError, match="FilterError: the standard deviation of 'y' is an expression"):
        ph.estimate(decay(), record(), transcription=ph.FilterError(states=["x"]))
    with pytest.raises(ph.OptionError, match="standard deviation of 'y' changes along the record"):
        ph.estimate(decay(), record()).robust()


def test_an_output_that_one_experiment_never_measures() -> None:
    e, other = record(1, "both"), record(2, "only y")
    m = decay()
    m.noise(ph.Gaussian())
    m = m.with_terms({"y:y": ph.Expr.symbol("a"), "y:z": ph.Expr.symbol("b")})
    left_out = ph.Experiment(T, outputs={"y": other.outputs["y"]}, name="only y")
    fit = ph.estimate(m, [e, left_out])
    missing = ph.Experiment(T, outputs={"y": other.outputs["y"], "z": np.where(T[3] == T, 1.0, np.nan)}, name="only y")
    almost = ph.estimate(m, [e, missing])
    assert fit.converged and any("'only y' without z" in w for w in fit.warnings)
    assert np.isnan(fit.records[1].residuals["z"]).all()
    # One sample of z more moves the estimate, but not far.
    assert 0.0 < abs(fit.parameters["k"].value - almost.parameters["k"].value) < 2.0 * fit.parameters["k"].std_error
    with pytest.raises(ph.DataError, match="experiment 'none' has no output 'y'"):
        ph.estimate(m, [e, ph.Experiment(T, outputs={"w": T}, name="none")])
