"""Manoeuvres found in a long record: their spans and kinds, what is not a manoeuvre, and records cut out of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import attas
import numpy as np
import pytest
from matplotlib import pyplot as plt
from scipy.signal import lfilter

import phugoid as ph
from phugoid import design

T = np.arange(0.0, 400.0, 0.02)
TRUTH = [  # input, kind, start, end
    ("de", "doublet", 20.0, 21.0),
    ("de", "3-2-1-1", 40.0, 44.2),
    ("de", "pulse", 60.0, 61.0),
    ("de", "sweep", 80.0, 140.0),
    ("de", "step", 190.0, None),
    ("de", "step", 240.0, None),
    ("da", "multisine", 280.0, 310.0),
    ("de", "multisine", 280.0, 310.0),
    ("da", "sine", 330.0, 340.0),
]


@cache
def flown() -> tuple[np.ndarray, np.ndarray]:
    """Elevator and aileron with one manoeuvre of each kind."""
    de = design.doublet(T, 0.05, width=0.5, start=20) + design.three_two_one_one(T, -0.04, width=0.6, start=40)
    de += design.pulse(T, 0.05, width=1, start=60) + design.sweep(T, 0.04, band=(0.1, 2.0), start=80, duration=60)
    de += design.step(T, 0.03, start=190) - design.step(T, 0.03, start=240)
    da = np.zeros_like(T)
    part, inside = np.arange(0.0, 30.0, 0.02), slice(14000, 15500)
    de[inside] += design.multisine(part, 0.03, band=(0.1, 2.0))
    da[inside] += design.multisine(part, 0.05, band=(0.15, 2.0))
    da[16500:17000] += 0.03 * np.sin(2 * np.pi * part[:500])
    return de, da


@cache
def log(sigma: float = 0.0, seed: int = 0) -> ph.Experiment:
    """The controls with noise, and a rate that follows the elevator."""
    rng, (de, da) = np.random.default_rng(seed), flown()
    q = lfilter([0.05], [1, -0.95], de) + 0.001 * rng.standard_normal(T.size)
    noisy = {"de": de + sigma * rng.standard_normal(T.size), "da": da + sigma * rng.standard_normal(T.size)}
    return ph.Experiment(T, noisy, {"q": q}, name="log", units={"de": "rad"})


@pytest.mark.parametrize("sigma", [0.0, 0.001, 0.003])
def test_each_kind_is_found(sigma: float) -> None:
    # The multisines begin at the same time: noise decides which is first.
    found = sorted(ph.manoeuvres(log(sigma)), key=lambda m: (round(m.start / 5.0), m.input))
    assert [(m.input, m.kind) for m in found] == [(name, kind) for name, kind, *_ in TRUTH]
    for m, (_, kind, start, end) in zip(found, TRUTH, strict=True):
        assert m.start == pytest.approx(start, abs=0.6)
        assert end is None or m.end == pytest.approx(end, abs=1.5)
        assert kind != "sweep" or m.band == pytest.approx((0.11, 1.7), abs=0.1)
    multisine = found[7]
    assert set(multisine.together) == {"da"} and abs(multisine.together["da"]) < 0.2
    assert found[0].amplitude == pytest.approx(0.05, abs=4 * sigma + 1e-9) and found[0].unit == "rad"
    # The rate follows the elevator, and not the aileron.
    assert found[0].snr["q"] > 10 and found[8].snr["q"] < 1
    with pytest.raises(KeyError, match="Did you mean 'q'"):
        found[0].snr["Q"]


def test_signal_to_noise_ratio_is_that_of_the_simulation() -> None:
    run = log()
    m = ph.manoeuvres(run)[3]
    inside = (m.start <= T) & (m.end >= T)
    clean = lfilter([0.05], [1, -0.95], run.input("de"))
    assert m.snr["q"] == pytest.approx(clean[inside].std() / 0.001, rel=0.1)


def test_controls_that_never_rest_are_continuous() -> None:
    rng = np.random.default_rng(3)
    u = lfilter([0.02], [1, -0.98], rng.standard_normal(T.size))
    found = ph.manoeuvres(ph.Experiment(T, {"de": u}))
    assert sum(m.end - m.start for m in found if m.kind == "continuous") > 0.8 * sum(m.end - m.start for m in found)


def feedback(seed: int) -> Any:
    """What an autopilot does in turbulence for 400 s, after a calm start of 50 s: most of it small, with some gusts."""
    random = np.random.default_rng(seed)
    slow, fast = (lfilter([1 - a], [1, -a], random.standard_normal(T.size)) for a in (0.999, 0.98))
    gusts = np.exp(lfilter([0.001], [1, -0.999], 40.0 * random.standard_normal(T.size)))
    u = gusts * (slow / slow.std() + fast / fast.std())
    return np.where(T < 50.0, 0.0, 0.02 * u / np.abs(u).max())


@pytest.mark.parametrize("seed", range(5))
def test_an_autopilot_in_turbulence_flies_no_manoeuvres(seed: int) -> None:
    found = ph.manoeuvres(ph.Experiment(T, {"de": feedback(seed)}, name="log"))
    claimed = [m for m in found if m.kind != "continuous"]
    assert len(claimed) <= 1 and len(found) <= 8
    assert "continuous span" in found.summary().splitlines()[0]


@pytest.mark.parametrize("seed", range(5))
def test_manoeuvres_that_stand_out_of_turbulence_are_found(seed: int) -> None:
    de = feedback(seed) + design.doublet(T, 0.25, width=1.0, start=120) + design.pulse(T, 0.25, width=1.0, start=250)
    found = [m for m in ph.manoeuvres(ph.Experiment(T, {"de": de})) if m.kind != "continuous"]
    assert [m.start for m in found] == [pytest.approx(120.0, abs=0.6), pytest.approx(250.0, abs=0.6)]


@pytest.mark.parametrize("width", [3.0, 16.0])
def test_a_pulse_ends_where_the_input_is_back(width: float) -> None:
    (m,) = ph.manoeuvres(ph.Experiment(T, {"de": design.pulse(T, 0.05, width=width, start=100)}))
    assert m.kind == "pulse" and m.span == (pytest.approx(100.0, abs=0.1), pytest.approx(100.0 + width, abs=0.1))


def steps(rate: float, lengths: Sequence[float], heights: Sequence[float], rise: float = 0.0) -> str:
    """Return the kind that is found for steps up and down, sampled at ``rate`` (Hz), of lengths in s, in some noise."""
    t = np.arange(0.0, 40.0, 1.0 / rate)
    edges = 20.0 + np.concatenate([[0.0], np.cumsum(lengths)])
    times = np.concatenate([[0.0], *([e, e + rise + 1e-6] for e in edges), [40.0]])
    u = np.interp(t, times, np.repeat([0.0, *heights, 0.0], 2))
    u += 0.01 * np.random.default_rng(round(rate)).standard_normal(t.size)
    (found,) = ph.manoeuvres(ph.Experiment(t, {"de": u}))
    return found.kind


@pytest.mark.parametrize("rate", [8.0, 25.0, 50.0, 200.0])
@pytest.mark.parametrize("unit", [0.5, 1.0])
@pytest.mark.parametrize("rise", [0.0, 0.2])
def test_a_3211_is_recognised_at_any_rate_with_steps_a_bit_off(rate: float, unit: float, rise: float) -> None:
    rng = np.random.default_rng(0)
    for _ in range(10):
        lengths = unit * np.array([3.0, 2.0, 1.0, 1.0]) * rng.uniform(0.85, 1.15, 4)
        heights = np.array([1.0, -1.0, 1.0, -1.0]) * rng.uniform(0.7, 1.0, 4)
        assert steps(rate, lengths, heights, rise) == "3-2-1-1"


def test_a_3211_flown_by_hand_is_recognised() -> None:
    # As on the two ATTAS records: the first step too brief, or those to one side half as high.
    for lengths, heights in (([2.1, 2.1, 1, 1], [-42, 32, -39, 39]), ([2.4, 2, 0.8, 0.8], [38, -58, 35, -62])):
        for rate in (10.0, 25.0, 100.0):
            assert steps(rate, lengths, 0.02 * np.array(heights), 0.15) == "3-2-1-1"


@pytest.mark.parametrize("lengths", [[1, 1, 1, 1], [4, 3, 2, 1], [1, 1, 2, 3], [1, 2, 1], [3, 1, 1, 1]])
def test_other_steps_are_no_3211(lengths: list[float]) -> None:
    for rate in (10.0, 50.0, 200.0):
        assert steps(rate, lengths, (-1.0) ** np.arange(len(lengths))) == "multistep"


def test_the_manoeuvres_of_attas_are_3211s(published: Callable[[str], Path]) -> None:
    for name in ("fAttasElv1.mat", "fAttasElv2.mat"):
        published(name)
    for run in attas.records():
        assert [m.kind for m in ph.manoeuvres(run)] == ["3-2-1-1"]


def test_a_flight_of_an_autopilot_has_hardly_any(published: Callable[[str], Path]) -> None:
    names = [f"actuator_controls_0.control[{i}]" for i in range(3)]
    path = published("solar_uav_px4")
    run = ph.read(path, time="timestamp_sample", inputs=names, outputs=["vehicle_angular_velocity.xyz[1]"])
    claimed = [m for m in ph.manoeuvres(run) if m.kind != "continuous"]
    assert len(claimed) <= 5
    assert [m.input for m in claimed if abs(m.start - 592.0) < 1.0] == names[:2]  # set to other values on the ground


def test_the_manoeuvres_of_the_hfb320(published: Callable[[str], Path]) -> None:
    columns = ["T", "DELV", *(f"channel{i}" for i in range(18))]
    path = published("hfb320_1_10.asc")
    run = ph.read(path, columns=columns, time="T", inputs=["DELV"], outputs=["channel0"])
    first, second = ph.manoeuvres(run)
    assert (first.kind, second.kind) == ("3-2-1-1", "pulse")
    assert first.span == (pytest.approx(4.5, abs=0.5), pytest.approx(11.8, abs=0.5))
    assert second.span == (pytest.approx(25.4, abs=0.5), pytest.approx(41.8, abs=0.6))


def test_what_is_no_manoeuvre() -> None:
    spike = np.zeros(T.size)
    spike[5000] = 1.0
    assert len(ph.manoeuvres(ph.Experiment(T, {"de": spike, "da": np.full(T.size, 0.2)}))) == 0
    ramp = 1e-4 * T
    assert all(m.kind == "continuous" for m in ph.manoeuvres(ph.Experiment(T, {"de": ramp})))
    assert [m.kind for m in ph.manoeuvres(ph.Experiment(T, {"de": spike}), shortest=0.02)] == ["pulse"]


def test_records_are_cut_out_once() -> None:
    run = log()
    found = ph.manoeuvres(run)
    parts = found.cut(before=1.0, after=2.0)
    assert [p.name for p in parts][:2] == ["log[1]", "log[2]"]
    assert len(parts) == 8  # the two multisines are one record
    assert (parts[0].t[0], parts[0].t[-1]) == (pytest.approx(19.0), pytest.approx(23.0))
    assert [m.input for m in found.of("da")] == ["da", "da"]
    assert [m.kind for m in found.of("de", "step", "doublet")] == ["doublet", "step", "step"]
    assert [p.n for p in run.cut(found[:1])] == [51]
    assert [p.n for p in run.cut([(0.0, 1.0), (0.5, 2.0), (5.0, 6.0)])] == [101, 51]


def test_inputs_with_samples_of_their_own() -> None:
    slow, u = T[::5], np.where((T >= 50) & (T < 51), 1.0, 0.0)[::5]
    run = ph.multirate({"de": (slow, u)}, {"q": (T, np.zeros(T.size))}, name="log")
    (m,) = ph.manoeuvres(run)
    assert m.kind == "pulse" and m.span == (pytest.approx(50.0, abs=0.1), pytest.approx(51.0, abs=0.1))


def test_what_is_shown() -> None:
    found = ph.manoeuvres(log())
    lines = found.summary().splitlines()
    assert lines[0] == "log: 9 manoeuvres" and "doublet" in lines[4] and "together" in lines[2]
    assert "<table" in found._repr_html_() and str(found[0]) == "doublet of de, 20.0 to 21.0"
    figure, axes = found.plot()
    assert list(axes) == ["de", "da"] and len(axes["da"].patches) == 2
    plt.close(figure)
    pytest.importorskip("pandas")
    table = found.to_pandas()
    assert list(table["kind"]) == [m.kind for m in found] and "snr_q" in table


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: ph.manoeuvres(3), "the first argument is an Experiment"),
        (lambda: ph.manoeuvres(ph.Experiment(T, outputs={"q": T})), "has no inputs; name some"),
        (lambda: ph.manoeuvres(log(), ["elevator"]), "has no input 'elevator'"),
        (lambda: ph.manoeuvres(log(), "de"), r"inputs=\['de'\]"),
        (lambda: ph.manoeuvres(log(), outputs=["p"]), "has no output 'p'"),
        (lambda: ph.manoeuvres(log(), threshold=2.0), "below 1"),
        (lambda: ph.manoeuvres(log(), gap=-1.0), "gap is a positive number"),
        (lambda: ph.manoeuvres(log()).of("dr"), "'dr' is neither an input"),
        (lambda: ph.manoeuvres(log()).cut(before=-1.0), "before is a number from 0"),
        (lambda: ph.manoeuvres(log())[:0].cut(), "no manoeuvres were found in 'log'"),
        (lambda: log().cut([(3.0, 2.0)]), "ends before it begins"),
        (lambda: log().cut([3.0]), "spans are pairs of times"),
    ],
)
def test_bad_input(call: Any, words: str) -> None:
    with pytest.raises(ph.PhugoidError, match=words):
        call()
