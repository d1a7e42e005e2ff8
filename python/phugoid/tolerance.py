"""Tolerances of outputs: an absolute deviation, or a part of the measurements, whichever is greater."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from .errors import OptionError, did_you_mean

__all__ = ["Tolerance", "tolerance_of", "tolerances_by_output"]

_Array: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True)
class Tolerance:
    """A tolerance as flight simulators are qualified with (14 CFR Part 60): "±3 kt, or ±5 %, whichever is greater".

    ``absolute``  greatest deviation, in the unit of the output; 0 for none.
    ``relative``  the same as a part of the measured value at each sample, 0.05 for 5 %; 0 for none. Where a standard
                  means a part of the greatest value, that is one number, and so absolute.

    A sample z may be off by ``max(absolute, relative * abs(z))``. Where tolerances are taken, a number is an absolute
    one. Raises OptionError where neither is positive, or ``relative`` is above 1.

    >>> Tolerance(absolute=1.5, relative=0.05).at(np.array([10.0, -60.0]))
    array([1.5, 3. ])
    """

    absolute: float = 0.0
    relative: float = 0.0

    def __post_init__(self) -> None:
        for name, value in (("absolute", self.absolute), ("relative", self.relative)):
            if not isinstance(value, Real) or isinstance(value, bool) or not 0.0 <= value < math.inf:
                raise OptionError(f"Tolerance: {name} is a number from 0, not {value!r}")
        if self.relative > 1.0:
            raise OptionError(
                f"Tolerance: relative is a part of the measured value, 0.05 for 5 %, not {self.relative!r}"
            )
        if not (self.absolute or self.relative):
            raise OptionError("Tolerance: give an absolute or a relative part above 0, or both")

    def at(self, measured: _Array) -> _Array:
        """Return the greatest allowed deviation of samples (N,); NaN where one is missing."""
        sizes = np.abs(np.asarray(measured, dtype=float))
        return np.asarray(np.where(np.isnan(sizes), np.nan, np.maximum(self.absolute, self.relative * sizes)))

    def text(self, unit: str = "") -> str:
        """Return a short text for tables and figures.

        >>> Tolerance(absolute=1.5, relative=0.05).text("m/s")
        '±1.5 m/s or ±5 %'
        """
        unit = "" if unit in ("1", "-") else unit
        parts = [f"±{self.absolute:.4g} {unit}".rstrip()] if self.absolute else []
        parts += [f"±{100.0 * self.relative:.4g} %"] if self.relative else []
        return " or ".join(parts)


def tolerance_of(whose: str, value: Any) -> Tolerance:
    """Return the tolerance given for one output; ``whose`` names it in errors."""
    if isinstance(value, Tolerance):
        return value
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise OptionError(f"{whose} must be a number, or a Tolerance(absolute, relative), not {value!r}") from None
    if not 0.0 < number < math.inf:
        raise OptionError(f"{whose} must be positive and finite, not {value!r}")
    return Tolerance(number)


def tolerances_by_output(caller: str, outputs: Sequence[str], given: Any) -> dict[str, Tolerance]:
    """Return the tolerances given to ``caller``, in the order of ``outputs``; {} for None.

    Raises OptionError for anything but a mapping, an unknown output, or an invalid tolerance.
    """
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        raise OptionError(f"{caller}: tolerances are given by output, such as {{'q': 0.035}}, not as {given!r}")
    limits = {}
    for name, value in given.items():
        if name not in outputs:
            hint = did_you_mean(str(name), outputs)
            raise OptionError(f"{caller}: tolerance of '{name}', which is not an output.{hint}")
        limits[name] = tolerance_of(f"{caller}: the tolerance of '{name}'", value)
    return {name: limits[name] for name in outputs if name in limits}
