"""The eigenvalues of a linear system, and C, in numbers that pass smoothly from a pair to two real ones."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .modal_regression import Regression
from .modal_response import Answers

__all__ = ["Blocks"]

_Array: TypeAlias = NDArray[np.float64]
_Complex: TypeAlias = NDArray[np.complex128]

# Eigenvalues of a block are held apart by the root of this part of their size, or responses would lose their digits.
_APART = 1e-9


@dataclass(frozen=True, eq=False)
class Blocks:
    """A = diag of companion blocks [[0, 1], [-b, -a]] with eigenvalues of s^2 + a s + b, and of single real ones.

    pairs (k, 2): a in 1/s and b in 1/s^2; singles (l,), 1/s; C (p, 2 k + l) in ``units`` (p,) of the outputs. With one
    output C is (1, 0) of a pair and 1 of a single: what it would say, B says.
    """

    pairs: _Array
    singles: _Array
    C: _Array
    units: _Array

    @classmethod
    def of(cls, values: _Complex, C: _Complex, units: _Array) -> Blocks:
        """From eigenvalues (r,), of a complex pair one, and the columns of C (p, r); real ones go in pairs too."""
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
        """Eigenvalues (r,), of a complex pair one; their columns of C (p, r); and the block of each (r,)."""
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

    def without(self, k: int) -> Blocks:
        """All blocks but one."""
        n = len(self.pairs)
        if k < n:
            C = np.delete(self.C, [2 * k, 2 * k + 1], 1)
            return replace(self, pairs=np.delete(self.pairs, k, 0), C=C)
        return replace(self, singles=np.delete(self.singles, k - n), C=np.delete(self.C, n + k, 1))

    def joined(self, other: Blocks) -> Blocks:
        """These blocks and others."""
        n, m = 2 * len(self.pairs), 2 * len(other.pairs)
        C = np.hstack([self.C[:, :n], other.C[:, :m], self.C[:, n:], other.C[:, m:]])
        pairs, singles = np.vstack([self.pairs, other.pairs]), np.append(self.singles, other.singles)
        return replace(self, pairs=pairs, singles=singles, C=C)

    @property
    def sizes(self) -> _Array:
        """By how much each number may move, about: the scales of `moved`."""
        b = np.maximum(np.abs(self.pairs[:, 1]), 0.25 * self.pairs[:, 0] ** 2)
        own = [np.column_stack([np.sqrt(b), b]).ravel(), np.abs(self.singles)]
        if self.C.shape[0] > 1:
            own.append(np.broadcast_to(np.abs(self.C).max(axis=0), self.C.shape).ravel())
        found = np.concatenate(own)
        return np.where(found > 0.0, found, 1.0)

    def moved(self, step: _Array) -> Blocks:
        """With a step of pairs, singles and (of several outputs) C added."""
        n, m = self.pairs.size, self.singles.size
        C = self.C + step[n + m :].reshape(self.C.shape) if self.C.shape[0] > 1 else self.C
        return replace(self, pairs=self.pairs + step[:n].reshape(-1, 2), singles=self.singles + step[n : n + m], C=C)

    def reflected(self) -> Blocks:
        """With modes that decay in place of those that grow."""
        return replace(self, pairs=np.abs(self.pairs), singles=-np.abs(self.singles))

    def slopes(self, answers: Answers, found: Regression) -> Iterator[tuple[list[int], _Array]]:
        """Of each output the derivatives (k, N) of its path in an experiment, B and first states held, and by which
        numbers of `moved` they are."""
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
                # value' = -(value a' + b') / (2 value + a), and what the output sees of the mode moves with it.
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
