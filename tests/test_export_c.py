"""Models as C source: compiled, and compared with phugoid."""

from __future__ import annotations

import ctypes
import itertools
import shutil
import subprocess
from pathlib import Path
from typing import Any

import hfb320
import numpy as np
import pytest

import phugoid as ph
from phugoid import Expr, ModelError, OptionError, Table, _core, cos, sin, where

CC = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
STRICT = ["-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror", "-O2"]
needs_cc = pytest.mark.skipif(CC is None, reason="no C compiler (cc, gcc, clang) was found")


class Compiled:
    """The functions of an exported model by ctypes."""

    def __init__(self, folder: Path, model: ph.Model | ph.Fit, *args: Any, **options: Any) -> None:
        header, self.source = ph.export_c(model, folder, *args, **options)
        self.header, self.name = header.read_text(encoding="utf-8"), header.stem
        library = folder / "model.so"
        command = [str(CC), *STRICT, "-shared", "-fPIC", str(self.source), "-o", str(library), "-lm"]
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr + self.source.read_text(encoding="utf-8")
        self.library = ctypes.CDLL(str(library))
        m = model.model if isinstance(model, ph.Fit) else model
        self.n_x, self.n_u = len(m.state_names), len(m._core.inputs)
        self.n_y, self.n_p = len(m.output_names), len(m.parameter_names)

    def numbers(self, what: str, n: int) -> np.ndarray:
        return np.array((ctypes.c_double * n).in_dll(self.library, f"{self.name}_{what}"))

    def texts(self, what: str, n: int) -> list[str]:
        return [t.decode() for t in (ctypes.c_char_p * n).in_dll(self.library, f"{self.name}_{what}")]

    def __call__(self, what: str, t: float, x: Any, u: Any, p: Any, *sizes: int) -> list[np.ndarray]:
        found = [np.full(max(n, 1), np.nan) for n in sizes]
        function = getattr(self.library, f"{self.name}_{what}")
        function.restype = None
        function(ctypes.c_double(t), *map(pointer, (x, u, p)), *map(pointer, found))
        return [array[:n] for array, n in zip(found, sizes, strict=True)]

    def step(self, t: float, h: float, u0: Any, u1: Any, p: Any, x: np.ndarray) -> None:
        function = getattr(self.library, f"{self.name}_step")
        function.restype = None
        function(ctypes.c_double(t), ctypes.c_double(h), *map(pointer, (u0, u1, p, x)))


def pointer(values: Any) -> Any:
    if isinstance(values, np.ndarray) and values.size:
        return values.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
    array = np.array(values if len(values) else [0.0], dtype=np.float64)
    return (ctypes.c_double * array.size)(*array)


def of_outputs(expressions: dict[str, Any], symbols: str = "a b c") -> ph.Model:
    """A model whose outputs are expressions in its states."""
    m = ph.Model("outputs")
    states = m.states(symbols)
    m.dynamics(**{str(s): 0.0 for s in states})
    m.outputs(**expressions)
    return m


def compare(folder: Path, expressions: dict[str, Any], points: np.ndarray) -> None:
    """Outputs and their derivatives at points (n, 3), against the interpreter."""
    names = ("a", "b", "c")
    compiled = Compiled(folder, of_outputs(expressions))
    n = len(expressions)
    for point in points:
        at = dict(zip(names, point.tolist(), strict=True))
        (y,) = compiled("outputs", 0.0, point, [], [], n)
        *_, by_state, _ = compiled("jacobians", 0.0, point, [], [], 9, 0, 3 * n, 0)
        for k, (name, e) in enumerate(expressions.items()):
            e = Expr(e)
            expected = e.evaluate({s: at[s] for s in e.symbols})
            np.testing.assert_allclose(y[k], expected, rtol=1e-12, atol=1e-12, err_msg=f"{name} at {at}")
            for j, symbol in enumerate(names):
                d = e.diff(symbol)
                expected = d.evaluate({s: at[s] for s in d.symbols})
                close = {"rtol": 1e-11, "atol": 1e-12, "err_msg": f"d {name} / d {symbol} at {at}"}
                np.testing.assert_allclose(by_state[3 * k + j], expected, **close)


