"""Outputs that are there twice: the same measurement under two names, or in two units."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .records import Record

__all__ = ["repeated_outputs"]

_Array = NDArray[np.float64]

# Correlation of residuals from which on one output tells nothing that the other does not: digits are rounded.
_SAME = 0.999
# Outputs that differ by less than this part of their residuals, once one is scaled to the other, are copies with slight
# noise of their own.
_OWN = 0.2
_FEWEST = 10  # samples that both have
_EXACT = 1e-9  # of an output's spread: a residual below it is rounding


def repeated_outputs(records: Sequence[Record], outputs: Sequence[str]) -> list[str]:
    """Return a warning for each group of outputs whose residuals are proportional to each other.

    Residuals are compared, not measurements alone: two outputs that move alike tell more than one as long as their
    noise is their own. With process noise they are the innovations, which two sensors of a state that was wrongly
    predicted may share: there, only proportional ones are reported.
    """
    residuals = {name: [_centred(r.innovations.get(name, r.residuals[name])) for r in records] for name in outputs}
    measured = {name: [_centred(r.measured[name]) for r in records] for name in outputs}
    known = [name for name in outputs if _size(residuals[name]) > _EXACT * _size(measured[name])]

    def alike(one: str, other: str) -> bool:
        copies = not any(r.innovations for r in records) and _copies(
            (residuals[one], measured[one]), (residuals[other], measured[other])
        )
        return copies or _alike(residuals[one], residuals[other])

    groups: list[list[str]] = []
    for name in known:
        mine = next((g for g in groups if any(alike(name, other) for other in g)), None)
        if mine is None:
            groups.append([name])
        else:
            mine.append(name)
    found = []
    for group in (g for g in groups if len(g) > 1):
        listed = f"{', '.join(group[:-1])} and {group[-1]}"
        found.append(
            f"outputs {listed} hold the same measurement: their residuals are proportional, but for little. "
            f"Each counts as if its noise were its own, and so standard errors are too small, by √{len(group)} where "
            f"nothing else is measured: leave {'one' if len(group) == 2 else 'all but one'} out of the outputs"
        )
    return found


def _centred(values: _Array) -> _Array:
    there = np.isfinite(values)
    return np.asarray(values - values[there].mean()) if there.any() else values


def _size(each: Sequence[_Array]) -> float:
    return float(np.sqrt(sum(np.nansum(v**2) for v in each)))


_Pair = tuple[Sequence[_Array], Sequence[_Array]]  # residuals and measurements


def _copies(one: _Pair, other: _Pair) -> bool:
    """Whether one output is the other, scaled, but for noise that is slight beside the residuals."""
    (a, b), (za, zb) = (([np.concatenate(each) for each in pair]) for pair in zip(one, other, strict=True))
    both = np.isfinite(a) & np.isfinite(b)
    if both.sum() < _FEWEST or not _size([za[both]]) > 0.0:
        return False
    a, b, za, zb = a[both], b[both], za[both], zb[both]
    scale = (za @ zb) / (za @ za)
    size = _OWN * np.std(b)
    return bool(np.std(zb - scale * za) < size and np.std(b - scale * a) < size)


def _alike(one: Sequence[_Array], other: Sequence[_Array]) -> bool:
    a, b = np.concatenate(one), np.concatenate(other)
    both = np.isfinite(a) & np.isfinite(b)
    if both.sum() < _FEWEST:
        return False
    a, b = a[both], b[both]
    return bool(abs(a @ b) > _SAME * np.linalg.norm(a) * np.linalg.norm(b))
