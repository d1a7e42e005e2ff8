"""simulate: against solutions in closed form, against a fit, and where there is no solution."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import phugoid as ph
from phugoid import Collocation, DataError, EvaluationError, Experiment, Expr, Gaussian, Model, ModelError, OptionError
from phugoid.results import Record

T = np.linspace(0.0, 4.0, 41)


def lag() -> Model:
    m = Model("lag")
    (x,) = m.states(x="m")
    (u,) = m.inputs(u="V")
    tau, gain = m.parameters(tau=1.0, gain=1.0)
    m.dynamics(x=(gain * u - x) / tau)
    m.outputs(x=x, rate=((gain * u - x) / tau, "m/s"))
    return m


def model(f: Callable[..., Any], g: Callable[..., Any] | None = None) -> Model:
    """x' = f(x, u, a), y = g(x, u, a) or x."""
    m = Model("trial")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    (a,) = m.parameters("a")
    m.dynamics(x=f(x, u, a))
    m.outputs(y=g(x, u, a) if g else x)
    return m


def run(u: Any = 0.0, t: np.ndarray = T, **options: Any) -> Experiment:
    return Experiment(t, {"u": np.broadcast_to(u, t.shape)}, name="run", **options)


def simulate(m: Model, a: float, data: Experiment, **options: Any) -> Record:
    return ph.simulate(m, {"a": a}, data, **options)


# ---------------------------------------------------------------- against closed forms


def test_response_to_a_ramp() -> None:
    tau, gain = 0.7, 2.0
    r = ph.simulate(lag(), {"tau": tau, "gain": gain}, run(T), initial={"x": 0.3})
    x = gain * (T - tau) + (0.3 + gain * tau) * np.exp(-T / tau)
    np.testing.assert_allclose(r.states["x"], x, rtol=0, atol=1e-9)
    np.testing.assert_allclose(r.outputs["rate"], (gain * T - x) / tau, rtol=0, atol=2e-9)


def test_inputs_run_straight_between_samples() -> None:
    t = np.array([0.0, 1.0, 3.0, 4.0])
    r = simulate(model(lambda x, u, a: a * u), 1.0, run([0.0, 2.0, -2.0, 1.0], t))
    np.testing.assert_allclose(r.outputs["y"], [0.0, 1.0, 1.0, 0.5], rtol=0, atol=1e-9)


def test_inputs_run_as_a_cubic_where_the_experiment_says_so() -> None:
    t = np.array([0.0, 1.0, 3.0, 4.0])
    r = simulate(model(lambda x, u, a: a * u), 1.0, run(t**3, t, interpolation="cubic"))
    np.testing.assert_allclose(r.outputs["y"], t**4 / 4, rtol=1e-9)


@pytest.mark.parametrize("begin", [0.0, -7.0])
def test_time_enters_and_need_not_start_at_zero(begin: float) -> None:
    m = Model("clock")
    (x,) = m.states("x")
    m.dynamics(x=ph.cos(m.time))
    m.outputs(x=x)
    t = T + begin
    r = ph.simulate(m, {}, Experiment(t), initial={"x": math.sin(begin)})
    np.testing.assert_allclose(r.outputs["x"], np.sin(t), rtol=0, atol=1e-9)


def test_stiff_method_agrees() -> None:
    e, p = run(np.sin(3 * T)), {"tau": 0.01, "gain": 1.0}
    explicit, implicit = (ph.simulate(lag(), p, e, method=method) for method in ("DOP853", "Radau"))
    np.testing.assert_allclose(implicit.outputs["x"], explicit.outputs["x"], rtol=0, atol=1e-7)


# ---------------------------------------------------------------- against a fit


def pendulum() -> tuple[Model, Experiment]:
    m = Model("pendulum")
    phi, omega = m.states("phi omega")
    (torque,) = m.inputs("torque")
    k, d = m.parameters(k=1.0, d=0.1)
    m.dynamics(phi=omega, omega=-k * ph.sin(phi) - d * omega + torque)
    m.outputs(phi=phi, acceleration=-k * ph.sin(phi) - d * omega + torque)
    e = Experiment(T, {"torque": np.sin(2 * T)}, name="swing")
    clean = ph.simulate(m, {"k": 4.0, "d": 0.3}, e, initial={"phi": 1.0}).outputs
    rng = np.random.default_rng(0)
    return m, e.with_outputs({n: y + 0.02 * rng.standard_normal(T.size) for n, y in clean.items()})


