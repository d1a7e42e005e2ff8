"""Models changed by methods: parameters, terms and noise in a model that is otherwise the same."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import phugoid as ph
from phugoid import Expr, Gaussian, Model, ModelError, Parameter, StudentT

PACKAGE = Path(ph.__file__).parent


def late() -> Model:
    """Two states, a quantity, an initial condition, a late input and a late sensor."""
    m = Model("late")
    a, q = m.states(a="rad", q=ph.State("rad/s", start=0.5))
    (u,) = m.inputs(u="rad")
    k, b, tau, h = m.parameters(
        k=Parameter(-2.0, bounds=(-10, 0), unit="1/s²", prior=(-2, 1)), b=0.1, tau=0.05, h=Parameter(0.1, fixed=True)
    )
    (moment,) = m.quantities(M=k * a + m.delay(u, tau))
    m.dynamics(q=moment, a=q)
    m.initial(q=0.0)
    m.outputs(a=(a + b, "deg"), q=q)
    m.sensor_delay(q=h)
    m.noise(a=0.01)
    return m


def test_number_moves_a_start_and_keeps_what_else_was_declared() -> None:
    m = late()
    before = m.to_json()
    changed = m.with_parameters(k=-3.0, h=0.2)
    assert changed.declared_parameters["k"] == Parameter(-3.0, bounds=(-10, 0), unit="1/s²", prior=(-2, 1))
    assert changed.declared_parameters["h"] == Parameter(0.2, fixed=True)
    assert m.to_json() == before


def test_parameter_takes_the_place_of_the_declaration() -> None:
    changed = late().with_parameters({"k": Parameter(1.0, fixed=True)})
    assert changed.declared_parameters["k"] == Parameter(1.0, fixed=True)
    assert changed.parameter_names == late().parameter_names


def test_nothing_changed_is_the_same_model() -> None:
    m = late()
    assert m.with_parameters().to_json() == m.to_json()
    assert m.with_terms({}).to_json() == m.to_json()
    assert m.with_noise(a=0.01).to_json() == m.to_json()


def test_term_is_added_where_it_belongs() -> None:
    m, c, a = late(), Expr.symbol("c"), Expr.symbol("a")
    changed = m.with_terms({"M": c * a**2, "q'": a, "y:q": 2.0}, {"c": Parameter(0.5, unit="1/s²")})
    assert {n: changed.equations[n] for n in ("M", "q'", "y:q")} == {
        "M": m.equations["M"] + c * a**2,
        "q'": m.equations["q'"] + a,
        "y:q": m.equations["y:q"] + 2.0,
    }
    assert changed.declared_parameters["c"] == Parameter(0.5, unit="1/s²")
    assert (changed.delays, changed.units["a"]) == (m.delays, "deg")
    changed.check()


def test_noise_is_stated_as_by_the_method_of_that_name() -> None:
    m = late()
    assert m.with_noise(q=0.02).noise_model == Gaussian({"a": 0.01, "q": 0.02})
    assert isinstance(m.with_noise(StudentT()).noise_model, StudentT)
    assert m.noise_model == Gaussian({"a": 0.01})


def test_changed_model_is_independent() -> None:
    m = late()
    changed = m.with_noise(q=0.02)
    changed.parameters(extra=1.0)
    assert "extra" not in m.parameter_names


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda m: m.with_parameters(kk=1.0), "with_parameters: 'kk' is not a parameter. Did you mean 'k'?"),
        (lambda m: m.with_parameters(k=1.0), "with_parameters: 'k': a parameter's start 1 lies outside its bounds"),
        (lambda m: m.with_parameters(k="one"), "with_parameters: 'k'"),
        (lambda m: m.with_terms({"q": 1.0}), "with_terms: 'q' is not an equation. Did you mean"),
        (lambda m: m.with_terms({"M": "a"}), "with_terms: the term of 'M'"),
        (lambda m: m.with_terms({"M": 1.0}, {"k": 1.0}), "with_terms: the model has a parameter 'k' already"),
    ],
)
def test_wrong_change_is_refused(change: object, words: str) -> None:
    with pytest.raises(ModelError, match=re.escape(words)):
        change(late())  # type: ignore[operator]


def test_core_model_is_handled_in_modelling_alone() -> None:
    """What poses problems for the core hands its model on; nothing else asks what is in it or builds another."""
    posing = {
        "estimation",
        "fleet",
        "online",
        "transcription.py",
        "filter_error.py",
        "simulation.py",
        "initialisation.py",
    }
    found = []
    for path in PACKAGE.rglob("*.py"):
        name = path.relative_to(PACKAGE)
        if name.parts[0] not in {"modelling", *posing} and re.search(
            r"\b_core\.(Model|Evaluator)\b|model\._core\b|\b(rebuilt|changed)\(", path.read_text()
        ):
            found.append(str(name))
    assert found == []
