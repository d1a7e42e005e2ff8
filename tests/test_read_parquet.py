"""read: Parquet files, as pandas and polars write them, and damaged ones."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from phugoid.data.read import read
from phugoid.errors import DataError, MissingDependency

T = np.arange(4) * 0.5


@pytest.fixture
def path(tmp_path: Path) -> Path:
    pa, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    fields = [pa.field("t", pa.float64()), pa.field("V", pa.float32(), metadata={"unit": "kt"})]
    schema = pa.schema([*fields, pa.field("alpha [deg]", pa.float64()), pa.field("mode", pa.string())])
    table = pa.table([T, T.astype("f4"), [0.0, None, 180.0, 90.0], list("abab")], schema=schema)
    parquet.write_table(table, tmp_path / "run1.parquet")
    return tmp_path / "run1.parquet"


def test_columns_and_units(path: Path) -> None:
    e = read(path, inputs=["V"], outputs=["alpha"], convert=True)
    assert (e.name, dict(e.units)) == ("run1", {"V": "m/s", "alpha": "rad"})
    np.testing.assert_allclose(e.outputs["alpha"], [0.0, np.nan, np.pi, np.pi / 2])
    with pytest.raises(DataError, match=r"column 'mode': .*leave it out"):
        read(path)


@pytest.mark.parametrize("name", [None, "t", "time"])
def test_index_of_pandas(tmp_path: Path, name: str | None) -> None:
    pytest.importorskip("pyarrow")
    pandas = pytest.importorskip("pandas")
    pandas.DataFrame({"q": T}, index=pandas.Index(T, name=name)).to_parquet(tmp_path / "a.pq")
    e = read(tmp_path / "a.pq", time=name)
    assert list(e.channels) == ["q"]
    np.testing.assert_array_equal(e.t, T)


@pytest.mark.parametrize("size", [0, 3, 300])
def test_damaged(path: Path, size: int) -> None:
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(DataError, match=r"run1\.parquet: is not a Parquet file, or is damaged or cut short"):
        read(path)


def test_damaged_within(path: Path) -> None:
    raw = bytearray(path.read_bytes())
    raw[4:60] = b"\xff" * 56
    path.write_bytes(raw)
    with pytest.raises(DataError, match=r"run1\.parquet.*damaged"):
        read(path, inputs=[], outputs=["V"])


def test_missing_package_names_the_command(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    with pytest.raises(MissingDependency, match=r'needs pyarrow .*pip install "phugoid\[parquet\]"'):
        read(path)
