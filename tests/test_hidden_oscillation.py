"""A section on springs in a stream, whose wake oscillates by itself: that is no random disturbance, as gusts are."""

from __future__ import annotations

import numpy as np
import pytest

import phugoid as ph
from phugoid.discrepancy.search.disturbance import components_of, histories_at
from phugoid.discrepancy.search.randomness import in_a_tenth
from phugoid.discrepancy.search.refit import Refit
from phugoid.discrepancy.search.remainder import RemainderSettings
from phugoid.estimation import estimate
from phugoid.sensitivities import Place

_STEP, _SAMPLES, _INNER = 0.05, 800, 20
_STIFFNESS, _DAMPING, _GAIN = 9.0, 0.5, 4.0


def _model() -> ph.Model:
    m = ph.Model("section on springs")
    y, v = m.states(y="m", v="m/s")
    (u,) = m.inputs(u="N")
    stiffness, damping, gain = m.parameters(stiffness=7.0, damping=0.3, gain=3.0)
    m.dynamics(y=v, v=gain * u - stiffness * y - damping * v)
    m.outputs(y_m=(y, "m"), v_m=(v, "m/s"))
    return m


def _record(seed: int, acts: str) -> ph.Experiment:
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1.0, 1.0, _SAMPLES // 20), 20)
    y, v, wake, rate, gust = 0.0, 0.0, 0.3, 0.0, 0.0
    shown, h = np.empty((_SAMPLES, 2)), _STEP / _INNER
    for k in range(_SAMPLES):
        shown[k] = y, v
        for _ in range(_INNER):
            rate += h * (1.2 * (1.0 - 0.25 * wake**2) * rate - 30.0 * wake + 3.0 * v)
            wake += h * rate
            gust += h * (-gust / 0.3) + 1.2 * np.sqrt(h) * rng.standard_normal()
            force = _GAIN * u[k] + (0.45 * wake if acts == "wake" else 1.5 * gust)
            v += h * (force - _STIFFNESS * y - _DAMPING * v)
            y += h * v
    y_m, v_m = (shown + [0.003, 0.01] * rng.standard_normal(shown.shape)).T
    return ph.Experiment(_STEP * np.arange(_SAMPLES), {"u": u}, {"y_m": y_m, "v_m": v_m}, interpolation="hold")


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_components_of_gusts_are_standard_normal_and_those_of_an_oscillation_are_few(seed: int) -> None:
    parts = {}
    for acts in ("gusts", "wake"):
        at = Refit((), estimate(_model(), _record(seed, acts)))
        components = components_of(at.linear, histories_at(at, Place("equation", "v"))[0])
        assert components.size > 100
        assert np.std(components) == pytest.approx(1.0, abs=0.1)
        parts[acts] = in_a_tenth(components)
    assert parts["gusts"] < RemainderSettings().components - 0.1  # of normal values 0.44
    assert parts["wake"] > RemainderSettings().components + 0.3


@pytest.mark.parametrize("acts", ["gusts", "wake"])
def test_an_oscillation_that_no_candidate_describes_is_no_random_disturbance(acts: str) -> None:
    fit = ph.estimate(_model(), _record(2, acts))
    found = ph.diagnose(fit, validation=_record(12, acts)).findings
    assert [f.cause for f in found if f.status == "named"] == (["v':noise"] if acts == "gusts" else [])
