"""Which manoeuvre would tell a cause from its aliases, and that it does."""

from __future__ import annotations

import functools

import numpy as np
import pytest

import phugoid as ph
from phugoid.discrepancy.discrimination import DISCRIMINATES, advised, discrimination_advice
from phugoid.discrepancy.discrimination.candidate_manoeuvres import CandidateManoeuvres, manoeuvres_of_size
from phugoid.discrepancy.discrimination.manoeuvre_response import BatchSimulation, ManoeuvreResponse
from phugoid.discrepancy.search.refit import Refit, refit

TRUTH = {"k": 4.0, "d": 0.8, "b": 1.0}
SIGMA = {"x": 0.01, "v": 0.02}
T = 0.05 * np.arange(401)


def oscillator(cubic: float = 0.0, late: float = 0.0) -> ph.Model:
    """A mass on a spring; with a cubic one, or a late sensor, for the truth."""
    m = ph.Model("oscillator")
    x, v = m.states(x="m", v="m/s")
    (u,) = m.inputs(u="N")
    k, d, b = m.parameters(k=3.0, d=1.0, b=0.7)
    f, drive = m.quantities(f=-k * x - d * v - cubic * x**3, drive=b * u)
    m.dynamics(x=v, v=f + drive)
    m.outputs(x=x, v=v)
    if late:
        m.sensor_delay(x=m.parameters("late")[0])
    return m


def measured(m: ph.Model, values: dict[str, float], data: ph.Experiment, seed: int, **initial: float) -> ph.Experiment:
    """With white noise."""
    r, rng = ph.simulate(m, values, data, initial={"x": 0.0, "v": 0.0} | initial), np.random.default_rng(seed)
    return data.with_outputs({n: y + SIGMA[n] * rng.standard_normal(y.size) for n, y in r.outputs.items()})


def refits(data: ph.Experiment, *names: str) -> list[Refit]:
    """The oscillator with each of some candidates."""
    base = Refit((), ph.estimate(oscillator(), data))
    library = {c.name: c for c in ph.candidates(base.fit.model, points=base.linear.points)}
    found = [refit(base.fit, [library[n]], {}) for n in names]
    assert all(found)
    return [r for r in found if r]


@functools.cache
def stiff() -> list[Refit]:
    """Pulses of one size on a spring that is a little cubic."""
    u = np.where((T > 2) & (T < 3), 2.0, 0.0) - np.where((T > 9) & (T < 10), 2.0, 0.0)
    data = measured(oscillator(0.9), TRUTH, ph.Experiment(T, {"u": u}), seed=1)
    return refits(data, "f:x^3", "f:x|x|", "drive:x^3")


@functools.cache
def late() -> list[Refit]:
    """A late sensor, that has seen slow motion only."""
    u = 1.5 * np.sin(0.9 * T) + np.sin(0.4 * T)
    data = measured(oscillator(late=0.08), TRUTH | {"late": 0.08}, ph.Experiment(T, {"u": u}), seed=2)
    return refits(data, "x:delay", "x:lag")


def pace(u: np.ndarray) -> float:
    """Mean frequency of a signal, rad/s."""
    return float(np.sqrt(np.sum(np.diff(u) ** 2) / np.sum((u - u.mean()) ** 2)) / (T[1] - T[0]))


def test_a_faster_input_tells_a_late_sensor_from_a_slow_one() -> None:
    final, rival = late()
    advice = advised(final, [rival])
    (told,) = advice.manoeuvres
    assert told.gains["x:lag"] > DISCRIMINATES > 2 * told.here
    assert not advice.alike
    assert pace(told.record.input("u")) > 1.5 * pace(final.fit.records[0].inputs["u"])
    assert "distinguish it from x:lag (expected gain in log-likelihood" in str(advice)


def test_a_larger_motion_tells_two_nonlinear_springs_apart() -> None:
    final, rival, _ = stiff()
    flights = CandidateManoeuvres(final)
    gains = flights.gains(rival, 0.0)
    by: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for m, g in zip(flights.manoeuvres, gains, strict=True):
        by.setdefault((m.kind, m.pace), []).append((abs(m.size), float(g)))
    for sizes in by.values():
        ordered = [g for _, g in sorted(sizes)]
        assert ordered == sorted(ordered) or max(ordered) < 1.0
    (told,) = advised(final, [rival]).manoeuvres
    assert told.gains == {"f:x|x|": pytest.approx(gains.max())}
    assert told.gains["f:x|x|"] > DISCRIMINATES > told.here


def test_nothing_tells_one_effect_by_two_names() -> None:
    final, other, same = stiff()
    assert CandidateManoeuvres(final).gains(same, 0.0).max() < 1e-3
    text = discrimination_advice(final, [same])
    assert text.startswith("No manoeuvre of u tried here")
    assert text.endswith("is expected to distinguish it from drive:x^3.")
    # Beside a rival that can be told, both are said.
    both = advised(final, [same, other])
    assert [list(t.gains) for t in both.manoeuvres] == [["f:x|x|"]]
    assert both.alike == ("drive:x^3",)


