"""Constants have names where a model is read, and are numbers where it is computed."""

from __future__ import annotations

import json
import math
import pickle
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import phugoid as ph
from phugoid import Constant, Expr, Model, ModelError
from phugoid.models.general import READY

VALUES = {"S": 30.1, "g": 9.80665, "width": 0.2}
WING = {"S": Constant(30.1, "m²", "wing area"), "g": 9.80665, "width": Constant(0.2, meaning="of the step")}
TRUTH = {"k": 0.02, "b": 0.1, "tau": 0.1}


def glider(named: bool = True, late: bool = True) -> Model:
    """A model with each kind of equation, its constants named or as numbers."""
    m = Model("glider")
    v, h = m.states(v="m/s", h="m")
    (de,) = m.inputs(de="rad")
    k, b, tau = m.parameters(k=0.01, b=0.0, tau=ph.Parameter(0.05, bounds=(0, 0.5), unit="s", fixed=not late))
    S, g, width = m.constants(**WING) if named else [Expr(x) for x in VALUES.values()]
    (drag,) = m.quantities(drag=0.5 * S * k * v**2)
    turn = m.delay(de, tau) if late else de + 0 * tau
    m.dynamics(v=-g * ph.sin(turn) - drag, h=v * ph.cos(S / 100) - ph.smooth_sign(v, width))
    m.initial(h=2 * g)
    m.outputs(v=(v + b, "m/s"), h=h)
    m.noise(v=0.005 * g * (1 + 0.01 * ph.smooth_abs(v, width)))
    return m


def record(model: Model) -> ph.Experiment:
    t = 0.1 * np.arange(101)
    empty = ph.Experiment(t, {"de": 0.1 * np.sin(t)}, name="run")
    path = ph.simulate(model, TRUTH, empty, initial={"v": 3.0})
    noise = 0.05 * np.random.default_rng(1).standard_normal((2, t.size))
    return empty.with_outputs({n: path.outputs[n] + e for n, e in zip(("v", "h"), noise, strict=True)})


@pytest.fixture(scope="module")
def fit() -> ph.Fit:
    return ph.estimate(glider(), record(glider()))


def numbers_in(e: Expr) -> Iterator[float]:
    """Yield the numbers without a name in an expression."""
    operation, arguments = e.operation
    if operation == "constant" and not e.constants and e.constant is not None:
        yield e.constant
    for each in arguments:
        yield from numbers_in(each)


def test_equations_show_names() -> None:
    m = glider()
    assert str(m.equations["drag"]) == "0.5*S*k*v**2"
    assert str(m.equations["v'"]) == "-g*sin(de_delayed) - drag"
    assert r"-g \, \sin" in m.latex() and r"\frac{S}{100}" in m.latex()
    assert str(m).splitlines()[-3:] == ["  S = 30.1 m² (wing area)", "  g = 9.80665", "  width = 0.2 (of the step)"]
    assert repr(m).endswith("3 parameters, 3 constants>")
    shown = m._repr_html_()
    assert "wing area" in shown and "9.80665" in shown and "<mi>g</mi>" in shown


def test_declared_constants_come_back() -> None:
    m = glider()
    assert m.constant_names == ("S", "g", "width")
    assert m.declared_constants == {**WING, "g": Constant(9.80665)}
    assert m.units["S"] == "m²" and "g" not in m.units
    assert not set(m.constant_names).intersection((*m.parameter_names, *m.quantity_names, *m.input_names))


