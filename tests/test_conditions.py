"""Initial, final and periodic conditions: constraints on the ends of a record."""

from __future__ import annotations

import math

import numpy as np
import pytest

import phugoid as ph
from phugoid import _core

SIGMA = 0.02
TRUTH = {"k": 2.0, "c": 0.2, "g": 0.8}


def oscillator() -> ph.Model:
    """A mass on a spring with quadratic damping, which starts at x = g."""
    m = ph.Model("oscillator")
    x, v = m.states(x="m", v="m/s")
    (u,) = m.inputs(u="m/s²")
    k, c, g = m.parameters(k=1.0, c=0.1, g=0.3)
    m.dynamics(x=v, v=-k * x - c * v * abs(v) + u)
    m.outputs(x=x, v=v)
    m.initial(x=g)
    return m


def trimmed() -> ph.Model:
    m = oscillator()
    x = _core.Expr.symbol("x")
    m.initial(v=x**2 + 0.1)
    return m


def record(name: str = "run", seed: int = 0) -> ph.Experiment:
    t = np.linspace(0, 20, 401)
    empty = ph.Experiment(t, {"u": 0.5 * np.sin(0.7 * t)}, {"x": 0 * t, "v": 0 * t}, name=name)
    path = ph.simulate(trimmed(), TRUTH, empty)
    random = np.random.default_rng(seed)
    return empty.with_outputs({n: y + SIGMA * random.standard_normal(t.size) for n, y in path.outputs.items()})


def test_simulation_starts_at_the_initial_conditions() -> None:
    path = ph.simulate(trimmed(), TRUTH, record())
    assert path.states["x"][0] == 0.8
    assert path.states["v"][0] == pytest.approx(0.8**2 + 0.1)
    assert ph.simulate(trimmed(), TRUTH, record(), initial={"x": 0.5}).states["v"][0] == pytest.approx(0.35)


@pytest.mark.parametrize("runs", [1, 2])
def test_a_condition_holds_and_parameters_in_it_are_found(runs: int) -> None:
    data = [record(f"run {i}", i) for i in range(runs)]
    free = ph.estimate(oscillator(), data)
    fit = ph.estimate(trimmed(), data)
    assert fit.converged
    for r in fit.records:
        g = fit.parameters["g"].value
        assert r.states["x"][0] == pytest.approx(g, abs=1e-12)
        assert r.states["v"][0] == pytest.approx(g**2 + 0.1, abs=1e-12)
    for name, true in TRUTH.items():
        assert abs(fit.parameters[name].value - true) < 4 * fit.parameters[name].std_error
    # Knowing more of the start, g is known better, and the fit is a little worse.
    assert fit.parameters["g"].std_error < 0.8 * free.parameters["g"].std_error
    assert free.log_likelihood - 10 < fit.log_likelihood < free.log_likelihood


@pytest.mark.parametrize("transcription", [ph.SingleShooting(), ph.MultipleShooting(segments=8)], ids=str)
def test_initial_conditions_hold_in_shooting(transcription: ph.SingleShooting | ph.MultipleShooting) -> None:
    data = [record("one", 0), record("two", 1)]
    fit = ph.estimate(trimmed(), data, transcription=transcription, start={"k": 1.8, "c": 0.15, "g": 0.7})
    reference = ph.estimate(trimmed(), data, transcription=ph.Collocation(order=6))
    assert fit.converged
    for name, e in reference.parameters.items():
        assert abs(fit.parameters[name].value - e.value) < 0.01 * e.std_error
        assert fit.parameters[name].std_error == pytest.approx(e.std_error, rel=1e-4)
    for r in fit.records:
        g = fit.parameters["g"].value
        assert r.states["x"][0] == pytest.approx(g, abs=1e-12)
        assert r.states["v"][0] == pytest.approx(g**2 + 0.1, abs=1e-12)

    problem = transcription.problem(trimmed(), data, ph.Gaussian().resolve(["x", "v"], {"x": 1.0, "v": 1.0}, {}))
    random = np.random.default_rng(0)
    xi = 0.3 * random.standard_normal(problem.n)
    xi[:5] = 2.0, 0.2, 0.8, 1.3, 1.3
    assert problem.check_derivatives(xi, random.standard_normal(problem.m), list(range(problem.n)), 1e-6) == []
    assert problem.constraint_name(problem.m - 1) == "initial condition of v of 'two'"


