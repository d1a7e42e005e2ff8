"""The library of candidates: what is in it, what its signals are, and that its extensions can be fitted."""

from __future__ import annotations

import pickle
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

import phugoid as ph
from phugoid import _core
from phugoid.discrepancy.candidates.library import FAMILIES
from phugoid.discrepancy.candidates.scales import late_smooth, trim_of
from phugoid.discrepancy.search.refit import Refit, refit
from phugoid.modelling.declared import Delays, rebuilt

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


def along(
    m: ph.Model, values: dict[str, float], r: ph.results.Record, t: np.ndarray | None = None
) -> ph.results.Points:
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
    return ph.results.Points(r.name, r.t, everything, rates, dict(r.outputs), slopes)


@pytest.fixture(scope="module")
def path() -> ph.results.Points:
    m = pitch()
    r = ph.simulate(m, TRUTH, record(), initial={"alpha": 0.04, "q": 0.0})
    return along(m, TRUTH, r)


@pytest.fixture(scope="module")
def library(path: ph.results.Points) -> ph.results.Candidates:
    return ph.candidates(pitch(), points=[path])


# ---------------------------------------------------------------- what is in it


def test_the_library_of_the_hfb320_model() -> None:
    import hfb320

    library = ph.candidates(hfb320.model())
    assert library.families == {
        "linear": 48,
        "square": 25,
        "product": 45,
        "damping": 9,
        "effectiveness": 18,
        "cube": 18,
        "sine": 3,  # of theta; they go when a record is there, too
        "quadratic": 18,
        "absolute": 18,
        "sign": 12,  # of V it goes when a record is there: V keeps its sign
        "lag": 30,  # of the thrust in what accelerometers show, too
        "periodic": 3,
        "bias": 4,
        "scale": 8,
        "drift": 7,
        "rate": 6,
        "curve": 13,  # of q its square is there already
        "ripple": 17,  # of alpha and theta; they go when a record is there: they are far from a quarter of a turn
        "delay": 9,
        "deadband": 2,
        "saturation": 3,  # of Cm and of the inputs
        "backlash": 4,  # of the inputs, and of the sensors of theta, a position, and alpha, an angle
        "rate_limit": 2,
        "clipped": 7,
        "integral": 11,  # of the thrust in each parameter, where it adds up
        "variation": 11,
        "step": 18,
        "stribeck": 6,
        "hysteresis": 6,
        "stall": 3,
        "mode": 3,
    }
    assert library.only("Cm:*").names == (
        *("Cm:theta", "Cm:T", "Cm:V^2", "Cm:alpha^2", "Cm:theta^2", "Cm:q^2", "Cm:de^2", "Cm:T^2"),
        *("Cm:V*alpha", "Cm:V*theta", "Cm:V*q", "Cm:V*de", "Cm:V*T", "Cm:alpha*theta", "Cm:alpha*q", "Cm:alpha*de"),
        *("Cm:alpha*T", "Cm:theta*q", "Cm:theta*de", "Cm:theta*T", "Cm:q*de", "Cm:q*T", "Cm:de*T"),
        *("Cm:V^2*q", "Cm:alpha^2*q", "Cm:theta^2*q"),
        *("Cm:V^2*de", "Cm:V^2*T", "Cm:alpha^2*de", "Cm:alpha^2*T", "Cm:theta^2*de", "Cm:theta^2*T"),
        *("Cm:V^3", "Cm:alpha^3", "Cm:theta^3", "Cm:q^3", "Cm:de^3", "Cm:T^3"),
        *("Cm:V|V|", "Cm:alpha|alpha|", "Cm:theta|theta|", "Cm:q|q|", "Cm:de|de|", "Cm:T|T|"),
        *("Cm:|V|", "Cm:|alpha|", "Cm:|theta|", "Cm:|q|", "Cm:|de|", "Cm:|T|"),
        *("Cm:sin(theta)", "Cm:cos(theta)", "Cm:sin(2*theta)"),
        *("Cm:sign(V)", "Cm:sign(q)", "Cm:sign(de)", "Cm:sign(T)"),
        *("Cm:lag_V", "Cm:lag_alpha", "Cm:lag_theta", "Cm:lag_q", "Cm:lag_de", "Cm:lag_T"),
        *("Cm:stribeck_V", "Cm:hysteresis_alpha", "Cm:hysteresis_theta", "Cm:stribeck_q", "Cm:stall"),
        *("Cm:periodic_theta", "Cm:saturation", "Cm:mode", "Cm:periodic"),
    )
    # Its own bias is there; q' + bias is what it measures, so that q' is its scale.
    assert library.only("aq:*").names == (
        *("aq:scale", "aq:drift", "aq:V", "aq:alpha", "aq:theta", "aq:q", "aq:de", "aq:T", "aq:q^2"),
        *("aq:aq^2", "aq:aq^3", "aq:lag_T", "aq:periodic_alpha", "aq:periodic_theta", "aq:clipped", "aq:lag"),
        "aq:delay",
        "aq:step",
    )
    # The elevator stands beside Cmde and Cm0 only: its scale and bias are theirs.
    inputs = ("de:deadband", "de:saturation", "de:backlash", "de:rate_limit", "de:lag", "de:delay")
    assert library.only("de:*", "T:*").names == (
        *inputs,
        *("T:scale", "T:bias", "T:deadband", "T:saturation", "T:backlash", "T:rate_limit", "T:lag", "T:delay"),
    )
    # Biases of sensors act on no state; what changes of them is the sensor's drift.
    assert library.only("Cma:*", "theta:drift").names == ("theta:drift", "Cma:integral_T", "Cma:drift", "Cma:step")
    assert "b_q:drift" not in library.names
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