@needs_cc
def test_every_operation(tmp_path: Path) -> None:
    """At points within the domain of each, conditions on both sides."""
    random = np.random.default_rng(0)
    for symbols, points in (
        ("abc", random.uniform(0.05, 0.95, (20, 3))),
        ("abc", random.uniform(-0.95, 0.95, (20, 3))),
    ):
        expressions = {}
        for name, arity, domain in _core.operations():
            if points.min() < 0 and any(low == 0.0 for low, _ in domain[:1]):
                continue  # positive arguments only
            arguments = [Expr.symbol(s) for s in symbols[:arity]]
            if name in ("and", "or", "not", "where"):  # of conditions
                arguments[0] = arguments[0] < 0.4
            expressions[f"{name}_"] = _core.apply(name, *arguments)
        assert points.min() < 0 or len(expressions) == len(_core.operations())
        folder = tmp_path / str(points.min() < 0)
        compare(folder, expressions, points)


@needs_cc
def test_at_the_edge_of_conditions(tmp_path: Path) -> None:
    """Where arguments are equal or zero, which random points are not."""
    arguments = [Expr.symbol(s) for s in "abc"]
    names = {"sign": 1, "abs": 1, "not": 1, "lt": 2, "le": 2, "and": 2, "or": 2, "min": 2, "max": 2, "where": 3}
    expressions = {f"{name}_": _core.apply(name, *arguments[:n]) for name, n in names.items()}
    compare(tmp_path, expressions, np.array(list(itertools.product((-1.0, 0.0, 0.5), repeat=3))))


@needs_cc
def test_powers_conditions_and_what_is_not_finite(tmp_path: Path) -> None:
    a, b, c = (Expr.symbol(s) for s in "abc")
    expressions = {
        **{f"p{k}": a**n for k, n in enumerate((2, 3, 7, -1, -2, -5, 0.5, 1.5, -0.5, 20))},
        "sums": a - (b - (c - a)) - -b,
        "quotients": a / (b / (c / (a * b))) / -c,
        "shared": sin(a * b) * cos(a * b) + sin(b * a),
        "branches": where((a < b) & ~(b < c), a**2, where((a >= 0.5) | (c > 0.5), b, ph.log(c))),
        "least": ph.minimum(ph.maximum(a, b), c),
        "constants": 1e-300 * a + 1.7976931348623157e308 * 0 * b + a * (0.1 + 0.2),
    }
    compare(tmp_path / "finite", expressions, np.random.default_rng(1).uniform(0.05, 0.95, (30, 3)))
    compiled = Compiled(
        tmp_path / "not", of_outputs({"least": ph.minimum(a, b), "greatest": ph.maximum(a, b), "s": ph.sign(a)})
    )
    for point in ([np.nan, 1.0, 0.0], [1.0, np.nan, 0.0]):
        (y,) = compiled("outputs", 0.0, point, [], [], 3)
        assert np.isnan(y[:2]).all() and np.isnan(y[2]) == np.isnan(point[0])


@needs_cc
def test_tables_and_their_derivatives(tmp_path: Path) -> None:
    """Within the grid, on its points, and beyond; derivatives that the user took too."""
    a, b, c = (Expr.symbol(s) for s in "abc")
    random = np.random.default_rng(2)
    lift = Table("lift */ \\", [-0.5, -0.1, 0.0, 0.3, 0.8], random.standard_normal(5))
    two = Table("two points", [0.0, 1.0], [1.0, -2.0])
    map_ = Table("map", ([-0.6, 0.0, 0.2, 0.7], [-1.0, 0.1, 0.5]), random.standard_normal((4, 3)))
    expressions = {
        "one": lift(a) * b,
        "line": two(a),
        "two_d": map_(a, b) + map_(b, c),
        "slope": lift(a).diff("a"),
        "bend": lift(a + b).diff("a").diff("b"),
        "mixed": map_(a, b).diff("a").diff("b"),
    }
    points = np.vstack([random.uniform(-1.5, 1.5, (60, 3)), [[-0.5, 0.1, 0.3], [0.8, 0.5, 0.0], [0.0, -1.0, -0.1]]])
    compare(tmp_path, expressions, points)