@pytest.mark.parametrize("transcription", [ph.SingleShooting(), ph.MultipleShooting(segments=8)], ids=str)
def test_final_and_periodic_conditions_hold_in_shooting(
    transcription: ph.SingleShooting | ph.MultipleShooting,
) -> None:
    m = oscillator()
    m.final(v=-0.25)
    data = [record("one", 0), record("two", 1)]
    near = {"k": 1.8, "c": 0.15, "g": 0.7}
    fit = ph.estimate(m, data, transcription=transcription, start=near)
    reference = ph.estimate(m, data, transcription=ph.Collocation(order=6))
    assert fit.converged
    for r in fit.records:
        assert r.states["x"][0] == pytest.approx(fit.parameters["g"].value, abs=1e-10)
        assert r.states["v"][-1] == pytest.approx(-0.25, abs=1e-9)
    for name, e in reference.parameters.items():
        assert abs(fit.parameters[name].value - e.value) < 0.02 * e.std_error
        assert fit.parameters[name].std_error == pytest.approx(e.std_error, rel=1e-3)

    m = oscillator()
    m.periodic(v=_core.Expr.symbol("g"))
    problem = transcription.problem(m, data, ph.Gaussian().resolve(["x", "v"], {"x": 1.0, "v": 1.0}, {}))
    random = np.random.default_rng(0)
    xi = 0.3 * random.standard_normal(problem.n)
    xi[:5] = 2.0, 0.2, 0.8, 1.3, 1.3
    assert problem.check_derivatives(xi, random.standard_normal(problem.m), list(range(problem.n)), 1e-6) == []
    assert problem.constraint_name(problem.m - 1) == "periodic condition of v of 'two'"


@pytest.mark.parametrize("transcription", [ph.SingleShooting(), ph.Collocation()], ids=str)
def test_a_single_condition(transcription: ph.SingleShooting | ph.Collocation) -> None:
    """Fewer conditions than states, and no other constraints in single shooting."""
    near = {"k": 1.8, "c": 0.15, "g": 0.7}
    fit = ph.estimate(oscillator(), record(), transcription=transcription, start=near)
    assert fit.converged
    assert fit.states["x"][0] == pytest.approx(fit.parameters["g"].value, abs=1e-12)
    assert fit.warnings == ()
    pytest.importorskip("cyipopt")
    other = ph.estimate(oscillator(), record(), transcription=transcription, start=near, solver=ph.Ipopt())
    assert other.log_likelihood == pytest.approx(fit.log_likelihood, abs=1e-6)


def test_newton_and_ipopt_agree() -> None:
    pytest.importorskip("cyipopt")
    newton, ipopt = (ph.estimate(trimmed(), record(), solver=s) for s in (ph.Newton(), ph.Ipopt()))
    assert newton.parameters.values_array == pytest.approx(ipopt.parameters.values_array, rel=1e-7)
    assert newton.parameters.std_errors_array == pytest.approx(ipopt.parameters.std_errors_array, rel=1e-5)


def test_final_and_fixed_conditions_hold() -> None:
    m = oscillator()
    m.final(v=-0.25)
    fit = ph.estimate(m, record())
    assert fit.converged
    assert fit.states["v"][-1] == pytest.approx(-0.25, abs=1e-12)

    m = oscillator()
    m.initial(v=0.74)
    fit = ph.estimate(m, record())
    assert fit.states["v"][0] == pytest.approx(0.74, abs=1e-12)
    assert math.isnan(fit.initial_states["run"]["v"].std_error)


