"""A diagnosis of several records between which a parameter or an offset changed."""

from __future__ import annotations

import numpy as np
import pytest

import phugoid as ph
from phugoid.discrepancy.page.figures import explained_figure

T = np.arange(0.0, 25.0, 0.05)


def mass(cubic: float = 0.0) -> ph.Model:
    m = ph.Model("mass")
    (u,), (x, v) = m.inputs("u"), m.states(x="m", v="m/s")
    k, c = m.parameters(k=4.0, c=0.5)
    m.dynamics(x=v, v=u - k * x - c * v - (cubic * x**3 if cubic else 0.0))
    m.outputs(x=x, v=v)
    return m


def flights(
    seed: int, stiffness: tuple[float, ...], offset: tuple[float, ...] | None = None, cubic: float = 0.0
) -> list[ph.Experiment]:
    """A record for each stiffness, of other inputs."""
    rng, found = np.random.default_rng(seed), []
    for i, k in enumerate(stiffness):
        f, p = rng.uniform(0.05, 1.2, 8), rng.uniform(0.0, 2.0 * np.pi, 8)
        u = 1.5 * np.sum(np.sin(2.0 * np.pi * f[:, None] * T + p[:, None]), axis=0)
        run = ph.simulate(mass(cubic), {"k": k, "c": 0.5}, ph.Experiment(T, {"u": u}), initial={"x": 0.0, "v": 0.0})
        y = {
            n: z + s * rng.standard_normal(T.size) for (n, z), s in zip(run.outputs.items(), (5e-3, 0.01), strict=True)
        }
        y["x"] = y["x"] + (offset[i] if offset else 0.0)
        found.append(ph.Experiment(T, {"u": u}, y, name=f"flight {i + 1}"))
    return found


def test_a_parameter_that_was_another_in_one_record_is_named() -> None:
    """It was called noise on the input."""
    runs = flights(1, (4.0, 4.0, 4.6, 4.0))
    d = ph.diagnose(ph.estimate(mass(), runs))
    (f,) = d.findings
    assert (f.cause, f.status) == ("k:per_experiment", "named"), d.summary()
    for record, truth in zip(("flight 1", "flight 2", "flight 3", "flight 4"), (4.0, 4.0, 4.6, 4.0), strict=True):
        value, error = f.parameters[f"k[{record}]"]
        assert abs(value - truth) < 4.0 * error < 0.02
    extended = d.extend()
    assert extended.added == ("k:per_experiment",)
    assert extended.fit.parameters["k[flight 3]"].value == pytest.approx(4.6, abs=0.01)
    assert extended.gain.log_likelihood > 1000.0
    assert all(extended.gain.rms_after[n] < 0.2 * extended.gain.rms_before[n] for n in ("x", "v"))
    assert "4.6" in d.summary() and "'flight 3'" in d.summary()
    # All of the misfit is that, and the figure that leads the page shows it.
    assert f.explained > 0.95 and f.explained_in == "the fitted records" and set(f.explained_outputs) == {"x", "v"}
    assert "in free simulation of the fitted records" in d.summary()
    (bar,) = explained_figure(d.findings)[1]["explained"].patches
    assert bar.get_width() == pytest.approx(100.0 * f.explained)


def test_an_offset_of_a_sensor_in_one_record_is_named() -> None:
    runs = flights(2, (4.0, 4.0, 4.0), offset=(0.0, 0.05, 0.0))
    d = ph.diagnose(ph.estimate(mass(), runs))
    (f,) = d.findings
    assert f.cause == "x:bias_per_experiment" and f.status == "named", d.summary()
    # A constant force on the spring is the same, and so is an offset of the force that is recorded.
    assert set(f.aliases) == {"u:bias_per_experiment", "v':bias_per_experiment"}
    assert f.parameters["x[flight 2]"][0] == pytest.approx(0.05, abs=0.002)


def test_a_scale_of_a_sensor_in_one_record_is_named() -> None:
    runs = flights(4, (4.0, 4.0))
    second = runs[1]
    y = {"x": second.output("x"), "v": 1.08 * second.output("v")}
    runs[1] = ph.Experiment(second.t, {"u": second.input("u")}, y, name=second.name)
    d = ph.diagnose(ph.estimate(mass(), runs))
    (f,) = d.findings
    assert f.cause == "v:scale_per_experiment" and f.status == "named", d.summary()
    assert f.parameters["v[flight 1]"][0] == pytest.approx(0.0, abs=0.004)
    assert f.parameters["v[flight 2]"][0] == pytest.approx(0.08, abs=0.004)


def test_the_other_record_has_a_value_of_its_own_too() -> None:
    *runs, other = flights(3, (4.0, 4.7, 4.3))
    d = ph.diagnose(ph.estimate(mass(), runs), validation=other)
    assert [f.cause for f in d.findings] == ["k:per_experiment"], d.summary()
    gain = d.extend().gain
    assert all(gain.held_out_rms_after[n] < 0.3 * gain.held_out_rms_before[n] for n in ("x", "v"))


