"""Executors, and runs that several tests look at."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from many import T, new_pool, run, sine

import phugoid as ph
from phugoid import Experiment
from phugoid.results import Multistart


@pytest.fixture(scope="session")
def pool() -> Iterator[ProcessPoolExecutor]:
    with new_pool() as executor:
        yield executor


@pytest.fixture(scope="session")
def dask() -> Iterator[Executor]:
    """An executor on a local cluster of two processes, which gives a task up at the first death of its worker."""
    distributed = pytest.importorskip("distributed", reason="dask[distributed] is not installed")
    import dask

    settings = {"distributed.scheduler.allowed-failures": 0, "distributed.worker.daemon": True}
    with (
        dask.config.set(settings),
        distributed.LocalCluster(2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client.get_executor()


@pytest.fixture
def anywhere(request: pytest.FixtureRequest) -> Any:
    """The fixture that a test names in its parameters, or a pool of threads, or nothing."""
    if request.param == "threads":
        with ThreadPoolExecutor(2) as executor:
            yield executor
    else:
        yield request.param and request.getfixturevalue(request.param)


@pytest.fixture(scope="session")
def twins() -> Multistart:
    return run(20)


@pytest.fixture(scope="session")
def rugged() -> Multistart:
    noise = 0.05 * np.random.default_rng(0).standard_normal(T.size)
    e = Experiment(T, outputs={"y": np.sin(2.0 * T) + 0.5 + noise})
    return run(60, sine(), data=e, ranges={"a": (-5.0, 6.0)}, solver=ph.Ipopt(max_iterations=12))


@pytest.fixture
def pyplot() -> Iterator[Any]:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    yield plt
    plt.close("all")
