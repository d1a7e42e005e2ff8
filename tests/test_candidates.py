"""The library of candidates: what is in it, what its signals are, and that its extensions can be fitted."""

from __future__ import annotations

import pickle
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

import phugoid as ph
from phugoid import _core
from phugoid.delayed import at_delays
from phugoid.discrepancy.along import lagged, late_smooth
from phugoid.discrepancy.candidates import FAMILIES
from phugoid.discrepancy.scales import trim_of
from phugoid.rebuilt import rebuilt

TRUTH = {"CL0": -0.045, "CLa": 0.9, "Cm0": 0.02, "Cma": -4.0, "Cmq": -2.0, "Cmde": -6.0, "b_az": 0.3}
SIGMA = {"alpha": 0.0005, "q": 0.001, "az": 0.005}


def pitch() -> ph.Model:
    """Short period about a trimmed elevator; az measures the lift with a bias."""
    m = ph.Model("pitch")
    alpha, q = m.states(alpha="rad", q="rad/s")
    (de,) = m.inputs(de="rad")
    CL0, CLa, Cm0, Cma, Cmq, Cmde, b_az = m.parameters("CL0 CLa Cm0 Cma Cmq Cmde b_az")
    CL, Cm = m.quantities(CL=CL0 + CLa * alpha, Cm=Cm0 + Cma * alpha + Cmq * q + Cmde * de)
    m.dynamics(alpha=q - CL, q=Cm)
    m.outputs(alpha=alpha, q=q, az=(-8.0 * CL + b_az, "m/s²"))
    m.noise(alpha=SIGMA["alpha"])
    return m


def oscillator() -> ph.Model:
    m = ph.Model("oscillator")
    x, v = m.states(x="m", v="m/s")
    (u,) = m.inputs(u="m/s²")
    k, c = m.parameters(k=1.0, c=0.1)
    m.dynamics(x=v, v=-k * x - c * v + u)
    m.outputs(x=x, v=v)
    return m


def record(seed: int = 0, n: int = 601) -> ph.Experiment:
    """Elevator: smooth noise about -0.03 rad, 30 s at 20 Hz."""
    t = 0.05 * np.arange(n)
    u = sosfiltfilt(butter(3, 0.08, output="sos"), np.random.default_rng(seed).standard_normal(n))
    return ph.Experiment(t, {"de": -0.03 + 0.05 * u / u.std()}, name="run")


def along(m: ph.Model, values: dict[str, float], r: ph.Record, t: np.ndarray | None = None) -> ph.Points:
    """Points along a simulated path: all that the model has names for, evaluated independently of the library."""
    inputs = dict(r.inputs)
    names = [name for name, *_ in m._core.quantities]
    core = rebuilt(m._core, m._core.inputs, lambda core, p: core.parameter(*p))
    for i, name in enumerate(names):
        core.output(f"copy_{i}", _core.Expr.symbol(name), "", None)
    theta = np.array([values[name] for name in m.parameter_names])
    columns = np.vstack([r.t, *(inputs[name] for name, _ in m._core.inputs), *r.states.values()])
    f = _core.Evaluator(core).dynamics(theta, columns)
    y = _core.Evaluator(core).outputs(theta, columns)[len(m.output_names) :]
    rates = dict(zip(m.state_names, f, strict=True)) | {n: np.gradient(u, r.t) for n, u in inputs.items()}
    slopes = {name: np.gradient(v, r.t) for name, v in r.outputs.items()}
    everything = {**r.states, **inputs, **dict(zip(names, y, strict=True))}
    return ph.Points(r.name, r.t, everything, rates, dict(r.outputs), slopes)


@pytest.fixture(scope="module")
def path() -> ph.Points:
    m = pitch()
    r = ph.simulate(m, TRUTH, record(), initial={"alpha": 0.04, "q": 0.0})
    return along(m, TRUTH, r)


@pytest.fixture(scope="module")
def library(path: ph.Points) -> ph.Candidates:
    return ph.candidates(pitch(), points=[path])


# ---------------------------------------------------------------- what is in it


