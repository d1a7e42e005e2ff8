"""read: units become what the user asks for, at the door."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import phugoid as ph
from phugoid.data.read import read
from phugoid.data.units import convert, si
from phugoid.errors import DataError

ONE = np.array([1.0])


@pytest.mark.parametrize(
    ("unit", "into", "factor"),
    [
        ("deg", "rad", math.pi / 180),
        ("DEG/S", "rad/s", math.pi / 180),
        ("°/s", "rad/s", math.pi / 180),
        ("deg/s^2", "rad/s^2", math.pi / 180),
        ("deg/s²", "rad/s^2", math.pi / 180),
        ("ft", "m", 0.3048),
        ("ft/s**2", "m/s^2", 0.3048),
        ("ft/min", "m/s", 0.00508),
        ("kt", "m/s", 0.514444444),
        ("KTS", "m/s", 0.514444444),
        ("km/h", "m/s", 1 / 3.6),
        ("g", "m/s^2", 9.80665),
        ("m/s/s", "m/s^2", 1.0),
        ("m s^-2", "m/s^2", 1.0),
        ("hPa", "Pa", 100.0),
        ("psf", "Pa", 47.880259),
        ("inHg", "Pa", 3386.389),
        ("slug", "kg", 14.593903),
        ("slug/ft^3", "kg/m^3", 515.378818),
        ("slug*ft^2", "kg*m^2", 1.355817948),
        ("lbf", "N", 4.4482216),
        ("ms", "s", 1e-3),
        ("µs", "s", 1e-6),
        ("rpm", "rad/s", math.pi / 30),
        ("%", "", 0.01),
    ],
)
def test_to_si_and_back(unit: str, into: str, factor: float) -> None:
    np.testing.assert_allclose(convert(ONE, unit, into, "x"), factor, rtol=1e-8)
    np.testing.assert_allclose(convert(factor * ONE, into, unit, "x"), 1.0, rtol=1e-8)
    name = si(unit)
    assert name is not None
    np.testing.assert_allclose(convert(ONE, unit, name, "x"), factor, rtol=1e-8)


def test_temperatures_have_a_zero() -> None:
    np.testing.assert_allclose(convert(15.0 * ONE, "degC", "K", "x"), 288.15)
    np.testing.assert_allclose(convert(59.0 * ONE, "degF", "degC", "x"), 15.0)


@pytest.mark.parametrize("unit", ["furlong", "KN", "deg/", "2x", "m/kt"])
def test_unknown_units_are_not_guessed(unit: str) -> None:
    assert si(unit) is None


def test_units_of_another_kind_are_refused() -> None:
    with pytest.raises(DataError, match=r"x: 'deg' cannot become 'm'"):
        convert(ONE, "deg", "m", "x")
    with pytest.raises(DataError, match=r"'N' cannot become 'Pa'"):
        convert(ONE, "N", "Pa", "x")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "a.csv"
    file.write_text("t [ms],alpha [deg],V [kt],n [furlong]\n0,90,1,1\n100,180,2,1\n")
    return file


def test_header_units_become_si(path: Path) -> None:
    e = read(path, inputs=[], outputs=["alpha", "V"], convert=True)
    np.testing.assert_allclose(e.t, [0.0, 0.1])
    np.testing.assert_allclose(e.outputs["alpha"], [math.pi / 2, math.pi])
    assert dict(e.units) == {"alpha": "rad", "V": "m/s", "time": "s"}
    assert e.history == ("converted alpha from deg to rad, V from kt to m/s",)


def test_one_channel_alone(path: Path) -> None:
    e = read(path, units={"alpha": ("deg", "rad")}, rename={"V [kt]": "v"})
    np.testing.assert_allclose(e.output("alpha"), [math.pi / 2, math.pi])
    np.testing.assert_array_equal(e.output("v"), [1.0, 2.0])
    assert dict(e.units) == {"alpha": "rad", "v": "kt", "n": "furlong", "time": "s"}


def test_milliseconds_are_never_taken_for_seconds(path: Path) -> None:
    np.testing.assert_allclose(read(path).t, [0.0, 0.1])


def test_unknown_unit_names_its_column(path: Path) -> None:
    with pytest.raises(DataError, match=r"column 'n'.*'furlong' is not known.*units=\{'n'"):
        read(path, convert=True)
    with pytest.raises(DataError, match=r"column 'alpha': 'deg' cannot become 'kt'"):
        read(path, units={"alpha": ("deg", "kt")})
    with pytest.raises(DataError, match=r"units: give 'alpha' its unit, or \(from, to\)"):
        read(path, units={"alpha": ("deg", "rad", "grad")})  # type: ignore[dict-item]


@pytest.mark.parametrize(("name", "factor"), [("t_us", 1e6), ("time_ms", 1e3), ("Timestamp_ns", 1e9), ("t_s", 1.0)])
def test_a_unit_in_the_name_of_the_time_column_counts(tmp_path: Path, name: str, factor: float) -> None:
    file = tmp_path / "run.csv"
    rows = "\n".join(f"{round(0.05 * k * factor, 2)},{k}" for k in range(5))
    file.write_text(f"{name},q\n{rows}\n", encoding="utf-8")
    assert read(file, time=name).t == pytest.approx(0.05 * np.arange(5))
    # A unit that is given goes before.
    assert read(file, time=name, units={name: "s"}).t[1] == pytest.approx(0.05 * factor)


def test_a_rate_per_minute_is_not_taken_for_an_angular_rate(tmp_path: Path) -> None:
    file = tmp_path / "motor.csv"
    file.write_text("t [min],n [1/min],T [degC]\n0,60,20\n1,120,21\n2,60,22\n")
    run = read(file, convert=True)
    assert run.units["n"] == "Hz" and run.channels["n"][0] == pytest.approx(1.0)
    m = ph.Model("motor")
    (n,) = m.states(n="rad/s")
    (k,) = m.parameters("k")
    m.dynamics(n=-k * n)
    m.outputs(n=n)
    with pytest.raises(DataError, match=r"if it counts revolutions, give units=\{'n': \('rpm', 'rad/s'\)\}"):
        ph.estimate(m, run)
    assert read(file, units={"n": ("rpm", "rad/s")}).channels["n"][0] == pytest.approx(2.0 * math.pi)


def test_columns_are_converted_to_the_units_of_a_model(tmp_path: Path) -> None:
    file = tmp_path / "house.csv"
    file.write_text("t [min],power [W],T [degC],n [1/min],x [ft]\n0,500,20,3,1\n1,700,21,3,1\n")
    m = ph.Model("house", time_unit="min")
    (T,) = m.states(T="K")
    power, n = m.inputs(power="kW", n="1/min")
    (k,) = m.parameters("k")
    m.dynamics(T=k * power * n)
    m.outputs(T=T)
    run = read(file, convert=m.units, time_unit="min")
    assert {name: run.units[name] for name in ("power", "T", "n", "x")} == {
        "power": "kW", "T": "K", "n": "1/min", "x": "m",
    }  # fmt: skip
    np.testing.assert_allclose([run.channels[name][0] for name in ("power", "T", "n", "x")], [0.5, 293.15, 3.0, 0.3048])
    with pytest.raises(DataError, match=r"convert=m.units, or this one with units=\{'power': \('W', 'kW'\)\}"):
        ph.estimate(m, read(file, time_unit="min"))
    # The advice names the unit of the file, also where the column was converted to another one.
    with pytest.raises(DataError, match=r"this one with units=\{'n': \('1/min', '1/min'\)\}"):
        ph.estimate(m, read(file, time_unit="min", convert=True).with_channels({"power": [0.5, 0.7]}, {"power": "kW"}))
