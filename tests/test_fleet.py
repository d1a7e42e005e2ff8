"""Estimation from many records on executors: the estimate of one process, whatever happens to workers and records."""

import math
import os
import signal
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial

import numpy as np
import pytest

import phugoid as ph
from phugoid.fleet import worker
from phugoid.fleet.population import Population
from phugoid.fleet.worker import Trial, work

SIGMA = {"x": 0.02, "v": 0.03}


def oscillator(cubic: bool = True) -> ph.Model:
    m = ph.Model("oscillator")
    x, v = m.states(x="m", v="m/s")
    (u,) = m.inputs(u="N")
    k, c, bias = m.parameters(
        k=ph.Parameter(1.0, bounds=(0.0, 100.0), prior=(4.0, 0.5)),
        c=ph.Parameter(0.1),
        bias=ph.Parameter(0.0, unit="m", per_experiment=True),
    )
    spring = k * x
    if cubic:
        (k3,) = m.parameters(k3=0.0)
        spring = spring + k3 * x**3
    m.dynamics(x=v, v=u - spring - c * v)
    m.outputs(x=x + bias, v=v)
    return m


def flight(number: int, n: int = 120, cubic: float = 0.4, bias: float | None = None) -> ph.Experiment:
    """Return a record with an offset of its sensor of its own."""
    rng = np.random.default_rng(number)
    t = 0.1 * np.arange(n)
    u = np.sin(0.7 * t + number) + 0.5 * np.sin(1.3 * t + 2 * number)
    bias = 0.05 * (number % 5) - 0.1 if bias is None else bias
    blank = ph.Experiment(t, {"u": u}, {"x": 0 * t, "v": 0 * t}, f"flight {number}")
    values = {"k": 4.0, "c": 0.3, "k3": cubic, "bias": bias}
    run = ph.simulate(oscillator(), values, blank, initial={"x": 1.0 + 0.1 * (number % 7), "v": -0.2})
    outputs = {n: run.outputs[n] + s * rng.standard_normal(t.size) for n, s in SIGMA.items()}
    return ph.Experiment(t, {"u": u}, outputs, f"flight {number}")


@pytest.fixture(scope="module")
def flights() -> list[ph.Experiment]:
    return [flight(k, 120 + 10 * (k % 3)) for k in range(12)]


@pytest.fixture(scope="module")
def whole(flights: list[ph.Experiment]) -> ph.Fit:
    return ph.estimate(oscillator(), flights)


def assert_same(fleet, whole: ph.Fit, part: float = 1e-3) -> None:
    assert fleet.status == "converged"
    for name, e in fleet.parameters.items():
        other = whole.parameters[name]
        assert abs(e.value - other.value) < part * other.std_error, name
        assert e.std_error == pytest.approx(other.std_error, rel=1e-4), name


def test_the_estimate_is_that_of_one_process(flights, whole) -> None:
    with ThreadPoolExecutor(2) as executor:
        fleet = ph.estimate(oscillator(), flights, executor=executor)
    assert_same(fleet, whole)
    assert fleet.log_likelihood == pytest.approx(whole.log_likelihood, abs=1e-3)
    assert list(fleet.parameters) == [n for n in whole.parameters if not n.startswith("bias")]
    for name, found in fleet.flights.items():
        bias = whole.parameters[f"bias[{name}]"]
        assert abs(found.parameters["bias"].value - bias.value) < 1e-3 * bias.std_error
        assert found.parameters["bias"].std_error <= 1.001 * bias.std_error
        residuals = next(r for r in whole.records if r.name == name).residuals
        assert found.rms["x"] == pytest.approx(np.sqrt(np.mean(residuals["x"] ** 2)), rel=1e-3)
    i, j = (list(fleet.parameters).index(n) for n in ("k", "k3"))
    a, b = (list(whole.parameters).index(n) for n in ("k", "k3"))
    assert fleet.covariance[i, j] == pytest.approx(whole.covariance[a, b], rel=1e-3)


def test_useless_starts_and_a_fit_as_start(flights, whole) -> None:
    with ThreadPoolExecutor(2) as executor:
        far = ph.estimate(oscillator(), flights, executor=executor, start={"k": 40.0, "c": 9.0})
        again = ph.estimate(oscillator(), flights, executor=executor, start=whole)
    assert_same(far, whole)
    assert_same(again, whole)
    assert again.iterations <= 2