def test_scales_are_those_of_the_record(path: ph.results.Points, library: ph.results.Candidates) -> None:
    trim = trim_of([path])
    assert trim["de"] == pytest.approx(-0.03, abs=0.02) and trim["q"] == 0.0
    assert "Cm:sign(q)" in library
    still = {**path.values, "de": np.full(path.n, -0.03)}
    calm = ph.results.Points("calm", path.t, still, path.rates, path.outputs, path.output_rates)
    assert not any(re.search(r"\bde\b|_de", name) for name in ph.candidates(pitch(), points=[calm]).names)
    one_sided = {**path.values, "q": np.abs(path.values["q"]) + 0.1 * np.ptp(path.values["q"])}
    climb = ph.results.Points("climb", path.t, one_sided, path.rates, path.outputs, path.output_rates)
    assert "Cm:sign(q)" not in ph.candidates(pitch(), points=[climb])
    assert ph.candidates(pitch()).on([path]).names == library.names
    frequencies = np.array([shape["Cm_frequency"] for shape in library["Cm:periodic"].shapes])
    assert frequencies[0] == pytest.approx(2 * np.pi / 30)
    assert np.diff(frequencies).max() <= np.pi / 30 + 1e-12 and frequencies.size <= 200


def test_a_collection_is_read_by_number_name_and_pattern(library: ph.results.Candidates) -> None:
    assert library[0] is library[library[0].name] and len(library[:5]) == 5
    assert library["Cm:alpha*q"] in library and "Cm:alpha*q" in library
    assert library.only("Cm:alpha*q").names == ("Cm:alpha*q",)  # its star is not a wild card
    assert len(library.without("*:lag_*", "Cm:periodic")) == len(library) - 7
    assert (library.only("Cm:*") + library.only("de:*")).names == library.only("Cm:*", "de:*").names
    assert {c.family for c in library} < {*FAMILIES}  # type: ignore[attr-defined]
    assert "Cm contains a term proportional to the product of (alpha - 0.05" in str(library)
    assert "Cm contains a term proportional to the product of alpha and q" in str(ph.candidates(pitch()))
    again = pickle.loads(pickle.dumps(library))
    assert again.names == library.names and str(again["Cm:alpha^2"].extended(pitch())) == str(
        library["Cm:alpha^2"].extended(pitch())
    )


