"""The example of a model that misses something: what was put in the twin is found, and put right."""

from __future__ import annotations

import sys
from pathlib import Path

import demo
import hfb320
import missing_physics
import pytest
from missing_physics import HIDDEN, Walk

import phugoid as ph


@pytest.fixture(scope="module")
def walk() -> Walk:
    return missing_physics.walk(*missing_physics.twins())


def off(fit: ph.Fit, name: str) -> float:
    """Standard errors from the truth."""
    e = fit.parameters[name]
    return abs(e.value - hfb320.PUBLISHED[name]) / e.std_error


def test_the_fit_that_is_wrong_is_sure_of_itself(walk: Walk) -> None:
    assert walk.fit.converged and not walk.fit.warnings
    assert all(off(walk.fit, name) > 8 for name in ("Cma", "Cmq", "Cmde"))


def test_both_effects_are_found_and_nothing_else(walk: Walk) -> None:
    findings = walk.diagnosis.findings
    assert len(findings) == len(HIDDEN)
    for name, true in HIDDEN.items():
        (f,) = (f for f in findings if name in (f.cause, *f.aliases))
        if f.cause == name:
            assert abs(f.coefficient - true) < 4 * f.std_error


def test_the_extended_model_finds_the_truth(walk: Walk) -> None:
    ext = walk.diagnosis.extend()
    assert all(off(ext.fit, name) < 4 for name in hfb320.PUBLISHED)
    assert all(ext.gain.change(name, held_out=True) < 0.02 for name in ext.gain.channels)


def test_it_prints_and_writes(
    walk: Walk, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(missing_physics, "walk", lambda *_, **__: walk)
    monkeypatch.setattr(sys, "argv", ["missing_physics.py", "--out", str(tmp_path)])
    missing_physics.main()
    printed = capsys.readouterr().out
    assert "The model misses" in printed and "Cmq" in printed
    assert (tmp_path / "missing_physics.html").stat().st_size > 100_000
    saved = ph.Model.load(tmp_path / "missing_physics.json")
    assert str(saved) == str(walk.diagnosis.extend().model)


def test_without_the_record_it_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr(missing_physics, "find", lambda _: None)
    monkeypatch.setattr(sys, "argv", ["missing_physics.py", "--real", "--out", str(tmp_path)])
    with pytest.raises(SystemExit):
        missing_physics.main()
    assert "PHUGOID_DATA" in capsys.readouterr().err


def test_the_demonstration_finds_what_it_hid(
    walk: Walk, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without the flight record `make demo` fits and diagnoses the same two manoeuvres."""

    def again(fit: ph.Fit, *, validation: ph.Experiment, progress: bool) -> ph.results.Diagnosis:
        assert progress and fit.log_likelihood == walk.fit.log_likelihood
        assert (validation.outputs["q"] == missing_physics.twins()[1].outputs["q"]).all()
        return walk.diagnosis

    monkeypatch.setattr(ph, "diagnose", again)
    monkeypatch.setattr(demo, "find", lambda _: None)
    monkeypatch.setattr(sys, "argv", ["demo.py", "--out", str(tmp_path)])
    demo.main()
    printed = capsys.readouterr().out
    assert "4 of 4: extension by de:delay, alpha:scale" in printed and "held out before" in printed
    for name in ("hfb320.html", "hfb320_missing.html"):
        assert str(tmp_path / name) in printed and (tmp_path / name).stat().st_size > 50_000
    assert ph.load(tmp_path / "hfb320.json").converged
