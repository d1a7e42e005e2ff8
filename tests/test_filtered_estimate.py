"""Estimates from filtered and decimated records: a linear model keeps its parameters, if inputs stay fine enough."""

from __future__ import annotations

import functools
import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

import phugoid as ph

RATE, OMEGA, ZETA, GAIN = 2000.0, 2 * np.pi * 12.0, 0.03, 1000.0
TRUE = {"w2": OMEGA**2, "d": 2 * ZETA * OMEGA, "b": GAIN}


def mode() -> ph.Model:
    m = ph.Model("a mode")
    x, v = m.states("x v")
    (u,) = m.inputs("u")
    w2, d, b = m.parameters(w2=5000.0, d=3.0, b=800.0)
    m.dynamics(x=v, v=-w2 * x - d * v + b * u)
    m.outputs(y=x)
    return m


@functools.cache
def clean() -> ph.Experiment:
    """Twelve seconds at 2 kHz of a mode at 12 Hz, shaken from 2 to 45 Hz."""
    t = np.arange(int(12 * RATE)) / RATE
    shaped = signal.butter(4, [2, 45], "bandpass", fs=RATE, output="sos")
    u = 10.0 * signal.sosfilt(shaped, np.random.default_rng(0).standard_normal(t.size))
    a, b = np.array([[0.0, 1.0], [-TRUE["w2"], -TRUE["d"]]]), np.array([[0.0], [GAIN]])
    discrete = signal.cont2discrete((a, b, np.eye(2)[:1], np.zeros((1, 1))), 1 / RATE, "foh")
    return ph.Experiment(t, {"u": u}, {"y": signal.dlsim(discrete, u)[1][:, 0]}, name="shake")


def measured(seed: int) -> ph.Experiment:
    """With noise, and a slow drift that the model does not know."""
    run = clean()
    y = run.output("y")
    noise = 0.3 * y.std() * np.random.default_rng(seed).standard_normal(y.size)
    return run.with_outputs({"y": y + noise + 2.0 * y.std() * np.sin(2 * np.pi * 0.3 * run.t)})


def decimated(data: ph.Experiment, inputs: int | None) -> ph.Experiment:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # a little noise above 50 Hz
        return data.decimate(20, inputs).window(0.6, 12.0)


def errors(fit: ph.Fit) -> dict[str, float]:
    """In standard errors."""
    assert fit.status == "converged"
    return {n: (fit.parameters[n].value - true) / fit.parameters[n].std_error for n, true in TRUE.items()}


@pytest.mark.parametrize("seed", [1, 2])
def test_the_same_filter_on_all_channels_leaves_the_parameters(seed: int) -> None:
    fit = ph.estimate(mode(), decimated(measured(seed).band_pass(6, 32), 5))
    assert max(map(abs, errors(fit).values())) < 3.0
    assert all(fit.parameters[n].std_error < 0.02 * true for n, true in TRUE.items())


def test_a_filter_on_the_output_alone_does_not() -> None:
    fit = ph.estimate(mode(), decimated(measured(1).band_pass(6, 32, channels=["y"]), 5))
    assert max(map(abs, errors(fit).values())) > 10.0


def test_straight_lines_between_coarse_inputs_cost_gain_and_finer_inputs_do_not() -> None:
    """The mode lies at 0.12 of the sampling rate: lines lose sinc², 4.7 %."""
    lost = np.sinc(OMEGA / (2 * np.pi) / 100.0) ** 2
    coarse = decimated(measured(1).band_pass(6, 32), None)
    fit = ph.estimate(mode(), coarse)
    assert fit.parameters["b"].value * lost == pytest.approx(GAIN, rel=0.01)
    assert errors(fit)["b"] > 10.0
    fine = ph.estimate(mode(), coarse.upsample_inputs(4))
    assert max(map(abs, errors(fine).values())) < 3.0


def test_simulation_takes_the_finer_inputs() -> None:
    data = decimated(clean().band_pass(6, 32), 5)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        short = data.window(6.0, 7.0)
    fit = ph.estimate(mode(), short, start=TRUE)
    assert fit.records[0].residuals["y"].std() < 1e-3 * short.output("y").std()
    start = {name: float(fit.initial_states["shake"][name]) for name in ("x", "v")}
    values = {name: fit.parameters[name].value for name in TRUE}
    found = ph.simulate(mode(), values, short, initial=start)
    np.testing.assert_allclose(found.outputs["y"], fit.records[0].outputs["y"], atol=2e-4 * short.output("y").std())
    # And where the fine inputs run in straight lines.
    times, u = short.samples("u")
    y = {"y": (short.t, short.output("y"))}
    lines = ph.simulate(mode(), values, ph.multirate({"u": (times, u)}, y), initial=start)
    at_all = ph.Experiment(times, {"u": u}).window(short.t[0], short.t[-1])
    wanted = ph.simulate(mode(), values, at_all, initial=start)
    np.testing.assert_allclose(lines.outputs["y"], wanted.outputs["y"][::4], rtol=1e-6, atol=1e-9)


def test_a_saved_fit_keeps_the_finer_inputs(tmp_path) -> None:
    fit = ph.estimate(mode(), decimated(measured(1).band_pass(6, 32), 5).window(1.0, 3.0))
    fit.save(tmp_path / "fit.json")
    again = ph.load(tmp_path / "fit.json").records[0]
    for a, b in zip(again.input_samples["u"], fit.records[0].input_samples["u"], strict=True):
        np.testing.assert_array_equal(a, b)
    assert ph.load(tmp_path / "fit.json").integration_error()[0].worst.max() == pytest.approx(
        fit.integration_error()[0].worst.max()
    )


def test_the_integration_error_is_that_with_the_finer_inputs() -> None:
    """Else the path, which followed these, would seem to be wrong between samples."""
    data = decimated(measured(1).band_pass(6, 32), 5).window(1.0, 3.0)
    fit = ph.estimate(mode(), data, transcription=ph.Collocation(order=4, substeps=4))
    error = fit.integration_error()[0].worst.max()
    (run,) = fit.experiments
    inputs = {name: run.input(name) for name in fit.model.input_names}
    outputs = {name: run.output(name) for name in fit.model.output_names}
    blind = replace(fit, experiments=[ph.Experiment(run.t, inputs, outputs, run.name, run.interpolation)])
    assert error < 1e-4 < 10.0 * error < blind.integration_error()[0].worst.max()
