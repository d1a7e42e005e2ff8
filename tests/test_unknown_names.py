"""An unknown name in what a fit or a record holds by name is a KeyError that says which names there are."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from typing import Any

import pytest
from oscillator import measured, model

import phugoid as ph


@pytest.fixture(scope="module")
def fit() -> ph.Fit:
    return ph.estimate(model(), measured(300, (0.0, 0.0), 1))


@pytest.mark.parametrize(
    ("look", "message"),
    [
        (lambda fit: fit.residuals["w"], "there is no output 'w'. There are: x, v."),
        (lambda fit: fit.outputs["V"], "there is no output 'V'. Did you mean 'v'? There are: x, v."),
        (lambda fit: fit.states["w"], "there is no state 'w'. There are: x, v."),
        (lambda fit: fit.records[0].measured["w"], "there is no measured output 'w'. There are: x, v."),
        (lambda fit: fit.records[0].inputs["w"], "there is no input 'w'. There are: u."),
        (lambda fit: fit.initial_states["runs"], "there is no experiment 'runs'. Did you mean 'run'? There are: run."),
        (lambda fit: fit.experiments[0].outputs["w"], "there is no output 'w'. There are: x, v."),
        (
            lambda fit: fit.experiments[0].channels["w"],
            "there is no channel 'w'. There are: none. The record was made from arrays: use `inputs` and `outputs`.",
        ),
    ],
)
def test_it_names_those_that_are_there(look: Callable[[ph.Fit], Any], message: str, fit: ph.Fit) -> None:
    with pytest.raises(KeyError) as error:
        look(fit)
    assert str(error.value) == message
    with pytest.raises(ph.errors.UnknownName):
        look(pickle.loads(pickle.dumps(fit)))


def test_notebooks_complete_the_names(fit: ph.Fit) -> None:
    residuals: Any = fit.residuals
    assert residuals._ipython_key_completions_() == list(fit.model.output_names)


def test_mappings_stay_as_they_were(fit: ph.Fit) -> None:
    assert "w" not in fit.residuals and fit.residuals.get("w") is None and list(fit.states) == ["x", "v"]


def test_a_text_is_no_expression(fit: ph.Fit) -> None:
    with pytest.raises(ph.ModelError, match="derived 'ratio': 'k/c' is text: give an expression of the symbols"):
        fit.derived(ratio="k/c")  # type: ignore[arg-type]
