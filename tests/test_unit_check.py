"""A record in other units than the model's is refused: degrees for radians would spoil estimates without a sign."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import phugoid as ph
from phugoid.data.units import differ

T = 0.1 * np.arange(41)
U = np.sign(np.sin(2.0 * T + 0.1))


def lag() -> ph.Model:
    m = ph.Model("lag")
    (q,) = m.states(q="rad/s")
    (de,) = m.inputs(de="rad")
    a, b = m.parameters(a=1.0, b=1.0)
    m.dynamics(q=-a * q + b * de)
    m.outputs(q=q)
    return m


def run(**units: str) -> ph.Experiment:
    q = ph.simulate(lag(), {"a": 1.5, "b": 2.0}, ph.Experiment(T, {"de": U})).outputs["q"]
    noise = 0.01 * np.random.default_rng(0).standard_normal(T.size)
    return ph.Experiment(T, {"de": U}, {"q": q + noise}, name="run1", units=units)


def test_degrees_are_not_taken_for_radians() -> None:
    words = r"input 'de' of experiment 'run1' is in 'deg'.*in 'rad'.*units=\{'de': \('deg', 'rad'\)\}"
    for call in (ph.estimate, ph.equation_error):
        with pytest.raises(ph.DataError, match=rf"^{call.__name__}: {words}"):
            call(lag(), run(de="deg"))
    with pytest.raises(ph.DataError, match=f"^simulate: {words}"):
        ph.simulate(lag(), {"a": 1.5, "b": 2.0}, run(de="deg"))
    fit = ph.estimate(lag(), run())
    with pytest.raises(ph.DataError, match="output 'q'.*'deg/s', but the model has it in 'rad/s'"):
        fit.validate(run(q="deg/s"))


@pytest.mark.parametrize("unit", ["1/s", "rad/s", "rad s^-1", "furlong", ""])
def test_what_is_the_same_or_not_known_is_let_pass(unit: str) -> None:
    assert ph.estimate(lag(), run(de="radians", q=unit)).converged


@pytest.mark.parametrize(("one", "two"), [("deg", "rad"), ("g", "m/s^2"), ("degC", "K"), ("m", "m/s"), ("%", "1")])
def test_units_that_differ(one: str, two: str) -> None:
    assert differ(one, two) and differ(two, one)
    assert not differ(one, one)


def test_conversion_as_the_message_says_it_is_accepted(tmp_path: Path) -> None:
    rows = np.column_stack([T, np.rad2deg(U), run().output("q")])
    file = tmp_path / "run1.csv"
    np.savetxt(file, rows, "%.9g", ",", header="t [s],de [deg],q [rad/s]", comments="")
    with pytest.raises(ph.DataError, match="convert=m.units"):
        ph.estimate(lag(), ph.read(file))
    for data in (ph.read(file, units={"de": ("deg", "rad")}), ph.read(file, convert=True)):
        assert abs(ph.estimate(lag(), data).parameters["a"].value - 1.5) < 0.1


def test_times_of_unknown_unit_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "run1.csv"
    for unit, told in (("ticks", {}), ("m", {}), ("ticks", {"t": "us"})):
        file.write_text(f"t [{unit}],x\n0,1\n1000,2\n")
        if told:
            np.testing.assert_allclose(ph.read(file, units=told).t, [0.0, 1e-3])
        else:
            with pytest.raises(ph.DataError, match=rf"'{unit}' is not a unit of time.*units=\{{'t': 's'\}}"):
                ph.read(file)
    file.write_text("t [ms since 2020-01-01],x\n0,1\n1000,2\n")
    np.testing.assert_allclose(ph.read(file).t, [0.0, 1.0])


def test_units_that_nobody_told_show_in_the_match(tmp_path: Path) -> None:
    m = ph.Model("angle")
    (theta,) = m.states(theta="rad")
    (q,) = m.inputs(q="rad/s")
    (bias,) = m.parameters(bias=0.0)
    m.dynamics(theta=q + bias)
    m.outputs(theta=theta)
    noise = 0.01 * np.random.default_rng(0).standard_normal(T.size)
    angle = np.sin(T) + noise
    right = ph.estimate(m, ph.Experiment(T, {"q": np.cos(T)}, {"theta": angle}))
    wrong = ph.estimate(m, ph.Experiment(T, {"q": np.rad2deg(np.cos(T))}, {"theta": angle}))
    words = "A constant would match theta better than the model does"
    assert words in wrong.summary() and words not in right.summary()
    wrong.report(tmp_path / "wrong.html")
    right.report(tmp_path / "right.html")
    assert words in (tmp_path / "wrong.html").read_text(encoding="utf-8")
    assert words not in (tmp_path / "right.html").read_text(encoding="utf-8")
