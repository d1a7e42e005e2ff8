"""Bands about outputs: how often what they are of lies within, on the records of the fit and on others."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib import pyplot as plt
from oscillator import SIGMA, TRUE, clean, measured, model

import phugoid as ph


def inside(band: tuple[np.ndarray, np.ndarray], values: np.ndarray) -> float:
    low, high = band
    return float(np.mean((low <= values) & (values <= high)))


@pytest.mark.parametrize(("rho", "coloured"), [((0.0, 0.0), False), ((0.9, 0.9), True)], ids=["white", "coloured"])
def test_bands_hold_the_truth_and_new_measurements(rho: tuple[float, float], coloured: bool) -> None:
    truth, new = clean(300), measured(300, rho, 999)
    found: dict[str, list[float]] = {"model": [], "measurement": [], "narrow": []}
    for seed in range(40):
        fit = ph.estimate(model(), measured(300, rho, seed))
        bands = fit.prediction_bands(coloured=coloured)
        narrow = fit.prediction_bands(coloured=False)
        for name in SIGMA:
            found["model"].append(inside(bands.model[name], truth.output(name)))
            found["narrow"].append(inside(narrow.model[name], truth.output(name)))
            found["measurement"].append(inside(bands.measurement[name], new.output(name)))
    assert 0.88 < np.mean(found["model"]) < 0.99
    assert 0.90 < np.mean(found["measurement"]) < 0.98
    if coloured:
        assert np.mean(found["narrow"]) < 0.7


def test_errors_of_outputs_are_those_of_repeated_experiments() -> None:
    fits = [ph.estimate(model(), measured(200, (0.0, 0.0), seed)) for seed in range(60)]
    for name in SIGMA:
        scatter = np.std([fit.outputs[name] for fit in fits], axis=0)
        error = np.mean([fit.prediction_bands(coloured=False).std_errors[name] for fit in fits], axis=0)
        assert np.sqrt(np.mean(error**2)) == pytest.approx(np.sqrt(np.mean(scatter**2)), rel=0.15)
        assert np.corrcoef(error, scatter)[0, 1] > 0.7


def other_run(seed: int) -> ph.Experiment:
    t = 0.05 * np.arange(160)
    run = ph.Experiment(t, {"u": np.sin(1.7 * t)}, name="other")
    y = ph.simulate(model(), TRUE, run, initial={"x": 0.3, "v": -0.2}).outputs
    random = np.random.default_rng(seed)
    return run.with_outputs({n: y[n] + SIGMA[n] * random.standard_normal(160) for n in SIGMA})


def test_another_record_with_first_states_found_anew() -> None:
    """The scatter of its outputs over repetitions of both experiments; initial states and parameters depend."""
    outputs, errors = [], []
    for seed in range(60):
        fit = ph.estimate(model(), measured(200, (0.0, 0.0), seed))
        bands = fit.prediction_bands(other_run(seed + 500), coloured=False)
        outputs.append([bands.record.outputs[n] for n in SIGMA])
        errors.append([bands.std_errors[n] for n in SIGMA])
    scatter, error = np.std(outputs, axis=0), np.mean(errors, axis=0)
    assert np.sqrt(np.mean(error**2, axis=1)) == pytest.approx(np.sqrt(np.mean(scatter**2, axis=1)), rel=0.15)
    for a, b in zip(scatter, error, strict=True):
        assert np.corrcoef(a, b)[0, 1] > 0.7


def test_logarithms_fixed_parameters_and_biases_elsewhere() -> None:
    """The same model in other clothes has the same bands."""
    m = ph.Model("in clothes")
    x, v = m.states("x v")
    (u,) = m.inputs("u")
    k, c, b, one, bias = m.parameters(
        k=ph.Parameter(4.0, transform="log"),
        c=1.0,
        b=2.0,
        one=ph.Parameter(1.0, fixed=True),
        bias=ph.Parameter(0.0, per_experiment=True),
    )
    m.dynamics(x=v, v=-k * x - c * v + b * one * u)
    m.outputs(x=x, v=v + bias)
    plain = ph.Model("plain")
    x, v = plain.states("x v")
    (u,) = plain.inputs("u")
    k, c, b, bias = plain.parameters(k=4.0, c=1.0, b=2.0, bias=0.0)
    plain.dynamics(x=v, v=-k * x - c * v + b * u)
    plain.outputs(x=x, v=v + bias)
    run = measured(200, (0.5, 0.5), 0)
    dressed, bare = (ph.estimate(each, run).prediction_bands(other_run(0)) for each in (m, plain))
    for name in SIGMA:
        assert dressed.std_errors[name] == pytest.approx(bare.std_errors[name], rel=1e-3)


def test_delays_here_and_elsewhere() -> None:
    m = ph.Model("late")
    x, v = m.states("x v")
    (u,) = m.inputs("u")
    k, c, b, tau, ts = m.parameters(
        k=4.0, c=1.0, b=2.0, tau=ph.Parameter(0.0, bounds=(-0.3, 0.3)), ts=ph.Parameter(0.0, bounds=(-0.3, 0.3))
    )
    m.dynamics(x=v, v=-k * x - c * v + b * m.delay(u, tau))
    m.outputs(x=x, v=v)
    m.sensor_delay(v=ts)
    fit = ph.estimate(m, measured(200, (0.0, 0.0), 0))
    bands = fit.prediction_bands(coloured=False)
    without = ph.estimate(model(), measured(200, (0.0, 0.0), 0)).prediction_bands(coloured=False)
    for name in SIGMA:
        there = np.isfinite(fit.outputs[name])
        assert np.isfinite(bands.std_errors[name][there]).all()
        # What is not known adds to the errors.
        assert np.mean(bands.std_errors[name][there]) > np.mean(without.std_errors[name][there])
    elsewhere = fit.prediction_bands(other_run(0))
    inside_new = [inside(elsewhere.measurement[n], elsewhere.record.measured[n]) for n in SIGMA]
    assert min(inside_new) > 0.85


def test_several_experiments_levels_and_the_figure() -> None:
    fit = ph.estimate(model(), [measured(150, (0.0, 0.0), i, name=name) for i, name in enumerate(("one", "two"))])
    with pytest.raises(ph.errors.DataError, match="'one', 'two'"):
        fit.prediction_bands()
    wide, narrow = fit.prediction_bands("two", level=0.99), fit.prediction_bands(1, level=0.5)
    assert wide.record.name == narrow.record.name == "two"
    assert np.all(wide.model["x"][1] > narrow.model["x"][1])
    figure, axes = wide.plot()
    assert list(axes) == ["x", "v"]
    assert "two, 99 %" in figure.get_suptitle()
    plt.close("all")


def test_bad_input() -> None:
    fit = ph.estimate(model(), measured(150, (0.0, 0.0), 0))
    with pytest.raises(ph.errors.UnknownName, match="'rum'"):
        fit.prediction_bands("rum")
    with pytest.raises(ph.errors.OptionError, match="below 1"):
        fit.prediction_bands(3)
    with pytest.raises(ph.errors.OptionError, match="level"):
        fit.prediction_bands(level=1.0)
    with pytest.raises(ph.errors.OptionError, match="biases and values"):
        fit.prediction_bands(biases=["k"])
    with pytest.raises(ph.errors.DataError, match="lacks what the model has"):
        fit.prediction_bands(ph.Experiment([0.0, 1.0, 2.0], outputs={"x": [0.0, 1.0, 2.0]}))
