"""Channels that were recorded with another clock than the rest: what a diagnosis names."""

from __future__ import annotations

import numpy as np
import pytest
from rigs import integrated, named

import phugoid as ph

_Array = np.ndarray


def _doublets(rng: np.random.Generator, t: _Array, size: float) -> _Array:
    """Return steps (N,) of random size and length, as an operator makes them, joined in half a second."""
    at = np.cumsum(rng.uniform(0.8, 3.0, 60))
    levels = size * rng.uniform(-1.0, 1.0, at.size)
    return np.interp(t, np.sort(np.concatenate([at, at + 0.5])), np.concatenate([[0.0], np.repeat(levels, 2)[:-1]]))


def _record(
    seed: int, name: str, rate: float, late: float = 0.0, drift: float = 0.0, of: tuple[str, ...] = ("d", "T")
) -> ph.Experiment:
    """A boat of which rudder and thrust, or other channels, were recorded by another computer than the rest."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 50.0, 0.05)
    u = {"d": _doublets(rng, t, 0.3), "T": _doublets(rng, t, 1.0)}

    def f(x: _Array, u: _Array) -> _Array:
        v, r = x
        return np.array([-0.6 * v + 0.8 * u[1], -1.4 * r + (1.0 - drift * u[2]) * 2.0 * u[0] + 0.1 * v * r])

    fine = np.arange(0.0, 49.96, 0.005) + 0.0025  # in the middle of short steps, in which inputs are held
    u_of = np.stack([np.interp(fine, t, u["d"]), np.interp(fine, t, u["T"]), fine], axis=1)
    x = integrated(f, np.zeros(2), fine, u_of, finer=1)[::10]
    happened = {**u, "v": x[:, 0], "r": x[:, 1]}
    recorded = {n: np.interp((t - late) / (1.0 + rate), t, y) if n in of else y for n, y in happened.items()}
    outputs = {n: recorded.pop(n) + sigma * rng.standard_normal(t.size) for n, sigma in {"v": 0.01, "r": 0.005}.items()}
    return ph.Experiment(t, recorded, outputs, name=name)


def _boat() -> ph.Model:
    m = ph.Model("boat")
    v, r = m.states(v="m/s", r="rad/s")
    d, thrust = m.inputs(d="rad", T="N")
    a, b, c, e, k = m.parameters(a=0.5, b=1.0, c=1.0, e=1.0, k=0.0)
    m.dynamics(v=-a * v + b * thrust, r=-c * r + e * d + k * v * r)
    m.outputs(v=v, r=r)
    return m


@pytest.mark.parametrize(("of", "cause"), [(("d", "T"), "inputs:clock"), (("d",), "d:clock")])
def test_a_clock_that_runs_at_another_rate_is_named(of: tuple[str, ...], cause: str) -> None:
    fit = ph.estimate(_boat(), _record(1, "a", 0.006, of=of))
    diagnosis = ph.diagnose(fit, validation=_record(2, "b", 0.006, of=of))
    (found,) = named(diagnosis)
    assert found.cause == cause
    assert found.coefficient == pytest.approx(0.006, abs=4.0 * found.std_error)
    assert found.std_error < 3e-4
    assert found.explained > 0.95
    assert "another clock" in found.explanation
    extended = diagnosis.extend().fit
    assert extended.parameters["e"].value == pytest.approx(2.0, rel=0.02)
    assert ph.improve(fit, validation=_record(2, "b", 0.006, of=of)).added == (cause,)


def test_an_output_that_was_recorded_late_is_not_distinguished_from_an_early_input() -> None:
    fit = ph.estimate(_boat(), _record(1, "a", 0.006, of=("r",)))
    (found,) = named(ph.diagnose(fit, validation=_record(2, "b", 0.006, of=("r",))))
    assert "r:clock" in {found.cause, *found.aliases}
    assert abs(found.coefficient) == pytest.approx(0.006, abs=4.0 * found.std_error)


def test_the_clock_of_an_output_without_data_held_out() -> None:
    """By the other clock the output lacks samples at the end, which the model as it was is not asked for either."""
    fit = ph.estimate(_boat(), _record(1, "a", 0.006, late=0.4, of=("r",)))
    (found,) = named(ph.diagnose(fit))
    assert "r:clock" in {found.cause, *found.aliases}
    assert found.explained > 0.9


def test_the_clock_of_one_output_among_others_is_named() -> None:
    """The acceleration tells that the input is in time, and the position is not."""

    def record(seed: int, name: str) -> ph.Experiment:
        rng = np.random.default_rng(seed)
        t = np.arange(0.0, 50.0, 0.05)
        u = _doublets(rng, t, 1.0)
        fine = np.arange(0.0, 49.96, 0.005) + 0.0025

        def f(x: _Array, u: _Array) -> _Array:
            return np.array([x[1], -4.0 * x[0] - 0.8 * x[1] + 1.5 * u[0]])

        x = integrated(f, np.zeros(2), fine, np.interp(fine, t, u)[:, None], finer=1)[::10]
        late = np.interp((t - 0.1) / 1.006, t, x[:, 0])
        force = -4.0 * x[:, 0] - 0.8 * x[:, 1] + 1.5 * u
        outputs = {"x": late, "v": x[:, 1], "a": force}
        noisy = {
            n: y + s * rng.standard_normal(t.size) for (n, y), s in zip(outputs.items(), (0.01, 0.03, 0.1), strict=True)
        }
        return ph.Experiment(t, {"u": u}, noisy, name=name)

    m = ph.Model("oscillator")
    x, v = m.states(x="m", v="m/s")
    (u,) = m.inputs(u="N")
    k, d, b = m.parameters(k=1.0, d=1.0, b=1.0)
    m.dynamics(x=v, v=-k * x - d * v + b * u)
    m.outputs(x=x, v=v, a=-k * x - d * v + b * u)
    diagnosis = ph.diagnose(ph.estimate(m, record(1, "a")), validation=record(2, "b"))
    (found,) = named(diagnosis)
    assert (found.cause, found.aliases) == ("x:clock", ())
    assert found.coefficient == pytest.approx(0.006, abs=4.0 * found.std_error)
    assert found.explained > 0.95
    assert "x was recorded with another clock than the other channels" in found.explanation


@pytest.mark.parametrize("kind", [{"rate": 0.0, "late": 0.3}, {"rate": 0.0, "drift": 0.012}])
def test_a_constant_delay_and_an_effectiveness_that_falls_are_no_clock(kind: dict[str, float]) -> None:
    fit = ph.estimate(_boat(), _record(1, "a", of=("d",), **kind))
    diagnosis = ph.diagnose(fit, validation=_record(2, "b", of=("d",), **kind))
    assert not [f.cause for f in diagnosis.findings if f.cause.endswith(":clock")]
    assert named(diagnosis)
