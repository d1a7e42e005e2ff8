"""A missing term that depends on two variables at once, such as no candidate has: found, fitted, shown and saved."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import phugoid as ph
from phugoid.discrepancy.candidates.scales import Scales
from phugoid.discrepancy.candidates.terms import tabulated
from phugoid.discrepancy.page.figures import curve_figure
from phugoid.discrepancy.search.disturbance import Disturbance, hats
from phugoid.discrepancy.search.finding import Finding
from phugoid.sensitivities import Place, Points
from phugoid.sensitivities.whitened import Marginal

K, C = 2.0, 0.4


def bump(x: Any, v: Any) -> Any:
    return 1.5 * ph.exp(-(((x - 0.5) / 0.45) ** 2) - ((v + 0.4) / 0.6) ** 2)


def mass(hidden: bool) -> ph.Model:
    m = ph.Model("mass")
    (u,), (x, v) = m.inputs("u"), m.states(x="m", v="m/s")
    k, c = m.parameters(k=K, c=C)
    m.dynamics(x=v, v=u - k * x - c * v + (bump(x, v) if hidden else 0.0))
    m.outputs(x=x, v=v)
    return m


def record(seed: int) -> ph.Experiment:
    rng, t = np.random.default_rng(3 + seed), np.arange(0.0, 60.0, 0.05)
    u = 1.5 * np.sin(1.1 * t + 0.013 * t**2 + seed) + np.sin(0.37 * t + 2.0 * seed)
    run = ph.simulate(mass(True), {"k": K, "c": C}, ph.Experiment(t, {"u": u}, {}), initial={"x": 0.0, "v": 0.0})
    noise = {"x": 0.01, "v": 0.02}
    y = {n: z + noise[n] * rng.standard_normal(t.size) for n, z in run.outputs.items()}
    return ph.Experiment(t, {"u": u}, y, name=f"record {seed}")


def test_a_bump_over_two_variables_is_shown_as_a_surface(tmp_path: Path) -> None:
    """Of the likeliest function of each variable alone the better explains 37 % of the misfit."""
    d = ph.diagnose(ph.estimate(mass(False), record(0)), validation=record(1))
    (f,) = d.findings
    assert d.verdict == "unexplained" and not f.cause and f.aliases == ("v':f(x, v)",)
    assert f.explained > 0.9 and "smooth function of x and v in v'" in f.explanation
    x, v = np.array(f.surface["first"]), np.array(f.surface["second"])
    value, samples = (np.array(f.surface[key]).reshape(x.size, v.size) for key in ("value", "samples"))
    assert samples.sum() == record(0).n
    # What k and c do as well is left to these.
    found = d.extend(minor=True).fit.parameters
    assert found["k"].value == pytest.approx(K, abs=0.1) and found["c"].value == pytest.approx(C, abs=0.1)
    on = np.array([[float(bump(a, b)) for b in v] for a in x])
    left = value - (found["k"].value - K) * x[:, None] - (found["c"].value - C) * v - on
    rms = np.sqrt((left**2 * samples).sum() / samples.sum())
    assert rms < 0.3 * np.sqrt((on**2 * samples).sum() / samples.sum())
    figure, axes = curve_figure(f)
    assert (axes["curve"].get_xlabel(), axes["curve"].get_ylabel()) == ("x", "v") and len(figure.axes) == 2
    _, named = curve_figure(f, d.fit.model)
    assert (named["curve"].get_xlabel(), named["curve"].get_ylabel()) == ("x, m", "v, m/s")
    pages = []
    for minor in (False, True):
        d.report(tmp_path / "page.html", minor=minor)
        pages.append((tmp_path / "page.html").read_text(encoding="utf-8"))
    assert "The new equations" not in pages[0] and "The gain" not in pages[0]
    assert "The model is extended by v&#39;:f(x, v)" in pages[1] and "The new equations" in pages[1]
    d.save(tmp_path / "diagnosis.json")
    assert ph.load(tmp_path / "diagnosis.json").findings[0].surface == f.surface


def test_a_table_of_two_variables_goes_on_with_its_mean_slopes() -> None:
    x, y = np.linspace(-1.0, 1.0, 9), np.linspace(0.0, 4.0, 11)
    values = 2.0 * x[:, None] - 0.5 * y
    points = Points("run", np.arange(3.0), {"x": x[:3], "y": y[:3]}, {}, {}, {}, {})
    term = tabulated(Place("equation", "v"), ("x", "y"), (x, y), values, Scales.of([points]))
    assert term.name == "v':f(x, y)" and term.variables == ("x", "y") and term.given is not None
    for a, b in ((0.3, 1.7), (1.2, -0.4), (-1.3, 4.3)):
        assert term.given.evaluate({"x": a, "y": b}) == pytest.approx(2.0 * a - 0.5 * b, abs=1e-9)


def test_hats_of_two_variables_and_values_between_nodes() -> None:
    axes = np.array([0.0, 1.0, 2.0]), np.array([0.0, 2.0])
    plane = (3.0 * axes[0][:, None] + axes[1]).ravel()
    columns = [np.array([0.5, 1.25]), np.array([1.0, 0.5])]
    np.testing.assert_allclose(plane @ hats(columns, axes), 3.0 * columns[0] + columns[1])
    marginal = Marginal(0.0, 1.0, np.ones(1), plane, plane**2, np.zeros(1), 6.0)
    d = Disturbance(
        "function", Place("equation", "v"), ("x", "y"), 0.0, marginal, 0.0, None, np.empty(0), 0.0, axes=axes
    )
    finer = np.linspace(0.0, 2.0, 5), np.linspace(0.0, 2.0, 4)
    moved = d.marginal_on(finer)
    np.testing.assert_allclose(moved.coefficients, (3.0 * finer[0][:, None] + finer[1]).ravel())
    assert moved.deviations.shape == (20,) and d.name == "v':f(x, y)"


def test_a_finding_without_a_curve_has_no_figure() -> None:
    finding = Finding(cause="f:x^3", status="named", explanation="")
    with pytest.raises(ph.DataError, match="no curve"):
        curve_figure(finding)
