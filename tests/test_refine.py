"""Integration error and mesh refinement: against exact solutions, and on the HFB-320 record."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import hfb320
import mesh_refinement
import numpy as np
import pytest
from records import find
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

import phugoid as ph
from phugoid import Collocation, Experiment, Fit, Model

T = np.linspace(0.0, 10.0, 101)
TRUTH = {"mu": 0.8, "k": 1.5}


def oscillator(speed_measured: bool = True) -> Model:
    """Van der Pol's, with a force."""
    m = Model("van der Pol")
    x, v = m.states("x v")
    (u,) = m.inputs("u")
    mu, k = m.parameters("mu k")
    m.dynamics(x=v, v=mu * (1 - x**2) * v - k * x + u)
    m.outputs(**({"x": x, "v": v} if speed_measured else {"x": x}))
    return m


def record(u: np.ndarray, interpolation: Any = "cubic", name: str = "run", m: Model | None = None) -> Experiment:
    m = m or oscillator()
    e = Experiment(T, {"u": u}, name=name, interpolation=interpolation)
    clean = ph.simulate(m, TRUTH, e, initial={"x": 0.4, "v": 0.0}).outputs
    rng = np.random.default_rng(0)
    return e.with_outputs({n: y + 0.01 * rng.standard_normal(T.size) for n, y in clean.items()})


SMOOTH = record(0.5 * np.sin(T))


def exact(fit: Fit, i: int, a: float, b: float, first: int) -> tuple[np.ndarray, Any]:
    """The exact solution of the fitted model through a mesh point, from a to b."""
    p, r = fit.parameters.to_dict(), fit.records[i]
    u = CubicSpline(r.t, r.inputs["u"])

    def f(t: float, x: np.ndarray) -> list[float]:
        return [x[1], p["mu"] * (1 - x[0] ** 2) * x[1] - p["k"] * x[0] + float(u(t))]

    x0 = [r.mesh_states[n][first] for n in ("x", "v")]
    t = np.linspace(a, b, 41)
    return t, solve_ivp(f, (a, b), x0, method="DOP853", rtol=1e-12, atol=1e-14, t_eval=t).y


@pytest.mark.parametrize("order", [2, 3, 4])
def test_errors_are_those_of_the_exact_solution(order: int) -> None:
    """Collocation polynomial by hand (degree `order`: first value and slopes), exact solution by DOP853."""
    fit = ph.estimate(oscillator(), SMOOTH, transcription=Collocation(order=order))
    (error,) = fit.integration_error()
    r, p = fit.records[0], fit.parameters.to_dict()
    u = CubicSpline(r.t, r.inputs["u"])(r.mesh_t)
    x, v = r.mesh_states["x"], r.mesh_states["v"]
    slopes = np.array([v, p["mu"] * (1 - x**2) * v - p["k"] * x + u])
    for s in (0, 17, 40, 77):
        a, b, first = error.edges[s], error.edges[s + 1], s * (order - 1)
        t, solution = exact(fit, 0, a, b, first)
        inside = slice(first, first + order)
        for i, name in enumerate(("x", "v")):
            slope = np.polynomial.Polynomial.fit(r.mesh_t[inside] - a, slopes[i, inside], order - 1)
            rise = slope.convert().integ()
            path = r.mesh_states[name][first] + rise(t - a)
            true = np.abs(path - solution[i]).max()
            assert error.errors[name][s] == pytest.approx(true, rel=0.1)


def test_errors_of_stiff_segments_are_those_of_the_exact_solution() -> None:
    """x' = -x, y' = 200 (x - y) with steps of 0.1: far beyond the reach of iteration. Solution in closed form."""
    m = Model("stiff")
    x, y = m.states("x y")
    (k,) = m.parameters("k")
    m.dynamics(x=-x, y=k * (x - y))
    m.outputs(x=x, y=y)
    clean = np.exp(-T)
    rng = np.random.default_rng(0)
    noisy = {n: c * clean + 1e-3 * rng.standard_normal(T.size) for n, c in (("x", 1.0), ("y", 1.005))}
    fit = ph.estimate(m, Experiment(T, {}, noisy), start={"k": 200.0}, transcription=Collocation(order=3))
    (error,), r, rate = fit.integration_error(), fit.records[0], fit.parameters["k"].value
    assert rate * 0.1 > 10
    for s in (0, 10, 60):
        t = r.mesh_t[2 * s : 2 * s + 3] - r.mesh_t[2 * s]
        xs, ys = (r.mesh_states[n][2 * s : 2 * s + 3] for n in ("x", "y"))
        at = np.linspace(0.0, t[-1], 2000)
        path = ys[0] + np.polynomial.Polynomial.fit(t, rate * (xs - ys), 2).convert().integ()(at)
        forced = xs[0] * rate / (rate - 1) * np.exp(-at)
        exact_path = forced + (ys[0] - forced[0]) * np.exp(-rate * at)
        # The largest error at the nodes of the finer rule, and over the whole segment.
        assert error.errors["y"][s] == pytest.approx(np.abs(path - exact_path).max(), rel=0.2)


