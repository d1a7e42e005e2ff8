"""Two threads of Python that estimate at once, with one model, get what one after the other gets."""

import sys
import threading

import numpy as np

import phugoid as ph


def oscillator() -> ph.Model:
    m = ph.Model("oscillator")
    x, v = m.states(x="m", v="m/s")
    (force,) = m.inputs(force="N")
    k, d = m.parameters("k d")
    m.dynamics(x=v, v=force - k * x - d * v)
    m.outputs(x=x)
    return m


def record(model: ph.Model, seed: int) -> ph.Experiment:
    t = np.arange(0.0, 20.0, 0.02)
    blank = ph.Experiment(t, {"force": np.where(t % 8 < 4, 1.0 + seed, -1.0)}, name=f"run{seed}")
    x = ph.simulate(model, {"k": 4.0, "d": 0.3}, blank).outputs["x"]
    return blank.with_outputs({"x": x + 0.005 * np.random.default_rng(seed).standard_normal(t.size)})


def test_estimations_in_two_threads_have_the_same_bits() -> None:
    model = oscillator()
    runs = [record(model, seed) for seed in range(4)]
    found: dict[int, ph.Fit] = {}

    def fit(i: int) -> None:
        found[i] = ph.estimate(model, runs[i])

    threads = [threading.Thread(target=fit, args=(i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for i, run in enumerate(runs):
        alone = ph.estimate(model, run)
        assert alone.log_likelihood == found[i].log_likelihood
        assert {n: p.value for n, p in alone.parameters.items()} == {n: p.value for n, p in found[i].parameters.items()}


def test_a_free_threaded_python_stays_so() -> None:
    enabled = getattr(sys, "_is_gil_enabled", lambda: True)()
    assert enabled != ("free-threading" in sys.version)
