"""What a finding's numbers are made to say."""

from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace
from typing import Any

import pytest

from phugoid.discrepancy.page import _nearest, finding_lines, headline, value_of
from phugoid.discrepancy.search.finding import Finding, Scored

LAG = Finding(
    cause="CL:lag_alpha",
    aliases=("CL:lag_q",),
    status="named",
    coefficient=-0.46,
    std_error=0.03,
    interval=(-0.52, -0.4),
    unit="",
    parameters={"CL_lag_alpha": (-0.46, 0.03), "tau": (0.31, 0.05)},
    gain=120.0,
    held_out_gain=31.5,
    threshold=9.9,
    explanation="CL follows alpha with a lag",
    alternatives={"CL:lag_q": 96.0},
    units={"tau": "s"},
)


def test_all_parameters_of_a_finding_are_told() -> None:
    lines = finding_lines(LAG)
    assert lines[0] == "That is, CL follows alpha with a lag."
    assert "Estimated: -0.46 ± 0.03 (95 %: -0.52 to -0.4)." in lines
    assert "With tau = 0.31 ± 0.05 s." in lines


def test_a_disturbance_has_an_amplitude_and_a_frequency() -> None:
    parameters = {"Cm_sin": (3e-4, 1e-5), "Cm_cos": (-4e-4, 1e-5), "Cm_frequency": (math.pi, 0.01)}
    size = {"coefficient": 5e-4, "std_error": 1e-5, "interval": (4.8e-4, 5.2e-4)}
    lines = finding_lines(dataclasses.replace(LAG, cause="Cm:periodic", aliases=(), parameters=parameters, **size))
    assert "Amplitude: 0.000500 ± 0.000010 (95 %: 0.00048 to 0.00052), at 0.5 Hz." in lines
    assert not any("Estimated" in line for line in lines)


@pytest.mark.parametrize(
    ("value", "error", "interval"),
    [
        (0.0478623, 8e-7, "0.0478607 to 0.0478639"),
        (-93.0, 7.0, "-107 to -79.3"),
        (1.2e-4, 1e-4, "-7.6e-05 to 0.000316"),
        (11683.2, 0.4, "11682.4 to 11684"),
    ],
)
def test_the_ends_of_an_interval_can_be_told_apart(value: float, error: float, interval: str) -> None:
    ends = value - 1.96 * error, value + 1.96 * error
    said = value_of(dataclasses.replace(LAG, coefficient=value, std_error=error, interval=ends))
    assert f"(95 %: {interval})" in said


def test_an_estimate_at_the_edge_of_its_range_has_no_error() -> None:
    edge = dataclasses.replace(LAG, coefficient=0.0, std_error=0.0, interval=(0.0, 0.0), unit="N")
    assert value_of(edge) == "0 N, at the limit of its range, therefore without a standard error"


def test_a_finding_that_does_not_predict_is_doubted() -> None:
    doubted = "Together with the other causes it does not improve the prediction of held-out data; it is doubtful."
    assert doubted in finding_lines(dataclasses.replace(LAG, held_out_gain=-14.2))
    assert doubted not in finding_lines(LAG)
    assert doubted not in finding_lines(dataclasses.replace(LAG, held_out_gain=math.nan))


def test_what_fits_without_predicting_is_no_rival() -> None:
    unexplained = dataclasses.replace(LAG, cause="", status="unexplained", explanation="the residuals hold more")
    assert finding_lines(unexplained)[0] == "The residuals hold more."
    assert "What fits, but does not simulate held-out data better: CL:lag_q (gain +96.0)." in finding_lines(unexplained)
    lost = dataclasses.replace(unexplained, held_out_gain=-14.2)
    assert "What fits, but does not predict held-out data: CL:lag_q (gain +96.0)." in finding_lines(lost)


def test_surrogates_among_causes_are_named() -> None:
    surrogate = dataclasses.replace(LAG, cause="Z:periodic", aliases=(), status="surrogate")
    both: Any = SimpleNamespace(findings=[LAG, surrogate], verdict="named", interrupted=False, is_extended=False)
    assert headline(both) == (
        "The model misses one of {CL:lag_alpha, CL:lag_q}. "
        "Z:periodic is a surrogate, which fits but may represent another cause."
    )
    both.findings.append(dataclasses.replace(surrogate, cause="Z:drift"))
    assert "Z:periodic, Z:drift are surrogates, which fit but may represent" in headline(both)


@pytest.mark.parametrize(("ratio", "predictable", "told"), [(5.2, 0.97, True), (1.2, 0.97, False), (5.2, 0.3, False)])
def test_what_named_causes_leave_is_told(ratio: float, predictable: float, told: bool) -> None:
    channel = SimpleNamespace(name="q", structured=True, predictable=predictable, ratio=ratio)
    one: Any = SimpleNamespace(findings=[LAG], verdict="named", interrupted=False, is_extended=True)
    one.remaining = SimpleNamespace(channels={"q": channel})
    said = "with what is named, the residual of q is 5.2 times its noise." in headline(one)
    assert said is told


def near(statistic: float) -> Any:
    ranking = [Scored("q:bias", "", {}, statistic, 0.0, 0.0, 0.5), Scored("q:scale", "", {}, 3.0, 50.0, 0.0, 0.5)]
    return SimpleNamespace(ranking=ranking, threshold=19.8)


def test_how_near_the_best_candidate_came() -> None:
    text = "The best candidate is q:bias, with a gain of {} in log-likelihood (threshold 9.9)"
    assert _nearest(near(15.6)) == text.format(7.8) + "."
    assert _nearest(near(25.0)) == text.format(12.5) + (
        " to first order. It was rejected when it was estimated with the model, or by held-out data."
    )