@pytest.mark.parametrize("order", [2, 3, 4])
def test_errors_fall_with_the_order_of_the_method(order: int) -> None:
    """Half the step divides the error of a segment by 2^(m+1)."""
    largest = []
    for substeps in (1, 2):
        grid = Collocation(order=order, substeps=substeps)
        largest.append(ph.estimate(oscillator(), SMOOTH, transcription=grid).integration_error()[0].worst.max())
    assert np.log2(largest[0] / largest[1]) == pytest.approx(order + 1, abs=0.35)


def test_scales_are_the_noise_where_it_is_measured() -> None:
    fit = ph.estimate(oscillator(), SMOOTH)
    (error,) = fit.integration_error()
    assert error.scales["x"] == fit.parameters["sigma_x"].value
    m = oscillator(speed_measured=False)
    half = ph.estimate(m, record(0.5 * np.sin(T), m=m))
    (error,) = half.integration_error()
    assert error.scales["v"] == pytest.approx(0.01 * half.records[0].mesh_states["v"].std())
    assert error.relative["v"] == pytest.approx(error.errors["v"] / error.scales["v"])


def test_known_noise_is_a_scale_too() -> None:
    fit = ph.estimate(oscillator(), SMOOTH, noise=ph.Gaussian({"x": 0.02}))
    assert fit.integration_error()[0].scales["x"] == 0.02


def test_refinement_meets_the_tolerance_and_the_exact_estimates() -> None:
    coarse = Collocation(order=2, segments=25)
    fit = ph.estimate(oscillator(), SMOOTH, transcription=Collocation(order=2, segments=25, refine=True))
    report = fit.refinement
    assert report is not None and report.met and fit.converged
    assert fit.integration_error()[0].worst.max() <= 1e-4
    first, last = ph.estimate(oscillator(), SMOOTH, transcription=coarse), ph.estimate(oscillator(), SMOOTH)
    for name in TRUTH:
        e = fit.parameters[name]
        assert e.value == pytest.approx(last.parameters[name].value, abs=0.02 * e.std_error)
        assert report.changes[name][:2] == (first.parameters[name].value, e.value)
        moved = e.value - first.parameters[name].value
        assert report.change(name) == pytest.approx((100 * moved / abs(e.value), moved / e.std_error))
    # The coarse mesh would have been wrong by more than a standard error.
    assert max(abs(report.change(name)[1]) for name in TRUTH) > 1


def test_only_coarse_segments_are_split() -> None:
    """A short pulse: the mesh is fine there alone."""
    pulse = record(5.0 * np.exp(-(((T - 5.0) / 0.3) ** 2)))
    grid = Collocation(order=4, segments=20, refine=True, tolerance=1e-3)
    fit = ph.estimate(oscillator(), pulse, transcription=grid)
    assert fit.refinement is not None and fit.refinement.met
    edges = fit.integration_error()[0].edges
    lengths, middle = np.diff(edges), 0.5 * (edges[1:] + edges[:-1])
    assert lengths[np.abs(middle - 5.0) < 0.5].max() < 0.3 < lengths.max()


def test_segments_are_cut_at_samples_where_inputs_bend() -> None:
    steps = record(np.where(np.sin(1.7 * T) > 0, 0.5, -0.5), "linear")
    grid = Collocation(order=4, segments=[0.0, 2.5, 5.0, 7.5, 10.0], refine=True)
    fit = ph.estimate(oscillator(), steps, transcription=grid)
    assert fit.refinement is not None and fit.refinement.met
    assert all(step.order == 4 for step in fit.refinement.steps)
    edges = fit.integration_error()[0].edges
    at_sample = np.abs(T[:, None] - edges).min(axis=0) < 1e-9
    assert at_sample.sum() > 50
    for edge in edges[~at_sample]:  # between samples only where both of them are ends already
        for sample in (T[edge > T][-1], T[edge < T][0]):
            assert np.abs(edges - sample).min() < 1e-9