def test_constant_is_a_number_to_all_that_computes() -> None:
    (S,) = Model("m").constants(S=30.1)
    x = Expr.symbol("x")
    assert S.constant == 30.1 and S.symbols == [] and S.constants == [("S", 30.1)] and S.name is None
    assert float(ph.sqrt(S)) == math.sqrt(30.1) and str(ph.sqrt(S)) == "sqrt(S)"
    assert (2 * S).evaluate() == 60.2 and str((2 * S).simplify()) == "60.2"
    assert (S * x**2).diff("x") == (30.1 * x**2).diff("x")
    (same,) = Model("other").constants(S=30.1)
    assert {S, same} == {S} and {S, Expr(30.1)} != {S}
    assert pickle.loads(pickle.dumps(S * x)) == S * x
    with pytest.raises(ModelError, match=r"log\(S\) is NaN: outside the domain"):
        ph.log(Model("m").constants(S=-1.0)[0])
    with pytest.raises(ModelError, match="division of x by zero"):
        x / Model("m").constants(zero=0)[0]


def test_a_fit_is_the_same_to_the_bit(fit: ph.Fit) -> None:
    other = ph.estimate(glider(named=False), record(glider(named=False)))
    assert fit.converged and fit.iterations == other.iterations
    assert fit.log_likelihood == other.log_likelihood
    assert [(e.value, e.std_error) for e in fit.parameters.values()] == [
        (e.value, e.std_error) for e in other.parameters.values()
    ]


def test_compiled_equations_take_the_same_instructions() -> None:
    counts = []
    for named in (True, False):
        m = glider(named, late=False)
        noise = m.noise_model.resolve(m.output_names, dict.fromkeys(m.output_names, 1.0), {})
        counts.append(ph.Collocation().problem(m, [record(m)], noise).instructions())
    assert counts[0] == counts[1] and min(counts[0]) > 0


def test_constants_are_saved(tmp_path: Path, fit: ph.Fit) -> None:
    m = glider()
    m.save(tmp_path / "model.json")
    fit.save(tmp_path / "fit.json")
    for back in (Model.load(tmp_path / "model.json"), ph.load(tmp_path / "fit.json").model, m.copy()):
        assert str(back) == str(m) and back.declared_constants == m.declared_constants
        back.check()
    assert pickle.loads(pickle.dumps(m)).to_json() == m.to_json()


def test_a_model_without_constants_is_saved_as_before() -> None:
    saved = json.loads(glider(named=False).to_json())
    assert "constants" not in saved and not any("name" in node for node in saved["expressions"]["nodes"])


def test_changed_models_keep_their_constants() -> None:
    m, S, v = glider(), glider().declared_constants, Expr.symbol("v")
    for changed in (
        m.with_parameters(k=0.03),
        m.with_terms({"drag": Expr.symbol("d") * v}, {"d": 0.1}),
        m.with_noise(h=0.1),
    ):
        changed.check()
        assert changed.declared_constants == S and "-g*" in str(changed.equations["v'"])
    of_each = glider().with_parameters(b=ph.Parameter(per_experiment=True))
    assert ph.estimate(of_each, [record(m), record(m).with_outputs(record(m).outputs, name="again")]).converged


def test_a_constant_is_not_changed_as_a_parameter_is() -> None:
    with pytest.raises(ModelError, match="'S' is a constant, .* declare it as a parameter: S=Parameter"):
        glider().with_parameters(S=31.0)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"v": 1.0}, "constant 'v': there is a state of this name already"),
        ({"k": 1.0}, "constant 'k': there is a parameter of this name already"),
        ({"S": 1.0}, "constant 'S': there is a constant of this name already"),
        ({"drag": 1.0}, "constant 'drag': there is a quantity of this name already"),
        ({"time": 1.0}, "this name is the symbol of time"),
        ({"2": 1.0}, "constant '2': a name starts with a letter"),
        ({"c": math.nan}, "constant 'c': a constant's value is nan, not a finite number"),
        ({"c": math.inf}, "constant 'c': a constant's value is inf, not a finite number"),
        ({"c": "large"}, "constant 'c': a constant's value is 'large', not a finite number"),
    ],
)
def test_a_wrong_declaration_says_what_is_wrong(given: dict[str, float], message: str) -> None:
    with pytest.raises(ModelError, match=message):
        glider().constants(**given)


