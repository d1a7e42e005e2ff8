"""What a planned manoeuvre would tell is what `estimate` finds when it is flown."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import input_design as example
import numpy as np
import pytest

import phugoid as ph
from phugoid import design

T = 0.05 * np.arange(161)
TRUTH = {"Zw": -1.42, "Zde": -6.26, "Mw": -0.216, "Mq": -3.7, "Mde": -12.8}
NOISE = {"w": 0.2, "q": 0.004, "az": 0.2}
U0 = 44.57


def short_period(**more: Any) -> ph.Model:
    m = ph.Model("short period")
    w, q = m.states(w="m/s", q="rad/s")
    (de,) = m.inputs(de="rad")
    Zw, Zde, Mw, Mq, Mde = m.parameters(**{n: ph.Parameter(v, unit="1/s") for n, v in TRUTH.items()})
    (b,) = m.parameters(b=ph.Parameter(per_experiment=True)) if "bias" in more else (0.0,)
    late = m.delay(de, *m.parameters(tau=0.13)) if "delay" in more else de
    m.dynamics(w=Zw * w + U0 * q + Zde * late, q=Mw * w + Mq * q + Mde * late)
    m.outputs(w=w, q=q + b, az=(Zw * w + Zde * late, "m/s²"))
    if "vane" in more:
        m.sensor_delay(w=m.parameters(tau=0.13)[0])
    if "steady" in more:
        m.initial(w=0.0, q=0.0)
    return m


def flown(kind: str = "3-2-1-1", amplitude: float = 0.05, name: str = "") -> ph.Experiment:
    shape = design.doublet if kind == "doublet" else design.three_two_one_one
    return ph.Experiment(T, {"de": shape(T, amplitude, width=0.4, start=0.5, rise=0.1)}, name=name or kind)


def measured(m: ph.Model, run: ph.Experiment, rng: np.random.Generator | None, **values: float) -> ph.Experiment:
    y = ph.simulate(m, {**TRUTH, **values}, run).outputs
    noisy = {n: v + (0.0 if rng is None else NOISE[n] * rng.standard_normal(v.size)) for n, v in y.items()}
    return run.with_outputs(noisy)


def errors(of: ph.results.Plan | ph.Fit) -> dict[str, float]:
    return {n: e.std_error for n, e in of.parameters.items() if not n.startswith("sigma")}


def test_the_errors_are_those_of_an_estimation_of_noisy_data() -> None:
    m = short_period()
    plan = ph.design.plan(m, flown(), noise=NOISE)
    fit = ph.estimate(m, measured(m, flown(), np.random.default_rng(0)))
    assert {n: plan.parameters[n].value for n in TRUTH} == TRUTH
    # The values and the noise that the fit found differ by some percent from those assumed.
    assert errors(plan) == pytest.approx(errors(fit), rel=0.1)
    first = fit.initial_states["3-2-1-1"]
    assert all(np.isfinite(e.std_error) for e in first.values())


@pytest.mark.parametrize("more", [{}, {"bias": True}, {"delay": True}, {"vane": True}, {"steady": True}, {"Mw": 0.25}])
def test_without_noise_in_the_data_they_are_the_same_to_many_digits(more: dict[str, Any]) -> None:
    m = short_period(**more)
    extra = ({"b": 0.01} if "bias" in more else {}) | ({"tau": 0.13} if {"delay", "vane"} & {*more} else {})
    extra |= {n: v for n, v in more.items() if n in TRUTH}  # unstable
    fit = ph.estimate(m, measured(m, flown(), None, **extra), noise=ph.Gaussian(NOISE), start={**TRUTH, **extra})
    assert fit.converged
    plan = ph.design.plan(m, flown(), values=extra, noise=NOISE)
    # A delay is found to a small part of its standard error, no better.
    digits = 1e-3 if "tau" in extra else 1e-5
    assert errors(plan) == pytest.approx(errors(fit), rel=digits)
    correlation = fit.covariance / np.outer(*2 * [np.sqrt(np.diag(fit.covariance))])
    assert plan.information.correlation == pytest.approx(correlation, abs=digits)


def test_estimates_of_many_simulated_flights_scatter_as_planned() -> None:
    m = short_period()
    plan = ph.design.plan(m, flown(), noise=NOISE)
    y = plan.records[0].outputs
    rng = np.random.default_rng(3)
    found = []
    for _ in range(200):
        noisy = {n: v + NOISE[n] * rng.standard_normal(v.size) for n, v in y.items()}
        fit = ph.estimate(m, flown().with_outputs(noisy), noise=ph.Gaussian(NOISE))
        found.append(fit.parameters.values_array)
    ratio = np.std(found, axis=0, ddof=1) / plan.information.std_errors
    assert ratio == pytest.approx(1.0, abs=4 / np.sqrt(2 * 199))  # four standard errors of a standard deviation
    bias = (np.mean(found, axis=0) - list(TRUTH.values())) / plan.information.std_errors * np.sqrt(200)
    assert np.abs(bias).max() < 4


def test_several_records_and_records_that_are_there_add_up() -> None:
    m = short_period(bias=True)
    runs = [flown(name="a"), flown("doublet", 0.03, name="b")]
    data = [measured(m, run, None, b=0.01) for run in runs]
    both = ph.estimate(m, data, noise=ph.Gaussian(NOISE))
    plan = ph.design.plan(m, runs, values={"b": 0.01}, noise=NOISE)
    assert errors(plan) == pytest.approx(errors(both), rel=1e-4)
    first = ph.estimate(m, data[0], noise=ph.Gaussian(NOISE))
    after = ph.design.plan(m, runs[1], values={"b": 0.01}, noise=NOISE, after=first)
    # Each flight has a bias of its own: that of the first one is not known the better by the second.
    assert {n: errors(after)[n] for n in TRUTH} == pytest.approx({n: errors(both)[n] for n in TRUTH}, rel=1e-4)
    assert errors(after)["b"] == pytest.approx(errors(both)["b[b]"], rel=1e-4)
    assert "after 'a'" in after.summary()


def test_a_fit_gives_its_values_its_noise_and_its_first_states() -> None:
    m = short_period()
    run = flown()
    fit = ph.estimate(m, measured(m, run, np.random.default_rng(1)))
    plan = ph.design.plan(fit, run)
    assert plan.sigmas == pytest.approx({n: fit.parameters[f"sigma_{n}"].value for n in NOISE})
    assert plan.records[0].outputs["q"] == pytest.approx(fit.outputs["q"], abs=1e-5)
    assert errors(plan) == pytest.approx(errors(fit), rel=0.02)


def test_outputs_of_lower_rate_tell_less() -> None:
    m = short_period()
    run = flown()
    some = np.where(np.arange(T.size) % 4 == 0, 0.0, np.nan)
    slow = run.with_outputs({"w": some, "az": some})
    plan = ph.design.plan(m, slow, noise=NOISE)
    data = measured(m, run, None)
    data = data.with_outputs({n: v + (some if n in ("w", "az") else 0.0) for n, v in data.outputs.items()})
    fit = ph.estimate(m, data, noise=ph.Gaussian(NOISE))
    assert errors(plan) == pytest.approx(errors(fit), rel=1e-5)
    assert errors(plan)["Zw"] > 1.5 * errors(ph.design.plan(m, run, noise=NOISE))["Zw"]


def test_what_is_not_told_is_named() -> None:
    m = ph.Model("lag")
    (x,) = m.states("x")
    u, v = m.inputs("u v")
    a, b, c, d = m.parameters(a=1.0, b=2.0, c=3.0, d=0.5)
    m.dynamics(x=-a * x + b * c * u + d * v)
    m.outputs(x=x)
    run = ph.Experiment(T, {"u": design.doublet(T, 1.0, width=1.0), "v": np.zeros(T.size)}, name="doublet on u")
    plan = ph.design.plan(m, run, noise={"x": 0.01})
    assert [np.isinf(plan.parameters[n].std_error) for n in "abcd"] == [False, True, True, True]
    assert plan.parameters["a"].std_error < 0.05
    silent, trade = sorted(plan.weak[:2], key=lambda w: len(w.parts))
    assert silent.parts == pytest.approx({"d": 1.0}) and set(trade.parts) == {"b", "c"}
    assert trade.parts["b"] == pytest.approx(-trade.parts["c"])  # in units of their sizes
    assert np.isinf(silent.std_error) and np.isinf(trade.std_error)
    assert plan.criteria["worst"] == np.inf and "does not determine all" in repr(plan)
    assert plan.summary().count("not determined") == 5
    told = ph.design.plan(m, run, noise={"x": 0.01}, of=["a"])
    assert told.criteria["worst"] == pytest.approx(plan.parameters["a"].std_error)


def test_a_prior_and_fixed_parameters_count() -> None:
    m = ph.Model("lag")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    a, b, c = m.parameters(a=1.0, b=ph.Parameter(2.0, prior=(2.0, 0.1)), c=ph.Parameter(3.0, fixed=True))
    (k,) = m.parameters(k=ph.Parameter(0.5, transform="log"))
    m.dynamics(x=-a * x + b * c * u + k)
    m.outputs(x=x)
    run = ph.Experiment(T, {"u": design.doublet(T, 1.0, width=1.0)})
    plan = ph.design.plan(m, run, noise={"x": 1.0})
    fit = ph.estimate(
        m,
        ph.Experiment(T, run.inputs, ph.simulate(m, {"a": 1, "b": 2, "c": 3, "k": 0.5}, run).outputs),
        noise=ph.Gaussian({"x": 1.0}),
    )
    assert np.isnan(plan.parameters["c"].std_error) and plan.parameters["c"].fixed
    for n in "abk":
        assert plan.parameters[n].std_error == pytest.approx(fit.parameters[n].std_error, rel=1e-3)
    assert plan.parameters["b"].std_error < 0.1


def test_limits_say_what_goes_where_and_when() -> None:
    m = short_period()
    plan = ph.design.plan(m, flown(), noise=NOISE, limits={"q": 0.1, "az": (-100.0, 100.0), "de": 0.05})
    q = plan.records[0].outputs["q"]
    reached = plan.excursions["3-2-1-1"]["q"]
    assert (reached.least, reached.greatest) == (q.min(), q.max())
    assert reached.when == pytest.approx(T[np.argmax(np.abs(q) > 0.1)])
    assert not plan.within_limits
    (said,) = plan.violations
    assert said.startswith("q of '3-2-1-1' leaves -0.1 to 0.1 rad/s at ")
    small = ph.design.plan(m, flown(amplitude=0.01), noise=NOISE, limits={"q": 0.1, "de": 0.01})
    assert small.within_limits


def test_manoeuvres_side_by_side() -> None:
    m = short_period()
    runs = {"doublet": flown("doublet"), "3-2-1-1": flown(), "too much": flown(amplitude=0.5)}
    plans = ph.design.plans(m, runs, noise=NOISE, limits={"q": 0.5})
    assert plans.best().name == "3-2-1-1" and plans["doublet"].criteria["D"] > plans["3-2-1-1"].criteria["D"]
    # Ten times the input tells ten times as much of a linear system, but leaves the limits.
    assert plans["too much"].criteria["A"] == pytest.approx(plans["3-2-1-1"].criteria["A"] / 10, rel=1e-4)
    text = plans.summary()
    assert "doublet" in text and "limits kept" in text and "too much: q of" in text
    figure, axes = plans.plot()
    assert set(axes) == {"de", "w", "q", "az", "errors"}
    assert len([line for line in axes["w"].lines]) == 3
    from matplotlib import pyplot as plt

    plt.close(figure)
    with pytest.raises(ph.OptionError, match="no manoeuvre stays within its limits"):
        ph.design.plans(m, runs, noise=NOISE, limits={"q": 1e-3}).best()


def test_the_criteria_are_what_they_say() -> None:
    plan = ph.design.plan(short_period(), flown(), noise=NOISE)
    relative = plan.information.covariance / np.outer(plan.sizes, plan.sizes)
    assert plan.criteria["worst"] == pytest.approx(np.sqrt(np.diag(relative).max()))
    assert plan.criteria["A"] == pytest.approx(np.sqrt(np.trace(relative) / 5))
    assert plan.criteria["D"] == pytest.approx(np.linalg.det(relative) ** (0.5 / 5))
    D = np.exp(-0.5 * np.linalg.slogdet(plan.information.matrix)[1] / 5) / np.prod(plan.sizes) ** (1 / 5)
    assert plan.criteria["D"] == pytest.approx(D)


def test_the_best_amplitude_is_at_the_limit_and_the_best_width_within() -> None:
    m = short_period()

    def make(width: float, amplitude: float) -> ph.Experiment:
        de = design.doublet(T, amplitude, width=width, start=0.5, rise=0.1)
        return ph.Experiment(T, {"de": de}, name="doublet")

    bounds = {"width": (0.1, 3.0), "amplitude": (0.005, 0.5)}
    options = {"noise": NOISE, "limits": {"q": 0.2}, "of": ["Mw", "Mq", "Mde"]}
    best = ph.design.optimal_plan(m, make, bounds, **options)
    assert best.within_limits
    assert max(map(abs, (best.excursions["doublet"]["q"].least, best.excursions["doublet"]["q"].greatest))) > 0.19
    again = ph.design.plan(m, make(**best.choice), **options)
    assert again.criteria == best.criteria
    # The system is linear: for each width the amplitude at the limit, and the error there, follow from one plan.
    bests = []
    for width in np.arange(0.1, 3.0, 0.1):
        one = ph.design.plan(m, make(width, 0.1), **options)
        reached = np.abs(one.records[0].outputs["q"]).max()
        bests.append(one.criteria["D"] / min(0.2 / reached, 5.0))
    assert min(bests) * 0.97 < best.criteria["D"] < min(bests) * 1.03
    with pytest.raises(
        ph.OptionError, match="no manoeuvre that was tried stays within its limits. The nearest: q of 'doublet'"
    ):
        ph.design.optimal_plan(m, make, {"width": (0.3, 0.5), "amplitude": (0.4, 0.5)}, generations=1, **options)


@pytest.mark.parametrize(
    ("options", "kind", "says"),
    [
        ({"noise": {"w": 0.1, "q": 0.1}}, ph.OptionError, "noise of 'az' is not known: give noise={'az': ...}"),
        ({"noise": {**NOISE, "r": 0.1}}, ph.ModelError, "'r' is not an output"),
        ({"noise": {**NOISE, "q": 0.0}}, ph.OptionError, "noise of 'q' is a positive standard deviation"),
        ({"noise": NOISE, "values": {"Mww": 1.0}}, ph.ModelError, "'Mww' is not a parameter. Did you mean 'Mw'"),
        ({"noise": NOISE, "limits": {"alpha": 1.0}}, ph.ModelError, "'alpha' is not an input, state or output"),
        ({"noise": NOISE, "limits": {"q": (1.0, -1.0)}}, ph.OptionError, "limits of 'q'"),
        ({"noise": NOISE, "of": ["M"]}, ph.ModelError, "of: 'M' is not a parameter that is estimated"),
        ({"noise": NOISE, "sizes": {"Mq": -1.0}}, ph.OptionError, "the size of 'Mq'"),
        ({"noise": NOISE, "initial": {"u": 1.0}}, ph.ModelError, "initial 'u' is not a state"),
        ({"noise": NOISE, "after": "fit"}, ph.OptionError, "after is a fit"),
        ({"noise": NOISE, "transcription": ph.SingleShooting()}, ph.OptionError, "transcription is a Collocation"),
        ({"noise": NOISE, "values": {"Mw": 1e4}}, ph.EvaluationError, "short period"),
    ],
)
def test_what_cannot_be_is_refused_in_words(options: dict[str, Any], kind: type[Exception], says: str) -> None:
    with pytest.raises(kind, match=says.replace("...", r"\.\.\.").replace("{", r"\{").replace("}", r"\}")):
        ph.design.plan(short_period(), flown(), **options)


def test_a_model_is_asked_for() -> None:
    with pytest.raises(ph.ModelError, match="a Model or a Fit, not a str"):
        ph.design.plan("model", flown())  # type: ignore[arg-type]
    with pytest.raises(ph.DataError, match="give the manoeuvres by name"):
        ph.design.plans(short_period(), [flown()])  # type: ignore[arg-type]
    robust = short_period()
    robust.noise(ph.Huber())
    with pytest.raises(ph.OptionError, match="that of the model is"):
        ph.design.plan(robust, flown())


def test_a_fit_that_was_loaded_serves_too(tmp_path: Path) -> None:
    m = short_period()
    fit = ph.estimate(m, measured(m, flown(), np.random.default_rng(1)))
    fit.save(tmp_path / "fit.json")
    again = ph.load(tmp_path / "fit.json")
    assert errors(ph.design.plan(again, flown(), after=again)) == pytest.approx(
        errors(ph.design.plan(fit, flown(), after=fit))
    )


def test_the_example_keeps_its_limits_and_multisines_tell_most() -> None:
    runs = {
        "doublets": example.steps("doublets", 4.5 * example.DEG, 3.7 * example.DEG),
        "3-2-1-1": example.steps("3-2-1-1", 3.4 * example.DEG, 3.6 * example.DEG),
        "multisines": example.sines(2.3 * example.DEG, 3.7 * example.DEG),
    }
    plans = ph.design.plans(example.model(), runs, noise=example.NOISE, limits=example.LIMITS)
    assert all(p.within_limits for p in plans.values())
    criteria = [p.criteria["D"] for p in plans.values()]
    assert criteria == sorted(criteria, reverse=True) and criteria[2] < 0.65 * criteria[0]
    ratios = example.scatter(plans["multisines"], 60)
    assert np.sqrt(np.mean(np.square(list(ratios.values())))) == pytest.approx(1.0, abs=0.1)
