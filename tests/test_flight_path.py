"""Flight-path reconstruction: known errors of sensors are found and put right; the flights are made otherwise."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import flight_path as example
import flight_path_twin as twin
import numpy as np
import pytest
from numpy.typing import NDArray
from records import find

import phugoid as ph

OUTPUTS = ("V", "alpha", "beta", "phi", "theta", "psi")
DELAYED = ("V", "alpha", "beta")
Channels = dict[str, NDArray[np.float64]]


@pytest.fixture(scope="module")
def truth() -> ph.results.Record:
    return twin.flown()


def true_channels(truth: ph.results.Record) -> Channels:
    """Without any error, each from its definition."""
    s = truth.states
    V = np.sqrt(s["u"] ** 2 + s["v"] ** 2 + s["w"] ** 2)
    air = {"V": V, "alpha": np.arctan2(s["w"], s["u"]), "beta": np.arcsin(s["v"] / V)}
    return {**{n: s[n] for n in ("p", "q", "r", "phi", "theta", "psi")}, **truth.outputs, **air}


def over_ground(truth: ph.results.Record) -> NDArray[np.float64]:
    """(3, N) speeds of the body north, east and down, in calm air."""
    from scipy.spatial.transform import Rotation

    s = truth.states
    turned = Rotation.from_euler("ZYX", np.array([s["psi"], s["theta"], s["phi"]]).T)
    return np.asarray(turned.apply(np.array([s["u"], s["v"], s["w"]]).T).T)


def values(fit: ph.Fit) -> dict[str, float]:
    return {n: e.value for n, e in fit.parameters.items() if n not in fit.noise_parameters}


def test_without_noise_the_errors_are_found_to_many_digits(truth: ph.results.Record) -> None:
    c = true_channels(truth)
    read = {n: v + twin.ERRORS.get(f"b_{n}", 0.0) for n, v in c.items()}
    read |= {n: twin.ERRORS[f"K_{n}"] * c[n] for n in ("alpha", "beta")}
    run = ph.Experiment(truth.t, channels=read)
    found = values(ph.reconstruct(run, OUTPUTS, noise=ph.Gaussian(twin.NOISE)).fit)
    expected = {n: v for n, v in twin.ERRORS.items() if not n.startswith("tau")}
    assert {n: found[n] for n in expected} == pytest.approx(expected, rel=2e-3, abs=2e-6)


def test_known_errors_are_found_within_three_standard_errors(truth: ph.results.Record) -> None:
    path = ph.reconstruct(twin.measured(truth, 0, inertial_noise=False), OUTPUTS, delayed=DELAYED)
    assert path.fit.converged
    for n, e in twin.ERRORS.items():
        found = path.fit.parameters[n]
        # Between samples 0.04 s apart the late channels of the twin are lines.
        slack = 5e-4 if n.startswith(("tau", "K")) else 0.0
        assert abs(found.value - e) < 3 * found.std_error + slack, n
        assert found.std_error < 0.02 * abs(e) + 0.001


def test_noise_of_inertial_sensors_adds_its_mean(truth: ph.results.Record) -> None:
    path = ph.reconstruct(twin.measured(truth, 2), OUTPUTS, delayed=DELAYED)
    for n, e in twin.ERRORS.items():
        mean = twin.INERTIAL.get(n.removeprefix("b_"), 0.0) / np.sqrt(truth.t.size)
        error = np.hypot(path.coloured_errors[n], mean)
        slack = 5e-4 if n.startswith(("tau", "K")) else 0.0
        assert abs(path.fit.parameters[n].value - e) < 3 * error + slack, n


def test_the_corrected_record_is_the_truth_and_keeps_the_rest(truth: ph.results.Record) -> None:
    run = twin.measured(truth, 0)
    (right,) = ph.reconstruct(run, OUTPUTS, delayed=DELAYED).corrected
    c = true_channels(truth)
    for n, tolerance in {"V": 0.05, "alpha": 4e-4, "beta": 4e-4, "phi": 3e-4, "theta": 3e-4, "psi": 3e-4}.items():
        assert np.abs(right.channels[n] - c[n]).max() < tolerance, n
        # Nearer to the truth than what was measured.
        assert np.std(right.channels[n] - c[n]) < 0.5 * np.std(run.channels[n] - c[n]), n
    for n in ("ax", "ay", "az", "p", "q", "r"):
        assert right.channels[n] == pytest.approx(run.channels[n] - twin.ERRORS[f"b_{n}"], abs=0.003)
    assert right.channels["de"] == pytest.approx(run.inputs["de"]) and right.name == run.name
    assert right.history[-1].startswith("flight path reconstructed: p, q, r, ax")
    # It is data for the next step, which finds the derivatives that were put in.
    regression = ph.equation_error(example.attas.model(vane=False), right).parameters
    for n in ("Ma", "Mq", "Mde"):
        assert regression[n].value == pytest.approx(twin.DERIVATIVES[n], rel=0.02)
    raw = ph.equation_error(example.attas.model(vane=False), run).parameters["Mq"].value
    assert abs(raw - twin.DERIVATIVES["Mq"]) > 0.2


def test_sensors_off_the_centre_of_gravity(truth: ph.results.Record) -> None:
    c = true_channels(truth)
    rates = np.array([c[n] for n in "pqr"]).T
    turning = accelerations(truth)
    imu, vane = np.array([2.0, -0.5, 0.8]), np.array([9.0, 0.6, -0.3])
    felt = np.cross(turning, imu) + np.cross(rates, np.cross(rates, imu))
    read = {**c, **{n: c[n] + felt[:, i] for i, n in enumerate(("ax", "ay", "az"))}}
    s = truth.states
    there = np.array([s["u"], s["v"], s["w"]]).T + np.cross(rates, vane)
    read |= {"alpha": np.arctan2(there[:, 2], there[:, 0]), "beta": np.arctan2(there[:, 1], there[:, 0])}
    read |= {f"{n}dot": turning[:, i] for i, n in enumerate("pqr")}
    places: dict[str, Any] = {"accelerometer": imu, "alpha_vane": vane, "beta_vane": vane, "flank": True}
    run = ph.Experiment(truth.t, channels=read)
    known = ph.Gaussian(twin.NOISE)
    path = ph.reconstruct(run, OUTPUTS, noise=known, **places)
    found = values(path.fit)
    assert max(abs(v) for n, v in found.items() if n.startswith("b_")) < 3e-4
    assert found["K_alpha"] == pytest.approx(1.0, abs=2e-3) and found["K_beta"] == pytest.approx(1.0, abs=2e-3)
    (right,) = path.corrected
    assert right.channels["az"] == pytest.approx(c["az"], abs=2e-3)
    assert right.channels["alpha"] == pytest.approx(c["alpha"], abs=1e-4)
    # Where the places are not said, the vane seems to be wrong.
    assert abs(values(ph.reconstruct(run, OUTPUTS, noise=known).fit)["K_alpha"] - 1.0) > 0.01
    # Angular accelerations need not be in the record.
    without = ph.Experiment(truth.t, channels={n: v for n, v in read.items() if not n.endswith("dot")})
    again = ph.reconstruct(without, OUTPUTS, noise=known, **places)
    assert values(again.fit)["K_alpha"] == pytest.approx(1.0, abs=5e-3)
    assert again.runs[0].history == ("pdot, qdot, rdot from smoothing splines",)


def accelerations(truth: ph.results.Record) -> NDArray[np.float64]:
    """(N, 3) of the rates, by a spline through them: steps of the controls are ramps of 0.2 s."""
    from scipy.interpolate import CubicSpline

    return np.array([CubicSpline(truth.t, truth.states[n])(truth.t, 1) for n in "pqr"]).T


def test_wind_height_and_speeds_over_ground(truth: ph.results.Record) -> None:
    from scipy.integrate import cumulative_trapezoid

    c = true_channels(truth)
    north, east, down = over_ground(truth) + np.array([[8.0], [-5.0], [0.0]])
    track = {
        n: cumulative_trapezoid(v, x=truth.t, initial=0.0) for n, v in (("north", north), ("east", east), ("h", -down))
    }
    speeds = {"v_north": north, "v_east": east, "v_down": down}
    sigma = {**twin.NOISE, "h": 1.0, "north": 1.0, "east": 1.0, "v_north": 0.1, "v_east": 0.1, "v_down": 0.1}
    bent = {**c, **track, **speeds, "alpha": c["alpha"] + 0.01, "az": c["az"] + 0.05}
    for ground in (("h", "north", "east"), ("h", "v_north", "v_east", "v_down")):
        outputs = (*OUTPUTS, *ground)
        noise = ph.Gaussian({n: sigma[n] for n in outputs})
        found = values(ph.reconstruct(ph.Experiment(truth.t, channels=bent), outputs, noise=noise).fit)
        assert found["wind_north"] == pytest.approx(8.0, abs=0.02) and found["wind_east"] == pytest.approx(
            -5.0, abs=0.02
        )
        assert found["b_alpha"] == pytest.approx(0.01, abs=3e-4) and found["b_az"] == pytest.approx(0.05, abs=3e-3)
    rising = {**bent, "h": track["h"] + 2.0 * truth.t, "alpha": c["alpha"]}
    noise = ph.Gaussian({n: sigma[n] for n in (*OUTPUTS, "h")})
    only_up = {"biases": ("az",), "wind": ("up",), "noise": noise}
    found = values(ph.reconstruct(ph.Experiment(truth.t, channels=rising), (*OUTPUTS, "h"), **only_up).fit)
    assert found["wind_up"] == pytest.approx(2.0, abs=0.01) and found["b_az"] == pytest.approx(0.05, abs=2e-3)


def test_the_longitudinal_motion_alone() -> None:
    m = ph.Model("level")
    u, w, theta, h = m.states(u="m/s", w="m/s", theta="rad", h="m")
    ax, az, q = m.inputs("ax az q")
    g = 9.80665
    m.dynamics(
        u=ax - g * ph.sin(theta) - q * w,
        w=az + g * ph.cos(theta) + q * u,
        theta=q,
        h=u * ph.sin(theta) - w * ph.cos(theta),
    )
    m.outputs(u=u)
    t = 0.05 * np.arange(401)
    q_in = 0.05 * np.sin(0.9 * t)
    # Lift that follows the rate keeps the angle of attack small.
    az_in = -g - 60.0 * q_in
    run = ph.Experiment(t, {"ax": 0.3 + 0.1 * np.sin(0.4 * t), "az": az_in, "q": q_in})
    s = ph.simulate(m, {}, run, initial={"u": 60.0, "theta": 0.05}).states
    read = {
        "V": np.hypot(s["u"], s["w"]),
        "alpha": 1.2 * np.arctan2(s["w"], s["u"]) + 0.02,
        "theta": s["theta"],
        "h": s["h"],
    }
    inertial = {"ax": run.inputs["ax"] + 0.1, "az": run.inputs["az"] - 0.2, "q": run.inputs["q"] + 0.002}
    data = ph.Experiment(t, inertial, read)
    path = ph.reconstruct(
        data, longitudinal=True, noise=ph.Gaussian({"V": 0.1, "alpha": 0.001, "theta": 0.001, "h": 0.5})
    )
    expected = {"b_ax": 0.1, "b_az": -0.2, "b_q": 0.002, "b_alpha": 0.02, "K_alpha": 1.2}
    assert values(path.fit) == pytest.approx(expected, rel=1e-3)
    assert path.corrected[0].channels["az"] == pytest.approx(az_in, abs=1e-3)


def test_a_heading_that_jumps_is_unwrapped(truth: ph.results.Record) -> None:
    run = twin.measured(truth, 0)
    turned = {**run.channels, "psi": (run.channels["psi"] + 2.9 + np.pi) % (2 * np.pi) - np.pi}
    assert np.ptp(turned["psi"]) > 6
    jumped = ph.reconstruct(ph.Experiment(run.t, channels=turned), OUTPUTS, delayed=DELAYED)
    assert "psi unwrapped" in jumped.runs[0].history
    straight = ph.reconstruct(run, OUTPUTS, delayed=DELAYED)
    assert values(jumped.fit) == pytest.approx(values(straight.fit), rel=1e-4)


def test_several_records_share_what_is_not_their_own(truth: ph.results.Record) -> None:
    runs = [twin.measured(truth, seed, name=name) for seed, name in ((0, "a"), (1, "b"))]
    path = ph.reconstruct(runs, OUTPUTS, per_experiment=("q",))
    found = values(path.fit)
    assert {"b_q[a]", "b_q[b]", "b_p", "K_alpha"} < set(found) and "b_q" not in found
    assert [r.name for r in path.corrected] == ["a", "b"]
    text = path.summary()
    assert "Flight path of 'a', 'b': converged" in text and "autocorrelation at lag 1" in text


def test_coloured_errors_are_the_scatter_where_those_for_white_noise_are_not() -> None:
    m = ph.Model("lag")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    a, b, c = m.parameters(a=1.0, b=2.0, c=0.1)
    m.dynamics(x=-a * x + b * u)
    m.outputs(x=x + c)
    m.initial(x=0.0)
    t = 0.1 * np.arange(400)
    run = ph.Experiment(t, {"u": ph.design.multisine(t, 1.0, band=(0.05, 1.0), phases="schroeder")})
    y = ph.simulate(m, {"a": 1.0, "b": 2.0, "c": 0.1}, run).outputs["x"]
    rng = np.random.default_rng(5)
    found, white, coloured = [], [], []
    for _ in range(80):
        e = np.zeros(t.size)
        for k, w in enumerate(0.05 * rng.standard_normal(t.size - 1), start=1):
            e[k] = 0.8 * e[k - 1] + w
        fit = ph.estimate(m, run.with_outputs({"x": y + e}))
        found.append([fit.parameters[n].value for n in "abc"])
        white.append([fit.parameters[n].std_error for n in "abc"])
        coloured.append([fit.robust().parameters[n].std_error for n in "abc"])
    scatter = np.std(found, axis=0, ddof=1)
    # 80 samples: a standard deviation is known to 8 %.
    assert np.mean(coloured, axis=0) / scatter == pytest.approx(1.0, abs=0.25)
    assert (np.mean(white, axis=0) / scatter).min() < 0.5


def test_biases_that_nothing_tells_are_left_out_unless_asked_for() -> None:
    names = ph.models.flight_path("V alpha beta phi theta").parameter_names
    assert names == ("b_ax", "b_ay", "b_az", "b_p", "b_q", "K_alpha", "K_beta")
    more = ph.models.flight_path(
        "V alpha beta phi theta psi h", biases=("p", "V"), scales=("ax",), delayed="V"
    ).parameter_names
    assert more == ("b_p", "b_V", "K_ax", "tau_V")
    assert "wind_north" in ph.models.flight_path("V v_north v_east").parameter_names


def test_it_is_saved_and_loaded(truth: ph.results.Record, tmp_path: Path) -> None:
    path = ph.reconstruct(twin.measured(truth, 0).window(0.0, 12.0), OUTPUTS)
    path.fit.save(tmp_path / "fit.json")
    assert values(ph.load(tmp_path / "fit.json")) == values(path.fit)


@pytest.mark.skipif(any(find(n) is None for n in example.attas.RECORDS), reason="the ATTAS records are not here")
def test_attas_vanes_on_the_boom_are_in_scale_and_regression_agrees_with_output_error() -> None:
    runs = example.records()
    path = example.reconstruct(runs)
    p, errors = path.fit.parameters, path.coloured_errors
    assert path.fit.converged and path.vane_positions is None
    for n in ("K_alpha", "K_beta"):
        assert abs(p[n].value - 1.0) < errors[n] < 0.03
    regression = ph.equation_error(example.attas.model(vane=False), list(path.corrected)).parameters
    assert regression["Mq"].value == pytest.approx(-1.50, abs=0.1)
    assert regression["Zde"].value == pytest.approx(-0.08, abs=0.03)
    raw = ph.equation_error(example.attas.model(vane=False), runs).parameters
    assert raw["Mq"].value < -1.8 and raw["Zde"].value > 0.1


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"outputs": "V alfa"}, "'alfa' is not an output of it. Did you mean 'alpha'"),
        ({"outputs": "alpha theta"}, "V, the true airspeed, must be among the outputs"),
        ({"outputs": "V V"}, "each once"),
        ({"outputs": "V beta", "longitudinal": True}, "'beta' is not an output"),
        ({"biases": ("aq",)}, "biases: there is no such channel 'aq'"),
        ({"scales": ("psi",)}, "scales: there is no such channel 'psi'"),
        ({"delayed": ("q",)}, "delayed: there is no such channel 'q'"),
        ({"per_experiment": ("r",)}, "per_experiment: there is no such channel 'r'"),
        ({"wind": ("north",)}, "wind shows only in outputs over ground"),
        ({"wind": ("west",)}, "wind is of north, east, up"),
        ({"accelerometer": (1.0, 2.0)}, "accelerometer is its position"),
        ({"alpha_vane": (1.0, 2.0, np.nan)}, "alpha_vane is its position"),
        ({"outputs": "V theta", "longitudinal": True, "flank": True}, "six degrees of freedom"),
    ],
)
def test_what_cannot_be_is_refused_in_words(options: dict[str, Any], says: str) -> None:
    with pytest.raises(ph.OptionError, match=says):
        ph.models.flight_path(**options)


def test_reconstruct_refuses_other_models_and_double_options(truth: ph.results.Record) -> None:
    run = twin.measured(truth, 0)
    with pytest.raises(ph.ModelError, match="'twin' is not a flight-path model"):
        ph.reconstruct(run, twin.aircraft())
    with pytest.raises(ph.OptionError, match="delayed: options make a model"):
        ph.reconstruct(run, ph.models.flight_path(), delayed=DELAYED)
    with pytest.raises(ph.DataError, match="has no input 'ax'"):
        ph.reconstruct(run.rename({"ax": "nx"}), OUTPUTS)


def test_the_former_name_of_delayed_is_accepted_with_a_warning() -> None:
    with pytest.warns(DeprecationWarning, match="late of flight_path is now delayed"):
        former = ph.models.flight_path(OUTPUTS, late=DELAYED)
    assert str(former) == str(ph.models.flight_path(OUTPUTS, delayed=DELAYED))
