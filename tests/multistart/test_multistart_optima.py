"""Which optima there are."""

from __future__ import annotations

import json
import pickle

import numpy as np
import pytest
from many import T, outcome, run, sine, square

import phugoid as ph
from phugoid import EvaluationError, Experiment, Model
from phugoid.many_starts.optima import group
from phugoid.results import Multistart, Outcome


@pytest.mark.parametrize(
    ("one", "other", "count"),
    [
        (outcome(0, 5.0), outcome(1, 5.0009), 1),
        (outcome(0, 5.0), outcome(1, 5.0011), 2),
        (outcome(0, 5.0, 1.0), outcome(1, 5.0, 1.009), 1),
        (outcome(0, 5.0, 1.0), outcome(1, 5.0, 1.011), 2),
        (outcome(0, 5.0, 1.0, 1e-3), outcome(1, 5.0, 1.001, 1e-3), 2),
        (outcome(0, 5.0, 100.0, np.nan), outcome(1, 5.0, 100.9, np.nan), 1),
        (outcome(0, 5.0, 100.0, np.nan), outcome(1, 5.0, 102.0, np.nan), 2),
        (outcome(0, 5.0, 0.0, np.nan), outcome(1, 5.0, 0.0, np.nan), 1),
        (outcome(0, 5.0), outcome(1, 5.0, status="acceptable"), 1),
        (outcome(0, 5.0), outcome(1, np.nan), 1),
    ],
)
def test_what_counts_as_the_same_optimum(one: Outcome, other: Outcome, count: int) -> None:
    assert len(group([one, other])) == count


def test_optima_come_best_first_with_their_starts() -> None:
    optima = group([outcome(0, 1.0), outcome(1, 3.0, 2.0), outcome(2, 1.0004), outcome(3, 3.0, -2.0), outcome(4, 1.0)])
    assert [(o.log_likelihood, o.count, o.index, o.indices) for o in optima] == [
        (3.0, 1, 1, (1,)),
        (3.0, 1, 3, (3,)),
        (1.0004, 3, 2, (0, 2, 4)),
    ]


def test_a_gain_known_by_its_square_has_two_optima(twins: Multistart) -> None:
    assert len(twins.optima) == 2
    assert {round(o.parameters["a"]) for o in twins.optima} == {-2, 2}
    assert sum(o.count for o in twins.optima) == 20
    assert twins.success_rate == 1.0
    for optimum in twins.optima:
        assert optimum.index in optimum.indices
        assert abs(optimum.parameters["tau"] - 0.8) < 4 * optimum.std_errors["tau"]
    assert "It is 2 optima with the same log-likelihood" in twins.summary()
    assert len(twins.group(parameters=1e9)) == 1


def test_failures_are_outcomes(rugged: Multistart) -> None:
    counts = rugged.counts
    assert set(counts) == {"converged", "iteration limit", "error"}
    assert sum(counts.values()) == 60
    for failed in (o for o in rugged.outcomes if o.status == "error"):
        assert failed.start["a"] < -4
        assert failed.message.startswith("EvaluationError: at the starting point, the equation of c' is not finite")
        assert np.isnan(failed.log_likelihood) and failed.parameters == {}


def test_summary_tells_the_optima_and_the_failures(rugged: Multistart) -> None:
    text = rugged.summary()
    assert str(rugged) == text
    best = rugged.optima[0]
    assert 1 < best.count < 30 and rugged.success_rate == best.count / 60
    assert f"{best.count} of 60 starts ({100 * best.count / 60:.3g} %) reached the best optimum" in text
    assert "evidence that it is the global one, not proof" in text
    assert "starts      60, all finished" in text
    assert "iterations  median " in text
    numbers = [o.index for o in rugged.outcomes if o.status == "error"]
    assert f"error: {len(numbers)} start(s), number {', '.join(map(str, numbers[:12]))}" in text
    assert "the first: EvaluationError" in text
    assert f"and {len(rugged.optima) - 10} more" in text or len(rugged.optima) <= 10


def test_a_single_start_at_the_best_is_no_evidence() -> None:
    assert "One start does not show whether there are other optima." in run(1).summary()


def test_ends_where_parameters_cannot_be_determined_are_told_as_optima() -> None:
    m = ph.Model("product")
    (x,) = m.states(x="")
    a, b = m.parameters(a=1.0, b=1.0)
    m.dynamics(x=-x)
    m.outputs(y=a * b * x)
    m.initial(x=1.0)
    y = 2.0 * np.exp(-T) + 0.01 * np.random.default_rng(1).standard_normal(T.size)
    result = ph.multistart(m, ph.Experiment(T, {}, {"y": y}), n=3, ranges={"a": (0.5, 2.0), "b": (0.5, 2.0)}, seed=1)
    assert result.counts == {"unidentifiable": 3}
    summary = result.summary()
    assert "converged      0 (0 %)" in summary and "at an optimum  3 (100 %)" in summary
    assert "Optimum 1: the data do not determine all parameters" in summary


def test_best_is_the_fit_of_the_best_outcome(rugged: Multistart) -> None:
    best = rugged.best
    assert best.converged and rugged.best is best
    assert best.log_likelihood == pytest.approx(rugged.optima[0].log_likelihood, abs=1e-6)
    assert best.parameters["a"].value == pytest.approx(2.0, abs=4 * best.parameters["a"].std_error)
    assert best.states["c"].shape == (T.size,)


def test_best_leaves_fixed_parameters_and_given_states_alone() -> None:
    document = json.loads(square().to_json())
    document["parameters"][1].update(fixed=True, start=2.0)
    fixed = Model.from_json(json.dumps(document))
    result = run(2, fixed, ranges={"tau": (0.5, 2.0)}, start={"x": np.sin(T)})
    assert result.best.converged
    assert result.best.parameters["a"].value == 2.0
    assert np.isnan(result.outcomes[0].std_errors["a"])


def test_best_without_any_that_converged_says_so() -> None:
    result = run(3, solver=ph.Ipopt(max_iterations=2))
    assert (result.optima, result.success_rate) == ((), 0.0)
    assert result.best.status == "iteration limit"
    # After two iterations the states satisfy no equation: starts are ranked by the integrated model.
    assert not result.best.feasible and np.isnan(result.best.log_likelihood)
    assert result.best.integrated_log_likelihood == pytest.approx(max(o.log_likelihood for o in result.outcomes))
    assert "iteration limit: 3 start(s), number 0, 1, 2" in result.summary()


def test_no_best_where_no_start_led_anywhere() -> None:
    e = Experiment(T, outputs={"y": np.sin(2.0 * T)})
    result = run(3, sine(), data=e, ranges={"a": (-9.0, -5.0)})
    assert result.counts == {"error": 3}
    with pytest.raises(EvaluationError, match="none of the 3 starts led to an estimate"):
        _ = result.best
    assert "error: 3 start(s)" in result.summary()


def test_result_survives_pickling(twins: Multistart) -> None:
    again = pickle.loads(pickle.dumps(twins))
    assert again.summary() == twins.summary()
