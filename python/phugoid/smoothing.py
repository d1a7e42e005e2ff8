"""The result of smoothing in an estimation with kinks: widths, passes, and the remaining error."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from .parameters import text_table

__all__ = ["Smoothing", "SmoothingStep"]


@dataclass(frozen=True)
class SmoothingStep:
    """One pass.

    part            width of each kink as a part of the standard deviation of its argument over the path.
    segments        of the mesh, in all experiments.
    iterations      of the solver.
    log_likelihood  at the end.
    """

    part: float
    segments: int
    iterations: int
    log_likelihood: float


@dataclass(frozen=True)
class Smoothing:
    """How kinks and jumps of the state equations were smoothed, pass after pass over narrower widths.

    widths  "sign(v) in v'" -> (the width in the last pass, its unit, "" where that is not known).
    steps   the passes, the last the one that the fit holds.
    left    parameter -> (change with widths of zero, standard error). The change is extrapolated from the last two
            passes, in proportion to the width; NaN after a single pass.
    """

    widths: Mapping[str, tuple[float, str]]
    steps: Sequence[SmoothingStep]
    left: Mapping[str, tuple[float, float]]

    def beyond(self, errors: float) -> dict[str, float]:
        """Return the parameters whose remaining error exceeds ``errors`` standard errors, and its size in these."""
        parts = {name: left / error for name, (left, error) in self.left.items() if error > 0}
        return {name: part for name, part in parts.items() if not abs(part) <= errors}

    @property
    def description(self) -> str:
        """The widths in words."""
        return ", ".join(f"{kink} over {width:.2g} {unit}".rstrip() for kink, (width, unit) in self.widths.items())

    def summary(self) -> str:
        """Return passes and the remaining error as plain-text tables."""
        rows = [[f"{s.part:.1e}", str(s.segments), str(s.iterations), f"{s.log_likelihood:.3f}"] for s in self.steps]
        left = [
            [name, f"{change:+.2g}" if math.isfinite(change) else "", _part(change, error)]
            for name, (change, error) in self.left.items()
        ]
        return "\n\n".join(
            [
                f"kinks smoothed: {self.description}",
                text_table(["width/spread", "segments", "iterations", "log-likelihood"], rows, "rrrr"),
                text_table(["parameter", "left by smoothing", "in std errors"], left, "lrr"),
            ]
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the smoothing as JSON takes it."""
        widths = {kink: list(width) for kink, width in self.widths.items()}
        left = {name: list(pair) for name, pair in self.left.items()}
        return {"widths": widths, "steps": [vars(s) for s in self.steps], "left": left}

    @staticmethod
    def from_dict(saved: Mapping[str, Any]) -> Smoothing:
        """Read the result of `to_dict`."""

        def number(value: Any) -> float:
            return math.nan if value is None else float(value)

        return Smoothing(
            {str(kink): (float(width), str(unit)) for kink, (width, unit) in saved["widths"].items()},
            tuple(SmoothingStep(**s) for s in saved["steps"]),
            {str(name): (number(left), number(error)) for name, (left, error) in saved["left"].items()},
        )


def _part(change: float, error: float) -> str:
    return f"{change / error:+.2f}" if error > 0 and math.isfinite(change) else ""
