"""The log-likelihood of the integrated model: of fits that were cut, and where the parameters tell the motion."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import phugoid as ph

SIGMA = 0.05


def oscillator(a: float = 3.0, b: float = 1.0) -> ph.Model:
    m = ph.Model("relaxation")
    x, y = m.states("x y")
    rates = {"a": ph.Parameter(a, bounds=(0.01, 100), transform="log")}
    rates["b"] = ph.Parameter(b, bounds=(0.01, 100), transform="log")
    a_, b_ = m.parameters(**rates)
    m.dynamics(x=y, y=10 * a_ * (1 - x**2) * y - b_ * x)
    m.initial(x=2.0, y=0.0)
    m.outputs(z=x)
    return m


def record() -> ph.Experiment:
    t = np.linspace(0, 20, 12)
    run = ph.simulate(oscillator(), {"a": 0.5, "b": 1.5}, ph.Experiment(t, {}, name="one"))
    noise = SIGMA * np.random.default_rng(0).standard_normal(t.size)
    return ph.Experiment(t, outputs={"z": run.outputs["z"] + noise}, name="one")


def by_hand(fit: ph.results.Fit, e: ph.Experiment) -> float:
    values = {n: fit.parameters[n].value for n in "ab"}
    initial = {n: s.value for n, s in fit.initial_states["one"].items()}
    residual = (e.output("z") - ph.simulate(oscillator(), values, e, initial=initial).outputs["z"]) / SIGMA
    return float(-0.5 * residual @ residual) - e.n * math.log(SIGMA)


def cut(iterations: int) -> ph.results.Fit:
    """Return a fit that a limit ends on a mesh that is too coarse for the motion."""
    return ph.estimate(
        oscillator(0.5, 1.5),
        record(),
        noise=ph.Gaussian({"z": SIGMA}),
        transcription=ph.Collocation(substeps=3),
        solver=ph.Newton(max_iterations=iterations),
    )


def test_a_fit_that_was_cut_says_what_its_estimates_are_worth() -> None:
    fit = cut(2)
    assert fit.status == "iteration limit"
    truth = by_hand(fit, record())
    assert fit.integrated_log_likelihood == pytest.approx(truth, abs=1e-4)
    assert abs(fit.log_likelihood - truth) > 1.0
    text = f"integrated with these estimates has the log-likelihood {truth:.6g}"[:-2]
    assert any(text in w for w in fit.warnings)


def test_fits_on_meshes_that_follow_the_motion_are_compared() -> None:
    e = record()
    fit = ph.estimate(oscillator(), e, noise=ph.Gaussian({"z": SIGMA}), solver=ph.Newton(restarts=0))
    assert fit.integrated_log_likelihood == pytest.approx(by_hand(fit, e), abs=1e-4)
    assert fit.log_likelihood == pytest.approx(by_hand(fit, e), abs=0.1)
    assert not any("integrated" in w for w in fit.warnings)


def test_a_given_mesh_that_is_too_coarse_is_compared() -> None:
    e = record()
    mesh = ph.Collocation(substeps=8, order=2)
    fit = ph.estimate(oscillator(0.5, 1.5), e, noise=ph.Gaussian({"z": SIGMA}), transcription=mesh)
    assert fit.status == "converged"
    assert fit.integrated_log_likelihood == pytest.approx(by_hand(fit, e), abs=1e-4)
    assert fit.log_likelihood > fit.integrated_log_likelihood + 100
    assert any("the mesh is too coarse for this path" in w for w in fit.warnings)
    assert "the mesh is too coarse for this path" in fit.summary()


def test_a_mesh_that_may_be_refined_follows_the_motion_where_the_integrated_model_differs() -> None:
    e = record()
    mesh = ph.Collocation(substeps=8, order=2, refine=True)
    fit = ph.estimate(oscillator(0.5, 1.5), e, noise=ph.Gaussian({"z": SIGMA}), transcription=mesh)
    assert fit.status == "converged"
    assert fit.log_likelihood == pytest.approx(by_hand(fit, e), abs=0.1)
    assert not any("integrated" in w for w in fit.warnings)


def test_it_is_saved(tmp_path: Path) -> None:
    fit = cut(2)
    fit.save(tmp_path / "fit.json")
    assert ph.load(tmp_path / "fit.json").integrated_log_likelihood == fit.integrated_log_likelihood


def test_dense_records_need_no_comparison() -> None:
    t = np.linspace(0, 2, 200)
    m = ph.Model("decay")
    (x,) = m.states("x")
    (k,) = m.parameters(k=1.0)
    m.dynamics(x=-k * x)
    m.outputs(x=x)
    e = ph.Experiment(t, outputs={"x": np.exp(-2 * t) + 0.01 * np.sin(50 * t)})
    assert ph.estimate(m, e).integrated_log_likelihood is None


def test_many_starts_are_ranked_by_it() -> None:
    m, e = oscillator(0.5, 1.5), record()
    found = ph.multistart(
        m,
        e,
        starts=[{"a": 0.5, "b": 1.5}, {"a": 0.4, "b": 1.4}],
        noise=ph.Gaussian({"z": SIGMA}),
        transcription=ph.Collocation(substeps=3),
        solver=ph.Newton(max_iterations=2),
    )
    for outcome in found.outcomes:
        fit = found.fit(outcome.index)
        assert outcome.log_likelihood == pytest.approx(fit.integrated_log_likelihood, abs=1e-6)