def test_names_alone_and_wrong_texts_say_what_to_write() -> None:
    with pytest.raises(ModelError, match=r"constant 'c' needs a value: constants\(c=9.81\)"):
        Model("m").constants("c")
    with pytest.raises(ModelError, match="a constant's unit is text, not 3"):
        Constant(1.0, 3)  # type: ignore[arg-type]
    m = glider()
    with pytest.raises(ModelError, match="parameter 'S': there is a constant of this name already"):
        m.parameters("S")


def test_a_constant_of_another_model_is_refused() -> None:
    (mass,) = Model("other").constants(mass=3.0)
    for constants, message in (
        ({}, "equation of v': constant 'mass' is not declared in this model"),
        ({"mas": 3.0}, "constant 'mass' is not declared in this model. Did you mean 'mas'"),
        ({"mass": 4.0}, "constant 'mass' is 3 here, but was declared as 4 in this model"),
    ):
        m = Model("m")
        (v,) = m.states(v="m/s")
        if constants:
            m.constants(**constants)
        m.dynamics(v=-v / mass)
        m.outputs(v=v)
        with pytest.raises(ModelError, match=message.replace("v'", r"v'.*")):
            m.check()
    m = glider()
    m.noise(v=mass)
    with pytest.raises(ModelError, match="the noise of output v: constant 'mass' is not declared"):
        m.check()


def test_pages_have_a_table(tmp_path: Path, fit: ph.Fit) -> None:
    fit.report(tmp_path / "fit.html")
    page = (tmp_path / "fit.html").read_text(encoding="utf-8")
    assert "<h3>Constants</h3>" in page and "wing area" in page and "30.1" in page
    plain = ph.estimate(glider(named=False), record(glider()))
    plain.report(tmp_path / "plain.html")
    assert "<h3>Constants</h3>" not in (tmp_path / "plain.html").read_text(encoding="utf-8")


def test_exported_code_has_the_value_and_says_the_name(tmp_path: Path) -> None:
    m = glider(late=False)
    m.noise(v=1.0)
    _, source = ph.export_c(m, tmp_path, parameters=TRUTH)
    text = source.read_text(encoding="utf-8")
    assert " * constant S = 30.1 m" in text and "30.1 *" in text.replace("0.5 * 30.1", "30.1 *")


def test_what_is_asked_of_a_fit_takes_constants(fit: ph.Fit) -> None:
    k = Expr.symbol("k")
    (S,) = Model("m").constants(S=30.1)
    assert fit.derived(kS=k * S)["kS"].value == pytest.approx(30.1 * fit.parameters["k"].value, rel=1e-15)
    assert set(fit.validate(record(glider())).matches) == {"v", "h"}
    (g,) = Model("m").constants(g=9.80665)
    other = ph.estimate(fit.model.with_noise(v=0.005 * g), record(glider()))
    assert other.robust().parameters["k"].std_error > 0 and other.profile("k")


def test_linearisation_and_regression_take_constants() -> None:
    named, numbers = glider(late=False), glider(named=False, late=False)
    at = {"v": 3.0, "h": 20.0, "de": 0.0}
    systems = [ph.linear.linearise(m, {**TRUTH}, at=at) for m in (named, numbers)]
    assert np.array_equal(systems[0].A, systems[1].A) and systems[0].A[0, 0] != 0
    found = [ph.equation_error(m, record(m)).parameters["k"].value for m in (named, numbers)]
    assert found[0] == found[1]


def test_candidates_and_their_new_names_respect_constants(fit: ph.Fit) -> None:
    named = {c.name for c in ph.candidates(fit.model)}
    plain = {c.name for c in ph.candidates(glider(named=False))}
    assert named == plain and len(named) > 20


@pytest.mark.parametrize("name", READY)
def test_ready_models_have_no_physical_numbers_without_a_name(name: str) -> None:
    """Factors of formulas remain, such as the half of the dynamic pressure."""
    found = {x for e in getattr(ph.models, name)().equations.values() for x in numbers_in(e)}
    assert found <= {0.5, 1.0, 2.0}
