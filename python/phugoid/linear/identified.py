"""A state space in real blocks from eigenvalues and what a regression found of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from .modal_regression import Regression
from .sampled import Sampled
from .state_space import StateSpace

__all__ = ["identified"]

_Array: TypeAlias = NDArray[np.float64]
_Complex: TypeAlias = NDArray[np.complex128]


def identified(records: Sampled, values: _Complex, C: _Complex, found: Regression, **more: Any) -> StateSpace:
    """The system with these eigenvalues (r,), of pairs one, and C (p, r) of them; ``more`` as `StateSpace` takes it."""
    A, B, C_real, states = _real(values, C, found.B)
    return StateSpace(
        A=A,
        B=B,
        C=C_real,
        D=found.D,
        inputs=tuple(records.inputs),
        outputs=tuple(records.outputs),
        x0={name: states(x) for name, x in found.x0.items()},
        offsets=found.offsets,
        rate=records.rate,
        residual_rms=dict(zip(records.outputs, found.rms.tolist(), strict=True)),
        **more,
    )


def _real(values: _Complex, c: _Complex, b: _Complex) -> tuple[_Array, _Array, _Array, Callable[[_Complex], _Array]]:
    """A, B and C in real blocks, of a pair [[sigma, omega], [-omega, sigma]]; and what makes such states of modal ones.

    With xi = x_a - j x_b, xi' = (sigma + j omega) xi and Re(c xi) = Re(c) x_a + Im(c) x_b.
    """
    place, width = [], 0
    for value in values:
        place.append(width)
        width += 2 if value.imag != 0.0 else 1
    A, C = np.zeros((width, width)), np.zeros((c.shape[0], width))
    for k, value, seen in zip(place, values, c.T, strict=True):
        A[k, k] = value.real
        C[:, k] = seen.real
        if value.imag != 0.0:
            A[k : k + 2, k : k + 2] = [[value.real, value.imag], [-value.imag, value.real]]
            C[:, k + 1] = seen.imag

    def states(xi: _Complex) -> _Array:
        x = np.zeros((width, *xi.shape[1:]))
        for k, value, each in zip(place, values, xi, strict=True):
            x[k] = each.real
            if value.imag != 0.0:
                x[k + 1] = -each.imag
        return x

    return A, states(b), C, states
