"""How an estimation problem becomes a nonlinear program."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from . import _core
from .errors import OptionError
from .experiment import Experiment
from .model import Model

__all__ = ["Collocation"]

GridSpec = tuple[str, int, "list[float] | None"]


@dataclass(frozen=True)
class Collocation:
    """Legendre-Gauss-Lobatto collocation (Eq. oem_coll of the paper).

    ``order`` is the number of points of a segment, ends included: 2 is the trapezoid, m integrates to order
    2m - 2. By default every interval between samples is a segment; ``substeps`` divides each further;
    ``segments`` gives a number of equal segments, or the times of their ends (s), instead, which need not be
    sample times (a list of such for several experiments). ``threads`` 0 is one a core.
    """

    order: int = 4
    substeps: int = 1
    segments: int | ArrayLike | Sequence[ArrayLike] | None = None
    threads: int = 0

    def __post_init__(self) -> None:
        if isinstance(self.order, bool) or not isinstance(self.order, int) or not 2 <= self.order <= 64:
            raise OptionError(f"Collocation: order is a whole number from 2 (trapezoid) to 64, not {self.order!r}")
        if not isinstance(self.substeps, int) or self.substeps < 1:
            raise OptionError(f"Collocation: substeps is a whole number from 1, not {self.substeps!r}")
        if self.segments is not None and self.substeps != 1:
            raise OptionError("Collocation: substeps divides sample intervals and segments replaces them; give one")
        if isinstance(self.segments, int) and self.segments < 1:
            raise OptionError(f"Collocation: at least 1 segment is needed, not {self.segments}")
        if not isinstance(self.threads, int) or self.threads < 0:
            raise OptionError(f"Collocation: threads is a whole number from 0, not {self.threads!r}")

    def grids(self, experiments: int) -> list[GridSpec]:
        """The division into segments as the core takes it: one for all, or one an experiment."""
        if self.segments is None:
            return [("samples", self.substeps, None)]
        if isinstance(self.segments, (int, np.integer)):
            return [("uniform", int(self.segments), None)]
        parts = list(self.segments)  # type: ignore[arg-type]
        if parts and np.ndim(parts[0]) == 0 and experiments > 1:
            raise OptionError("Collocation: give the segment ends of each experiment, a list of lists")
        lists = [parts] if np.ndim(parts[0]) == 0 else parts
        return [("edges", 0, [float(t) for t in np.asarray(part)]) for part in lists]

    def problem(
        self, model: Model, experiments: Sequence[Experiment], sigmas: list[tuple[bool, float, float, float]]
    ) -> _core.Collocation:
        """The nonlinear program."""
        records = [
            (
                e.name,
                np.ascontiguousarray(e.t),
                [np.ascontiguousarray(e.input(n)) for n in model.input_names],
                [np.ascontiguousarray(e.output(n)) for n in model.output_names],
                e.interpolation,
            )
            for e in experiments
        ]
        return _core.Collocation(
            model._core, records, sigmas, self.order, self.grids(len(experiments)), self.threads
        )

    def __str__(self) -> str:
        if self.segments is None:
            grid = "one segment" if self.substeps == 1 else f"{self.substeps} segments"
            grid += " between samples"
        elif isinstance(self.segments, (int, np.integer)):
            grid = f"{self.segments} equal segments"
        else:
            grid = "given segments"
        return f"collocation of order {self.order}, {grid}"