@needs_cc
def test_hfb_320_simulated_in_c(tmp_path: Path) -> None:
    """Runge-Kutta steps in C against an integrator with error control."""
    model, data = hfb320.model(), hfb320.twin()
    start = {"V": 106.0, "alpha": 0.112, "theta": 0.104, "q": -0.003}
    expected = ph.simulate(model, hfb320.PUBLISHED, data, initial=start)
    compiled = Compiled(tmp_path, model, hfb320.PUBLISHED, name="hfb320")
    p = compiled.numbers("p", 15)
    np.testing.assert_array_equal(p, [hfb320.PUBLISHED[n] for n in model.parameter_names])
    assert compiled.texts("y_names", 7) == list(model.output_names)
    assert compiled.texts("y_units", 7)[5] == "m/s²" and "#define HFB320_X_q 3" in compiled.header
    u = np.array([data.input(n) for n in model.input_names]).T.copy()
    x, substeps = np.array(list(start.values())), 4
    for k, t in enumerate(data.t):
        (y,) = compiled("outputs", t, x, u[k], p, 7)
        for value, (name, record) in zip(y, expected.outputs.items(), strict=True):
            assert value == pytest.approx(record[k], rel=1e-6, abs=1e-6), (name, t)
        if k == data.n - 1:
            break
        h = (data.t[k + 1] - t) / substeps
        for s in range(substeps):
            ends = [u[k] + (u[k + 1] - u[k]) * (s + i) / substeps for i in (0, 1)]
            compiled.step(t + s * h, h, *ends, p, x)


@needs_cc
def test_jacobians_are_those_of_linearise(tmp_path: Path) -> None:
    model = hfb320.model()
    compiled = Compiled(tmp_path, model, hfb320.PUBLISHED)
    at = {"V": 106.0, "alpha": 0.11, "theta": 0.1, "q": 0.02, "de": -0.01, "T": 11500.0}
    x, u = [at[n] for n in model.state_names], [at[n] for n in model.input_names]
    found = compiled("jacobians", 0.0, x, u, compiled.numbers("p", 15), 16, 8, 28, 14)
    linear = ph.linear.linearise(model, hfb320.PUBLISHED, at=at)
    for block, values in zip("ABCD", found, strict=True):
        expected = getattr(linear, block)
        np.testing.assert_allclose(values.reshape(expected.shape), expected, rtol=1e-12, atol=1e-15)
    evaluator = _core.Evaluator(model._core)
    columns = np.array([0.0, *u, *x])[:, None]
    (dx,) = compiled("dynamics", 0.0, x, u, compiled.numbers("p", 15), 4)
    np.testing.assert_allclose(dx, evaluator.dynamics(compiled.numbers("p", 15), columns)[:, 0], rtol=1e-12, atol=1e-15)


def odd_names() -> ph.Model:
    """Names that are words of C, one another but for signs, and what the code itself uses; no parameters but one."""
    m = ph.Model("Größe */ 2")
    x, double, k, t = m.states(x="m", double="1/s", k="a*/b", t='"s\\?')
    u, p, A = m.inputs("u p A")
    (h,) = m.parameters(h=ph.Parameter(1.5, unit="µm"))
    v1, cubic = m.quantities(v1=x * h, cubic=double + x * h)
    m.dynamics(x=v1 + m.time, double=cubic * u, k=p - k, t=A)
    m.outputs(y=v1 * cubic, dx=sin(t) + k)
    return m


@needs_cc
def test_names_that_c_has_too(tmp_path: Path) -> None:
    m = odd_names()
    compiled = Compiled(tmp_path, m, {"h": 2.0})
    assert compiled.name == "gr_e_2"
    assert compiled.texts("x_units", 4) == ["m", "1/s", "a*/b", '"s\\?'] and compiled.texts("p_units", 1) == ["µm"]
    x, u = [1.0, 2.0, 3.0, 4.0], [5.0, 6.0, 7.0]
    (dx,) = compiled("dynamics", 10.0, x, u, [2.0], 4)
    np.testing.assert_array_equal(dx, [12.0, 20.0, 3.0, 7.0])
    (y,) = compiled("outputs", 10.0, x, u, [2.0], 2)
    np.testing.assert_allclose(y, [8.0, np.sin(4.0) + 3.0], rtol=1e-15)


@needs_cc
def test_a_model_without_inputs_and_parameters(tmp_path: Path) -> None:
    m = ph.Model("decay")
    (x,) = m.states("x")
    m.dynamics(x=-x)
    m.outputs(one=1.0)
    compiled = Compiled(tmp_path, m)
    state = np.array([1.0])
    for k in range(10):
        compiled.step(0.1 * k, 0.1, [], [], [], state)
    assert state[0] == pytest.approx(np.exp(-1.0), rel=1e-6)
    assert compiled("outputs", 0.0, [1.0], [], [], 1)[0][0] == 1.0


