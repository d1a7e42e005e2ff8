"""Gaps in the sampling of a record: found, warned of, split."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import phugoid as ph

H, LONG = 0.04, 30.0
TRUTH = {"a": 2.0, "b": 1.5}


def model(with_input: bool = True) -> ph.Model:
    m = ph.Model("lag")
    (x,) = m.states(x="m")
    a, b = m.parameters(a=1.0, b=1.0)
    if with_input:
        (u,) = m.inputs(u="m")
        m.dynamics(x=b * u - a * x)
    else:
        m.dynamics(x=-a * x + b * 0.01)
    m.outputs(x=x)
    return m


def times() -> np.ndarray:
    """Two stretches of 10 s, and 30 s between them."""
    t = H * np.arange(500)
    t[250:] += LONG
    return np.asarray(t)


def command(t: np.ndarray) -> np.ndarray:
    return np.asarray(np.sin(1.3 * t) + np.sin(0.37 * t**1.1))


def whole() -> ph.Experiment:
    """The record without its gap, and noise-free outputs."""
    t = H * np.arange(1250)
    run = ph.Experiment(t, {"u": command(t)}, name="run")
    return run.with_outputs({"x": ph.simulate(model(), TRUTH, run, initial={"x": 0.2}).outputs["x"]})


def gapped(keep: Any = None, **options: Any) -> ph.Experiment:
    e, t = whole(), times()
    at = np.searchsorted(e.t, t - 1e-9)
    z = e.output("x")[at] + 0.005 * np.random.default_rng(0).standard_normal(t.size)
    return ph.Experiment(t, {"u": e.input("u")[at]}, {"x": z}, "run", **options)


def warned(e: Any, m: ph.Model | None = None, **options: Any) -> list[str]:
    return [w for w in ph.estimate(m or model(), e, **options).warnings if "gap" in w]


def test_a_fit_warns_and_the_parts_give_the_truth() -> None:
    e = gapped()
    (text,) = warned(e)
    for word in ("experiment 'run'", "30.040", "t = 9.960", "(u)", "split"):
        assert word in text
    parts = e.split()
    assert [part.name for part in parts] == ["run[1]", "run[2]"]
    assert [part.n for part in parts] == [250, 250] and parts[1].t[0] == pytest.approx(40.0)
    fit = ph.estimate(model(), parts)
    assert not [w for w in fit.warnings if "gap" in w]
    assert set(fit.initial_states) == {"run[1]", "run[2]"}
    for name, value in TRUTH.items():
        assert abs(fit.parameters[name].value - value) < 4 * fit.parameters[name].std_error


def test_the_filter_error_method_and_shooting_warn_too() -> None:
    for transcription in (ph.FilterError("x"), ph.SingleShooting()):
        assert len(warned(gapped(), transcription=transcription)) == 1


def test_a_length_in_seconds() -> None:
    e = gapped()
    assert len(e.split(gaps=5.0)) == 2
    assert e.split(gaps=31.0) == [e]
    for wrong in (0, -1.0, False, float("nan"), "long", None):
        with pytest.raises(ph.OptionError, match="gaps is the length in s"):
            e.split(gaps=wrong)  # type: ignore[arg-type]


def test_a_sample_alone_is_left_out() -> None:
    t = np.concatenate([H * np.arange(30), [20.0], 40.0 + H * np.arange(30)])
    e = ph.Experiment(t, {"u": t}, {"x": t}, "run")
    with pytest.warns(UserWarning, match="t = 20 stands alone"):
        parts = e.split()
    assert [(part.name, part.n) for part in parts] == [("run[1]", 30), ("run[2]", 30)]


def test_a_record_without_gaps_is_itself() -> None:
    e = whole()
    assert e.split() == [e]
    assert not warned(e)


@pytest.mark.parametrize("kind", ["few", "spaced ever farther apart", "bursts", "a change of the rate", "dropouts"])
def test_what_is_irregular_by_nature_has_no_gap(kind: str) -> None:
    grids = {
        "few": np.array([0.0, 0.1, 0.2, 5.0, 5.1, 20.0, 20.1]),
        "spaced ever farther apart": np.geomspace(0.01, 100.0, 40),
        "bursts": np.concatenate([start + 0.01 * np.arange(5) for start in range(12)]),
        "a change of the rate": np.concatenate([0.01 * np.arange(100), 1.0 + 0.5 * np.arange(40)]),
        "dropouts": np.delete(H * np.arange(200), [20, 21, 60, 61, 62, 63, 64, 100]),
    }
    t = grids[kind]
    assert len(ph.Experiment(t, {"u": np.sin(t)}, {"x": np.cos(t)}).split()) == 1


def test_several_rates_have_no_gap() -> None:
    fast, slow = np.arange(0, 20, 0.02), np.arange(0, 20, 1.0) + 0.003
    e = whole()
    at = lambda t: (t, np.interp(t, e.t, e.output("x")))  # noqa: E731
    m = ph.Model("two")
    (x,), (u,) = m.states(x="m"), m.inputs(u="m")
    a, b = m.parameters(a=1.0, b=1.0)
    m.dynamics(x=b * u - a * x)
    m.outputs(x=x, y=2 * x)
    run = ph.multirate({"u": (e.t, e.input("u"))}, {"x": at(fast), "y": (slow, 2 * at(slow)[1])})
    assert len(run.split()) == 1
    assert not warned(run, m, noise=ph.Gaussian(sigma={"x": 0.01, "y": 0.01}))


def test_without_an_input_that_moves_there_is_nothing_to_warn_of() -> None:
    e = gapped()
    still = np.where(np.abs(e.t - 25.0) < 17.0, 1.0, e.input("u"))
    calm = ph.Experiment(e.t, {"u": still}, {"x": e.output("x")})
    assert len(calm.split()) == 2
    assert not warned(calm)
    decay = e.with_outputs({"x": np.exp(-0.1 * e.t) + 1e-3 * np.random.default_rng(0).standard_normal(e.n)})
    assert not warned(decay, model(with_input=False))


def test_outputs_that_are_missing_are_no_gap() -> None:
    e = whole()
    z = np.where((e.t > 10) & (e.t < 40), np.nan, e.output("x"))
    z += 0.005 * np.random.default_rng(0).standard_normal(e.n)
    lost = e.with_outputs({"x": z})
    assert len(lost.split()) == 1
    assert not warned(lost)


def test_the_own_samples_of_an_input_count() -> None:
    """A gap of an input alone; and of outputs alone, while the input goes on, which is none."""
    e, t = whole(), times()
    u = (t, command(t))
    run = ph.multirate({"u": u}, {"x": (e.t, e.output("x"))}, name="run")
    noise = ph.Gaussian(sigma={"x": 0.01})
    assert len(warned(run, noise=noise)) == 1
    parts = run.split()
    assert [part.n for part in parts] == [250, 250]
    assert not warned(parts, noise=noise)
    seen = ph.multirate({"u": (e.t, e.input("u"))}, {"x": (t, np.interp(t, e.t, e.output("x")))})
    assert not warned(seen, noise=noise)


def test_an_input_that_is_held_and_recorded_where_it_changes_has_none() -> None:
    at = np.array([0.0, 0.1, 0.2, 0.5, 0.6, 0.9, 1.0, 1.1, 1.2, 1.3, 1.5, 30.0, 30.1, 30.2, 30.4, 30.5, 30.7, 40.0])
    t = H * np.arange(1000)
    u = np.arange(at.size) % 3 - 1.0
    run = ph.multirate({"u": (at, u)}, {"x": (t, 0.0 * t)}, interpolation="hold")
    x = ph.simulate(model(), TRUTH, run, initial={"x": 0.2}).outputs["x"]
    assert len(run.split()) == 1
    assert not warned(run.with_outputs({"x": x + 1e-3 * np.random.default_rng(0).standard_normal(x.size)}))


def test_reading_splits(tmp_path: Path) -> None:
    e = gapped()
    path = tmp_path / "log.csv"
    np.savetxt(path, np.column_stack([e.t, e.input("u"), e.output("x")]), delimiter=",", header="t,u,x", comments="")
    assert isinstance(ph.read(path), ph.Experiment)
    assert [part.name for part in ph.read(path, split_gaps=True)] == ["log[1]", "log[2]"]
    assert len(ph.read(path, split_gaps=100.0)) == 1
    with pytest.raises(ph.OptionError, match="read: split_gaps"):
        ph.read(path, split_gaps=-1.0)
