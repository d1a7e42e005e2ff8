"""Cases of multistart, and solvers that tests can watch or that misbehave."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

import phugoid as ph
from phugoid import Experiment, Model
from phugoid.results import Multistart, Outcome

T = np.linspace(0.0, 8.0, 100)
TRUTH = {"tau": 0.8, "a": 2.0}
RANGES = {"tau": (0.2, 3.0), "a": (-4.0, 4.0)}
TRAPEZOID = ph.Collocation(order=2)


def square() -> Model:
    """A lag of which the output knows the gain by its square only: every optimum is given twice."""
    m = Model("lag with a squared gain")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    tau, a = m.parameters(tau=ph.Parameter(1.0, bounds=(0.01, 100.0), unit="s"), a=1.0)
    m.dynamics(x=(u - x) / tau)
    m.outputs(y=(a**2 * x, "m"))
    return m


@cache
def data(seed: int = 0) -> Experiment:
    e = Experiment(T, {"u": np.sign(np.sin(1.3 * T))}, name="run")
    clean = ph.simulate(square(), TRUTH, e, initial={"x": 0.1}).outputs["y"]
    return e.with_outputs({"y": clean + 0.05 * np.random.default_rng(seed).standard_normal(T.size)})


def run(n: int = 6, model: Model | None = None, **options: Any) -> Multistart:
    options = {"ranges": RANGES, "transcription": TRAPEZOID, **options}
    return ph.multistart(model or square(), options.pop("data", data()), n=n, **options)


def told(result: Multistart) -> list[tuple[Any, ...]]:
    """What a run must tell whatever executes it: all but the times."""
    return [(o.index, o.start, o.status, o.log_likelihood, o.parameters, o.iterations) for o in result.outcomes]


@cache
def reference(n: int = 6) -> list[tuple[Any, ...]]:
    return told(run(n))


# Solvers that tests can watch, or that misbehave. They are found again by name in worker processes.


@dataclass(frozen=True)
class Counting(ph.Newton):
    """Writes a byte to a file with each run."""

    regression: bool | None = False
    file: str = ""

    def solve(self, *args: Any, **kwargs: Any) -> Any:
        with open(self.file, "ab") as f:
            f.write(b".")
        return super().solve(*args, **kwargs)


@dataclass(frozen=True)
class Slow(ph.Newton):
    """Takes a while."""

    regression: bool | None = False
    seconds: float = 0.1

    def solve(self, *args: Any, **kwargs: Any) -> Any:
        time.sleep(self.seconds)
        return super().solve(*args, **kwargs)


@dataclass(frozen=True)
class Deadly(ph.Newton):
    """Kills its process: once, as long as the marker file is there; and always, from a start of tau above a limit."""

    regression: bool | None = False
    marker: str = ""
    limit: float = np.inf

    def solve(self, problem: Any, xi: Any, *args: Any, **kwargs: Any) -> Any:
        try:
            os.remove(self.marker)
            os.kill(os.getpid(), signal.SIGKILL)
        except FileNotFoundError:
            pass
        if xi[0] > self.limit:
            os.kill(os.getpid(), signal.SIGKILL)
        return super().solve(problem, xi, *args, **kwargs)


def new_pool(workers: int = 2, **options: Any) -> ProcessPoolExecutor:
    # Not forked: the core may have threads.
    return ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"), **options)


def interrupt_after(count: int) -> Callable[[Outcome], None]:
    left = [count]

    def watch(_: Outcome) -> None:
        left[0] -= 1
        if left[0] == 0:
            raise KeyboardInterrupt

    return watch


def outcome(
    index: int, log_likelihood: float, a: float = 1.0, error: float = 1.0, status: str = "converged"
) -> Outcome:
    return Outcome(index, {}, status, "", log_likelihood, {"a": a}, {"a": error})


def sine() -> Model:
    """The frequency of a sine: many optima, and beyond -4 no function to evaluate."""
    m = Model("frequency of a sine, $1")
    (c,) = m.states("c")
    (a,) = m.parameters("a")
    m.dynamics(c=1e-9 * ph.sqrt(a + 4))
    m.outputs(y=ph.sin(a * m.time) + c)
    return m
