"""Models saved by Python with records and what they are estimated to be, for the Rust crate to repeat.

    python tools/saved_estimates.py

writes rust/core/tests/data/saved_estimates.json. rust/core/tests/saved_estimates.rs and tests/test_saved_estimates.py
both estimate what is in it anew: the same model and the same data give the same estimates in both languages, in as many
iterations.
"""

import json
from pathlib import Path

import numpy as np

import phugoid as ph
from phugoid import exp, log, where

FIXTURE = Path(__file__).resolve().parents[1] / "rust" / "core" / "tests" / "data" / "saved_estimates.json"


def carriage(noise=None):
    """A table, a condition, initial conditions; transformed, fixed, local parameters, one with a prior."""
    m = ph.Model("carriage")
    x, v = m.states(x="m", v="m/s")
    (u,) = m.inputs(u="N")
    k, c, b, x0, g = m.parameters(
        k=ph.Parameter(3.0, bounds=(0.1, 50), transform="log"), c=ph.Parameter(0.3, prior=(0.5, 0.2)),
        b=ph.Parameter(0.0, per_experiment=True), x0=ph.Parameter(0.1, scale=0.1), g=ph.Parameter(1.0, fixed=True),
    )  # fmt: skip
    gain = ph.Table("gain", [-2.0, -1.0, 0.0, 1.0, 2.0], [-1.5, -1.0, 0.0, 1.0, 1.2])
    (f,) = m.quantities(f=-k * x - c * v + g * gain(u) + where(x > 0.5, -0.5 * (x - 0.5), 0.0))
    m.dynamics(x=v, v=f)
    m.outputs(x=x + b, a=(f, "m/s²"))
    m.initial(x=x0, v=0.0)
    if noise is not None:
        m.noise(noise)
    return m


def late():
    """An input that acts late, and two sensors that measure late."""
    m = ph.Model("late")
    x, v = m.states(x="m", v="m/s")
    (u,) = m.inputs(u="m")
    k, c, tau, slow = m.parameters(k=1.0, c=0.5, tau=ph.Parameter(0.0, bounds=(-0.5, 2.0)), slow=0.0)
    a = -k * (x - m.delay(u, tau)) - c * v
    m.dynamics(x=v, v=a)
    m.outputs(x=x, v=v, a=a)
    m.sensor_delay(x=slow, a=slow)
    return m


def run(model, values, name, sigma, phase, interpolation, missing=0.0):
    """A simulated record, rounded."""
    random = np.random.default_rng(int(10 * phase))
    t = np.round(0.1 * np.arange(120), 6)
    u = np.round(np.sin(1.3 * t + phase) + 0.3 * np.sin(3.1 * t), 6)
    e = ph.Experiment(t, {"u": u}, name=name, interpolation=interpolation)
    outputs = ph.simulate(model, values, e, initial={"x": 0.2, "v": 0.0}).outputs
    for n, s in sigma.items():
        z = outputs[n] + s * random.standard_normal(t.size)
        z[random.random(t.size) < missing] = np.nan
        outputs[n] = np.round(z, 6)
    return e.with_outputs(outputs)


def records():
    """Sets of records by name."""
    truth = {"k": 4.0, "c": 0.6, "x0": 0.2, "g": 1.0}
    sigma = {"x": 0.02, "a": 0.05}
    one = run(carriage(), {**truth, "b": 0.05}, "one", sigma, 0.0, "linear", 0.1)
    two = run(carriage(), {**truth, "b": 0.1}, "two", sigma, 1.0, "cubic", 0.1)
    values = {"k": 2.0, "c": 0.7, "tau": 0.237, "slow": 0.163}
    sigma = {"x": 0.01, "v": 0.02, "a": 0.03}
    delayed = {f"late {how}": [run(late(), values, "one", sigma, 0.5, how)] for how in ("linear", "cubic")}
    return {"carriage": [one, two], **delayed}


