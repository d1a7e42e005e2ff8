"""Long records are searched in windows, and what is named is estimated from all samples."""

from __future__ import annotations

import re

import numpy as np
import pytest

import phugoid as ph
from phugoid.discrepancy.search.parts import parts_of
from phugoid.discrepancy.search.refit import Refit

TRUTH = {"k": 30.0, "c": 1.2}
DRAG = 0.6
STEP, SAMPLES = 0.1, 12_000


def oscillator(drag: bool) -> ph.Model:
    m = ph.Model("oscillator")
    (u,) = m.inputs(u="m/s²")
    x, v = m.states(x="m", v="m/s")
    k, c = m.parameters(k=ph.Parameter(20.0, unit="1/s²"), c=ph.Parameter(1.0, unit="1/s"))
    m.dynamics(x=v, v=u - k * x - c * v - (DRAG * v * abs(v) if drag else 0.0))
    m.outputs(x=x)
    return m


def record(seed: int, samples: int, drag: bool, event: float | None = None, name: str = "flight") -> ph.Experiment:
    """Return steps of random size at random times, and noise on the output."""
    rng = np.random.default_rng(seed)
    t = STEP * np.arange(samples)
    u = np.repeat(rng.uniform(-20.0, 20.0, samples // 8 + 1), 8)[:samples]
    acting = u.copy()
    if event is not None:
        acting[(t >= event) & (t < event + 1.5)] += 15.0
    blank = ph.Experiment(t, {"u": acting}, {"x": np.zeros(samples)}, interpolation="hold")
    x = ph.simulate(oscillator(drag), TRUTH, blank).outputs["x"]
    return ph.Experiment(t, {"u": u}, {"x": x + 0.01 * rng.normal(size=samples)}, name=name, interpolation="hold")


CANDIDATES = ("v':v|v|", "v':v^3", "v':x^3", "v':sign(v)", "v':bias", "u:scale", "x:drift")


def diagnosed(data: ph.Experiment | list[ph.Experiment], validation: ph.Experiment, model: ph.Model) -> ph.Diagnosis:
    fit = ph.estimate(model, data)
    return ph.diagnose(fit, ph.candidates(model).only(*CANDIDATES), validation=validation)


def test_a_cause_is_found_in_windows_and_estimated_from_all_samples() -> None:
    model = oscillator(drag=False)
    data = record(1, SAMPLES, drag=True)
    d = diagnosed(data, record(2, 2000, drag=True), model)
    assert [f.cause for f in d.findings if f.status == "named"] == ["v':v|v|"]
    assert any("in 10 windows of the records with 6,000 of 12,000 samples" in note for note in d.notes)
    extension = d.extend()
    assert sum(r.t.size for r in extension.fit.records) == SAMPLES
    (found,) = (f for f in d.findings if f.status == "named")
    assert found.coefficient == pytest.approx(extension.fit.parameters["v_dot_v_abs_v"].value, rel=1e-6)
    assert abs(found.coefficient + DRAG) < 4.0 * found.std_error
    assert extension.gain.rms_after["x"] == pytest.approx(0.01, rel=0.03)
    assert sum(r.t.size for r in d.fit.records) == SAMPLES


def test_nothing_is_named_where_nothing_is_missing() -> None:
    model = oscillator(drag=False)
    d = diagnosed(record(3, SAMPLES, drag=False), record(4, 2000, drag=False), model)
    assert d.verdict == "nothing", d.summary()


def test_an_event_is_in_one_of_the_windows() -> None:
    fit = ph.estimate(oscillator(drag=False), record(5, SAMPLES, drag=False, event=777.0))
    parts = parts_of(Refit((), fit), [])
    assert parts is not None
    spans = [(r.t[0], r.t[-1]) for r in parts.base.fit.records]
    assert len(spans) == 10
    assert any(begin < 777.0 and end > 778.5 for begin, end in spans), spans


@pytest.mark.parametrize("samples", [1000, 3000, SAMPLES])
def test_an_event_is_found_in_records_of_any_length(samples: int) -> None:
    model, at = oscillator(drag=False), 77.0
    d = diagnosed(record(5, samples, drag=False, event=at), record(6, 2000, drag=False), model)
    (found,) = (f for f in d.findings if f.status == "named")
    assert "v':event" in (found.cause, *found.aliases)
    begin, end = (float(x) for x in re.findall(r"from ([\d.]+) to ([\d.]+) s", found.explanation)[0])
    assert at - 3.0 < begin <= at + 0.2 and at + 1.0 <= end < at + 4.5, found.explanation


def test_parameters_of_each_record_leave_one_window_of_each() -> None:
    m = oscillator(drag=False)
    m = m.with_parameters({"c": ph.Parameter(1.0, unit="1/s", per_experiment=True)})
    data = [record(i, 5000, drag=True, name=f"flight {i}") for i in (7, 8)]
    fit = ph.estimate(m, data)
    d = ph.diagnose(fit, ph.candidates(m).only("v':v^3", "v':v|v|", "v':bias"))
    assert any("in 2 windows of the records with 6,000 of 10,000 samples" in note for note in d.notes)
    assert [f.cause for f in d.findings if f.status == "named"] == ["v':v|v|"]


def test_short_records_are_searched_whole() -> None:
    model = oscillator(drag=False)
    d = diagnosed(record(9, 3000, drag=True), record(10, 1000, drag=True), model)
    assert not any("windows" in note for note in d.notes)
