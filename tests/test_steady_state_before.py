"""Records that begin at the steady state before a change: long rests, few samples, fast motions."""

from __future__ import annotations

import numpy as np
import pytest

import phugoid as ph

# A rest so long that nothing moves at its end, on a mesh from the fastest motion to the slowest.
REST = 1e5 * (np.concatenate([[0.0], np.logspace(-9.0, 0.0, 40)]) - 1.0)


def _logarithmic(truth: dict[str, float]) -> dict[str, ph.Parameter]:
    return {n: ph.Parameter(v, bounds=(1e-5, 1e4), transform="log") for n, v in truth.items()}


def _after_rest(times: np.ndarray, before: float, after: float, name: str) -> tuple[np.ndarray, dict, str]:
    t = np.concatenate([REST[:-1], times])
    return t, {"u": np.where(t < 0, before, after)}, name


def _measured(
    model: ph.Model, truth: dict[str, float], records: list[tuple[np.ndarray, dict, str]], sigma: float
) -> list[ph.Experiment]:
    """Simulate the truth, add noise from t = 0 on, and leave out what comes before."""
    rng = np.random.default_rng(12)
    found = []
    for t, inputs, name in records:
        made = ph.simulate(model, truth, ph.Experiment(t, inputs, name=name, interpolation={"u": "hold"}))
        outputs = {n: np.where(t < 0, np.nan, y + sigma * rng.standard_normal(t.size)) for n, y in made.outputs.items()}
        found.append(ph.Experiment(t, inputs, outputs, name=name, interpolation={"u": "hold"}))
    return found


def labelled() -> tuple[ph.Model, dict[str, float], list[ph.Experiment]]:
    """Six forms of a protein that turn into each other, all measured four times after the supply has stopped."""
    m = ph.Model("labelled")
    names = [f"x{i}{j}" for i in range(3) for j in range(2)]
    states = dict(zip(names, m.states(*names), strict=True))
    (supply,) = m.inputs("u")
    rng = np.random.default_rng(3)
    edges = [("x00", "x10"), ("x10", "x20"), ("x01", "x11"), ("x11", "x21")]
    edges += [("x00", "x01"), ("x10", "x11"), ("x20", "x21")]
    truth = {f"{way}_{a}_{b}": float(10 ** rng.uniform(-2.5, -0.5)) for a, b in edges for way in ("to", "from")}
    truth["dilution"] = 0.03
    p = dict(zip(truth, m.parameters(**_logarithmic(truth)), strict=True))
    slopes = {n: -p["dilution"] * x for n, x in states.items()}
    slopes["x00"] = slopes["x00"] + supply * p["dilution"]
    for a, b in edges:
        flow = p[f"to_{a}_{b}"] * states[a] - p[f"from_{a}_{b}"] * states[b]
        slopes[a], slopes[b] = slopes[a] - flow, slopes[b] + flow
    m.dynamics(**slopes)
    m.initial(**{n: float(n == "x00") for n in names})
    m.outputs(**{f"{n}_measured": x for n, x in states.items()})
    record = _after_rest(np.array([0.0, 10.0, 24.0, 48.0]), 1.0, 0.0, "pulse")
    return m, truth, _measured(m, truth, [record], 0.005)


def receptor() -> tuple[ph.Model, dict[str, float], list[ph.Experiment]]:
    """A receptor with a fast feedback, given doses from rest; two sums of states are measured in units of their own."""
    m = ph.Model("receptor")
    free, bound, active, inside, back, fed = m.states("free", "bound", "active", "inside", "back", "fed")
    (dose,) = m.inputs("u")
    truth = {"on": 0.18, "off": 0.005, "start": 0.36, "turn": 1.6, "take": 0.26, "return_": 0.03, "feed": 0.5}
    truth |= {"calm": 0.03, "gain": 25.0, "scale_1": 20.0, "scale_2": 30.0}
    p = dict(zip(truth, m.parameters(**_logarithmic(truth)), strict=True))
    binding = p["on"] * dose * free + 1e-3 * p["on"] * free - p["off"] * bound
    taken = p["take"] * inside * p["gain"] * fed / (1 + fed)
    m.dynamics(
        free=-binding + p["return_"] * back,
        bound=binding - p["start"] * bound,
        active=p["start"] * bound - p["turn"] * active,
        inside=p["turn"] * active - taken,
        back=taken - p["return_"] * back,
        fed=p["feed"] * (active + inside) * (10 - fed) - p["calm"] * fed,
    )
    m.initial(free=10, bound=0, active=0, inside=0, back=0, fed=0)
    m.outputs(active_sum=p["scale_1"] * (active + inside), fed_sum=p["scale_2"] * fed)
    course = np.array([0.0, 1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0, 15.0, 20.0, 30.0])
    records = [_after_rest(course, 0.0, 100.0, "high"), _after_rest(course[[0, 3, 5, 7, 10]], 0.0, 1.2, "low")]
    records += [_after_rest(np.array([0.0, 10.0]), 0.0, d, f"dose {d}") for d in (0.01, 0.1, 0.3, 1.0, 10.0)]
    return m, truth, _measured(m, truth, records, 1.0)


@pytest.fixture(scope="module", params=[labelled, receptor], ids=lambda make: make.__name__)
def case(request: pytest.FixtureRequest) -> tuple[ph.Model, dict[str, float], list[ph.Experiment]]:
    return request.param()


def test_the_optimum_is_reached_from_the_truth_and_held(case):
    model, truth, records = case
    fit = ph.estimate(model, records, start=truth, solver=ph.Newton(restarts=0))
    assert fit.converged or fit.status in ("acceptable", "unidentifiable")
    values = {n: fit.parameters[n].value for n in truth}
    # The likelihood is that of an integration with these parameters, and above that of the truth.
    for record, found in zip(records, fit.records, strict=True):
        simulated = ph.simulate(model, values, record)
        for name in model.output_names:
            measured = np.isfinite(record.outputs[name])
            noise = np.nanstd(record.outputs[name] - found.outputs[name]) + 1e-12
            assert np.abs(simulated.outputs[name] - found.outputs[name])[measured].max() < 0.1 * noise
    again = ph.estimate(model, records, start=values, solver=ph.Newton(restarts=0))
    assert abs(again.log_likelihood - fit.log_likelihood) < 0.1


def test_starts_within_wide_bounds_reach_it(case):
    model, truth, records = case
    best = ph.estimate(model, records, start=truth, solver=ph.Newton(restarts=0)).log_likelihood
    rng = np.random.default_rng(8)
    ends = []
    for _ in range(4):
        start = {n: v * 10 ** rng.uniform(-2, 2) for n, v in truth.items()}
        start = {n: min(max(v, 2e-5), 5e3) for n, v in start.items()}
        ends.append(ph.estimate(model, records, start=start, solver=ph.Newton(restarts=8)).log_likelihood)
    assert sum(end > best - 0.1 for end in ends) >= 2, (best, ends)
