"""Models as functional mock-up units, checked and simulated by FMPy."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import hfb320
import numpy as np
import pytest

import phugoid as ph
from phugoid import DataError, MissingDependency, ModelError, OptionError, Table

fmpy = pytest.importorskip("fmpy", reason="functional mock-up units need FMPy")
pytestmark = pytest.mark.skipif(
    not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="no C compiler (cc, gcc, clang) was found"
)

START = {"V": 106.0, "alpha": 0.112, "theta": 0.104, "q": -0.003}
N_X, N_U, N_P, N_Y = 4, 2, 15, 7
DX, U, P, Y = N_X, 2 * N_X, 2 * N_X + N_U, 2 * N_X + N_U + N_P  # first value references


@pytest.fixture(scope="module")
def unit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return ph.export_fmu(hfb320.model(), tmp_path_factory.mktemp("fmu") / "hfb320.fmu", hfb320.PUBLISHED)


@pytest.fixture(scope="module")
def expected() -> ph.results.Record:
    return ph.simulate(hfb320.model(), hfb320.PUBLISHED, hfb320.twin(), initial=START)


def start(unit: Path, folder: Path, kind: str) -> Any:
    """The unit in its initialization."""
    from fmpy import fmi2

    description = fmpy.read_model_description(unit)
    fmpy.extract(unit, folder)
    one = getattr(fmi2, kind)(
        guid=description.guid, unzipDirectory=str(folder), modelIdentifier=description.coSimulation.modelIdentifier,
        instanceName="one",
    )  # fmt: skip
    one.instantiate()
    one.setupExperiment(startTime=0.0)
    one.enterInitializationMode()
    return one


def instance(unit: Path, folder: Path, kind: str) -> Any:
    """The unit of the HFB-320, ready to go."""
    one = start(unit, folder, kind)
    one.setReal(list(range(N_X)), list(START.values()))
    one.exitInitializationMode()
    return one


def test_the_unit_is_valid(unit: Path) -> None:
    """Against the schema, and the rules on names, structure, start values and units."""
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(unit)) == []
    description = fmpy.read_model_description(unit)
    by_name = {v.name: v for v in description.modelVariables}
    assert (by_name["de"].causality, by_name["de"].unit) == ("input", "rad")
    assert float(by_name["Cmq"].start) == hfb320.PUBLISHED["Cmq"] and by_name["Cmq"].causality == "parameter"
    assert by_name["der(state.q)"].derivative is by_name["state.q"]
    rate = next(u for u in description.derivatives if u.variable is by_name["der(state.theta)"])
    assert [d.name for d in rate.dependencies] == ["state.q"]
    accelerometer = next(u for u in description.outputs if u.variable is by_name["ax"])
    assert [d.name for d in accelerometer.dependencies] == ["T", "state.V", "state.alpha"]


def test_co_simulation(unit: Path, expected: ph.results.Record, tmp_path: Path) -> None:
    """With inputs that run linearly over each step, as those of the record do."""
    data = hfb320.twin()
    u = np.array([data.input("de"), data.input("T")]).T
    one = instance(unit, tmp_path, "FMU2Slave")
    names = list(expected.outputs)
    for k, t in enumerate(data.t):
        y = one.getReal(list(range(Y, Y + N_Y)))
        if k == 0:  # outputs depend on inputs at once
            one.setReal([U, U + 1], u[0].tolist())
            y = one.getReal(list(range(Y, Y + N_Y)))
        for name, value in zip(names, y, strict=True):
            assert value == pytest.approx(expected.outputs[name][k], rel=1e-7, abs=1e-7), (name, t)
        if k == data.n - 1:
            break
        h = data.t[k + 1] - t
        one.setReal([U, U + 1], u[k].tolist())
        one.setRealInputDerivatives([U, U + 1], [1, 1], ((u[k + 1] - u[k]) / h).tolist())
        one.doStep(t, h)
    one.terminate()
    one.freeInstance()


def test_model_exchange(unit: Path, expected: ph.results.Record, tmp_path: Path) -> None:
    """The unit's derivatives with an integrator from elsewhere."""
    from scipy.integrate import solve_ivp

    data = hfb320.twin().window(0, 10)
    one = instance(unit, tmp_path, "FMU2Model")
    one.newDiscreteStates()
    one.enterContinuousTimeMode()
    dx = np.zeros(N_X)

    def at(t: float, x: np.ndarray) -> None:
        one.setTime(t)
        one.setReal([U, U + 1], [float(np.interp(t, data.t, data.input(n))) for n in ("de", "T")])
        one.setContinuousStates(x.ctypes.data_as(pointer), N_X)

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        at(t, np.array(x))
        one.getDerivatives(dx.ctypes.data_as(pointer), N_X)
        return dx.copy()

    pointer = ctypes.POINTER(ctypes.c_double)
    x = np.array(list(START.values()))
    for k, t in enumerate(data.t):
        at(t, x)
        for value, (name, values) in zip(one.getReal(range(Y, Y + N_Y)), expected.outputs.items(), strict=True):
            assert value == pytest.approx(values[k], rel=1e-7, abs=1e-7), (name, t)
        if k < data.n - 1:  # inputs bend at samples
            x = solve_ivp(rate, data.t[k : k + 2], x, "DOP853", rtol=1e-8, atol=1e-10).y[:, -1].copy()
    nominal = np.zeros(N_X)
    one.getNominalsOfContinuousStates(nominal.ctypes.data_as(pointer), N_X)
    assert (nominal > 0).all()
    one.terminate()
    one.freeInstance()


