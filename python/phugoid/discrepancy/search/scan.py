"""The expected gain of every candidate at a fit, from one linearisation.

What tangents can imitate counts for nothing through any filter, so it is taken out of the effects' columns C once, in
the metric of white noise: what is left is small where the motion is unstable and C is not. Through a filter F, with
W = F C, Q an orthonormal basis of the whitened tangents and e what they leave of the residuals, W'W - (Q'W)'(Q'W) and
W'e are all that the statistics need: whitened columns come and go, block by block."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ...residual_noise.autoregression import Autoregression
from ...residual_noise.whitening import Filter, Whitening
from ...sensitivities.linearised import Linearised
from ...sensitivities.whitened import Whitened
from ...solvers import check_time
from ..candidates.candidate import Candidate

__all__ = ["CONFOUNDED", "NEARLY", "Groups", "Scan", "Statistics"]

_Array = NDArray[np.float64]
_Grams = list[_Array]

# A column, of length 1 as a whole, of which less than this is left in square is rounding; directions with less of the
# columns' squares are.
_LEAST_SQUARE, _SINGULAR = 1e-20, 1e-10


class Groups:
    """Groups of columns, ``sizes`` of them each, one after the other: ``slices``.

    Products of each group's columns with each other, *grams*, are held by size, (groups of that size, size, size): what
    follows is done for all groups of a size at once.
    """

    def __init__(self, sizes: Sequence[int]) -> None:
        self.sizes = list(sizes)
        ends = np.cumsum([0, *self.sizes])
        squares = np.cumsum([0, *(s * s for s in self.sizes)])
        self.slices = [slice(a, b) for a, b in pairwise(ends.tolist())]
        self._members: list[tuple[NDArray[np.intp], NDArray[np.intp]]] = []  # groups, and their columns
        self._squares: list[NDArray[np.intp]] = []
        for size in sorted(set(self.sizes)):
            which = np.flatnonzero(np.array(self.sizes) == size)
            self._members.append((which, ends[which, None] + np.arange(size)))
            self._squares.append((squares[which, None] + np.arange(size * size)).reshape(-1, size, size))

    def grams(self, squares: _Array) -> _Grams:
        """Return the grams from products one after the other."""
        return [squares[at] for at in self._squares]

    def put(self, grams: _Grams, group: int, gram: _Array) -> None:
        """Another one of a group."""
        for (which, _), own in zip(self._members, grams, strict=True):
            at = np.flatnonzero(which == group)
            if at.size:
                own[at[0]] = gram

    def squares(self, grams: _Grams) -> _Array:
        """Return the squares (k,) of the columns."""
        out = np.empty(sum(self.sizes))
        for (_, columns), gram in zip(self._members, grams, strict=True):
            out[columns] = np.diagonal(gram, axis1=1, axis2=2)
        return out

    def without(self, grams: _Grams, along: _Array) -> _Grams:
        """Return the grams of what is left of the columns beside orthonormal vectors, along which they have parts (k,
        m)."""
        parts = [along[columns] for _, columns in self._members]
        return [gram - p @ p.transpose(0, 2, 1) for gram, p in zip(grams, parts, strict=True)]

    def solved(self, grams: _Grams, parts: _Array) -> tuple[_Array, _Array]:
        """Least squares with each group's columns alone, from their products with what is to be explained (k,).

        (groups,) sums of squares that they explain, and (k,) coefficients.
        """
        explained, coefficients = np.empty(len(self.sizes)), np.empty(parts.size)
        for (which, columns), gram in zip(self._members, grams, strict=True):
            root = _root(gram)
            c = root.transpose(0, 2, 1) @ parts[columns][..., None]
            explained[which] = np.sum(c**2, axis=(1, 2))
            coefficients[columns] = (root @ c)[..., 0]
        return explained, coefficients

    def cosines(self, grams: _Grams, along: _Array) -> _Array:
        """Return (groups,) cosines of the angles between groups and a space, along whose orthonormal basis the columns
        have parts (k, m): how far the smaller lies within the other."""
        out = np.empty(len(self.sizes))
        for (which, columns), gram in zip(self._members, grams, strict=True):
            inner = _root(gram).transpose(0, 2, 1) @ along[columns]
            out[which] = np.linalg.svd(inner, compute_uv=False).min(axis=1)
        return out


def _root(gram: _Array) -> _Array:
    """Return a matrix (..., n, n) such that columns times it are orthonormal, or nothing where they are rounding."""
    squares = np.diagonal(gram, axis1=1, axis2=2)
    unit = np.where(squares > _LEAST_SQUARE, 1.0 / np.sqrt(np.maximum(squares, _LEAST_SQUARE)), 0.0)
    values, vectors = np.linalg.eigh(gram * unit[:, :, None] * unit[:, None, :])
    inverse = np.where(values > _SINGULAR, 1.0 / np.sqrt(np.maximum(values, _SINGULAR)), 0.0)
    return np.asarray(unit[:, :, None] * vectors * inverse[:, None, :])


# Candidates of whose effect on the outputs only this part is their own are hardly distinguishable from parameters.
CONFOUNDED, NEARLY = 0.003, 0.05
# Terms that are taken out before the noise is modelled for ranking.
_GREEDY = 3
# Filters whose statistics are kept.
_KEPT = 8
# Of an effect what the parameters leave, if it is less than this part, is rounding.
_ROUNDING = 1e-10
# Where tangents imitate all but this of a column's square, what is left is not found by subtraction.
_CANCELLED = 1e-5
# Columns that are worked on together: they stay in the cache.
_AT_ONCE = 32


@dataclass(frozen=True, eq=False)
class Statistics:
    """For each effect (a candidate at a shape), seen through a filter:

    values      twice the gain in log-likelihood, to first order.
    amplitudes  one-step estimates of its coefficients.
    seen        the fit through the filter.
    parts       (all columns,) of what is left of columns beside the tangents, products with what is left of residuals.
    grams       products with each other within an effect, as `Groups` holds them.
    """

    values: _Array
    amplitudes: Sequence[_Array]
    seen: Whitened
    parts: _Array
    grams: list[_Array]


class Scan:
    """The effects of candidates on the outputs of a fit.

    effects   candidate and shape; several for a candidate with shapes.
    distinct  for each, the part of its effect that the parameters there cannot imitate.
    lost      names of candidates without such a part.
    """

    def __init__(self, linear: Linearised, candidates: Sequence[Candidate]) -> None:
        self.linear = linear
        effects = [(c, shape) for c in candidates for shape in c.shapes]
        self.white = Whitened(linear, white_noise(linear))
        columns, parameters, groups = linear.columns(effects)
        # Coefficients have units: with that of length 1, in units of the noise, none is lost for the user's choice.
        units = 1.0 / self._lengths(columns)
        columns *= units[:, None]
        parameters *= units[:, None]
        along = self._without_tangents(columns)
        # What initial states alone cannot imitate, of the tangents and of how parameters took part.
        tangents, each = self.white.basis.T, np.eye(parameters.shape[1])
        rest = linear.without_states(
            np.pad(tangents, ((0, len(each)), (0, 0))), np.pad(each, ((len(tangents), 0), (0, 0)))
        )
        imitated = np.hstack([along, parameters]) @ np.asarray(np.linalg.qr(rest.T, mode="r")).T
        scale = linear.scale()
        sizes = [np.sum((columns[g] / scale) ** 2) for g in groups]
        own = np.sqrt(sizes)
        whole = np.sqrt([s + np.sum(imitated[g] ** 2) for s, g in zip(sizes, groups, strict=True)])
        distinct = own / np.maximum(whole, 1e-300)
        kept = np.flatnonzero((distinct > CONFOUNDED) & (own > _ROUNDING))
        self.effects: list[tuple[Candidate, Mapping[str, float]]] = [effects[i] for i in kept]
        self.groups = Groups([groups[i].stop - groups[i].start for i in kept])
        for to, i in zip(self.groups.slices, kept, strict=True):
            columns[to] = columns[groups[i]]
        self._columns: _Array | None = columns[: sum(self.groups.sizes)]
        self._units = np.concatenate([np.zeros(0), *(units[groups[i]] for i in kept)])
        self.distinct = distinct[kept]
        there = {c.name for c, _ in self.effects}
        self.lost = tuple(dict.fromkeys(c.name for c in candidates if c.name not in there))
        self._clean: Whitening | None = None
        self._last: list[tuple[Filter, Statistics]] = []
        self._shares: dict[str, float] = {}

    @property
    def columns(self) -> _Array:
        """(all columns, n_rows) the effects, without what tangents can imitate if the noise is white."""
        if self._columns is None:
            self._columns, _, _ = self.linear.columns(self.effects)
            self._columns *= self._units[:, None]
            self._without_tangents(self._columns)
        return self._columns

    def _lengths(self, columns: _Array) -> _Array:
        """Return lengths (k,) of columns in units of the noise; 1 of those that are zero."""
        scale = self.linear.scale()
        lengths = np.array([np.linalg.norm(column / scale) for column in columns])
        return np.where((lengths > 0) & np.isfinite(lengths), lengths, 1.0)

    def _without_tangents(self, columns: _Array) -> _Array:
        """Take out of columns what tangents can imitate, and return that: (k, tangents) along the white basis."""
        scale, basis = self.linear.scale()[:, None], self.white.basis
        taken, put = basis / scale, (basis * scale).T
        along = np.empty((columns.shape[0], basis.shape[1]))
        for k in range(0, columns.shape[0], _AT_ONCE):
            block = columns[k : k + _AT_ONCE]
            along[k : k + _AT_ONCE] = block @ taken
            block -= along[k : k + _AT_ONCE] @ put
        return along

    def share(self, name: str) -> float:
        """Return the part of the residuals' power, taken as white, that a candidate explains to first order at its best
        shape; 0 of one that has no effect of its own."""
        if not self._shares:
            values = self.through(self.white.filter).values / max(self.linear.n_rows, 1)
            for (candidate, _), value in zip(self.effects, values.tolist(), strict=True):
                self._shares[candidate.name] = max(value, self._shares.get(candidate.name, 0.0))
        return self._shares.get(name, 0.0)

    @property
    def size(self) -> int:
        """Number of numbers in the columns; 0 where these were dropped."""
        return 0 if self._columns is None else self._columns.size

    def forget(self) -> None:
        """Drop columns and derivatives that take much space: they can be made again."""
        self._columns = None
        self.linear.forget()

    def through(self, filter: Filter) -> Statistics:
        """Statistics through a filter; those of the last few filters are kept."""
        for known, statistics in self._last:
            if known is filter:
                return statistics
        check_time()
        seen = self.white if filter is self.white.filter else Whitened(self.linear, filter.on(self.linear.structure))
        statistics = self._statistics(seen)
        self._last = [(filter, statistics), *self._last[: _KEPT - 1]]
        return statistics

    def _along(self, seen: Whitened, vectors: _Array) -> tuple[_Array, _Array]:
        assert isinstance(seen.filter, Whitening)  # channel by channel
        return seen.filter.products(self.columns, vectors, self.groups.sizes)

    def _statistics(self, seen: Whitened) -> Statistics:
        errors, groups = seen.errors, self.groups
        # The filter may be that of other residuals: what is left here is not less certain than its variance.
        variance = min(float(errors @ errors) / max(errors.size - seen.basis.shape[1], 1), 1.0)
        along, squares = self._along(seen, np.vstack([errors, seen.basis.T]))
        parts, whole = along[:, 0].copy(), groups.grams(squares)
        grams = groups.without(whole, along[:, 1:])
        cancelled = groups.squares(grams) < _CANCELLED * groups.squares(whole)
        for i in [i for i, g in enumerate(groups.slices) if cancelled[g].any()]:
            beside = self._beside(seen, i)
            parts[groups.slices[i]] = beside @ errors
            groups.put(grams, i, beside @ beside.T)
        explained, amplitudes = groups.solved(grams, parts)
        amplitudes *= self._units
        return Statistics(explained / variance, [amplitudes[g] for g in groups.slices], seen, parts, grams)

    def _beside(self, seen: Whitened, effect: int) -> _Array:
        return seen.beside(self.columns[self.groups.slices[effect]])

    def basis(self, statistics: Statistics, effect: int) -> _Array:
        """Return an orthonormal basis (n_rows, k) of an effect's columns, whitened, without what tangents can
        imitate."""
        columns = self._beside(statistics.seen, effect).T
        if columns.shape[1] == 1:
            return np.asarray(columns / max(float(np.linalg.norm(columns)), 1e-300))
        return np.asarray(np.linalg.qr(columns)[0])

    def cosines(self, statistics: Statistics, basis: _Array) -> _Array:
        """Return the cosines (effects,) of the angles between all effects and that of a basis: the smaller within the
        other."""
        return self.groups.cosines(statistics.grams, self._along(statistics.seen, basis.T)[0])

    def clean(self) -> Whitening:
        """Return the filter of the residuals without the few terms that explain most of them, taken as white.

        Slow effects hide in a noise model that was made with them.
        """
        if self._clean is None:
            _, errors = self._greedy(self.through(self.white.filter), _GREEDY)
            own = self.white.residuals + self.linear.scale() * (errors - self.white.errors)
            self._clean = Whitening.of(own, self.linear.structure)
        return self._clean

    def different(self, statistics: Statistics, count: int) -> list[int]:
        """Return the effect that explains most, the one that explains most of what is left, and so on."""
        return self._greedy(statistics, count)[0]

    def _greedy(self, statistics: Statistics, count: int) -> tuple[list[int], _Array]:
        """Take out of the errors what explains most of them, one effect after the other; return which, and what is
        left."""
        errors, parts, grams = statistics.seen.errors.copy(), statistics.parts, statistics.grams
        taken: list[int] = []
        found = np.empty((errors.size, 0))
        for number in range(min(count, len(self.effects))):
            taken.append(int(np.argmax(self.groups.solved(grams, parts)[0])))
            best = self._beside(statistics.seen, taken[-1]).T
            new = np.linalg.qr(best - found @ (found.T @ best))[0]
            found, inner = np.hstack([found, new]), new.T @ errors
            errors -= new @ inner
            if number + 1 < count:
                along, _ = self._along(statistics.seen, new.T)
                parts, grams = parts - along @ inner, self.groups.without(grams, along)
        return taken, errors


def white_noise(linear: Linearised) -> Whitening:
    """Return the noise as the fit has it: white."""
    channels = [Autoregression((np.empty(0),), np.array([sigma**2])) for sigma in linear.sigmas]
    return Whitening(channels, linear.structure)
