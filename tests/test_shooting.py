"""Single and multiple shooting through estimate: agreement with collocation and simulation, options, saving."""

from __future__ import annotations

import pickle
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import hfb320
import numpy as np
import pytest
from records import find

import phugoid as ph
from phugoid import (
    Collocation,
    DataError,
    EvaluationError,
    Experiment,
    Fit,
    Ipopt,
    Model,
    MultipleShooting,
    Newton,
    OptionError,
    Parameter,
    SingleShooting,
    estimate,
)

T = np.linspace(0.0, 10.0, 101)
# With the distance from the limit of small steps, in standard errors, that their steps leave.
SHOOTING: list[tuple[MultipleShooting | SingleShooting, float]] = [
    (SingleShooting(substeps=4), 1e-3),
    (SingleShooting(integrator="heun", substeps=40), 1e-2),
    (MultipleShooting(substeps=4), 1e-3),
    (MultipleShooting(7, integrator="dopri5", step=0.03), 1e-4),
    (MultipleShooting([0.0, 2.718, 3.1416, 10.0], integrator="kutta", steps=400), 5e-3),
]
each = pytest.mark.parametrize("transcription", [t for t, _ in SHOOTING], ids=str)


def oscillator(**parameters: Any) -> Model:
    """Van der Pol's, position measured, speed not."""
    m = Model("van der Pol")
    x, v = m.states("x v")
    (u,) = m.inputs("u")
    mu, k = m.parameters(**{"mu": 0.5, "k": 1.2, **parameters})
    m.dynamics(x=v, v=mu * (1 - x**2) * v - k * x + u)
    m.outputs(x=x)
    return m


def record(name: str = "run", seed: int = 0, mu: float = 0.8, missing: bool = False) -> Experiment:
    u = np.sin(1.3 * T + seed) + 0.5 * np.sin(2.9 * T)
    flight = Experiment(T, {"u": u}, name=name, interpolation="cubic")
    truth = ph.simulate(oscillator(), {"mu": mu, "k": 1.5}, flight, initial={"x": 0.5, "v": 0.2})
    z = truth.outputs["x"] + 0.01 * np.random.default_rng(seed).standard_normal(T.size)
    if missing:
        z[5::7] = np.nan
    return Experiment(T, {"u": u}, {"x": z}, name=name, interpolation="cubic")


def distance(fit: Fit, reference: Fit) -> float:
    """Greatest difference of a parameter, in standard errors."""
    return max(abs(fit.parameters[n].value - e.value) / e.std_error for n, e in reference.parameters.items())


@pytest.mark.parametrize(("transcription", "most"), SHOOTING, ids=[str(t) for t, _ in SHOOTING])
def test_agrees_with_collocation(transcription: MultipleShooting | SingleShooting, most: float) -> None:
    data = record(missing=True)
    reference = estimate(oscillator(), data, transcription=Collocation(order=6))
    fit = estimate(oscillator(), data, transcription=transcription)
    assert fit.converged, fit.message
    assert distance(fit, reference) < most
    for name, e in reference.parameters.items():
        assert fit.parameters[name].std_error == pytest.approx(e.std_error, rel=1e-4)
    for name, e in reference.initial_states["run"].items():
        found = fit.initial_states["run"][name]
        assert abs(found.value - e.value) < most * e.std_error
        assert found.std_error == pytest.approx(e.std_error, rel=1e-3)


def test_the_limit_of_small_steps_is_that_of_collocation() -> None:
    path = find(hfb320.RECORD)
    for data in [hfb320.twin(), *([hfb320.experiment(path)] if path else [])]:
        model = hfb320.model()
        reference = estimate(model, data, transcription=Collocation(order=6))
        for substeps, most, gap in ((1, 1e-4, 1e-4), (2, 5e-6, 1e-5)):
            transcription = MultipleShooting(60, integrator="dopri5", substeps=substeps)
            fit = estimate(model, data, transcription=transcription, start=reference)
            assert fit.converged and distance(fit, reference) < most
            assert abs(fit.log_likelihood - reference.log_likelihood) < gap


@pytest.mark.parametrize(
    "transcription", [SingleShooting(substeps=10), MultipleShooting(9, "dopri5", step=0.01)], ids=str
)
def test_the_path_is_that_of_a_simulation(transcription: MultipleShooting | SingleShooting) -> None:
    data = record()
    fit = estimate(oscillator(), data, transcription=transcription)
    again = ph.simulate(oscillator(), fit, data, rtol=1e-12)
    for name in ("x", "v"):
        # Steps of 0.01 s, and defects of the solver's tolerance.
        assert np.abs(fit.states[name] - again.states[name]).max() < 1e-6
    mesh_t, mesh = fit.records[0].mesh_t, fit.records[0].mesh_states["x"]
    assert np.all(np.diff(mesh_t) > 0) and mesh_t[0] == T[0] and mesh_t[-1] == T[-1]
    assert np.abs(np.interp(T, mesh_t, mesh) - fit.states["x"]).max() < 1e-4


@pytest.mark.parametrize("transcription", [SingleShooting(), MultipleShooting(20)], ids=str)
def test_newton_and_ipopt_agree(transcription: MultipleShooting | SingleShooting) -> None:
    pytest.importorskip("cyipopt")
    ours = estimate(oscillator(), record(), transcription=transcription)
    theirs = estimate(oscillator(), record(), transcription=transcription, solver=Ipopt())
    assert ours.converged and theirs.converged
    assert distance(theirs, ours) < 1e-6


