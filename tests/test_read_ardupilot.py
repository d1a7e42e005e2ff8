"""read: ArduPilot's logs (.bin), whole and damaged."""

from __future__ import annotations

import struct
import sys
from pathlib import Path

import numpy as np
import pytest

from phugoid.data.read import read
from phugoid.errors import DataError, MissingDependency

pytest.importorskip("pymavlink.DFReader")

HEAD = b"\xa3\x95"


def fmt(number: int, length: int, name: bytes, form: bytes, columns: bytes) -> bytes:
    return HEAD + b"\x80" + struct.pack("<BB4s16s64s", number, length, name, form, columns)


def log() -> bytes:
    """IMU of two instances at 50 Hz, with units, and RCOU at 10 Hz."""
    raw = fmt(128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")
    raw += fmt(130, 44, b"FMTU", b"QBNN", b"TimeUS,FmtType,UnitIds,MultIds")
    raw += fmt(131, 76, b"UNIT", b"QbZ", b"TimeUS,Id,Label")
    raw += fmt(129, 16, b"IMU", b"QBf", b"TimeUS,I,GyrX")
    raw += fmt(132, 13, b"RCOU", b"QH", b"TimeUS,C1")
    raw += HEAD + bytes([131]) + struct.pack("<Qb64s", 0, ord("k"), b"deg/s")
    raw += HEAD + bytes([130]) + struct.pack("<QB16s16s", 0, 129, b"s#k", b"F--")
    for k in range(51):
        for instance in (0, 1):
            raw += HEAD + bytes([129]) + struct.pack("<QBf", 1_000_000 + 20_000 * k, instance, 10 * instance + k)
        if k % 5 == 0:
            raw += HEAD + bytes([132]) + struct.pack("<QH", 1_000_000 + 20_000 * k, 1500 + k)
    return raw


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "7.bin"
    file.write_bytes(log())
    return file


def test_channels_keep_their_rates_and_units(path: Path) -> None:
    e = read(path, inputs=["da"], outputs=["p", "IMU[1].GyrX"], rename={"RCOU.C1": "da", "IMU.GyrX": "p"}, convert=True)
    np.testing.assert_allclose(e.t, 1.0 + 0.02 * np.arange(51))
    np.testing.assert_allclose(e.outputs["p"], np.deg2rad(np.arange(51)))
    np.testing.assert_allclose(e.outputs["IMU[1].GyrX"], np.deg2rad(10.0 + np.arange(51)))
    np.testing.assert_allclose(e.samples("da")[1], 1500.0 + np.arange(0, 51, 5))
    assert e.units["p"] == "rad/s"


def test_absent_field_names_its_neighbour(path: Path) -> None:
    with pytest.raises(DataError, match=r"7\.bin: has no column 'IMU.GyroX'.*Did you mean 'IMU.GyrX'"):
        read(path, inputs=[], outputs=["IMU.GyroX"])


@pytest.mark.parametrize("size", [0, 2, 89, 300])
def test_damaged(path: Path, size: int, capfd: pytest.CaptureFixture[str]) -> None:
    path.write_bytes(log()[:size])
    with pytest.raises(DataError, match=r"7\.bin: .*damaged or cut short"):
        read(path)
    assert capfd.readouterr() == ("", "")


def test_other_bytes(path: Path) -> None:
    path.write_bytes(b"t,q\n0,1\n" * 200)
    with pytest.raises(DataError, match=r"7\.bin: is not a log of ArduPilot"):
        read(path)


def test_missing_package_names_the_command(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pymavlink.DFReader", None)
    with pytest.raises(MissingDependency, match=r'needs pymavlink .*pip install "phugoid\[ardupilot\]"'):
        read(path)
