"""The example that diagnoses real records: its cases where the records are there, and what it prints where not."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import real_records

import phugoid as ph


@pytest.mark.parametrize("name", real_records.CASES)
def test_a_case_is_fitted_on_one_part_and_judged_on_another(name: str) -> None:
    case = real_records.CASES[name]()
    if case is None:
        pytest.skip(f"the record of {name} is not there")
    for part in (*case.fitted, *case.held_out):
        assert all(np.isfinite(part.outputs[n]).any() for n in case.model.output_names if n in part.outputs)
    assert {e.name for e in case.fitted}.isdisjoint(e.name for e in case.held_out)


def test_the_force_on_a_real_cart_is_named() -> None:
    case = real_records.CASES["cart3_08"]()
    if case is None:
        pytest.skip("the record of cart3_08 is not there")
    d = ph.diagnose(ph.estimate(case.model, list(case.fitted[:3])), validation=list(case.held_out[:2]))
    assert [f.cause for f in d.findings if f.status == "named"] == ["v':bias"]


def test_records_that_are_not_there_are_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for module in (real_records, real_records.attas, real_records.hfb320):
        monkeypatch.setattr(module, "find", lambda name: None, raising=False)
    monkeypatch.setattr(sys, "argv", ["real_records.py", "hfb320", "ball", "--out", str(tmp_path)])
    real_records.main()
    printed = capsys.readouterr().out
    assert "hfb320: the record is not there" in printed
    assert "ball: the record is not there" in printed
    assert (tmp_path / "index.html").exists()
