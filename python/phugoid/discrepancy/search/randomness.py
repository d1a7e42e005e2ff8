"""Test whether a time history that was found at a place of the model is random: noise does not know of what moves.

Unmodelled dynamics answer the motion and the inputs, and what is no stationary random disturbance occurs in bursts, or
in few of its independent components. (Tests of independence between residuals and past inputs: Ljung 1999, section
16.6.)
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from ..._core import lagged
from ...sensitivities import Points
from ...sensitivities.linearised import Linearised
from .disturbance import Disturbance

__all__ = ["goes_with_motion", "in_a_tenth", "parts_predicted", "past_inputs", "products_of_motion"]

_Array = NDArray[np.float64]

# Neighbours in the motion that are asked, and the part of the record about a time that counts as the same pass.
_NEIGHBOURS, _PASS = 5, 0.04
# What is slow correlates with what is slow by chance: the history later or earlier, so many times, as a share of the
# record; the quantile of its correlations that is to be exceeded; and a correlation that is none by chance (where the
# motion is periodic, a history that is correlated with it is so with any phase).
_SHIFTS, _CHANCE, _SURELY = 40, 0.95, 0.7
# Of so few correlation times, as a history has in its records, chance is no excuse: it may be anything slow.
_INDEPENDENT = 20.0


def _over_records(linear: Linearised, of: Disturbance) -> list[tuple[Points, _Array]]:
    """Return each record with the times of a time history in it."""
    return list(zip(linear.points, np.split(of.knots, np.cumsum(of.counts)[:-1]), strict=True))


def goes_with_motion(linear: Linearised, of: Disturbance) -> float:
    """Return the correlation of a time history with what it was when the fitted motion was nearly the same at another
    time, 0 where it is so by chance: about 0 for gusts, which do not know of the path that the model simulates without
    them."""
    names = [*linear.model.state_names, *linear.model.declared_inputs]
    each = _over_records(linear, of)
    x = np.hstack([np.stack([np.interp(at, p.t, p.values[name]) for name in names]) for p, at in each])
    spread = x.std(axis=1)
    x = x[spread > 0.0] / spread[spread > 0.0, None]
    where = np.repeat(np.arange(len(each)), of.counts)
    distance = np.sum((x[:, :, None] - x[:, None, :]) ** 2, axis=0)
    index = np.arange(of.knots.size)
    same = (where[:, None] == where) & (np.abs(index[:, None] - index) < max(_PASS * index.size, 3.0))
    distance[same] = np.inf
    nearest = np.argsort(distance, axis=1)[:, :_NEIGHBOURS]

    def correlation(values: _Array) -> float:
        predicted = values[nearest].mean(axis=1)
        spread = predicted.std() * values.std()
        return float(np.cov(predicted, values, bias=True)[0, 1] / spread) if spread > 0.0 else 0.0

    ends = np.cumsum(of.counts)[:-1]
    shifted = [
        np.concatenate([np.roll(v, round(share * v.size)) for v in np.split(of.values, ends)])
        for share in np.linspace(0.1, 0.9, _SHIFTS)
    ]
    found = correlation(of.values)
    if of.correlation * _INDEPENDENT > of.step * of.knots.size:
        return found
    chance = float(np.quantile([correlation(v) for v in shifted], _CHANCE))
    return found if found > min(chance, _SURELY) else 0.0


# Time constants of what inputs do later, from so many knots to a part of the record; blocks that are left out in turn,
# and what is added to the diagonal, in parts of the variances: neighbouring lags are much alike.
_LAGS, _QUICK, _SLOW, _BLOCKS, _RIDGES = 6, 1.0, 0.2, 8, (1e-3, 1e-2, 1e-1)


def in_a_tenth(values: _Array) -> float:
    """Return the part of the squares that the largest tenth of the values has."""
    squares = np.sort(values**2)[::-1]
    return float(squares[: max(squares.size // 10, 1)].sum() / max(float(squares.sum()), 1e-300))


_Signals = Callable[[Linearised, Disturbance], list[list[_Array]]]


def past_inputs(linear: Linearised, of: Disturbance) -> list[list[_Array]]:
    """Return the inputs along each record, now and through lags of several time constants."""
    names, found = _moving(linear, linear.model.declared_inputs), []
    for p in linear.points:
        taus = np.geomspace(_QUICK * of.step, max(_SLOW * float(p.t[-1] - p.t[0]), 2.0 * of.step), _LAGS)
        found.append([z for n in names for z in (p.values[n], *(lagged(p.t, p.values[n], tau) for tau in taus))])
    return found


def products_of_motion(linear: Linearised, _: Disturbance) -> list[list[_Array]]:
    """Return states and inputs along each record, and their squares and products."""
    names = _moving(linear, [*linear.model.state_names, *linear.model.declared_inputs])
    every = [np.concatenate([p.values[n] for p in linear.points]) for n in names]
    found = []
    for p in linear.points:
        moving = [(p.values[n] - x.mean()) / x.std() for n, x in zip(names, every, strict=True)]
        found.append([*moving, *(a * b for a, b in combinations_with_replacement(moving, 2))])
    return found


def _moving(linear: Linearised, names: Iterable[str]) -> list[str]:
    return [n for n in names if any(np.ptp(p.values[n]) > 0.0 for p in linear.points)]


def parts_predicted(linear: Linearised, of: Disturbance, signals: _Signals, values: Sequence[_Array]) -> list[float]:
    """Return the parts of the variances of several values at the knots of a time history that signals predict in blocks
    of time that are left out in turn, each at least 0."""
    columns, blocks = [], []
    for (p, at), along in zip(_over_records(linear, of), signals(linear, of), strict=True):
        columns.append(np.stack([np.ones(at.size), *(np.interp(at, p.t, z) for z in along)]))
        blocks.append(np.minimum((_BLOCKS * (at - p.t[0]) / (p.t[-1] - p.t[0])).astype(int), _BLOCKS - 1))
    x, block, y = np.hstack(columns).T, np.concatenate(blocks), np.stack(values, axis=1)
    power = np.sum(y**2, axis=0)
    if x.shape[1] < 2 or len(y) <= 2 * x.shape[1]:
        return [0.0] * len(values)
    x /= np.maximum(np.sqrt(np.mean(x**2, axis=0)), 1e-300)
    least = power
    for ridge in _RIDGES:
        error = np.empty(y.shape)
        for b in range(_BLOCKS):
            rest = block != b
            normal = x[rest].T @ x[rest] + ridge * rest.sum() * np.eye(x.shape[1])
            error[~rest] = y[~rest] - x[~rest] @ np.linalg.solve(normal, x[rest].T @ y[rest])
        least = np.minimum(least, np.sum(error**2, axis=0))
    return [1.0 - float(left / whole) if whole > 0.0 else 0.0 for left, whole in zip(least, power, strict=True)]
