"""read: HDF5 files, their groups and attributes, and damaged ones."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from phugoid.data.read import read
from phugoid.errors import DataError, MissingDependency

T = np.arange(5) * 0.1


@pytest.fixture
def path(tmp_path: Path) -> Path:
    h5py = pytest.importorskip("h5py")
    file = tmp_path / "run1.h5"
    with h5py.File(file, "w") as f:
        f["t"] = T
        f["alpha"] = np.arange(5.0)
        f["alpha"].attrs["units"] = "deg"
        f["air/t"] = T[::2]
        f["air/V"] = 10 * T[::2]
        f["crew"] = "two"
    return file


def test_groups_keep_their_times(path: Path) -> None:
    e = read(path, inputs=["alpha"], outputs=["air.V"], convert=True)
    np.testing.assert_allclose(e.t, [0.0, 0.2, 0.4])
    np.testing.assert_allclose(e.outputs["air.V"], [0.0, 2.0, 4.0])
    times, values = e.samples("alpha")
    np.testing.assert_allclose(times, T)
    np.testing.assert_allclose(values, np.deg2rad(np.arange(5.0)))
    assert e.units["alpha"] == "rad"


def test_one_group_needs_no_more(path: Path) -> None:
    e = read(path, inputs=[], outputs=["alpha"])
    assert (e.n, dict(e.units)) == (5, {"alpha": "deg"})


def test_text_is_no_channel(path: Path) -> None:
    with pytest.raises(DataError, match=r"'crew' \(outputs=...\) holds no numbers"):
        read(path, inputs=[], outputs=["crew"])


def test_compound_dataset_has_a_column_a_field(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    table = np.zeros(4, dtype=[("t", "f8"), ("q", "f4"), ("mode", "S4")])
    table["t"], table["q"] = np.arange(4), [3, 2, 1, 0]
    with h5py.File(tmp_path / "a.hdf5", "w") as f:
        f["log"] = table
    np.testing.assert_array_equal(read(tmp_path / "a.hdf5").output("q"), [3, 2, 1, 0])


@pytest.mark.parametrize("size", [0, 100, 1000])
def test_damaged(path: Path, size: int) -> None:
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(DataError, match=r"run1\.h5: is not an HDF5 file, or is damaged or cut short"):
        read(path)


def test_missing_package_names_the_command(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(MissingDependency, match=r'needs h5py .*pip install "phugoid\[hdf5\]"'):
        read(path)
