"""Text tables as data loggers write them: a preamble before the header, dates as times, numbers for missing samples."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import phugoid as ph


def written(folder: Path, text: str) -> Path:
    path = folder / "log.csv"
    path.write_text(text)
    return path


def test_lines_before_the_header_are_passed_over(tmp_path: Path) -> None:
    text = "Flight 12\nRecorder: A7, serial 4\n\ntime [s],de [deg],q\n0.0,1,2\n0.1,2,3\n0.2,3,4\n0.3,3,4\n"
    run = ph.read(written(tmp_path, text))
    assert run.t.tolist() == [0.0, 0.1, 0.2, 0.3]
    assert run.channels["q"].tolist() == [2, 3, 4, 4] and run.units["de"] == "deg"


def test_a_header_that_lacks_a_name_is_no_preamble(tmp_path: Path) -> None:
    with pytest.raises(ph.DataError, match="line 2: has 3 fields, but the header has 2"):
        ph.read(written(tmp_path, "t,q\n0.0,1,2\n0.1,2,3\n0.2,2,3\n"))
    with pytest.raises(ph.DataError, match="line 2: has 3 fields, but the header has 2"):
        ph.read(written(tmp_path, "t,q\n[s],[deg],[deg]\n0.1,2,3\n0.2,2,3\n"))


@pytest.mark.parametrize(
    "times",
    [
        ["2024-05-31T23:59:59.5Z", "2024-06-01T00:00:00Z", "2024-06-01T00:00:00.500000Z"],
        ["2024-05-31 23:59:59.5", "2024-06-01 00:00:00", "2024-06-01 00:00:00,5"],
        ["2024-06-01T01:59:59.5+02:00", "2024-05-31T19:00:00-0500", "2024-06-01T00:00:00.5Z"],
    ],
)
def test_dates_are_seconds_from_the_first(times: list[str], tmp_path: Path) -> None:
    rows = "".join(f"{t};{k}\n" for k, t in enumerate(times))
    run = ph.read(written(tmp_path, f"time;q\n{rows}"))
    assert run.t.tolist() == [0.0, 0.5, 1.0] and run.channels["q"].tolist() == [0, 1, 2]


def test_a_cell_that_is_no_date_is_named(tmp_path: Path) -> None:
    text = "time,q\n2024-05-31T12:00:00,1\n2024-05-31T12:00:99,2\n2024-05-31T12:00:02,2\n"
    with pytest.raises(ph.DataError, match="line 3, column 'time': '2024-05-31T12:00:99' is not a date with its time"):
        ph.read(written(tmp_path, text))


def test_a_number_for_missing_samples_is_answered_with_what_to_do(tmp_path: Path) -> None:
    text = "t,q\n0.0,1\n0.1,-9999\n0.2,-9999.0\n0.3,2\n"
    with pytest.raises(ph.DataError, match=r"line 3, column 'q': -9999, in 2 samples, .* leave these cells empty") as e:
        ph.read(written(tmp_path, text))
    assert "na_values=[-9999]" in str(e.value)
    pandas = pytest.importorskip("pandas")
    run = ph.read(pandas.read_csv(written(tmp_path, text), na_values=[-9999]), outputs=["q"])
    assert np.isnan(run.outputs["q"]).tolist() == [False, True, True, False]


def test_a_column_that_comes_near_it_is_of_numbers(tmp_path: Path) -> None:
    run = ph.read(written(tmp_path, "t,h\n0.0,-9998\n0.1,-9999\n0.2,-10000\n"))
    assert run.channels["h"].tolist() == [-9998, -9999, -10000]