def options(said):
    """Options of `estimate` from what is saved of them."""
    found = {"start": said["start"]} if "start" in said else {}
    if "shooting" in said:
        segments = said["shooting"]
        shooting = ph.SingleShooting() if segments == 1 else ph.MultipleShooting(segments=segments)
        return {**found, "transcription": shooting}
    return {**found, "transcription": ph.Collocation(order=said.get("order", 4), segments=said.get("uniform"))}


def cases():
    """Name, model, set of records, options as they are saved."""
    good = lambda e: exp(-(e**2) / 2)  # noqa: E731
    bad = lambda r, sigma, share, wide: (  # noqa: E731
        log((1 - share) * good(r / sigma) + share / wide * good(r / (wide * sigma))) - log(sigma)
    )
    kinds = {
        "unknown": None,
        "sigma": ph.Gaussian({"x": 0.02, "a": ph.Sigma(bounds=(0.001, 1.0))}),
        "correlated": ph.Gaussian(correlated=True),
        "covariance": ph.Gaussian(covariance={"x": {"x": 4e-4, "a": 1e-4}, "a": {"a": 2.5e-3}}),
        "student": ph.StudentT(dof={"x": None, "a": 5.0}),
        "per output": ph.PerOutput({"x": ph.Huber(), "a": ph.Laplace(smoothing=0.3)}, {"a": 0.05}),
        "per experiment": ph.PerExperiment(),
        "density": ph.Density(
            bad, parameters={"share": ph.Parameter(0.05, bounds=(0.001, 0.5)), "wide": ph.Parameter(8.0, fixed=True)}
        ),
    }
    for name, noise in kinds.items():
        yield f"noise {name}", carriage(noise), "carriage", {}
    yield "order", carriage(), "carriage", {"order": 6}
    yield "uniform", carriage(), "carriage", {"uniform": 50}
    yield "single", carriage(), "carriage", {"shooting": 1}
    yield "multiple", carriage(), "carriage", {"shooting": 10}
    yield "start", carriage(), "carriage", {"start": {"b[two]": 0.3, "sigma_x": 0.05, "v": 0.1}}
    yield "delays", late(), "late linear", {}
    yield "delays of a spline", late(), "late cubic", {}
    yield "delays by shooting", late(), "late linear", {"shooting": 10, "start": {"k": 1.5, "c": 0.6}}


def saved(e):
    """A record as plain data; None where a sample is missing."""
    return {
        "name": e.name,
        "cubic": e.interpolation == "cubic",
        "t": e.t.tolist(),
        "inputs": {n: e.input(n).tolist() for n in e.inputs},
        "outputs": {n: [None if np.isnan(v) else v for v in e.output(n).tolist()] for n in e.outputs},
    }


def fixture():
    """Cases with their estimates."""
    found, sets = [], records()
    for name, model, of, said in cases():
        fit = ph.estimate(model, sets[of], **options(said))
        assert fit.converged, name
        found.append(
            {
                "name": name,
                "model": json.loads(model.to_json()),
                "records": of,
                "options": said,
                "iterations": fit.iterations,
                "log_likelihood": fit.log_likelihood,
                "estimates": {
                    n: [e.value, e.std_error if np.isfinite(e.std_error) else None] for n, e in fit.parameters.items()
                },
                "initial": {
                    f"{run} {n}": e.value for run, states in fit.initial_states.items() for n, e in states.items()
                },
            }
        )
    runs = {name: [saved(e) for e in each] for name, each in sets.items()}
    return {"made by": "tools/saved_estimates.py", "records": runs, "cases": found}


if __name__ == "__main__":
    lines = json.dumps(fixture(), ensure_ascii=False).replace('{"name": ', '\n{"name": ')
    FIXTURE.write_text(lines + "\n", encoding="utf-8")
    print(f"{FIXTURE}: {FIXTURE.stat().st_size} bytes")
