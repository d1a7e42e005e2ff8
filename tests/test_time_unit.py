"""The unit of a model's time: in results, figures, pages and saved files, and in what a diagnosis takes for a rate."""

from __future__ import annotations

import pickle
import re
from pathlib import Path

import numpy as np
import pytest

import phugoid as ph
from phugoid.discrepancy.candidates.model_structure import ModelStructure

HOURS = np.arange(0.0, 72.0, 0.25)
# A time, a frequency or a rate in seconds, however it is written.
SECONDS = re.compile(r"\d s\b|, s\b|√s|/s\b|Hz")


def house(delayed: bool = False) -> ph.Model:
    """The temperature of a house, whose heating may act some time after it is switched on."""
    m = ph.Model("house", time_unit="h")
    (theta,) = m.states(theta="K")
    (power,) = m.inputs(power="kW")
    (outside,) = m.conditions(outside="K")
    tau, gain = m.parameters(tau=ph.Parameter(10.0, bounds=(0.5, 200.0), unit="h"), gain=ph.Parameter(1.0, unit="K/kW"))
    if delayed:
        (lag,) = m.parameters(lag=ph.Parameter(1.0, unit="h"))
        power = m.delay(power, lag)
    m.dynamics(theta=(outside - theta + gain * power) / tau)
    m.outputs(theta=(theta, "K"))
    return m