def test_experiments_with_parameters_of_their_own() -> None:
    model = oscillator(mu=Parameter(0.5, per_experiment=True))
    data = [record("one", 1, mu=0.8), record("two", 2, mu=1.1, missing=True)]
    reference = estimate(model, data, transcription=Collocation(order=6))
    for transcription in (SingleShooting(substeps=4), MultipleShooting(12, substeps=4)):
        fit = estimate(model, data, transcription=transcription)
        assert fit.converged and {"mu[one]", "mu[two]"} <= set(fit.parameters)
        assert distance(fit, reference) < 1e-3


def test_the_number_of_threads_changes_no_bit() -> None:
    data = [record("one", 1), record("two", 2)]
    fits = [estimate(oscillator(), data, transcription=MultipleShooting(40, threads=n)) for n in (1, 2, 3)]
    for fit in fits[1:]:
        assert fit.parameters.to_dict() == fits[0].parameters.to_dict()
        assert fit.log_likelihood == fits[0].log_likelihood


@each
def test_saved_loaded_pickled(transcription: MultipleShooting | SingleShooting, tmp_path: Path) -> None:
    assert pickle.loads(pickle.dumps(transcription)) == transcription
    fit = estimate(oscillator(), record(), transcription=transcription)
    fit.save(tmp_path / "fit.json")
    loaded = ph.load(tmp_path / "fit.json")
    assert loaded.transcription == transcription
    assert loaded.parameters.to_dict() == fit.parameters.to_dict()
    np.testing.assert_array_equal(loaded.states["v"], fit.states["v"])
    assert pickle.loads(pickle.dumps(fit)).transcription == transcription
    assert "shooting" in str(transcription)


def test_goes_on_from_another_formulation() -> None:
    first = estimate(oscillator(), record(), transcription=Collocation())
    for transcription in (SingleShooting(), MultipleShooting(8), Collocation(order=5)):
        fit = estimate(oscillator(), record(), transcription=transcription, start=first)
        assert fit.converged and fit.iterations <= 5
        first = fit


def test_many_starts() -> None:
    with ThreadPoolExecutor(2) as executor:
        many = ph.multistart(
            oscillator(), record(), {"mu": (0, 2), "k": (1, 2)}, n=4, seed=0, executor=executor,
            transcription=MultipleShooting(20),
        )  # fmt: skip
    assert many.best.converged and isinstance(many.best.transcription, MultipleShooting)
    assert abs(many.best.parameters["mu"].value - 0.8) < 5 * many.best.parameters["mu"].std_error


def test_a_start_without_a_simulation_says_when_it_ends() -> None:
    m = Model("escape")
    (x,) = m.states("x")
    (a,) = m.parameters(a=1.0)
    m.dynamics(x=a * x**3)
    m.outputs(x=x)
    data = Experiment(T, {}, {"x": 1 + 0.01 * np.sin(7 * T)}, name="run")
    for solver in (Newton(), Ipopt()):
        if isinstance(solver, Ipopt):
            pytest.importorskip("cyipopt")
        with pytest.raises(EvaluationError, match=r"the solution of 'run' that starts at t = 0 ceases to exist at"):
            estimate(m, data, transcription=SingleShooting(), solver=solver)
        assert estimate(m, data, transcription=MultipleShooting(50), solver=solver).converged


def test_a_regression_is_for_collocation() -> None:
    with pytest.raises(OptionError, match="makes sense with Collocation only"):
        estimate(oscillator(), record(), transcription=SingleShooting(), solver=Newton(regression=True))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"integrator": "rk5"}, "integrator is one of euler, heun, kutta, rk4, dopri5, not 'rk5'"),
        ({"substeps": 0}, "substeps is a whole number from 1"),
        ({"steps": 2.5}, "steps is a whole number from 1"),
        ({"step": -0.1}, "step is a positive number, not -0.1"),
        ({"step": 0.1, "steps": 3}, "give one"),
        ({"step": 0.1, "substeps": 2}, "give one"),
        ({"threads": -1}, "threads is a whole number from 0"),
    ],
)
def test_wrong_options(options: dict[str, Any], words: str) -> None:
    for kind in (SingleShooting, MultipleShooting):
        with pytest.raises(OptionError, match=f"{kind.__name__}: .*{words}"):
            kind(**options)


def test_wrong_segments() -> None:
    with pytest.raises(OptionError, match="MultipleShooting: at least 1 segment"):
        MultipleShooting(0)
    with pytest.raises(OptionError, match="MultipleShooting: segments is a number"):
        MultipleShooting(None)  # type: ignore[arg-type]
    with pytest.raises(OptionError, match="MultipleShooting: the segments run from 0 to 9, but"):
        estimate(oscillator(), record(), transcription=MultipleShooting([0, 5, 9]))
    with pytest.raises(OptionError, match="Collocation, FilterError, MultipleShooting or SingleShooting"):
        estimate(oscillator(), record(), transcription="shooting")  # type: ignore[arg-type]


def test_a_damaged_file_is_an_error(tmp_path: Path) -> None:
    fit = estimate(oscillator(), record(), transcription=SingleShooting())
    fit.save(tmp_path / "fit.json")
    text = (tmp_path / "fit.json").read_text()
    (tmp_path / "fit.json").write_text(text.replace("SingleShooting", "TripleShooting"))
    with pytest.raises(DataError, match="is damaged"):
        ph.load(tmp_path / "fit.json")


@pytest.mark.parametrize("noise", [ph.StudentT(), ph.PerExperiment()], ids=["Student's t", "per experiment"])
def test_other_noise_is_collocations(noise: Any) -> None:
    data = [record("one", 1), record("two", 2, missing=True)]
    reference = estimate(oscillator(), data, transcription=Collocation(order=6), noise=noise)
    for transcription in (SingleShooting(substeps=4), MultipleShooting(20, substeps=4)):
        fit = estimate(oscillator(), data, transcription=transcription, noise=noise)
        assert fit.converged and set(fit.parameters) == set(reference.parameters)
        assert distance(fit, reference) < 1e-3
