"""The generator of cases that hide an effect does what it says, by its own numbers and by those of phugoid."""

from __future__ import annotations

import functools

import hidden
import numpy as np
import pytest
from hidden import SYSTEMS, Case
from hidden.colour import Colour
from hidden.effect import Part
from hidden.flow import Flow

import phugoid as ph
from phugoid import maximum, minimum, sin, tanh
from phugoid.results import Record

each_system = pytest.mark.parametrize("system", list(SYSTEMS))

CASES = [
    ("hfb320", "Cm:alpha^2", "medium", "white"),
    ("duffing", "f:x^3", "strong", "coloured"),
    ("servo", "torque:sign(rate)", "weak", "white"),
    ("uav", "alpha:scale", "weak", "coloured"),
]


@functools.cache
def case(system: str, effect: str, strength: str, noise: str) -> Case:
    return hidden.make(system, effect, strength, noise, seed=5, validation=False)


@functools.cache
def empty(system: str) -> Case:
    return hidden.nothing(system, "white", seed=11)


def known_noise(c: Case) -> ph.Gaussian:
    return ph.Gaussian(dict(SYSTEMS[c.system].sigma))


def test_a_seed_makes_the_same_case_again_and_another_one_does_not() -> None:
    one, same, other = (hidden.draw(seed, systems=["servo"], strengths=["weak"]) for seed in (3, 3, 4))
    assert one.truth == same.truth and one.coefficients == same.coefficients and one.shapes == same.shapes
    for name, y in one.data.outputs.items():
        assert np.array_equal(y, same.data.outputs[name])
        assert not np.array_equal(y, other.data.outputs[name])


def test_the_call_that_a_case_names_makes_it() -> None:
    one = hidden.draw(6, systems=["servo"], strengths=["weak"], doubles=1.0)
    again = eval(one.again(), {"make": hidden.make, "nothing": hidden.nothing})
    assert len(one.truth) == 2
    assert again.coefficients == one.coefficients
    assert np.array_equal(again.data.outputs["angle"], one.data.outputs["angle"])


@pytest.mark.parametrize("which", CASES, ids=lambda w: w[1])
def test_strength_is_what_an_estimation_leaves(which: tuple[str, str, str, str]) -> None:
    """The base model fitted by phugoid to the data without noise leaves a residual of that size.

    White noise: the fit is in the true metric. Coloured: it is not, so that its residual is an upper bound, and the
    parameters are taken to the true optimum from there by a second, independent way: scipy's least squares.
    """
    c = case(*which)
    fit = ph.estimate(c.model, c.data.with_outputs(c.clean), noise=known_noise(c))
    assert fit.converged
    if c.noise == "white":
        left = sum(float(np.sum((r / SYSTEMS[c.system].sigma[n]) ** 2)) for n, r in fit.residuals.items())
    else:
        left = whitened_optimum(c, fit)
    assert left == pytest.approx(hidden.STRENGTHS[which[2]], rel=0.1)


def whitened_optimum(c: Case, fit: ph.Fit) -> float:
    """Least of the whitened sum of squares over parameters and initial states."""
    from scipy.optimize import least_squares

    s = SYSTEMS[c.system]
    clean = c.baseline.whitened({n: y[:, None] for n, y in c.clean.items()})[:, 0]
    true = np.array([*(c.parameters[n] for n in s.parameters), *c.baseline.x0])
    found = [*(fit.parameters[n].value for n in s.parameters), *(x.value for x in fit.initial_states["data"].values())]

    def left(z: np.ndarray) -> np.ndarray:
        return clean - c.baseline.whitened(c.baseline.moved((z * c.baseline.h)[:, None]))[:, 0]

    start = (np.array(found) - true) / c.baseline.h

    # Three-point differences in all directions at once: lanes.
    def jacobian(z: np.ndarray) -> np.ndarray:
        steps = np.eye(z.size) * 0.5
        lanes = (z[:, None] + np.concatenate([steps, -steps], axis=1)) * c.baseline.h[:, None]
        y = c.baseline.whitened(c.baseline.moved(lanes))
        return -(y[:, : z.size] - y[:, z.size :])

    return 2 * float(least_squares(left, start, jac=jacobian, x_scale="jac").cost)


