"""Residuals put together anew in blocks, for noise of which no model is known."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..fit_result import FitResult
from .coloured import coloured
from .resample import Resampler

__all__ = ["Blocks", "block_length"]

_Array: TypeAlias = NDArray[np.float64]

# Blocks are no longer than this part of a record.
_LONGEST = 6


@dataclass(frozen=True, eq=False)
class Blocks(Resampler):
    """Blocks of the residuals themselves, all channels together (Künsch 1989).

    residuals  for each experiment (N, n_y), centred, the missing ones filled with the nearest in time.
    starts     for each experiment where a block may begin, by its length.
    """

    residuals: Sequence[_Array] = ()
    lengths: Sequence[int] = ()
    starts: Sequence[NDArray[np.intp]] = ()

    @classmethod
    def of(cls, fit: FitResult, block: int) -> Blocks:
        """With blocks of so many samples, or fewer where gaps leave no room for them."""
        names = list(fit.model.output_names)
        parts = cls.parts(fit)
        raw = [np.column_stack([r.residuals[n] for n in names]) for r in fit.records]
        stacked = np.vstack(raw)
        n = int(np.isfinite(stacked).sum())
        free = sum(1 for e in fit.parameters.values() if not e.fixed and not e.bounds_active)
        free += len(fit.model.state_names) * len(fit.records) - len(fit.noise_parameters)
        # Residuals are less than the noise by what the fit took.
        larger = math.sqrt(n / max(n - free, 1))
        mean = np.nanmean(stacked, axis=0)
        residuals, lengths, starts = [], [], []
        for r, record in zip(raw, fit.records, strict=True):
            filled, near = _filled(record.t, r)
            residuals.append(larger * (filled - mean))
            length, begin = _beginnings(record.t, near, block)
            lengths.append(length)
            starts.append(begin)
        return cls(**parts, residuals=residuals, lengths=lengths, starts=starts)

    def noise(self, random: np.random.Generator, e: int) -> Mapping[str, _Array]:
        n, length = self.times[e].size, self.lengths[e]
        begin = random.choice(self.starts[e], size=-(-n // length))
        at = (begin[:, None] + np.arange(length)).ravel()[:n]
        return dict(zip(self.model[e], self.residuals[e][at].T, strict=True))


def _filled(t: _Array, residuals: _Array) -> tuple[_Array, NDArray[np.bool_]]:
    """Residuals with the nearest in place of missing ones, and whether all channels were measured nearby: no farther
    away than their usual spacing."""
    out, near = residuals.copy(), np.ones(t.size, dtype=np.bool_)
    for column in out.T:
        there = np.flatnonzero(np.isfinite(column))
        if not there.size:
            column[:] = 0.0
            continue
        after = np.clip(np.searchsorted(t[there], t), 0, there.size - 1)
        before = np.maximum(after - 1, 0)
        nearer = np.where(t - t[there[before]] < t[there[after]] - t, before, after)
        spacing = float(np.median(np.diff(t[there]))) if there.size > 1 else math.inf
        near &= np.abs(t[there[nearer]] - t) <= spacing
        column[:] = column[there[nearer]]
    return out, near


def _beginnings(t: _Array, near: NDArray[np.bool_], block: int) -> tuple[int, NDArray[np.intp]]:
    """The length of blocks and where they may begin: they do not reach over gaps, in time or in the measurements."""
    usual = float(np.median(np.diff(t)))
    whole = near.copy()
    broken = np.r_[False, np.diff(t) > 1.5 * usual]
    run = np.zeros(t.size, dtype=np.intp)  # samples from here on without a gap
    for k in range(t.size - 1, -1, -1):
        following = k + 1 < t.size and whole[k + 1] and not broken[k + 1]
        run[k] = (1 + (run[k + 1] if following else 0)) if whole[k] else 0
    length = max(min(block, int(run.max())), 1)
    begin = np.flatnonzero(run >= length)
    return length, begin if begin.size else np.arange(t.size)


def block_length(fit: FitResult) -> int:
    """Samples of a block, from how long the noise remembers (Carlstein 1986): as for a process of order one with the
    same memory, the longest of all outputs; no more than a sixth of a record."""
    colour = coloured(fit)
    n = min(r.n for r in fit.records)
    length = 1.0
    for name, memory in colour.times.items():
        step = colour.times[name] / max(2.0 * float(colour.autocorrelation[name].sum()) - 1.0, 1e-3)
        usual = float(np.median([np.median(np.diff(r.t)) for r in fit.records]))
        tau = max(memory / step, 1.0)
        rho = (tau - 1.0) / (tau + 1.0)
        own = (2.0 * rho / max(1.0 - rho**2, 1e-9)) ** (2.0 / 3.0) * n ** (1.0 / 3.0)
        length = max(length, own * step / usual)
    return max(1, min(round(length), n // _LONGEST))
