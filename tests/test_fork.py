"""A process forked from one that has estimated estimates as well, and to the same bits."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap

import pytest

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")

# A record so long that its factorisation, its blocks and its groups of segments are worked on by several threads.
_PROBLEM = """
import multiprocessing, os, pickle, sys, warnings
from concurrent.futures import ProcessPoolExecutor
import numpy as np, phugoid as ph
warnings.simplefilter("ignore", DeprecationWarning)  # of Python from 3.12 on: threads and a fork
m = ph.Model("lag")
(x,) = m.states("x"); (u,) = m.inputs("u"); (a,) = m.parameters(a=1.5)
m.dynamics(x=a * (u - x)); m.outputs(x=x)

def record(n):
    t = 0.02 * np.arange(n)
    command, state = np.sign(np.sin(0.5 * t)), np.zeros(n)
    for k in range(1, n):
        state[k] = state[k - 1] + 0.02 * 1.2 * (command[k - 1] - state[k - 1])
    return ph.Experiment(t, {"u": command}, {"x": state + 0.1 * np.random.default_rng(1).normal(size=n)})

e = record(5000)

def numbers(fit):
    return [fit.parameters["a"].value, fit.log_likelihood, fit.covariance.tolist(), fit.records[0].states["x"].tolist()]

def in_fork(work):
    into, out = os.pipe()
    child = os.fork()
    if not child:
        os.close(into)
        with os.fdopen(out, "wb") as file:
            pickle.dump(work(), file)
        os._exit(0)
    os.close(out)
    with os.fdopen(into, "rb") as file:
        found = pickle.load(file)
    assert os.waitpid(child, 0)[1] == 0
    return found
"""


def _run(script: str) -> None:
    # Four threads wherever this runs: on a single core nothing would be waited for.
    done = subprocess.run(
        [sys.executable, "-c", _PROBLEM + textwrap.dedent(script)],
        capture_output=True,
        text=True,
        timeout=60,
        env={**os.environ, "RAYON_NUM_THREADS": "4"},
    )
    assert (done.returncode, done.stdout) == (0, "same\n"), done.stderr[-2000:]


def test_a_fork_estimates_to_the_same_bits() -> None:
    _run("""
    few = record(300)
    ways = [(ph.Collocation(), e), (ph.Collocation(threads=2), e), (ph.MultipleShooting(), e)]
    ways += [(ph.MultipleShooting(threads=2), e), (ph.FilterError("x", terms=2, substeps=1), few)]
    def work():
        return [numbers(ph.estimate(m, data, transcription=way)) for way, data in ways]
    before = work()
    print("same" if in_fork(work) == before == work() else "differs")
    """)


def test_a_pool_of_forked_processes_estimates_to_the_same_bits() -> None:
    _run("""
    def work(number=0):
        return numbers(ph.estimate(m, e))
    before = work()
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("fork")) as pool:
        found = list(pool.map(work, range(3)))
    print("same" if found == [before] * 3 else "differs")
    """)


def test_a_fork_of_a_fork_estimates_to_the_same_bits() -> None:
    _run("""
    def work():
        return numbers(ph.estimate(m, e))
    before = work()
    print("same" if in_fork(lambda: [work(), in_fork(work)]) == [before, before] else "differs")
    """)


def test_a_fork_simulates_diagnoses_and_validates_a_fit_of_its_parent() -> None:
    _run("""
    few = record(300)
    numbers(ph.estimate(m, e))  # which starts the threads
    fit = ph.estimate(m, few)
    def work():
        simulated = ph.simulate(m, fit, few).outputs["x"].tolist()
        found = ph.diagnose(fit)
        return [simulated, fit.validate(few).summary(), found.threshold, [(s.name, s.ranking) for s in found.ranking]]
    before = work()
    print("same" if in_fork(work) == before else "differs")
    """)


def test_a_fork_evaluates_a_problem_of_its_parent() -> None:
    _run("""
    noise = ph.Gaussian().resolve(["x"], {"x": 0.1}, {})
    ways = ph.Collocation(), ph.Collocation(threads=2), ph.MultipleShooting(threads=2)
    problems = [way.problem(m, [e], noise) for way in ways]
    def work():
        return [p.gradient(np.full(p.n, 0.5)).tolist() for p in problems]
    before = work()
    print("same" if in_fork(work) == before == work() else "differs")
    """)