@pytest.fixture(scope="module")
def fit() -> ph.Fit:
    """Two records, each with a bias of its own."""
    m = ph.Model("lag")
    (x,) = m.states(x="m")
    (u,) = m.inputs("u")
    a, b = m.parameters(a=1.0, b=ph.Parameter(0.0, per_experiment=True))
    m.dynamics(x=a * (u - x))
    m.outputs(x=x + b)
    t = 0.1 * np.arange(50)
    rng = np.random.default_rng(0)
    runs = []
    for k in (1, 2):
        e = ph.Experiment(t, {"u": np.cos(k * t)}, name=f"run {k}")
        y = ph.simulate(m, {"a": 1.5, "b": 0.1 * k}, e, initial={"x": 0.5 * k}).outputs["x"]
        runs.append(e.with_outputs({"x": y + 0.001 * rng.standard_normal(t.size)}))
    return ph.estimate(m, runs)


@needs_cc
def test_a_fit_brings_its_estimates_and_first_states(tmp_path: Path, fit: ph.Fit) -> None:
    with pytest.raises(ModelError, match=r"each experiment has its own b: say which, experiment='run 1'"):
        fit.export_c(tmp_path)
    compiled = Compiled(tmp_path, fit, experiment="run 2", name="second")
    np.testing.assert_array_equal(
        compiled.numbers("p", 2), [fit.parameters["a"].value, fit.parameters["b[run 2]"].value]
    )
    np.testing.assert_array_equal(compiled.numbers("x0", 1), [fit.initial_states["run 2"]["x"].value])
    assert "converged" in compiled.header and "run 2" in compiled.header
    header, _ = fit.export_c(tmp_path / "held", parameters={"b": 0.0})
    assert header.name == "lag.h"


@needs_cc
def test_delayed_inputs_are_inputs_of_their_own_where_asked_for(tmp_path: Path) -> None:
    m = ph.Model("late")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    (tau,) = m.parameters(tau=0.2)
    m.dynamics(x=m.delay(u, tau) - x)
    m.outputs(x=x + u)
    m.sensor_delay(x=tau)
    with pytest.raises(ModelError, match=r"delays \(u_delayed, x\)"):
        ph.export_c(m, tmp_path, {"tau": 0.2})
    with pytest.warns(DeprecationWarning, match="late_inputs of export_c is now delayed_inputs"):
        ph.export_c(m, tmp_path / "former", {"tau": 0.2}, late_inputs=True)
    compiled = Compiled(tmp_path, m, {"tau": 0.2}, delayed_inputs=True)
    assert "u_delayed is u(t - tau): the caller delays it" in compiled.header
    assert compiled("dynamics", 0.0, [1.0], [0.0, 5.0], [0.2], 1)[0][0] == 4.0


def test_bad_input(tmp_path: Path) -> None:
    m = odd_names()
    for name in ("1st", "a-b", "int", "", "größe"):
        with pytest.raises(OptionError, match="is not a name in C"):
            ph.export_c(m, tmp_path, {"h": 1.0}, name=name)
    with pytest.raises(ModelError, match="a model needs parameters"):
        ph.export_c(m, tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(ph.DataError, match="cannot be written"):
        ph.export_c(m, tmp_path / "file", {"h": 1.0})


@needs_cc
def test_inputs_that_are_held(tmp_path: Path) -> None:
    """With one value of a held input in u0 and u1, steps between samples follow the exact solution."""
    m = ph.Model("lag")
    (x,), (u,) = m.states(x="m"), m.inputs(u="m")
    (a,) = m.parameters(a=1.0)
    m.dynamics(x=a * (u - x))
    m.outputs(x=x)
    t, command = 0.1 * np.arange(60), np.random.default_rng(0).choice([-1.0, 1.0], 60)
    exact = np.zeros(60)
    for k in range(59):
        exact[k + 1] = command[k] + (exact[k] - command[k]) * np.exp(-0.2)
    run = ph.Experiment(t, {"u": command}, {"x": exact}, interpolation="hold")
    fit = ph.estimate(m, run, noise=ph.Gaussian(sigma={"x": 0.01}), transcription=ph.Collocation(order=8))
    code = Compiled(tmp_path, fit)
    assert "inputs held between samples: u" in code.header
    value = np.array([fit.parameters["a"].value])
    found = np.array([exact[0]])
    for k in range(59):
        for part in range(10):
            code.step(t[k] + 0.01 * part, 0.01, command[k : k + 1], command[k : k + 1], value, found)
        assert found[0] == pytest.approx(exact[k + 1], abs=1e-9)
