"""What multistart refuses."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np
import pytest
from many import T, run

import phugoid as ph
from phugoid import DataError, Experiment, Model, ModelError, OptionError


@pytest.mark.parametrize(
    ("ranges", "error", "message"),
    [
        ({"Tau": (0, 1)}, ModelError, "'Tau' is not a parameter, sigma or state. Did you mean 'tau'?"),
        ({"sigma_x": (0, 1)}, ModelError, "'sigma_x' is not a parameter, sigma or state"),
        ({"tau": (2.0, 1.0)}, OptionError, "'tau' from 2 to 1 is reversed"),
        ({"tau": (0.5, np.inf)}, OptionError, "'tau' from 0.5 to inf is not finite"),
        ({"tau": (np.nan, 1.0)}, OptionError, "'tau' from nan to 1 is not finite"),
        ({"tau": (1.0, 1.0)}, OptionError, r"'tau' from 1 to 1 leaves no room: use start=\{'tau': 1\}"),
        ({"tau": 1.0}, OptionError, r"'tau' is a pair of numbers \(low, high\), not 1.0"),
        ({"tau": (1, 2, 3)}, OptionError, "'tau' is a pair of numbers"),
        ({"tau": ("a", "b")}, OptionError, "'tau' is a pair of numbers"),
        ({"tau": (0.0, 1.0)}, ModelError, r"'tau' from 0 to 1 reaches outside its bounds \(0.01, 100\)"),
        ({"tau": (1.0, 101.0)}, ModelError, "'tau' from 1 to 101 reaches outside its bounds"),
        ({"sigma_y": (-1.0, 1.0)}, OptionError, "'sigma_y' starts at -1: a standard deviation is positive"),
        ({}, OptionError, "give \\(low, high\\) by name"),
        ([("tau", 1, 2)], OptionError, "give \\(low, high\\) by name"),
    ],
)
def test_impossible_ranges_are_refused(ranges: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=f"ranges: {message}"):
        run(1, ranges=ranges)


def test_fixed_and_known_are_not_drawn() -> None:
    m = Model("fixed")
    (x,) = m.states("x")
    (a,) = m.parameters(a=ph.Parameter(2.0, fixed=True))
    m.dynamics(x=-a * x)
    m.outputs(x=x)
    e = Experiment(T, outputs={"x": np.exp(-T)})
    with pytest.raises(ModelError, match="ranges: 'a' is fixed at 2: take it out of the ranges, or free it"):
        run(1, m, data=e, ranges={"a": (0.0, 3.0)})
    with pytest.raises(ModelError, match="ranges: 'sigma_x' is known"):
        run(1, m, data=e, ranges={"sigma_x": (0.1, 3.0)}, noise=ph.Gaussian({"x": 0.1}))
    bounded = ph.Gaussian({"x": ph.Sigma(0.1, bounds=(0.05, 1.0))})
    with pytest.raises(ModelError, match="ranges: 'sigma_x' from 0.1 to 3 reaches outside its bounds"):
        run(1, m, data=e, ranges={"sigma_x": (0.1, 3.0)}, noise=bounded)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"n": 0}, OptionError, "n is a whole number from 1, not 0"),
        ({"n": 2.5}, OptionError, "n is a whole number from 1, not 2.5"),
        ({"n": True}, OptionError, "n is a whole number from 1"),
        ({"seed": -1}, OptionError, "seed is a whole number from 0, not -1"),
        ({"seed": None}, OptionError, "seed is a whole number from 0"),
        ({"ranges": None}, OptionError, "give either ranges to draw from, or starts"),
        ({"starts": [{}]}, OptionError, "give either ranges to draw from, or starts"),
        ({"ranges": None, "starts": []}, OptionError, "starts: give a list"),
        ({"ranges": None, "starts": "tau"}, OptionError, "starts: give a list"),
        ({"ranges": None, "starts": [{}], "n": 2}, OptionError, "starts: there are 1, but n = 2"),
        ({"ranges": None, "starts": [{}, 3], "n": 2}, OptionError, "starts: number 1 holds no values by name"),
        ({"ranges": None, "starts": [{"Tau": 1}]}, ModelError, "starts: number 0: .*Did you mean 'tau'"),
        ({"ranges": None, "starts": [{"tau": "x"}]}, ModelError, "number 0: start: 'tau' is 'x', not a finite number"),
        (
            {"ranges": None, "starts": [{"tau": 0.0}]},
            ModelError,
            "number 0: start: 'tau' = 0.0 lies outside its bounds",
        ),
        ({"ranges": None, "starts": [{"sigma_y": -1}]}, ModelError, "number 0: the start of sigma_y is a positive"),
        ({"ranges": None, "starts": [{"x": [1, 2]}]}, DataError, r"number 0: start: state 'x' has shape \(2,\)"),
        ({"executor": 4}, OptionError, r"executor: give a concurrent.futures.Executor, .* not 4"),
        ({"executor": ProcessPoolExecutor}, OptionError, "executor: give a concurrent.futures.Executor"),
        ({"progress": "yes"}, OptionError, "progress is True, False or a function"),
        ({"transcription": 2}, OptionError, "SingleShooting, not 2"),
        ({"noise": 2}, OptionError, "noise is a Gaussian, StudentT, .* not 2"),
        ({"start": 2}, OptionError, "start holds values by name, or is a fit"),
        ({"start": {"b": 2}}, ModelError, "start: 'b' is not a parameter, sigma or state"),
        ({"solver": "newton"}, OptionError, "solver is Newton"),
        ({"solver": ph.Ipopt(options={"nonsense": 1})}, OptionError, "Ipopt has no option 'nonsense'"),
        ({"model": "lag"}, ModelError, "the first argument is a Model, not a str"),
        ({"data": [1]}, DataError, "data is an Experiment or a list of them"),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, dict) else "",
)
def test_bad_options_are_refused(options: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        run(**{"n": 1, **options})


def test_a_client_is_no_executor() -> None:
    class Client:
        get_executor = None

    with pytest.raises(OptionError, match=r"of a Dask client take client\.get_executor\(\)"):
        run(1, executor=Client())


def test_a_fault_of_the_call_comes_out_of_a_worker(pool: ProcessPoolExecutor) -> None:
    with pytest.raises(OptionError, match="Ipopt has no option 'nonsense'"):
        run(3, executor=pool, solver=ph.Ipopt(options={"nonsense": 1}))


def test_an_output_that_the_data_lack_is_named() -> None:
    e = Experiment(T, {"u": np.sin(T)}, {"z": np.sin(T)}, name="run")
    with pytest.raises(DataError, match="experiment 'run' has no output 'y'"):
        run(1, data=e)
