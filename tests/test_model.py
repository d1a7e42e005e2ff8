"""Model: declarations, quantities, printing, saving, and what is refused with the user's own names and lines."""

from __future__ import annotations

import copy
import math
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import phugoid as ph
from phugoid import Expr, Gaussian, Model, ModelError, Parameter, Sigma, Table, _core

HERE = Path(__file__).name


def lag() -> tuple[Model, Expr, Expr, Expr]:
    """A first-order lag without equations: model, state, input, parameter."""
    m = Model("lag")
    (x,) = m.states(x="m")
    (u,) = m.inputs(u="V")
    (T,) = m.parameters(T=Parameter(2.0, bounds=(0.01, 100.0), unit="s"))
    return m, x, u, T


def complete() -> Model:
    m, x, u, T = lag()
    (rate,) = m.quantities(rate=(u - x) / T)
    m.dynamics(x=rate)
    m.outputs(x=x, rate=(rate, "m/s"))
    return m


# ---------------------------------------------------------------- declarations


@pytest.mark.parametrize(
    "declare",
    [
        lambda m: m.states("a b c"),
        lambda m: m.states("a, b, c"),
        lambda m: m.states("a", "b", "c"),
        lambda m: m.states(a="m", b="", c="rad"),
        lambda m: m.states("a b", c="rad"),
    ],
)
def test_states_are_declared_by_name_or_with_units(declare: Callable[[Model], tuple[Expr, ...]]) -> None:
    m = Model()
    symbols = declare(m)
    assert [s.name for s in symbols] == ["a", "b", "c"]
    assert m.state_names == ("a", "b", "c")


def test_inputs_are_declared_likewise() -> None:
    m = Model()
    de, thrust = m.inputs("de", thrust="N")
    assert (de.name, thrust.name, m.input_names, m.units) == ("de", "thrust", ("de", "thrust"), {"thrust": "N"})


def test_parameters_start_at_zero_unless_told() -> None:
    m = Model()
    m.parameters("a b", c=1.5, d=Parameter(2, bounds=(0, 3), unit="1/s", prior=(1, 0.5)), e=Parameter(4, fixed=True))
    assert m.parameter_names == ("a", "b", "c", "d", "e")
    assert m.declared_parameters == {
        "a": Parameter(),
        "b": Parameter(),
        "c": Parameter(1.5),
        "d": Parameter(2, bounds=(0, 3), unit="1/s", prior=(1, 0.5)),
        "e": Parameter(4, fixed=True),
    }


def test_units_of_everything() -> None:
    assert complete().units == {"x": "m", "u": "V", "T": "s", "rate": "m/s"}


def test_output_that_is_a_state_or_input_has_its_unit() -> None:
    m, x, u, T = lag()
    m.outputs(position=x, command=u, other=x / T)
    assert {n: m.units.get(n) for n in m.output_names} == {"position": "m", "command": "V", "other": None}


def test_constants_may_stand_for_equations() -> None:
    m = Model()
    m.states("x")
    m.dynamics(x=1)
    m.outputs(y=2.5)
    m.check()
    assert m.equations["x'"] == 1


def test_time_is_a_symbol() -> None:
    m, x, u, T = lag()
    m.dynamics(x=u * ph.sin(m.time / T))
    m.outputs(x=x)
    m.check()
    rate = _core.Evaluator(m._core).dynamics(np.array([2.0]), np.array([[0.5], [3.0], [0.0]]))
    assert rate[0, 0] == pytest.approx(3.0 * math.sin(0.25), rel=1e-15)


def test_noise_is_part_of_the_model() -> None:
    m = complete()
    assert m.noise_model == Gaussian()
    m.noise(x=0.1)
    m.noise(rate=Sigma(0.2))
    assert m.noise_model == Gaussian({"x": 0.1, "rate": Sigma(0.2)})
    m.noise(Gaussian({"x": 1}))
    assert m.noise_model == Gaussian({"x": 1.0})


# ---------------------------------------------------------------- quantities


