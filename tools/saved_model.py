"""A model saved by Python with what it evaluates to, for the Rust crate to read and repeat bit by bit.

    python tools/saved_model.py

writes rust/core/tests/suite/data/saved_model.json, which rust/core/tests/suite/saved_model.rs reads;
tests/test_saved_model.py sees to it that the file is what this script makes. Numbers are the 16 hexadecimal digits of
their 64 bits, one after the other.
"""

import json
import random
from pathlib import Path

import numpy as np

import phugoid as ph
from phugoid import _core, atan2, cos, exp, log, maximum, sin, sqrt, tanh, where

FIXTURE = Path(__file__).resolve().parents[1] / "rust" / "core" / "tests" / "suite" / "data" / "saved_model.json"

ORDER, FACTOR = 3, 0.7
POINTS, SAMPLES = 5, (6, 4)
EDGES = ((0.0, 0.13, 0.3, 0.5), (0.0, 0.2, 0.3))  # s; not all samples are mesh points
SIGMAS = [(True, 0.3, 0.3, 0.3), (False, 0.8, 1e-3, 1e3), (False, 0.5, 1e-3, 1e3)]


def model():
    """Operations of many kinds, two tables, time, quantities; a bounded, a fixed and a parameter with a prior."""
    m = ph.Model("saved by Python")
    V, alpha = m.states(V="m/s", alpha="rad")
    (de,) = m.inputs(de="rad")
    a, b, c, k = m.parameters(
        a=ph.Parameter(0.1 + 0.2, bounds=(-1, 9), unit="1/s"), b=1 / 3, c=ph.Parameter(-0.6, prior=(-0.5, 0.3)),
        k=ph.Parameter(0.4, fixed=True),
    )  # fmt: skip
    lift = ph.Table("lift", [-1.0, -0.4, 0.1, 0.6, 1.2], [-0.7, -0.3, 0.2, 0.5, 0.4])
    axes = ([0.0, 0.5, 1.5], [0.5, 1.2, 2.0])
    drag = ph.Table("drag", axes, [[0.1, 0.3, 0.2], [0.05, 0.4, 0.1], [0.2, 0.0, 0.3]])
    CL, CD = m.quantities(
        CL=a + b * alpha + lift(alpha),
        CD=where(alpha > 0.7, k * alpha**2, drag(alpha, V)) + 0.1 * maximum(alpha, V) ** 3,
    )
    m.dynamics(
        V=-CD * V**2 + c * sin(alpha) - exp(-V) / (1 + V**2) + sqrt(V) * de,
        alpha=-CL * cos(alpha) + tanh(de * alpha) - log(V) * c + 0.1 * sin(m.time),
    )
    m.outputs(V=V, alpha=alpha + c * V, az=(CL * V**1.5 - abs(atan2(de, V)), "m/s²"))
    m.noise(V=0.3)
    return m


def hexadecimal(values):
    """16 digits a number, six numbers a line."""
    text = np.asarray(values, dtype=">f8").tobytes().hex()
    return [text[i : i + 96] for i in range(0, len(text), 96)]


def fixture():
    """The model, numbers to evaluate it at, and what comes out."""
    m, draw = model(), random.Random(1)
    m = ph.Model.from_json(m.to_json())

    def some(n, low=0.4, high=1.2):
        return [draw.uniform(low, high) for _ in range(n)]

    experiments = []
    for i, n in enumerate(SAMPLES):
        outputs = {name: some(n) for name in m.output_names}
        outputs["az"][1] = float("nan")
        t = [0.1 * j for j in range(n)]
        t[-1] = EDGES[i][-1]
        kind = ("linear", "cubic")[i]
        experiments.append(ph.Experiment(t, {"de": some(n)}, outputs, name=f"run {i}", interpolation=kind))
    sigmas = {
        name: start if known else ph.Sigma(start, (low, high))
        for name, (known, start, low, high) in zip(m.output_names, SIGMAS, strict=True)
    }
    noise = ph.Gaussian(sigmas).resolve(m.output_names, dict.fromkeys(m.output_names, np.inf), {})
    problem = ph.Collocation(order=ORDER, segments=EDGES).problem(m, experiments, noise)
    evaluator = _core.Evaluator(m._core)
    parameters, columns = some(len(m.parameter_names)), [some(POINTS) for _ in range(4)]
    xi, multipliers = some(problem.n), some(problem.m, -1.0, 1.0)
    at, lambdas, p, c = (np.array(v) for v in (xi, multipliers, parameters, columns))
    return {
        "made by": "tools/saved_model.py",
        "model": json.loads(m.to_json()),
        "evaluator": {
            "parameters": hexadecimal(parameters),
            "columns": [hexadecimal(column) for column in columns],
            "dynamics": [hexadecimal(f) for f in evaluator.dynamics(p, c)],
            "outputs": [hexadecimal(g) for g in evaluator.outputs(p, c)],
        },
        "experiments": [
            {
                "name": e.name,
                "cubic": e.interpolation == "cubic",
                "t": hexadecimal(e.t),
                "inputs": [hexadecimal(e.input(name)) for name in m.input_names],
                "outputs": [hexadecimal(e.output(name)) for name in m.output_names],
                "edges": hexadecimal(edges),
            }
            for e, edges in zip(experiments, EDGES, strict=True)
        ],
        "order": ORDER,
        "sigmas": [{"known": known, "value, lower, upper": hexadecimal(rest)} for known, *rest in SIGMAS],
        "xi": hexadecimal(xi),
        "factor": hexadecimal([FACTOR]),
        "multipliers": hexadecimal(multipliers),
        "objective": hexadecimal([problem.objective(at)]),
        "gradient": hexadecimal(problem.gradient(at)),
        "constraints": hexadecimal(problem.constraints(at)),
        "jacobian": hexadecimal(problem.jacobian(at)),
        "hessian": hexadecimal(problem.hessian(at, FACTOR, lambdas)),
        "gauss_newton": hexadecimal(problem.gauss_newton(at, FACTOR)),
    }


def text():
    """The fixture as it is checked in."""
    return json.dumps(fixture(), indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    FIXTURE.parent.mkdir(exist_ok=True)
    FIXTURE.write_text(text(), encoding="utf-8")
    print(f"{FIXTURE}: {FIXTURE.stat().st_size} bytes")