# ---------------------------------------------------------------- signals


def right_sides(
    m: ph.Model, theta: dict[str, float], p: ph.results.Points, more: dict[str, np.ndarray]
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


def test_signals_are_what_extensions_add(path: ph.results.Points, library: ph.results.Candidates) -> None:
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
            more[lag] = _core.lagged(p.t, of, shape[c.shape_names[0]])
        if c.name == "de:delay":
            more["de_delayed"] = np.interp(p.t - shape["tau_de"], p.t, p.values["de"])
            more |= dict.fromkeys(("de_delayed_rate", "de_delayed_bend"), np.zeros(p.n))
            core = extended._core.at_delays(extended.delays.spec, list(shape.items()))
            extended = extended._around(core, Delays())
        if c.place.kind == "output" and what == "delay":
            # A late output is moved, not its equation.
            assert extended.delays.outputs == {c.place.name: c.shape_names[0]}
            assert str(extended) == str(m)
            continue
        if c.family in ("backlash", "rate_limit"):  # what they do depends on the past: see below
            continue
        more |= c.paths(p, shape)
        after = right_sides(extended, {**starts, **TRUTH, **size, **shape}, p, more)
        if c.place.kind == "parameter":  # the equations are linear in each parameter
            own = c.place.name
            by_one = right_sides(m, {**TRUTH, own: TRUTH[own] + 1.0}, p, {})
            for name, before in base.items():
                change = added * (by_one[name] - before)
                assert after[name] - before == pytest.approx(change, abs=1e-9), (c.name, name)
            checked += 1
            continue
        through = {"CL": {"alpha'": -1.0, "az": -8.0}, "Cm": {"q'": 1.0}, "de": {"q'": TRUTH["Cmde"]}}
        gains = through.get(c.place.name, {c.place.name: 1.0})
        scale = float(np.abs(added).max())
        assert scale > 0, c.name
        for name, before in base.items():
            change = after[name] - before
            assert change == pytest.approx(gains.get(name, 0.0) * added, abs=1e-9 * max(scale, 1.0)), (c.name, name)
        checked += 1
    assert checked > 60


def test_lags_and_late_outputs_along_a_path_are_those_of_a_simulation(library: ph.results.Candidates) -> None:
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


@pytest.mark.parametrize(("what", "size"), [("backlash", 0.02), ("rate_limit", 0.06)])
def test_actuators_with_a_memory_act_as_they_are_defined(what: str, size: float) -> None:
    """Extended models, integrated, against what the definition makes of the command; and they are found again."""
    m, fine = pitch(), record()
    first = {"alpha": 0.04, "q": 0.0}
    u = fine.input("de")
    z = [u[0]]
    for now in u[1:]:
        if what == "backlash":
            z.append(min(max(z[-1], now - size), now + size))
        else:
            z.append(z[-1] + min(max(now - z[-1], -0.05 * size), 0.05 * size))
    known = ph.simulate(m, TRUTH, ph.Experiment(fine.t, {"de": np.array(z)}), initial=first).outputs
    random = np.random.default_rng(2)
    noisy = {n: y + SIGMA[n] * random.standard_normal(y.size) for n, y in known.items()}
    data = ph.Experiment(fine.t, {"de": u}, noisy)
    base = Refit((), ph.estimate(m, data))
    c = ph.candidates(m, points=base.linear.points)[f"de:{what}"]
    (name,) = c.shape_names
    error = ph.simulate(c.extended(m), {**TRUTH, name: size}, fine, initial=first).outputs["q"] - known["q"]
    effect = ph.simulate(m, TRUTH, fine, initial=first).outputs["q"] - known["q"]
    assert np.std(error) < 0.05 * np.std(effect)
    for start in (size, 1.5 * size):  # the grid of the scan is no wider
        found = refit(base.fit, [c], {name: start}, points=base.linear.points)
        assert found is not None
        assert found.fit.parameters[name].value == pytest.approx(size, rel=0.05)


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
        assert _core.lagged(t, u, tau) == pytest.approx(z, abs=1e-9)


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
    "alpha:clipped": {"limit_alpha": 0.05},
    "de:delay": {"tau_de": 0.09},
    "de:lag": {"lag_de": 0.18},
    "de:deadband": {"deadband_de": 0.02},
    "de:saturation": {"saturation_de": 0.06},
}