def test_simulation_of_a_fit_reproduces_its_outputs() -> None:
    m, e = pendulum()
    fit = ph.estimate(m, e, transcription=Collocation(order=5))
    r = ph.simulate(m, fit, e)
    for name, y in fit.outputs.items():
        np.testing.assert_allclose(r.outputs[name], y, rtol=0, atol=1e-8)
    for name, x in fit.states.items():
        np.testing.assert_allclose(r.states[name], x, rtol=0, atol=1e-8)


def test_simulation_of_a_fit_starts_from_its_initial_states() -> None:
    m, e = pendulum()
    fit = ph.estimate(m, e)
    assert ph.simulate(m, fit, e).states["omega"][0] == fit.initial_states["swing"]["omega"].value
    given = ph.simulate(m, fit, e, initial={"omega": -1.5})
    assert given.states["omega"][0] == -1.5
    assert given.states["phi"][0] == fit.initial_states["swing"]["phi"].value


def test_estimates_and_their_standard_deviations_are_taken_as_parameters() -> None:
    m, e = pendulum()
    fit = ph.estimate(m, e)
    whole = ph.simulate(m, fit.parameters, e, initial={"phi": 1.0, "omega": 0.0})
    named = ph.simulate(m, {n: fit.parameters[n] for n in ("k", "d")}, e, initial={"phi": 1.0, "omega": 0.0})
    np.testing.assert_array_equal(whole.outputs["phi"], named.outputs["phi"])


# ---------------------------------------------------------------- where it starts, what it holds


def test_states_start_as_measured() -> None:
    m = Model("biased")
    x, v = m.states("x v")
    scale, bias = m.parameters(scale=1.0, bias=0.0)
    m.dynamics(x=v, v=0.0)
    m.outputs(z=scale * x + bias)
    z = np.full(T.size, 5.0)
    z[0] = np.nan
    e = Experiment(T, outputs={"z": z}, name="run")
    r = ph.simulate(m, {"scale": 2.0, "bias": 1.0}, e)
    assert (r.states["x"][0], r.states["v"][0]) == (2.0, 0.0)


def test_states_start_at_zero_where_nothing_measures_them() -> None:
    assert simulate(model(lambda x, u, a: a * u), 1.0, run(0.0)).states["x"][0] == 0.0


def test_record_of_a_plain_simulation() -> None:
    r = ph.simulate(lag(), {"tau": 0.5, "gain": 1.0}, run(1.0))
    assert isinstance(r, Record)
    assert (r.name, r.n, list(r.inputs), list(r.outputs), list(r.states)) == ("run", 41, ["u"], ["x", "rate"], ["x"])
    assert (dict(r.measured), dict(r.residuals)) == ({}, {})
    assert r.units == {"x": "m", "u": "V", "rate": "m/s"}
    np.testing.assert_array_equal(r.t, T)


def test_measured_outputs_give_residuals() -> None:
    z = np.full(T.size, 0.5)
    z[3] = np.nan
    r = ph.simulate(lag(), {"tau": 0.5, "gain": 1.0}, run(1.0).with_outputs({"x": z}))
    assert list(r.measured) == ["x"]
    np.testing.assert_array_equal(r.residuals["x"], z - r.outputs["x"])


def test_simulated_outputs_make_an_experiment_for_estimation() -> None:
    e = run(np.sin(2 * T))
    truth = {"tau": 0.6, "gain": 1.4}
    outputs = ph.simulate(lag(), truth, e, initial={"x": 0.2}).outputs
    noise = Gaussian({"x": 0.1, "rate": 0.1})
    fit = ph.estimate(lag(), e.with_outputs(outputs), transcription=Collocation(order=6), noise=noise)
    assert fit.parameters.to_dict() == pytest.approx(truth, rel=1e-7)


