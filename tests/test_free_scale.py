"""A scale that no output can tell is named, and a model with an unmeasured state under a root is fitted."""

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import phugoid as ph

TRUE = {"k1": 0.5, "k2": 0.4, "k3": 0.6, "k4": 0.8}
TRANSCRIPTIONS = [ph.Collocation(), ph.MultipleShooting()]
SEEDS = range(5)


@cache
def record(seed: int) -> ph.Experiment:
    """Levels of the lower tank with 1 % noise, integrated by scipy."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 40, 201)
    u = 1.0 + 0.7 * np.sign(np.sin(2 * np.pi * t / 13))
    k1, k2, k3, k4 = TRUE.values()

    def rates(time: float, x: np.ndarray) -> list[float]:
        upper, lower = np.sqrt(np.maximum(x, 0.0))
        return [-k1 * upper + k4 * np.interp(time, t, u), k2 * upper - k3 * lower]

    x2 = solve_ivp(rates, (0, 40), [4.0, 0.2], t_eval=t, rtol=1e-9, atol=1e-9, max_step=0.2).y[1]
    return ph.Experiment(t, {"u": u}, {"x2": x2 + 0.01 * x2.mean() * rng.standard_normal(t.size)})


def tanks(seed: int, fixed: str | None = None, **upper: ph.State) -> ph.Model:
    """Two tanks of which the lower is measured, from random starting values."""
    m = ph.Model("two tanks")
    x1, x2 = m.states(**{"x1": ph.State("m"), **upper}, x2="m")
    (u,) = m.inputs(u="V")
    starts = dict(zip(TRUE, np.random.default_rng(100 + seed).uniform(0.1, 2.0, 4), strict=True))
    declared = {n: ph.Parameter(TRUE[n], fixed=True) if n == fixed else ph.Parameter(s) for n, s in starts.items()}
    k1, k2, k3, k4 = m.parameters(**declared)
    m.dynamics(x1=-k1 * ph.sqrt(x1) + k4 * u, x2=k2 * ph.sqrt(x1) - k3 * ph.sqrt(x2))
    m.outputs(x2=x2)
    return m


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("transcription", TRANSCRIPTIONS, ids=str)
def test_a_free_scale_is_named_with_what_to_fix(transcription: ph.Collocation, seed: int) -> None:
    fit = ph.estimate(tanks(seed), record(seed), transcription=transcription)
    assert fit.status == "unidentifiable" and "x1, k1, k2, k4: one scale is free" in fit.message
    (warning,) = (w for w in fit.warnings if "cannot be distinguished" in w)
    assert "x1*s, k1*s**0.5, k2*s**(-0.5), k4*s" in warning and "fix one of k1, k2, k4, or give x1" in warning
    scaled = [fit.parameters[n] for n in ("k1", "k2", "k4")] + [fit.initial_states["experiment"]["x1"]]
    assert all(np.isnan(e.std_error) and np.isfinite(e.value) for e in scaled)
    k3 = fit.parameters["k3"]
    assert k3.std_error < 0.05 and np.abs(list(e.value for e in scaled)).max() < 1e3


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("fixed", ["k2", "k4"])
@pytest.mark.parametrize("transcription", TRANSCRIPTIONS, ids=str)
def test_with_the_scale_fixed_it_converges_to_the_truth(transcription: ph.Collocation, fixed: str, seed: int) -> None:
    fit = ph.estimate(tanks(seed, fixed), record(seed), transcription=transcription)
    assert fit.status == "converged"
    for name in TRUE.keys() - {fixed}:
        estimate = fit.parameters[name]
        assert abs(estimate.value - TRUE[name]) < 3 * estimate.std_error, name


def test_a_prior_or_an_initial_value_determines_the_scale() -> None:
    for name in ("k1", "k2", "k4"):
        assert tanks(0, name)._core.scalings([1.0] * 4) == []
    m = tanks(0)
    m.initial(x1=1.0)
    assert m._core.scalings([1.0] * 4) == []


def test_states_keep_their_bounds_and_start_where_declared() -> None:
    within = ph.State("m", start=2.0, bounds=(0.5, 3.0))
    m = tanks(0, "k4", x1=within)
    assert m.declared_states["x1"] == within and ph.Model.from_json(m.to_json()).declared_states == m.declared_states
    fit = ph.estimate(m, record(0))
    path = fit.records[0].mesh_states["x1"]
    assert path.min() >= 0.5 and path.max() <= 3.0


@pytest.mark.parametrize("transcription", [*TRANSCRIPTIONS, ph.SingleShooting()], ids=str)
def test_an_initial_state_beyond_its_bound_is_estimated_there(transcription: ph.Collocation) -> None:
    """The decay starts at 1, which the bound does not allow: there is an optimum at the bound."""
    t = np.linspace(0, 3, 31)
    z = np.exp(-t) + 0.01 * np.random.default_rng(0).standard_normal(31)
    m = ph.Model("decay")
    (x,) = m.states(x=ph.State("", bounds=(0, 0.98)))
    (a,) = m.parameters(a=0.5)
    m.dynamics(x=-a * x)
    m.outputs(y=x)
    fit = ph.estimate(m, ph.Experiment(t, outputs={"y": z}), transcription=transcription)
    assert fit.status == "converged" and fit.initial_states["experiment"]["x"].value == pytest.approx(0.98, abs=1e-9)
    assert fit.parameters["a"].value == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(
    ("state", "told"),
    [
        ({"start": 2.0, "bounds": (0.0, 1.0)}, "start 2 lies outside its bounds"),
        ({"bounds": (1.0, 0.0)}, "reversed"),
        ({"bounds": (1.0, 1.0)}, "leave no room"),
        ({"start": float("nan")}, "finite number"),
    ],
)
def test_a_state_that_cannot_be_is_refused(state: dict, told: str) -> None:
    with pytest.raises(ph.ModelError, match=f"a state's.*{told}"):
        ph.State(**state)


def test_a_parameter_without_influence_is_named() -> None:
    m = ph.Model("lag")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    a, b, z = m.parameters("a b z")
    m.dynamics(x=-a * x + b * u)
    m.outputs(x=x + 0 * z)
    t = np.linspace(0, 10, 201)
    blank = ph.Experiment(t, {"u": np.sign(np.sin(t))})
    x = ph.simulate(m, {"a": 1.0, "b": 2.0, "z": 0.0}, blank).outputs["x"]
    fit = ph.estimate(m, blank.with_outputs({"x": x + 0.01 * np.random.default_rng(0).standard_normal(201)}))
    assert fit.status == "unidentifiable" and fit.message.endswith("(z: without influence)")
    (warning,) = (w for w in fit.warnings if "no influence" in w)
    assert warning.startswith("The size of z has no influence on the outputs") and "fix it" in warning