def test_orders_are_raised_where_all_segments_are_too_coarse() -> None:
    fit = ph.estimate(oscillator(), SMOOTH, transcription=Collocation(order=2, refine=True))
    assert fit.refinement is not None and fit.refinement.met
    assert [step.order for step in fit.refinement.steps][:2] == [2, 3]
    assert fit.transcription.order == fit.refinement.steps[-1].order


def test_a_mesh_that_is_fine_enough_stays() -> None:
    fit = ph.estimate(oscillator(), SMOOTH, transcription=Collocation(order=5, refine=True))
    assert fit.refinement is not None and len(fit.refinement.steps) == 1
    plain = ph.estimate(oscillator(), SMOOTH, transcription=Collocation(order=5))
    assert fit.parameters.to_dict() == plain.parameters.to_dict()


def test_several_experiments_are_refined_each_for_itself() -> None:
    calm, wild = record(0.0 * T, name="calm"), record(np.sin(6 * T), name="wild")
    fit = ph.estimate(oscillator(), [calm, wild], transcription=Collocation(order=4, segments=30, refine=True))
    assert fit.refinement is not None and fit.refinement.met
    errors = fit.integration_error()
    assert [e.name for e in errors] == ["calm", "wild"]
    assert errors[0].edges.size < errors[1].edges.size
    assert fit.refinement.steps[-1].segments == sum(e.edges.size - 1 for e in errors)


def test_parameters_of_each_experiment_enter_their_errors() -> None:
    m = Model("rates")
    (x,) = m.states("x")
    (rate,) = m.parameters(rate=ph.Parameter(0.5, per_experiment=True))
    m.dynamics(x=-rate * x)
    m.outputs(x=x)
    rng = np.random.default_rng(0)
    runs = [
        Experiment(T, {}, {"x": np.exp(-r * T) + 1e-3 * rng.standard_normal(T.size)}, name=n)
        for n, r in (("slow", 0.2), ("fast", 2.0))
    ]
    fit = ph.estimate(m, runs, transcription=Collocation(order=2))
    slow, fast = fit.integration_error()
    # Of the first segment, the trapezoid's error is (rate h)^3/12 of the state.
    for error, rate_found in ((slow, fit.parameters["rate[slow]"]), (fast, fit.parameters["rate[fast]"])):
        assert error.errors["x"][0] == pytest.approx((rate_found.value * 0.1) ** 3 / 12, rel=0.25)


def test_refinement_goes_no_further_than_a_solver_that_fails() -> None:
    grid = Collocation(order=2, refine=True)
    fit = ph.estimate(oscillator(), SMOOTH, transcription=grid, solver=ph.Newton(max_iterations=1))
    assert not fit.converged and fit.refinement is not None
    assert len(fit.refinement.steps) == 1 and not fit.refinement.met
    assert "not met" in fit.summary()


def test_report_is_saved_with_the_fit(tmp_path: Path) -> None:
    fit = ph.estimate(oscillator(), SMOOTH, transcription=Collocation(order=2, refine=True))
    fit.save(tmp_path / "fit.json")
    loaded = ph.load(tmp_path / "fit.json")
    assert loaded.refinement == fit.refinement
    assert loaded.summary() == fit.summary() and "mesh refinement: tolerance 0.0001 of the noise met" in fit.summary()
    # The kind of interpolation is saved too, without which errors would come out otherwise.
    assert loaded.integration_error()[0].worst == pytest.approx(fit.integration_error()[0].worst, rel=1e-9)


@pytest.mark.parametrize("options", [{"refine": 1}, {"refine": "yes"}, {"tolerance": 0.0}, {"tolerance": 2}])
def test_wrong_options_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(ph.OptionError, match="Collocation: (refine|tolerance)"):
        Collocation(**options)


# ---------------------------------------------------------------- HFB-320

needs_record = pytest.mark.skipif(find(hfb320.RECORD) is None, reason=f"the record {hfb320.RECORD} is not there")


