"""All candidates at one fit: what each would gain, from one linearisation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .candidate import Candidate
from .least_squares import Whitened, row_runs
from .linearised import Linearised
from .whitening import Channel, Whitening

__all__ = ["CONFOUNDED", "NEARLY", "Scan", "Statistics"]

_Array = NDArray[np.float64]

# Candidates whose effect on the outputs is but this part their own cannot be told from the parameters there, or hardly.
CONFOUNDED, NEARLY = 0.003, 0.05
# Terms that are taken out before the noise is modelled for ranking.
_GREEDY = 3
# Of an effect's own part what is less than this, in units of the noise, is rounding.
_ROUNDING = 1e-10


@dataclass(frozen=True, eq=False)
class Statistics:
    """For each effect (a candidate at a shape), seen through a filter:

    values      twice the gain in log-likelihood, to first order.
    amplitudes  one-step estimates of its coefficients.
    beside      its columns, whitened, without what tangents can imitate, (n_rows, all columns).
    """

    values: _Array
    amplitudes: Sequence[_Array]
    beside: _Array


class Scan:
    """The effects of candidates on the outputs of a fit.

    effects   candidate and shape; several for a candidate with shapes.
    distinct  for each, the part of its effect that the parameters there cannot imitate.
    lost      names of candidates without such a part.
    """

    def __init__(self, linear: Linearised, candidates: Sequence[Candidate]) -> None:
        self.linear = linear
        effects = [(c, shape) for c in candidates for shape in c.shapes]
        found = linear.columns(effects)
        widths = [columns.shape[1] for columns, _ in found]
        ends = np.cumsum(widths)
        groups = [slice(int(end - w), int(end)) for end, w in zip(ends, widths, strict=True)]
        empty = np.empty((linear.n_rows, 0))
        self.columns = np.hstack([empty, *(c for c, _ in found)])
        self.white = Whitened(linear, _white(linear))
        beside = self.white.beside(self.columns)
        parameters = np.hstack([np.empty((found[0][1].shape[0] if found else 0, 0)), *(p for _, p in found)])
        whole = linear.without_states(self.columns / linear.scale()[:, None], parameters)

        def size(columns: _Array, group: slice) -> float:
            return float(np.linalg.norm(columns[:, group]))

        distinct = [size(beside, g) / max(size(whole, g), 1e-300) for g in groups]
        kept = [i for i, g in enumerate(groups) if distinct[i] > CONFOUNDED and size(beside, g) > _ROUNDING]
        self.effects: list[tuple[Candidate, Mapping[str, float]]] = [effects[i] for i in kept]
        self.groups = [groups[i] for i in kept]
        self.distinct = np.array([distinct[i] for i in kept])
        there = {c.name for c, _ in self.effects}
        self.lost = tuple(dict.fromkeys(c.name for c in candidates if c.name not in there))

    def through(self, filter: Whitening) -> Statistics:
        """Statistics through a filter."""
        return self._statistics(Whitened(self.linear, filter.on(row_runs(self.linear))))

    def _statistics(self, whitened: Whitened) -> Statistics:
        beside, errors = whitened.beside(self.columns), whitened.errors
        # The filter may be that of other residuals: what is left here is not less certain than its variance.
        variance = min(float(errors @ errors) / max(errors.size - whitened.basis.shape[1], 1), 1.0)
        values, amplitudes = np.zeros(len(self.groups)), []
        for i, group in enumerate(self.groups):
            j = beside[:, group]
            c = np.linalg.lstsq(j, errors, rcond=1e-10)[0] if j.shape[1] > 1 else (j.T @ errors) / (j[:, 0] @ j[:, 0])
            values[i] = (j.T @ errors) @ c / variance
            amplitudes.append(c)
        return Statistics(values, amplitudes, beside)

    def clean(self) -> Whitening:
        """The filter of the residuals without the few terms that explain most of them, taken as white.

        Slow effects hide in a noise model that was made with them.
        """
        errors, columns = self.white.errors, self.white.beside(self.columns)
        taken: list[int] = []
        e, c = errors.copy(), columns.copy()
        for _ in range(min(_GREEDY, len(self.groups))):
            gains = [-1.0 if i in taken else _gain(c[:, g], e) for i, g in enumerate(self.groups)]
            taken.append(int(np.argmax(gains)))
            q = np.linalg.qr(c[:, self.groups[taken[-1]]])[0]
            e, c = e - q @ (q.T @ e), c - q @ (q.T @ c)
        own = self.white.residuals + self.linear.scale() * (e - errors)
        return Whitening.of(own, row_runs(self.linear))


def _gain(columns: _Array, e: _Array) -> float:
    """Part of e that columns explain."""
    if columns.shape[1] == 1:
        size = float(columns[:, 0] @ columns[:, 0])
        return float(columns[:, 0] @ e) ** 2 / size if size > _ROUNDING else -1.0
    return float(np.sum((np.linalg.qr(columns)[0].T @ e) ** 2))


def _white(linear: Linearised) -> Whitening:
    """The noise as the fit has it: white."""
    channels = [Channel((np.empty(0),), np.array([sigma])) for sigma in linear.sigmas]
    return Whitening(channels, row_runs(linear))