@pytest.mark.parametrize("name", EFFECTS)
def test_what_was_put_in_is_estimated(name: str, library: ph.results.Candidates) -> None:
    """From the base model's truth and, as a scan gives them, the nearest shape of the grid and rough coefficients."""
    c, true = library[name], EFFECTS[name]
    model, empty = c.extended(pitch()), record(3)
    r = ph.simulate(model, {**TRUTH, **true}, empty, initial={"alpha": 0.04, "q": 0.0})
    random = np.random.default_rng(7)
    z = {n: y + SIGMA[n] * random.standard_normal(empty.n) for n, y in r.outputs.items()}
    same_side = [s for s in c.shapes if all(s[n] * true[n] > 0 for n in s)]  # an upper limit is none from below
    nearest = min(same_side or c.shapes, key=lambda s: sum(abs(np.log(s[n] / true[n])) for n in s))
    rough = {n: 0.7 * true[n] for n in c.coefficients}
    fit = ph.estimate(c.extended(pitch(), {**rough, **nearest}), empty.with_outputs(z), start=TRUTH)
    assert fit.converged
    low_high = c.physical([along(pitch(), TRUTH, ph.simulate(pitch(), TRUTH, empty, initial={"alpha": 0.04, "q": 0}))])
    for parameter, value in true.items():
        e = fit.parameters[parameter]
        assert abs(e.value - value) < 4 * e.std_error, (e, value)
        assert e.std_error < 0.12 * abs(value), e
        low, high = low_high[parameter]
        assert low <= value <= high
    assert fit.parameters["Cma"].value == pytest.approx(TRUTH["Cma"], rel=0.1)


def test_friction_that_truly_jumps_is_estimated_by_the_rounded_form() -> None:
    """Within 2 %, although its signal-to-noise ratio would show a tenth of that."""
    m, t = oscillator(), 0.05 * np.arange(601)
    u = 1.5 * np.sin(0.9 * t) + np.sin(2.3 * t)
    empty, truth, first = ph.Experiment(t, {"u": u}), {"k": 2.0, "c": 0.15}, {"x": 0.5, "v": 0.0}
    path = along(m, truth, ph.simulate(m, truth, empty, initial=first))
    jump = ph.smooth_sign(ph.Expr.symbol("v"), 1e-4)
    sharp = ph.candidates(m, terms={"v':sharp": jump})["v':sharp"].extended(m)
    r = ph.simulate(sharp, {**truth, "v_dot_sharp": -0.2}, empty, initial=first)
    random = np.random.default_rng(2)
    data = empty.with_outputs({n: y + 0.01 * random.standard_normal(t.size) for n, y in r.outputs.items()})
    fit = ph.estimate(ph.candidates(m, points=[path])["v':sign(v)"].extended(m), data)
    assert fit.converged
    assert fit.parameters["v_dot_sign_v"].value == pytest.approx(-0.2, rel=0.02)
    assert fit.parameters["v_dot_sign_v"].std_error < 0.001


# ---------------------------------------------------------------- several at once


CHAIN = (
    "Cm:lag_alpha",
    "Cm:alpha*de",
    "de:deadband",
    "de:saturation",
    "de:lag",
    "de:delay",
    "az:q'",
    "az:lag",
    "az:delay",
)
CHAIN_VALUES = {
    **{"Cm_lag_alpha": -1.5, "tau_Cm_alpha": 0.5, "Cm_alpha_de": 3.0, "deadband_de": 0.01, "saturation_de": 0.05},
    **{"lag_de": 0.2, "tau_de": 0.15, "y_az_q_dot": 0.1, "lag_az": 0.3, "tau_az": 0.1},
}


