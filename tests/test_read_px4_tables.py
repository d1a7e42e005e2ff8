"""read: the CSV tables of a PX4 log, each at its own rate."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from phugoid.data.read import read
from phugoid.errors import DataError


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    gyro = [f"{1_000_000 + 20_000 * k},{999_000 + 20_000 * k},{0.1 * k}" for k in range(11)]
    servo = [f"{990_000 + 50_000 * k},{k}" for k in range(6)]
    header = "timestamp,timestamp_sample,xyz[0]"
    (tmp_path / "log_7_vehicle_gyro_0.csv").write_text("\n".join([header, *gyro]))
    (tmp_path / "log_7_vehicle_gyro_1.csv").write_text("\n".join([header, *gyro[::2]]))
    text = "\n".join(["timestamp,control[0]", *servo])
    (tmp_path / "log_7_vehicle_servo_0.csv.gz").write_bytes(gzip.compress(text.encode()))
    return tmp_path


@pytest.mark.parametrize("prefix", ["", "log_7", "log_7_"])
def test_channels_keep_their_rates(folder: Path, prefix: str) -> None:
    e = read(folder / prefix, inputs=["de"], outputs=["vehicle_gyro.xyz[0]"], rename={"vehicle_servo.control[0]": "de"})
    np.testing.assert_allclose(e.samples("de")[0], 0.99 + 0.05 * np.arange(6))
    np.testing.assert_allclose(e.t, 1.0 + 0.02 * np.arange(11))
    np.testing.assert_allclose(e.outputs["vehicle_gyro.xyz[0]"], 0.1 * np.arange(11))


def test_other_stamps_and_instances(folder: Path) -> None:
    e = read(folder, inputs=[], outputs=["vehicle_gyro[1].xyz[0]"], time="timestamp_sample", name="climb")
    assert e.name == "climb"
    np.testing.assert_allclose(e.t, 0.999 + 0.04 * np.arange(6))


def test_window_leaves_the_inputs_to_its_ends(folder: Path) -> None:
    names = {"inputs": ["vehicle_servo.control[0]"], "outputs": ["vehicle_gyro.xyz[0]"]}
    e = read(folder, window=(1.05, 1.15), **names)
    np.testing.assert_allclose(e.t, [1.06, 1.08, 1.10, 1.12, 1.14])
    assert e.samples("vehicle_servo.control[0]")[0].size == 4
    with pytest.raises(DataError, match=r"no sample of 'vehicle_servo.control\[0\]' lies in the window 5 to 6;"):
        read(folder, window=(5.0, 6.0), **names)


def test_names_must_be_given(folder: Path) -> None:
    with pytest.raises(DataError, match=r"times of their own .*inputs=.*There are: vehicle_gyro\.timestamp_sample"):
        read(folder)
    with pytest.raises(DataError, match=r"no column 'vehicle_giro.xyz\[0\]'.*Did you mean 'vehicle_gyro.xyz\[0\]'"):
        read(folder, inputs=[], outputs=["vehicle_giro.xyz[0]"])


def test_damaged_tables(folder: Path) -> None:
    table = folder / "log_7_vehicle_servo_0.csv.gz"
    table.write_bytes(table.read_bytes()[:-12])
    with pytest.raises(DataError, match=r"vehicle_servo_0\.csv\.gz: .*(cut short|damaged)"):
        read(folder, inputs=[], outputs=["vehicle_servo.control[0]"])
    (folder / "log_7_vehicle_gyro_0.csv").write_text("a,b\n1,2\n")
    with pytest.raises(DataError, match=r"vehicle_gyro_0\.csv: .*no 'timestamp'"):
        read(folder)


def test_folder_without_tables(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="is a folder without tables of a PX4 log"):
        read(tmp_path)
    with pytest.raises(DataError, match="no such file"):
        read(tmp_path / "log_8")


def test_solar_aircraft(published: Callable[[str], Path]) -> None:
    path = published("solar_uav_px4")
    e = read(
        path,
        inputs=["de"],
        outputs=["q", "V"],
        rename={
            "actuator_controls_0.control[1]": "de",
            "vehicle_angular_velocity.xyz[1]": "q",
            "airspeed_validated.true_airspeed_m_s": "V",
        },
        window=(600.0, 700.0),
    )
    present = {n: int(np.isfinite(v).sum()) for n, v in e.outputs.items()}
    assert 4900 < present["q"] < 5100 and 480 < present["V"] < 520
    assert 1900 < e.samples("de")[0].size < 2100