@pytest.mark.parametrize("pair", [stiff, late], ids=["springs", "sensors"])
def test_data_of_the_manoeuvre_give_what_was_expected(pair: functools._lru_cache_wrapper[list[Refit]]) -> None:
    final, rival = pair()[:2]
    (told,) = advised(final, [rival]).manoeuvres
    first = {n: float(x) for n, x in final.fit.initial_states["experiment"].items()}
    values = {n: e.value for n, e in final.fit.parameters.items()}
    gains = []
    for seed in range(4):
        r, rng = ph.simulate(final.fit.model, values, told.record, initial=first), np.random.default_rng(seed)
        data = told.record.with_outputs({n: y + SIGMA[n] * rng.standard_normal(y.size) for n, y in r.outputs.items()})
        fits = []
        for model in (final.fit.model, rival.fit.model):
            known = {**rival.fit.parameters.to_dict(), **values}
            start = {n: known[n] for n in model.parameter_names}
            fits.append(ph.estimate(model, data, noise=ph.Gaussian(SIGMA), start=start))
        assert all(f.status in ("converged", "acceptable") for f in fits)
        gains.append(fits[0].log_likelihood - fits[1].log_likelihood)
    (expected,) = told.gains.values()
    # Its standard deviation is the root of twice the expected gain.
    assert expected / 2 < np.mean(gains) < 2 * expected


def test_flights_stay_within_the_envelope_until_they_are_over() -> None:
    final, *_ = stiff()
    flights, record = CandidateManoeuvres(final), final.fit.records[0]
    assert {m.kind for m in flights.manoeuvres} >= {"doublet", "3-2-1-1", "sine sweep", "slow ramp"}
    for m, y, end in zip(flights.manoeuvres, flights.y, flights.ends, strict=True):
        assert end >= m.done
        for v, name in zip(y, ("x", "v"), strict=True):
            assert np.abs(v[:end] - v[0]).max() <= 2 * np.abs(record.outputs[name] - record.outputs[name][0]).max()


def test_what_never_was_negative_stays_so() -> None:
    m = ph.Model("tank")
    (h,) = m.states(h="m")
    (flow,) = m.inputs(flow="m/s")
    k, c = m.parameters(k=1.0, c=0.2)
    m.dynamics(h=k * flow - c * h)
    m.outputs(h=h)
    data = ph.Experiment(T, {"flow": np.where((T > 3) & (T < 9), 0.5, 0.1)})
    level = ph.simulate(m, {"k": 1.2, "c": 0.3}, data, initial={"h": 0.5}).outputs["h"]
    noise = 0.01 * np.random.default_rng(0).standard_normal(T.size)
    flights = CandidateManoeuvres(Refit((), ph.estimate(m, data.with_outputs({"h": level + noise}))))
    assert len(flights.manoeuvres) > 5
    assert flights.inputs.min() >= 0.0
    assert max(flights.inputs[:, 0].max(axis=1)) > 0.4  # those to the other side are there


def roll(rate: float, ref: np.ndarray) -> Refit:
    """A roll rate that grows as exp(rate t) where no feedback holds it, as it did in the record."""
    m, closed = ph.Model("roll"), ph.Model("closed")
    for model in (m, closed):
        (p,) = model.states(p="rad/s")
        (u,) = model.inputs(da="rad")
        a, b = model.parameters(a=0.5 * rate, b=1.0)
        model.dynamics(p=a * p + b * (u if model is m else u - 5.0 * p))
        model.outputs(p=p)
    t = T[: ref.size]
    p = ph.simulate(closed, {"a": rate, "b": 1.0}, ph.Experiment(t, {"da": ref}), initial={"p": 0.0}).outputs["p"]
    noisy = p + 1e-3 * np.random.default_rng(0).standard_normal(p.size)
    return Refit((), ph.estimate(m, ph.Experiment(t, {"da": ref - 5.0 * p}, {"p": noisy})))


def test_an_unstable_vehicle_is_not_let_go() -> None:
    """It is flown as long as it stays near, if the manoeuvre is over by then."""
    wave = 0.2 * np.sin(2 * T[:101])
    held, free = CandidateManoeuvres(roll(-1.0, wave)), CandidateManoeuvres(roll(3.0, wave))
    assert {"sine sweep", "doublet"} <= {m.kind for m in held.manoeuvres}
    assert "sine sweep" not in {m.kind for m in free.manoeuvres}
    assert max(held.ends) == 101 > max(free.ends)
    assert all(end >= m.done for m, end in zip(free.manoeuvres, free.ends, strict=True))
    assert [m.kind for m in free.manoeuvres]


