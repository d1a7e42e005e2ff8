"""`make demo`: the program runs from the fit to the pages, and builds show how they go on."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import demo
import hfb320
import missing_physics
import pytest
import show_progress

import phugoid as ph


def test_without_the_record_it_finds_what_it_hid(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    candidates = ph.candidates(hfb320.model()).only(*missing_physics.HIDDEN, "Cm:alpha^2")
    whole = ph.diagnose

    def quick(*args: Any, **options: Any) -> ph.results.Diagnosis:
        return whole(*args, **options, candidates=candidates)

    monkeypatch.setattr(ph, "diagnose", quick)
    monkeypatch.setattr(demo, "find", lambda _: None)
    monkeypatch.setattr(sys, "argv", ["demo.py", "--out", str(tmp_path)])
    demo.main()
    printed = capsys.readouterr().out
    assert "4 of 4: extension by de:delay, alpha:scale" in printed and "held out before" in printed
    for name in ("hfb320.html", "hfb320_missing.html"):
        assert str(tmp_path / name) in printed and (tmp_path / name).stat().st_size > 50_000
    assert ph.load(tmp_path / "hfb320.json").converged


@pytest.mark.skipif(demo.find(hfb320.RECORD) is None, reason=f"{hfb320.RECORD} is not there (see README)")
def test_the_flight_record_is_split() -> None:
    whole, first, second, about = demo.records()
    assert (first.n, second.n, whole.n) == (201, 401, 601) and hfb320.RECORD in about


def test_a_long_command_shows_that_it_runs(capsys: pytest.CaptureFixture[str]) -> None:
    slow = "import time; print('compiling', flush=True); time.sleep(0.6); print('linking', flush=True)"
    assert show_progress.run("Building", [sys.executable, "-c", slow], every=0.25) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("Building ...") and "s  compiling" in printed and "Building: done after" in printed
    assert show_progress.run("Building", [sys.executable, "-c", "print('why'); raise SystemExit(3)"]) == 3
    printed = capsys.readouterr().out
    assert "why\n" in printed and "failed" in printed
