"""Noise of which each experiment has its own."""

from __future__ import annotations

import numpy as np
import pytest

import phugoid as ph

SIGMA = [0.05, 0.2]


def model(names: tuple[str, ...] = ("x", "v")) -> ph.Model:
    m = ph.Model("oscillator")
    x, v = m.states(x="m", v="m/s")
    (u,) = m.inputs("u")
    k, c = m.parameters(k=1.0, c=0.5)
    m.dynamics(x=v, v=-k * x - c * v + u)
    m.outputs(**dict(zip(names, (x, v), strict=True)))
    return m


def runs() -> list[ph.Experiment]:
    random = np.random.default_rng(0)
    found = []
    for i, sigma in enumerate(SIGMA):
        t = np.linspace(0, 20, 300 + 100 * i)
        e = ph.Experiment(t, {"u": np.sign(np.sin(0.9 * t))}, name=f"run {i}")
        path = ph.simulate(model(), {"k": 2.0, "c": 0.4}, e, initial={"x": 0.3, "v": 0.0})
        noise = random.standard_normal((2, t.size))
        noise[1] = 0.8 * noise[0] + 0.6 * noise[1]
        found.append(e.with_outputs({n: path.outputs[n] + sigma * r for n, r in zip(("x", "v"), noise, strict=True)}))
    return found


@pytest.mark.parametrize("kind", [ph.Gaussian(), ph.StudentT(dof=50.0)])
def test_each_record_has_its_own_sigma(kind: ph.Gaussian) -> None:
    fit = ph.estimate(model(), runs(), noise=ph.PerExperiment(kind))
    assert fit.converged
    assert "sigma_x[run 0]" in fit.parameters and "sigma_x" not in fit.parameters
    for i, sigma in enumerate(SIGMA):
        for output in ("x", "v"):
            e = fit.parameters[f"sigma_{output}[run {i}]"]
            assert abs(e.value - sigma) < 4 * e.std_error + 0.03 * sigma
    shared = ph.estimate(model(), runs(), noise=kind)
    assert fit.log_likelihood > shared.log_likelihood + 100
    # The quieter record counts for more.
    assert fit.parameters["k"].std_error < 0.8 * shared.parameters["k"].std_error


def test_it_is_two_fits_where_nothing_is_shared() -> None:
    m = model()
    local = ph.Model("each its own")
    x, v = local.states(x="m", v="m/s")
    (u,) = local.inputs("u")
    k, c = local.parameters(k=ph.Parameter(1.0, per_experiment=True), c=ph.Parameter(0.5, per_experiment=True))
    local.dynamics(x=v, v=-k * x - c * v + u)
    local.outputs(x=x, v=v)
    noise = ph.Gaussian(correlated=True)
    both = ph.estimate(local, runs(), noise=ph.PerExperiment(noise))
    alone = [ph.estimate(m, run, noise=noise) for run in runs()]
    assert both.log_likelihood == pytest.approx(sum(fit.log_likelihood for fit in alone), abs=1e-6)
    for i, fit in enumerate(alone):
        for name, e in fit.parameters.items():
            own = both.parameters[f"{name}[run {i}]"]
            assert own.value == pytest.approx(e.value, rel=1e-6)
            assert own.std_error == pytest.approx(e.std_error, rel=1e-4)
    assert both.parameters["corr_x_v[run 1]"].value == pytest.approx(0.8, abs=0.1)


def test_it_is_saved_starts_again_and_derivatives_are_right(tmp_path: object) -> None:
    noise = ph.PerExperiment(ph.StudentT())
    fit = ph.estimate(model(), runs(), noise=noise)
    again = ph.estimate(model(), runs(), noise=noise, start=fit)
    assert again.log_likelihood == pytest.approx(fit.log_likelihood, abs=1e-6)
    path = f"{tmp_path}/fit.json"
    fit.save(path)
    assert ph.load(path).noise == noise
    assert "sigma_x[run 0]" in fit.summary().split("noise", 1)[1]
    resolved = noise.resolve(["x", "v"], {"x": 1.0, "v": 1.0}, {})
    problem = ph.Collocation(order=3).problem(model(), runs(), resolved)
    random = np.random.default_rng(0)
    xi = 1.0 + 0.1 * random.standard_normal(problem.n)
    xi[6:10] = 0.2
    assert problem.check_derivatives(xi, random.standard_normal(problem.m), list(range(14)), 1e-6) == []


def test_wrong_noise_is_refused() -> None:
    with pytest.raises(ph.ModelError, match="PerExperiment: give another noise model"):
        ph.PerExperiment(ph.PerExperiment())
