"""The modal form: as many modes, inputs and outputs as wanted, and the transfer function that it starts with."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import phugoid as ph
from phugoid.linear.linearise import linearise, model_response

FREQUENCIES = np.linspace(0.01, 8.0, 50)


def system(n_pairs: int = 3, n_real: int = 0, m: int = 2, p: int = 2, seed: int = 0) -> ph.linear.StateSpace:
    """Not in modal form."""
    random = np.random.default_rng(seed)
    A = np.zeros((2 * n_pairs + n_real,) * 2)
    for k in range(n_pairs):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[-0.2 - 0.1 * k, 4.0 + 9.0 * k], [-4.0 - 9.0 * k, -0.2 - 0.1 * k]]
    for k in range(n_real):
        A[2 * n_pairs + k, 2 * n_pairs + k] = -1.0 - k
    T = random.normal(size=A.shape)
    n = len(A)
    B, C, D = random.normal(size=(n, m)), random.normal(size=(p, n)), random.normal(size=(p, m))
    return ph.linear.StateSpace(T @ A @ np.linalg.inv(T), B, C, D)


def starts(model: ph.Model) -> dict[str, float]:
    return {name: p.start for name, p in model.declared_parameters.items()}


@pytest.mark.parametrize("scale", ["fixed", "free"])
@pytest.mark.parametrize(("n_pairs", "n_real", "m", "p"), [(3, 0, 2, 2), (2, 1, 1, 1), (1, 2, 3, 1), (0, 2, 2, 3)])
def test_it_starts_with_the_transfer_function_of_a_numeric_system(
    scale: Any, n_pairs: int, n_real: int, m: int, p: int
) -> None:
    truth = system(n_pairs, n_real, m, p)
    model = ph.models.modal(start=truth, scale=scale)
    assert len(model.state_names) == 2 * n_pairs + n_real
    for u in truth.inputs:
        for y in truth.outputs:
            expected = truth.frequency_response(FREQUENCIES, u, y).response
            found = model_response(model, FREQUENCIES, u, y, parameters=starts(model)).response
            np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-9)


def test_it_is_the_form_of_the_paper() -> None:
    model = ph.models.modal(2, scale="free")
    assert model.parameter_names == (
        *("sigma_1", "omega_1", "b_1", "c_1a", "c_1b"),
        *("sigma_2", "omega_2", "b_2", "c_2a", "c_2b"),
    )
    assert not any(p.fixed for p in model.declared_parameters.values())
    values = dict(zip(model.parameter_names, [-0.1, 2.0, 3.0, 0.5, 0.25, -0.4, 5.0, 1.0, -1.0, 2.0], strict=True))
    found = linearise(model, values)
    np.testing.assert_array_equal(
        found.A, [[-0.1, 2.0, 0, 0], [-2.0, -0.1, 0, 0], [0, 0, -0.4, 5.0], [0, 0, -5.0, -0.4]]
    )
    np.testing.assert_array_equal(found.B, [[3.0], [0], [1.0], [0]])
    np.testing.assert_array_equal(found.C, [[0.5, 0.25, -1.0, 2.0]])


def test_with_the_scale_fixed_c_is_the_residue_and_nothing_is_redundant() -> None:
    """As many free parameters as the transfer function has: a pole and m + p - 1 complex numbers a mode, and D."""
    for m, p in ((1, 1), (1, 3), (2, 1), (3, 2)):
        model = ph.models.modal(start=system(3, 0, m, p))
        free = [name for name, each in model.declared_parameters.items() if not each.fixed]
        assert len(free) == 3 * (2 + 2 * (m + p - 1)) + m * p
    model = ph.models.modal(start=system(1, 0, 1, 1))
    assert model.declared_parameters["b_1"] == ph.Parameter(1.0, fixed=True)


def test_the_input_that_moves_a_mode_most_has_its_scale_held() -> None:
    one = [[-0.1, 3.0], [-3.0, -0.1]]
    model = ph.models.modal(start=(one, [[0.0, 2.0], [0.0, 0.0]], [[1.0, 0.0]]), inputs="idle active")
    declared = model.declared_parameters
    assert declared["b_1a_active"].fixed and not declared["b_1a_idle"].fixed
    assert declared["b_1a_idle"].start == declared["b_1b_idle"].start == 0.0


def test_feedthrough_is_given_to_the_outputs_named() -> None:
    names = ph.models.modal(1, "u v", "x a", feedthrough="a").parameter_names
    assert [name for name in names if name.startswith("d_")] == ["d_a_u", "d_a_v"]
    assert "d" in ph.models.modal(1, feedthrough=True).parameter_names
    # A start has it where it is not zero.
    A, B, C = [[-1.0, 2.0], [-2.0, -1.0]], [[1.0], [0.0]], [[1.0, 0.0], [0.0, 1.0]]
    names = ph.models.modal(start=(A, B, C, [[0.0], [0.5]]), outputs=("x", "a")).parameter_names
    assert [name for name in names if name.startswith("d")] == ["d_a"]


def test_no_mode_may_grow_where_that_is_said() -> None:
    A = [[0.1, 2.0, 0.0], [-2.0, 0.1, 0.0], [0.0, 0.0, 0.5]]
    free, stable = (ph.models.modal(start=(A, [[1.0]] * 3, [[1.0] * 3]), stable=s) for s in (False, True))
    for name, value in (("sigma_1", 0.1), ("sigma_r1", 0.5)):
        assert free.declared_parameters[name].start == pytest.approx(value)
        declared = stable.declared_parameters[name]
        assert declared.start == pytest.approx(-value) and declared.bounds == (-np.inf, 0.0)


def test_a_bias_is_of_each_experiment() -> None:
    model = ph.models.modal(1, outputs="x a", bias=True)
    assert model.declared_parameters["bias_a"].per_experiment


def test_a_mode_without_input_does_not_show() -> None:
    one = [[-0.1, 3.0], [-3.0, -0.1]]
    model = ph.models.modal(start=(one, [[0.0], [0.0]], [[1.0, 0.0]]))
    assert starts(model)["c_1a"] == 0.0


def test_what_cannot_be_right_is_refused() -> None:
    twice = np.array([[-1.0, 1.0], [0.0, -1.0]]), [[1.0], [1.0]], [[1.0, 0.0]]
    good = system(1, 0, 1, 1)
    cases: list[tuple[type[Exception], str, Any]] = [
        (ph.OptionError, "give n_modes, or start", lambda: ph.models.modal()),
        (ph.OptionError, "n_modes is a whole number, not 1.5", lambda: ph.models.modal(1.5)),  # type: ignore[arg-type]
        (ph.OptionError, "at least 1, or n_real", lambda: ph.models.modal(0)),
        (ph.OptionError, 'scale is "fixed" or "free", not \'both\'', lambda: ph.models.modal(1, scale="both")),  # type: ignore[arg-type]
        (ph.OptionError, "'z' is not an output", lambda: ph.models.modal(1, feedthrough=["z"])),
        (ph.OptionError, "a positive number for each of 2 modes", lambda: ph.models.modal(2, frequencies_hz=[1.0])),
        (ph.OptionError, "not both", lambda: ph.models.modal(start=good, frequencies_hz=[1.0])),
        (ph.OptionError, "inputs holds names of channels", lambda: ph.models.modal(1, [])),
        (ph.OptionError, "sigma_r1 is the damping", lambda: ph.models.modal(1, outputs="r1", n_real=1)),
        (ph.ModelError, "n_modes is 2, but start has 1", lambda: ph.models.modal(2, start=good)),
        (ph.ModelError, "2 inputs are named, but start has 1", lambda: ph.models.modal(inputs="u v", start=good)),
        (ph.ModelError, "cannot be distinguished", lambda: ph.models.modal(start=twice)),
        (ph.ModelError, "start is a StateSpace, or the matrices", lambda: ph.models.modal(start="gvt")),
        (ph.ModelError, "B has shape", lambda: ph.models.modal(start=(twice[0], [[1.0]], [[1.0, 0.0]]))),
        (ph.ModelError, "A holds numbers that are not finite", lambda: ph.linear.StateSpace([[np.nan]], [[1]], [[1]])),
        (ph.ModelError, "C has shape", lambda: ph.linear.StateSpace([[1.0]], [[1]], [1.0])),
        (ph.ModelError, "is not a matrix of real numbers", lambda: ph.linear.StateSpace([["a"]], [[1]], [[1]])),
        (
            ph.ModelError,
            "2 inputs are named, but the matrices have 1",
            lambda: ph.linear.StateSpace([[1.0]], [[1]], [[1]], inputs=("u", "v")),
        ),
    ]
    for kind, message, call in cases:
        with pytest.raises(kind) as error:
            call()
        assert message in str(error.value)