def test_records_are_read_on_the_worker_and_again_where_memory_is_short(flights, whole, tmp_path) -> None:
    paths = []
    for e in flights:
        table = np.column_stack([e.t, e.input("u"), e.output("x"), e.output("v")])
        paths.append(tmp_path / f"{e.name}.csv")
        np.savetxt(paths[-1], table, delimiter=",", header="t,u,x,v", comments="", fmt="%.17g")
    with ThreadPoolExecutor(2) as executor:
        kept = ph.estimate(oscillator(), paths, executor=executor)
        runs = [ph.Run(p, inputs=["u"], outputs=["x", "v"]) for p in paths]
        read_again = ph.estimate(oscillator(), runs, executor=executor, memory=0)
    assert_same(kept, whole)
    assert_same(read_again, whole)
    assert list(kept.flights) == [e.name for e in flights] or {*kept.flights} == {e.name for e in flights}


def test_a_killed_worker_loses_nothing(whole, flights) -> None:
    with ProcessPoolExecutor(2) as executor:
        executor.submit(os.getpid).result()
        victim = next(iter(executor._processes))
        killed = []

        def kill(_) -> None:
            if not killed:
                killed.append(victim)
                os.kill(victim, signal.SIGKILL)

        fleet = ph.estimate(oscillator(), flights, executor=executor, progress=kill)
    assert killed
    assert_same(fleet, whole)
    assert any("run again" in w for w in fleet.warnings)


def test_a_dask_cluster(whole, flights) -> None:
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        runs = [ph.Run(partial(flight, k, 120 + 10 * (k % 3)), name=f"flight {k}") for k in range(12)]
        fleet = ph.estimate(oscillator(), runs, executor=client)
    assert_same(fleet, whole)


def test_records_that_cannot_be_used_are_named_and_left_out_if_asked(flights, tmp_path) -> None:
    without = flights[4]
    bad = ph.Experiment(without.t, dict(without.inputs), {"x": without.output("x")}, "no v")
    unread = ph.Run(tmp_path / "gone.csv")
    data = [*flights[:6], bad, unread]
    with ThreadPoolExecutor(1) as executor:
        with pytest.raises(ph.DataError, match="gone.*leave_out=True"):
            ph.estimate(oscillator(), [*flights[:6], unread], executor=executor, first=3)
        fleet = ph.estimate(oscillator(), data, executor=executor, leave_out=True, first=3)
    assert {"gone"} <= {*fleet.left_out} <= {"gone", "no v"}
    assert "gone" in fleet.summary()
    if "no v" not in fleet.left_out:  # an output that a record does not measure says nothing of it
        assert math.isnan(fleet.flights["no v"].rms["v"])


def test_wrong_options_are_named(flights) -> None:
    m = oscillator()
    with ThreadPoolExecutor(1) as executor:
        with pytest.raises(ph.DataError, match="both called 'flight 0'"):
            ph.estimate(m, [flights[0], flights[0]], executor=executor)
        with pytest.raises(ph.DataError, match="empty"):
            ph.estimate(m, [], executor=executor)
        with pytest.raises(ph.OptionError, match="refine"):
            ph.estimate(m, flights, executor=executor, transcription=ph.Collocation(refine=True))
        with pytest.raises(ph.OptionError, match="populations names"):
            ph.estimate(m, flights, executor=executor, populations=["k"])
    with pytest.raises(ph.OptionError, match="client of Dask"):
        ph.estimate(m, flights, executor="two")
    with pytest.raises(ph.OptionError, match="takes no work"):
        ph.estimate(m, flights, executor=executor)


def test_a_source_that_does_not_travel_is_named(flights) -> None:
    with ThreadPoolExecutor(1) as executor, pytest.raises(ph.DataError, match="pickled"):
        ph.estimate(oscillator(), [ph.Run(lambda: flights[0], name="here")], executor=executor)


def test_a_worker_of_another_version_says_so() -> None:
    answer = work("key", None, 0, None, Trial(), "0.0.0", 1)
    assert answer is not None
    assert "not 0.0.0" in answer["wrong"]


def slow(number: int) -> ph.Experiment:
    time.sleep(0.25 if number else 0.0)
    return flight(number)


