"""What `diagnose` refuses, and says."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hidden import Case, make

import phugoid as ph
from phugoid import DataError, ModelError, OptionError


@functools.cache
def servo() -> Case:
    return make("servo", "torque:sign(rate)", "strong", "white", 1)


@functools.cache
def fit() -> ph.Fit:
    return ph.estimate(servo().model, servo().data)


def symbol(name: str) -> ph.Expr:
    return ph.Expr.symbol(name)


@pytest.mark.parametrize(
    ("given", "kind"),
    [
        (lambda: None, "NoneType"),
        (lambda: servo().model, "Model"),
        (lambda: ph.equation_error(servo().model, servo().data), "EquationError"),
    ],
)
def test_what_is_no_fit(given: Callable[[], Any], kind: str) -> None:
    with pytest.raises(OptionError, match=f"the first argument is a fit, as estimate gives it, not {kind}"):
        ph.diagnose(given())


def test_a_fit_with_process_noise() -> None:
    filtered = ph.estimate(servo().model, servo().data, transcription=ph.FilterError(states=("rate",)))
    with pytest.raises(OptionError, match=r"process noise explains every misfit.*without FilterError"):
        ph.diagnose(filtered)


def test_data_of_the_model_itself() -> None:
    simulated = ph.simulate(servo().model, fit(), servo().data)
    exact = ph.estimate(servo().model, servo().data.with_outputs(simulated.outputs))
    with pytest.raises(DataError, match=r"residuals of output 'angle' are all zero.*no noise"):
        ph.diagnose(exact)


def test_one_output_that_is_exact() -> None:
    simulated = ph.simulate(servo().model, fit(), servo().data)
    outputs = {"angle": servo().data.outputs["angle"], "rate": simulated.outputs["rate"]}
    one = ph.estimate(servo().model, servo().data.with_outputs(outputs))
    with pytest.raises(DataError, match="residuals of output 'rate' are all zero"):
        ph.diagnose(one)


def test_too_few_samples_of_an_output() -> None:
    with pytest.raises(
        DataError, match=r"output 'angle' has 31 samples, too few to distinguish noise from misfit \(40\)"
    ):
        ph.diagnose(ph.estimate(servo().model, servo().data.window(0, 0.6)))
    outputs = {n: y.copy() for n, y in servo().data.outputs.items()}
    outputs["rate"][20:] = np.nan
    with pytest.raises(DataError, match="output 'rate' has 20 samples"):
        ph.diagnose(ph.estimate(servo().model, servo().data.with_outputs(outputs)))


def test_too_few_samples_for_the_unknowns() -> None:
    m = ph.Model("many unknowns")
    (x,) = m.states(x="m")
    (u,) = m.inputs(u="N")
    names = [f"c{k}" for k in range(12)]
    c = m.parameters(" ".join(names))
    m.dynamics(x=u - x + sum(p * ph.sin((k + 1) * m.time) for k, p in enumerate(c)))
    m.outputs(x=x)
    t = 0.1 * np.arange(50)
    e = ph.Experiment(t, {"u": np.sin(2 * t)}, {"x": np.random.default_rng(0).standard_normal(t.size)})
    with pytest.raises(DataError, match=r"record is too short: 50 measurements for 13 unknowns .*at least 5 for each"):
        ph.diagnose(ph.estimate(m, e))


def without(name: str) -> ph.Experiment:
    e = servo().validation
    return e.with_outputs({n: y for n, y in e.outputs.items() if n != name})


@pytest.mark.parametrize(
    ("validation", "words"),
    [
        (lambda: make("duffing", (), "", "white", 1).data, "experiment 'data' has no input 'volts'.*There are: u"),
        (lambda: without("rate"), "experiment 'validation' has no output 'rate'.*There are: angle"),
        (lambda: servo().data, "validation record 'data' is one that the fit was made on: give another, or none"),
        (lambda: [servo().validation, servo().data], "validation record 'data' is one that the fit was made on"),
        (lambda: [servo().validation] * 2, "two experiments are called 'validation'"),
        (lambda: [], "the list of experiments is empty"),
        (lambda: "run2.csv", "diagnose: validation: data is an Experiment or a list of them"),
    ],
    ids=["other inputs", "other outputs", "its own", "its own among others", "twice", "empty", "no experiment"],
)
def test_validation_records(validation: Callable[[], Any], words: str) -> None:
    with pytest.raises(DataError, match=words):
        ph.diagnose(fit(), validation=validation())


@pytest.mark.parametrize("which", ["read again", "of a loaded fit"])
def test_its_own_record_in_another_guise(which: str, tmp_path: Path) -> None:
    e, given = servo().data, fit()
    if which == "of a loaded fit":
        given.save(tmp_path / "fit.json")
        given = ph.load(tmp_path / "fit.json")
    else:
        e = e.with_outputs(e.outputs, name="another name")
    with pytest.raises(DataError, match="is one that the fit was made on"):
        ph.diagnose(given, validation=e)


def elsewhere() -> ph.results.Candidates:
    """Candidates of a model that has a torque too, of other states."""
    m = ph.Model("other servo")
    a, b = m.states("a", "b")
    (volts,) = m.inputs("volts")
    (p,) = m.parameters("p")
    (torque,) = m.quantities(torque=p * volts - b)
    m.dynamics(a=b, b=torque)
    m.outputs(angle=a)
    return ph.candidates(m)


@pytest.mark.parametrize(
    ("candidates", "error", "words"),
    [
        (lambda: [*ph.candidates(servo().model)][:1] * 2, OptionError, "candidate 'torque:angle' is given twice"),
        (lambda: ph.candidates(make("duffing", (), "", "white", 1).model), OptionError, "quantity 'f', which the"),
        (lambda: [elsewhere()["torque:a*b"]], DataError, "no state, input or quantity 'a'"),
        (lambda: ["torque:sign(rate)"], OptionError, r"'torque:sign\(rate\)', which is not a Candidate: make them by"),
        (lambda: {"torque": [symbol("rate")]}, ModelError, "torque:rate: the model has this already"),
        (lambda: {"torque": [symbol("rate") ** 5] * 2}, ModelError, r"torque:rate\^5 and torque:rate\^5 are the same"),
        (lambda: {"torque": [symbol("d") * symbol("rate")]}, ModelError, "holds the parameter 'd'"),
        (lambda: {"torq": [symbol("rate") ** 2]}, ModelError, "'torq' names no quantity.*Did you mean 'torque'"),
        (lambda: {"torque": [symbol("Rate") ** 2]}, ModelError, "unknown 'Rate'. Did you mean 'rate'"),
        (lambda: {"torque": ["rate**2"]}, ModelError, "'torque' holds 'rate\\*\\*2', not an expression"),
    ],
    ids=[
        *("twice", "other places", "other states", "a name", "already there", "terms twice", "with a parameter"),
        *("no such place", "no such symbol", "text"),
    ],
)
def test_candidates(candidates: Callable[[], Any], error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        ph.diagnose(fit(), candidates=candidates())


def test_no_candidates_at_all_is_an_answer(tmp_path: Path) -> None:
    d = ph.diagnose(fit(), candidates=[])
    assert not d.found and d.ranking == ()
    d.report(tmp_path / "page.html")
    page = re.sub(r"base64,[^']*", "", (tmp_path / "page.html").read_text(encoding="utf-8"))
    for text in (d.summary(), page):
        assert not re.search(r"\bnan\b", text)
        assert "No candidates were tried" in text


def test_terms_of_your_own_are_added() -> None:
    d = ph.diagnose(fit(), candidates={"torque": [symbol("rate") ** 3 * symbol("volts")]})
    assert "torque:rate^3*volts" in [s.name for s in d.ranking]
    assert [f.cause for f in d.findings] == ["torque:sign(rate)"]
