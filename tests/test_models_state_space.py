"""General state spaces: canonical forms hold any system with as few parameters as its transfer function has."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import phugoid as ph
from phugoid.linear.linearise import linearise, model_response

FREQUENCIES = np.linspace(0.01, 3.0, 40)


def system(n: int, m: int, p: int) -> ph.linear.StateSpace:
    random = np.random.default_rng(n + 10 * m + 100 * p)
    A = random.normal(size=(n, n)) - 2.0 * np.eye(n)
    return ph.linear.StateSpace(A, random.normal(size=(n, m)), random.normal(size=(p, n)), random.normal(size=(p, m)))


@pytest.mark.parametrize("structure", ["observer", "companion", "full"])
@pytest.mark.parametrize(("n", "m", "p"), [(4, 1, 1), (5, 2, 2), (3, 1, 2), (2, 3, 3), (5, 2, 1)])
def test_it_starts_with_the_transfer_function_of_a_numeric_system(structure: Any, n: int, m: int, p: int) -> None:
    truth = system(n, m, p)
    model = ph.models.state_space(start=truth, structure=structure)
    values = {name: each.start for name, each in model.declared_parameters.items()}
    for u in truth.inputs:
        for y in truth.outputs:
            expected = truth.frequency_response(FREQUENCIES, u, y).response
            found = model_response(model, FREQUENCIES, u, y, parameters=values).response
            np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-8)
    count = {"observer": n * (m + p), "companion": n * (m + p), "full": n * (n + m + p)}[structure]
    assert len(model.parameter_names) == count + m * p


def test_the_chains_are_scaled_by_the_rate() -> None:
    found = linearise(ph.models.state_space(2, rate=50.0), {"a_2_1": -1.0, "a_2_2": -0.5, "b_1_u": 0, "b_2_u": 1})
    np.testing.assert_array_equal(found.A, [[0.0, 50.0], [-1.0, -0.5]])
    np.testing.assert_array_equal(found.C, [[1.0, 0.0]])


def test_a_start_of_equal_eigenvalues_is_taken() -> None:
    double = ([[-1.0, 1.0], [0.0, -1.0]], [[0.0], [1.0]], [[1.0, 0.0]])
    model = ph.models.state_space(start=double, rate=1.0)
    declared = model.declared_parameters
    assert declared["a_2_1"].start == pytest.approx(-1.0) and declared["a_2_2"].start == pytest.approx(-2.0)


def test_what_cannot_be_right_is_refused() -> None:
    unseen = ([[-1.0, 0.0], [0.0, -2.0]], [[1.0], [1.0]], [[1.0, 0.0]])
    cases: list[tuple[type[Exception], str, Any]] = [
        (
            ph.OptionError,
            "structure is one of observer, companion, full",
            lambda: ph.models.state_space(2, structure="observable"),
        ),  # type: ignore[arg-type]
        (ph.OptionError, "give n, or start", lambda: ph.models.state_space()),
        (ph.OptionError, "at least 1", lambda: ph.models.state_space(0)),
        (ph.OptionError, "rate is a positive number", lambda: ph.models.state_space(1, rate=-1.0)),
        (ph.ModelError, "not seen in y", lambda: ph.models.state_space(start=unseen)),
        (ph.ModelError, "n is 3, but start has 2", lambda: ph.models.state_space(3, start=unseen)),
    ]
    for kind, message, call in cases:
        with pytest.raises(kind) as error:
            call()
        assert message in str(error.value)


def test_equations_are_cited_at_the_line_that_asked_for_the_model() -> None:
    text = ph.models.state_space(2).to_json()
    assert "test_models_state_space.py:" in text and "general.py:" not in text