def chained(library: ph.results.Candidates, m: ph.Model) -> ph.Model:
    for c in sorted((library[name] for name in CHAIN), key=lambda c: c.stage):
        m = c.extended(m)
    return m


def test_effects_compose_in_the_order_of_their_stages(library: ph.results.Candidates) -> None:
    """The input is late, lags, saturates, and has a dead-band, in that order; the lever arm sees the whole equation."""
    m, empty = chained(library, pitch()), record()
    m.check()
    assert m.delays.inputs == {"de_delayed": ("de", "tau_de")} and m.delays.outputs == {"az": "tau_az"}
    assert m.noise_model == pitch().noise_model
    first = {"alpha": 0.04, "q": 0.0, "alpha_lag": 0.04, "de_lag": float(empty.input("de")[0])}
    values = {**TRUTH, **CHAIN_VALUES}
    r = ph.simulate(m, values, empty, initial=first)
    t, centre = empty.t, library["de:lag"].scales.centre("de")  # type: ignore[attr-defined]
    acting = _core.lagged(t, np.interp(t - 0.15, t, empty.input("de")), 0.2)
    # What the delay bends lies at samples here (0.15 s are three intervals), so the lag is exact.
    assert r.states["de_lag"] == pytest.approx(acting, abs=1e-8)
    acting = np.clip(acting - centre, -0.05, 0.05)
    acting = centre + np.sign(acting) * np.maximum(np.abs(acting) - 0.01, 0.0)
    alpha, q, lag = (r.states[name] for name in ("alpha", "q", "alpha_lag"))
    Cm = TRUTH["Cm0"] + TRUTH["Cma"] * alpha + TRUTH["Cmq"] * q + TRUTH["Cmde"] * acting
    trim = library["Cm:alpha*de"].scales.centre("alpha")  # type: ignore[attr-defined]
    Cm += -1.5 * lag + 3.0 * (alpha - trim) * (acting - centre)
    smooth = np.gradient(q, t)[2:-2]
    assert Cm[2:-2] == pytest.approx(smooth, abs=0.05 * np.ptp(smooth))
    y = -8.0 * (TRUTH["CL0"] + TRUTH["CLa"] * alpha) + TRUTH["b_az"] + 0.1 * Cm
    z = _core.lagged(t, y, 0.3)
    assert r.states["az_sensor"] == pytest.approx(
        z + r.states["az_sensor"][0] * np.exp(-t / 0.3) - y[0] * np.exp(-t / 0.3), abs=0.01 * np.ptp(z)
    )
    assert r.outputs["az"][2:] == pytest.approx(r.states["az_sensor"][:-2], abs=1e-6)


def test_extensions_are_saved_and_printed_like_any_model(library: ph.results.Candidates, tmp_path: Path) -> None:
    m = chained(library, pitch())
    m.save(tmp_path / "model.json")
    again = ph.Model.load(tmp_path / "model.json")
    assert again.to_json() == m.to_json() and str(again) == str(m)
    assert "Cm_lag_alpha*alpha_lag" in str(m) and r"\dot{" in m.latex()
    for c in library:
        extended = c.extended(pitch())
        assert ph.Model.from_json(extended.to_json()).to_json() == extended.to_json(), c.name


def test_extending_leaves_the_model_as_it_was(library: ph.results.Candidates) -> None:
    m = pitch()
    before = m.to_json()
    for c in library:
        c.extended(m)
    assert m.to_json() == before


