"""read: PX4 logs (ULog), whole and damaged."""

from __future__ import annotations

import struct
import sys
from pathlib import Path

import numpy as np
import pytest

from phugoid.data.read import read
from phugoid.errors import DataError, MissingDependency

pytest.importorskip("pyulog")


def message(kind: bytes, body: bytes) -> bytes:
    return struct.pack("<Hc", len(body), kind) + body


def log() -> bytes:
    """Two topics, of which the gyro has two instances, at 50 and 20 Hz."""
    raw = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)
    raw += message(b"B", bytes(40))
    raw += message(b"F", b"gyro:uint64_t timestamp;uint64_t timestamp_sample;float[2] xyz;")
    raw += message(b"F", b"servo:uint64_t timestamp;float control;")
    for number, (instance, topic) in enumerate([(0, b"gyro"), (1, b"gyro"), (0, b"servo")]):
        raw += message(b"A", struct.pack("<BH", instance, number) + topic)
    for k in range(51):
        for number in (0, 1):
            t = 1_000_000 + 20_000 * k
            raw += message(b"D", struct.pack("<HQQff", number, t, t - 3000, 0.1 * k, number + k))
        if k < 21:
            raw += message(b"D", struct.pack("<HQf", 2, 1_000_000 + 50_000 * k, k))
    return raw


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "flight.ulg"
    file.write_bytes(log())
    return file


def test_channels_keep_their_rates(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    e = read(path, inputs=["de"], outputs=["gyro.xyz[0]", "gyro[1].xyz[1]"], rename={"servo.control": "de"})
    assert e.name == "flight"
    np.testing.assert_allclose(e.t, 1.0 + 0.02 * np.arange(51))
    np.testing.assert_allclose(e.outputs["gyro.xyz[0]"], 0.1 * np.arange(51), rtol=1e-6)
    np.testing.assert_allclose(e.outputs["gyro[1].xyz[1]"], 1.0 + np.arange(51))
    np.testing.assert_allclose(e.samples("de")[0], 1.0 + 0.05 * np.arange(21))
    assert capsys.readouterr().out == ""


def test_other_stamps(path: Path) -> None:
    assert read(path, inputs=[], outputs=["gyro.xyz[0]"], time="timestamp_sample").t[0] == pytest.approx(0.997)


def test_absent_field_names_its_neighbour(path: Path) -> None:
    with pytest.raises(DataError, match=r"flight\.ulg: has no column 'giro.xyz\[0\]'.*Did you mean 'gyro.xyz\[0\]'"):
        read(path, inputs=[], outputs=["giro.xyz[0]"])


@pytest.mark.parametrize("size", [0, 8, 16, 150])
def test_damaged(path: Path, size: int) -> None:
    path.write_bytes(log()[:size])
    with pytest.raises(DataError, match=r"flight\.ulg: .*damaged or cut short"):
        read(path)


def test_other_bytes(path: Path) -> None:
    path.write_bytes(b"t,q\n0,1\n" * 20)
    with pytest.raises(DataError, match=r"flight\.ulg: is not a PX4 log .*Failed to parse header"):
        read(path)


def test_log_that_ends_early_is_read_as_far_as_it_goes(path: Path) -> None:
    path.write_bytes(log()[:-500])
    assert 20 < read(path, inputs=[], outputs=["gyro.xyz[0]"]).n < 51


def test_damage_within_is_told(path: Path) -> None:
    raw = log()
    path.write_bytes(raw[:800] + b"\x00\xff" * 150 + raw[800:])
    with pytest.warns(UserWarning, match=r"flight\.ulg: parts of the log are damaged"):
        read(path, inputs=[], outputs=["gyro.xyz[0]"])


def test_missing_package_names_the_command(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyulog.core", None)
    with pytest.raises(MissingDependency, match=r'needs pyulog .*pip install "phugoid\[px4\]"'):
        read(path)
