"""`make demo`: the program runs from the fit to the pages, and builds show how they go on."""

from __future__ import annotations

import sys

import demo
import hfb320
import pytest
import show_progress


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