def test_quantity_enters_wherever_it_is_used() -> None:
    m, x, u, T = lag()
    CL, twice = m.quantities(CL=x**2 + u, twice=2 * Expr.symbol("CL"))
    m.dynamics(x=CL / T)
    m.outputs(lift=twice, both=CL + twice)
    evaluator = _core.Evaluator(m._core)
    theta, column = np.array([4.0]), np.array([[0.0], [1.0], [3.0]])  # T; time, u, x
    assert evaluator.dynamics(theta, column).tolist() == [[2.5]]
    assert evaluator.outputs(theta, column).tolist() == [[20.0], [30.0]]


def test_output_expressions_have_quantities_put_in() -> None:
    assert {n: str(e) for n, e in complete().output_expressions().items()} == {"x": "x", "rate": "(u - x)/T"}


def test_equations_by_name() -> None:
    assert {n: str(e) for n, e in complete().equations.items()} == {
        "rate": "(u - x)/T",
        "x'": "rate",
        "y:x": "x",
        "y:rate": "rate",
    }


# ---------------------------------------------------------------- printing


def test_str_shows_the_equations() -> None:
    assert str(complete()).splitlines() == [
        "lag",
        "  rate = (u - x)/T",
        "  x' = rate",
        "  x (measured) = x",
        "  rate (measured) = rate",
    ]


def test_repr_counts() -> None:
    assert repr(complete()) == "<Model 'lag': 1 state, 1 input, 2 outputs, 1 parameter>"


def test_latex_is_an_aligned_block() -> None:
    lines = complete().latex().splitlines()
    assert (lines[0], lines[-1]) == (r"\begin{aligned}", r"\end{aligned}")
    assert lines[1:-1] == [
        r"\mathrm{rate} &= \frac{u - x}{T} \\",
        r"\dot{x} &= \mathrm{rate} \\",
        r"\tilde{x} &= x \\",
        r"\tilde{\mathrm{rate}} &= \mathrm{rate}",
    ]


# ---------------------------------------------------------------- saving


def rich() -> Model:
    """Something of everything that must survive."""
    m = Model("rich")
    (x,) = m.states(x="m")
    (u,) = m.inputs("u")
    a, b, c = m.parameters(
        a=Parameter(0.1, bounds=(-math.inf, 2.0), unit="1/s", prior=(0.3, 0.01)), b=Parameter(3, fixed=True), c=1e-300
    )
    lift = Table("CL", [0.0, 0.1, 0.3], [0.1, 0.7, 1.0 / 3.0])
    m.quantities(k=ph.where(x > 0, a, -b) + c)
    m.dynamics(x=lift(x) * u + Expr.symbol("k"))
    m.outputs(x=(x, "m"))
    m.noise(x=Sigma(0.1, bounds=(0.01, 1.0)))
    return m


@pytest.mark.parametrize(
    "through",
    [
        lambda m: Model.from_json(m.to_json()),
        lambda m: pickle.loads(pickle.dumps(m)),
        lambda m: copy.deepcopy(m),
    ],
    ids=["json", "pickle", "deepcopy"],
)
def test_model_survives(through: Callable[[Model], Model]) -> None:
    m = rich()
    again = through(m)
    assert again.to_json() == m.to_json()
    assert (str(again), again.units) == (str(m), m.units)
    assert again.equations == m.equations
    assert again.declared_parameters == m.declared_parameters
    assert again.noise_model == m.noise_model


def test_model_is_saved_to_a_file(tmp_path: Path) -> None:
    m = rich()
    m.save(tmp_path / "model.json")
    assert Model.load(tmp_path / "model.json").to_json() == m.to_json()


def test_copy_is_independent() -> None:
    m = complete()
    again = copy.deepcopy(m)
    again.states("extra")
    assert m.state_names == ("x",)


@pytest.mark.parametrize("text", ["", "{}", "{", '{"format": "phugoid-fit", "version": 1}', "[]"])
def test_text_that_is_no_model_is_refused(text: str) -> None:
    with pytest.raises(ModelError, match="saved model"):
        Model.from_json(text)


def test_model_of_a_later_version_is_refused() -> None:
    text = complete().to_json().replace('"version":1', '"version":99')
    with pytest.raises(ModelError, match="version 99; this release reads phugoid-model up to 3"):
        Model.from_json(text)


# ---------------------------------------------------------------- what is refused, and where