def test_without_an_input_that_moves_there_is_no_advice() -> None:
    m = ph.Model("decay")
    (x,) = m.states(x="m")
    (u,) = m.inputs(u="N")
    (a,) = m.parameters(a=1.0)
    m.dynamics(x=-a * x + u)
    m.outputs(x=x)
    y = 2.0 * np.exp(-T) + 0.5 + 0.01 * np.random.default_rng(0).standard_normal(T.size)
    fit = ph.estimate(m, ph.Experiment(T, {"u": np.full(T.size, 0.5)}, {"x": y}))
    library = {c.name: c for c in ph.candidates(m, points=Refit((), fit).linear.points)}
    found = [refit(fit, [library[n]], {}) for n in ("x':x^2", "x':x^3")]
    final, rival = [r for r in found if r]
    assert discrimination_advice(final, [rival]) == ""
    assert discrimination_advice(final, []) == ""


def test_on_a_disturbance_there_is_no_advice() -> None:
    """The next record has another one."""
    final, rival, _ = stiff()
    wave = refits(final.fit.experiments[0], "f:periodic")[0]
    assert discrimination_advice(wave, [rival]) == ""
    assert discrimination_advice(final, [rival]) != ""


def test_batches_integrate_as_simulate_does() -> None:
    """Inputs and sensors that are late, a lag from a steady start, other values in each lane."""
    m = ph.Model("late")
    x, z = m.states(x="m", z="m")
    (u,) = m.inputs(u="N")
    a, tau, later, early = m.parameters("a tau later early")
    m.dynamics(x=-a * x + m.delay(u, later) - 0.1 * x**3, z=(x - z) / tau)
    m.initial(z=x)
    m.outputs(x=x, z=z, f=a * x + u)
    m.sensor_delay(x=early)
    u0 = 0.5 + np.array([np.sin(T), np.where(T > 3, 1.0, 0.0)])[:, None]
    values = np.array([[1.0, 0.3, 0.12, 0.07], [2.0, 0.02, 0.03, 0.13]])
    first = np.array([[0.3, 0.3], [0.2, 0.2]])
    batch = BatchSimulation(m, T, values[1], first[1], np.array([0.5]), np.ones(first.shape[1]))
    assert batch.steps > 1  # of the lag of 0.02 s
    y, states = batch.outputs(values, first, u0, np.array([0, 1]))
    for i in range(2):
        data = ph.Experiment(T, {"u": u0[i, 0]})
        r = ph.simulate(m, dict(zip(m.parameter_names, values[i], strict=True)), data, initial={"x": first[i, 0]})
        for k, name in enumerate(m.output_names):
            there = np.isfinite(r.outputs[name])
            assert there.sum() > 390
            np.testing.assert_allclose(y[i, k, there], r.outputs[name][there], atol=3e-3 if name == "x" else 1e-3)
        np.testing.assert_allclose(states[i, 0], r.states["x"], atol=1e-3)


def test_tangents_are_differences_of_flights() -> None:
    final, *_ = late()
    u = np.zeros((1, 1, T.size))
    u[0, 0, 40:80] = 1.0
    response = ManoeuvreResponse(final, T, np.zeros(1))
    moved = response.tangents(u)[0]
    for k in range(response.units.size):
        to = np.zeros((2, response.units.size))
        to[:, k] = 0.02, -0.02
        y, _ = response.simulate(u, to, np.zeros(2, dtype=np.intp))
        np.testing.assert_allclose(moved[k], (y[0] - y[1]) / 0.04, atol=0.03 * np.abs(moved[k]).max())


def test_manoeuvres_are_what_they_are_called() -> None:
    for m in manoeuvres_of_size("de", "rad", T, -0.05):
        assert np.abs(m.moves).max() <= 0.05 * (1 + 1e-12)
        assert not m.moves[:20].any()  # trim first
        assert 20 < m.done <= T.size
        heights = np.unique(np.round(m.moves / -0.05, 9))
        if m.kind in ("doublet", "3-2-1-1"):
            assert heights.tolist() == [-1, 0, 1]
            assert not m.moves[m.done :].any()
        if m.kind == "3-2-1-1":
            step = float(m.pace.split()[-2])
            edges = T[np.flatnonzero(np.diff(m.moves)) + 1]
            np.testing.assert_allclose(np.diff(edges), step * np.array([3, 2, 1, 1]), rtol=0.05)
        assert str(m).startswith(f"{m.kind} on de of {'-' if m.kind in ('step', 'slow ramp') else '±'}0.05 rad")


def test_a_diagnosis_gives_the_advice() -> None:
    final, *_ = stiff()
    base = ph.estimate(oscillator(), final.fit.experiments)
    linear = Refit((), base).linear
    some = [c for c in ph.candidates(base.model, points=linear.points) if c.name in ("f:x^3", "drive:x^3", "f:u|u|")]
    d = ph.diagnose(base, some)
    (finding,) = d.findings
    assert {finding.cause, *finding.aliases} == {"f:x^3", "drive:x^3"}
    assert finding.advice.startswith("No manoeuvre of u tried here")
    assert finding.advice.endswith(f"is expected to distinguish it from {finding.aliases[0]}.")
    assert finding.advice in " ".join(d.summary().split())