@pytest.mark.parametrize("kind", ["CoSimulation", "ModelExchange"])
def test_simulated_by_another_program(kind: str, unit: Path) -> None:
    """FMPy holds inputs over a step, so they are constant here; its integrator is CVode."""
    t = np.linspace(0, 20, 201)
    inputs = {"de": -0.011, "T": 11500.0}
    e = ph.Experiment(t, {n: np.full(t.size, v) for n, v in inputs.items()})
    expected = ph.simulate(hfb320.model(), hfb320.PUBLISHED, e, initial=START)
    start = {**{f"state.{n}": v for n, v in START.items()}, **inputs}
    found = fmpy.simulate_fmu(
        str(unit), stop_time=20.0, output_interval=0.1, fmi_type=kind, relative_tolerance=1e-9, start_values=start,
        record_events=False,
    )  # fmt: skip
    np.testing.assert_allclose(found["time"], t, atol=1e-9)
    for name, values in expected.outputs.items():
        np.testing.assert_allclose(found[name], values, rtol=1e-5, atol=1e-5, err_msg=name)


def test_states_are_saved_and_restored_and_parameters_tuned(unit: Path, tmp_path: Path) -> None:
    one = instance(unit, tmp_path, "FMU2Slave")
    one.setReal([U, U + 1], [-0.01, 11500.0])
    state = one.getFMUstate()
    data = one.serializeFMUstate(state)

    def ended() -> list[float]:
        one.doStep(0.0, 0.37)
        return list(one.getReal(list(range(N_X))))

    first = ended()
    one.setReal([P + hfb320.model().parameter_names.index("Cmq")], [-10.0])
    one.setFMUstate(state)
    assert ended() == first  # with the parameter as it was
    one.freeFMUstate(state)
    again = one.deSerializeFMUstate(data)
    one.setFMUstate(again)
    one.setReal([P + hfb320.model().parameter_names.index("Cmq")], [-10.0])
    assert ended() != first
    one.reset()
    assert list(one.getReal([0, 1, 2, 3])) == [0.0] * 4
    one.freeInstance()


def test_directional_derivatives_are_those_of_linearise(unit: Path, tmp_path: Path) -> None:
    one = instance(unit, tmp_path, "FMU2Model")
    one.setReal([U, U + 1], [-0.01, 11500.0])
    linear = ph.linear.linearise(hfb320.model(), hfb320.PUBLISHED, at={**START, "de": -0.01, "T": 11500.0})
    unknown, known = [*range(DX, U), *range(Y, Y + N_Y)], [*range(N_X), U, U + 1]
    whole = np.block([[linear.A, linear.B], [linear.C, linear.D]])
    for k, variable in enumerate(known):
        column = one.getDirectionalDerivative(unknown, [variable], [1.0])
        np.testing.assert_allclose(column, whole[:, k], rtol=1e-12, atol=1e-15)
    seeds = np.random.default_rng(0).standard_normal(6)
    found = one.getDirectionalDerivative(unknown, known, seeds.tolist())
    np.testing.assert_allclose(found, whole @ seeds, rtol=1e-12)
    one.freeInstance()


def test_misuse_is_an_error_not_a_crash(unit: Path, tmp_path: Path) -> None:
    from fmpy.fmi1 import FMICallException

    one = instance(unit, tmp_path, "FMU2Slave")
    for call in (
        lambda: one.getReal([10_000]),
        lambda: one.setReal([Y], [0.0]),
        lambda: one.getInteger([0]),
        lambda: one.doStep(0.0, -1.0),
        lambda: one.setRealInputDerivatives([U], [2], [0.0]),
        lambda: one.getDirectionalDerivative([Y], [P], [1.0]),
    ):
        with pytest.raises(FMICallException):
            call()
    one.setReal([0], [0.0])  # no speed: the equations divide by it
    with pytest.raises(FMICallException):
        one.doStep(0.0, 0.1)
    one.freeInstance()


