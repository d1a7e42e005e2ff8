"""Observer canonical forms: of each output a chain of states, which are its derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..errors import ModelError

__all__ = ["chains", "observer_form"]

_Array: TypeAlias = NDArray[np.float64]

# Beyond this condition of the transformation the form is taken not to hold the system.
_SINGULAR = 1e12


def lengths(n: int, p: int) -> list[int]:
    """Lengths of the chains: n states for p outputs, as equal as can be. Almost any system has this form."""
    return [n // p + (j < n % p) for j in range(p)]


def chains(n: int, p: int, rate: float) -> tuple[_Array, _Array]:
    """A (n, n) and C (p, n) of the form, NaN where an element is free.

    Within the chain of output j (s_j states, x_0 = y_j) x_k' = rate x_k+1, and the last row of each is free. An output
    without a chain has a free row of C. (J. M. Maciejowski, Multivariable Feedback Design, 1989, sec. 8.3.)
    """
    A, C = np.zeros((n, n)), np.zeros((p, n))
    first = 0
    for j, length in enumerate(lengths(n, p)):
        if length:
            C[j, first] = 1.0
            A[range(first, first + length - 1), range(first + 1, first + length)] = rate
            A[first + length - 1] = np.nan
        else:
            C[j] = np.nan
        first += length
    return A, C


def observer_form(
    A: _Array, B: _Array, C: _Array, rate: float, names: Sequence[str], kind: str
) -> tuple[_Array, _Array, _Array]:
    """A system in the coordinates c_j A^k x / rate^k of the chains. ModelError where these do not span the states."""
    rows = []
    for j, length in enumerate(lengths(A.shape[0], C.shape[0])):
        row = C[j]
        for _ in range(length):
            rows.append(row)
            row = row @ A / rate
    T = np.array(rows)
    # The sizes of the coordinates are no matter.
    size = np.linalg.norm(T, axis=1, keepdims=True)
    if not size.all() or not np.linalg.cond(T / size) < _SINGULAR:
        seen, share = ("seen in", "an output") if kind == "output" else ("moved by", "an input")
        raise ModelError(
            f"state_space: start has states that are not {seen} {', '.join(names)} as its canonical form needs, with "
            f"as many states for each {kind} (or {share} stands for another): take structure='full', or modal"
        )
    back = np.linalg.inv(T)
    return T @ A @ back, T @ B, C @ back
