"""Random disturbances by the filter-error method: gusts that are not white, and where they act."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import short_period
from hidden.situation import situation
from short_period import T

import phugoid as ph
from phugoid.discrepancy.search.disturbance import histories_at
from phugoid.discrepancy.search.process_noise import filtered, filtered_elsewhere, through_shaping_filter
from phugoid.discrepancy.search.randomness import goes_with_motion, parts_predicted, products_of_motion
from phugoid.discrepancy.search.refit import Refit
from phugoid.discrepancy.search.remainder import RemainderSettings
from phugoid.sensitivities import Place
from phugoid.sensitivities.tangents import collocated

LASTING, SIZE = 0.6, 0.5


def gusty(seed: int) -> ph.Experiment:
    """Moments of gusts of 0.5 rad/s² and 0.6 s on the rate of pitch."""
    rng = np.random.default_rng(seed)
    de = short_period.elevator(rng, 0.05)
    gust = np.zeros(T.size)
    keep = float(np.exp(-0.04 / LASTING))
    for k in range(1, T.size):
        gust[k] = keep * gust[k - 1] + SIZE * np.sqrt(1.0 - keep**2) * rng.standard_normal()

    def slope(t: float, x: np.ndarray) -> np.ndarray:
        moment = np.interp(t, T, gust) - 9.0 * np.interp(t, T, de)
        return np.array([-1.1 * x[0] + x[1], -6.0 * x[0] - 1.6 * x[1] + moment])

    return short_period.record(seed, rng, de, slope)


def test_gusts_have_the_size_and_the_correlation_time_that_they_were_made_with() -> None:
    at = Refit((), collocated(ph.estimate(short_period.model(), gusty(3))))
    of = histories_at(at, Place("equation", "q"))[0]
    found = filtered(at, of, 20.0)
    assert found is not None and found.merit > at.merit + 30.0
    size, error = found.intensity
    assert size == pytest.approx(SIZE, abs=3.0 * error) and error < 0.4 * SIZE
    assert found.tau and found.correlation == pytest.approx(LASTING, rel=0.6)
    # The parameters are no longer biased, and the other record has such gusts, too.
    assert found.fit.parameters["md"].value == pytest.approx(-9.0, abs=3.0 * found.fit.parameters["md"].std_error)
    assert filtered_elsewhere(found, [gusty(2)], [], 20.0) > 0.0


def test_wind_acts_on_declared_forces_and_not_on_gravity() -> None:
    m = ph.Model("path")
    (a, th), (g,) = m.states(alpha="rad", theta="rad"), m.inputs("g")
    (k,) = m.parameters(k=1.0)
    (lift,) = m.quantities(lift=k * a)
    m.dynamics(alpha=-lift + g * ph.cos(th - a), theta=a)
    m.outputs(alpha=a)
    shaped, state, tau = through_shaping_filter(m, Place("state", "alpha"), 0.5)
    right = shaped._right_hand_sides()
    assert state in right["quantity", "lift"].symbols and state in right["equation", state].symbols
    assert tau in right["equation", state].symbols and shaped.declared_parameters[tau].start == 0.5
    for key in (("equation", "alpha"), ("equation", "theta"), ("output", "alpha")):
        assert state not in right[key].symbols
    # Without declared forces all but the kinematics may be one.
    shaped, state, _ = through_shaping_filter(short_period.model(), Place("state", "alpha"), 0.5)
    right = shaped._right_hand_sides()
    assert state in right["equation", "q"].symbols and state not in right["output", "alpha"].symbols


def test_gusts_that_the_linearisation_takes_for_noise_of_sensors_are_named() -> None:
    s = situation("gust", "duffing", 20270418)
    d = ph.diagnose(ph.estimate(s.model, s.data), validation=s.validation)
    (f,) = d.findings
    assert (f.cause, f.status) == ("v':noise", "named") and f.unit == "m/s²"
    assert f.held_out_gain > 0.0 and "FilterError('w')" in f.advice


def test_a_slow_history_that_goes_with_the_motion_by_chance_is_a_random_one() -> None:
    """The same place, with a function of the motion in its place: that does not do so by chance."""
    s = situation("gust", "servo", 20270419)
    at = Refit((), collocated(ph.estimate(s.model, s.data)))
    of = histories_at(at, Place("equation", "rate"))[0]
    assert goes_with_motion(at.linear, of) == 0.0
    (p,) = at.linear.points
    function = np.interp(of.knots, p.t, p.values["angle"] * p.values["rate"])
    same = replace(of, marginal=replace(of.marginal, coefficients=function))
    assert goes_with_motion(at.linear, same) > RemainderSettings.motion


def test_gusts_know_nothing_of_products_of_the_motion_and_an_unknown_function_or_a_changing_factor_does() -> None:
    s, least = situation("gust", "servo", 20270419), RemainderSettings.products
    at = Refit((), collocated(ph.estimate(s.model, s.data)))
    of = histories_at(at, Place("equation", "rate"))[0]
    (p,) = at.linear.points
    angle, rate = (np.interp(of.knots, p.t, p.values[n]) for n in ("angle", "rate"))
    noise = of.values.std() * np.random.default_rng(3).standard_normal(of.knots.size)

    def parts(values: np.ndarray) -> list[float]:
        each = [values, values**2 - np.mean(values**2)]
        return parts_predicted(at.linear, of, products_of_motion, each)

    assert max(parts(of.values)) < 0.5 * least
    function = angle * rate
    assert parts(noise + 2.0 * noise.std() * function / function.std())[0] > least
    # A damping that changes its sign at random: the square is proportional to that of the rate.
    assert parts(np.sign(noise) * rate)[1] > least