def test_the_library_of_the_hfb320_model() -> None:
    sys.path.insert(0, str(Path(__file__).parent.parent / "examples"))
    import hfb320

    library = ph.candidates(hfb320.model())
    assert library.families == {
        "linear": 48,
        "square": 25,
        "product": 45,
        "cube": 18,
        "quadratic": 18,
        "absolute": 18,
        "sign": 9,
        "lag": 27,
        "periodic": 3,
        "bias": 4,
        "scale": 8,
        "drift": 7,
        "rate": 6,
        "delay": 9,
        "deadband": 2,
        "saturation": 2,
    }
    assert library.only("Cm:*").names == (
        *("Cm:theta", "Cm:T", "Cm:V^2", "Cm:alpha^2", "Cm:theta^2", "Cm:q^2", "Cm:de^2", "Cm:T^2"),
        *("Cm:V*alpha", "Cm:V*theta", "Cm:V*q", "Cm:V*de", "Cm:V*T", "Cm:alpha*theta", "Cm:alpha*q", "Cm:alpha*de"),
        *("Cm:alpha*T", "Cm:theta*q", "Cm:theta*de", "Cm:theta*T", "Cm:q*de", "Cm:q*T", "Cm:de*T"),
        *("Cm:V^3", "Cm:alpha^3", "Cm:theta^3", "Cm:q^3", "Cm:de^3", "Cm:T^3"),
        *("Cm:V|V|", "Cm:alpha|alpha|", "Cm:theta|theta|", "Cm:q|q|", "Cm:de|de|", "Cm:T|T|"),
        *("Cm:|V|", "Cm:|alpha|", "Cm:|theta|", "Cm:|q|", "Cm:|de|", "Cm:|T|"),
        *("Cm:sign(q)", "Cm:sign(de)", "Cm:sign(T)"),
        *("Cm:lag_V", "Cm:lag_alpha", "Cm:lag_theta", "Cm:lag_q", "Cm:lag_de", "Cm:lag_T", "Cm:periodic"),
    )
    # Its own bias is there; q' + bias is what it measures, so that q' is its scale.
    assert library.only("aq:*").names == (
        *("aq:scale", "aq:drift", "aq:V", "aq:alpha", "aq:theta", "aq:q", "aq:de", "aq:T", "aq:q^2"),
        *("aq:lag", "aq:delay"),
    )
    # The elevator stands beside Cmde and Cm0 only: its scale and bias are theirs.
    inputs = ("de:deadband", "de:saturation", "de:lag", "de:delay")
    assert library.only("de:*", "T:*").names == (
        *inputs,
        *("T:scale", "T:bias", "T:deadband", "T:saturation", "T:lag", "T:delay"),
    )
    # Kinematics and what quantities govern are not doubted.
    assert not any(name.split(":")[0].endswith("'") for name in library.names)


def test_state_equations_that_hold_parameters_are_places() -> None:
    library = ph.candidates(oscillator())
    assert not any(name.startswith("x':") for name in library.names)
    assert {"v':x^3", "v':v|v|", "v':sign(v)", "v':bias", "v':lag_x", "v':periodic", "x:v", "u:delay"} <= {
        *library.names
    }
    # The input stands alone in one equation: a term with it is its scale, its offset is a bias there.
    assert "u:scale" in library and "v':u" not in library
    assert "v':bias" in library and "u:bias" not in library
    every = ph.candidates(pitch(), equations="all")
    assert "q':alpha*q" in every and "alpha':alpha^2" in every and "q':alpha*q" not in ph.candidates(pitch())


def test_scales_are_those_of_the_record(path: ph.Points, library: ph.Candidates) -> None:
    trim = trim_of([path])
    assert trim["de"] == pytest.approx(-0.03, abs=0.02) and trim["q"] == 0.0
    assert "Cm:sign(q)" in library
    still = {**path.values, "de": np.full(path.n, -0.03)}
    calm = ph.Points("calm", path.t, still, path.rates, path.outputs, path.output_rates)
    assert not any(re.search(r"\bde\b|_de", name) for name in ph.candidates(pitch(), points=[calm]).names)
    one_sided = {**path.values, "q": np.abs(path.values["q"])}
    climb = ph.Points("climb", path.t, one_sided, path.rates, path.outputs, path.output_rates)
    assert "Cm:sign(q)" not in ph.candidates(pitch(), points=[climb])
    assert ph.candidates(pitch()).on([path]).names == library.names
    frequencies = np.array([shape["Cm_frequency"] for shape in library["Cm:periodic"].shapes])
    assert frequencies[0] == pytest.approx(2 * np.pi / 30)
    assert np.diff(frequencies).max() <= np.pi / 30 + 1e-12 and frequencies.size <= 200


