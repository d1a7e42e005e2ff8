"""One autoregressive model and one kind of segment serve all that asks for the colour of residuals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solve_toeplitz

from phugoid.residual_noise import UniformSegment, output_segments, sampled_segment, uniform_segments
from phugoid.residual_noise.autoregression import Autoregression, burg


@pytest.fixture(scope="module")
def model() -> Autoregression:
    """Of a process of second order."""
    r = np.zeros(4000)
    e = np.random.default_rng(3).standard_normal(r.size)
    for t in range(2, r.size):
        r[t] = 1.5 * r[t - 1] - 0.7 * r[t - 2] + 0.3 * e[t]
    return burg([r])


def test_covariances_satisfy_the_yule_walker_equations(model: Autoregression) -> None:
    c = model.covariance(200)
    np.testing.assert_allclose(solve_toeplitz(c[: model.order], c[1 : model.order + 1]), model.coefficients, rtol=1e-8)
    assert c[0] - model.coefficients @ c[1 : model.order + 1] == pytest.approx(model.power, rel=1e-9)
    assert model.sigmas[-1] == pytest.approx(0.3, rel=0.04)


def test_spectrum_is_that_of_the_response(model: Autoregression) -> None:
    lags, size = 400, 1024
    power = model.power * np.abs(np.fft.rfft(model.response(lags), size)) ** 2
    np.testing.assert_allclose(model.spectrum(lags, size), power, rtol=1e-6)


def test_innovations_need_all_their_lags(model: Autoregression) -> None:
    grid = np.random.default_rng(0).standard_normal(50)
    grid[20] = np.nan
    known = np.isfinite(model.innovations(grid))
    p = model.order
    assert known.tolist() == [i >= p and not 20 <= i <= 20 + p for i in range(50)]


def test_ways_to_place_samples_agree_where_times_are_even() -> None:
    t = np.r_[np.arange(10), np.arange(15, 30)] * 0.1
    (one,) = uniform_segments(t)
    ((other,),) = output_segments(t, [[slice(0, t.size)]])
    for segment in (one, other, sampled_segment(t)):
        assert segment.places.tolist() == [*range(10), *range(15, 30)]
        assert segment.runs == [slice(0, 10), slice(10, 25)]
        assert segment.step == pytest.approx(0.1) and segment.size == 30


def test_values_on_a_grid() -> None:
    segment = UniformSegment(slice(4, 7), np.array([0, 1, 3]), 0.5)
    np.testing.assert_array_equal(segment.on_grid(np.array([1.0, 2.0, 3.0])), [1.0, 2.0, np.nan, 3.0])
    np.testing.assert_array_equal(segment.on_grid(np.ones((3, 2)), 0.0)[2], [0.0, 0.0])
    assert segment.mask.tolist() == [1.0, 1.0, 0.0, 1.0]
    assert segment.from_row(10).rows == slice(14, 17)


def test_samples_whose_times_jitter_follow_each_other() -> None:
    """They were taken for independent, so that sensor noise with a correlation time was called process noise."""
    rng = np.random.default_rng(3)
    t = np.arange(200.0) + rng.uniform(-0.3, 0.3, 200)
    (one,) = uniform_segments(t)
    assert one.rows == slice(0, 200) and len(one.runs) < 20
    # Half of the samples on even times: their segments are long enough to be taken apart.
    assert len(uniform_segments(np.r_[np.arange(100.0), 200.5 + np.arange(100.0)])) <= 2
