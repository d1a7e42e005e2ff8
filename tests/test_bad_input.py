"""What estimate refuses, each time in the user's names and with what to do."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import phugoid as ph
from phugoid import (
    Collocation,
    DataError,
    EvaluationError,
    Experiment,
    Expr,
    Gaussian,
    Ipopt,
    Model,
    ModelError,
    OptionError,
    Parameter,
    Sigma,
)

NAN, INF = float("nan"), float("inf")
T = np.linspace(0.0, 2.0, 21)
U = np.sin(T)
X = 0.5 * np.sin(T - 0.3) + 0.01 * np.cos(37 * T)


def lag() -> Model:
    m = Model("lag")
    (x,) = m.states(x="m")
    (u,) = m.inputs(u="m")
    tau, gain = m.parameters(tau=Parameter(1.0, bounds=(0.01, 100.0)), gain=Parameter(1.0, fixed=True))
    m.dynamics(x=(gain * u - x) / tau)
    m.outputs(x=x)
    return m


def run(**changes: Any) -> Experiment:
    return Experiment(**{"t": T, "inputs": {"u": U}, "outputs": {"x": X}, "name": "run1", **changes})


def spoilt(values: np.ndarray, index: int, value: float) -> np.ndarray:
    changed = values.copy()
    changed[index] = value
    return changed


def refuses(error: type[Exception], words: str, call: Callable[[], Any]) -> None:
    with pytest.raises(error, match=words):
        call()


def test_the_unspoilt_case_is_accepted() -> None:
    assert ph.estimate(lag(), run()).converged


# ---------------------------------------------------------------- data


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"inputs": {"U": U}}, r"experiment 'run1' has no input 'u'\. Did you mean 'U'\?.*\.rename"),
        ({"inputs": None}, r"experiment 'run1' has no input 'u'\. There are: none"),
        ({"outputs": {"y": X}}, r"experiment 'run1' has no output 'x'\. There are: y"),
        ({"outputs": None}, r"experiment 'run1' has no output 'x'"),
        ({"inputs": {"u": U, "x": X}, "outputs": None}, r"no output 'x'\. It is there as an input"),
        ({"inputs": {"u": U[:-1]}}, r"input 'u': has 20 values, but time has 21"),
        ({"outputs": {"x": np.append(X, 0.0)}}, r"output 'x': has 22 values, but time has 21"),
        ({"outputs": {"x": X[:, np.newaxis]}}, r"output 'x': has shape \(21, 1\)"),
        ({"t": spoilt(T, 3, 0.2)}, r"sample 3 \(0\.2\) does not come after sample 2 .* sort the record"),
        ({"t": T[::-1]}, r"time must increase strictly"),
        ({"t": spoilt(T, 3, NAN)}, r"time: sample 3 is nan"),
        ({"outputs": {"x": NAN * X}}, r"output 'x': is NaN throughout; remove the output"),
        ({"inputs": {"u": spoilt(U, 4, NAN)}}, r"input 'u': sample 4 \(t = 0\.4\) is nan; .* interpolate them, or cut"),
        ({"inputs": {"u": spoilt(U, 4, INF)}}, r"input 'u': sample 4 \(t = 0\.4\) is inf"),
        ({"outputs": {"x": spoilt(X, 5, -INF)}}, r"output 'x': sample 5 \(t = 0\.5\) is -inf; mark a missing"),
        ({"outputs": {"x": 0 * X + 3}}, r"output 'x': is 3 throughout \(zero variance\).* give its σ as known"),
    ],
)
def test_data_as_inputs_and_outputs(changes: dict[str, Any], words: str) -> None:
    refuses(DataError, words, lambda: ph.estimate(lag(), run(**changes)))


@pytest.mark.parametrize(
    ("channels", "words"),
    [
        ({"x": X}, r"experiment 'run1' has no input 'u'"),
        ({"u": U, "X": X}, r"experiment 'run1' has no output 'x'\. Did you mean 'X'"),
        ({"u": spoilt(U, 4, NAN), "x": X}, r"input 'u': sample 4 \(t = 0\.4\) is nan"),
        ({"u": U, "x": NAN * X}, r"output 'x': is NaN throughout"),
        ({"u": U, "x": spoilt(X, 5, INF)}, r"output 'x': sample 5 \(t = 0\.5\) is inf"),
        ({"u": U, "x": np.zeros(21)}, r"output 'x': is 0 throughout \(zero variance\)"),
    ],
)
def test_data_as_channels_that_the_model_tells_apart(channels: dict[str, Any], words: str) -> None:
    refuses(DataError, words, lambda: ph.estimate(lag(), run(inputs=None, outputs=None, channels=channels)))


def test_extra_channels_do_no_harm() -> None:
    extra = {"u": U, "x": X, "dead": 0 * X, "gaps": NAN * X}
    assert ph.estimate(lag(), run(inputs=None, outputs=None, channels=extra)).converged


@pytest.mark.parametrize("noise", [Gaussian({"x": 0.1}), Gaussian({"x": np.float32(0.1)}), Gaussian({"x": 1})])
def test_output_without_variance_is_accepted_where_its_sigma_is_known(noise: Gaussian) -> None:
    assert ph.estimate(lag(), run(outputs={"x": 0 * X + 3}), noise=noise).converged


def test_model_with_more_outputs_than_the_data() -> None:
    m = lag()
    m.outputs(rate=Expr.symbol("x") / 2)
    refuses(DataError, r"experiment 'run1' has no output 'rate'\. There are: x", lambda: ph.estimate(m, run()))


def test_the_experiment_at_fault_is_named() -> None:
    both = [run(), run(name="run2", outputs={"y": X})]
    refuses(DataError, "experiment 'run2' has no output 'x'", lambda: ph.estimate(lag(), both))


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ([], "the list of experiments is empty"),
        ([run(), run()], "two experiments are called 'run1'; give each a name of its own"),
        ({"u": U, "x": X}, r"data is an Experiment or a list of them, not .*; make one with ph\.read"),
        ([run(), None], "data is an Experiment or a list of them"),
        ("run1.csv", "data is an Experiment or a list of them"),
    ],
)
def test_data_that_are_no_experiments(data: Any, words: str) -> None:
    refuses(DataError, words, lambda: ph.estimate(lag(), data))


def test_model_and_data_swapped() -> None:
    refuses(DataError, "data is an Experiment", lambda: ph.estimate(run(), lag()))  # type: ignore[arg-type]


def test_model_that_is_none() -> None:
    refuses(ModelError, "the first argument is a Model, not a str", lambda: ph.estimate("lag", run()))  # type: ignore[arg-type]


def test_incomplete_model() -> None:
    m = Model("half")
    m.states("x")
    refuses(ModelError, "model 'half': it has no outputs", lambda: ph.estimate(m, run()))


# ---------------------------------------------------------------- start


@pytest.mark.parametrize(
    ("start", "error", "words"),
    [
        ({"Tau": 1.0}, ModelError, r"'Tau' is not a parameter, sigma or state\. Did you mean 'tau'\?"),
        ({"sigma_X": 1.0}, ModelError, r"'sigma_X' is not a .* Did you mean 'sigma_x'\?"),
        ({"u": 1.0}, ModelError, "'u' is not a parameter, sigma or state"),
        ({"tau": 1000.0}, ModelError, r"'tau' = 1000\.0 lies outside its bounds \(0\.01, 100\.0\)"),
        ({"tau": NAN}, ModelError, "'tau' is nan, not a finite number"),
        ({"tau": "slow"}, ModelError, "'tau' is 'slow', not a finite number"),
        ({"tau": None}, ModelError, "'tau' is None, not a finite number"),
        ({"gain": 2.0}, ModelError, r"'gain' is fixed at 1\.0 and cannot start at 2\.0"),
        ({"x": [1.0, 2.0]}, DataError, r"state 'x' has shape \(2,\); give a number or one value a sample \(21\)"),
        ({"x": spoilt(X, 2, NAN)}, DataError, r"state 'x' is nan at sample 2 \(t = 0\.2\)"),
        ({"x": "measured"}, DataError, "state 'x' is 'measured'"),
        ({"sigma_x": 0.0}, ModelError, "the start of sigma_x is a positive number, not 0"),
        ({"sigma_x": -1.0}, ModelError, "the start of sigma_x is a positive number"),
        ({"sigma_x": NAN}, ModelError, "the start of sigma_x is a positive number, not nan"),
        ({"sigma_x": "small"}, ModelError, "the start of sigma_x is a positive number, not 'small'"),
        (5, OptionError, "start holds values by name, or is a fit, not 5"),
    ],
)
def test_start(start: Any, error: type[Exception], words: str) -> None:
    refuses(error, words, lambda: ph.estimate(lag(), run(), start=start))


def test_start_of_a_known_sigma() -> None:
    noise = Gaussian({"x": 0.1})
    call = lambda: ph.estimate(lag(), run(), noise=noise, start={"sigma_x": 1.0})  # noqa: E731
    refuses(ModelError, r"sigma_x is known \(0\.1\) and cannot be given a start", call)


def test_start_of_a_sigma_outside_its_bounds() -> None:
    noise = Gaussian({"x": Sigma(bounds=(0.001, 0.01))})
    call = lambda: ph.estimate(lag(), run(), noise=noise, start={"sigma_x": 1.0})  # noqa: E731
    refuses(ModelError, r"start: 'sigma_x' = 1\.0 lies outside its bounds \(0\.001, 0\.01\)", call)


def test_sigma_without_start_begins_within_its_bounds() -> None:
    fit = ph.estimate(lag(), run(), noise=Gaussian({"x": Sigma(bounds=(10.0, 20.0))}))
    assert fit.parameters["sigma_x"].value == pytest.approx(10.0, rel=1e-6)


# ---------------------------------------------------------------- options


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"order": 1}, r"order is a whole number from 2 \(trapezoid\) to 64, not 1"),
        ({"order": 65}, "not 65"),
        ({"order": 2.5}, "not 2.5"),
        ({"order": True}, "not True"),
        ({"order": "4"}, "not '4'"),
        ({"substeps": 0}, "substeps is a whole number from 1, not 0"),
        ({"substeps": 1.5}, "substeps is a whole number from 1"),
        ({"substeps": 2, "segments": 3}, "give one"),
        ({"segments": 0}, "at least 1 segment is needed, not 0"),
        ({"segments": np.int64(-1)}, "at least 1 segment is needed, not -1"),
        ({"segments": 2.5}, "segments is a whole number or the times of segment ends, not 2.5"),
        ({"segments": "abc"}, "not 'abc'"),
        ({"segments": True}, "not True"),
        ({"segments": []}, r"not \[\]"),
        ({"segments": [0.0]}, r"not \[0\.0\]"),
        ({"segments": [0.0, NAN, 2.0]}, "segments is"),
        ({"segments": [0.0, 1.0, 1.0, 2.0]}, r"number 2 \(1\) does not come after the last"),
        ({"threads": -1}, "threads is a whole number from 0, not -1"),
    ],
)
def test_collocation(options: dict[str, Any], words: str) -> None:
    refuses(OptionError, f"Collocation: .*{words}", lambda: Collocation(**options))


@pytest.mark.parametrize(
    ("segments", "words"),
    [
        ([0.0, 1.0], "the segments run from 0 to 1, but experiment 'run1' from 0 to 2"),
        ([0.5, 2.0], "the segments run from 0.5 to 2"),
        ([[0.0, 2.0], [0.0, 2.0]], r"2 list\(s\) of segment ends for 1 experiment"),
    ],
)
def test_segments_that_do_not_fit_the_data(segments: Any, words: str) -> None:
    call = lambda: ph.estimate(lag(), run(), transcription=Collocation(segments=segments))  # noqa: E731
    refuses(OptionError, words, call)


def test_one_list_of_segments_for_two_experiments() -> None:
    both = [run(), run(name="run2")]
    call = lambda: ph.estimate(lag(), both, transcription=Collocation(segments=[0.0, 1.0, 2.0]))  # noqa: E731
    refuses(OptionError, r"1 list\(s\) of segment ends for 2 experiment\(s\): give each its own", call)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"max_iterations": -1}, "max_iterations is a whole number from 0, not -1"),
        ({"max_iterations": 2.5}, "not 2.5"),
        ({"max_iterations": "many"}, "not 'many'"),
        ({"tolerance": 0.0}, "tolerance is a number between 0 and 1, not 0.0"),
        ({"tolerance": 1.0}, "not 1.0"),
        ({"tolerance": "tight"}, "not 'tight'"),
        ({"time_limit": -0.5}, "time_limit is a number of seconds from 0, or None, not -0.5"),
        ({"time_limit": "1 min"}, "not '1 min'"),
        ({"options": ["tol"]}, r"options are values by name"),
    ],
)
def test_ipopt(options: dict[str, Any], words: str) -> None:
    refuses(OptionError, f"Ipopt: .*{words}", lambda: Ipopt(**options))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"max_itr": 3}, "Ipopt has no option 'max_itr'"),
        ({"tol": "tight"}, "Ipopt has no option 'tol' that takes 'tight'"),
        ({"linear_solver": "guess"}, "Ipopt has no option 'linear_solver' that takes 'guess'"),
    ],
)
def test_option_that_ipopt_does_not_know(options: dict[str, Any], words: str) -> None:
    refuses(OptionError, words, lambda: ph.estimate(lag(), run(), solver=Ipopt(options=options)))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"transcription": "collocation"}, "SingleShooting, not 'collocation'"),
        ({"transcription": Collocation}, "SingleShooting, not <class"),
        ({"noise": {"x": 0.1}}, r"noise is a Gaussian, StudentT, .*, not {'x': 0\.1}"),
        ({"solver": "ipopt"}, r"solver is Newton\(...\) or Ipopt\(...\), not 'ipopt'"),
        ({"progress": "yes"}, "progress is True, False or a function, not 'yes'"),
    ],
)
def test_options_of_the_wrong_kind(options: dict[str, Any], words: str) -> None:
    refuses(OptionError, words, lambda: ph.estimate(lag(), run(), **options))


# ---------------------------------------------------------------- noise


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"start": -1.0}, "starts at a positive number, not -1.0"),
        ({"start": INF}, "starts at a positive number, not inf"),
        ({"start": "small"}, "starts at a positive number, not 'small'"),
        ({"bounds": (3.0, 2.0)}, r"a positive pair that increases, not \(3\.0, 2\.0\)"),
        ({"bounds": (0.0, 2.0)}, "a positive pair that increases"),
        ({"bounds": 3.0}, "a positive pair that increases, not 3.0"),
        ({"start": 1.0, "bounds": (2.0, 3.0)}, "the start 1.0 of a standard deviation lies outside its bounds"),
    ],
)
def test_sigma(options: dict[str, Any], words: str) -> None:
    refuses(ModelError, words, lambda: Sigma(**options))


@pytest.mark.parametrize(
    ("sigma", "words"),
    [
        ({"x": 0.0}, "noise of 'x': a known standard deviation is a positive number, not 0.0"),
        ({"x": NAN}, "not nan"),
        ({"x": "small"}, "not 'small'"),
        ({"x": None}, "not None"),
        (0.1, "give standard deviations by output"),
    ],
)
def test_gaussian(sigma: Any, words: str) -> None:
    refuses(ModelError, words, lambda: Gaussian(sigma))


def test_noise_of_no_output() -> None:
    call = lambda: ph.estimate(lag(), run(), noise=Gaussian({"X": 0.1}))  # noqa: E731
    refuses(ModelError, r"noise: 'X' is not an output\. Did you mean 'x'\?", call)


# ---------------------------------------------------------------- not finite at the start


def with_equation(f: Callable[[Expr, Expr, Expr], Any], g: Callable[[Expr, Expr, Expr], Any] | None = None) -> Model:
    m = Model("shaky")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    (a,) = m.parameters(a=0.0)
    m.dynamics(x=f(x, u, a))
    m.outputs(y=g(x, u, a) if g else x)
    return m


@pytest.mark.parametrize(
    ("model", "parts"),
    [
        (
            with_equation(lambda x, u, a: u / a - x),
            ["the equation of x'", "'climb'", "t = 10", "1/a = inf", "a = 0", "inputs u = 1"],
        ),
        (
            with_equation(lambda x, u, a: a * x + ph.log(u)),
            ["the equation of x'", "'climb'", "t = 11", "log(u) = -inf", "u = 0"],
        ),
        (
            with_equation(lambda x, u, a: a * x, lambda x, u, a: x * ph.exp(1000 * u)),
            ["output", "'climb'", "t = 10", "exp(1000*u) = inf", "1000*u = 1000", "inputs u = 1"],
        ),
        (
            with_equation(lambda x, u, a: u - x, lambda x, u, a: x + ph.sqrt(a)),
            ["the derivative of an output with respect to a", "'climb'", "1/sqrt(a) = inf"],
        ),
    ],
    ids=["dynamics", "logarithm", "output", "derivative"],
)
def test_model_not_finite_at_the_start(model: Model, parts: list[str]) -> None:
    t = 10.0 + T
    e = Experiment(t, {"u": 11.0 - t}, {"y": X}, name="climb")
    with pytest.raises(EvaluationError, match="at the starting point, .* give other start values") as caught:
        ph.estimate(model, e, transcription=Collocation(order=2), start={"x": 1.0})
    assert all(part in str(caught.value) for part in parts), str(caught.value)