@each_system
def test_where_nothing_is_hidden_the_base_model_fits_to_the_noise(system: str) -> None:
    c = empty(system)
    for data in (c.data, c.validation):
        assert data is not None
        fit = ph.estimate(c.model, data, noise=known_noise(c))
        assert fit.converged and not fit.warnings
        squares = sum(float(np.sum((r / SYSTEMS[system].sigma[n]) ** 2)) for n, r in fit.residuals.items())
        freedom = data.n * len(fit.residuals) - len(fit.parameters) - len(fit.states)
        assert abs(squares / freedom - 1) < 4 * np.sqrt(2 / freedom)
        # The true parameters are found: the two records are of one vehicle.
        off = [(e.value - c.parameters[n]) / e.std_error for n, e in fit.parameters.items() if n in c.parameters]
        assert np.max(np.abs(off)) < 4


@each_system
def test_the_second_manoeuvre_is_another(system: str) -> None:
    c = empty(system)
    assert c.validation is not None
    for name in c.data.inputs:
        a, b = c.data.inputs[name], c.validation.inputs[name]
        assert np.ptp(a) == 0.0 or np.ptp(b) == 0.0 or abs(np.corrcoef(a, b)[0, 1]) < 0.8


@pytest.mark.parametrize("seed", range(4))
def test_noise_has_its_autocorrelation_and_unit_variance(seed: int) -> None:
    colour = Colour.draw(np.random.default_rng(seed))
    assert 0.5 <= colour.lag_one <= 0.97
    rho = colour.autocorrelation(1500)
    factor, rng = colour.factor(1500), np.random.default_rng(seed + 100)
    y = factor @ rng.standard_normal((1500, 60))
    measured = [np.mean(y[k:] * y[: 1500 - k]) for k in range(4)]
    # Standard error of a mean of squares of n correlated samples: sqrt(2 sum rho² / n) at most.
    error = np.sqrt(2 * (1 + 2 * np.sum(rho[1:] ** 2)) / y.size)
    assert np.abs(measured - rho[:4]).max() < 4 * error
    assert np.allclose(colour.whiten(y).std(), 1, atol=4 / np.sqrt(2 * y.size))


def test_coloured_noise_of_a_case_is_white_when_whitened() -> None:
    c = hidden.nothing("hfb320", "coloured", seed=8, validation=False)
    for name, y in c.data.outputs.items():
        noise = (y - c.clean[name]) / SYSTEMS["hfb320"].sigma[name]
        white = c.colours[name].whiten(noise[:, None])[:, 0]
        assert abs(white @ white / white.size - 1) < 4 * np.sqrt(2 / white.size)
        assert abs(white[1:] @ white[:-1] / (white @ white)) < 4 / np.sqrt(white.size)
        assert noise[1:] @ noise[:-1] / (noise @ noise) > 0.3


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(KeyError, match="servo has no effect 'f:x"):
        hidden.make("servo", "f:x^3", "weak", "white", 0)
    with pytest.raises(hidden.Unreachable, match="torque:periodic does not reach 1000000000000"):
        hidden.make("servo", "torque:periodic", 1e12, "white", 0)


# The same effects in phugoid's own models, by hand: what scipy integrates must be what phugoid does.


def with_part(system: str, effect: str) -> tuple[Case, Part, dict[str, np.ndarray]]:
    """A case, an effect of middling size, and what scipy makes of both."""
    c, e = empty(system), SYSTEMS[system].effect(effect)
    sign, shape = e.draw(np.random.default_rng(1))
    part = Part(e, sign * float(np.sqrt(e.span[0] * e.span[1])), shape)
    return c, part, Flow(SYSTEMS[system], c.baseline.vehicle, c.data.inputs, [part]).truth(list(c.baseline.x0))


