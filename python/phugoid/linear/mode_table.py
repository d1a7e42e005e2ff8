"""The modes of a linear system: frequencies, damping ratios and time constants, with standard errors where known."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import overload

import numpy as np
from numpy.typing import NDArray

from ..parameters import Estimate, plus_minus, text_table

__all__ = ["Mode", "Modes", "table_of"]

# An eigenvalue this near the real axis, beside its size, is real: a pair would be twice as far apart as rounding makes
# it.
_REAL = 1e-12


@dataclass(frozen=True)
class Mode:
    """One real eigenvalue, or a complex pair by the eigenvalue with the positive imaginary part.

    eigenvalue     lambda, 1/s.
    frequency      |lambda| / 2 pi in Hz: the natural frequency, which is not the damped one, |Im lambda| / 2 pi.
    damping        damping ratio -Re(lambda) / |lambda|; 1 or -1 for a real eigenvalue, NaN for one at zero.
    time_constant  -1 / Re(lambda) in s: of the decay, or for a pair of its envelope; negative where it grows.

    Each is an `Estimate`: ``float(mode.frequency)``, ``mode.frequency.std_error`` (NaN where it is not known).
    """

    eigenvalue: complex
    frequency: Estimate
    damping: Estimate
    time_constant: Estimate

    @property
    def oscillates(self) -> bool:
        """Whether it is a complex pair."""
        return self.eigenvalue.imag != 0.0

    @property
    def stable(self) -> bool:
        """Whether it decays."""
        return self.eigenvalue.real < 0.0


@dataclass(frozen=True, repr=False)
class Modes(Sequence[Mode]):
    """Modes in the order of their natural frequencies; printed, a table.

    >>> print(table_of(np.array([-0.1 + 2j, -0.1 - 2j, -0.5])))
    frequency, Hz  damping ratio  time constant, s  eigenvalue, 1/s
    -------------  -------------  ----------------  ---------------
                                  2                            -0.5
    0.318708       0.0499376      10                      -0.1 ± 2j
    """

    modes: tuple[Mode, ...]

    @property
    def eigenvalues(self) -> NDArray[np.complex128]:
        """One a mode, 1/s: of a pair the one with the positive imaginary part."""
        return np.array([m.eigenvalue for m in self.modes], dtype=np.complex128)

    @property
    def frequencies_hz(self) -> NDArray[np.float64]:
        """Natural frequencies, Hz."""
        return np.array([m.frequency.value for m in self.modes])

    @property
    def damping_ratios(self) -> NDArray[np.float64]:
        """Damping ratios."""
        return np.array([m.damping.value for m in self.modes])

    @overload
    def __getitem__(self, i: int) -> Mode: ...
    @overload
    def __getitem__(self, i: slice) -> tuple[Mode, ...]: ...
    def __getitem__(self, i: int | slice) -> Mode | tuple[Mode, ...]:
        return self.modes[i]

    def __len__(self) -> int:
        return len(self.modes)

    def __iter__(self) -> Iterator[Mode]:
        return iter(self.modes)

    def summary(self) -> str:
        """Return a table: natural frequency, damping ratio, time constant and eigenvalue of each mode."""
        rows = [
            [
                _cell(m.frequency) if m.oscillates else "",
                _cell(m.damping) if m.oscillates else "",
                _cell(m.time_constant),
                f"{m.eigenvalue.real:.6g}" + (f" ± {m.eigenvalue.imag:.6g}j" if m.oscillates else ""),
            ]
            for m in self.modes
        ]
        return text_table(["frequency, Hz", "damping ratio", "time constant, s", "eigenvalue, 1/s"], rows, "lllr")

    def __str__(self) -> str:
        return self.summary()

    def __repr__(self) -> str:
        pairs = sum(m.oscillates for m in self.modes)
        return f"<Modes: {pairs} oscillating, {len(self.modes) - pairs} not>"


def table_of(eigenvalues: NDArray[np.complex128], covariances: NDArray[np.float64] | None = None) -> Modes:
    """Return the table of all eigenvalues (n,) of a real matrix, 1/s.

    ``covariances`` (n, 2, 2): of real and imaginary part of each; NaN where it is not known.
    """
    found = []
    for k, value in enumerate(np.asarray(eigenvalues, dtype=np.complex128)):
        eigenvalue = complex(value)
        if abs(eigenvalue.imag) <= _REAL * abs(eigenvalue):
            eigenvalue = complex(eigenvalue.real)
        if eigenvalue.imag >= 0.0:
            found.append(_mode(eigenvalue, np.full((2, 2), np.nan) if covariances is None else covariances[k]))
    return Modes(tuple(sorted(found, key=lambda m: (abs(m.eigenvalue), m.eigenvalue.real))))


def _mode(eigenvalue: complex, covariance: NDArray[np.float64]) -> Mode:
    """Return a mode with standard errors by the delta method."""
    size, (re, im) = abs(eigenvalue), (eigenvalue.real, eigenvalue.imag)
    if im == 0.0:  # real for small changes of the parameters too
        covariance = covariance * np.array([[1.0, 0.0], [0.0, 0.0]]) if np.isfinite(covariance).all() else covariance

    def error(slope: tuple[float, float]) -> float:
        d = np.array(slope)
        return float(np.sqrt(d @ covariance @ d))

    nan = math.nan
    frequency = Estimate(
        "frequency",
        size / (2.0 * math.pi),
        error((re / size / (2.0 * math.pi), im / size / (2.0 * math.pi))) if size else nan,
        "Hz",
    )
    ratio = 0.0 - re / size if size else nan  # 0, not -0, of a mode without damping
    damping = Estimate("damping ratio", ratio, error((-(im**2) / size**3, re * im / size**3)) if im else nan)
    constant = -1.0 / re if re else math.inf
    time_constant = Estimate("time constant", constant, error((1.0 / re**2, 0.0)) if re else nan, "s")
    return Mode(eigenvalue, frequency, damping, time_constant)


def _cell(e: Estimate) -> str:
    return plus_minus(e.value, e.std_error or math.nan)  # a parameter at a bound has no error