def test_a_periodic_path_ends_as_it_began() -> None:
    m = ph.Model("forced oscillator")
    x, v = m.states("x v")
    (k,) = m.parameters(k=1.0)
    m.dynamics(x=v, v=-k * x - 0.3 * v + ph.cos(0.7 * m.time))
    m.outputs(x=x)
    m.periodic("x", "v")
    t = np.linspace(0, 2 * math.pi / 0.7, 101)
    w = 1 / (2.0 - 0.49 + 0.21j)  # the steady answer to a cosine, for k = 2
    z = np.real(w * np.exp(0.7j * t)) + 0.01 * np.random.default_rng(0).standard_normal(t.size)
    fit = ph.estimate(m, ph.Experiment(t, outputs={"x": z}))
    assert fit.converged
    for path in fit.states.values():
        assert path[-1] == pytest.approx(path[0], abs=1e-12)
    assert abs(fit.parameters["k"].value - 2.0) < 4 * fit.parameters["k"].std_error
    # Nothing is free but k: the steady answer itself comes out, not a transient.
    assert fit.states["x"] == pytest.approx(np.real(w * np.exp(0.7j * t)), abs=0.01)


def test_periodic_up_to_a_difference() -> None:
    m = ph.Model("turn")
    (psi,) = m.states(psi="rad")
    (r,) = m.parameters("r")
    m.dynamics(psi=r)
    m.outputs(psi=psi)
    m.periodic(psi=2 * math.pi)
    t = np.linspace(0, 10, 11)
    fit = ph.estimate(m, ph.Experiment(t, outputs={"psi": 0.6 * t + 0.01 * np.cos(7 * t)}))
    assert fit.parameters["r"].value == pytest.approx(2 * math.pi / 10, abs=1e-12)


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("segments", [None, 37])
def test_derivatives(order: int, segments: int | None) -> None:
    m = oscillator()
    g, u, x, v = (_core.Expr.symbol(name) for name in ("g", "u", "x", "v"))
    m.final(v=ph.sin(g * x) * v**2 + u)
    noise = ph.Gaussian().resolve(["x", "v"], {"x": 1.0, "v": 1.0}, {})
    problem = ph.Collocation(order, segments=segments).problem(m, [record()], noise)
    random = np.random.default_rng(0)
    xi = random.standard_normal(problem.n)
    xi[3:5] = 1.3
    columns = [*range(12), problem.n - 2, problem.n - 1]
    assert problem.check_derivatives(xi, random.standard_normal(problem.m), columns, 1e-6) == []
    assert problem.constraint_name(problem.m - 1) == "final condition of v of 'run'"


def test_saved_models_keep_their_conditions() -> None:
    m = oscillator()
    m.periodic("v")
    again = ph.Model.from_json(m.to_json())
    assert str(again) == str(m)
    assert "x (initial) = g" in str(again)
    assert "v (periodic) = 0" in str(again)


def test_wrong_conditions_are_refused() -> None:
    m = oscillator()
    with pytest.raises(ph.ModelError, match=r"'w' is not a state. Did you mean 'v'\?|'w' is not a state"):
        m.initial(w=1.0)
    with pytest.raises(ph.ModelError, match="'x' already has such a condition"):
        m.initial(x=1.0)
    m.final(v=_core.Expr.symbol("gg"))
    with pytest.raises(ph.ModelError, match="condition of v.*'gg' is not declared.*Did you mean 'g'"):
        m.check()
    m = oscillator()
    m.periodic(v=_core.Expr.symbol("x"))
    with pytest.raises(ph.ModelError, match="may depend on parameters, not on 'x'"):
        m.check()
    m = oscillator()
    m.final(x=0.0)
    with pytest.raises(ph.ModelError, match="would leave nothing to estimate"):
        m.final(v=0.0)


def test_conditions_that_contradict_each_other_end_with_a_status() -> None:
    m = ph.Model("ramp")
    x, y = m.states("x y")
    (a,) = m.parameters(a=1.0)
    m.dynamics(x=1.0, y=a * x)
    m.outputs(y=y)
    m.initial(x=0.0)
    m.final(x=5.0)  # it runs to 1
    t = np.linspace(0, 1, 21)
    fit = ph.estimate(m, ph.Experiment(t, outputs={"y": t**2 + 0.01 * np.cos(9 * t)}))
    assert fit.status in ("infeasible", "failed")
    assert "x" in fit.message