def line_of(marker: str) -> int:
    """The line of this file that carries a marker in a comment."""
    lines = Path(__file__).read_text(encoding="utf-8").splitlines()
    return next(i for i, line in enumerate(lines, 1) if line.endswith(f"# {marker}"))


def test_undeclared_symbol_is_named_with_the_users_line() -> None:
    m, x, u, T = lag()
    m.dynamics(x=(u - x) / T + Expr.symbol("wind"))  # undeclared symbol
    m.outputs(x=x)
    with pytest.raises(ModelError, match="model 'lag': equation of x'") as caught:
        m.check()
    assert f"({HERE}:{line_of('undeclared symbol')}): symbol 'wind' is not declared" in str(caught.value)


def test_symbol_of_another_model_is_undeclared() -> None:
    m, x, u, T = lag()
    (v,) = Model("other").states("v")
    m.dynamics(x=v / T)
    m.outputs(x=x)
    with pytest.raises(ModelError, match="symbol 'v' is not declared in this model"):
        m.check()


@pytest.mark.parametrize(
    ("place", "words"),
    [
        (lambda m, e: m.quantities(rate=e), rf"quantity rate \({HERE}:\d+\)"),
        (lambda m, e: m.dynamics(x=e), rf"equation of x' \({HERE}:\d+\)"),
        (lambda m, e: m.outputs(z=e), rf"output z \({HERE}:\d+\)"),
    ],
    ids=["quantity", "dynamics", "output"],
)
def test_misspelt_symbol_gets_a_hint(place: Callable[[Model, Expr], Any], words: str) -> None:
    m = Model("pitch")
    (x,) = m.states("x")
    (alpha,) = m.inputs("alpha")
    place(m, alpha + Expr.symbol("aplha"))
    if "x'" not in m.equations:
        m.dynamics(x=x)
    m.outputs(x=x)
    with pytest.raises(ModelError, match=words) as caught:
        m.check()
    assert "symbol 'aplha' is not declared in this model. Did you mean 'alpha'?" in str(caught.value)


def test_quantity_must_be_given_before_it_is_used_in_another() -> None:
    m, x, u, T = lag()
    m.quantities(first=Expr.symbol("second"), second=x / T)
    m.dynamics(x=Expr.symbol("first"))
    m.outputs(x=x)
    with pytest.raises(ModelError, match="quantity first .* symbol 'second' is not declared"):
        m.check()


def test_state_without_equation() -> None:
    m, x, u, T = lag()
    m.states("q")
    m.dynamics(x=(u - x) / T)
    m.outputs(x=x)
    with pytest.raises(ModelError, match=r"state 'q' has no equation; give dynamics\(q=\.\.\.\)"):
        m.check()


def test_parameter_in_no_equation() -> None:
    m, x, u, T = lag()
    m.parameters("unused")
    m.dynamics(x=(u - x) / T)
    m.outputs(x=x)
    with pytest.raises(ModelError, match="parameter 'unused' appears in no equation"):
        m.check()


def test_parameter_in_a_quantity_that_nothing_uses() -> None:
    m, x, u, T = lag()
    m.quantities(idle=x / T)
    m.dynamics(x=u - x)
    m.outputs(x=x)
    with pytest.raises(ModelError, match="parameter 'T' appears in no equation"):
        m.check()


def test_no_outputs() -> None:
    m, x, u, T = lag()
    m.dynamics(x=(u - x) / T)
    with pytest.raises(ModelError, match="it has no outputs; declare what is measured"):
        m.check()


def test_no_states() -> None:
    with pytest.raises(ModelError, match="model 'empty': it has no states"):
        Model("empty").check()


@pytest.mark.parametrize(
    ("declare", "words"),
    [
        (lambda m: m.states("x"), "state 'x': there is a state of this name already"),
        (lambda m: m.inputs("x"), "input 'x': there is a state of this name already"),
        (lambda m: m.parameters("u"), "parameter 'u': there is a input of this name already"),
        (lambda m: m.quantities(T=1.0), "quantity 'T': there is a parameter of this name already"),
        (lambda m: m.states("a b a"), "states: 'a' is given twice"),
        (lambda m: m.inputs("a", a="m"), "inputs: 'a' is given twice"),
    ],
)
def test_name_given_twice(declare: Callable[[Model], Any], words: str) -> None:
    m, *_ = lag()
    with pytest.raises(ModelError, match=words):
        declare(m)


