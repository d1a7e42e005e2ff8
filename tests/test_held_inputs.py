"""Inputs that are held between their samples (zero-order hold), against the exact discrete-time solution."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest
from scipy.signal import cont2discrete

import phugoid as ph

A, B, C = 4.0, 0.6, 2.0
STEP = 0.1
HELD: dict[str, Any] = {"u": "hold", "w": "linear"}


def model() -> ph.Model:
    """An oscillator driven by a held command u and a smooth input w; its acceleration jumps with u."""
    m = ph.Model("oscillator")
    x, v = m.states(x="m", v="m/s")
    u, w = m.inputs(u="N", w="N")
    a, b, c = m.parameters(a=1.0, b=1.0, c=1.0)
    force = c * u + w - a * x - b * v
    m.dynamics(x=v, v=force)
    m.outputs(x=x, acceleration=force)
    return m


def exact(
    n: int = 300, seed: int = 3, kick: float = 0.0
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], np.ndarray]:
    """Inputs, outputs and states at the samples: u held, w linear, v kicked at random."""
    random = np.random.default_rng(seed + 1)
    command = np.random.default_rng(seed).choice([-1.0, 1.0, 0.3], n)
    w = np.sin(0.7 * STEP * np.arange(n))
    state, force = np.array([[0.0, 1.0], [-A, -B]]), np.array([[0.0], [1.0]])
    held = cont2discrete((state, force, np.eye(2), np.zeros((2, 1))), STEP, method="zoh")
    # Of w the slope is held: it is the state of an integrator.
    ramp = np.block([[state, force], [np.zeros((1, 3))]])
    slope = cont2discrete((ramp, np.array([[0.0], [0.0], [1.0]]), np.eye(3), np.zeros((3, 1))), STEP, method="zoh")
    x = np.zeros((2, n))
    x[:, 0] = 0.3, -0.2
    for k in range(n - 1):
        linear = slope[0] @ np.append(x[:, k], w[k]) + slope[1][:, 0] * (w[k + 1] - w[k]) / STEP
        x[:, k + 1] = linear[:2] + held[1][:, 0] * C * command[k]
        x[1, k + 1] += kick * np.sqrt(STEP) * random.standard_normal()
    outputs = {"x": x[0], "acceleration": C * command + w - A * x[0] - B * x[1]}
    return {"u": command, "w": w}, outputs, x


def record(interpolation: Any = HELD, noise: float = 0.0, n: int = 300, kick: float = 0.0) -> ph.Experiment:
    inputs, outputs, _ = exact(n, kick=kick)
    random = np.random.default_rng(5)
    z = {k: y + noise * random.standard_normal(n) for k, y in outputs.items()}
    return ph.Experiment(STEP * np.arange(n), inputs, z, "run", interpolation)


KNOWN = ph.Gaussian(sigma={"x": 0.01, "acceleration": 0.01})


def test_simulation_is_exact() -> None:
    _, outputs, x = exact()
    path = ph.simulate(model(), {"a": A, "b": B, "c": C}, record(), initial={"x": 0.3, "v": -0.2}, rtol=1e-12)
    assert path.states["x"] == pytest.approx(x[0], abs=1e-10)
    assert path.states["v"] == pytest.approx(x[1], abs=1e-10)
    assert path.outputs["acceleration"] == pytest.approx(outputs["acceleration"], abs=1e-9)
    assert path.interpolation == HELD


@pytest.mark.parametrize(
    ("transcription", "tolerance"),
    [
        (ph.Collocation(order=8), 1e-9),
        (ph.Collocation(order=8, segments=40), 1e-4),  # w bends within segments, where u does not jump
        (ph.MultipleShooting(segments=10, substeps=20), 1e-8),
        (ph.SingleShooting(substeps=20), 1e-8),
        (ph.Collocation(order=3, refine=True, tolerance=1e-6), 1e-5),
    ],
)
def test_estimates_of_exact_data_are_exact(transcription: Any, tolerance: float) -> None:
    fit = ph.estimate(model(), record(), noise=KNOWN, transcription=transcription)
    assert [fit.parameters[n].value for n in "abc"] == pytest.approx([A, B, C], rel=tolerance)
    assert fit.initial_states["run"]["v"].value == pytest.approx(-0.2, abs=10 * tolerance)


def test_a_wrong_assumption_biases_and_the_right_one_does_not() -> None:
    def errors(interpolation: Any) -> dict[str, float]:
        fit = ph.estimate(model(), record(interpolation, noise=0.01), noise=KNOWN)
        truth = {"a": A, "b": B, "c": C}
        return {n: (fit.parameters[n].value - v) / fit.parameters[n].std_error for n, v in truth.items()}

    held, linear = errors(HELD), errors("linear")
    assert max(map(abs, held.values())) < 3.0
    assert max(map(abs, linear.values())) > 50.0


def test_filter_error_takes_them() -> None:
    method = ph.FilterError("v", initial={"x": None, "v": None})

    def errors(interpolation: Any) -> list[float]:
        run = record(interpolation, noise=0.01, kick=0.05)
        found = ph.estimate(model(), run, transcription=method, start={"q_v": 0.1}).parameters
        truth = {"a": A, "b": B, "c": C, "q_v": 0.05}
        return [abs(found[name].value - v) / found[name].std_error for name, v in truth.items()]

    assert max(errors(HELD)) < 4.0
    assert max(errors("linear")) > 8.0


def test_an_input_of_its_own_samples_is_held_between_these() -> None:
    """Commands at 5 Hz, outputs at 10 Hz a third of an interval later: jumps lie within the intervals."""
    n, h = 200, 0.2
    rng = np.random.default_rng(8)
    at, command = h * np.arange(n), rng.choice([-1.0, 1.0], n)
    t = np.sort(np.concatenate([at, at + h / 3.0, at + h / 2.0]))[:-2]
    state, force = np.array([[0.0, 1.0], [-A, -B]]), np.array([[0.0], [C]])
    x = np.zeros((2, t.size))
    for k in range(t.size - 1):
        step = cont2discrete((state, force, np.eye(2), np.zeros((2, 1))), t[k + 1] - t[k], method="zoh")
        x[:, k + 1] = step[0] @ x[:, k] + step[1][:, 0] * command[np.searchsorted(at, t[k] + 1e-9) - 1]
    seen = np.abs((t + 1e-9) % h - h / 3.0) < 1e-6
    m = ph.Model("oscillator")
    p, v = m.states("p", "v")
    (u,) = m.inputs("u")
    a, b, c = m.parameters(a=1.0, b=1.0, c=1.0)
    m.dynamics(p=v, v=c * u - a * p - b * v)
    m.outputs(p=p)
    run = ph.multirate({"u": (at, command)}, {"p": (t[seen], x[0][seen])}, interpolation={"u": "hold"})
    noise = ph.Gaussian(sigma={"p": 0.01})
    for transcription, tolerance in ((ph.Collocation(order=8), 1e-8), (ph.MultipleShooting(5, substeps=20), 1e-6)):
        fit = ph.estimate(m, run, noise=noise, transcription=transcription)  # type: ignore[arg-type]
        assert [fit.parameters[n].value for n in "abc"] == pytest.approx([A, B, C], rel=tolerance)
    first = {"p": x[0][seen][0], "v": x[1][seen][0]}
    path = ph.simulate(m, {"a": A, "b": B, "c": C}, run, initial=first, rtol=1e-12)
    assert path.outputs["p"] == pytest.approx(x[0][seen], abs=1e-9)


def test_a_delay_moves_the_jumps() -> None:
    """The input reaches the model 0.137 s late: jumps lie within the sampling intervals."""
    late = 0.137
    n, h = 400, 0.1
    t, command = h * np.arange(n), np.random.default_rng(2).choice([-1.0, 1.0], n)
    all_times = np.unique(np.concatenate([t, t + late]).round(9))
    state, force = np.array([[0.0, 1.0], [-A, -B]]), np.array([[0.0], [C]])
    x = np.zeros((2, all_times.size))
    for k in range(all_times.size - 1):
        step = cont2discrete((state, force, np.eye(2), np.zeros((2, 1))), np.diff(all_times)[k], method="zoh")
        before = max(np.searchsorted(t, all_times[k] - late + 1e-9) - 1, 0)
        x[:, k + 1] = step[0] @ x[:, k] + step[1][:, 0] * command[before]
    at = np.searchsorted(all_times, t - 1e-9)
    m = ph.Model("late")
    p, v = m.states("p", "v")
    (u,) = m.inputs("u")
    a, b, c, tau = m.parameters(a=3.0, b=1.0, c=1.0, tau=ph.Parameter(0.1, bounds=(0.0, 0.4)))
    m.dynamics(p=v, v=c * m.delay(u, tau) - a * p - b * v)
    m.outputs(p=p)
    truth = {"a": A, "b": B, "c": C, "tau": late}
    run = ph.Experiment(t, {"u": command}, {"p": x[0][at]}, interpolation={"u": "hold"})
    path = ph.simulate(m, truth, run, initial={"p": 0.0, "v": 0.0}, rtol=1e-12)
    assert path.outputs["p"] == pytest.approx(x[0][at], abs=1e-9)
    fit = ph.estimate(m, run, noise=ph.Gaussian(sigma={"p": 0.01}), transcription=ph.Collocation(order=6))
    assert {n: fit.parameters[n].value for n in truth} == pytest.approx(truth, rel=1e-5)
    noisy = run.with_outputs({"p": x[0][at] + 0.01 * np.random.default_rng(1).standard_normal(n)})
    fit = ph.estimate(m, noisy)
    for name, value in truth.items():
        assert abs(fit.parameters[name].value - value) < 4 * fit.parameters[name].std_error


def test_declarations_are_checked() -> None:
    inputs, outputs, _ = exact(20)
    t = STEP * np.arange(20)
    e = ph.Experiment(t, inputs, outputs, interpolation={"u": "hold"})
    assert (e.interpolation_of("u"), e.interpolation_of("w")) == ("hold", "linear")
    assert e.interpolation == {"u": "hold"}
    for wrong, words in (
        ({"q": "hold"}, "'q'"),
        ({"x": "hold"}, "'x'"),
        ({"u": "zoh"}, "'zoh'"),
        (3, "3"),
        ({"u": None}, "None"),
    ):
        with pytest.raises(ph.DataError) as error:
            ph.Experiment(t, inputs, outputs, interpolation=wrong)  # type: ignore[arg-type]
        assert words in str(error.value) and len(str(error.value)) < 300


def test_steps_on_records_keep_them() -> None:
    e = record(n=200)
    assert e.rename({"u": "command"}).interpolation == {"command": "hold", "w": "linear"}
    assert e.window(1.0, 5.0).interpolation == e.detrend().interpolation == HELD
    assert e.with_outputs({"x": e.output("x")}).interpolation == HELD
    assert pickle.loads(pickle.dumps(e)).interpolation == HELD
    with pytest.warns(UserWarning, match="folds"):
        thin = e.decimate(4)
    own = thin.signal("u")
    assert own is not None and own[0].size == 200 and thin.signal("w") is None  # no jump is lost
    fine = e.upsample_inputs(4)
    assert fine.interpolation == {"u": "hold", "w": "cubic"} and fine.signal("u") is None
    with pytest.raises(ph.OptionError, match="'u' of experiment 'run' is held"):
        e.resample(5.0)
    assert e.to_pandas().attrs["interpolation"] == "u hold, w linear"


def test_decimated_records_give_the_same_estimates() -> None:
    with pytest.warns(UserWarning, match="folds"):
        thin = record(n=400).decimate(4)
    fit = ph.estimate(model(), thin, noise=KNOWN, transcription=ph.Collocation(order=8))
    # Of w, whose samples are thinned, the lines between are others.
    assert [fit.parameters[n].value for n in "abc"] == pytest.approx([A, B, C], rel=2e-3)


@pytest.mark.parametrize("ending", ["json", "h5"])
def test_saved_fits_keep_them(ending: str, tmp_path: Any) -> None:
    if ending == "h5":
        pytest.importorskip("h5py")
    fit = ph.estimate(model(), record(noise=0.01), noise=KNOWN)
    fit.save(tmp_path / f"fit.{ending}")
    again = ph.load(tmp_path / f"fit.{ending}")
    assert again.records[0].interpolation == HELD and again.experiments[0].interpolation == HELD
    refit = ph.estimate(again.model, list(again.experiments), noise=KNOWN, start=again)
    assert refit.parameters["a"].value == pytest.approx(fit.parameters["a"].value, rel=1e-8)


def test_the_integration_error_sees_no_jump_inside() -> None:
    fit = ph.estimate(model(), record(), noise=KNOWN, transcription=ph.Collocation(order=6))
    (error,) = fit.integration_error()
    assert error.worst.max() < 1e-6


def test_a_diagnosis_of_a_right_model_finds_nothing() -> None:
    fit = ph.estimate(model(), record(noise=0.01))
    assert not ph.diagnose(fit).findings


def test_linear_tools_take_them() -> None:
    state_space = ph.linear.subspace(record(noise=1e-4, n=400), 2, offset=False)
    assert np.sort_complex(np.linalg.eigvals(state_space.A)) == pytest.approx(
        np.sort_complex(np.roots([1.0, B, A])), abs=2e-3
    )
