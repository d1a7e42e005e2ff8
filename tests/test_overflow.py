"""Two tanks, one above the other: what the upper one does not hold flows over, a part of it into the lower one."""

from __future__ import annotations

import numpy as np
import pytest

import phugoid as ph

_STEP, _SAMPLES, _INNER, _LEVEL, _NOISE = 4.0, 500, 40, 9.0, 0.03
_OUT, _BETWEEN, _IN = 0.055, 0.05, 0.055


def _model() -> ph.Model:
    """Return two tanks, with flows in the equations of the levels."""
    m = ph.Model("tanks")
    upper, lower = m.states("upper lower")
    (u,) = m.inputs("u")
    between, out, inlet = m.parameters(
        **{name: ph.Parameter(0.04, bounds=(0.005, 0.5)) for name in ("between", "out", "inlet")}
    )
    m.dynamics(upper=inlet * u - between * ph.sqrt(upper), lower=between * ph.sqrt(upper) - out * ph.sqrt(lower))
    m.outputs(y=lower, z=upper)
    return m


def _record(seed: int, part: float) -> ph.Experiment:
    """Return a record in which the upper tank flows over; a part of that reaches the lower one."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(1.2, 3.9, _SAMPLES // 25), 25)
    upper, lower, h = 6.0, 5.0, _STEP / _INNER
    levels = np.zeros((_SAMPLES, 2))
    for k in range(_SAMPLES):
        levels[k] = lower, upper
        for _ in range(_INNER):
            flow = _BETWEEN * np.sqrt(max(upper, 0.0))
            rate = _IN * u[k] - flow
            over = rate if upper >= _LEVEL and rate > 0.0 else 0.0
            upper += h * (rate - over)
            lower += h * (flow - _OUT * np.sqrt(max(lower, 0.0)) + part * over)
    y, z = (levels + _NOISE * rng.standard_normal(levels.shape)).T
    return ph.Experiment(np.arange(_SAMPLES) * _STEP, {"u": u}, {"y": y, "z": z}, interpolation="hold")


@pytest.mark.parametrize("part", [0.6, 0.0])
def test_an_overflow_is_named_with_where_it_goes(part: float) -> None:
    fit = ph.estimate(_model(), _record(1, part))
    found = ph.diagnose(fit, validation=_record(2, part)).findings
    named = [f for f in found if f.status == "named"]
    assert [f.cause for f in named] == ["upper:overflow_lower" if part else "upper:limit"]
    assert named[0].explained > 0.9
    if part:
        assert abs(named[0].parameters["part_of_upper_to_lower"][0] - part) < 0.05


def test_a_store_is_full_in_a_model_of_declared_flows_in_the_unit_of_its_level() -> None:
    m = ph.Model("tanks")
    upper, lower = m.states(upper="m", lower="m")
    (u,) = m.inputs("u")
    between, out, inlet = m.parameters(
        **{name: ph.Parameter(0.04, bounds=(0.005, 0.5)) for name in ("between", "out", "inlet")}
    )
    first, second = m.quantities(first=between * ph.sqrt(upper), second=out * ph.sqrt(lower))
    m.dynamics(upper=inlet * u - first, lower=first - second)
    m.outputs(upper=(100.0 * upper, "cm"), lower=(100.0 * lower, "cm"))
    assert (m.units["upper"], m.variable_units["upper"]) == ("cm", "m")

    def record(seed: int) -> ph.Experiment:
        e = _record(seed, 0.0)
        levels = {"upper": 100.0 * e.outputs["z"], "lower": 100.0 * e.outputs["y"]}
        return ph.Experiment(e.t, e.inputs, levels, interpolation="hold")

    (named,) = (f for f in ph.diagnose(ph.estimate(m, record(1)), validation=record(2)).findings if f.status == "named")
    assert "upper:limit" in {named.cause, *named.aliases}
    level = next(iter(named.parameters))
    assert named.parameters[level][0] == pytest.approx(_LEVEL, rel=0.02)
    assert named.units[level] == "m"


def test_a_limit_of_a_state_that_nothing_measures_may_be_far_from_where_the_model_has_it() -> None:
    m = ph.Model("tanks")
    upper, lower = m.states("upper lower")
    (u,) = m.inputs("u")
    (k,) = m.parameters("k")
    m.dynamics(upper=u - k * upper, lower=k * (upper - lower))
    m.outputs(level=2.0 * lower)
    bounds = {}
    for name in ("upper", "lower"):
        limited = ph.candidates(m)[f"{name}:limit"].extended(m)
        bounds[name] = limited.declared_parameters[f"limit_of_{name}"].bounds
    # Without a record a state is taken to be within 0.5 of zero.
    assert bounds["lower"] == pytest.approx((-0.7, 0.7)) and bounds["upper"][1] > 5.0
