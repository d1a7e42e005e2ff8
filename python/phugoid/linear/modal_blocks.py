"""The eigenvalues of a linear system, and C, in parameters in which a complex pair passes smoothly into two
real ones."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..solvers import check_time
from .modal_regression import ModalRegression, rows
from .sampled import Answers, Sampled, triangle

__all__ = ["ModalBlocks", "best_places"]

_Array: TypeAlias = NDArray[np.float64]
_Complex: TypeAlias = NDArray[np.complex128]

# Eigenvalues of a block are held apart by the root of this part of their size, or responses would lose their digits.
_APART = 1e-9


@dataclass(frozen=True, eq=False)
class ModalBlocks:
    """A = diag of companion blocks [[0, 1], [-b, -a]] with eigenvalues of s^2 + a s + b, and of single real ones.

    pairs (k, 2): a in 1/s and b in 1/s^2; singles (l,), 1/s; C (p, 2 k + l) in ``units`` (p,) of the outputs. With one
    output C is (1, 0) of a pair and 1 of a single: what it would say, B says.
    """

    pairs: _Array
    singles: _Array
    C: _Array
    units: _Array

    @classmethod
    def of(cls, values: _Complex, C: _Complex, units: _Array) -> ModalBlocks:
        """Return the blocks of eigenvalues (r,), one of each complex pair, and the columns of C (p, r); real ones are
        paired too."""
        C = C / units[:, None]
        # B is free, so that the size (and of a pair the phase) of a column of C does not matter.
        largest = C[np.argmax(np.abs(C), axis=0), np.arange(values.size)]
        C = C / np.where(largest == 0.0, 1.0, largest)
        pairs, columns = [], []
        for value, c in zip(values, C.T, strict=True):
            if value.imag != 0.0:
                pairs.append((-2.0 * value.real, abs(value) ** 2))
                slope = c.imag / value.imag
                columns += [c.real - value.real * slope, slope]
        reals = sorted((value.real, k) for k, value in enumerate(values) if value.imag == 0.0)
        singles = []
        while len(reals) > 1:
            (one, i), (two, k) = reals.pop(), reals.pop()
            pairs.append((-(one + two), one * two))
            slope = (C[:, i] - C[:, k]).real / ((one - two) or 1.0)
            columns += [C[:, i].real - one * slope, slope]
        for value, k in reals:
            singles.append(value)
            columns.append(C[:, k].real)
        made = np.array(columns).T.reshape(C.shape[0], -1)
        if C.shape[0] == 1:
            made = np.array([[1.0, 0.0] * len(pairs) + [1.0] * len(singles)])
        return cls(np.array(pairs).reshape(-1, 2), np.array(singles), made, units)

    def modal(self) -> tuple[_Complex, _Complex, NDArray[np.intp]]:
        """Return eigenvalues (r,), one of each complex pair; their columns of C (p, r); and the block of each (r,)."""
        values, owners = [], []
        for k, (a, b) in enumerate(self.pairs):
            d = 0.25 * a * a - b
            least = _APART * max(abs(b), 0.25 * a * a)
            d = d if abs(d) > least else np.copysign(least, d)
            if d < 0.0:
                values.append(complex(-0.5 * a, np.sqrt(-d)))
                owners.append(k)
            else:
                # The larger one first, without cancellation.
                far = -0.5 * a - np.copysign(np.sqrt(d), a)
                values += [complex(far), complex(b / far if far else 0.0)]
                owners += [k, k]
        values += [complex(value) for value in self.singles]
        owners += [len(self.pairs) + i for i in range(self.singles.size)]
        found, own = np.array(values, dtype=np.complex128), np.array(owners, dtype=np.intp)
        k = len(self.pairs)
        first = np.where(own < k, 2 * own, k + own)
        slope = np.where(own < k, self.C[:, np.minimum(first + 1, self.C.shape[1] - 1)], 0.0)
        return found, (self.C[:, first] + slope * found) * self.units[:, None], own

    def __len__(self) -> int:
        return len(self.pairs) + self.singles.size

    def without(self, k: int) -> ModalBlocks:
        """Return all blocks but block ``k``."""
        n = len(self.pairs)
        if k < n:
            C = np.delete(self.C, [2 * k, 2 * k + 1], 1)
            return replace(self, pairs=np.delete(self.pairs, k, 0), C=C)
        return replace(self, singles=np.delete(self.singles, k - n), C=np.delete(self.C, n + k, 1))

    def joined(self, other: ModalBlocks) -> ModalBlocks:
        """Return these blocks and those of another."""
        n, m = 2 * len(self.pairs), 2 * len(other.pairs)
        C = np.hstack([self.C[:, :n], other.C[:, :m], self.C[:, n:], other.C[:, m:]])
        pairs, singles = np.vstack([self.pairs, other.pairs]), np.append(self.singles, other.singles)
        return replace(self, pairs=pairs, singles=singles, C=C)

    @property
    def sizes(self) -> _Array:
        """Typical sizes of the numbers: the scales of `moved`."""
        b = np.maximum(np.abs(self.pairs[:, 1]), 0.25 * self.pairs[:, 0] ** 2)
        own = [np.column_stack([np.sqrt(b), b]).ravel(), np.abs(self.singles)]
        if self.C.shape[0] > 1:
            own.append(np.broadcast_to(np.abs(self.C).max(axis=0), self.C.shape).ravel())
        found = np.concatenate(own)
        return np.where(found > 0.0, found, 1.0)

    def moved(self, step: _Array) -> ModalBlocks:
        """Return the blocks with a step added to pairs, singles and (of several outputs) C."""
        n, m = self.pairs.size, self.singles.size
        C = self.C + step[n + m :].reshape(self.C.shape) if self.C.shape[0] > 1 else self.C
        return replace(self, pairs=self.pairs + step[:n].reshape(-1, 2), singles=self.singles + step[n : n + m], C=C)

    def reflected(self) -> ModalBlocks:
        """Return the blocks with growing modes reflected into decaying ones."""
        return replace(self, pairs=np.abs(self.pairs), singles=-np.abs(self.singles))

    def slopes(self, answers: Answers, found: ModalRegression) -> Iterator[tuple[list[int], _Array]]:
        """Yield for each output the derivatives (k, N) of its path in an experiment by the numbers of `moved`, with B
        and initial states fixed, and the indices of these numbers."""
        values, C, own = self.modal()
        run = answers.driven.run
        xi, eta = answers.slopes(found.B, found.motion[run.name])
        k, (p, n) = len(self.pairs), self.C.shape
        for j in range(p):
            rows, which = np.zeros((2 * k + self.singles.size, run.n)), list(range(2 * k + self.singles.size))
            for i, (value, block) in enumerate(zip(values, own, strict=True)):
                if block >= k:
                    rows[k + block] = (C[j, i] * eta[i]).real
                    continue
                # value' = -(value a' + b') / (2 value + a), and the column of C changes with it.
                c, slope = C[j, i], self.C[j, 2 * block + 1] * self.units[j]
                g = -(c * eta[i] + slope * xi[i]) / (2.0 * value + self.pairs[block, 0])
                rows[2 * block] += (value * g).real
                rows[2 * block + 1] += g.real
            if p > 1:
                seen = np.zeros((n, run.n))
                for i, (value, block) in enumerate(zip(values, own, strict=True)):
                    if block >= k:
                        seen[k + block] = xi[i].real
                        continue
                    seen[2 * block] += xi[i].real
                    seen[2 * block + 1] += (value * xi[i]).real
                rows = np.vstack([rows, self.units[j] * seen])
                which += [len(which) + j * n + i for i in range(n)]
            yield which, rows


# Natural frequencies tried, from this part of the lowest of the others to this multiple of the highest (but no higher
# than this part of the Nyquist frequency).
_BELOW, _ABOVE, _NYQUIST = 0.6, 1.3, 0.8
# Damping ratios, each with the ratio of frequencies that lie next to each other: a resonance must not fall between.
_DAMPING = ((0.01, 1.02), (0.03, 1.06), (0.1, 1.2), (0.6, 1.5))
# Places that differ by less than this part lead to the same optimum: only the better one is kept.
_DIFFERENT = 0.15
# Places whose responses are stored at once; relative size below which a direction is ignored.
_AT_ONCE, _RANK = 8, 1e-10


def best_places(
    records: Sampled, blocks: ModalBlocks, found: ModalRegression, direct: tuple[bool, ...], offset: bool
) -> list[ModalBlocks]:
    """Return candidate pairs, each a `ModalBlocks`, in the order of how much they would lower the weighted sum of
    squares.

    What the present modes can explain with another B, in each experiment and output by itself, is projected out of
    the outputs and of the response of each new mode; initial states of the new mode are left out. Of several outputs C
    of the new mode is the direction of the largest response.
    """
    places = _grid(records, blocks)
    m, p = len(records.inputs), len(records.outputs)
    # Normal equations of each place and output: two unknowns for each input.
    squares, sides = np.zeros((places.size, p, 2 * m, 2 * m)), np.zeros((places.size, p, 2 * m))
    weights = np.where(found.rms > 0.0, found.rms, 1.0) ** 2
    values, C, _ = blocks.modal()
    for driven in records.driven:
        answers = driven.answers(values)
        bases = []
        for j, name in enumerate(records.outputs):
            z = driven.run.output(name)
            q = _basis(np.vstack(list(rows(C[j], answers, direct[j], z, offset)))[:, :-1])
            there = np.isfinite(z)
            r = z[there] - q @ (q.T @ z[there])
            # Missing samples have no part in any product.
            whole = np.zeros((z.size, q.shape[1] + 1))
            whole[there] = np.column_stack([q, r])
            bases.append((there, whole))
        for a in range(0, places.size, _AT_ONCE):
            check_time()
            some = slice(a, min(a + _AT_ONCE, places.size))
            parts = np.empty((some.stop - a, m, 2, driven.run.n))
            for k, xi in enumerate(driven.forced(places[some])):
                parts[:, k, 0], parts[:, k, 1] = xi.real, -xi.imag
            every = parts.reshape(-1, driven.run.n)
            for j, (there, whole) in enumerate(bases):
                found_in = (every @ whole).reshape(-1, 2 * m, whole.shape[1])
                inside, new = found_in[:, :, :-1], parts.reshape(-1, 2 * m, driven.run.n)
                if not there.all():
                    new = new[:, :, there]
                squares[some, j] += (new @ new.swapaxes(1, 2) - inside @ inside.swapaxes(1, 2)) / weights[j]
                sides[some, j] += found_in[:, :, -1] / weights[j]
    gains = np.zeros(places.size)
    residues = np.zeros((places.size, p, m), dtype=np.complex128)
    for i in range(places.size):
        for j in range(p):
            b = np.linalg.lstsq(squares[i, j], sides[i, j], rcond=_RANK)[0]
            gains[i] += b @ sides[i, j]
            residues[i, j] = b[0::2] + 1j * b[1::2]
    chosen: list[int] = []
    for i in np.argsort(-gains):
        if all(abs(places[i] - places[k]) > _DIFFERENT * abs(places[k]) for k in chosen):
            chosen.append(int(i))
    return [_block(places[i], residues[i], blocks.units) for i in chosen]


def _basis(columns: _Array) -> _Array:
    """Return orthonormal columns of the same span."""
    size = np.linalg.norm(columns, axis=0)
    scaled = columns / np.where(size > 0.0, size, 1.0)
    _, s, Vt = np.linalg.svd(triangle([scaled.copy()]))
    kept = s > _RANK * s[0]
    # Rounding has grown by 1 / s: once more, of columns that are about orthonormal.
    q = scaled @ (Vt[kept].T / s[kept])
    return np.asarray(np.linalg.solve(triangle([q.copy()]).T, q.T).T)


def _grid(records: Sampled, blocks: ModalBlocks) -> _Complex:
    """Return the eigenvalues to try, 1/s."""
    nyquist = np.pi * records.rate
    size = np.abs(blocks.modal()[0])
    size = size[(size > 0.0) & (size < nyquist)]
    slowest = 2.0 * np.pi * records.rate / max(records.lengths)
    low = max(_BELOW * size.min(), slowest) if size.size else slowest
    high = min(_ABOVE * size.max(), _NYQUIST * nyquist) if size.size else _NYQUIST * nyquist
    low = min(low, 0.5 * high)
    found = []
    for z, ratio in _DAMPING:
        frequencies = np.geomspace(low, high, max(2, round(np.log(high / low) / np.log(ratio))))
        found += [w * (-z + 1j * np.sqrt(1.0 - z * z)) for w in frequencies]
    return np.array(found)


def _block(value: complex, residue: _Complex, units: _Array) -> ModalBlocks:
    """Return a pair with the C (p, 1) of the rank-one matrix nearest to the residue (p, m)."""
    left, _, _ = np.linalg.svd(residue / units[:, None])
    return ModalBlocks.of(np.array([value]), np.asarray(left[:, :1] * units[:, None], dtype=np.complex128), units)
