"""read: text tables in, experiments out, complaints with line and column; and the format of saved fits."""

from __future__ import annotations

import gzip
import json
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phugoid.data.read import read
from phugoid.errors import DataError
from phugoid.saving import files as io

NAN = float("nan")


@pytest.fixture
def table(tmp_path: Path) -> Any:
    """Writes a text file and gives its path."""

    def write(text: str, name: str = "run1.csv") -> Path:
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return write


def refusal(path: Path, **options: Any) -> str:
    with pytest.raises(DataError) as caught:
        read(path, **options)
    return str(caught.value)


def has(message: str, *parts: str) -> bool:
    return all(part in message for part in parts)


def test_columns_stay_undetermined_until_a_model_asks(table: Any) -> None:
    e = read(table("t,de,q\n0,1,2\n0.1,3,4\n"))
    assert (e.name, list(e.channels), dict(e.inputs), dict(e.outputs)) == ("run1", ["de", "q"], {}, {})
    np.testing.assert_array_equal(e.t, [0.0, 0.1])
    np.testing.assert_array_equal(e.input("de"), [1.0, 3.0])
    np.testing.assert_array_equal(e.output("q"), [2.0, 4.0])


def test_named_inputs_and_outputs_are_all_that_is_kept(table: Any) -> None:
    e = read(table("t,de,mode,q\n0,1,AUTO,2\n1,3,MANUAL,4\n"), inputs=["de"], outputs=["q"])
    assert (list(e.inputs), list(e.outputs), list(e.channels)) == (["de"], ["q"], [])


def test_a_table_without_times_has_a_rate(table: Any) -> None:
    path = table("u,y\n1,2\n3,4\n5,6\n")
    e = read(path, rate=4.0, inputs=["u"], outputs=["y"])
    np.testing.assert_array_equal(e.t, [0.0, 0.25, 0.5])
    np.testing.assert_array_equal(e.output("y"), [2.0, 4.0, 6.0])
    assert has(refusal(path), "no time column 't'", "rate=")
    assert has(refusal(path, rate=-4.0), "rate is a positive number of samples per unit of time, not -4.0")


def test_named_inputs_alone_leave_the_rest_open(table: Any) -> None:
    e = read(table("t,de,q\n0,1,2\n1,3,4\n"), inputs=["de"])
    assert list(e.inputs) == ["de"]
    np.testing.assert_array_equal(e.output("q"), [2.0, 4.0])


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("t,de,q\n0,1,2\n1,3,4\n", "a.csv"),
        ("t;de;q\n0;1;2\n1;3;4\n", "a.csv"),
        ("t\tde\tq\n0\t1\t2\n1\t3\t4\n", "a.tsv"),
        ("  t   de  q\n  0  1   2\n  1  3   4\n", "a.dat"),
        ("t \tde \tq\n0.0 \t1 \t2\n1.0 \t3 \t4\n", "a.txt"),
        ('"t", "de", "q"\n0, 1, 2\n1, 3, 4\n', "a.csv"),
        ("\ufefft,de,q\r\n0,1,2\r\n1,3,4\r\n\r\n", "a.csv"),
        ("# a comment\n\nt,de,q\n% another\n0,1,2\n1,3,4\n", "a.csv"),
        ("# t de q\n0 1 2\n1 3 4\n", "a.txt"),
    ],
)
def test_understands_the_layouts_in_use(table: Any, text: str, name: str) -> None:
    e = read(table(text, name))
    assert list(e.channels) == ["de", "q"]
    np.testing.assert_array_equal(e.output("q"), [2.0, 4.0])


def test_reads_gzip(tmp_path: Path) -> None:
    path = tmp_path / "run7.csv.gz"
    path.write_bytes(gzip.compress(b"t,q\n0,1\n1,2\n"))
    e = read(path)
    assert (e.name, e.n) == ("run7", 2)


def test_delimiter_can_be_given(table: Any) -> None:
    assert list(read(table("t|q\n0|1\n1|2\n"), delimiter="|").channels) == ["q"]


def test_columns_name_a_file_without_header(table: Any) -> None:
    e = read(table("0.0 1 2\n0.1 3 4\n", "a.asc"), columns=["T", "DE", "Q"], time="T", rename={"DE": "de"})
    assert (list(e.channels), e.n) == (["de", "Q"], 2)