def test_two_effects_together_are_estimated(library: ph.results.Candidates) -> None:
    names, true = ("Cm:alpha^2", "de:delay"), {"Cm_alpha2": 9.0, "tau_de": 0.09}
    model = pitch()
    for name in names:
        model = library[name].extended(model)
    empty, random = record(5), np.random.default_rng(11)
    r = ph.simulate(model, {**TRUTH, **true}, empty, initial={"alpha": 0.04, "q": 0.0})
    z = {n: y + SIGMA[n] * random.standard_normal(empty.n) for n, y in r.outputs.items()}
    fit = ph.estimate(model, empty.with_outputs(z), start=TRUTH)
    assert fit.converged
    for parameter, value in true.items():
        e = fit.parameters[parameter]
        assert abs(e.value - value) < 4 * e.std_error and e.std_error < 0.1 * value


def test_the_library_of_an_extended_model_does_not_doubt_its_extensions(path: ph.results.Points) -> None:
    base = pitch()
    library = ph.candidates(base, points=[path])
    m = base
    for name in ("Cm:lag_alpha", "de:delay"):
        m = library[name].extended(m)
    again = ph.candidates(m, base=base)
    assert "Cm:de^2" in again and again["Cm:de^2"].variables == ("de_delayed",)  # type: ignore[attr-defined]
    assert again["de:deadband"].place == ph.results.Place("input", "de_delayed")
    assert "de:delay" not in again and not any("alpha_lag" in name for name in again.names)
    # One more of the same kind gets parameters of its own.
    assert again["Cm:lag_alpha"].coefficients == ("Cm_lag_alpha_2",)
    assert again["Cm:lag_alpha"].extended(m).state_names[-2:] == ("alpha_lag", "alpha_lag_2")
    for c in again:
        c.extended(m).check()
    # So has a sensor that is late already.
    late = library["az:delay"].extended(base)
    assert "az:delay" not in ph.candidates(late) and "az:lag" in ph.candidates(late)


# ---------------------------------------------------------------- terms of the user's own, and bad input


def test_terms_of_the_users_own() -> None:
    m = pitch()
    alpha, q, de, CL = (ph.Expr.symbol(name) for name in ("alpha", "q", "de", "CL"))
    own = {"Cm": [alpha * q**2, ph.sin(3 * alpha)], "q'": CL * q, "y:alpha": alpha**3, "Cm:gap effect": de * alpha**2}
    library = ph.candidates(m, terms=own, leave_out=[f for f in FAMILIES if f != "own"])
    assert library.names == ("Cm:alpha*q^2", "Cm:sin(3*alpha)", "q':CL*q", "alpha:alpha^3", "Cm:gap effect")
    extended = library["Cm:gap effect"].extended(m, {"Cm_gap_effect": 2.0})
    assert "Cm_gap_effect*de*alpha**2" in str(extended)
    # One that the library would make itself keeps the user's name.
    renamed = ph.candidates(m, terms={"Cm:hardening": 2 * (alpha - 0.1) ** 3}, trim={"alpha": 0.1})
    assert "Cm:hardening" in renamed and "Cm:alpha^3" not in renamed


BAD_TERMS = [
    ({"CM": "q"}, "'CM' names no quantity, state equation (with a prime) or output. Did you mean"),
    ({"Cm": "Cmq*q"}, "holds the parameter 'Cmq'"),
    ({"Cm": "beta*q"}, "holds the unknown 'beta'"),
    ({"Cm": "3*q"}, "the model has this already"),
    ({"Cm": "sign(q)"}, "use smooth_sign(x, width) in place of sign"),
    ({"Cm": "q*(alpha > 0.1)"}, "use smooth_step(x, width) in place of lt"),
    ({"Cm": "2.0"}, "is a number"),
    ({"Cm": ["q**2", "2*q**2 + q"]}, "Cm:2*q^2+q and Cm:q^2 are the same but for a factor and what the model has"),
    ({"Cm:both": ["q**2", "q**3"]}, "'Cm:both' names one term, but 2 are given"),
    ({"CL": "Cm*q"}, "holds 'Cm', which stands below CL in the model"),
]


