"""The Newton solver against Ipopt on the real records, from many starts, and in hard cases."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import hfb320
import numpy as np
import pytest
import unstable_aircraft
from records import find

import phugoid as ph
from phugoid import Collocation, EvaluationError, Experiment, Fit, Ipopt, Model, Newton, OptionError, Parameter

T = np.linspace(0.0, 10.0, 201)
U = np.sign(np.sin(1.3 * T))


def flight(example: Any) -> tuple[Model, Experiment]:
    path = find(example.RECORD)
    if path is None:
        pytest.skip(f"the record {example.RECORD} is neither in $PHUGOID_DATA nor in ../shared/data")
    return example.model(), example.experiment(path)


def lag_response(a: float = 1.0) -> np.ndarray:
    """Of x' = a (u - x) to U held between samples, with noise."""
    x = np.zeros(T.size)
    for i in range(T.size - 1):
        decay = np.exp(-a * (T[i + 1] - T[i]))
        x[i + 1] = x[i] * decay + (1 - decay) * U[i]
    return x + 0.05 * np.random.default_rng(0).standard_normal(T.size)


def lag(rate: Callable[..., Any], parameters: dict[str, Any]) -> Model:
    """x' = rate(parameters) (u - x), x measured."""
    m = Model("lag")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    m.dynamics(x=rate(*m.parameters(**parameters)) * (u - x))
    m.outputs(x=x)
    return m


def estimate(m: Model, **options: Any) -> Fit:
    data = Experiment(T, dict.fromkeys(m.input_names, U), {"x": lag_response()})
    return ph.estimate(m, data, **options)


# ---------------------------------------------------------------- the same as Ipopt


@pytest.mark.parametrize("example", [hfb320, unstable_aircraft], ids=lambda e: e.__name__)
@pytest.mark.parametrize("order", [2, 4])
def test_optimum_and_standard_errors_are_those_of_ipopt(example: Any, order: int) -> None:
    model, data = flight(example)
    ours, other = (
        ph.estimate(model, data, transcription=Collocation(order=order), solver=s) for s in (Newton(), Ipopt())
    )
    assert (ours.status, other.status) == ("converged", "converged")
    for name, estimate in ours.parameters.items():
        assert estimate.value == pytest.approx(other.parameters[name].value, rel=1e-8)
        assert estimate.std_error == pytest.approx(other.parameters[name].std_error, rel=1e-6)
    assert ours.log_likelihood == pytest.approx(other.log_likelihood, abs=1e-7)
    assert ours.iterations <= 14


@pytest.mark.parametrize("order", [2, 3, 4, 5, 8])
@pytest.mark.parametrize("regression", [True, False])
def test_hfb320_converges_at_any_order(order: int, regression: bool) -> None:
    model, data = flight(hfb320)
    fit = ph.estimate(model, data, transcription=Collocation(order=order), solver=Newton(regression=regression))
    assert fit.converged
    assert fit.iterations <= 10


def test_hfb320_random_starts_of_the_paper_reach_the_published_optimum() -> None:
    """The first 40 of the 1,000 that `benchmarks/random_starts.py` runs, no regression."""
    model, data = flight(hfb320)
    reference = Path(find(hfb320.RECORD) or "").parents[1] / "reference" / "optima.json"
    if not reference.is_file():
        pytest.skip("the reference optima.json is not there")
    case = json.loads(reference.read_text())["hfb320"]
    for seed in range(40):
        random = np.random.RandomState(seed)
        start = {name: random.uniform(*limits) for name, limits in case["random_starts"]["ranges"].items()}
        fit = ph.estimate(model, data, transcription=Collocation(order=2), start=start, solver=Newton(regression=False))
        worst = max(abs(fit.parameters[name].value - value) for name, value in case["parameters"].items())
        assert fit.converged, seed
        assert worst <= 1e-5, seed


# ---------------------------------------------------------------- what it reports


def test_a_fit_tells_what_it_cost() -> None:
    fit = estimate(lag(lambda a: a, {"a": 0.3}))
    assert fit.converged
    assert fit.solution is not None
    counts = fit.solution.evaluations
    # The regression takes Gauss-Newton Hessians, too.
    assert 0 < counts["factorizations"] <= counts["hessian"] + counts["gauss_newton"]
    assert fit.solution.flops > 0
    assert [line.number for line in fit.history] == list(range(fit.iterations + 1))
    # What is left to gain falls below the square of the tolerance.
    assert fit.history[-1].dual < 1e-8 < fit.history[0].dual


def test_a_fit_is_a_warm_start() -> None:
    m = lag(lambda a: a, {"a": 0.3})
    again = estimate(m, start=estimate(m))
    assert (again.status, again.iterations) == ("converged", 0)