@pytest.fixture(scope="module")
def fit() -> ph.Fit:
    """A table, time, and an output that is called like an input."""
    m = ph.Model('Servo <1> & "2"')
    (x,) = m.states(x="m")
    (u,) = m.inputs(u="N")
    (a,) = m.parameters(a=ph.Parameter(1.0, unit="1/s"))
    gain = Table("gain", [-1.0, 0.0, 1.0], [-2.0, 0.0, 1.0])
    m.dynamics(x=a * (gain(u) - x) + 0.1 * m.time)
    m.outputs(x=x, u=(2 * u, "N"))
    t = 0.05 * np.arange(80)
    e = ph.Experiment(t, {"u": np.round(np.sin(2 * t), 2)}, name="run")
    y = ph.simulate(m, {"a": 1.5}, e, initial={"x": 0.3}).outputs
    random = np.random.default_rng(0)
    return ph.estimate(m, e.with_outputs({n: v + 0.01 * random.standard_normal(t.size) for n, v in y.items()}))


def test_a_fit_brings_its_start_values(fit: ph.Fit, tmp_path: Path) -> None:
    from fmpy.validation import validate_fmu

    path = fit.export_fmu(tmp_path / "servo.fmu")
    assert validate_fmu(str(path)) == []
    description = fmpy.read_model_description(path)
    by_name = {v.name: v for v in description.modelVariables}
    assert description.modelName == fit.model.name
    assert float(by_name["a"].start) == fit.parameters["a"].value
    assert float(by_name["state.x"].start) == fit.initial_states["run"]["x"].value
    assert float(by_name["u"].start) == fit.records[0].inputs["u"][0]
    assert by_name["output.u"].causality == "output" and by_name["u"].causality == "input"
    t = 0.05 * np.arange(80)
    e = ph.Experiment(t, {"u": np.full(t.size, 0.4)}, name="run")
    found = fmpy.simulate_fmu(str(path), stop_time=t[-1], output_interval=0.05, start_values={"u": 0.4})
    for name, values in ph.simulate(fit.model, fit, e).outputs.items():
        title = "output.u" if name == "u" else name
        np.testing.assert_allclose(found[title], values, rtol=1e-6, atol=1e-6)


def test_the_same_fit_gives_the_same_source(fit: ph.Fit, tmp_path: Path) -> None:
    for name in ("one.fmu", "two.fmu"):
        fit.export_fmu(tmp_path / name, binary=False)
    assert (tmp_path / "one.fmu").read_bytes() == (tmp_path / "two.fmu").read_bytes()
    with zipfile.ZipFile(tmp_path / "one.fmu") as archive:
        assert sorted(archive.namelist()) == [
            "modelDescription.xml",
            *(f"sources/{file}" for file in ("fmi2.c", "fmi2_model.h", "servo_1_2.c", "servo_1_2.h")),
        ]


def test_the_source_compiles_without_a_warning(unit: Path, fit: ph.Fit, tmp_path: Path) -> None:
    compiler = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))))
    headers = Path(fmpy.__file__).parent / "c-code"
    for k, path in enumerate((unit, fit.export_fmu(tmp_path / "servo.fmu", binary=False))):
        with zipfile.ZipFile(path) as archive:
            archive.extractall(tmp_path / str(k))
        for file in (tmp_path / str(k) / "sources").glob("*.c"):
            command = [
                compiler,
                "-std=c99",
                "-Wall",
                "-Wextra",
                "-Werror",
                f"-I{headers}",
                "-c",
                file.name,
                "-o",
                os.devnull,
            ]
            done = subprocess.run(command, cwd=file.parent, capture_output=True, text=True)
            assert done.returncode == 0, done.stderr


def late() -> ph.Model:
    """An input and a sensor that are late."""
    m = ph.Model("late")
    (x,), (u,) = m.states(x="m"), m.inputs(u="V")
    tau, a = m.parameters(tau=0.2, a=1.0)
    m.dynamics(x=a * (m.delay(u, tau) - x))
    m.outputs(x=x, y=x + u)
    m.sensor_delay(y=tau)
    return m