def test_columns_replace_a_header(table: Any) -> None:
    e = read(table("x,y\n0,1\n1,2\n"), columns=["t", "q"])
    assert (list(e.channels), e.n) == (["q"], 2)


@pytest.mark.parametrize("cell", ["", "NaN", "nan", "NA", "null"])
def test_missing_cells_become_nan(table: Any, cell: str) -> None:
    e = read(table(f"t,q,r\n0,1,5\n1,{cell},6\n2,3,7\n"))
    np.testing.assert_array_equal(e.output("q"), [1.0, NAN, 3.0])


def test_units_come_from_the_header(table: Any) -> None:
    e = read(table("t [s],alpha (deg),V[m/s],Mach [-]\n0,1,2,0.3\n1,3,4,0.3\n"), units={"V": ("kt", "kt")})
    assert list(e.channels) == ["alpha", "V", "Mach"]
    assert dict(e.units) == {"alpha": "deg", "V": "kt", "time": "s"}


def test_units_come_from_a_row_of_their_own(table: Any) -> None:
    e = read(table("t,alpha\n[s],deg\n0,1\n1,3\n"))
    assert (dict(e.units), e.n) == ({"alpha": "deg", "time": "s"}, 2)


def test_units_hold_where_blanks_delimit(table: Any) -> None:
    assert dict(read(table("t [s]  q [rad/s]\n0 1\n1 2\n", "a.dat")).units) == {"q": "rad/s", "time": "s"}


def test_an_index_in_brackets_is_no_unit(table: Any) -> None:
    e = read(table("t,xyz[0],xyz[1]\n0,1,2\n1,3,4\n"))
    assert (list(e.channels), dict(e.units)) == (["xyz[0]", "xyz[1]"], {})