def test_the_exact_hessian_alone_finds_the_same() -> None:
    m = lag(lambda a: a, {"a": 0.7})
    one, other = estimate(m), estimate(m, solver=Newton(gauss_newton=False))
    assert other.converged
    assert other.parameters["a"].value == pytest.approx(one.parameters["a"].value, rel=1e-9)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"max_iterations": -1}, "max_iterations is a whole number from 0, not -1"),
        ({"max_iterations": 2.5}, "max_iterations is a whole number from 0, not 2.5"),
        ({"tolerance": 0}, "tolerance is a number between 0 and 1, not 0"),
        ({"tolerance": "tight"}, "tolerance is a number between 0 and 1, not 'tight'"),
        ({"time_limit": -1}, "time_limit is a number of seconds from 0, or None, not -1"),
        ({"time_limit": float("nan")}, "time_limit is a number of seconds from 0, or None, not nan"),
        ({"regression": "yes"}, "regression is True, False or None, not 'yes'"),
    ],
)
def test_wrong_options_are_refused(options: dict[str, Any], words: str) -> None:
    with pytest.raises(OptionError, match=f"Newton: {words}"):
        Newton(**options)


# ---------------------------------------------------------------- hard cases


@pytest.mark.parametrize("solver", [Newton(), Newton(regression=False), Newton(gauss_newton=False)])
@pytest.mark.parametrize("rate", [lambda a, b: a + b, lambda a, b: a * b], ids=["sum", "product"])
def test_parameters_that_trade_off_are_named(rate: Callable[..., Any], solver: Newton) -> None:
    fit = estimate(lag(rate, {"a": 0.5, "b": 0.3}), solver=solver)
    assert fit.status == "unidentifiable"
    # That the scale of a product is free shows in the equations alone, before the fit.
    product = rate(2.0, 3.0) == 6.0
    assert fit.message.endswith("(a, b: one scale is free)" if product else "(a, b)")
    assert product or any("a, b cannot be distinguished" in w for w in fit.warnings)
    assert np.isnan(fit.parameters["a"].std_error)
    # What they are together is known well, and so is the noise.
    together = rate(fit.parameters["a"].value, fit.parameters["b"].value)
    assert together == pytest.approx(0.978, abs=0.01)
    assert fit.parameters["sigma_x"].value == pytest.approx(0.051, abs=0.002)
    assert fit.parameters["sigma_x"].std_error == pytest.approx(0.051 / np.sqrt(2 * T.size), rel=0.05)


def test_a_parameter_without_influence_is_named() -> None:
    m = Model("lag with a second input that stands still")
    (x,) = m.states("x")
    u, v = m.inputs("u", "v")
    a, b = m.parameters(a=0.5, b=0.3)
    m.dynamics(x=a * (u - x) + b * v)
    m.outputs(x=x)
    fit = ph.estimate(m, Experiment(T, {"u": U, "v": 0 * U}, {"x": lag_response()}))
    assert fit.status == "unidentifiable"
    assert fit.message.endswith("(b)")
    assert fit.parameters["b"].value == 0.3
    assert fit.parameters["a"].std_error == pytest.approx(0.0085, rel=0.1)


def test_a_state_that_nothing_tells_of_is_named() -> None:
    m = Model("lag, and another that nobody sees")
    x, y = m.states("x", "y")
    (u,) = m.inputs("u")
    (a,) = m.parameters(a=0.5)
    m.dynamics(x=a * (u - x), y=-y)
    m.outputs(x=x)
    fit = estimate(m)
    assert fit.status == "unidentifiable"
    assert "y at t = 0 of" in fit.message
    assert fit.parameters["a"].std_error == pytest.approx(0.0085, rel=0.1)


def test_a_bound_that_binds_is_reported() -> None:
    fit = estimate(lag(lambda a: a, {"a": Parameter(5.5, bounds=(5, 6))}))
    assert fit.converged
    assert (fit.parameters["a"].value, fit.parameters["a"].bounds_active) == (5.0, "lower")


def test_the_domain_of_a_function_is_not_left_for_good() -> None:
    fit = estimate(lag(ph.log, {"a": 40.0}), solver=Newton(regression=False))
    assert fit.converged
    assert fit.parameters["a"].value == pytest.approx(np.exp(0.9785), rel=1e-3)


def test_a_start_outside_the_domain_says_which_equation() -> None:
    with pytest.raises(EvaluationError, match="equation of x' is not finite .* log"):
        estimate(lag(ph.log, {"a": -1.0}))


def test_a_hopeless_model_ends_with_a_status_in_no_time() -> None:
    m = Model("explosion")
    x, y = m.states("x", "y")
    (u,) = m.inputs("u")
    a, b = m.parameters(a=1.0, b=2.0)
    m.dynamics(x=ph.sin(1e3 * a * y) * x, y=b * x * y + u)
    m.outputs(x=x)
    alone = estimate(m, solver=ph.Newton(max_iterations=199))  # no other way is tried
    assert alone.status in ("infeasible", "failed", "iteration limit", "diverging")
    fit = estimate(m)
    assert fit.time < 20
    assert np.isfinite([e.value for e in fit.parameters.values()]).all()
    assert not any("cannot be distinguished" in w for w in fit.warnings)  # it is not the data's fault