def test_output_given_twice() -> None:
    m, x, u, T = lag()
    m.outputs(x=x)
    with pytest.raises(ModelError, match="output 'x': there is an output of this name already"):
        m.outputs(x=x)


def test_second_equation_of_a_state() -> None:
    m, x, u, T = lag()
    m.dynamics(x=x)
    with pytest.raises(ModelError, match=rf"state equation \({HERE}:\d+\): 'x' already has an equation"):
        m.dynamics(x=x)


def test_equation_of_what_is_no_state() -> None:
    m, x, u, T = lag()
    with pytest.raises(ModelError, match=rf"\({HERE}:\d+\): 'X' is not a state\. Did you mean 'x'\?"):
        m.dynamics(X=x)


@pytest.mark.parametrize("declare", [Model.states, Model.inputs, Model.parameters])
def test_time_is_reserved(declare: Callable[[Model, str], Any]) -> None:
    with pytest.raises(ModelError, match="'time': this name is the symbol of time"):
        declare(Model(), "time")


@pytest.mark.parametrize("name", ["2a", "a-b", "a.b", "q'"])
def test_name_of_other_characters(name: str) -> None:
    with pytest.raises(
        ModelError, match="a name starts with a letter and contains only letters, digits and underscores"
    ):
        Model().states(name)


@pytest.mark.parametrize("value", [float("nan"), math.inf, "fast", [1.0]])
def test_start_that_is_no_number_names_the_parameter(value: Any) -> None:
    with pytest.raises(ModelError, match="parameter 'a': a parameter's start must be"):
        Model().parameters(a=value)


def test_start_outside_its_bounds() -> None:
    with pytest.raises(ModelError, match=r"start 5 lies outside its bounds \(0, 1\)"):
        Model().parameters(a=Parameter(5, bounds=(0, 1)))


@pytest.mark.parametrize("unit", [5, ["m"], Parameter()])
def test_unit_that_is_no_text(unit: Any) -> None:
    with pytest.raises(ModelError, match="states: the unit of 'x' is text"):
        Model().states(x=unit)


@pytest.mark.parametrize("bad", ["u - x", None, np.array([1.0, 2.0]), 1j])
def test_equation_that_is_no_expression(bad: Any) -> None:
    m, *_ = lag()
    with pytest.raises(
        ModelError, match=rf"dynamics of 'x' \({HERE}:\d+\): a \w+ is neither an expression nor a number"
    ):
        m.dynamics(x=bad)


def test_output_with_more_than_a_unit() -> None:
    m, x, *_ = lag()
    with pytest.raises(ModelError, match="outputs of 'x' .* a tuple is neither an expression"):
        m.outputs(x=(x, "m", "extra"))


def test_equation_that_is_not_finite() -> None:
    m, x, u, T = lag()
    m.dynamics(x=(u - x) / T)
    m.outputs(y=float("nan"))
    with pytest.raises(ModelError, match=rf"output y \({HERE}:\d+\): it contains the constant NaN"):
        m.check()


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda m: m.states(), "states: no names were given"),
        (lambda m: m.states(""), "states: no names were given"),
        (lambda m: m.states(5), "names are text"),
        (lambda m: m.dynamics(), "dynamics: no equations were given"),
        (lambda m: m.outputs(Expr.symbol("x")), r"outputs: give each output a name, as in outputs\(q=q\)"),
        (lambda m: m.noise(Gaussian(), x=1), "a noise model or standard deviations by output, not both"),
        (lambda m: m.noise(3), "a noise model is a Gaussian, StudentT, .* or PerOutput, not 3"),
        (lambda m: m.noise(x=-1), "noise of 'x': a known standard deviation is a positive number, not -1"),
        (lambda m: m.noise(x="small"), "a positive number, not 'small'"),
    ],
)
def test_wrong_call(call: Callable[[Model], Any], words: str) -> None:
    m, *_ = lag()
    with pytest.raises(ModelError, match=words):
        call(m)
