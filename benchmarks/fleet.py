"""Estimation from a fleet: 10,000 simulated flights of 1,000 samples on a local cluster of two processes.

    python benchmarks/fleet.py [--flights 10000] [--samples 1000] [--compare 200] [--kill SECONDS] [--pool]

Each flight is simulated on the worker that evaluates it, from its number. Prints the estimates beside the truth, time
per sample and factorisation beside that of one process with the same data (``--compare`` flights, two threads), the
memory of the driver before and at the end, and the bytes that travel. ``--kill`` kills a worker in the middle.
"""

from __future__ import annotations

import argparse
import os
import resource
import signal
import threading
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any

import numpy as np
from scipy.linalg import expm

import phugoid as ph

TRUTH = {"Zw": -0.9, "Zde": -6.0, "Mw": -0.06, "Mq": -1.4, "Mde": -4.5}
SIGMA = {"w": 0.3, "q": 0.004}
SPEED = 60.0  # m/s


def model() -> ph.Model:
    """Return the short-period motion: two states, five derivatives."""
    m = ph.Model("short period")
    w, q = m.states(w="m/s", q="rad/s")
    (de,) = m.inputs(de="rad")
    Zw, Zde, Mw, Mq, Mde = m.parameters(
        Zw=ph.Parameter(0.0, unit="1/s"),
        Zde=ph.Parameter(0.0, unit="m/(s² rad)"),
        Mw=ph.Parameter(0.0, unit="1/(m s)"),
        Mq=ph.Parameter(0.0, unit="1/s"),
        Mde=ph.Parameter(0.0, unit="1/(s² rad)"),
    )
    m.dynamics(w=Zw * w + SPEED * q + Zde * de, q=Mw * w + Mq * q + Mde * de)
    m.outputs(w=w, q=q)
    return m


def flight(number: int, n: int) -> ph.Experiment:
    """Return a flight: elevator doublets at random times, exact for inputs that are linear between samples."""
    rng = np.random.default_rng(number)
    step = 0.02
    t = step * np.arange(n)
    de = np.zeros(n)
    for _ in range(4):
        begin, width = rng.integers(0, max(n - 60, 1)), rng.integers(10, 30)
        height = 0.05 * rng.standard_normal()
        de[begin : begin + width] += height
        de[begin + width : begin + 2 * width] -= height
    a = np.array([[TRUTH["Zw"], SPEED], [TRUTH["Mw"], TRUTH["Mq"]]])
    b = np.array([[TRUTH["Zde"]], [TRUTH["Mde"]]])
    # Exact over a step with a linear input: of the system with the input and its slope as states.
    whole = np.zeros((4, 4))
    whole[:2, :2], whole[:2, 2:3], whole[2, 3] = a, b, 1.0
    over = expm(step * whole)
    x = np.zeros((n, 2))
    x[0] = rng.standard_normal(2) * (1.0, 0.02)
    forced = np.outer(de[:-1], over[:2, 2]) + np.outer(np.diff(de) / step, over[:2, 3])
    for k in range(n - 1):
        x[k + 1] = over[:2, :2] @ x[k] + forced[k]
    noise = rng.standard_normal((n, 2)) * (SIGMA["w"], SIGMA["q"])
    measured = x + noise
    return ph.Experiment(t, {"de": de}, {"w": measured[:, 0], "q": measured[:, 1]}, f"flight {number}")


def memory() -> float:
    """Return the greatest resident memory of this process so far, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def children() -> float:
    """Return the processor time of this process and of all that ended, s."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)


def run(executor: Any, flights: int, samples: int, progress: bool) -> Any:
    """Return the fit of a fleet."""
    runs = [ph.Run(partial(flight, k, samples), name=f"flight {k}") for k in range(flights)]
    transcription = ph.Collocation(order=4, threads=1)
    return ph.estimate(model(), runs, executor=executor, transcription=transcription, progress=progress)


def compare(flights: int, samples: int, executor: Any) -> None:
    """Print the time per sample and factorisation of one process with two threads, and of two processes."""
    data = [flight(k, samples) for k in range(flights)]
    m = model()
    began = time.perf_counter()
    whole = ph.estimate(m, data, transcription=ph.Collocation(order=4, threads=2))
    alone = time.perf_counter() - began
    run(executor, 2 * 8, samples, False)  # imports and functions are there
    began = time.perf_counter()
    fleet = ph.estimate(m, data, executor=executor, transcription=ph.Collocation(order=4, threads=1))
    both = time.perf_counter() - began
    again = ph.estimate(
        m, data, executor=executor, transcription=ph.Collocation(order=4, threads=1), start=fleet.start()
    )
    far = max(abs(fleet.parameters[n].value - e.value) / e.std_error for n, e in whole.parameters.items())
    count = whole.solution.evaluations["factorizations"]
    size = flights * samples
    print(f"{flights} flights of {samples} samples")
    each = 1e6 * alone / size / count
    print(f"one process, two threads: {alone:.2f} s, {count} factorisations, {each:.3f} µs each a sample")
    rounds = fleet.factorizations / flights
    print(f"two processes: {both:.2f} s, {rounds:.2f} rounds, {1e6 * both / size / rounds:.3f} µs each a sample")
    print(f"estimates differ by at most {far:.1e} standard errors; a second time {again.time:.2f} s")


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=10_000)
    parser.add_argument("--samples", type=int, default=1_000)
    parser.add_argument("--compare", type=int, default=200)
    parser.add_argument("--kill", type=float, default=0.0, help="kill a worker after so many seconds")
    parser.add_argument("--pool", action="store_true", help="a pool of processes in place of a Dask cluster")
    options = parser.parse_args()
    if options.pool:
        executor: Any = [ProcessPoolExecutor(1), ProcessPoolExecutor(1)]
        processes = [next(iter(e._processes)) for e in executor if e.submit(os.getpid).result()]
    else:
        from distributed import Client, LocalCluster

        cluster = LocalCluster(n_workers=2, threads_per_worker=1, memory_limit=0, dashboard_address=None)
        executor = Client(cluster)
        processes = list(executor.run(os.getpid).values())
    if options.compare:
        compare(options.compare, options.samples, executor)
    before = memory()
    if options.kill:
        threading.Timer(options.kill, os.kill, (processes[0], signal.SIGKILL)).start()
    began = time.perf_counter()
    fleet = run(executor, options.flights, options.samples, True)
    spent = time.perf_counter() - began
    print(fleet.summary())
    for name, value in {**TRUTH, **{f"sigma_{n}": s for n, s in SIGMA.items()}}.items():
        e = fleet.parameters[name]
        print(f"{name:8} {e.value:12.6f} ± {e.std_error:.6f}, true {value}: {(e.value - value) / e.std_error:+.2f}")
    size = options.flights * options.samples
    rounds = fleet.factorizations / options.flights
    p = len(fleet.parameters)
    print(f"{size} samples: {spent:.1f} s, {fleet.evaluations} trials, {rounds:.2f} factorisations of each record")
    each = 1e6 * spent / size / rounds
    print(f"{each:.3f} µs a sample and factorisation; driver {before:.0f} MB before, {memory():.0f} MB")
    print(f"{8 * (p * p + p + 1)} bytes a part and trial travel back")


if __name__ == "__main__":
    main()
