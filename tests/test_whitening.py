"""Whitening: autoregressive models of channels, their exact likelihood with gaps, and channels that go together."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import block_diag, solve_discrete_lyapunov, toeplitz
from scipy.signal import lfilter
from scipy.stats import chi2, multivariate_normal

from phugoid.residual_noise import UniformSegment, uniform_segments
from phugoid.residual_noise.autoregression import burg
from phugoid.residual_noise.whitening import RowStructure, Whitening

AR = [[], [0.9], [1.6, -0.8], [0.5, 0.0, 0.3], [-0.7]]


def coloured(a: Sequence[float], n: int, seed: int, sigma: float = 1.0) -> np.ndarray:
    """Of an AR process, long after its beginning."""
    e = sigma * np.random.default_rng(seed).standard_normal(n + 500)
    return np.asarray(lfilter([1.0], [1.0, *(-x for x in a)], e)[500:])


def covariance(a: Sequence[float], sigma: float, n: int) -> np.ndarray:
    """(n, n) of n samples of an AR process, by its state space (Lyapunov's equation), not by the recursion."""
    p = max(len(a), 1)
    step = np.eye(p, k=-1)
    step[0, : len(a)] = a
    noise = np.zeros((p, p))
    noise[0, 0] = sigma**2
    state, gamma = solve_discrete_lyapunov(step, noise), []
    for _ in range(n):
        gamma.append(state[0, 0])
        state = step @ state
    return np.asarray(toeplitz(gamma))


def alone(segments: Sequence[Sequence[UniformSegment]]) -> RowStructure:
    """No two rows at the same time."""
    together = [((i,), np.arange(s.rows.start, s.rows.stop)[:, None]) for i, line in enumerate(segments) for s in line]
    return RowStructure(segments, together)


def one(*lengths: int) -> RowStructure:
    """One channel, a strand without gaps for each length."""
    edges = np.cumsum([0, *lengths]).tolist()
    return alone([[UniformSegment(slice(a, b), np.arange(b - a)) for a, b in pairwise(edges)]])


def side_by_side(present: np.ndarray) -> RowStructure:
    """RowStructure of channels (n_y, n) at common times, output by output, where present."""
    numbers = np.full(present.shape, -1)
    numbers[present] = np.arange(int(present.sum()))
    segments = []
    for line, there in zip(numbers, present, strict=True):
        places = np.flatnonzero(there)
        first = int(line[places[0]])
        segments.append([UniformSegment(slice(first, first + places.size), places - places[0])])
    together = []
    for pattern in np.unique(present.T, axis=0):
        if pattern.any():
            which = np.flatnonzero(pattern)
            together.append((tuple(which.tolist()), numbers.T[(pattern == present.T).all(axis=1)][:, which]))
    return RowStructure(segments, together)


# ---------------------------------------------------------------- one channel


@pytest.mark.parametrize("a", AR, ids=str)
def test_the_process_is_found_and_its_order(a: list[float]) -> None:
    channel = burg([coloured(a, 20_000, 1, 0.3)])
    assert len(a) <= channel.order <= len(a) + 1
    assert channel.predictors[-1][: len(a)] == pytest.approx(a, abs=0.03)
    assert channel.sigmas[-1] == pytest.approx(0.3, rel=0.02)


def test_runs_tell_what_one_series_tells() -> None:
    """Pieces of one series, with every sixth left out."""
    x = coloured([1.6, -0.8], 12_000, 2)
    pieces = [x[i : i + 50] for i in range(0, x.size, 60)]
    channel = burg(pieces)
    assert 2 <= channel.order <= 3
    assert channel.predictors[-1][:2] == pytest.approx([1.6, -0.8], abs=0.04)


@pytest.mark.parametrize("missing", [0.0, 0.1, 0.3, 0.5, 0.7])
def test_of_white_noise_there_is_no_model(missing: float) -> None:
    """However many samples are missing: runs that are long enough for many lags may be few."""
    orders, sigmas = [], []
    for seed in range(100):
        random = np.random.default_rng(seed)
        t = 0.1 * np.flatnonzero(random.random(400) >= missing)
        x = random.standard_normal(t.size)
        (strand,) = uniform_segments(t)
        channel = burg([x[run] for run in strand.runs])
        orders.append(channel.order)
        sigmas.append(channel.sigmas[-1])
    assert np.mean(np.array(orders) > 0) <= 0.03
    assert min(sigmas) > 0.7 and max(sigmas) < 1.4


@pytest.mark.parametrize(
    "x", [np.ones(200), np.sin(0.3 * np.arange(200)), np.arange(200.0), np.zeros(200), np.r_[1.0, np.zeros(99)]]
)
def test_of_what_is_no_noise_the_model_is_still_stationary(x: np.ndarray) -> None:
    channel = burg([x])
    roots = np.roots(np.r_[1.0, -channel.predictors[-1]])
    assert (np.abs(roots) < 1.0).all() and (channel.sigmas > 0).all()
    assert np.isfinite(Whitening([channel], one(x.size))(x)).all()


def test_samples_on_a_grid_are_one_strand() -> None:
    t = 0.1 * np.arange(20)
    places = [strand.places.tolist() for strand in uniform_segments(t)]
    assert places == [list(range(20))]
    (rounded,) = uniform_segments(t + 0.002 * (-1.0) ** np.arange(20))
    assert rounded.places.tolist() == list(range(20)) and rounded.runs == [slice(0, 20)]
    (gaps,) = uniform_segments(np.delete(t, [5, 6, 12]))
    assert gaps.places.tolist() == np.delete(np.arange(20), [5, 6, 12]).tolist()
    assert gaps.runs == [slice(0, 5), slice(5, 10), slice(10, 17)]
    # Every third is missing: two steps alternate.
    (pairs,) = uniform_segments(np.delete(t, np.s_[2::3]))
    assert pairs.places.tolist() == [0, 1, 3, 4, 6, 7, 9, 10, 12, 13, 15, 16, 18, 19]
    # A jump by half a step, and a spacing that is not a multiple.
    jump = uniform_segments(np.r_[t, t + 2.05])
    assert [(s.rows, s.places.size) for s in jump] == [(slice(0, 20), 20), (slice(20, 40), 20)]
    assert uniform_segments(np.r_[t, t[-1] + 0.15 * np.arange(1, 6)])[0].rows == slice(0, 20)
    assert jump[1].from_row(100).rows == slice(120, 140)
    assert [s.rows for s in uniform_segments(t[:1])] == [slice(0, 1)] and list(uniform_segments(t[:0])) == []


# ---------------------------------------------------------------- likelihood


def test_the_likelihood_is_that_of_the_process() -> None:
    """Three channels, in segments with gaps short and long, against normal distributions with the covariance written
    out."""
    random = np.random.default_rng(0)
    tattered = np.flatnonzero(random.random(150) < 0.6)
    places = [
        [np.arange(120), np.array([0]), np.array([0, 1]), np.r_[:5, 9:30, 31, 40, 43:60], tattered - tattered[0]],
        [np.r_[:30, 33:40], np.r_[:4, 90:94, 300:310], np.arange(0, 80, 2)],
        [np.r_[:20, 90:100, 101, 250], np.r_[0:200:7, 200:210]],
    ]
    processes = [[1.6, -0.8], [0.9], [0.4, 0.3, -0.2, 0.1]]
    segments: list[list[UniformSegment]] = []
    pieces, first = [], 0
    for i, line in enumerate(places):
        segments.append([])
        for k, at in enumerate(line):
            segments[-1].append(UniformSegment(slice(first, first + at.size), at))
            pieces.append(coloured(processes[i], int(at[-1]) + 1, 10 * i + k, 0.3)[at])
            first += at.size
    r = np.concatenate(pieces)
    channels = [burg([coloured(a, 5000, 77 + i, 0.3)]) for i, a in enumerate(processes)]
    assert all(channel.order >= len(a) for channel, a in zip(channels, processes, strict=True))
    whitening = Whitening(channels, alone(segments))
    densities = whitening.log_densities(whitening(r))
    blocks = []
    for channel, line in zip(channels, segments, strict=True):
        for strand in line:
            at, n = strand.places, strand.places.size
            whole = covariance(channel.predictors[-1], channel.sigmas[-1], int(at[-1]) + 1)
            blocks.append(whole[np.ix_(at, at)])
            expected = multivariate_normal(cov=blocks[-1]).logpdf(r[strand.rows]) + 0.5 * n * np.log(2 * np.pi)
            assert densities[strand.rows].sum() == pytest.approx(expected, abs=1e-9 * n)
    # What is done to rows is linear, and makes this covariance that of white noise of size 1.
    w = whitening(np.eye(r.size)).T
    assert w @ r == pytest.approx(whitening(r), abs=1e-11)
    assert w @ block_diag(*blocks) @ w.T == pytest.approx(np.eye(r.size), abs=1e-9)


def test_far_down_a_slow_process_no_digits_are_lost() -> None:
    """A process of high order near its edge of stability, through the least gap."""
    channel = burg([np.sin(0.3 * np.arange(3000)) + 0.01 * np.random.default_rng(0).standard_normal(3000)])
    assert channel.order > 4 and channel.sigmas[-1] < 0.03 * channel.sigmas[0]
    at = np.r_[:40, 41:80]
    whole = covariance(channel.predictors[-1], channel.sigmas[-1], 80)
    w = Whitening([channel], alone([[UniformSegment(slice(0, 79), at)]]))(np.eye(79)).T
    assert w @ whole[np.ix_(at, at)] @ w.T == pytest.approx(np.eye(79), abs=1e-9)


@pytest.mark.parametrize("a", AR, ids=str)
def test_errors_are_white(a: list[float]) -> None:
    x, n = coloured(a, 4000, 5, 2.0), 4000
    whitening = Whitening.of(x, one(1500, n - 1500))
    e = whitening(x)
    assert e.std() == pytest.approx(1.0, abs=0.02)
    rho = np.array([e[k:] @ e[: n - k] / (e @ e) for k in range(1, 21)])
    assert n * (rho**2).sum() < chi2.isf(1e-3, 20)  # Box and Pierce


def test_rows_are_whitened_many_at_a_time_as_each_alone() -> None:
    x = coloured([0.9], 300, 5)
    whitening = Whitening.of(x, one(100, 200))
    many = np.random.default_rng(0).standard_normal((2, 70, 300))
    found = whitening(many)
    assert found.shape == many.shape
    assert found[1, 65] == pytest.approx(whitening(many[1, 65]), abs=1e-13)


# ---------------------------------------------------------------- channels that go together

PRESENT = np.ones((3, 600), dtype=bool)


def errors(correlation: np.ndarray, n: int, seed: int) -> np.ndarray:
    return np.linalg.cholesky(correlation) @ np.random.default_rng(seed).standard_normal((len(correlation), n))


C = np.array([[1.0, 0.6, 0.0], [0.6, 1.0, -0.3], [0.0, -0.3, 1.0]])


def test_correlation_is_found_where_it_is() -> None:
    for seed in range(20):
        e = errors(C, 600, seed)
        # Each channel with a colour of its own.
        r = np.array([lfilter([1.0], [1.0, -a], line) for a, line in zip((0.9, 0.0, 0.5), e, strict=True)])
        whitening = Whitening.of(r.ravel(), side_by_side(PRESENT))
        assert whitening.correlation is not None
        assert whitening.correlation == pytest.approx(C, abs=0.16)
        white = whitening(r.ravel()).reshape(3, -1)
        assert np.cov(white) == pytest.approx(np.eye(3), abs=0.03)


@pytest.mark.parametrize(("channels", "n"), [(2, 600), (3, 300), (7, 600)])
def test_correlation_is_not_found_where_it_is_not(channels: int, n: int) -> None:
    """By Schwarz's criterion of a single pair in 1 % of records of 600 samples; of more in fewer."""
    rows, false, seeds = side_by_side(np.ones((channels, n), dtype=bool)), 0, 300
    colours = np.linspace(0.0, 0.9, channels)
    for seed in range(seeds):
        e = np.random.default_rng(seed).standard_normal((channels, n))
        r = np.array([lfilter([1.0], [1.0, -a], line) for a, line in zip(colours, e, strict=True)])
        false += Whitening.of(r.ravel(), rows).correlation is not None
    assert false < 0.02 * seeds, false


def test_channels_that_are_never_seen_together_hide_nothing_of_the_others() -> None:
    present = PRESENT.copy()
    present[:2, 1::2], present[2, ::2] = False, False
    e = errors(C, 600, 3)
    found = Whitening.of(e[present], side_by_side(present)).correlation
    assert found is not None and found[0, 1] == pytest.approx(0.6, abs=0.1)
    assert found[0, 2] == found[1, 2] == 0.0


def test_densities_with_correlation_and_missing_channels() -> None:
    """Against the determinant and the covariance of the whole transform."""
    present = PRESENT[:, :80].copy()
    present[1, 10:25] = present[0, 20:40] = present[2, ::3] = False
    rows = side_by_side(present)
    channels = [burg([coloured(a, 3000, i)]) for i, a in enumerate(([0.8], [0.5, 0.3], []))]
    whitening = Whitening(channels, rows, C)
    assert {which for which, _ in rows.together} > {(0, 1, 2), (0, 1), (1,)}
    n = int(present.sum())
    w = whitening(np.eye(n)).T
    r = np.random.default_rng(4).standard_normal(n)
    e = whitening(r)
    assert e == pytest.approx(w @ r, abs=1e-11)
    sign, log_det = np.linalg.slogdet(w)
    assert sign > 0
    assert whitening.log_densities(e).sum() == pytest.approx(-0.5 * e @ e + log_det, abs=1e-9)
    # Errors of single channels have the correlation where they are at the same time, and none else.
    single = Whitening(channels, rows)(np.eye(n)).T @ np.linalg.inv(w)
    found = single @ single.T
    at, channel = np.nonzero(present.T)
    order = np.lexsort((at, channel))
    at, channel = at[order], channel[order]
    expected = np.where(at[:, None] == at, C[channel[:, None], channel], 0.0)
    assert found == pytest.approx(expected, abs=1e-9)


def test_on_other_rows_the_models_stay() -> None:
    whitening = Whitening.of(errors(C, 600, 3).ravel(), side_by_side(PRESENT))
    other = whitening.on(side_by_side(PRESENT[:, :50]))
    assert other.channels == whitening.channels and other.correlation is whitening.correlation
    e = other(np.ones(150))
    expected = np.linalg.solve(np.linalg.cholesky(C), np.ones(3))
    assert e.reshape(3, -1)[:, -1] == pytest.approx(expected, abs=0.2)


def test_a_single_channel_has_no_correlation() -> None:
    x = np.random.default_rng(0).standard_normal(100)
    assert Whitening.of(x, side_by_side(PRESENT[:1, :100])).correlation is None


def test_a_channel_without_residuals_does_not_disturb_the_others() -> None:
    e = errors(C, 600, 3)
    e[2] = 0.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        whitening = Whitening.of(e.ravel(), side_by_side(PRESENT))
        found = whitening(e.ravel()).reshape(3, -1)
    assert whitening.correlation is not None
    assert whitening.correlation == pytest.approx(np.array([[1, 0.6, 0], [0.6, 1, 0], [0, 0, 1]]), abs=0.1)
    assert np.cov(found[:2]) == pytest.approx(np.eye(2), abs=0.03) and not found[2].any()