def test_latin_1_degree_sign(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes("t,alpha [°]\n0,1\n1,2\n".encode("latin-1"))
    assert dict(read(path).units) == {"alpha": "°"}


def test_rename_comes_before_selection_and_takes_units_along(table: Any) -> None:
    path = table("TIME,DELV [rad],Q\n0,1,2\n1,3,4\n")
    e = read(path, rename={"TIME": "t", "DELV": "de"}, inputs=["de"], outputs=["Q"])
    assert (list(e.inputs), dict(e.units)) == (["de"], {"de": "rad"})


def test_name_interpolation_and_window_are_passed_on(table: Any) -> None:
    path = table("t,q\n0,1\n1,2\n2,3\n3,4\n")
    e = read(path, name="climb", interpolation="cubic", window=(1.0, 3.0))
    assert (e.name, e.interpolation, e.n) == ("climb", "cubic", 3)


def test_absent_time_column(table: Any) -> None:
    assert has(refusal(table("T,q\n0,1\n1,2\n")), "no time column 't'", "Did you mean 'T'?", "T, q", "time=")


def test_absent_input_column(table: Any) -> None:
    message = refusal(table("t,elevator,q\n0,1,2\n1,2,3\n"), inputs=["elevatr"])
    assert has(message, "no column 'elevatr'", "Did you mean 'elevator'?", "elevator, q")


def test_unknown_rename_key(table: Any) -> None:
    message = refusal(table("t,alpha\n0,1\n1,2\n"), rename={"alfa": "a"})
    assert has(message, "rename", "'alfa'", "Did you mean 'alpha'?")


def test_rename_onto_a_taken_name(table: Any) -> None:
    assert has(refusal(table("t,p,q\n0,1,2\n1,2,3\n"), rename={"p": "q"}), "two columns", "'q'")


def test_two_columns_of_one_name(table: Any) -> None:
    assert has(refusal(table("t,q,q\n0,1,2\n1,2,3\n")), "two columns are called 'q'", "columns=[...]")


def test_text_for_a_list_of_names(table: Any) -> None:
    assert has(refusal(table("t,de\n0,1\n1,2\n"), inputs="de"), "inputs=['de']")


def test_header_missing(table: Any) -> None:
    assert has(refusal(table("0,1,2\n1,2,3\n")), "line 1", "header is missing", "3 columns", "columns=[...]")


@pytest.mark.parametrize(("row", "count"), [("1,2", 2), ("1,2,3,4", 4)])
def test_row_of_wrong_length_names_its_line(table: Any, row: str, count: int) -> None:
    message = refusal(table(f"# c\nt,a,b\n0,1,2\n{row}\n2,3,4\n"))
    assert has(message, "line 4", f"{count} fields", "the header has 3")


def test_wrong_number_of_column_names(table: Any) -> None:
    message = refusal(table("0 1 2\n1 2 3\n", "a.asc"), columns=["t", "q"])
    assert has(message, "line 1", "3 fields", "columns=[...] names 2")


def test_text_cell_names_line_and_column(table: Any) -> None:
    message = refusal(table("t,a,b\n0,1,2\n\n1,2,off\n"))
    assert has(message, "run1.csv", "line 4", "column 'b'", "'off' is not a number")


def test_a_column_of_words_is_left_out(table: Any) -> None:
    path = table("t,q,Remarks\n0,1,begin\n1,2,\n2,3,turn left\n")
    run = read(path)
    assert run.output("q").tolist() == [1.0, 2.0, 3.0]
    with pytest.raises(DataError, match=r"The file has it, but it holds text \('begin'\)"):
        run.output("Remarks")
    assert has(refusal(path, outputs=["Remarks"]), "'Remarks' (outputs=...) holds text ('begin')")
    # One number, a date or inf makes it a column with a wrong cell.
    assert has(refusal(table("t,q,b\n0,1,off\n1,2,3\n")), "'off' is not a number")


def test_decimal_commas_are_read(table: Any) -> None:
    run = read(table("Zeit [s];q\n0,00;1,500\n0,01;-,5e1\n0,02;\n"))
    assert run.t.tolist() == [0.0, 0.01, 0.02]
    assert run.output("q")[:2].tolist() == [1.5, -5.0] and np.isnan(run.output("q")[2])
    assert read(table("t;q\n0;1,5\n1;2,5\n")).output("q").tolist() == [1.5, 2.5]


def test_commas_that_may_separate_thousands_are_not_guessed(table: Any) -> None:
    for text in ("t;q\n0;1,500\n1;2,500\n", "t;q\n0.5;1,5\n1.5;2,5\n"):
        assert has(refusal(table(text)), "line 2", "decimal commas or thousands?", "write points")
    # A row of such numbers is not one of units.
    assert has(refusal(table("t;q\n1,000;1,500\n1,001;2,500\n")), "line 2", "'1,000'", "decimal commas")


@pytest.mark.parametrize("header", ["Elapsed Time (s)", "Zeit [s]", "elapsed", "seconds"])
def test_common_names_of_times_are_found(table: Any, header: str) -> None:
    assert read(table(f"{header};q\n0.5;1\n1.5;2\n")).t.tolist() == [0.5, 1.5]


def test_microseconds_of_autopilots_become_seconds(table: Any) -> None:
    ardupilot = read(table("TimeUS,GyrX,AccZ\n81000250,0.1,-9\n81020250,0.2,-9\n"))
    assert ardupilot.t.tolist() == pytest.approx([81.00025, 81.02025]) and ardupilot.units["time"] == "s"
    path = table("timestamp,q\n4000000,1\n4004010,2\n4008000,3\n")
    px4 = read(path)
    assert px4.t.tolist() == pytest.approx([4.0, 4.00401, 4.008]) and px4.units["time"] == "s"
    assert px4.history == ("times 'timestamp' read as microseconds",)
    assert read(path, time="timestamp").t.tolist() == px4.t.tolist()
    assert read(path, units={"timestamp": "ms"}).t[0] == 4000.0
    since_1970 = read(table("timestamp,q\n1764412800000000,1\n1764412800010000,2\n"))
    assert np.diff(since_1970.t) == pytest.approx([0.01], rel=1e-3)
    # Another name for the times is preferred, and the stamps are a column then.
    both = read(table("time,timestamp,q\n0,4000000,1\n1,4004000,2\n"))
    assert both.t.tolist() == [0.0, 1.0] and "timestamp" in both.channels
    assert read(table("timestamp,TimeUS,q\n1.5,81000000,1\n1.6,81100000,2\n")).t[0] == 81.0


STAMPS = {
    "seconds": "0.5 0.6 0.7",
    "whole seconds": "1 2 3",
    "seconds since 1970": "1764412800 1764413800 1764414800",
    "milliseconds since 1970": "1764412800000 1764412801000 1764412802000",
    "nanoseconds": "4000000000 4004000000 4008000000",
}


@pytest.mark.parametrize("kind", STAMPS)
def test_stamps_without_a_known_unit_are_not_guessed(table: Any, kind: str) -> None:
    stamps = STAMPS[kind].split()
    path = table("timestamp,q\n" + "".join(f"{each},{k}\n" for k, each in enumerate(stamps)))
    assert has(refusal(path), "time 'timestamp'", "units={'timestamp': 's'}", "'ms', 'us', 'ns'")
    unit = "ms" if kind.startswith("milli") else "ns" if kind.startswith("nano") else "s"
    size = {"s": 1.0, "ms": 1e-3, "ns": 1e-9}[unit]
    expected = [float(each) * size for each in stamps]
    assert read(path, units={"timestamp": unit}).t.tolist() == pytest.approx(expected, rel=1e-15)
    assert read(path, time="timestamp").t.tolist() == [float(each) for each in stamps]  # as the user names it
    assert read(path, time_unit=unit).t.tolist() == [float(each) for each in stamps]


def test_error_names_the_column_that_may_hold_the_times(table: Any) -> None:
    assert has(refusal(table("q,Test time base,V\n0,0,1\n1,1,2\n")), "such as time='Test time base'")
    assert has(refusal(table("clock,q,V\n0,0,1\n1,1,2\n")), "such as time='clock'")


def test_label_against_the_unit_of_the_file_is_reported(table: Any) -> None:
    path = table("t,speed [rpm]\n0,60\n1,120\n")
    with pytest.warns(UserWarning, match=r"states the unit 'rpm'.*without converting.*\('rpm', 'rad/s'\)"):
        assert read(path, units={"speed": "rad/s"}).output("speed")[0] == 60
    assert read(path, units={"speed": ("rpm", "rad/s")}).output("speed")[0] == pytest.approx(2 * np.pi)
    assert read(path, units={"speed": ("rad/s", "rad/s")}).output("speed")[0] == 60


def test_rename_the_wrong_way_round_is_recognised(table: Any) -> None:
    message = refusal(table("t,Pitch\n0,1\n1,2\n"), rename={"q": "Pitch"})
    assert has(message, "there is no column 'q'", "rename is {column: name}: {'Pitch': 'q'}")


def test_gap_in_a_declared_input_is_refused(table: Any) -> None:
    message = refusal(table("t,de,q\n0,1,2\n1,,3\n"), inputs=["de"])
    assert has(message, "experiment 'run1', input 'de'", "sample 1 (t = 1)", "interpolate them, or cut")


def test_absent_file_names_its_neighbour(table: Any) -> None:
    path = table("t,q\n0,1\n1,2\n", "flight12.csv")
    assert has(refusal(path.with_name("fligth12.csv")), "no such file", "Did you mean 'flight12.csv'?")


def test_an_absent_record_is_not_another_record(table: Any) -> None:
    path = table("t,q\n0,1\n1,2\n", "flight12.csv")
    for name in ("flight13.csv", "flight12.py", "elsewhere/flight12.csv"):
        message = refusal(path.parent / name)
        assert has(message, "no such file", str(path.parent)) and "Did you mean" not in message


@pytest.mark.parametrize("header", ["Time (s)", "Time [s]", "time_s", "TIME"])
def test_a_column_called_time_needs_no_name(table: Any, header: str) -> None:
    path = table(f"{header},T,q\n0,5,1\n0.5,6,2\n")
    for named in (None, header, header.replace(" ", "")):
        e = read(path, time=named)
        assert e.t.tolist() == [0.0, 0.5] and list(e.channels) == ["T", "q"]
    assert has(refusal(table("T,q\n0,1\n1,2\n")), "no time column 't'")
    assert has(refusal(table("time,Time,q\n0,0,1\n1,1,2\n")), "no time column 't'")


@pytest.mark.parametrize(("text", "words"), [("", "is empty"), ("# c\n\n", "is empty"), ("t,q\n", "no rows")])
def test_file_without_data(table: Any, text: str, words: str) -> None:
    assert words in refusal(table(text))


def test_binary_file(tmp_path: Path) -> None:
    path = tmp_path / "a.xls"
    path.write_bytes(b"\xd0\xcf\x11\xe0\0\0\0")
    assert has(refusal(path), "a.xls: is not a text table", "pandas.read_excel", "ph.read")


def test_gzip_cut_short(tmp_path: Path) -> None:
    path = tmp_path / "a.csv.gz"
    path.write_bytes(gzip.compress(b"t,q\n0,1\n1,2\n")[:-6])
    assert has(refusal(path), "gzip", "cut short")


def test_real_flight_record(published: Callable[[str], Path]) -> None:
    path = published("hfb320_1_10.asc")
    motion = ["V", "alpha", "theta", "q", "qdot", "ax", "az"]
    rest = ["ay", "p", "r", "pdot", "rdot", "beta", "phi", "da", "dr"]
    e = read(path, columns=["t", "de", "qbar", "T", *motion, *rest])
    assert (e.n, round(float(e.t[-1]), 3), len(e.channels)) == (601, 60.0, 19)
    e.check_for(["de", "T"], motion)


PAYLOAD: dict[str, Any] = {
    "model": {"name": "größe", "order": 4, "unstable": True, "prior": None},
    "values": [0.1, 1 / 3, 5e-324, -1.7976931348623157e308],
}


def test_saved_payload_comes_back(tmp_path: Path) -> None:
    path = tmp_path / "fit.json"
    io.save_fit_dict(path, PAYLOAD)
    assert io.load_fit_dict(path) == (PAYLOAD, io.VERSION)
    assert json.loads(path.read_text(encoding="utf-8"))["format"] == "phugoid-fit"


def test_arrays_keep_every_bit_and_nan_and_infinity() -> None:
    x = np.random.default_rng(0).standard_normal((3, 4))
    x[1, 2], x[0, 0], x[2, 3] = NAN, math.inf, -math.inf
    text = io.to_json({"x": x, "n": np.int64(3), "s": np.float64(NAN), "bounds": (-math.inf, 1.0)})
    back, _ = io.from_json(text)
    np.testing.assert_array_equal(io.to_array(back["x"]), x)
    assert back["x"][1][2] is None and back["n"] == 3 and back["s"] is None
    assert math.isnan(io.to_float(back["s"]))
    assert [io.to_float(b) for b in back["bounds"]] == [-math.inf, 1.0]


def test_text_cut_short_is_refused() -> None:
    text = io.to_json(PAYLOAD)
    for end in (0, 1, len(text) // 2, len(text) - 1):
        with pytest.raises(DataError, match=r"fit\.json: .*(cut short)"):
            io.from_json(text[:end], source="fit.json")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"a": 1}', "not a fit saved by phugoid"),
        ("[1, 2]", "not a fit saved by phugoid"),
        ('{"format": "phugoid-fit", "version": 99}', "install a newer phugoid"),
        ('{"format": "phugoid-fit"}', "version None"),
    ],
)
def test_other_formats_and_versions_are_refused(text: str, words: str) -> None:
    with pytest.raises(DataError, match=words):
        io.from_json(text)


def test_what_json_cannot_hold_is_named_by_its_place() -> None:
    with pytest.raises(DataError, match=r"'a\.b\[1\]': a complex"):
        io.to_json({"a": {"b": [1, 2j]}})


def test_failed_save_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "fit.json"
    io.save_fit_dict(path, {"generation": 1})

    def full_disk(fd: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full_disk)
    with pytest.raises(DataError, match="No space left"):
        io.save_fit_dict(path, {"generation": 2})
    assert io.load_fit_dict(path) == ({"generation": 1}, io.VERSION)
    assert [p.name for p in tmp_path.iterdir()] == ["fit.json"]


def test_save_into_an_absent_folder(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="there is no folder"):
        io.save_fit_dict(tmp_path / "no" / "fit.json", {})


def test_load_of_an_absent_file(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no such file"):
        io.load_fit_dict(tmp_path / "fit.json")
