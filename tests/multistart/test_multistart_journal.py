"""A journal, from which a run goes on."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from many import RANGES, Counting, T, data, interrupt_after, reference, run, square, told

import phugoid as ph
from phugoid import DataError, Model
from phugoid.results import Outcome


def lines(path: Path) -> list[bytes]:
    return path.read_bytes().splitlines(keepends=True)


@pytest.mark.parametrize("anywhere", [None, "pool"], indirect=True)
def test_an_interrupted_run_goes_on_from_its_journal(anywhere: Executor | None, tmp_path: Path) -> None:
    path, runs = tmp_path / "starts.jsonl", tmp_path / "runs"
    options: dict[str, Any] = {"journal": path, "solver": Counting(file=str(runs)), "executor": anywhere}
    first = run(6, progress=interrupt_after(3), **options)
    assert (first.status, len(first.outcomes)) == ("interrupted", 3)
    assert len(lines(path)) == 1 + 3
    time.sleep(0.3 if anywhere else 0.0)  # what was in flight ends on its own
    before = runs.stat().st_size
    second = run(6, **options)
    assert (second.status, told(second)) == ("complete", reference())
    assert runs.stat().st_size - before == 3
    third = run(6, **options)
    assert told(third) == reference()
    assert runs.stat().st_size - before == 3
    assert len(lines(path)) == 1 + 6


def test_a_run_that_is_killed_goes_on_from_its_journal(tmp_path: Path) -> None:
    path = tmp_path / "j"
    script = f"""
from many import *
run(6, journal={str(path)!r}, progress=lambda outcome: outcome.index == 2 and os.kill(os.getpid(), signal.SIGKILL))
"""
    done = subprocess.run([sys.executable, "-c", script], cwd=Path(__file__).parent)
    assert done.returncode == -signal.SIGKILL
    assert len(lines(path)) == 1 + 3
    seen: list[Outcome] = []
    assert told(run(6, journal=path, progress=seen.append)) == reference()
    assert [o.index for o in seen] == [3, 4, 5]


def test_a_journal_keeps_every_bit(tmp_path: Path) -> None:
    first, second = (run(3, journal=tmp_path / "j") for _ in range(2))
    for one, other in zip(first.outcomes, second.outcomes, strict=True):
        assert vars(one) == vars(other)


def test_more_starts_can_be_asked_of_a_journal_later(tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    options: dict[str, Any] = {"journal": tmp_path / "j", "solver": Counting(file=str(runs))}
    run(2, **options)
    assert told(run(6, **options)) == reference()
    assert runs.stat().st_size == 6
    assert told(run(4, **options)) == reference()[:4]
    assert runs.stat().st_size == 6


@pytest.mark.parametrize("kept", [1, 20, -1], ids=["first byte", "some", "all but the end of line"])
def test_a_torn_last_line_is_run_again(kept: int, tmp_path: Path) -> None:
    path = tmp_path / "j"
    run(3, journal=path)
    whole = lines(path)
    path.write_bytes(b"".join(whole[:-1]) + whole[-1][:kept])
    assert told(run(3, journal=path)) == reference()[:3]
    assert [json.loads(line)["index"] for line in lines(path)[1:]] == [0, 1, 2]


def test_a_torn_header_is_written_again(tmp_path: Path) -> None:
    path = tmp_path / "j"
    run(2, journal=path)
    path.write_bytes(lines(path)[0][:30])
    assert told(run(2, journal=path)) == reference()[:2]
    assert told(run(2, journal=path)) == reference()[:2]


def test_a_damaged_line_is_named(tmp_path: Path) -> None:
    path = tmp_path / "j"
    run(3, journal=path)
    whole = lines(path)
    path.write_bytes(b"".join([*whole[:2], whole[2][:20] + b"\n", *whole[3:]]))
    with pytest.raises(DataError, match="line 3 is damaged"):
        run(3, journal=path)


def renamed() -> Model:
    return Model.from_json(square().to_json().replace("squared", "second"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"model": renamed()}, "the model differs"),
        ({"data": data(1)}, "the data of experiment 'run' differ"),
        ({"data": data().with_outputs(data().outputs, name="b")}, "experiment 'b' differ; .* experiment 'run' differ"),
        ({"ranges": {**RANGES, "a": (0.0, 4.0)}}, r"ranges: 'a' is \[-4.0, 4.0\] there and \[0.0, 4.0\] here"),
        ({"ranges": {"a": (-4.0, 4.0)}}, r"ranges: 'tau' is \[0.2, 3.0\] there and absent here"),
        ({"seed": 1}, "seed is 0 there and 1 here"),
        ({"start": {"sigma_y": 0.1}}, "start: 'sigma_y' is absent there and 0.1 here"),
        ({"noise": ph.Gaussian({"y": 0.05})}, "noise: 'y' is absent there"),
        ({"transcription": ph.Collocation(order=3)}, "transcription is .*order=2.* there and .*order=3.* here"),
        ({"solver": ph.Ipopt(tolerance=1e-6)}, "solver is default there and .*1e-06.* here"),
        ({"ranges": None, "starts": [{}]}, "seed is 0 there and none: starts were given here"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_the_journal_of_another_problem_is_refused(change: dict[str, Any], message: str, tmp_path: Path) -> None:
    path = tmp_path / "j"
    run(1, journal=path)
    before = path.read_bytes()
    with pytest.raises(DataError, match=f"belongs to another problem: .*{message}"):
        run(1, journal=path, **change)
    assert path.read_bytes() == before


def test_starts_given_must_be_those_of_the_journal(tmp_path: Path) -> None:
    starts = [{"tau": 0.5, "x": np.zeros(T.size)}, {"tau": 1.5, "x": 0.3}]
    run(None, ranges=None, starts=starts, journal=tmp_path / "j")  # type: ignore[arg-type]
    again = run(1, ranges=None, starts=starts, journal=tmp_path / "j")
    np.testing.assert_array_equal(again.outcomes[0].start["x"], starts[0]["x"])
    starts[0] = {"tau": 0.5, "x": np.ones(T.size)}
    with pytest.raises(DataError, match="start 0 differs"):
        run(2, ranges=None, starts=starts, journal=tmp_path / "j")


def test_threads_and_lines_of_code_have_no_part_in_a_journal(tmp_path: Path) -> None:
    run(2, journal=tmp_path / "j")
    moved = json.loads(square().to_json())
    for entry in (*moved["dynamics"], *moved["outputs"]):
        entry["source"] = "elsewhere.py:1"
    one_thread = ph.Collocation(order=2, threads=1)
    again = run(2, Model.from_json(json.dumps(moved)), transcription=one_thread, journal=tmp_path / "j")
    assert told(again) == reference()[:2]


@pytest.mark.parametrize("text", ["t,y\n0,1\n", "no line end", '{"format": "other"}\n', "[]\n"])
def test_a_file_that_is_no_journal_stays_as_it_is(text: str, tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text(text)
    with pytest.raises(DataError, match="is not a journal of a multistart"):
        run(1, journal=path)
    assert path.read_text() == text


def test_a_journal_of_a_newer_version_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "j"
    run(1, journal=path)
    path.write_bytes(path.read_bytes().replace(b'"version": 1', b'"version": 2', 1))
    with pytest.raises(DataError, match="has version 2"):
        run(1, journal=path)


def test_a_journal_needs_a_folder(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="cannot be read and written"):
        run(1, journal=tmp_path / "nowhere" / "j")
