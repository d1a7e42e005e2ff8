"""A lightly damped oscillator: what rings at its mode is not sensor noise, and no proof of anything either."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.signal import lfilter

import phugoid as ph
from phugoid.discrepancy.search.refit import Refit
from phugoid.discrepancy.search.refit_cache import RefitCache
from phugoid.discrepancy.search.ringing import light_modes, ringing_of
from phugoid.residual_noise.whitening import Whitening
from phugoid.sensitivities.linearised import Linearised

STEP, N = 0.05, 1200
RATE, DAMPING = 2 * np.pi, 0.005  # 1 Hz
TRUE = {"k": RATE**2, "c": 2 * DAMPING * RATE, "b": 1.0}
LEVEL = 0.02  # of the sensors' noise, in parts of the response


@cache
def oscillator() -> ph.Model:
    m = ph.Model("light oscillator")
    x, v = m.states(x="m", v="m/s")
    (u,) = m.inputs(u="N")
    k, c, b = m.parameters(**TRUE)
    (f,) = m.quantities(f=b * u - k * x - c * v)
    m.dynamics(x=v, v=f)
    m.outputs(x=x, a=f)
    return m


def flown(name: str, cubic: float, noise: str, random: np.random.Generator) -> ph.Experiment:
    """A multisine from 0.4 to 2 Hz; ``cubic`` is the part of the stiffness that a term in x^3 has at twice the RMS.

    ``noise`` is that of the sensors, "white" or "drifting" (first order, 0.9 from sample to sample); or "shaken": a
    force without memory shakes the mass too, so that it rings by a tenth of its response.
    """
    t, parts = STEP * np.arange(N), 6
    lines = np.arange(int(0.4 * N * STEP), int(2.0 * N * STEP) + 1) / (N * STEP)
    u = np.sin(2 * np.pi * lines[:, None] * t + random.uniform(0, 2 * np.pi, (lines.size, 1))).sum(axis=0)
    u /= u.std()
    size = 0.2  # m, of the response, nearly
    force = cubic * RATE**2 / (4 * size**2)
    shake = 0.1 * size * np.sqrt(4 * DAMPING * RATE**3) if noise == "shaken" else 0.0
    h = STEP / parts
    fine = np.interp(h * np.arange((N - 1) * 2 * parts + 1) / 2, t, u)
    gusts = shake * np.sqrt(h) * random.standard_normal((N - 1) * parts)

    def slope(x: float, v: float, now: float) -> tuple[float, float]:
        return v, now - RATE**2 * x - 2 * DAMPING * RATE * v - force * x**3

    state, path = (0.0, 0.0), [(0.0, u[0])]
    for i in range((N - 1) * parts):
        x, v = state
        u0, u1, u2 = fine[2 * i : 2 * i + 3]
        k1 = slope(x, v, u0)
        k2 = slope(x + h / 2 * k1[0], v + h / 2 * k1[1], u1)
        k3 = slope(x + h / 2 * k2[0], v + h / 2 * k2[1], u1)
        k4 = slope(x + h * k3[0], v + h * k3[1], u2)
        dx, dv = (h / 6 * (a + 2 * b + 2 * c + d) for a, b, c, d in zip(k1, k2, k3, k4, strict=True))
        state = x + dx, v + dv + gusts[i]
        if (i + 1) % parts == 0:
            path.append((state[0], slope(*state, u[(i + 1) // parts])[1]))
    x, a = np.array(path).T
    e = random.standard_normal((2, N + 200))
    if noise == "drifting":
        e = lfilter([np.sqrt(1 - 0.9**2)], [1.0, -0.9], e, axis=1)
    e = LEVEL * size * e[:, 200:]
    return ph.Experiment(t, {"u": u}, {"x": x + e[0], "a": a + RATE**2 * e[1]}, name)


def diagnosed(cubic: float, noise: str, seed: int) -> ph.results.Diagnosis:
    random = np.random.default_rng(seed)
    run, other = (flown(name, cubic, noise, random) for name in ("run", "other"))
    return ph.diagnose(ph.estimate(oscillator(), run), validation=other)


# ---------------------------------------------------------------- what is found


@pytest.mark.parametrize("noise", ["white", "drifting"])
@pytest.mark.parametrize("cubic", [0.01, -0.01, 0.002])
def test_hardening_and_softening_are_named(cubic: float, noise: str) -> None:
    """Though the noise of the base model has learned to ring."""
    d = diagnosed(cubic, noise, 0)
    (f,) = d.findings
    assert f.status == "named" and f.cause in ("f:x^3", "f:x|x|") and "f:x^3" in (f.cause, *f.aliases)
    assert np.sign(f.coefficient) == -np.sign(cubic)


@pytest.mark.parametrize("noise", ["white", "drifting"])
@pytest.mark.parametrize("seed", [0, 1])
def test_sensor_noise_is_nothing(noise: str, seed: int) -> None:
    assert not diagnosed(0.0, noise, seed).found


@pytest.mark.parametrize("seed", range(6))
def test_no_term_is_named_where_the_mass_is_shaken(seed: int) -> None:
    """A mode that is shaken looks like a tone for as long as it remembers, and that is half of the record here."""
    d = diagnosed(0.0, "shaken", seed)
    assert RefitCache(Refit((), d.fit), ()).ringing(Refit((), d.fit)) is not None
    # At a mode, noise that moves x and noise that moves v are much alike.
    told = {f.cause for f in d.findings if f.status != "unexplained"}
    assert told <= {"v':noise", "x':noise"}, d


# ---------------------------------------------------------------- modes and noise


@cache
def linear() -> Linearised:
    run = flown("run", 0.0, "white", np.random.default_rng(0))
    return Linearised(ph.estimate(oscillator(), run))


def rings(poles: list[complex]) -> tuple[float, ...]:
    """Frequencies at which noise with such poles (1/s) is found to ring at the modes of the oscillator."""
    roots = np.exp(np.array([*poles, *np.conj(poles)]) * STEP)
    random = np.random.default_rng(1)
    e = random.standard_normal((2, N + 2000))
    r = lfilter([1.0], np.real(np.poly(roots)), e, axis=1)[:, 2000:].ravel()
    filter = Whitening.of(r, linear().structure)
    found = ringing_of(filter, r, linear(), light_modes(linear().fit))
    if found is None:
        return ()
    white = found.filter(r)
    assert np.mean(white[:N] ** 2) == pytest.approx(1.0, rel=1e-6)  # as large as the residuals are
    # Their peak at the mode stays in them: the filter takes it for no noise.
    power = np.abs(np.fft.rfft(white[:N])) ** 2
    assert abs(np.argmax(power) / (N * STEP) - 1.0) < 0.05 and power.max() > 20 * np.median(power)
    return found.frequencies


def test_light_modes_are_those_of_little_damping() -> None:
    (mode,) = light_modes(linear().fit)
    assert mode.imag == pytest.approx(RATE, rel=0.01) and -mode.real == pytest.approx(DAMPING * RATE, rel=0.3)
    m = oscillator()
    damped = ph.estimate(m, flown("run", 0.0, "white", np.random.default_rng(0)), start={"c": 2.0}, solver=FEW)
    assert light_modes(damped).size == 0


FEW = ph.Newton(max_iterations=0, regression=False)


def test_noise_rings_where_its_poles_are_light_and_near_a_mode() -> None:
    assert rings([-0.05 + 6.3j]) == pytest.approx((1.0,), rel=0.01)
    assert rings([-0.05 + 12.6j]) == ()  # a tone elsewhere
    assert rings([-3.0 + 6.3j]) == ()  # a broad peak
    assert rings([-2.0 + 0j]) == ()  # a drift