@pytest.mark.parametrize("terms, message", BAD_TERMS, ids=lambda x: str(x)[:30])
def test_terms_that_cannot_be_are_refused(terms: dict[str, object], message: str) -> None:
    known = {name: ph.Expr.symbol(name) for name in ("alpha", "q", "beta", "Cmq", "Cm", "CL")} | {"sign": ph.sign}

    def read(text: object) -> object:
        return [read(t) for t in text] if isinstance(text, list) else eval(str(text), dict(known))

    with pytest.raises(ph.ModelError, match=re.escape(message)):
        ph.candidates(pitch(), terms={key: read(text) for key, text in terms.items()})


def test_wrong_options_and_wrong_extensions_are_refused(
    library: ph.results.Candidates, path: ph.results.Points
) -> None:
    m = pitch()
    with pytest.raises(ph.OptionError, match="there is no family 'cubes'. Did you mean 'cube'"):
        ph.candidates(m, leave_out=["cubes"])
    with pytest.raises(ph.OptionError, match="leave_out is several families"):
        ph.candidates(m, leave_out="cube")
    with pytest.raises(ph.OptionError, match="trim names 'alfa', no state or input. Did you mean 'alpha'"):
        ph.candidates(m, trim={"alfa": 0.1})
    with pytest.raises(ph.OptionError, match='equations is "own" or "all"'):
        ph.candidates(m, equations="both")  # type: ignore[arg-type]
    with pytest.raises(ph.ModelError, match="give a Model, not a str"):
        ph.candidates("pitch")  # type: ignore[arg-type]
    with pytest.raises(ph.DataError, match="there are no points"):
        ph.candidates(m, points=[])
    with pytest.raises(KeyError, match="there is no candidate 'Cm:alfa"):
        library["Cm:alfa*q"]
    with pytest.raises(
        KeyError, match="there is no candidate 'Cx:.*Effects that the parameters of the model can represent"
    ):
        library.without("Cx:*")
    with pytest.raises(KeyError, match="Disturbances, .* are no candidates: a diagnosis tries them by itself"):
        library.only("*:noise")
    with pytest.raises(ph.ModelError, match="'Cm:alpha\\*q' is given twice"):
        library + library.only("Cm:alpha*q")
    c = library["Cm:alpha*q"]
    with pytest.raises(ph.ModelError, match="start names 'Cm_alpha'"):
        c.extended(m, {"Cm_alpha": 1.0})
    with pytest.raises(ph.ModelError, match="'Cm_alpha_q' is in the model already"):
        c.extended(c.extended(m))
    with pytest.raises(ph.ModelError, match="the model has no quantity 'Cm'"):
        c.extended(oscillator())
    with pytest.raises(ph.ModelError, match="'de' is in no equation; extend inputs in order of stage"):
        library["de:deadband"].extended(library["de:delay"].extended(m))
    other = ph.candidates(oscillator())
    with pytest.raises(ph.DataError, match="the points have no"):
        other["v':x^3"].signals(path, {})


def test_a_damper_between_two_masses_may_be_asymmetric_and_rub() -> None:
    """Its relative velocity, a declared quantity, had squares and cubes, but neither |vd| nor sign(vd)."""
    m = ph.Model("quarter car")
    (road,) = m.inputs(road="m")
    zs, zu, vs, vu = m.states(zs="m", zu="m", vs="m/s", vu="m/s")
    k, c, kt = m.parameters(k=100.0, c=8.0, kt=900.0)
    (vd,) = m.quantities(vd=vu - vs)
    (force,) = m.quantities(Fd=c * vd + k * (zu - zs))
    m.dynamics(zs=vs, zu=vu, vs=force, vu=kt * (road - zu) - 6.0 * force)
    m.outputs(zs=zs, zu=zu)
    assert {"Fd:|vd|", "Fd:sign(vd)", "Fd:vd^2"} <= {c.name for c in ph.candidates(m)}
