"""Parameters of which each experiment has its own value, and how the solver sees a parameter."""

from __future__ import annotations

import numpy as np
import pytest

import phugoid as ph

BIAS = [0.3, -0.7, 1.1]
SIGMA = 0.05


def lag(**changes: ph.Parameter) -> ph.Model:
    m = ph.Model("lag")
    (x,) = m.states(x="m")
    (u,) = m.inputs(u="m")
    declared = {"T": ph.Parameter(1.0), "b": ph.Parameter(0.0, per_experiment=True), "k": ph.Parameter(1.0), **changes}
    T, b, k = m.parameters(**declared)
    m.dynamics(x=(k * u - x) / T)
    m.outputs(x=x + b)
    return m


def runs(n: int = 3) -> list[ph.Experiment]:
    """Records of different lengths, rates and inputs, T = 0.8, k = 2.2."""
    found = []
    random = np.random.default_rng(0)
    for i, b in enumerate(BIAS[:n]):
        t = np.linspace(0, 10 - i, 200 + 50 * i)
        e = ph.Experiment(t, {"u": np.sign(np.sin(1.3 * t + i))}, {"x": 0 * t}, name=f"run {i}")
        path = ph.simulate(lag(), {"T": 0.8, "b": b, "k": 2.2}, e, initial={"x": 0.2 * i})
        found.append(e.with_outputs({"x": path.outputs["x"] + SIGMA * random.standard_normal(t.size)}))
    return found


def test_each_experiment_has_its_own_value() -> None:
    fit = ph.estimate(lag(), runs())
    assert fit.parameters.names == ("T", "b[run 0]", "b[run 1]", "b[run 2]", "k", "sigma_x")
    truth = {"T": 0.8, "k": 2.2, **{f"b[run {i}]": b for i, b in enumerate(BIAS)}}
    for name, true in truth.items():
        assert abs(fit.parameters[name].value - true) < 4 * fit.parameters[name].std_error, name
    for e, record in zip(runs(), fit.records, strict=True):
        again = ph.simulate(lag(), fit, e)
        assert again.outputs["x"] == pytest.approx(record.outputs["x"], abs=1e-6)


def test_it_is_the_fit_of_a_model_with_a_parameter_for_each_by_name() -> None:
    """The same with separate parameters that inputs switch on and off."""
    m = ph.Model("lag, switched")
    (x,) = m.states(x="m")
    u, first, second = m.inputs("u first second")
    T, b0, b1, k = m.parameters(T=1.0, b0=0.0, b1=0.0, k=1.0)
    m.dynamics(x=(k * u - x) / T)
    m.outputs(x=x + b0 * first + b1 * second)
    data = []
    for i, e in enumerate(runs(2)):
        on, off = np.ones(e.n), np.zeros(e.n)
        inputs = {"u": e.input("u"), "first": off if i else on, "second": on if i else off}
        data.append(ph.Experiment(e.t, inputs, {"x": e.output("x")}, name=e.name))
    switched, local = ph.estimate(m, data), ph.estimate(lag(), runs(2))
    assert local.log_likelihood == pytest.approx(switched.log_likelihood, abs=1e-8)
    assert local.parameters.values_array == pytest.approx(switched.parameters.values_array, rel=1e-8)
    assert local.parameters.std_errors_array == pytest.approx(switched.parameters.std_errors_array, rel=1e-6)
    assert local.covariance == pytest.approx(switched.covariance, rel=1e-5, abs=1e-12)


def test_of_one_experiment_it_keeps_its_name() -> None:
    assert "b" in ph.estimate(lag(), runs(1)).parameters


def test_starts_for_one_experiment_and_for_all() -> None:
    fit = ph.estimate(lag(), runs(), start={"b": 0.1, "b[run 1]": -0.5})
    warm = ph.estimate(lag(), runs(), start=fit)
    assert fit.converged and warm.converged
    assert warm.iterations <= 2
    with pytest.raises(ph.ModelError, match=r"'b\[run 9\]'.*Did you mean 'b\[run \d\]'"):
        ph.estimate(lag(), runs(), start={"b[run 9]": 0.0})


def test_a_new_experiment_needs_a_value() -> None:
    fit = ph.estimate(lag(), runs())
    other = ph.Experiment(runs()[0].t, runs()[0].inputs, runs()[0].outputs, name="another")
    with pytest.raises(ph.ModelError, match="no value was given for b"):
        ph.simulate(lag(), fit, other)
    path = ph.simulate(lag(), {**fit.parameters.to_dict(), "b[another]": 0.3}, other)
    assert path.rms()["x"] < 0.1


@pytest.mark.parametrize("solver", ["newton", "ipopt"])
def test_a_logarithm_comes_back_from_far(solver: str) -> None:
    if solver == "ipopt":
        pytest.importorskip("cyipopt")
    chosen = ph.Newton() if solver == "newton" else ph.Ipopt()
    plain = ph.estimate(lag(), runs())
    fit = ph.estimate(lag(T=ph.Parameter(30.0, transform="log")), runs(), solver=chosen)
    assert fit.converged
    assert fit.parameters.values_array == pytest.approx(plain.parameters.values_array, rel=1e-7)
    assert fit.parameters.std_errors_array == pytest.approx(plain.parameters.std_errors_array, rel=1e-5)
    assert fit.covariance == pytest.approx(plain.covariance, rel=1e-4, abs=1e-12)