def test_a_collection_is_read_by_number_name_and_pattern(library: ph.Candidates) -> None:
    assert library[0] is library[library[0].name] and len(library[:5]) == 5
    assert library["Cm:alpha*q"] in library and "Cm:alpha*q" in library
    assert library.only("Cm:alpha*q").names == ("Cm:alpha*q",)  # its star is no wild card
    assert len(library.without("*:lag_*", "Cm:periodic")) == len(library) - 7
    assert (library.only("Cm:*") + library.only("de:*")).names == library.only("Cm:*", "de:*").names
    assert {c.family for c in library} < {*FAMILIES}  # type: ignore[attr-defined]
    assert "Cm has a part that goes with the product of alpha and q" in str(library)
    again = pickle.loads(pickle.dumps(library))
    assert again.names == library.names and str(again["Cm:alpha^2"].extended(pitch())) == str(
        library["Cm:alpha^2"].extended(pitch())
    )


# ---------------------------------------------------------------- signals


def right_sides(
    m: ph.Model, theta: dict[str, float], p: ph.Points, more: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """State derivatives and outputs of a model along points, with further states and late inputs put in."""
    evaluator = _core.Evaluator(m._core)
    columns = [p.t]
    columns += [more[name] if name in more else p.values[name] for name, _ in m._core.inputs]
    columns += [more[name] if name in more else p.values[name] for name in m.state_names]
    numbers = np.array([theta[name] for name in m.parameter_names])
    f, y = evaluator.dynamics(numbers, np.vstack(columns)), evaluator.outputs(numbers, np.vstack(columns))
    found = {f"{name}'": row for name, row in zip(m.state_names, f, strict=True)}
    return found | {name: row for name, row in zip(m.output_names, y, strict=True)}


def test_signals_are_what_extensions_add(path: ph.Points, library: ph.Candidates) -> None:
    """Of every candidate: the change of all right-hand sides along the path is its signal, through its place."""
    m, p = pitch(), path
    base = right_sides(m, TRUTH, p, {})
    checked = 0
    for c in library:
        shape = c.shapes[len(c.shapes) // 2]
        signals = c.signals(p, shape)
        assert signals.shape == (1 if c.unit_amplitude else len(c.coefficients), p.n)
        size = dict(zip(c.coefficients, (0.7, -0.3), strict=False))
        added = signals[0] if c.unit_amplitude else np.array(list(size.values())) @ signals
        extended = c.extended(m, {**size, **shape})
        extended.check()
        starts = {name: x.start for name, x in extended.declared_parameters.items()}
        assert all(starts[name] == pytest.approx(value) for name, value in {**size, **shape}.items())
        what, more = c.name.split(":")[1], {}
        if "lag" in what:
            (lag,) = {*extended.state_names} - {*m.state_names}
            of = p.outputs[c.place.name] if c.place.kind == "output" else p.values[lag.removesuffix("_lag")]
            more[lag] = lagged(p.t, of, shape[c.shape_names[0]])
        if c.name == "de:delay":
            more["de_delayed"] = np.interp(p.t - shape["tau_de"], p.t, p.values["de"])
            more |= dict.fromkeys(("de_delayed_rate", "de_delayed_bend"), np.zeros(p.n))
            extended = at_delays(extended, shape)
        if c.place.kind == "output" and what == "delay":
            # A late output is moved, not its equation.
            assert extended.delays.outputs == {c.place.name: c.shape_names[0]}
            assert str(extended) == str(m)
            continue
        after = right_sides(extended, {**TRUTH, **size, **shape}, p, more)
        through = {"CL": {"alpha'": -1.0, "az": -8.0}, "Cm": {"q'": 1.0}, "de": {"q'": TRUTH["Cmde"]}}
        gains = through.get(c.place.name, {c.place.name: 1.0})
        scale = float(np.abs(added).max())
        assert scale > 0, c.name
        for name, before in base.items():
            change = after[name] - before
            assert change == pytest.approx(gains.get(name, 0.0) * added, abs=1e-9 * max(scale, 1.0)), (c.name, name)
        checked += 1
    assert checked > 60


def test_lags_and_late_outputs_along_a_path_are_those_of_a_simulation(library: ph.Candidates) -> None:
    """Independently: extended models, integrated."""
    m, fine = pitch(), record(n=121)
    first = {"alpha": 0.04, "q": 0.0}
    base = ph.simulate(m, TRUTH, fine, initial=first)
    p = along(m, TRUTH, base)
    lag = library["de:lag"]
    r = ph.simulate(lag.extended(m), {**TRUTH, "lag_de": 0.21}, fine, initial=first)
    assert r.states["de_lag"] == pytest.approx(p.values["de"] + lag.signals(p, {"lag_de": 0.21})[0], abs=1e-8)
    sensor = library["az:lag"]
    r = ph.simulate(sensor.extended(m), {**TRUTH, "lag_az": 0.4}, fine, initial=first)
    change = r.outputs["az"] - base.outputs["az"]
    assert change == pytest.approx(sensor.signals(p, {"lag_az": 0.4})[0], abs=2e-3 * np.ptp(base.outputs["az"]))
    late = library["az:delay"]
    r = ph.simulate(late.extended(m), {**TRUTH, "tau_az": 0.12}, fine, initial=first)
    change, signal = r.outputs["az"] - base.outputs["az"], late.signals(p, {"tau_az": 0.12})[0]
    assert np.isnan(change[:3]).all() and (signal[:3] == 0).all()
    assert change[3:] == pytest.approx(signal[3:], abs=2e-3 * np.ptp(base.outputs["az"]))


def test_a_lag_is_exact_for_broken_lines() -> None:
    """Against fine steps, on irregular times."""
    random = np.random.default_rng(1)
    t = np.cumsum(random.uniform(0.01, 0.3, 80))
    u = random.standard_normal(80)
    for tau in (0.003, 0.2, 50.0):
        z, numbers = np.empty(80), [u[0]]
        for k in range(79):  # the solution of each interval in closed form
            h, slope = t[k + 1] - t[k], (u[k + 1] - u[k]) / (t[k + 1] - t[k])
            numbers.append(u[k + 1] - slope * tau + (numbers[k] - u[k] + slope * tau) * np.exp(-h / tau))
        z[:] = numbers
        assert lagged(t, u, tau) == pytest.approx(z, abs=1e-9)


def test_a_late_signal_is_interpolated_smoothly() -> None:
    t = np.linspace(0, 10, 201)
    late = late_smooth(t, np.sin(t), np.cos(t), 0.333)
    assert np.isnan(late[:7]).all()
    assert late[7:] == pytest.approx(np.sin(t[7:] - 0.333), abs=1e-7)


# ---------------------------------------------------------------- extensions are fitted


EFFECTS = {
    "Cm:alpha^2": {"Cm_alpha2": 9.0},
    "Cm:q|q|": {"Cm_q_abs_q": -6.0},
    "Cm:sign(q)": {"Cm_sign_q": -0.08},
    "Cm:lag_alpha": {"Cm_lag_alpha": -3.0, "tau_Cm_alpha": 0.6},
    "Cm:periodic": {"Cm_sin": 0.06, "Cm_cos": -0.03, "Cm_frequency": 2.3},
    "alpha:scale": {"k_alpha": 0.06},
    "alpha:drift": {"y_alpha_drift": 0.0004},
    "alpha:q": {"y_alpha_q": 0.04},
    "az:q'": {"y_az_q_dot": 0.15},
    "alpha:delay": {"tau_alpha": 0.08},
    "alpha:lag": {"lag_alpha": 0.15},
    "de:delay": {"tau_de": 0.09},
    "de:lag": {"lag_de": 0.18},
    "de:deadband": {"deadband_de": 0.02},
    "de:saturation": {"saturation_de": 0.06},
}


@pytest.mark.parametrize("name", EFFECTS)
def test_what_was_put_in_is_estimated(name: str, library: ph.Candidates) -> None:
    """From the base model's truth and a rough value of the shape, as a scan gives it."""
    c, true = library[name], EFFECTS[name]
    model, empty = c.extended(pitch()), record(3)
    r = ph.simulate(model, {**TRUTH, **true}, empty, initial={"alpha": 0.04, "q": 0.0})
    random = np.random.default_rng(7)
    z = {n: y + SIGMA[n] * random.standard_normal(empty.n) for n, y in r.outputs.items()}
    nearest = min(c.shapes, key=lambda s: sum(abs(np.log(s[n] / true[n])) for n in s))
    fit = ph.estimate(c.extended(pitch(), nearest), empty.with_outputs(z), start=TRUTH)
    assert fit.converged
    low_high = c.physical([along(pitch(), TRUTH, ph.simulate(pitch(), TRUTH, empty, initial={"alpha": 0.04, "q": 0}))])
    for parameter, value in true.items():
        e = fit.parameters[parameter]
        assert abs(e.value - value) < 4 * e.std_error, (e, value)
        assert e.std_error < 0.12 * abs(value), e
        low, high = low_high[parameter]
        assert low <= value <= high
    assert fit.parameters["Cma"].value == pytest.approx(TRUTH["Cma"], rel=0.1)