# ---------------------------------------------------------------- where there is no solution


def test_solution_that_ceases_to_exist_is_an_error_with_the_time() -> None:
    # x' = x^2, x(0) = 1/2 is 1/(2 - t).
    with pytest.raises(EvaluationError, match=r"experiment 'run': the simulation of 'trial' ends at t = 2 of 4"):
        simulate(model(lambda x, u, a: a * x**2), 1.0, run(), initial={"x": 0.5})


def test_equation_that_is_not_finite_on_the_way_is_named() -> None:
    with pytest.raises(EvaluationError, match=r"the equation of x' is not finite at t = 1.*, x = .*, u = -"):
        simulate(model(lambda x, u, a: a * ph.sqrt(u)), 1.0, run(1.0 - T))


@pytest.mark.parametrize("f", [lambda x, u, a: ph.log(a) * x, lambda x, u, a: x / (a + 1), lambda x, u, a: ph.sqrt(a)])
def test_equation_that_is_not_finite_at_the_start_is_named(f: Callable[[Expr, Expr, Expr], Any]) -> None:
    with pytest.raises(EvaluationError, match=r"ends at t = 0 .* equation of x' is not finite at t = 0, x = 1, u = 2"):
        simulate(model(f), -1.0, run(2.0), initial={"x": 1.0})


def test_output_that_is_not_finite_is_named() -> None:
    with pytest.raises(EvaluationError, match=r"the output 'y' of 'trial' is -inf at t = 1"):
        simulate(model(lambda x, u, a: -a * x, lambda x, u, a: ph.log(u)), 1.0, run(1.0 - T))


# ---------------------------------------------------------------- what is refused


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"tau": 1.0}, "no value was given for gain"),
        ({}, "no value was given for tau, gain"),
        ({"tau": 1.0, "gain": 1.0, "Tau": 1.0}, "'Tau' is not a parameter. Did you mean 'tau'?"),
        ({"tau": "slow", "gain": 1.0}, "parameter 'tau' is 'slow', not a finite number"),
        ({"tau": float("nan"), "gain": 1.0}, "parameter 'tau' is nan"),
        (1.0, "parameters are values by name, or a fit, not 1.0"),
    ],
)
def test_parameters(parameters: Any, words: str) -> None:
    with pytest.raises(ModelError, match=words):
        ph.simulate(lag(), parameters, run())


@pytest.mark.parametrize(
    ("initial", "words"),
    [
        ({"X": 1.0}, "initial 'X' is not a state. Did you mean 'x'?"),
        ({"x": math.inf}, "initial 'x' is inf, not a finite number"),
        ({"x": [1.0, 2.0]}, "initial 'x' is"),
    ],
)
def test_initial(initial: Any, words: str) -> None:
    with pytest.raises(ModelError, match=words):
        ph.simulate(lag(), {"tau": 1.0, "gain": 1.0}, run(), initial=initial)


def test_missing_input() -> None:
    with pytest.raises(DataError, match="experiment 'bare' has no input 'u'"):
        ph.simulate(lag(), {"tau": 1.0, "gain": 1.0}, Experiment(T, name="bare"))


def test_list_of_experiments() -> None:
    with pytest.raises(DataError, match="data is one Experiment, not a list"):
        ph.simulate(lag(), {"tau": 1.0, "gain": 1.0}, [run()])  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("options", "words"),
    [({"method": "Euler"}, "one of auto, DOP853, Radau, not 'Euler'"), ({"rtol": 0.0}, "rtol is a number")],
)
def test_options(options: dict[str, Any], words: str) -> None:
    with pytest.raises(OptionError, match=words):
        ph.simulate(lag(), {"tau": 1.0, "gain": 1.0}, run(), **options)


def test_incomplete_model() -> None:
    m = Model("half")
    m.states("x")
    m.outputs(x=Expr.symbol("x"))
    with pytest.raises(ModelError, match="state 'x' has no equation"):
        ph.simulate(m, {}, run())
