"""The figure of residuals: what its panels show, against numpy and scipy, and what is refused."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter, welch

import phugoid as ph
from phugoid import Gaussian
from phugoid.discrepancy.misfit.residuals_figure import plot_residuals
from phugoid.errors import DataError, UnknownName
from phugoid.parameters import Estimate, Estimates
from phugoid.records import Record

N, DT = 400, 0.05


def record(**residuals: np.ndarray) -> Record:
    t = DT * np.arange(len(next(iter(residuals.values()))))
    zero = {name: np.zeros(t.size) for name in residuals}
    return Record(
        name="run1", t=t, inputs={}, outputs=zero, states={}, measured=residuals, residuals=residuals,
        units={"q": "rad/s", "az": "m/s²"},
    )  # fmt: skip


def fit(*records: Record) -> Any:
    return SimpleNamespace(
        records=list(records),
        parameters=Estimates([Estimate("sigma_q", 0.5)]),
        noise=Gaussian(),
        model=SimpleNamespace(name="a model worth $5"),
    )


def white(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(N)


def coloured() -> np.ndarray:
    return np.asarray(lfilter([1.0], [1.0, -0.8], white()))


def curve(axis: Any) -> tuple[np.ndarray, np.ndarray]:
    """The longest line of a panel."""
    line = max(axis.get_lines(), key=lambda x: len(x.get_xdata()))
    return np.asarray(line.get_xdata(), dtype=float), np.asarray(line.get_ydata(), dtype=float)


def band(axis: Any) -> tuple[float, float]:
    (patch,) = axis.patches
    low = patch.get_y()
    return low, low + patch.get_height()


def test_panels_units_and_residuals() -> None:
    r = coloured()
    figure, axes = plot_residuals(fit(record(q=r, az=white(1))))
    assert list(axes) == [f"{n}{what}" for n in ("q", "az") for what in ("", " autocorrelation", " spectrum")]
    assert [axes[n].get_ylabel() for n in ("q", "az")] == ["q, rad/s", "az, m/s²"]
    assert axes["az"].get_xlabel() == "time, s" and axes["az autocorrelation"].get_xlabel() == "lag, s"
    assert axes["az spectrum"].get_xlabel() == "frequency, Hz"
    assert axes["q spectrum"].get_title(loc="right") == "(rad/s)²/Hz"
    np.testing.assert_array_equal(curve(axes["q"])[1], r)
    assert band(axes["q"]) == (-1.0, 1.0)  # ±2σ; of az no σ is known
    assert not axes["az"].patches
    assert figure.get_size_inches()[0] <= 7.3


def test_autocorrelation_is_that_of_numpy_with_its_bound() -> None:
    r = coloured()
    _, axes = plot_residuals(fit(record(q=r)))
    lags, rho = curve(axes["q autocorrelation"])
    products = np.correlate(r, r, "full")[N - 1 :] / (N - np.arange(N))  # means over the pairs there are
    np.testing.assert_allclose(rho, (products / products[0])[: rho.size], atol=1e-12)
    np.testing.assert_allclose(lags, DT * np.arange(rho.size))
    assert band(axes["q autocorrelation"]) == pytest.approx((-1.96 / N**0.5, 1.96 / N**0.5))
    assert f"lag 1: {rho[1]:.2f}" in axes["q autocorrelation"].get_title(loc="right")
    assert rho[1] > 0.6


def test_spectrum_is_that_of_scipy_and_white_noise_stays_in_its_band() -> None:
    r = white()
    _, axes = plot_residuals(fit(record(q=r)))
    frequency, density = curve(axes["q spectrum"])
    size = 2 * frequency.size
    f, p = welch(r, 1.0 / DT, "hann", size, size - (size - size // 2), detrend=False)
    np.testing.assert_allclose(frequency, f[1:], atol=1e-9)
    np.testing.assert_allclose(density[:-1], p[1:-1], rtol=0.05)  # scaled by the mean square, padded at the end
    low, high = band(axes["q spectrum"])
    assert low < np.mean(density) < high
    inside = np.mean((density > low) & (density < high))
    assert 0.88 < inside <= 1.0
    _, axes = plot_residuals(fit(record(q=coloured())))
    density, (low, high) = curve(axes["q spectrum"])[1], band(axes["q spectrum"])
    assert np.mean((density > low) & (density < high)) < 0.5


def test_gaps_join_no_pairs_across_them_and_break_the_line() -> None:
    r = coloured()
    r[100:180] = np.nan
    _, axes = plot_residuals(fit(record(q=r)))
    _, rho = curve(axes["q autocorrelation"])
    first = np.concatenate([r[:99] * r[1:100], r[180:-1] * r[181:]])
    present = r[np.isfinite(r)]
    assert rho[1] == pytest.approx(first.mean() / np.mean(present**2))
    t, shown = curve(axes["q"])
    assert np.isnan(shown).sum() == 1 and np.isfinite(shown).sum() == N - 80


def test_uneven_times_and_outliers_are_told() -> None:
    r = white()
    r[50] = 40.0
    uneven = record(q=r)
    object.__setattr__(uneven, "t", np.cumsum(np.random.default_rng(2).uniform(0.02, 0.09, N)))
    told, untold = (
        [text.get_text() for text in plot_residuals(fit(run))[1]["q autocorrelation"].texts]
        for run in (uneven, record(q=white()))
    )
    assert told == ["uneven times\n1 outlier left out"] and untold == [""]


def test_innovations_take_the_place_of_residuals() -> None:
    r = record(q=white())
    innovations = white(5)
    object.__setattr__(r, "innovations", {"q": innovations})
    object.__setattr__(r, "innovation_std", {"q": np.full(N, 0.7)})
    figure, axes = plot_residuals(fit(r))
    np.testing.assert_array_equal(curve(axes["q"])[1], innovations)
    assert "innovations" in figure.texts[0].get_text()
    assert axes["q"].collections[0].get_paths()[0].vertices[:, 1].max() == pytest.approx(1.4)


def test_few_samples_get_no_statistics() -> None:
    _, axes = plot_residuals(fit(record(q=white()[:8])))
    assert [t.get_text() for t in axes["q spectrum"].texts] == ["too few residuals"]


def test_bad_input_is_refused() -> None:
    r = record(q=white(), az=np.full(N, np.nan))
    assert "az" not in plot_residuals(fit(r))[1]  # not measured
    with pytest.raises(UnknownName, match="no residuals of 'Q'. Did you mean 'q'"):
        plot_residuals(fit(r), channels=["Q"])
    with pytest.raises(DataError, match="'az' was not measured"):
        plot_residuals(fit(r), channels=["az"])
    with pytest.raises(DataError, match=r"channels=\['q'\]"):
        plot_residuals(fit(r), channels="q")
    with pytest.raises(UnknownName, match="no record 3"):
        plot_residuals(fit(r), 3)
    with pytest.raises(DataError, match="nothing was measured"):
        plot_residuals(fit(record(az=np.full(N, np.nan))))


def test_method_of_a_fit() -> None:
    m = ph.Model("lag")
    (x,) = m.states(x="m")
    (a,) = m.parameters(a=1.0)
    m.dynamics(x=-a * x)
    m.outputs(x=x)
    t = 0.1 * np.arange(40)
    found = ph.estimate(m, ph.Experiment(t, outputs={"x": np.exp(-t) + 0.01 * white()[:40]}))
    _, axes = found.plot_residuals()
    np.testing.assert_array_equal(curve(axes["x"])[1], found.residuals["x"])
