"""Detection of duplicated outputs: the same measurement under two names, or in two units."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from .records import Record

__all__ = ["repeated_outputs"]

_Array = NDArray[np.float64]

# Correlation of residuals from which on one output has no information beyond the other: digits are rounded.
_SAME = 0.999
# Outputs that differ by less than this part of their residuals, once one is scaled to the other, are copies with slight
# noise of their own.
_OWN = 0.2
_FEWEST = 10  # samples that both have
_EXACT = 1e-9  # part of an output's spread: smaller residuals are rounding errors


def repeated_outputs(records: Sequence[Record], outputs: Sequence[str]) -> list[str]:
    """Return a warning for each group of outputs whose residuals are proportional to each other.

    Residuals are compared, not measurements alone: two outputs that move alike have more information than one as long
    as their noise is their own. With process noise they are the innovations, which two sensors of a state that was
    wrongly predicted may share: there, only proportional ones are reported.
    """
    residuals = {name: _joined(r.innovations.get(name, r.residuals[name]) for r in records) for name in outputs}
    measured = {name: _joined(r.measured[name] for r in records) for name in outputs}
    known = [name for name in outputs if _size(residuals[name]) > _EXACT * _size(measured[name])]
    innovations = any(r.innovations for r in records)

    def alike(one: str, other: str) -> bool:
        correlation = _correlation(residuals[one], residuals[other])
        # A copy with noise of its own has correlated residuals as well, though less closely.
        if innovations or correlation < 1 - 2 * _OWN**2:
            return correlation > _SAME
        copies = _copies((residuals[one], measured[one]), (residuals[other], measured[other]))
        return copies or correlation > _SAME

    groups: list[list[str]] = []
    for name in known:
        group = next((g for g in groups if any(alike(name, other) for other in g)), None)
        if group is None:
            groups.append([name])
        else:
            group.append(name)
    found = []
    for members in (g for g in groups if len(g) > 1):
        listed = f"{', '.join(members[:-1])} and {members[-1]}"
        found.append(
            f"outputs {listed} hold the same measurement: their residuals are nearly proportional. "
            f"Each counts as if its noise were its own, and so standard errors are too small, by √{len(members)} where "
            f"nothing else is measured: leave {'one' if len(members) == 2 else 'all but one'} out of the outputs"
        )
    return found


def _centred(values: _Array) -> _Array:
    there = np.isfinite(values)
    return np.asarray(values - values[there].mean()) if there.any() else values


def _joined(parts: Iterable[_Array]) -> _Array:
    """Return the values of all records, each about its mean."""
    return np.concatenate([_centred(part) for part in parts])


def _size(values: _Array) -> float:
    return float(np.sqrt(np.nansum(values**2)))


def _correlation(one: _Array, other: _Array) -> float:
    """Return the absolute value of the correlation; 0 with too few samples."""
    both = np.isfinite(one) & np.isfinite(other)
    if both.sum() < _FEWEST:
        return 0.0
    a, b = one[both], other[both]
    product = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(abs(a @ b)) / product if product > 0.0 else 0.0


_Pair = tuple[_Array, _Array]  # residuals and measurements


def _copies(one: _Pair, other: _Pair) -> bool:
    """Return whether one output is a scaled copy of the other, but for noise that is small beside the residuals."""
    both = np.isfinite(one[0]) & np.isfinite(other[0])
    (a, za), (b, zb) = ([values[both] for values in pair] for pair in (one, other))
    if not _size(za) > 0.0:
        return False
    scale = (za @ zb) / (za @ za)
    size = _OWN * np.std(b)
    return bool(np.std(zb - scale * za) < size and np.std(b - scale * a) < size)