def test_bounds_and_priors_are_those_of_the_parameter() -> None:
    strong = {"prior": (0.5, 0.01), "bounds": (0.1, 0.55)}
    plain = ph.estimate(lag(T=ph.Parameter(0.4, **strong)), runs())  # type: ignore[arg-type]
    log = ph.estimate(lag(T=ph.Parameter(0.4, transform="log", **strong)), runs())  # type: ignore[arg-type]
    assert plain.parameters["T"].bounds_active == log.parameters["T"].bounds_active == "upper"
    assert log.parameters["T"].value == pytest.approx(0.55, rel=1e-12)

    free = {"prior": (0.5, 0.01)}
    plain = ph.estimate(lag(T=ph.Parameter(0.4, **free)), runs())  # type: ignore[arg-type]
    log = ph.estimate(lag(T=ph.Parameter(0.4, transform="log", **free)), runs())  # type: ignore[arg-type]
    assert 0.5 < plain.parameters["T"].value < 0.8
    assert log.parameters["T"].value == pytest.approx(plain.parameters["T"].value, rel=1e-7)
    assert log.parameters["T"].std_error == pytest.approx(plain.parameters["T"].std_error, rel=1e-6)
    assert log.log_likelihood == pytest.approx(plain.log_likelihood, abs=1e-7)


def test_derivatives_with_priors_transforms_and_local_parameters() -> None:
    m = lag(
        T=ph.Parameter(1.0, transform="log", prior=(1.0, 0.3)),
        b=ph.Parameter(0.5, per_experiment=True, scale=3.0, prior=(0.0, 1.0)),
    )
    problem = ph.Collocation(order=3).problem(m, runs(2), ph.Gaussian().resolve(["x"], {"x": 1.0}, {}))
    random = np.random.default_rng(0)
    xi = 1.0 + 0.1 * random.standard_normal(problem.n)
    columns = [*range(8), problem.n // 2, problem.n - 1]
    assert problem.check_derivatives(xi, random.standard_normal(problem.m), columns, 1e-6) == []
    assert problem.variable_name(0) == "ln T"
    assert problem.variable_name(1) == "b[run 0]/3"


def test_wrong_options_are_refused() -> None:
    with pytest.raises(ph.ModelError, match="no logarithm"):
        ph.Parameter(0.0, transform="log")
    with pytest.raises(ph.ModelError, match="not both"):
        ph.Parameter(1.0, transform="log", scale=2.0)
    with pytest.raises(ph.ModelError, match="scale -1 must be positive"):
        ph.Parameter(1.0, scale=-1.0)
    with pytest.raises(ph.ModelError, match='"log" or None'):
        ph.Parameter(1.0, transform="sqrt")  # type: ignore[arg-type]


def test_a_saved_model_keeps_them() -> None:
    m = lag(T=ph.Parameter(1.0, transform="log"), k=ph.Parameter(1.0, scale=2.0))
    assert ph.Model.from_json(m.to_json()).declared_parameters == m.declared_parameters


# ---------------------------------------------------------------- expressions of parameters


def test_a_tie_is_a_quantity_and_a_derived_estimate_has_its_error() -> None:
    """k = 2 a, as a quantity: the same fit, and the same estimate and error of k."""
    m = ph.Model("lag, tied")
    (x,) = m.states(x="m")
    (u,) = m.inputs(u="m")
    T, b, a = m.parameters(T=1.0, b=ph.Parameter(0.0, per_experiment=True), a=0.5)
    (k,) = m.quantities(k=2.0 * a)
    m.dynamics(x=(k * u - x) / T)
    m.outputs(x=x + b)
    plain, tied = ph.estimate(lag(), runs()), ph.estimate(m, runs())
    assert tied.log_likelihood == pytest.approx(plain.log_likelihood, abs=1e-8)
    derived = tied.derived(k=m.equations["k"], ratio=k.substitute({"k": 2.0 * a}) / T)
    assert derived["k"].value == pytest.approx(plain.parameters["k"].value, rel=1e-9)
    assert derived["k"].std_error == pytest.approx(plain.parameters["k"].std_error, rel=1e-6)
    # k/T by hand, with the covariance between both.
    names = list(plain.parameters)
    i, j = names.index("T"), names.index("k")
    t, gain = plain.parameters["T"].value, plain.parameters["k"].value
    slope = np.array([-gain / t**2, 1 / t])
    variance = slope @ plain.covariance[np.ix_([i, j], [i, j])] @ slope
    assert derived["ratio"].value == pytest.approx(gain / t, rel=1e-9)
    assert derived["ratio"].std_error == pytest.approx(np.sqrt(variance), rel=1e-6)
    with pytest.raises(ph.ModelError, match="derived 'z': 'x' is not a parameter"):
        tied.derived(z=2.0 * x)
