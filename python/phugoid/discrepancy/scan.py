"""All candidates at one fit: what each would gain, from one linearisation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .candidate import Candidate
from .joint import Filter
from .least_squares import Whitened
from .linearised import Linearised
from .prediction import Channel
from .whitening import Whitening

__all__ = ["CONFOUNDED", "NEARLY", "Scan", "Statistics"]

_Array = NDArray[np.float64]

# Candidates whose effect on the outputs is but this part their own cannot be told from the parameters there, or hardly.
CONFOUNDED, NEARLY = 0.003, 0.05
# Terms that are taken out before the noise is modelled for ranking.
_GREEDY = 3
# Whitenings whose statistics are kept.
_KEPT = 4
# Of an effect's own part what is less than this, in units of the noise, is rounding.
_ROUNDING = 1e-10


@dataclass(frozen=True, eq=False)
class Statistics:
    """For each effect (a candidate at a shape), seen through a filter:

    values      twice the gain in log-likelihood, to first order.
    amplitudes  one-step estimates of its coefficients.
    beside      its columns, whitened, without what tangents can imitate, (all columns, n_rows).
    errors      (n_rows,) what is left of the residuals, whitened.
    """

    values: _Array
    amplitudes: Sequence[_Array]
    beside: _Array
    errors: _Array


class Scan:
    """The effects of candidates on the outputs of a fit.

    effects   candidate and shape; several for a candidate with shapes.
    groups    which columns are whose.
    distinct  for each, the part of its effect that the parameters there cannot imitate.
    lost      names of candidates without such a part.
    """

    def __init__(self, linear: Linearised, candidates: Sequence[Candidate]) -> None:
        self.linear = linear
        effects = [(c, shape) for c in candidates for shape in c.shapes]
        self.columns, parameters, groups = linear.columns(effects)
        self.white = Whitened(linear, _white(linear))
        beside = self.white.beside(self.columns)
        own = _sizes(beside)
        whole = _sizes(linear.without_states(self.columns / linear.scale(), parameters))
        own, whole = (np.array([np.sqrt(np.sum(v[g] ** 2)) for g in groups]) for v in (own, whole))
        distinct = own / np.maximum(whole, 1e-300)
        kept = np.flatnonzero((distinct > CONFOUNDED) & (own > _ROUNDING))
        self.effects: list[tuple[Candidate, Mapping[str, float]]] = [effects[i] for i in kept]
        self.groups = [groups[i] for i in kept]
        self.distinct = distinct[kept]
        there = {c.name for c, _ in self.effects}
        self.lost = tuple(dict.fromkeys(c.name for c in candidates if c.name not in there))
        self._clean: Whitening | None = None
        self._last: list[tuple[Filter, Statistics]] = [(self.white.filter, self._statistics(self.white, beside))]

    def through(self, filter: Filter) -> Statistics:
        """Statistics through a filter; those of the last few filters are kept."""
        for known, statistics in self._last:
            if known is filter:
                return statistics
        whitened = Whitened(self.linear, filter.on(self.linear.structure))
        statistics = self._statistics(whitened, whitened.beside(self.columns))
        self._last = [(filter, statistics), *self._last[: _KEPT - 1]]
        return statistics

    def forget(self) -> None:
        """Drops what is kept: it takes space."""
        self._last = []

    def _statistics(self, whitened: Whitened, beside: _Array) -> Statistics:
        errors = whitened.errors
        # The filter may be that of other residuals: what is left here is not less certain than its variance.
        variance = min(float(errors @ errors) / max(errors.size - whitened.basis.shape[1], 1), 1.0)
        grams, parts = _grams(beside, self.groups), beside @ errors
        values, amplitudes = [], []
        for gram, group in zip(grams, self.groups, strict=True):
            c = _solved(gram, parts[group])
            values.append(float(parts[group] @ c) / variance)
            amplitudes.append(c)
        return Statistics(np.array(values), amplitudes, beside, errors)

    def clean(self) -> Whitening:
        """The filter of the residuals without the few terms that explain most of them, taken as white.

        Slow effects hide in a noise model that was made with them.
        """
        if self._clean is None:
            errors = self.white.errors.copy()
            self._greedy(self.through(self.white.filter).beside, errors, _GREEDY)
            own = self.white.residuals + self.linear.scale() * (errors - self.white.errors)
            self._clean = Whitening.of(own, self.linear.structure)
        return self._clean

    def different(self, statistics: Statistics, count: int) -> list[int]:
        """The effect that explains most, the one that explains most of what is left, and so on."""
        return self._greedy(statistics.beside, statistics.errors.copy(), count)

    def _greedy(self, beside: _Array, errors: _Array, count: int) -> list[int]:
        """Takes out of errors what explains most of them, one effect after the other, and tells which."""
        grams = _grams(beside, self.groups)
        taken: list[int] = []
        found: list[_Array] = []
        for _ in range(min(count, len(self.groups))):
            parts = beside @ errors
            gains = [float(parts[g] @ _solved(gram, parts[g])) for gram, g in zip(grams, self.groups, strict=True)]
            taken.append(int(np.argmax(gains)))
            best = beside[self.groups[taken[-1]]].T.copy()
            for q in found:
                best -= np.outer(q, q @ best)
            for q in np.linalg.qr(best)[0].T:
                errors -= q * (q @ errors)
                found.append(q)
                along = beside @ q
                for gram, g in zip(grams, self.groups, strict=True):
                    gram -= along[g, None] * along[g]
        return taken


def _sizes(columns: _Array) -> _Array:
    return np.asarray(np.sqrt(np.einsum("ij,ij->i", columns, columns)))


def _grams(columns: _Array, groups: Sequence[slice]) -> list[_Array]:
    """Products of each group's columns with each other."""
    return [columns[g] @ columns[g].T for g in groups]


def _solved(gram: _Array, part: _Array) -> _Array:
    """Least squares from normal equations; nothing where the columns are nothing."""
    if gram.shape[0] == 1:
        return part / gram[0] if gram[0, 0] > _ROUNDING else np.zeros(1)
    if gram.shape[0] == 2:  # by hand: there are hundreds
        (a, b), (_, d) = gram
        determinant = a * d - b * b
        if determinant > 1e-10 * a * d:
            solved: _Array = np.array([d * part[0] - b * part[1], a * part[1] - b * part[0]]) / determinant
            return solved
    return np.asarray(np.linalg.lstsq(gram, part, rcond=1e-10)[0])


def _white(linear: Linearised) -> Whitening:
    """The noise as the fit has it: white."""
    channels = [Channel((np.empty(0),), np.array([sigma])) for sigma in linear.sigmas]
    return Whitening(channels, linear.structure)
