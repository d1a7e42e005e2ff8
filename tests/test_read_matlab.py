"""read: MATLAB files of each version, and what is wrong with one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

from phugoid.data.read import read
from phugoid.errors import DataError

T = np.arange(5) * 0.1


def saved(tmp_path: Path, content: dict[str, Any], **options: Any) -> Path:
    path = tmp_path / "run1.mat"
    savemat(path, content, **options)
    return path


@pytest.mark.parametrize("version", ["4", "5"])
def test_variables_are_columns(tmp_path: Path, version: str) -> None:
    e = read(saved(tmp_path, {"t": T, "de": T**2, "q": -T, "mass": 7.5}, format=version))
    assert (e.name, list(e.channels)) == ("run1", ["de", "q"])
    np.testing.assert_allclose(e.t, T)
    np.testing.assert_allclose(e.output("q"), -T)


def test_one_structure_is_not_named(tmp_path: Path) -> None:
    e = read(saved(tmp_path, {"data": {"T": T, "q": T, "note": "calm"}}), time="T", rename={"q": "rate"})
    assert list(e.channels) == ["rate"]


@pytest.mark.parametrize("group", ["", "fdr."])
def test_one_structure_may_be_named(group: str, tmp_path: Path) -> None:
    path = saved(tmp_path, {"fdr": {"clock": 1000 * T, "ELEV": T, "q": T, "air": {"V": 1 + T}}})
    e = read(
        path,
        time=f"{group}clock",
        inputs=[f"{group}ELEV"],
        outputs=["rate", f"{group}air.V"],
        rename={f"{group}ELEV": "de", f"{group}q": "rate"},
        units={f"{group}clock": "ms", f"{group}ELEV": ("deg", "rad"), "rate": "rad/s"},
        interpolation={f"{group}ELEV": "hold"},
    )
    assert (list(e.inputs), list(e.outputs)) == (["de"], ["rate", "air.V"])
    np.testing.assert_allclose(e.t, T)
    np.testing.assert_allclose(e.input("de"), np.deg2rad(T))
    assert (e.units["de"], e.units["rate"]) == ("rad", "rad/s") and e.interpolation_of("de") == "hold"
    whole = read(path, time=f"{group}clock", rename={f"{group}q": "rate"})
    assert list(whole.channels) == ["ELEV", "rate", "air.V"]
    with pytest.raises(DataError, match=r"no column 'p'.*outputs=.*There are: .*ELEV"):
        read(path, time=f"{group}clock", inputs=[], outputs=[f"{group}p"])


def test_structures_have_times_of_their_own(tmp_path: Path) -> None:
    slow = np.array([0.0, 0.2, 0.4])
    path = saved(tmp_path, {"imu": {"time": T, "q": T}, "air": {"time": slow, "alpha": 1 + slow}})
    e = read(path, inputs=[], outputs=["imu.q", "air.alpha"])
    np.testing.assert_allclose(e.output("imu.q"), T)
    np.testing.assert_allclose(e.output("air.alpha"), [1.0, np.nan, 1.2, np.nan, 1.4])
    with pytest.raises(DataError, match=r"times of their own.*air\.time, imu\.time.*outputs="):
        read(path)


def test_matrix_has_a_channel_a_column(tmp_path: Path) -> None:
    xyz = np.arange(15.0).reshape(5, 3)
    e = read(saved(tmp_path, {"t": T, "gyro": xyz, "across": xyz.T}))
    assert list(e.channels)[:3] == ["gyro[0]", "gyro[1]", "gyro[2]"]
    np.testing.assert_array_equal(e.output("gyro[1]"), xyz[:, 1])
    np.testing.assert_array_equal(e.output("across[2]"), xyz[:, 2])


def test_columns_name_those_of_the_one_matrix(tmp_path: Path) -> None:
    path = saved(tmp_path, {"run": np.column_stack([T, T**2])})
    np.testing.assert_allclose(read(path, columns=["t", "q"]).output("q"), T**2)
    with pytest.raises(DataError, match=r"columns=\[...\] names 3.*'run' \(5 x 2\)"):
        read(path, columns=["t", "q", "r"])


def test_channel_of_another_length_says_so(tmp_path: Path) -> None:
    path = saved(tmp_path, {"t": T, "q": T, "r": T[:4], "mass": 2.0})
    assert list(read(path).channels) == ["q"]
    with pytest.raises(DataError, match=r"'r' \(outputs=...\) has 4 values, but its times 't' 5"):
        read(path, outputs=["r"])
    with pytest.raises(DataError, match=r"'mass' \(inputs=...\) is a single value"):
        read(path, inputs=["mass"])


def test_version_7_3(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "new.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        file["t"] = T[None, :]
        file["gyro"] = np.arange(10.0).reshape(2, 5)  # 5 x 2 in MATLAB
        file["note"] = np.array([[104], [105]], dtype=np.uint16)
        file["note"].attrs["MATLAB_class"] = np.bytes_("char")
        file["#refs#/a"] = T
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    e = read(path)
    assert list(e.channels) == ["gyro[0]", "gyro[1]"]
    np.testing.assert_array_equal(e.output("gyro[1]"), [5, 6, 7, 8, 9])


@pytest.mark.parametrize("size", [0, 20, 200, 400])
def test_damaged(tmp_path: Path, size: int) -> None:
    path = saved(tmp_path, {"t": np.arange(100.0), "q": np.arange(100.0)})
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(DataError, match=r"run1\.mat: (is not a MATLAB file, or is damaged|has no arrays)"):
        read(path)


def test_tags_that_end_scipys_loader_are_found_before(tmp_path: Path) -> None:
    path = saved(tmp_path, {"t": T, "q": T})
    whole = path.read_bytes()
    for place, byte in ((145, 0x9F), (176, 59)):  # a complex array without its imaginary part; a type there is not
        path.write_bytes(whole[:place] + bytes([byte]) + whole[place + 1 :])
        with pytest.raises(DataError, match=r"run1\.mat: .* damaged .*do not fit together"):
            read(path)


def test_attas(published: Callable[[str], Path]) -> None:
    path = published("fAttasElv1.mat")
    names = ["t", *(f"c{k}" for k in range(1, 45))]
    names[8], names[23] = "q", "de"
    e = read(path, columns=names, inputs=["de"], outputs=["q"], units={"q": ("deg/s", "rad/s"), "de": ("deg", "rad")})
    assert (e.n, dict(e.units)) == (626, {"q": "rad/s", "de": "rad"})
    assert 0.02 < np.abs(e.outputs["q"]).max() < 0.5
