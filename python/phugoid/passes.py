"""The passes of an estimation: mesh refinement, and the smoothing of kinks."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from .parameters import Estimates, text_table

__all__ = ["Refinement", "Smoothing", "SmoothingStep", "Step"]


@dataclass(frozen=True)
class Step:
    """One pass: the transcription, and how exact it was.

    order           points of a segment.
    segments        their number in all experiments.
    largest         largest integration error of a segment, in units of `IntegrationError.scales`.
    coarse          number of segments above the tolerance.
    iterations      of the solver.
    log_likelihood  at the end.
    """

    order: int
    segments: int
    largest: float
    coarse: int
    iterations: int
    log_likelihood: float


@dataclass(frozen=True)
class Refinement:
    """The passes of a refined estimation, the first as asked for, the last the one that the fit holds.

    tolerance  of the integration error of a segment, in units of the noise.
    steps      the passes.
    changes    parameter -> (first estimate, last estimate, standard error of the last).
    """

    tolerance: float
    steps: Sequence[Step]
    changes: Mapping[str, tuple[float, float, float]]

    @staticmethod
    def of(first: Mapping[str, float], last: Estimates, steps: Sequence[Step], tolerance: float) -> Refinement:
        """Return the refinement made of the values in the first pass and the estimates of the last."""
        changes = {
            name: (first[name], e.value, e.std_error) for name, e in last.items() if name in first and not e.fixed
        }
        return Refinement(tolerance, tuple(steps), changes)

    @property
    def met(self) -> bool:
        """Whether the tolerance was met in the end."""
        return self.steps[-1].coarse == 0

    def change(self, name: str) -> tuple[float, float]:
        """Return the change of a parameter by refinement: in % of its value, and in standard errors; NaN where
        undefined."""
        first, last, error = self.changes[name]
        return (
            100.0 * (last - first) / abs(last) if last else math.nan,
            (last - first) / error if error > 0 else math.nan,
        )

    def summary(self) -> str:
        """Return passes and changes as plain-text tables."""
        rows = [
            [
                str(s.order),
                str(s.segments),
                f"{s.largest:.1e}",
                str(s.coarse),
                str(s.iterations),
                f"{s.log_likelihood:.3f}",
            ]
            for s in self.steps
        ]
        header = ["order", "segments", "largest error", "too coarse", "iterations", "log-likelihood"]
        outcome = "met" if self.met else "not met"
        parts = [
            f"mesh refinement: tolerance {self.tolerance:g} of the noise {outcome}",
            text_table(header, rows, "rrrrrr"),
        ]
        if len(self.steps) > 1:
            moved = [
                [name, f"{first:.6g}", f"{last:.6g}", *(_signed(c) for c in self.change(name))]
                for name, (first, last, _) in self.changes.items()
            ]
            header = ["parameter", "first mesh", "last mesh", "change, %", "in std errors"]
            parts.append(text_table(header, moved, "lrrrr"))
        return "\n\n".join(parts)

    def to_dict(self) -> dict[str, Any]:
        """Return the refinement as JSON takes it."""
        changes = {name: list(c) for name, c in self.changes.items()}
        return {"tolerance": self.tolerance, "steps": [vars(s) for s in self.steps], "changes": changes}

    @staticmethod
    def from_dict(saved: Mapping[str, Any]) -> Refinement:
        """Read the result of `to_dict`."""
        changes = {
            name: (float(a), float(b), math.nan if e is None else float(e))
            for name, (a, b, e) in saved["changes"].items()
        }
        return Refinement(saved["tolerance"], tuple(Step(**s) for s in saved["steps"]), changes)


def _signed(value: float) -> str:
    return f"{value:+.3f}" if math.isfinite(value) else ""


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