def record() -> ph.Experiment:
    rng = np.random.default_rng(3)
    power = 6.0 * (np.repeat(rng.random(HOURS.size // 12), 12) > 0.5)
    run = ph.Experiment(HOURS, {"power": power, "outside": 2.0 + 4.0 * np.sin(2.0 * np.pi * HOURS / 24.0)}, name="week")
    true = {"tau": 14.0, "gain": 3.0, "lag": 1.5}
    theta = ph.simulate(house(delayed=True), true, run, initial={"theta": 12.0}).outputs["theta"]
    return run.with_outputs({"theta": theta + 0.05 * rng.standard_normal(HOURS.size)})


FIT = ph.estimate(house(), record())


@pytest.mark.parametrize("wrong", [3600, None, "", " ", "1/h", "60 s", "a\tb"])
def test_what_is_no_unit_of_time_is_refused(wrong: object) -> None:
    with pytest.raises(ph.ModelError, match="model 'house': time_unit is a unit of time as text, such as 's'"):
        ph.Model("house", time_unit=wrong)  # type: ignore[arg-type]


def test_the_unit_is_kept_and_printed(tmp_path: Path) -> None:
    m = house()
    m.save(tmp_path / "house.json")
    FIT.save(tmp_path / "fit.json")
    theta = ph.Expr.symbol("theta")
    kept = {
        "copy": m.copy(),
        "pickle": pickle.loads(pickle.dumps(m)),
        "file": ph.Model.load(tmp_path / "house.json"),
        "terms": m.with_terms({"theta'": -ph.Expr.symbol("k") * theta}, {"k": 0.0}),
        "parameters": m.with_parameters(tau=9.0),
        "noise": m.with_noise(theta=0.1),
        "fit": ph.load(tmp_path / "fit.json").model,
        "pickled fit": pickle.loads(pickle.dumps(FIT)).model,
    }
    units = {name: (each.time_unit, each.units["time"]) for name, each in kept.items()}
    assert units == dict.fromkeys(kept, ("h", "h"))
    assert "time in h" in repr(m) and "time in h" in str(m) and "time in h" in m._repr_html_()
    plain = ph.Model("plain")
    assert plain.time_unit == "s" and "time" not in plain.units and "time" not in repr(plain)


def test_results_and_figures_are_in_the_unit_of_the_model(tmp_path: Path) -> None:
    misfit = FIT.misfit()
    c = misfit.channels["theta"]
    assert c.structured and " 1/h" in misfit.summary()
    texts = [misfit.summary(), FIT.summary(), FIT._repr_html_(), FIT.records[0]._repr_html_()]
    texts += [str(FIT.robust()), str(FIT.validate(record().window(20.0, 60.0))), str(ph.linear.modes(FIT))]
    texts += FIT.warnings
    figures = [FIT.plot(), FIT.plot_residuals(), misfit.plot(), FIT.prediction_bands().plot()]
    labels = [a.get_xlabel() for _, axes in figures for a in axes.values()]
    assert {"time, h", "lag, h", "frequency, 1/h"} <= {*labels}
    titles = [a.get_title(loc=loc) for _, axes in figures for a in axes.values() for loc in ("left", "center", "right")]
    assert "K²·h" in titles
    FIT.report(tmp_path / "fit.html")
    page = re.sub(r"<(script|style).*?</\1>|<[^>]*>", " ", (tmp_path / "fit.html").read_text(), flags=re.S)
    assert "0 to 71.75 h" in page
    wall = re.compile(r"[0-9.]+ m?s(?=[,;)\s])")  # how long the estimation took
    for text in [*texts, *labels, *titles, page]:
        assert not SECONDS.search(wall.sub("", text, count=1)), text
    assert "time constant, h" in str(ph.linear.modes(FIT))
    assert FIT.records[0].to_xarray()["time"].attrs["units"] == "h"


def test_a_diagnosis_is_in_the_unit_of_the_model() -> None:
    found = FIT.diagnose()
    finding = found.findings[0]
    assert finding.cause == "power:delay", found.summary()
    assert {*finding.units.values()} == {"h"}
    assert found.extend().model.time_unit == "h"
    for text in (finding.explanation, finding.advice, *found.notes):
        assert not SECONDS.search(text), text
    labels = {a.get_xlabel() for figure in found.figures() for a in figure.axes}
    assert "time, h" in labels and not any(SECONDS.search(label) for label in labels)


def pendulum(time: str, unit: str) -> ph.Model:
    m = ph.Model("pendulum", time_unit=time)
    theta, w, level = m.states(theta="rad", w=f"rad/{unit}", level=f"m/{unit}")
    (u,) = m.inputs(u="N")
    k, d, b, a = m.parameters("k d b a")
    m.dynamics(theta=w, w=b * u - k * theta - d * w, level=b * u - a * level)
    m.outputs(theta=(theta, "rad"), level=(level, f"m/{unit}"))
    return m


@pytest.mark.parametrize(("time", "unit"), [("h", "h"), ("hours", "h"), ("ms", "ms"), ("fortnight", "fortnight")])
def test_rates_are_known_by_the_unit_of_time(time: str, unit: str) -> None:
    """A state in m/h is a speed where time is in h, and else a store that may be full."""

    def listed(model: ph.Model) -> list[str]:
        return [c.name for c in ph.candidates(model)]

    usual = listed(pendulum("s", "s"))
    assert listed(pendulum(time, unit)) == usual
    assert listed(pendulum("s", unit)) != usual
    structure = ModelStructure(pendulum(time, unit))
    assert [v.symbol for v in structure.variables if v.rate] == ["w"]
    assert not any(structure.is_store(v) for v in structure.variables)
    drift = next(c for c in ph.candidates(pendulum(time, unit)) if c.name == "level:drift")
    assert drift.unit == f"m/{unit}²"


def test_files_are_read_in_the_unit_of_the_model(tmp_path: Path) -> None:
    file = tmp_path / "log.csv"
    file.write_text("t [min],power,outside,theta\n" + "".join(f"{60 * k},{k % 2},1,{k % 3}\n" for k in range(101)))
    hours, seconds = ph.read(file, time_unit="h"), ph.read(file)
    np.testing.assert_allclose(hours.t, np.arange(101.0))
    np.testing.assert_allclose(seconds.t, 3600.0 * np.arange(101.0))
    assert "0 to 100 h" in repr(hours) and "0 to 360000 s" in repr(seconds) and "0 to 71.75, " in repr(record())
    assert hours.units["time"] == "h" and hours.low_pass(0.2).history[0].startswith("low-pass 0.2 1/h")
    with pytest.raises(ph.DataError, match="times of experiment 'log' are in 's', but the model has time in 'h'"):
        ph.estimate(house(), seconds)
    with pytest.raises(ph.DataError, match="read: time_unit is a unit of time"):
        ph.read(file, time_unit="1/h")


def test_rates_per_another_unit_than_the_time_of_the_model_are_remarked() -> None:
    def fitted(time_unit: str) -> ph.Fit:
        m = ph.Model("store", time_unit=time_unit)
        (x,) = m.states(x="mg")
        (u,) = m.inputs(u="mg/h")
        (k,) = m.parameters(k=ph.Parameter(0.5, unit="1/h"))
        m.dynamics(x=u - k * x)
        m.outputs(x=x)
        t = np.arange(0.0, 20.0, 0.5)
        exact = np.asarray(ph.simulate(m, {"k": 0.3}, ph.Experiment(t, {"u": np.sin(t)})).outputs["x"])
        noise = 0.01 * np.random.default_rng(1).standard_normal(t.size)
        return ph.estimate(m, ph.Experiment(t, {"u": np.sin(t)}, {"x": exact + noise}))

    (said,) = [w for w in fitted("s").warnings if "time_unit" in w]
    assert said == "the time of the model is in s, but u and k are per h: Model(..., time_unit='h')"
    assert not [w for w in fitted("h").warnings if "time_unit" in w]
