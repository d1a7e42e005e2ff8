"""The counts that the benchmark of diagnoses prints, of outcomes made by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import discrepancy_scores as scores
import hidden
import numpy as np
import pytest
from discrepancy_scores import Found, Outcome

import phugoid as ph


def outcome(truth: dict[str, str], *found: Found, **about: Any) -> Outcome:
    coefficients = dict.fromkeys(truth, 2.0)
    return Outcome(0, "make(...)", "servo", "white", "weak", truth, coefficients, found, **about)


FRICTION = {"f:sign(v)": "friction"}
RIGHT = Found(("f:sign(v)",), "named", 2.2, (1.9, 2.5))
ALIAS = Found(("f:v|v|", "f:sign(v)"), "surrogate", 5.0, (4.0, 6.0))
WRONG = Found(("u:delay",), "named", 0.1, (0.0, 0.2))
UNSURE = Found(("",), "unexplained", 0.0, (0.0, 0.0))

OUTCOMES = [
    outcome(FRICTION, RIGHT),
    outcome(FRICTION, ALIAS),
    outcome(FRICTION, WRONG),
    outcome(FRICTION, error="raised ValueError: no"),
    outcome({**FRICTION, "f:x^3": "stiffness"}, RIGHT, WRONG),
    outcome({}),
    outcome({}, UNSURE),
    outcome({}, WRONG),
]


def test_recall_takes_aliases_and_what_raised_is_missed() -> None:
    rows = {name: rest for name, *rest in scores.recall(OUTCOMES, lambda o, effect: o.truth[effect])}
    assert rows == {
        "friction": ["0.600  (3 of 5)", "0.400  (2 of 5)"],
        "stiffness": ["0.000  (0 of 1)", "0.000  (0 of 1)"],
    }


def test_claims_of_what_is_not_there() -> None:
    rows = dict(map(tuple, scores.honesty(OUTCOMES)))
    assert rows["false alarms, of cases with nothing hidden"] == "0.333  (1 of 3)"
    assert rows["false discoveries, of all claims"] == "0.500  (3 of 6)"
    assert rows["  of claims 'surrogate'"] == "0.000  (0 of 1)"
    assert rows["  nothing said at all"] == "0.333  (1 of 3)"
    assert rows["'unexplained' said, of cases"] == "0.125  (1 of 8)"


def test_promises_are_kept_within_a_hundredth() -> None:
    kept = [outcome(FRICTION, RIGHT, promise=(part, (0.5, 0.9))) for part in (0.6, 0.495, 0.4, 0.95)]
    strength, every = scores.promises([*kept, outcome(FRICTION, RIGHT)])
    assert strength == ["weak", "0.500  (2 of 4)", "0.250  (1 of 4)", "0.250  (1 of 4)"]
    assert every == ["all", *strength[1:]]


def test_what_was_promised_is_compared_with_a_third_record() -> None:
    case = hidden.make("servo", "torque:sign(rate)", "strong", "white", 3, more=1)
    d = ph.diagnose(ph.estimate(case.model, case.data), validation=case.validation)
    found = scores.kept_promise(case, d.fit, d)
    assert found is not None
    part, interval = found
    assert interval == d.findings[0].explained_another
    assert 0.5 < part <= 1.0
    assert scores.kept_promise(hidden.nothing("servo", "white", 3), d.fit, d) is None


def test_rates_are_alike_in_verdict_causes_and_aliases() -> None:
    def at(verdict: str, *found: Found) -> Outcome:
        return outcome(FRICTION, *found, verdict=verdict)

    same = (at("named", RIGHT), at("named", RIGHT), at("named", RIGHT))
    alias = (at("named", RIGHT), at("named", Found(("f:v|v|", "f:sign(v)"), "named", 1.0, (0.0, 2.0))))
    other = (at("named", RIGHT), at("named", WRONG), at("nothing"))
    rows = dict(map(tuple, scores.alike([same, alias, other, other])))
    assert rows == {
        "verdict": "0.500  (2 of 4)",
        "named causes": "0.250  (1 of 4)",
        "named causes or their aliases": "0.500  (2 of 4)",
    }


def test_thinned_records_keep_their_inputs_and_every_second_output() -> None:
    run = ph.Experiment(np.arange(5.0), {"u": np.arange(5.0)}, {"y": np.arange(5.0)})
    one = scores.thinned([run], 2)[0]
    np.testing.assert_array_equal(one.output("y"), [0.0, np.nan, 2.0, np.nan, 4.0])
    np.testing.assert_array_equal(one.input("u"), run.input("u"))
    assert scores.thinned(run, 1) is run and scores.thinned(None, 2) is None


def test_coefficients_count_where_the_effect_is_named_first() -> None:
    wide = Found(("f:sign(v)",), "named", 3.0, (2.5, 3.5))
    rows = scores.accuracy([*OUTCOMES, outcome(FRICTION, wide)])
    assert rows == [["weak", "10.0 %", "0.667  (2 of 3)"], ["all", "10.0 %", "0.667  (2 of 3)"]]


def test_the_amplitude_of_a_wave_has_no_sign() -> None:
    wave = outcome({"f:periodic": "disturbance"}, Found(("f:periodic",), "named", 2.2, (1.9, 2.5)))
    wave.coefficients["f:periodic"] = -2.0
    assert scores.accuracy([wave])[0] == ["weak", "10.0 %", "1.000  (1 of 1)"]


def test_failures_are_listed() -> None:
    assert [o.failed for o in OUTCOMES] == [False, False, True, True, True, False, False, True]
    assert str(OUTCOMES[1]) == "0: make(...): f:v|v| or f:sign(v) (surrogate)"
    assert str(OUTCOMES[3]).endswith("raised ValueError: no")


CHOICE = {"systems": ["servo"], "strengths": ["medium"], "noises": ["white"], "validation": True}


def test_a_diagnosis_is_read_as_it_is() -> None:
    """The first four names count, and what is raised is kept."""
    asked = {}

    def diagnose(fit: Any, validation: Any) -> Any:
        asked.update(status=fit.status, held=validation.name)
        finding = SimpleNamespace(
            cause="a:b", aliases=("c:d", "e:f", "g:h", "i:j"), status="named", coefficient=1, interval=(0, 2)
        )
        return SimpleNamespace(findings=[finding], verdict="named")

    read = scores.diagnosed(1, CHOICE, diagnose)
    assert asked == {"status": "converged", "held": "validation"}
    assert read.found == (Found(("a:b", "c:d", "e:f", "g:h"), "named", 1.0, (0.0, 2.0)),)
    assert read.verdict == "named"
    assert read.time < 1 and read.fit_time > 0

    def broken(fit: Any, validation: Any) -> Any:
        raise ZeroDivisionError("by zero")

    assert scores.diagnosed(1, CHOICE, broken).error == "raised ZeroDivisionError: by zero"


def test_a_case_that_cannot_be_made_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(seed: int, **choice: Any) -> None:
        raise scores.hidden.Unreachable("too weak")

    monkeypatch.setattr(scores.hidden, "draw", refuse)
    assert scores.diagnosed(1, CHOICE).error == "not made: too weak"