def test_delayed_inputs_are_delayed_by_the_importing_program(tmp_path: Path) -> None:
    from fmpy.validation import validate_fmu

    m, values = late(), {"tau": 0.2, "a": 1.5}
    with pytest.raises(ModelError, match=r"delays \(u_delayed, y\).*export_fmu\(\.\.\., delayed_inputs=True\)"):
        ph.export_fmu(m, tmp_path / "late.fmu", values)
    path = ph.export_fmu(m, tmp_path / "late.fmu", values, delayed_inputs=True)
    assert validate_fmu(str(path)) == []
    by_name = {v.name: v for v in fmpy.read_model_description(path).modelVariables}
    assert by_name["u_delayed"].description == "u(t - tau): to be delayed outside"
    assert by_name["u_delayed"].causality == "input" and by_name["u_delayed"].unit == "V"
    assert by_name["y"].description == "without its delay, by tau: to be delayed outside"

    t = 0.05 * np.arange(80)
    u = np.cos(2 * t)
    e = ph.Experiment(t, {"u": u}, name="run")
    expected = ph.simulate(m, values, e, initial={"x": 0.3})
    # The delay is four samples; before the first the input is as there.
    delayed = np.concatenate([np.full(4, u[0]), u[:-4]])
    one, two = by_name["u"].valueReference, by_name["u_delayed"].valueReference
    x, y = by_name["state.x"].valueReference, by_name["y"].valueReference
    unit = start(path, tmp_path, "FMU2Slave")
    unit.setReal([x], [0.3])
    unit.exitInitializationMode()
    for k, now in enumerate(t):
        unit.setReal([one, two], [u[k], delayed[k]])
        found = unit.getReal([x, y])
        assert found[0] == pytest.approx(expected.outputs["x"][k], rel=1e-7, abs=1e-7), now
        if k + 4 < t.size:  # the sensor's delay, four samples too
            assert found[1] == pytest.approx(expected.outputs["y"][k + 4], rel=1e-7, abs=1e-7), now
        if k + 1 < t.size:
            rates = [(u[k + 1] - u[k]) / 0.05, (delayed[k + 1] - delayed[k]) / 0.05]
            unit.setRealInputDerivatives([one, two], [1, 1], rates)
            unit.doStep(now, 0.05)
    unit.terminate()
    unit.freeInstance()


@pytest.mark.parametrize("kind", ["CoSimulation", "ModelExchange"])
def test_inputs_that_are_held_are_discrete(kind: str, tmp_path: Path) -> None:
    """Another program holds them between the samples that it is given."""
    from fmpy.validation import validate_fmu

    m = ph.Model("lag")
    (x,), (u, w) = m.states(x="m"), m.inputs(u="m", w="m")
    (a,) = m.parameters(a=1.5)
    m.dynamics(x=a * (u + w - x))
    m.outputs(y=2 * x)
    t = 0.1 * np.arange(40)
    inputs = {"u": np.random.default_rng(0).choice([-1.0, 1.0], 40), "w": 0.0 * t}
    run = ph.Experiment(t, inputs, name="run", interpolation={"u": "hold"})
    expected = ph.simulate(m, {"a": 1.5}, run, initial={"x": 0.0})
    fit = ph.estimate(m, run.with_outputs(dict(expected.outputs)), noise=ph.Gaussian(sigma={"y": 0.01}))
    path = fit.export_fmu(tmp_path / "held.fmu")
    assert validate_fmu(str(path)) == []
    by_name = {v.name: v for v in fmpy.read_model_description(path).modelVariables}
    assert (by_name["u"].variability, by_name["w"].variability) == ("discrete", "continuous")
    table = np.array(list(zip(t, inputs["u"], inputs["w"], strict=True)), [(n, float) for n in ("time", "u", "w")])
    found = fmpy.simulate_fmu(
        str(path), stop_time=t[-1], output_interval=0.1, fmi_type=kind, relative_tolerance=1e-9, input=table,
        record_events=False,
    )  # fmt: skip
    np.testing.assert_allclose(found["y"], np.interp(found["time"], t, expected.outputs["y"]), atol=1e-5)


def test_bad_input(fit: ph.Fit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for step in (0.0, -1.0, float("nan"), "fast"):
        with pytest.raises(OptionError, match="step is a positive number"):
            fit.export_fmu(tmp_path / "a.fmu", step=step)
    with pytest.raises(DataError, match="cannot be saved, since there is no folder"):
        fit.export_fmu(tmp_path / "absent" / "a.fmu", binary=False)
    with pytest.raises(ModelError, match="has delays"):
        ph.export_fmu(late(), tmp_path / "a.fmu", {"tau": 0.1, "a": 1.0})
    monkeypatch.setenv("CC", "false")
    with pytest.raises(DataError, match="false failed"):
        fit.export_fmu(tmp_path / "a.fmu")
    monkeypatch.delenv("CC")
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(MissingDependency, match="needs a C compiler"):
        fit.export_fmu(tmp_path / "a.fmu")
    monkeypatch.setitem(sys.modules, "fmpy", None)
    with pytest.raises(MissingDependency, match=r'pip install "phugoid\[fmu\]"'):
        fit.export_fmu(tmp_path / "a.fmu")
    assert not (tmp_path / "a.fmu").exists()
