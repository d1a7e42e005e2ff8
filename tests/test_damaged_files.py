"""Saved fits, models and journals that were damaged: refused when they are loaded, with the place."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from lag_case import lag, record

import phugoid as ph
from phugoid.writing import sealed


@pytest.fixture(scope="module")
def fit() -> ph.Fit:
    return ph.estimate(lag(), record())


def deep(levels: int) -> Any:
    found: Any = []
    for _ in range(levels):
        found = [found]
    return found


def put(*place: Any) -> Callable[[dict[str, Any]], None]:
    """What sets the entry at a place; the last is its value."""

    def change(document: dict[str, Any]) -> None:
        node: Any = document
        for key in place[:-2]:
            node = node[key]
        node[place[-2]] = place[-1]

    return change


DAMAGE: dict[str, tuple[Callable[[dict[str, Any]], None], str]] = {
    "a covariance of another size": (put("covariance", [[1.0]]), "covariance: has shape"),
    "a negative variance": (put("covariance", 0, 0, -1.0), "covariance: a variance is negative"),
    "a sample less": (lambda d: d["records"][0]["states"]["x"].pop(), r"records\[0\].states.x: has shape"),
    "times that go back": (put("records", 0, "t", 3, 0.0), r"records\[0\].t: does not increase"),
    "a state that is not finite": (put("records", 0, "states", "x", 3, None), r"records\[0\].states.x: 1 of its"),
    "no first state of a record": (lambda d: d["initial_states"].clear(), "initial_states: names"),
    "no records": (put("records", []), "records: there is none"),
    "a record without an output": (lambda d: d["records"][0]["outputs"].clear(), r"records\[0\].outputs: names"),
    "an estimate without a name of the model": (put("parameters", 0, "name", "b"), "parameters: 'a' is missing"),
    "an estimate that is not a number": (put("parameters", 0, "value", None), "parameters.a.value is nan"),
    "a text for a number": (put("parameters", 0, "fixed", "no"), "parameters.a.fixed is not a truth value"),
    "an unknown status": (put("status", "fine"), "status is 'fine', which is none"),
    "a size of 1e13": (put("solution", "bound_multipliers", "lower", "size", 10**13), "bound_multipliers"),
    "a whole number of 400 digits": (put("iterations", 10**400), "iterations is not a whole number"),
    "unknowns in excess": (lambda d: d["solution"]["xi"].append([1.0]), "solution|inhomogeneous"),
    "experiments of other records": (put("experiments", 0, "name", "b"), "experiments: are not the records'"),
    "an experiment with fewer samples": (
        lambda d: (
            [d["experiments"][0][k].pop() for k in ("t",)]
            + [d["experiments"][0][g][n].pop() for g, n in (("inputs", "u"), ("outputs", "x"))]
        ),
        r"experiments\[0\]: has 59 samples, and its record 60",
    ),
    "deep nesting": (put("warnings", deep(900)), "damaged"),
}


@pytest.mark.parametrize("what", DAMAGE)
@pytest.mark.parametrize("sealing", ["as an earlier release", "with a right checksum"])
def test_damage_is_named_with_its_place(what: str, sealing: str, fit: ph.Fit, tmp_path: Path) -> None:
    path = tmp_path / "fit.json"
    fit.save(path)
    document = json.loads(path.read_text(encoding="utf-8"))
    change, words = DAMAGE[what]
    change(document)
    if sealing == "as an earlier release":
        del document["checksum"]
    else:
        document = sealed(document)
    path.write_text(json.dumps(document), encoding="utf-8")
    with pytest.raises(ph.DataError, match=words):
        ph.load(path)


def test_nesting_beyond_the_stack_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "fit.json"
    path.write_text('{"format": "phugoid-fit", "version": 2, "model": ' + "[" * 100_000, encoding="utf-8")
    with pytest.raises(ph.DataError, match="is not complete JSON"):
        ph.load(path)


@pytest.mark.parametrize("name", ["fit.json", "fit.h5"])
def test_a_single_digit_that_changed_is_found(name: str, fit: ph.Fit, tmp_path: Path) -> None:
    if name.endswith("h5"):
        pytest.importorskip("h5py")
    path = tmp_path / name
    fit.save(path)
    raw = path.read_bytes()
    at = raw.index(b'"log_likelihood": ') + 22
    path.write_bytes(raw[:at] + (b"1" if raw[at : at + 1] != b"1" else b"2") + raw[at + 1 :])
    with pytest.raises(ph.DataError, match="is damaged"):
        ph.load(path)


def test_spaces_and_the_order_of_keys_do_not_matter(fit: ph.Fit, tmp_path: Path) -> None:
    path = tmp_path / "fit.json"
    fit.save(path)
    document = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(json.dumps(document, indent=2, sort_keys=True), encoding="utf-8")
    assert ph.load(path).summary() == fit.summary()


def test_a_model_has_a_checksum_and_may_be_without(tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    lag().save(path)
    text = path.read_text(encoding="utf-8")
    assert ph.Model.load(path).to_json() == lag().to_json()
    path.write_text(text.replace('"start": 1.0', '"start": 1.5'), encoding="utf-8")
    with pytest.raises(ph.DataError, match="is damaged, or was changed after it was saved"):
        ph.Model.load(path)
    path.write_text(lag().to_json(), encoding="utf-8")
    assert ph.Model.load(path).to_json() == lag().to_json()


def test_a_damaged_noise_of_a_model_is_named(tmp_path: Path) -> None:
    m = lag()
    m.noise(x=ph.StudentT())
    document = json.loads(m.to_json())
    document["noise"] = {"kind": "Student t", "sigma": {}}
    with pytest.raises(ph.ModelError):
        ph.Model.from_json(json.dumps(document))


def test_a_line_of_a_journal_has_a_checksum(tmp_path: Path) -> None:
    path = tmp_path / "starts.jsonl"
    ph.multistart(lag(), record(), {"a": (0.5, 2.0)}, n=3, journal=path)
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    path.write_text("".join([*lines[:2], lines[2].replace('"iterations": ', '"iterations": 1'), lines[3]]))
    with pytest.raises(ph.DataError, match="line 3 is damaged; delete the line"):
        ph.multistart(lag(), record(), {"a": (0.5, 2.0)}, n=3, journal=path)
    entry = json.loads(lines[2])
    del entry["checksum"]  # of an earlier release
    path.write_text("".join([*lines[:2], json.dumps(entry) + "\n", lines[3]]))
    assert ph.multistart(lag(), record(), {"a": (0.5, 2.0)}, n=3, journal=path).status == "complete"


def test_a_solution_of_another_problem_is_an_error(fit: ph.Fit, tmp_path: Path) -> None:
    path = tmp_path / "fit.json"
    fit.save(path)
    document = json.loads(path.read_text(encoding="utf-8"))
    del document["checksum"]
    document["solution"]["multipliers"].pop()
    path.write_text(json.dumps(document), encoding="utf-8")
    again = ph.load(path)
    assert again.summary()
    with pytest.raises(ph.DataError, match="its solution is not one of its model and data"):
        _ = again.robust()


def test_no_message_is_longer_than_2000_characters(tmp_path: Path) -> None:
    path = tmp_path / "fit.json"
    path.write_text(json.dumps({"format": "x" * 10_000}), encoding="utf-8")
    with pytest.raises(ph.DataError) as told:
        ph.load(path)
    assert len(str(told.value)) <= 2000
