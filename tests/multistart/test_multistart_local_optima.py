"""Local optima of many starts are told as such, and all parameters that end at bounds are named."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from many import T, outcome, run, sine

import phugoid as ph
from phugoid import Experiment, Model
from phugoid.many_starts import at_bounds, below_best, local_optima
from phugoid.many_starts.optima import group
from phugoid.results import Multistart


def test_a_local_optimum_carries_a_remark_in_its_fit(rugged: Multistart) -> None:
    local = next(o for o in rugged.outcomes if o.index == rugged.optima[1].index)
    gap = rugged.optima[0].log_likelihood - local.log_likelihood
    fit = rugged.fit(local.index)
    assert fit.converged
    (remark,) = [w for w in fit.warnings if "optimum is local" in w]
    assert f"{rugged.optima[0].count} of 60 starts" in remark and f"higher by {gap:.4g}" in remark
    assert remark in fit.summary()


def test_the_best_fit_says_that_others_are_known_and_is_not_called_local(rugged: Multistart) -> None:
    (remark,) = [w for w in rugged.best.warnings if "local optima are known" in w]
    count = sum(o.count for o in rugged.optima[1:])
    assert remark.startswith(f"{len(rugged.optima) - 1} other local optima are known, where {count} of 60 starts")
    assert remark in rugged.summary()
    assert not any("optimum is local" in w for w in rugged.fit(rugged.optima[0].index).warnings)


def test_optima_of_the_same_likelihood_are_not_local(twins: Multistart) -> None:
    assert len(twins.optima) == 2
    assert "local optima" not in twins.summary()
    assert not any("local" in w and "starts" in w for i in (0, 1) for w in twins.fit(twins.optima[i].index).warnings)


def test_the_table_tells_local_optima(rugged: Multistart) -> None:
    pytest.importorskip("pandas")
    messages = rugged.to_pandas()["message"]
    best = set(rugged.optima[0].indices)
    for o in rugged.outcomes:
        assert ("optimum is local" in messages[o.index]) == (o.at_optimum and o.index not in best)


def test_a_start_that_is_not_there_is_an_error(twins: Multistart) -> None:
    with pytest.raises(ph.OptionError, match="start 20 is none of the 20 finished starts"):
        twins.fit(20)


def test_what_is_no_optimum_is_not_called_one() -> None:
    ends = [outcome(0, 5.0), outcome(1, 3.0, status="iteration limit"), outcome(2, 4.0, a=9.0)]
    optima = group(ends)
    assert below_best(ends[1], optima, 3) == "" == below_best(ends[0], optima, 3)
    assert "1 of 3 starts reached one whose log-likelihood is higher by 1, such as start 0" in below_best(
        ends[2], optima, 3
    )
    assert local_optima(optima, 3).startswith("1 other local optimum is known, where 1 of 3 starts (33.3 %) ended")
    assert local_optima(optima[:1], 3) == ""


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"a": 2.0, "b": 1e-5, "c": 0.0, "d": 7.0}, "a (upper), b (lower), c (lower)"),
        ({"a": 1.0, "b": 2e-5, "c": 1e-3, "d": 7.0}, ""),
    ],
)
def test_all_parameters_at_bounds_are_named(values: Mapping[str, float], told: str) -> None:
    declared = {
        "a": ph.Parameter(1.0, bounds=(-2.0, 2.0)),
        "b": ph.Parameter(1.0, bounds=(1e-5, 1e5)),
        "c": ph.Parameter(1.0, bounds=(0.0, 1.0)),
        "d": ph.Parameter(7.0),
    }
    assert at_bounds(values, declared) == told


def test_a_summary_names_the_parameters_at_bounds() -> None:
    m = Model("two gains, both bounded too low")
    (x,) = m.states("x")
    a, b = m.parameters(a=ph.Parameter(0.5, bounds=(0.0, 1.0)), b=ph.Parameter(0.5, bounds=(0.0, 1.0)))
    m.dynamics(x=-x)
    m.initial(x=1.0)
    m.outputs(y=a * x, z=b * x)
    noise = 0.01 * np.random.default_rng(0).standard_normal((2, T.size))
    e = Experiment(T, outputs={"y": 2.0 * np.exp(-T) + noise[0], "z": 3.0 * np.exp(-T) + noise[1]})
    result = ph.multistart(m, e, {"a": (0.1, 0.9), "b": (0.1, 0.9)}, n=2)
    assert "At bounds in optimum 1: a (upper), b (upper)." in result.summary()
    assert "At bounds" not in run(1, sine(), data=e.with_outputs({"y": np.sin(T)}), ranges={"a": (0.9, 1.1)}).summary()


def test_an_optimum_below_which_a_start_was_cut_says_so(rugged: Multistart) -> None:
    """Remark on an end at the best optimum where another start was cut at a higher log-likelihood: none was made."""
    best = rugged.optima[0]
    cut = outcome(len(rugged.outcomes), best.log_likelihood + 5.0, status="time limit")
    with_cut = replace(rugged, outcomes=(*rugged.outcomes, cut), n=rugged.n + 1)
    pytest.importorskip("pandas")
    messages = with_cut.to_pandas()["message"]
    assert "1 start was cut at a log-likelihood above that of the best optimum" in messages[best.index]
    assert "was cut at a log-likelihood" not in messages[cut.index]
    assert any("there is a better optimum" in w for w in with_cut.fit(best.index).warnings)
