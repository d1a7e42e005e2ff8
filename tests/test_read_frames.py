"""read: tables of pandas, polars and xarray in place of a file."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from phugoid.data.read import read
from phugoid.errors import DataError

T = np.arange(4) * 0.5
COLUMNS = {"t": T, "alpha [deg]": [0.0, 90.0, 180.0, 0.0], "mode": ["a", "b", "a", "b"]}


@pytest.mark.parametrize("package", ["pandas", "polars"])
def test_columns_with_units(package: str) -> None:
    frame = pytest.importorskip(package).DataFrame(COLUMNS)
    e = read(frame, inputs=[], outputs=["alpha"], convert=True, name="run1", window=(0.5, 1.5))
    assert (e.name, dict(e.units)) == ("run1", {"alpha": "rad"})
    np.testing.assert_allclose(e.outputs["alpha"], [np.pi / 2, np.pi, 0.0])
    assert "mode" not in read(frame).channels
    with pytest.raises(DataError, match=r"no column 'alfa'.*Did you mean 'alpha'"):
        read(frame, outputs=["alfa"])


def test_missing_samples_of_pandas_and_polars() -> None:
    pandas, polars = pytest.importorskip("pandas"), pytest.importorskip("polars")
    for frame in (
        pandas.DataFrame({"t": T, "n": pandas.array([1, None, 3, 4], dtype="Int64")}),
        polars.DataFrame({"t": T, "n": [1, None, 3, 4]}),
        polars.LazyFrame({"t": T, "n": [1, None, 3, 4]}),
    ):
        np.testing.assert_array_equal(read(frame).output("n"), [1.0, np.nan, 3.0, 4.0])


def index(pandas: Any, kind: str) -> Any:
    return {
        "named": pandas.Index(T, name="seconds"),
        "unnamed": pandas.Index(T),
        "dates": pandas.Timestamp("2026-01-01") + pandas.to_timedelta(T, unit="s"),
        "differences": pandas.to_timedelta(T, unit="s"),
    }[kind]


@pytest.mark.parametrize("kind", ["named", "unnamed", "dates", "differences"])
def test_index_is_the_time(kind: str) -> None:
    pandas = pytest.importorskip("pandas")
    e = read(pandas.DataFrame({"q": T**2}, index=index(pandas, kind)))
    np.testing.assert_allclose(e.t, T)
    assert list(e.channels) == ["q"]


def test_a_count_is_no_time() -> None:
    frame = pytest.importorskip("pandas").DataFrame({"T": T, "q": T})
    with pytest.raises(DataError, match=r"the DataFrame: has no time column 't'.*Did you mean 'T'"):
        read(frame)
    assert read(frame, time="T").n == 4
    assert read(frame[["q"]], rate=2.0).t[-1] == 1.5


@pytest.mark.parametrize("name", [None, "id"])
def test_row_numbers_are_no_times_once_rows_are_dropped(name: str | None) -> None:
    frame = pytest.importorskip("pandas").DataFrame({"time": T, "q": T**2}).drop(index=1).rename_axis(name)
    e = read(frame)
    assert e.t.tolist() == [T[0], *T[2:]] and "time" not in e.channels
    if name is None:
        with pytest.raises(DataError, match="the DataFrame: has no time column 't'"):
            read(frame[["q"]])
        assert read(frame[["q"]], rate=2.0).n == T.size - 1


def test_polars_dates() -> None:
    polars = pytest.importorskip("polars")
    t = np.datetime64("2026-01-01", "us") + (T * 1e6).astype("timedelta64[us]")
    np.testing.assert_allclose(read(polars.DataFrame({"t": t, "q": T})).t, T)


def test_dataset_of_xarray() -> None:
    xarray = pytest.importorskip("xarray")
    data = xarray.Dataset(
        {"q": ("time", T, {"units": "deg/s"}), "acc": (("axis", "time"), [T, 2 * T]), "mass": 3.0},
        coords={"time": T, "axis": ["x", "z"]},
    )
    e = read(data, inputs=["q"], outputs=["acc[1]"], convert=True)
    np.testing.assert_allclose(e.inputs["q"], np.deg2rad(T))
    np.testing.assert_allclose(e.outputs["acc[1]"], 2 * T)
    with pytest.raises(DataError, match=r"'mass' \(outputs=...\) is a single value"):
        read(data, inputs=[], outputs=["mass"])
    np.testing.assert_allclose(read(data["q"], inputs=[], outputs=["q"]).t, T)


def test_each_dimension_of_xarray_is_a_clock() -> None:
    xarray = pytest.importorskip("xarray")
    data = xarray.Dataset({"q": ("fast", T), "V": ("slow", T[::3])}, coords={"fast": T, "slow": T[::3]})
    e = read(data, inputs=["V"], outputs=["q"])
    assert (e.n, e.samples("V")[0].size) == (4, 2)


def test_something_else() -> None:
    with pytest.raises(DataError, match=r"give the path of a file, or a table of pandas, polars or xarray, not \[1, 2"):
        read([1, 2])


@pytest.mark.parametrize("package", ["pandas", "polars"])
def test_columns_of_words_are_left_out(package: str) -> None:
    frames: Any = pytest.importorskip(package)
    table = frames.DataFrame({"t": [0.0, 1.0, 2.0], "q [deg/s]": [1.0, 2.0, 3.0], "remark": ["ok", "ok", None]})
    run = read(table)
    assert list(run.channels) == ["q"]
    with pytest.raises(DataError, match=r"'remark' \(inputs=...\) holds text \('ok'\)"):
        read(table, inputs=["remark"], outputs=["q"])
    mixed = frames.DataFrame({"t": [0.0, 1.0], "q": ["1.5", "stuck"]})
    with pytest.raises(DataError, match="column 'q'"):
        read(mixed)