def test_what_is_missing_in_all_records_is_no_difference_between_them() -> None:
    runs = flights(4, (4.0, 4.0, 4.0), cubic=0.3)
    d = ph.diagnose(ph.estimate(mass(), runs))
    named = [f for f in d.findings if f.status == "named"]
    assert [f.cause for f in named] == ["v':x^3"], d.summary()


def test_nothing_differs_where_nothing_does() -> None:
    d = ph.diagnose(ph.estimate(mass(), flights(5, (4.0, 4.0, 4.0))))
    assert not d.findings and d.verdict == "nothing", d.summary()


def test_an_offset_that_is_small_beside_the_noise_is_named() -> None:
    """Noise was counted against it: with offsets of the size of the noise it was called process noise."""
    runs = flights(6, (4.0, 4.0, 4.0, 4.0), offset=(-0.006, 0.007, 0.001, 0.006))
    d = ph.diagnose(ph.estimate(mass(), runs[:3]), validation=runs[3])
    (f,) = d.findings
    assert f.cause == "x:bias_per_experiment" and f.status == "named", d.summary()


def test_offsets_of_an_input_are_named_where_another_place_cannot_stand_for_them() -> None:
    """The input acts on two equations: an offset of it is none of a sensor, and none in one equation."""

    def model() -> ph.Model:
        m = ph.Model("short period")
        (de,), (a, q) = m.inputs(de="rad"), m.states(alpha="rad", q="rad/s")
        za, zd, ma, mq, md = m.parameters(za=-1.0, zd=-0.5, ma=-6.0, mq=-1.6, md=-9.0)
        m.dynamics(alpha=za * a + q + zd * de, q=ma * a + mq * q + md * de)
        m.outputs(alpha=a, q=q)
        return m

    truth = dict(za=-1.0, zd=-0.5, ma=-6.0, mq=-1.6, md=-9.0)
    rng, runs = np.random.default_rng(7), []
    for i, offset in enumerate((0.01, -0.012, 0.002)):
        de = 0.05 * np.repeat(rng.uniform(-1.0, 1.0, 40), 20)[: T.size]
        run = ph.simulate(model(), truth, ph.Experiment(T, {"de": de}), initial={"alpha": 0.0, "q": 0.0})
        y = {n: z + 2e-3 * rng.standard_normal(T.size) for n, z in run.outputs.items()}
        runs.append(ph.Experiment(T, {"de": de + offset}, y, name=f"flight {i + 1}"))
    d = ph.diagnose(ph.estimate(model(), runs))
    (f,) = [f for f in d.findings if f.status == "named"]
    assert f.cause == "de:bias_per_experiment", d.summary()
    differences = f.parameters["de[flight 2]"][0] - f.parameters["de[flight 1]"][0]
    assert abs(abs(differences) - 0.022) < 0.002


def test_a_rudder_offset_of_each_record_is_found_beside_a_quadratic_damping() -> None:
    """The offset stood for noise of a correlation time beyond the record, and a term in the heading was named with a
    gain below its threshold."""
    t = np.arange(0.0, 300.0, 1.0)

    def ship(damping: str = "") -> ph.Model:
        m = ph.Model("ship")
        rate, heading = m.states(r="deg/s", psi="deg")
        (rudder,) = m.inputs(rud="deg")
        a, b = m.parameters(a=0.03 if damping else 0.05, b=0.005 if damping else 0.01)
        m.dynamics(r=-a * rate + b * rudder - (0.04 * rate * abs(rate) if damping else 0.0), psi=rate)
        m.outputs(r=rate, psi=heading)
        return m

    def record(seed: int, offset: float) -> ph.Experiment:
        rng = np.random.default_rng(seed)
        corners = np.r_[0.0, np.cumsum(rng.uniform(20.0, 50.0, 20))]
        rudder = np.interp(t, np.sort(np.r_[corners, corners + 4.0]), np.repeat(rng.uniform(-25.0, 25.0, 21), 2))
        moved = ph.Experiment(t, {"rud": rudder - offset})
        run = ph.simulate(ship("quadratic"), {"a": 0.03, "b": 0.005}, moved, initial={"r": 0.1, "psi": 40.0})
        noise = {"r": 0.02, "psi": 0.3}
        y = {n: run.outputs[n] + s * rng.standard_normal(t.size) for n, s in noise.items()}
        return ph.Experiment(t, {"rud": rudder}, y, name=f"{offset:g}")

    d = ph.diagnose(ph.estimate(ship(), [record(1, 2.5), record(2, -1.5)]), validation=record(3, 1.0))
    found = {f.cause: f for f in d.findings if f.status == "named"}
    assert set(found) == {"rud:bias_per_experiment", "r':r|r|"}, d.summary()
    # As the final model has it, not as it was beside a linear damping.
    values = found["rud:bias_per_experiment"].parameters
    for name, truth in {"2.5": -2.5, "-1.5": 1.5}.items():
        value, error = next(v for key, v in values.items() if key.endswith(f"[{name}]"))
        assert abs(value - truth) < 4.0 * error < 0.2
