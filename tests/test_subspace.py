"""The subspace method finds linear systems from records alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from linear_case import RATE, run
from scipy.interpolate import CubicSpline
from scipy.signal import butter, lfilter, lsim

import phugoid as ph

POLES = (-0.3 + 6.0j, -0.5 + 14.0j, -0.9 + 25.0j)


def system(poles: tuple[complex, ...] = POLES, m: int = 2, p: int = 2, D: float = 0.2) -> ph.linear.StateSpace:
    random = np.random.default_rng(1)
    n = 2 * len(poles)
    A = np.zeros((n, n))
    for k, pole in enumerate(poles):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[pole.real, pole.imag], [-pole.imag, pole.real]]
    return ph.linear.StateSpace(
        A, random.normal(size=(n, m)), random.normal(size=(p, n)), D * random.normal(size=(p, m))
    )


def distance(found: ph.linear.StateSpace, truth: ph.linear.StateSpace) -> float:
    """Greatest error of a frequency response, in parts of its root mean square."""
    f = np.linspace(0.2, 8.0, 200)
    worst = 0.0
    for u in truth.inputs:
        for y in truth.outputs:
            G = truth.frequency_response(f, u, y).response
            H = found.frequency_response(f, u, y).response
            worst = max(worst, np.sqrt(np.mean(np.abs(H - G) ** 2) / np.mean(np.abs(G) ** 2)))
    return worst


@pytest.mark.parametrize("weighting", ["cva", "moesp"])
def test_it_finds_modes_response_and_order_in_noise(weighting: Any) -> None:
    truth = system()
    data = run(truth)
    found = ph.linear.subspace(data, 6, weighting=weighting)
    np.testing.assert_allclose(found.modes.eigenvalues, POLES, atol=0.06)
    assert distance(found, truth) < 0.02
    assert not found.warnings
    if weighting == "cva":
        assert found.suggested_order in (6, 7, 8)
    noise = [0.02 * data.output(y).std() for y in truth.outputs]
    np.testing.assert_allclose(list(found.residual_rms.values()), noise, rtol=0.06)


def test_without_noise_it_is_exact() -> None:
    """Also the initial states: the record is what they, B and D make."""
    truth = system()
    data = run(truth, 1000, noise=0.0)
    found = ph.linear.subspace(data, 6, offset=False)
    np.testing.assert_allclose(found.modes.eigenvalues, POLES, rtol=1e-7)
    assert distance(found, truth) < 1e-7
    u = np.array([data.input(name) for name in truth.inputs])
    _, y, _ = lsim((found.A, found.B, found.C, found.D), u.T, data.t, X0=found.x0["run"])
    np.testing.assert_allclose(y[:, 0], data.output("y1"), atol=1e-7)


def test_inputs_sampled_faster_than_outputs_are_used_as_they_are() -> None:
    """Taken at the samples of the outputs, an input with more in it misleads."""
    truth = system(m=1)
    fine, t = np.arange(8000) / (4 * RATE), np.arange(2000) / RATE
    u = lfilter(*butter(4, 0.3), np.random.default_rng(3).normal(size=fine.size))
    at = np.arange(32000 - 3) / (16 * RATE)
    _, y, _ = lsim((truth.A, truth.B, truth.C, truth.D), CubicSpline(fine, u)(at), at)
    y = y[::16][: t.size].T
    outputs = dict(zip(truth.outputs, y, strict=True))
    several = ph.multirate({"u": (fine, u)}, {k: (t, z) for k, z in outputs.items()}, interpolation="cubic")
    single = ph.Experiment(t, {"u": u[::4]}, outputs, interpolation="cubic")
    good, bad = (distance(ph.linear.subspace(e, 6), truth) for e in (several, single))
    assert good < 0.03 and 1.5 * good < bad


def test_experiments_are_pooled_each_with_its_states_and_offset() -> None:
    truth = system()
    runs = [run(truth, 900, 0.05, seed, f"run{seed}", offset=10.0 * seed) for seed in range(3)]
    found = ph.linear.subspace(runs, 6)
    alone = ph.linear.subspace(runs[:1], 6)
    assert distance(found, truth) < 0.04 and distance(found, truth) < distance(alone, truth)
    for seed in range(3):
        np.testing.assert_allclose(found.offsets[f"run{seed}"], 10.0 * seed, atol=0.1)
        assert found.x0[f"run{seed}"].shape == (6,)


def test_a_growing_mode_is_found_and_simulated() -> None:
    truth = system((0.08 + 5.0j, -0.5 + 14.0j))
    data = run(truth, 1500, 1e-4)
    found = ph.linear.subspace(data, 4)
    np.testing.assert_allclose(found.modes.eigenvalues, [0.08 + 5.0j, -0.5 + 14.0j], atol=1e-3)
    assert found.warnings == ("1 mode grows with time",)
    u = np.array([data.input(name) for name in truth.inputs])
    _, y, _ = lsim((found.A, found.B, found.C, found.D), u.T, data.t, X0=found.x0["run"])
    y = y.T + found.offsets["run"][:, None]
    assert all(np.std(data.output(k) - z) < 0.02 * data.output(k).std() for k, z in zip(truth.outputs, y, strict=True))
    assert ph.linear.subspace(data, 4, stable=True).modes[0].stable


def test_the_default_order_is_that_of_the_data() -> None:
    assert ph.linear.subspace(run(system(), 3000)).order in (6, 7, 8)


def test_feedthrough_is_found_where_it_may_be() -> None:
    truth = system()
    D = ph.linear.subspace(run(truth), 6, feedthrough="y2").D
    assert not D[0].any()
    np.testing.assert_allclose(D[1], truth.D[1], atol=0.05)


def test_an_order_too_high_still_fits_and_can_be_pruned() -> None:
    data = run(system(), 1000, 0.3)
    found = ph.linear.subspace(data, 15)
    assert distance(found, system()) < 0.4
    assert found.order >= 15
    pruned = ph.linear.subspace(data, 15, prune=True)
    assert pruned.order == 6 and distance(pruned, system()) < 0.2


def test_it_starts_an_estimation_that_ends_at_the_truth() -> None:
    """Three modes, 2,000 samples: parameters within 3.5 standard errors, in two iterations a mode or so."""
    truth = system(m=1, p=1)
    data = run(truth)
    model = ph.models.modal(start=ph.linear.subspace(data, 6))
    fit = ph.estimate(model, data)
    assert fit.converged and fit.iterations < 12
    exact = ph.models.modal(start=truth).declared_parameters
    for name, p in exact.items():
        e = fit.parameters[name]
        assert e.fixed == p.fixed
        if not p.fixed:
            assert abs(e.value - p.start) < 3.5 * e.std_error
    values = [m.eigenvalue for m in ph.linear.modes(fit)]
    np.testing.assert_allclose(values, POLES, atol=0.03)


def test_what_cannot_be_right_is_refused() -> None:
    good = run(system(), 400)
    u, y = dict(good.inputs), dict(good.outputs)
    gap = np.where(np.arange(400) == 7, np.nan, y["y1"])
    uneven = np.where(np.arange(400) > 200, good.t + 0.5, good.t)
    slow = ph.Experiment(2 * good.t, u, y, "slow")
    still = {**y, "y1": np.ones(400)}
    cases: list[tuple[type[Exception], str, Any]] = [
        (
            ph.DataError,
            "in experiment 'experiment' the interval after t = 4 is 0.52 ",
            lambda: ph.linear.subspace(ph.Experiment(uneven, u, y), 6),
        ),
        (
            ph.DataError,
            "output 'y1': sample 7 (t = 0.14) is missing: cut",
            lambda: ph.linear.subspace(ph.Experiment(good.t, u, {**y, "y1": gap}), 6),
        ),
        (ph.DataError, "has no input 'de'", lambda: ph.linear.subspace(good, 6, inputs="de")),
        (ph.DataError, "has no output 'q'", lambda: ph.linear.subspace(good, 6, outputs=("q",))),
        (ph.DataError, "'run' has 50 and 'slow' 25", lambda: ph.linear.subspace([good, slow], 6)),
        (ph.DataError, "'y1' never changes", lambda: ph.linear.subspace(ph.Experiment(good.t, u, still), 6)),
        (
            ph.DataError,
            "does not say which channels are inputs",
            lambda: ph.linear.subspace(ph.Experiment(good.t, None, y), 6),
        ),
        (
            ph.DataError,
            "400 samples are too few for 60 block rows of 4 channels, which need 599",
            lambda: ph.linear.subspace(good, 6, block_rows=60),
        ),
        (ph.DataError, "are too few for", lambda: ph.linear.subspace(good, 90)),
        (
            ph.OptionError,
            "order 20 is too high for 8 block rows, which hold 14 states",
            lambda: ph.linear.subspace(good, 20, block_rows=8),
        ),
        (ph.OptionError, "order is a whole number from 1, or None", lambda: ph.linear.subspace(good, 0)),
        (ph.OptionError, "block_rows is a whole number from 1", lambda: ph.linear.subspace(good, 2, block_rows=2.5)),  # type: ignore[arg-type]
        (ph.OptionError, 'weighting is "cva" or "moesp"', lambda: ph.linear.subspace(good, 2, weighting="n4sid")),  # type: ignore[arg-type]
        (
            ph.OptionError,
            "feedthrough: 'y3' is not an output. There are: y1, y2.",
            lambda: ph.linear.subspace(good, 2, feedthrough=["y3"]),
        ),
        (ph.OptionError, "each once", lambda: ph.linear.subspace(good, 2, outputs="y1 y1")),
    ]
    for kind, message, call in cases:
        with pytest.raises(kind) as error:
            call()
        assert message in str(error.value), str(error.value)


def test_a_background_of_heavily_damped_pairs() -> None:
    """Two lags and two oscillators: these stay, a pair takes the place of the lags and simulates nearly as well."""
    rng = np.random.default_rng(5)
    t = 0.02 * np.arange(6000)
    u = rng.standard_normal(t.size)
    lags = lsim(([[-6.0, 0.0], [0.0, -14.0]], [[6.0], [14.0]], [[1.0, 0.5]], [[0.0]]), u, t)[1]
    modes = [lsim(([[-0.3, w], [-w, -0.3]], [[1.0], [0.0]], [[1.0, 0.0]], [[0.0]]), u, t)[1] for w in (4.0, 20.0)]
    y = lags + modes[0] + modes[1]
    run = ph.Experiment(t, {"u": u}, {"y": y + 0.01 * rng.standard_normal(t.size)})
    free = ph.linear.subspace(run, 6, feedthrough=False)
    joined = ph.linear.subspace(run, 6, feedthrough=False, background=True)
    assert sum(mode.oscillates for mode in free.modes) == 2
    assert len(joined.modes) == 3 and all(mode.oscillates for mode in joined.modes)
    light = [mode.frequency.value for mode in joined.modes if mode.damping.value < 0.15]
    assert light == pytest.approx(np.array([4.0, 20.0]) / (2 * np.pi), rel=0.02)
    # Without the lags there is this much more than the noise; the pair leaves hardly any.
    assert joined.residual_rms["y"] < 0.2 * np.std(lags)
    two = ph.Experiment(t, {"u": u}, {"y": y, "z": 2.0 * y})
    with pytest.raises(ph.OptionError, match="one output"):
        ph.linear.subspace(two, 4, background=True)
