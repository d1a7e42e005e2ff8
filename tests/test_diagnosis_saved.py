"""Diagnoses that are saved and loaded again."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from cli_case import run, write
from hidden import make

import phugoid as ph
from phugoid.writing import sealed


@pytest.fixture(scope="module")
def fit() -> ph.Fit:
    """A spring that hardens, which the model does not know."""
    case = make("duffing", ("f:x^3",), "strong", "white", 1)
    return ph.estimate(case.model, case.data)


@pytest.fixture(scope="module")
def diagnosis(fit: ph.Fit) -> ph.results.Diagnosis:
    return ph.diagnose(fit)


@pytest.mark.parametrize("name", ["d.json", "d.h5"])
def test_all_of_it_comes_back(name: str, diagnosis: ph.results.Diagnosis, tmp_path: Path) -> None:
    if name.endswith(".h5"):
        pytest.importorskip("h5py")
    diagnosis.save(tmp_path / name)
    again = ph.load(tmp_path / name)
    assert isinstance(again, ph.results.Diagnosis)
    assert [f.cause for f in again.findings] == ["f:x^3"]
    for a, b in zip(again.findings, diagnosis.findings, strict=True):
        np.testing.assert_equal(asdict(a), asdict(b))
    for s, t in zip(again.ranking, diagnosis.ranking, strict=True):
        np.testing.assert_equal(asdict(s), asdict(t))
    assert (again.threshold, again.notes, again.seconds) == (diagnosis.threshold, diagnosis.notes, diagnosis.seconds)
    assert again.found and not again.interrupted
    assert again.summary() == diagnosis.summary()
    assert again.fit.parameters.to_dict() == diagnosis.fit.parameters.to_dict()
    one, other = again.extend(), diagnosis.extend()
    assert one.added == other.added and str(one.model) == str(other.model)
    np.testing.assert_equal(asdict(one.gain), asdict(other.gain))
    assert one.fit.parameters.to_dict() == other.fit.parameters.to_dict()
    assert len(again.figures()) == len(diagnosis.figures())
    again.report(tmp_path / "page.html")
    assert "f:x^3" in (tmp_path / "page.html").read_text(encoding="utf-8")
    # And once more.
    again.save(tmp_path / f"again_{name}")
    assert ph.load(tmp_path / f"again_{name}").summary() == diagnosis.summary()


def test_nothing_found_is_saved_too(diagnosis: ph.results.Diagnosis, tmp_path: Path) -> None:
    none = ph.diagnose(diagnosis.extend().fit)
    assert not none.found
    none.save(tmp_path / "d.json")
    again = ph.load(tmp_path / "d.json")
    assert not again.found and again.summary() == none.summary() and len(again.figures()) == len(none.figures())


def test_a_file_tells_the_misfit_in_words_and_what_it_is(diagnosis: ph.results.Diagnosis, tmp_path: Path) -> None:
    diagnosis.save(tmp_path / "d.json")
    document = json.loads((tmp_path / "d.json").read_text(encoding="utf-8"))
    assert (document["format"], document["version"]) == ("phugoid-diagnosis", 1)
    assert document["misfit"] == diagnosis.misfit.summary()


def test_what_a_later_release_adds_is_passed_over(diagnosis: ph.results.Diagnosis, tmp_path: Path) -> None:
    path = tmp_path / "d.json"
    diagnosis.save(path)
    document = json.loads(path.read_text(encoding="utf-8"))
    document["findings"][0]["mood"] = document["mood"] = "good"
    path.write_text(json.dumps(sealed(document)), encoding="utf-8")
    assert ph.load(path).summary() == diagnosis.summary()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"version": 2}, "has version 2 of the format, but this phugoid reads up to 1"),
        ({"findings": None}, "is damaged"),
        ({"format": "something"}, "is not a fit saved by phugoid .format 'something'"),
    ],
)
def test_files_that_cannot_be_read(
    change: dict[str, object], words: str, diagnosis: ph.results.Diagnosis, tmp_path: Path
) -> None:
    path = tmp_path / "d.json"
    diagnosis.save(path)
    path.write_text(json.dumps({**json.loads(path.read_text(encoding="utf-8")), **change}), encoding="utf-8")
    with pytest.raises(ph.DataError, match=words):
        ph.load(path)


def test_fits_load_as_before_and_bad_places_are_named(
    fit: ph.Fit, diagnosis: ph.results.Diagnosis, tmp_path: Path
) -> None:
    fit.save(tmp_path / "fit.json")
    assert isinstance(ph.load(tmp_path / "fit.json"), ph.Fit)
    with pytest.raises(ph.DataError, match="there is no such file"):
        ph.load(tmp_path / "none.json")
    with pytest.raises(ph.DataError, match="cannot be saved, since there is no folder"):
        diagnosis.save(tmp_path / "no" / "d.json")


def test_the_command_line_saves_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path)
    monkeypatch.chdir(tmp_path)
    done = run("diagnose", "model.py", "run1.csv", "--save", "d.json")
    assert done.exit_code in (0, 1) and done.stdout.endswith("Written: d.json\n"), done.output
    assert done.stdout.startswith(ph.load("d.json").summary())
    # A diagnosis is not a fit to go on from.
    wrong = run("validate", "d.json", "run2.csv")
    assert wrong.exit_code == 2 and "holds a diagnosis, not a model or a fit" in wrong.stderr
    wrong = run("diagnose", "model.py", "run1.csv", "--save", "d.txt")
    assert wrong.exit_code == 2 and "a saved diagnosis ends in .json" in wrong.stderr
