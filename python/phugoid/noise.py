"""What the measurement noise is assumed to be."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from .errors import ModelError, did_you_mean

__all__ = ["Gaussian", "Sigma"]


@dataclass(frozen=True)
class Sigma:
    """An unknown standard deviation of the noise of one output, in the output's unit.

    ``start`` None starts at the standard deviation of the measurements, and a larger start is lowered to it;
    ``bounds`` None allows 1e-9 to 1e6 times that.
    """

    start: float | None = None
    bounds: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if self.start is not None and not _positive(self.start):
            raise ModelError(f"a standard deviation starts at a positive number, not {self.start!r}")
        if self.bounds is not None:
            try:
                low, high = self.bounds
                sound = 0 < low < high
            except (TypeError, ValueError):
                sound = False
            if not sound:
                raise ModelError(
                    f"bounds of a standard deviation are a positive pair that increases, not {self.bounds!r}"
                )
            if self.start is not None and not low <= self.start <= high:
                raise ModelError(
                    f"the start {self.start} of a standard deviation lies outside its bounds {self.bounds}"
                )


@dataclass(frozen=True)
class Gaussian:
    """Independent Gaussian noise on each output (Eqs. pe_gaussian and r_diag of the paper).

    ``sigma`` gives, by output name, a number (a known standard deviation) or a `Sigma` (an unknown one); outputs
    not named have an unknown one.
    """

    sigma: Mapping[str, float | Sigma] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not isinstance(self.sigma, Mapping):
            raise ModelError(f"noise: give standard deviations by output, such as {{'q': 0.01}}, not {self.sigma!r}")
        for name, value in self.sigma.items():
            if not isinstance(value, Sigma) and not _positive(value):
                raise ModelError(
                    f"noise of '{name}': a known standard deviation is a positive number, not {value!r}; "
                    "an unknown one is a Sigma"
                )
        plain = {name: s if isinstance(s, Sigma) else float(s) for name, s in self.sigma.items()}
        object.__setattr__(self, "sigma", plain)

    @property
    def known(self) -> dict[str, float]:
        """The known standard deviations by output."""
        return {name: s for name, s in self.sigma.items() if not isinstance(s, Sigma)}

    def to_dict(self) -> dict[str, Any]:
        """As JSON takes it: output -> known value, or start and bounds."""

        def plain(s: float | Sigma) -> dict[str, Any]:
            if not isinstance(s, Sigma):
                return {"known": s}
            return {"start": s.start, "bounds": list(s.bounds) if s.bounds else None}

        return {name: plain(s) for name, s in self.sigma.items()}

    @staticmethod
    def from_dict(saved: Mapping[str, Any]) -> Gaussian:
        """Reads `to_dict`."""

        def sigma(s: Mapping[str, Any]) -> float | Sigma:
            return s["known"] if "known" in s else Sigma(s["start"], tuple(s["bounds"]) if s["bounds"] else None)

        return Gaussian({name: sigma(s) for name, s in saved.items()})

    def resolve(
        self, outputs: Sequence[str], spread: Mapping[str, float], start: Mapping[str, float]
    ) -> list[tuple[bool, float, float, float]]:
        """For each output: known?, value or start, lower bound, upper bound.

        ``spread`` is the standard deviation of the measurements, ``start`` holds starts by ``sigma_<output>``.
        """
        for name in self.sigma:
            if name not in outputs:
                raise ModelError(f"noise: '{name}' is not an output.{did_you_mean(name, outputs)}")
        resolved = []
        for name in outputs:
            spec = self.sigma.get(name, Sigma())
            given = start.get(f"sigma_{name}")
            if not isinstance(spec, Sigma):
                if given is not None:
                    raise ModelError(f"sigma_{name} is known ({spec}) and cannot be given a start as well")
                resolved.append((True, float(spec), float(spec), float(spec)))
                continue
            scale = spread[name]
            low, high = spec.bounds or (1e-9 * scale, 1e6 * scale)
            value = given if given is not None else spec.start
            if value is None:
                value = min(max(scale, low), high)
            if not _positive(value):
                raise ModelError(f"the start of sigma_{name} is a positive number, not {value!r}")
            if not low <= value <= high and spec.bounds is None:
                low, high = min(low, value), max(high, value)
            if not low <= value <= high:
                raise ModelError(f"the start {value} of sigma_{name} lies outside its bounds {spec.bounds}")
            # No useful fit is worse than a constant. Beside others of its kind, an output with a start far above its
            # spread would have no say in the first steps, and these can lead far away.
            value = max(min(value, scale), low)
            resolved.append((False, float(value), float(low), float(high)))
        return resolved


def _positive(value: Any) -> bool:
    try:
        return value > 0 and math.isfinite(value)
    except TypeError:
        return False