@cache
def hfb_fit(order: int, substeps: int = 1) -> Fit:
    path = find(hfb320.RECORD)
    assert path is not None
    return ph.estimate(
        hfb320.model(), hfb320.experiment(path), transcription=Collocation(order=order, substeps=substeps)
    )


def off(fit: Fit, name: str) -> float:
    return fit.parameters[name].value / hfb_fit(6).parameters[name].value - 1


@needs_record
def test_the_trapezoid_moves_pitch_derivatives_of_hfb320() -> None:
    assert off(hfb_fit(2), "Cma") == pytest.approx(0.0048, abs=2e-4)
    assert off(hfb_fit(2), "Cmq") == pytest.approx(0.0129, abs=4e-4)


@needs_record
@pytest.mark.parametrize("name", mesh_refinement.SHOWN)
def test_half_the_step_quarters_that(name: str) -> None:
    assert off(hfb_fit(2, 1), name) / off(hfb_fit(2, 2), name) == pytest.approx(4.0, rel=0.02)


@needs_record
def test_the_trapezoid_finds_the_short_period_that_it_integrates_rightly() -> None:
    """(2/h) tanh(s h/2): the shift that it predicts is the one found, to a quarter."""
    true, found = mesh_refinement.short_period(hfb_fit(6)), mesh_refinement.short_period(hfb_fit(2))
    expected = mesh_refinement.trapezoidal(true, 0.1) - true
    assert abs(found - true - expected) < 0.25 * abs(expected)


@needs_record
def test_refinement_of_the_trapezoid_on_hfb320() -> None:
    path = find(hfb320.RECORD)
    assert path is not None
    data = hfb320.experiment(path)
    fit = ph.estimate(hfb320.model(), data, transcription=Collocation(order=2, refine=True))
    report = fit.refinement
    assert report is not None and report.met
    assert report.steps[0].largest == pytest.approx(0.032, abs=0.003)
    assert report.change("Cmq")[0] == pytest.approx(1.29, abs=0.03)
    assert report.change("Cmq")[1] == pytest.approx(0.57, abs=0.03)
    assert all(abs(off(fit, name)) < 1e-4 for name in mesh_refinement.SHOWN)


def test_a_mesh_on_which_a_fit_nearby_lies_is_not_divided_for_want_of_iterations() -> None:
    near = ph.estimate(oscillator(), SMOOTH)
    other = record(3.0 * np.sin(T) + np.cos(2.3 * T))
    short = ph.Newton(max_iterations=1)
    fit = ph.estimate(oscillator(), other, start=near, solver=short, transcription=Collocation(refine=True))
    assert fit.status == "iteration limit" and not fit.feasible
    assert fit.records[0].mesh_t.size == near.records[0].mesh_t.size


def test_errors_that_add_up_along_a_record_are_told() -> None:
    """A position is an integral: errors of its speed, each small beside the noise, made its residuals four times as
    large, with no word of it."""
    m = ph.Model("servo")
    (u,), (theta, w) = m.inputs(u="V"), m.states(theta="rad", w="rad/s")
    a, k, c = m.parameters(a=3.0, k=20.0, c=5.0)
    m.dynamics(theta=w, w=k * u - a * w - c * ph.tanh(w / 0.1))
    m.outputs(theta=theta, w=w)
    t, rng = np.arange(0.0, 10.0, 0.02), np.random.default_rng(5)
    held = ph.Experiment(t, {"u": 2.0 * np.sin(3.0 * t) + 1.5 * np.sin(7.3 * t)}, interpolation="hold")
    run = ph.simulate(m, {"a": 3.6, "k": 25.0, "c": 6.0}, held, initial={"theta": 0.0, "w": 0.0})
    y = {"theta": run.outputs["theta"], "w": run.outputs["w"]}
    y = {n: z + s * rng.standard_normal(t.size) for (n, z), s in zip(y.items(), (4e-4, 0.15), strict=True)}
    record = ph.Experiment(t, held.inputs, y, interpolation="hold")
    coarse, fine = ph.estimate(m, record), ph.estimate(m, record, transcription=Collocation(substeps=4))
    assert fine.log_likelihood > coarse.log_likelihood + 10.0
    (told,) = coarse.warnings
    assert "the mesh is coarse: with segments half as long" in told and not fine.warnings
