"""Selection of regressors: paths of subsets of the candidate terms, and the statistics of each subset.

Statistics and names are those of V. Klein and E. A. Morelli, Aircraft System Identification, AIAA 2006, ch. 5.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, islice
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

__all__ = ["Block", "Path", "SubsetStatistics", "TermData", "best_subsets", "orthogonal", "stepwise"]

_Array: TypeAlias = NDArray[np.float64]
Block: TypeAlias = frozenset[int]
"""Numbers of the candidates in a subset."""

# Norm of a regressor, less its part along those chosen before, relative to the regressor, below which it has none.
_DEPENDENT = 1e-8
# Subsets whose normal equations are solved at once.
_BATCH = 4096


@dataclass(frozen=True)
class SubsetStatistics:
    """Measures of a subset.

    rms       root mean square of the residuals, in the unit of the equation.
    r_squared coefficient of determination.
    press     root mean square of the residuals of each sample predicted without it (PRESS).
    pse       square root of the predicted squared error.
    held_out  root mean square on held-out data; NaN where there are none.
    """

    rms: float
    r_squared: float
    press: float
    pse: float
    held_out: float


class TermData:
    """The least-squares problem of one group of equations: what is explained, and a column a term.

    y         (n,) left-hand sides, less what fixed parameters explain.
    x         (n, p) regressors; the first ``kept`` are in every subset.
    scatter   mean square of the left-hand sides about their mean.
    held_out  y and x of held-out data, or None.
    middle    (p, p) covariance of x'e under the autocorrelation of the residuals e of the full model, or None: white.
    """

    def __init__(
        self,
        y: _Array,
        x: _Array,
        kept: int,
        scatter: float,
        held_out: tuple[_Array, _Array] | None = None,
        middle: _Array | None = None,
    ) -> None:
        self.y, self.x, self.kept, self.scatter, self.held_out, self.middle = y, x, kept, scatter, held_out, middle
        self.n, self.p = x.shape
        self.candidates = range(kept, self.p)
        self._gram, self._moments = x.T @ x, x.T @ y
        full = y - x @ np.linalg.lstsq(x, y, rcond=None)[0]
        self._noise = float(full @ full) / max(self.n - self.p, 1)

    def columns(self, block: Block) -> list[int]:
        """Return the numbers of the columns of a subset, those that are always kept first."""
        return [*range(self.kept), *sorted(block)]

    def solve(self, block: Block) -> _Array:
        """Return the coefficients of a subset, in the order of `columns`."""
        x = self.x[:, self.columns(block)]
        return np.asarray(np.linalg.lstsq(x, self.y, rcond=None)[0])

    def statistics(self, block: Block) -> SubsetStatistics:
        """Return the measures of a subset."""
        chosen = self.columns(block)
        residual, leverage = self.y, np.zeros(self.n)
        held_out = math.nan
        if chosen:
            x = self.x[:, chosen]
            q, r = np.linalg.qr(x)
            residual = self.y - q @ (q.T @ self.y)
            leverage = np.einsum("ij,ij->i", q, q)
        if self.held_out is not None:
            y, x = self.held_out
            e = y - x[:, chosen] @ np.linalg.solve(r, q.T @ self.y) if chosen else y
            held_out = float(np.sqrt(np.mean(e**2)))
        fit_error = float(np.mean(residual**2))
        press = residual / np.maximum(1.0 - leverage, 1e-12)
        return SubsetStatistics(
            rms=math.sqrt(fit_error),
            r_squared=1.0 - fit_error / self.scatter if self.scatter > 0.0 else math.nan,
            press=float(np.sqrt(np.mean(press**2))),
            # The variance about the mean is the largest that the noise can have (Morelli 1995).
            pse=math.sqrt(fit_error + self.scatter * len(chosen) / self.n),
            held_out=held_out,
        )

    def partial_f(self, block: Block, term: int) -> tuple[float, float]:
        """Return the partial F of a term of a subset: for white residuals, and corrected for their autocorrelation.

        The first is the reduction of the sum of squares over the variance of the residuals; the second the square of
        the coefficient over its variance, with size and autocorrelation of the residuals of the full model. NaN where
        the term is a linear combination of the others.
        """
        chosen = self.columns(block)
        x = self.x[:, chosen]
        size = np.sqrt((x**2).sum(axis=0))
        q, r = np.linalg.qr(x / size)
        if abs(np.diag(r)).min() < _DEPENDENT:
            return math.nan, math.nan
        theta = np.linalg.solve(r, q.T @ self.y)
        inverse = np.linalg.inv(r)
        covariance = inverse @ inverse.T
        residual = self.y - q @ (q.T @ self.y)
        freedom = max(self.n - len(chosen), 1)
        j = chosen.index(term)
        variance = float((residual**2).sum()) / freedom * covariance[j, j]
        white = float(theta[j] ** 2 / variance) if variance > 0.0 else math.inf
        if self.middle is None:
            return white, white
        row = covariance[j] / size
        coloured = float(row @ self.middle[np.ix_(chosen, chosen)] @ row) * self.n / max(self.n - self.p, 1)
        # Autocorrelations of few samples are estimated too small: the variance is not below that of white residuals.
        variance = max(coloured, self._noise * covariance[j, j])
        return white, float(theta[j] ** 2 / variance) if variance > 0.0 else math.inf

    def gains(self, block: Block) -> dict[int, float]:
        """Return by how much each further candidate reduces the sum of squares; 0 for linear combinations."""
        rest = [k for k in self.candidates if k not in block]
        chosen = self.columns(block)
        x, residual = self.x[:, rest], self.y
        size = (x**2).sum(axis=0)
        if chosen:
            q, _ = np.linalg.qr(self.x[:, chosen])
            residual = residual - q @ (q.T @ residual)
            for _ in range(2):  # the second pass takes out what rounding left
                x = x - q @ (q.T @ x)
        left = (x**2).sum(axis=0)
        sound = left > _DEPENDENT**2 * np.maximum(size, 1e-300)
        gain = np.where(sound, (x.T @ residual) ** 2 / np.where(sound, left, 1.0), 0.0)
        return dict(zip(rest, gain.tolist(), strict=True))

    def squares(self, blocks: Sequence[tuple[int, ...]]) -> _Array:
        """Return the sums of squared residuals of subsets of equal size; inf where the regressors are dependent."""
        columns = np.array([[*range(self.kept), *b] for b in blocks], dtype=np.intp)
        total = float(self.y @ self.y)
        if columns.shape[1] == 0:
            return np.full(len(blocks), total)
        size = np.sqrt(np.diag(self._gram))
        size = np.where(size > 0.0, size, 1.0)
        gram, moments = self._gram / np.outer(size, size), self._moments / size
        found = np.full(len(blocks), np.inf)
        g = gram[columns[:, :, None], columns[:, None, :]]
        b = moments[columns]
        sound = np.linalg.eigvalsh(g)[:, 0] > 1e-12
        if sound.any():
            theta = np.linalg.solve(g[sound], b[sound][:, :, None])[:, :, 0]
            found[sound] = total - (theta * b[sound]).sum(axis=1)
        return found


Path: TypeAlias = list[tuple[Block, tuple[float, float]]]
"""Subsets in the order of a search, with the partial F of the term that entered or left; NaN where none did."""


def stepwise(data: TermData, f_in: float, f_out: float, least: float, corrected: bool) -> Path:
    """Return the steps of a stepwise regression, the last of which is its result.

    The candidate that reduces the sum of squares most, among those whose partial F is above ``f_in`` and which raise R²
    by ``least``, enters; then terms leave whose partial F is below ``f_out``, the smallest first. F is ``corrected``
    for the autocorrelation of the residuals, or for white ones. It ends where nothing enters, or a subset returns.
    """
    which = int(corrected)
    block: Block = frozenset()
    path: Path = [(block, (math.nan, math.nan))]
    seen = {block}
    while True:
        gains = data.gains(block)
        total = data.scatter * data.n
        for term in sorted(gains, key=lambda k: -gains[k]):
            if gains[term] <= 0.0 or (total > 0.0 and gains[term] < least * total):
                return path
            f = data.partial_f(block | {term}, term)
            if f[which] > f_in:
                break
        else:
            return path
        block = block | {term}
        path.append((block, f))
        while block:
            values = {k: data.partial_f(block, k) for k in block}
            weakest = min(values, key=lambda k: values[k][which])
            if not values[weakest][which] < f_out:
                break
            block = block - {weakest}
            path.append((block, values[weakest]))
        if block in seen:
            return path
        seen.add(block)


def orthogonal(data: TermData) -> Path:
    """Return the subsets that grow by the orthogonal function which reduces the mean squared error most.

    The candidates are orthogonalised to those chosen before (Gram-Schmidt), so that each reduction is independent of
    the others (E. A. Morelli, Global Nonlinear Aerodynamic Modeling Using Multivariate Orthogonal Functions, J.
    Aircraft 32(2), 1995); the coefficients of the orthogonal functions give those of the terms without error.
    """
    block: Block = frozenset()
    path: Path = [(block, (math.nan, math.nan))]
    while len(data.columns(block)) < data.n - 1:
        gains = data.gains(block)
        if not gains or max(gains.values()) <= 0.0:
            break
        term = max(gains, key=lambda k: gains[k])
        block = block | {term}
        path.append((block, data.partial_f(block, term)))
    return path


def best_subsets(data: TermData) -> Path:
    """Return the subset with the least sum of squares of each size, of all subsets of the candidates."""
    path: Path = []
    for k in range(len(data.candidates) + 1):
        best, least = None, math.inf
        every = combinations(data.candidates, k)
        while batch := list(islice(every, _BATCH)):
            squares = data.squares(batch)
            i = int(np.argmin(squares))
            if squares[i] < least:
                best, least = frozenset(batch[i]), float(squares[i])
        if best is not None:
            path.append((best, (math.nan, math.nan)))
    return path