def test_a_time_limit_returns_the_best_point(flights, whole) -> None:
    runs = [ph.Run(partial(slow, k), name=f"flight {k}") for k in range(12)]
    with ThreadPoolExecutor(1) as executor:
        fleet = ph.estimate(
            oscillator(), runs, executor=executor, memory=0, first=2, solver=ph.Newton(time_limit=8.0, tolerance=1e-9)
        )
    assert fleet.status in ("time limit", "converged", "acceptable")
    assert math.isfinite(fleet.log_likelihood)


def test_populations_are_those_of_all_records_together() -> None:
    rng = np.random.default_rng(5)
    biases = 0.3 + 0.02 * rng.standard_normal(40)
    data = [flight(k, 60, bias=b) for k, b in enumerate(biases)]
    with ThreadPoolExecutor(2) as executor:
        fleet = ph.estimate(oscillator(), data, executor=executor, populations=["bias"])
        free = ph.estimate(oscillator(), data, executor=executor)
    found = fleet.populations["bias"]
    assert abs(found.mean - biases.mean()) < 4.0 * found.mean_error
    assert abs(found.std - 0.02) < 4.0 * found.std_error
    # Shrinkage: nearer to the truth than each record alone.
    error = {
        name: np.mean(
            [(f.flights[e.name].parameters["bias"].value - b) ** 2 for e, b in zip(data, biases, strict=True)]
        )
        for name, f in (("with", fleet), ("without", free))
    }
    assert error["with"] < error["without"]


def test_a_population_of_normal_values_is_fitted_by_its_marginal_likelihood() -> None:
    rng = np.random.default_rng(1)
    errors = rng.uniform(0.05, 0.4, 4000)
    values = 2.0 + 0.3 * rng.standard_normal(4000) + errors * rng.standard_normal(4000)
    prior = Population("b", 0.0, 1.0)
    posterior = 1.0 / (1.0 / errors**2 + 1.0)
    found = prior.fitted(posterior * values / errors**2, np.sqrt(posterior))
    assert abs(found.mean - 2.0) < 3.0 * found.mean_error < 0.03
    assert abs(found.std - 0.3) < 3.0 * found.std_error < 0.03


def test_records_unlike_the_others_are_found() -> None:
    data = [flight(k, 80) for k in range(20)]
    odd = data[7]
    noisy = odd.output("v") + 0.15 * np.random.default_rng(0).standard_normal(odd.t.size)
    data[7] = ph.Experiment(odd.t, dict(odd.inputs), {"x": odd.output("x"), "v": noisy}, odd.name)
    with ThreadPoolExecutor(2) as executor:
        fleet = ph.estimate(oscillator(), data, executor=executor)
    unlike = fleet.unlike()
    assert [(u.name, u.what) for u in unlike] == [("flight 7", "residual of v")]
    assert unlike[0].distance > 5.0
    one = ph.estimate(fleet.model_of("flight 3"), data[3])
    expected = fleet.flights["flight 3"].parameters["bias"]
    assert abs(one.parameters["bias"].value - expected.value) < expected.std_error


def test_what_is_missing_in_most_records_is_found_and_nothing_where_nothing_is() -> None:
    data = [flight(k, 100) for k in range(30)]
    nothing = [flight(k, 100, cubic=0.0) for k in range(30)]
    with ThreadPoolExecutor(2) as executor:
        fleet = ph.estimate(oscillator(cubic=False), data, executor=executor)
        found = ph.missing_effects(fleet, data, executor)
        complete = ph.estimate(oscillator(cubic=False), nothing, executor=executor)
        none = ph.missing_effects(complete, nothing, executor)
    names = [found.effects[0].name, *found.effects[0].alike]
    assert "v':x^3" in names, found.summary()
    first = found.effects[0]
    assert first.agreeing > 0.95
    if first.name == "v':x^3":
        assert first.coefficient < 0.0
    assert len(none.effects) == 0, none.summary()
    assert found.plot().axes and none.plot().axes


def test_a_process_forgets_the_records_of_an_earlier_fleet(flights) -> None:
    with ThreadPoolExecutor(1) as executor:
        ph.estimate(oscillator(), flights, executor=executor)
        known = {key for key, _ in worker._HELD}
        ph.estimate(oscillator(), flights[:6], executor=executor)
    assert known.isdisjoint(key for key, _ in worker._HELD)
    assert worker._KEPT_BYTES[0] == sum(
        worker._size(r) for held in worker._HELD.values() for r in held.records.values()
    )