def by_hand(c: Case, part: Part) -> Record:
    """The same, simulated by phugoid."""
    s, m, name = SYSTEMS[c.system], ph.Model(c.system), part.effect.name
    size, trim = part.coefficient, c.baseline.vehicle.states | c.baseline.vehicle.inputs
    x, u = m.states(**s.states), list(m.inputs(**s.inputs))
    p = dict(zip(s.parameters, m.parameters(" ".join(s.parameters)), strict=True))
    by = dict(zip([*s.states, *s.inputs], [*x, *u], strict=True))
    extra, slope = {}, {}
    if name == "dr:delay":
        u[1] = m.delay(u[1], *m.parameters("tau"))
    elif name == "u:deadband":
        u[0] = maximum(u[0] - size, 0.0) + minimum(u[0] + size, 0.0)
    elif name == "de:lag":
        (z,) = m.states(z="rad")
        slope, extra, u[0] = {"z": (u[0] - z) / size}, {"z": c.data.inputs["de"][0]}, z
    q = s.quantities(x, u, p)
    if name == "Cm:alpha*q":
        q["Cm"] = q["Cm"] + size * (by["alpha"] - trim["alpha"]) * by["q"]
    elif name == "torque:sign(rate)":
        q["torque"] = q["torque"] + size * tanh(by["rate"] / s.steep["rate"])
    elif name == "CY:lag_beta":
        (z,) = m.states(z="rad")
        slope, extra = {"z": (by["beta"] - z) / part.shape["tau"]}, {"z": c.baseline.x0[0]}
        q["CY"] = q["CY"] + size * z
    elif name == "f:periodic":
        wave = 2 * np.pi * part.shape["frequency"] * m.time + part.shape["phase"]
        q["f"] = q["f"] + size * sin(wave)
    if q:
        q = dict(zip(q, m.quantities(**q), strict=True))
    f = dict(zip(s.states, s.dynamics(x, u, q, p), strict=True))
    if name == "q':w^2":
        f["q"] = f["q"] + size * by["w"] ** 2
    m.dynamics(**f, **slope)
    y = s.measured(x, u, q, p)
    if name == "ay:p^2":
        y["ay"] = y["ay"] + size * by["p"] ** 2
    elif name == "theta:drift":
        y["theta"] = y["theta"] + size * m.time
    m.outputs(**y)
    if name == "alpha:delay":
        (tau,) = m.parameters("tau")
        m.sensor_delay(alpha=tau)
    values = c.parameters | ({"tau": size} if "tau" in m.parameter_names else {})
    return ph.simulate(m, values, c.data, initial=dict(zip(s.states, c.baseline.x0, strict=True)) | extra)


@pytest.mark.parametrize(
    ("system", "effect"),
    [
        ("hfb320", "Cm:alpha*q"),
        ("hfb320", "de:lag"),
        ("hfb320", "alpha:delay"),
        ("duffing", "u:deadband"),
        ("duffing", "f:periodic"),
        ("servo", "torque:sign(rate)"),
        ("lateral", "CY:lag_beta"),
        ("lateral", "dr:delay"),
        ("lateral", "ay:p^2"),
        ("uav", "q':w^2"),
        ("uav", "theta:drift"),
    ],
)
def test_truth_is_what_phugoid_simulates(system: str, effect: str) -> None:
    c, part, truth = with_part(system, effect)
    record, sigma = by_hand(c, part), SYSTEMS[system].sigma
    for name, y in truth.items():
        error = np.abs(record.outputs[name] - y) / sigma[name]
        late = np.isnan(error)  # a sensor that is late has nothing before the record
        assert late.sum() <= (c.data.t < part.coefficient).sum() * (effect == f"{name}:delay")
        assert np.max(error[~late]) < 0.02, name
    assert max(np.max(np.abs(c.clean[n] - y)) / sigma[n] for n, y in truth.items()) > 0.2


@pytest.mark.parametrize(
    ("system", "effect"),
    [
        ("hfb320", "Cm:alpha^2"),
        ("hfb320", "de:lag"),
        ("duffing", "u:saturation"),
        ("duffing", "x:scale"),
        ("servo", "volts:deadband"),
        ("servo", "angle:delay"),
        ("lateral", "Cn:lag_beta"),
        ("uav", "q':periodic"),
    ],
)
def test_lanes_agree_with_scipy(system: str, effect: str) -> None:
    """What strengths are computed by."""
    c, part, exact = with_part(system, effect)
    s, several = SYSTEMS[system], Part(part.effect, part.coefficient * np.array([0.5, 1.0]), part.shape)
    lanes = Flow(s, c.baseline.vehicle, c.data.inputs, [several]).lanes(c.baseline.x0, 2)
    for name, y in exact.items():
        moved = np.abs(y - c.clean[name]).max()
        assert np.abs(lanes[name][:, 1] - y).max() < 0.02 * moved + 0.05 * s.sigma[name], name
