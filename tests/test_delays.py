"""Delays of inputs and sensors as parameters, and records with time stamps of their own for each channel."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

import phugoid as ph

TRUTH = {"k": 2.0, "c": 0.7, "tau": 0.237, "late": 0.163}
SIGMA = {"x": 0.01, "v": 0.02, "a": 0.03}


def model(**fixed: float) -> ph.Model:
    """A mass that follows its input tau late; position and acceleration are measured late."""
    m = ph.Model("late")
    x, v = m.states(x="m", v="m/s")
    (u,) = m.inputs(u="m")
    declared = {name: ph.Parameter(value, fixed=True) for name, value in fixed.items()}
    start = {"k": 1.0, "c": 0.5, "tau": ph.Parameter(0.0, bounds=(-0.5, 2.0)), "late": ph.Parameter(0.0)}
    k, c, tau, late = m.parameters(**{**start, **declared})  # type: ignore[arg-type]
    acceleration = -k * (x - m.delay(u, tau)) - c * v
    m.dynamics(x=v, v=acceleration)
    m.outputs(x=x, v=v, a=acceleration)
    m.sensor_delay(x=late, a=late)
    return m


def smooth(n: int, seed: int = 0) -> np.ndarray:
    u = sosfiltfilt(butter(4, 0.1, output="sos"), np.random.default_rng(seed).standard_normal(n))
    return np.asarray(u / u.std())


def record(interpolation: str = "cubic", name: str = "run", seed: int = 0) -> ph.Experiment:
    t = np.arange(0, 40, 0.1)
    u = {"u": smooth(t.size, seed)}
    e = ph.Experiment(t, u, name=name, interpolation=interpolation)  # type: ignore[arg-type]
    path = ph.simulate(model(), TRUTH, e, initial={"x": 0.1, "v": 0.0})
    random = np.random.default_rng(seed + 1)
    return e.with_outputs({n: path.outputs[n] + s * random.standard_normal(t.size) for n, s in SIGMA.items()})


def test_the_simulation_is_late() -> None:
    """Against the same model on an input that was moved by hand, and read late by hand."""
    t = np.arange(0, 20, 0.01)
    e = ph.Experiment(t, {"u": smooth(t.size)}, interpolation="cubic")
    now = ph.simulate(model(), {**TRUTH, "tau": 0.0, "late": 0.0}, e, initial={"x": 0.0, "v": 0.0})
    shifted = np.concatenate([np.full(50, e.input("u")[0]), e.input("u")[:-50]])
    moved = ph.Experiment(t, {"u": shifted}, interpolation="cubic")
    by_hand = ph.simulate(model(), {**TRUTH, "tau": 0.0, "late": 0.0}, moved, initial={"x": 0.0, "v": 0.0})
    late = ph.simulate(model(), {**TRUTH, "tau": 0.5, "late": 0.25}, e, initial={"x": 0.0, "v": 0.0})
    # Held before its first sample, the input starts with a bend that a spline through samples rounds off.
    assert late.states["x"] == pytest.approx(by_hand.states["x"], abs=1e-4)
    assert np.abs(late.states["x"] - now.states["x"]).max() > 0.1
    assert np.isnan(late.outputs["x"][:25]).all()
    assert late.outputs["x"][25:] == pytest.approx(late.states["x"][:-25], abs=1e-5)
    assert late.outputs["v"] == pytest.approx(late.states["v"], abs=1e-12)


@pytest.mark.parametrize("interpolation", ["linear", "cubic"])
def test_delays_are_found(interpolation: str) -> None:
    data = [record(interpolation, "one", 0), record(interpolation, "two", 7)]
    fit = ph.estimate(model(), data)
    assert fit.converged
    for name, true in TRUTH.items():
        e = fit.parameters[name]
        assert abs(e.value - true) < 4 * e.std_error, name
        assert e.std_error < 0.002
    # Residuals are at the samples of the record: those that reach back beyond its start are missing.
    for r, e in zip(fit.records, data, strict=True):
        assert r.t is e.t
        assert np.isnan(r.residuals["x"][:2]).all() and np.isfinite(r.residuals["x"][2:]).all()
        assert np.isfinite(r.residuals["v"]).all()
        for name, rms in r.rms().items():
            assert rms == pytest.approx(SIGMA[name], rel=0.15)
        # The delayed input bends within segments: the fit's mesh cannot follow as closely as a simulation.
        path = ph.simulate(model(), fit, e)
        assert path.outputs["x"][2:] == pytest.approx(r.outputs["x"][2:], abs=3e-4)


@pytest.mark.parametrize("transcription", [ph.MultipleShooting(segments=20), ph.SingleShooting()], ids=str)
def test_delays_are_found_by_shooting(transcription: ph.SingleShooting | ph.MultipleShooting) -> None:
    near = {"k": 1.5, "c": 0.6}
    fit = ph.estimate(model(), record(), transcription=transcription, start=near)
    reference = ph.estimate(model(), record(), transcription=ph.Collocation(order=6))
    assert fit.converged
    for name in TRUTH:
        e = reference.parameters[name]
        assert abs(fit.parameters[name].value - e.value) < 0.1 * e.std_error
        assert fit.parameters[name].std_error == pytest.approx(e.std_error, rel=0.01)


def test_the_estimate_is_the_maximum_and_its_error_the_curvature_there() -> None:
    data = record()
    fit = ph.estimate(model(), data)
    at, step = fit.parameters["tau"].value, fit.parameters["tau"].std_error
    start = {name: fit.parameters[name].value for name in ("k", "c", "late")}
    best, above, below = (
        ph.estimate(model(tau=value), data, start=start).log_likelihood for value in (at, at + step, at - step)
    )
    assert fit.log_likelihood == pytest.approx(best, abs=1e-6)
    # One standard error from the maximum the profile is 1/2 lower, on either side.
    assert above - best == pytest.approx(-0.5, abs=0.02)
    assert below - best == pytest.approx(-0.5, abs=0.02)


@pytest.mark.parametrize("interpolation", ["linear", "cubic"])
def test_rates_of_signals_are_those_of_the_interpolation(interpolation: str) -> None:
    """Derivatives of the transcribed program with respect to a delay, while the base stays."""
    start = {"tau": 0.2, "late": 0.1}
    found = ph.estimate(model(), record(interpolation), start=start, solver=ph.Newton(max_iterations=0))._moved
    assert found is not None
    noise = ph.Gaussian().resolve(list("xva"), dict.fromkeys("xva", 1.0), {})
    problem = ph.Collocation(3).problem(found.model, found.experiments, noise)
    random = np.random.default_rng(0)
    xi = random.standard_normal(problem.n)
    xi[:4], xi[4:7] = [2.0, 0.7, 0.21, 0.12], 1.3
    assert problem.check_derivatives(xi, random.standard_normal(problem.m), list(range(12)), 1e-6) == []


def test_what_is_late_is_saved_with_the_model() -> None:
    m = model()
    again = ph.Model.from_json(m.to_json())
    assert again.delays == m.delays
    assert again.input_names == ("u",)
    assert again.delays.parameters == ("tau", "late")


def test_wrong_delays_are_refused() -> None:
    m = ph.Model("wrong")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    (tau,) = m.parameters("tau")
    with pytest.raises(ph.ModelError, match="delay: give the symbol of an input"):
        m.delay(x, tau)
    with pytest.raises(ph.ModelError, match="delay of u: give the symbol of a parameter"):
        m.delay(u, x)
    with pytest.raises(ph.ModelError, match="'y' is not an output"):
        m.sensor_delay(y=tau)
    with pytest.raises(ph.DataError, match="no sample is left with a delay of 100 in"):
        ph.estimate(model(late=100.0), record())


def test_states_may_start_with_one_value_a_sample() -> None:
    t = np.arange(0, 10, 0.1)
    e = ph.Experiment(t, {"u": smooth(t.size)}, interpolation="cubic")
    path = ph.simulate(model(), TRUTH, e, initial={"x": 0.1, "v": 0.0})
    fit = ph.estimate(model(), e.with_outputs(path.outputs), noise=ph.Gaussian(SIGMA), start={**TRUTH, **path.states})
    assert fit.converged and fit.iterations < 10
    assert {n: fit.parameters[n].value for n in TRUTH} == pytest.approx(TRUTH, rel=1e-3)


# ---------------------------------------------------------------- time stamps of their own


def test_channels_with_their_own_times_make_one_record() -> None:
    fast, slow = np.linspace(0, 10, 501), np.linspace(0.003, 9.9, 95)
    u = np.linspace(-0.2, 10.1, 300)
    run = ph.multirate(
        {"u": (u, np.sin(u))}, {"x": (fast, fast), "v": (slow, slow**2)}, name="log", interpolation="cubic"
    )
    assert run.n == 501 + 95 - np.isin(slow, fast).sum()
    assert np.isfinite(run.output("x")).sum() == 501 and np.isfinite(run.output("v")).sum() == 95
    assert run.output("v")[np.isfinite(run.output("v"))] == pytest.approx(slow**2)
    assert run.input("u") == pytest.approx(np.sin(run.t), abs=1e-5)
    assert run.mesh_times is not None and run.mesh_times == pytest.approx(fast)
    part = run.window(2.0, 3.0)
    assert part.mesh_times is not None and part.mesh_times[[0, -1]] == pytest.approx(part.t[[0, -1]])
    assert part.signal("u") is run.signal("u")


def test_the_fit_of_a_multirate_record_is_that_of_its_samples() -> None:
    """Channels taken at their own times from one path tell the same as the path."""
    t = np.arange(0, 20, 0.02)
    e = ph.Experiment(t, {"u": smooth(t.size)}, interpolation="cubic")
    path = ph.simulate(model(), {**TRUTH, "tau": 0.0, "late": 0.0}, e, initial={"x": 0.3, "v": 0.0})
    random = np.random.default_rng(3)
    x, v, a = slice(0, None, 5), slice(3, None, 7), slice(1, None, 11)
    outputs = {
        name: (t[s], path.outputs[name][s] + SIGMA[name] * random.standard_normal(t[s].size))
        for name, s in {"x": x, "v": v, "a": a}.items()
    }
    run = ph.multirate({"u": (t, e.input("u"))}, outputs, interpolation="cubic")
    fit = ph.estimate(model(tau=0.0, late=0.0), run, transcription=ph.Collocation(order=7))
    assert fit.converged
    for name in ("k", "c"):
        assert abs(fit.parameters[name].value - TRUTH[name]) < 4 * fit.parameters[name].std_error
    # The same samples as one record with gaps, its input at every time: a finer mesh, the same answer.
    z = {n: np.full(t.size, np.nan) for n in outputs}
    for (name, (_, values)), s in zip(outputs.items(), (x, v, a), strict=True):
        z[name][s] = values
    whole = ph.estimate(model(tau=0.0, late=0.0), e.with_outputs(z))
    assert fit.parameters["k"].value == pytest.approx(whole.parameters["k"].value, rel=1e-5)
    assert fit.log_likelihood == pytest.approx(whole.log_likelihood, abs=1e-3)


def test_channels_that_do_not_overlap_are_refused() -> None:
    t = np.linspace(0, 1, 5)
    with pytest.raises(ph.DataError, match="output 'x': no sample lies between 5 and 6,"):
        ph.multirate({"u": (t + 5, t)}, {"x": (t, t)})
    with pytest.raises(ph.DataError, match="input 'u': give \\(times, values\\)"):
        ph.multirate({"u": t}, {"x": (t, t)})  # type: ignore[dict-item]
    with pytest.raises(ph.DataError, match="does not come after"):
        ph.multirate({}, {"x": (t[::-1], t)})
    with pytest.raises(ph.DataError, match="there are no outputs"):
        ph.multirate({"u": (t, t)}, {})


def late(start: float, most: float, t: np.ndarray, tau: float) -> tuple[ph.Model, ph.Experiment]:
    """A lag behind a delay that starts at `start` and is at most `most`, and its record with the delay `tau`, in s."""
    m = ph.Model("late")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    a, by = m.parameters(a=-1.0, tau=ph.Parameter(start, bounds=(0, most), unit="s"))
    m.dynamics(x=a * x + m.delay(u, by))
    m.outputs(x=x)
    run = ph.Experiment(t, {"u": np.sin(0.3 * t) + np.sin(0.9 * t)}, name="run")
    path = ph.simulate(m, {"a": -2.0, "tau": tau}, run, initial={"x": 0.0})
    noise = 0.01 * np.random.default_rng(0).standard_normal(t.size)
    return m, run.with_outputs({"x": path.outputs["x"] + noise})


def test_a_delay_still_on_its_way_is_neither_at_a_bound_nor_converged() -> None:
    m, run = late(0.0, 3, np.arange(0.0, 20.0, 0.01), tau=2.0)
    fit = ph.estimate(m, run)  # 2 s are far at steps of two samples
    assert 0.0 < fit.parameters["tau"].value < 2.9
    assert fit.parameters["tau"].bounds_active is None
    assert not fit.converged
    assert fit.message.endswith("(tau has not converged)")
    near = ph.estimate(m, run, start={"tau": 1.95})
    assert near.converged
    assert near.parameters["tau"].value == pytest.approx(2.0, abs=0.01)


def test_a_delay_at_its_own_bound_says_so() -> None:
    fit = ph.estimate(*late(0.05, 0.1, np.arange(0.0, 10.0, 0.05), tau=0.2))
    assert fit.converged
    assert fit.parameters["tau"].bounds_active == "upper"
    assert fit.parameters["tau"].value == pytest.approx(0.1, abs=1e-6)


def test_the_mesh_of_a_fit_with_delays_has_an_integration_error() -> None:
    """It is that of the model without delays, whose late inputs are moved: that was an error on unknown symbols."""
    fit = ph.estimate(model(), record())
    (error,) = fit.integration_error()
    assert error.name == "run" and np.isfinite(error.worst).all() and error.worst.size > 100


def test_a_kink_in_a_model_with_a_delay_is_smoothed() -> None:
    m = ph.Model("late relay")
    (x,) = m.states(x="m")
    (u,) = m.inputs(u="m")
    k, r, tau = m.parameters(k=0.5, r=0.5, tau=ph.Parameter(0.05, bounds=(0.0, 0.5)))
    m.dynamics(x=k * (m.delay(u, tau) - x) - r * ph.sign(x))
    m.outputs(x=x)
    true = {"k": 2.0, "r": 0.4, "tau": 0.13}
    t = np.arange(0, 20, 0.05)
    e = ph.Experiment(t, {"u": 2.0 * np.sin(0.9 * t) + np.sin(0.37 * t)}, name="run")
    # Sticking friction, in steps with a narrow smooth sign instead of the jump.
    almost = ph.Model("almost")
    (y,) = almost.states(x="m")
    (w,) = almost.inputs(u="m")
    a, b, late = almost.parameters(k=2.0, r=0.4, tau=0.13)
    almost.dynamics(x=a * (almost.delay(w, late) - y) - b * ph.smooth_sign(y, 1e-4))
    almost.outputs(x=y)
    path = ph.simulate(almost, true, e, initial={"x": 0.5})
    noise = 0.005 * np.random.default_rng(0).standard_normal(t.size)
    fit = ph.estimate(m, e.with_outputs({"x": path.outputs["x"] + noise}))
    assert fit.converged and fit.smoothing is not None, fit.message
    for name, value in true.items():
        found = fit.parameters[name]
        assert abs(found.value - value) < max(4 * found.std_error, 0.02 * value), (name, found)
