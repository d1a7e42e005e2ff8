"""How well an output matches, in numbers: Theil's coefficient, whiteness, tolerances."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import chi2, kstest

from phugoid.goodness_of_fit import chi_square_tail, match
from phugoid.records import Record


def _record(z: np.ndarray, y: np.ndarray, t: np.ndarray | None = None, name: str = "run") -> Record:
    t = np.arange(z.size, dtype=float) if t is None else t
    return Record(
        name=name,
        t=t,
        inputs={},
        outputs={"y": y},
        states={},
        measured={"y": z},
        residuals={"y": z - y},
        units={"y": "m"},
    )


@pytest.mark.parametrize("seed", range(5))
def test_theil_is_as_by_hand(seed: int) -> None:
    random = np.random.default_rng(seed)
    z = 3.0 + random.standard_normal(50)
    y = 2.5 + 0.8 * (z - 3.0) + 0.3 * random.standard_normal(50)
    m = match([_record(z, y)], "y")
    mse = np.mean((z - y) ** 2)
    assert m.theil == pytest.approx(np.sqrt(mse) / (np.sqrt(np.mean(z**2)) + np.sqrt(np.mean(y**2))))
    about = np.sqrt(np.mean((z - z.mean()) ** 2)) + np.sqrt(np.mean((y - z.mean()) ** 2))
    assert m.theil_about_mean == pytest.approx(np.sqrt(mse) / about)
    assert m.bias == pytest.approx((z.mean() - y.mean()) ** 2 / mse)
    assert m.variance == pytest.approx((z.std() - y.std()) ** 2 / mse)
    assert m.covariance == pytest.approx(2 * (1 - np.corrcoef(z, y)[0, 1]) * z.std() * y.std() / mse)
    assert m.bias + m.variance + m.covariance == pytest.approx(1.0, abs=1e-12)
    assert m.rms == pytest.approx(np.sqrt(mse))
    assert m.r_squared == pytest.approx(1 - mse / z.var())


def test_parts_of_theil_say_what_is_wrong() -> None:
    z = np.sin(0.1 * np.arange(400))
    offset, gain, late = (match([_record(z, y)], "y") for y in (z + 0.5, 0.5 * z, np.sin(0.1 * np.arange(400) - 0.3)))
    assert offset.bias == pytest.approx(1.0) and gain.variance > 0.99 and late.covariance > 0.98


def test_offsets_of_opposite_sign_do_not_cancel() -> None:
    z = np.sin(0.1 * np.arange(400))
    both = match([_record(z, z + 0.5), _record(z + 10, z + 9.5)], "y")
    assert both.bias == pytest.approx(1.0)
    # Nor does the difference between the records make the match look better.
    assert both.r_squared == pytest.approx(match([_record(z, z + 0.5)], "y").r_squared)


def test_theil_is_zero_for_the_truth_and_one_for_a_constant() -> None:
    z = 5.0 + np.sin(np.arange(100))
    right, nothing = match([_record(z, z)], "y"), match([_record(z, np.full(100, z.mean()))], "y")
    assert right.theil == right.theil_about_mean == 0.0 and right.r_squared == 1.0 and math.isnan(right.bias)
    assert nothing.theil_about_mean == pytest.approx(1.0) and nothing.r_squared == pytest.approx(0.0)
    # About zero, the mean alone makes it look right: why there are both.
    assert nothing.theil < 0.1


def test_ljung_box_is_as_by_hand() -> None:
    r = np.random.default_rng(0).standard_normal(200)
    m = match([_record(r, np.zeros(200))], "y")
    e = r - r.mean()
    rho = [float(e[k:] @ e[:-k] / (e @ e)) for k in range(1, 21)]
    q = 200 * 202 * sum(p**2 / (200 - k) for k, p in enumerate(rho, 1))
    assert (m.lags, m.lag_one) == (20, pytest.approx(rho[0]))
    assert m.whiteness == pytest.approx(chi2.sf(q, 20), rel=1e-9)


def test_the_tail_of_chi_square_is_that_of_scipy() -> None:
    for freedom in range(1, 40):
        for x in (0.0, 1e-3, 0.3, 1.0, 4.0, 10.0, 30.0, 100.0, 1000.0, 2000.0):
            assert chi_square_tail(x, freedom) == pytest.approx(float(chi2.sf(x, freedom)), rel=1e-12, abs=1e-300)


@pytest.mark.parametrize("missing", [0.0, 0.4])
def test_p_values_of_white_residuals_are_uniform(missing: float) -> None:
    found = []
    for seed in range(300):
        random = np.random.default_rng(seed)
        r = random.standard_normal(400)
        r[random.random(400) < missing] = np.nan
        found.append(match([_record(r, np.zeros(400))], "y").whiteness)
    assert kstest(found, "uniform").pvalue > 1e-3


def test_colour_is_seen_through_gaps_and_over_records() -> None:
    random = np.random.default_rng(0)
    runs = []
    for i in range(2):
        r = np.zeros(400)
        for k in range(1, 400):
            r[k] = 0.7 * r[k - 1] + random.standard_normal()
        r[random.random(400) < 0.4] = np.nan
        runs.append(_record(r, np.zeros(400), name=f"run {i}"))
    m = match(runs, "y")
    # Of the same samples as if none were missing between them, lag 1 would be the mean over several lags.
    assert m.whiteness < 1e-6 and m.lag_one == pytest.approx(0.7 * 0.6, abs=0.1)


def test_part_within_tolerance() -> None:
    r = np.array([0.0, 0.1, -0.2, 0.3, np.nan])
    m = match([_record(r, np.zeros(5))], "y", 0.1, tolerance=0.2)
    assert m.inside == pytest.approx(0.75) and m.samples == 4
    assert math.isnan(match([_record(r, np.zeros(5))], "y").inside)


def test_constant_and_missing_channels_have_no_numbers() -> None:
    z = np.full(30, 2.0)
    m = match([_record(z, z + 0.1)], "y")
    assert math.isnan(m.r_squared) and math.isnan(m.whiteness) and m.bias == pytest.approx(1.0)
    none = match([_record(np.full(30, np.nan), z)], "y", tolerance=1.0)
    assert none.samples == 0 and math.isnan(none.rms) and math.isnan(none.inside)
