"""What a regression on measured states gives back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from ..figures import fit as plot
from ..modelling.model import Model
from ..parameters import Estimates, estimates_table, text_table
from ..records import Record

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["EquationError"]

_Array: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class EquationError:
    """The result of `equation_error`.

    parameters         by name; their standard errors hold for residuals of the colour that they have.
    white_std_errors   name -> what the standard error would be if the residuals were white (it is too small).
    r_squared          equation -> coefficient of determination; NaN where the left side does not move.
    sigmas             equation -> root mean square of its residuals, in its unit.
    groups             the equations that were solved together, since they share parameters.
    collinear          (names, condition index): parameters that compensate each other (index from 30); infinite
                       where the data do not tell them apart at all.
    records            one an experiment. Its outputs are the equations, named after the output or the state with a
                       prime: measured left-hand sides, right-hand sides, residuals; its states are smoothed.
    warnings           what to beware of, in words.
    """

    model: Model
    parameters: Estimates
    white_std_errors: Mapping[str, float]
    r_squared: Mapping[str, float]
    sigmas: Mapping[str, float]
    groups: Sequence[tuple[str, ...]]
    collinear: Sequence[tuple[tuple[str, ...], float]]
    records: Sequence[Record]
    warnings: tuple[str, ...] = ()
    solution: None = field(default=None, init=False)  # an estimate from here has no multipliers to go on with

    @property
    def t_statistics(self) -> dict[str, float]:
        """Name -> value over standard error (coloured residuals); NaN where there is none."""
        return {name: e.value / e.std_error if e.std_error > 0 else np.nan for name, e in self.parameters.items()}

    @property
    def residuals(self) -> Mapping[str, _Array]:
        """Equation -> (N,), NaN where there is no row, of the only experiment."""
        if len(self.records) > 1:
            raise DataError(f"the regression has {len(self.records)} experiments: use result.records[i].residuals")
        return self.records[0].residuals

    def as_start(self) -> dict[str, float]:
        """Parameters as start values of an estimation."""
        return self.parameters.to_dict()

    def summary(self) -> str:
        """The regression as plain-text tables."""
        rows = []
        for name, sigma in self.sigmas.items():
            pieces = [r.residuals[name][np.isfinite(r.residuals[name])] for r in self.records]
            colour = _lag_one(pieces)
            unit = self.records[0].units.get(name, "")
            count = str(sum(p.size for p in pieces))
            r2 = self.r_squared[name]
            rows.append([name, f"{sigma:.4g}", unit, f"{r2:.4f}" if np.isfinite(r2) else "", f"{colour:.2f}", count])
        header = ["equation", "RMS residual", "unit", "R²", "lag-1 corr.", "samples"]
        t = self.t_statistics
        lines = []
        for name in self.parameters:
            white = self.white_std_errors[name]
            known = np.isfinite(t[name])
            lines.append([name, f"{white:.2g}" if known else "", f"{abs(t[name]):.1f}" if known else ""])
        parts = [
            f"{self.model.name}: equation error",
            text_table(header, rows, "lrlrrr"),
            estimates_table(self.parameters.values()),
            text_table(["parameter", "std error, if white", "|t|"], lines, "lrr"),
            *(f"Warning: {w}" for w in self.warnings),
        ]
        return "\n\n".join(parts)

    def plot(self, record: int | str = 0, channels: Sequence[str] | None = None) -> tuple[Figure, dict[str, Axes]]:
        """Both sides of the equations over time, residuals and inputs, of one experiment."""
        chosen = plot.choose_record(self.records, record)
        return plot.plot_record(chosen, channels, title=f"{self.model.name}: {chosen.name}")

    def __repr__(self) -> str:
        return (
            f"<EquationError of '{self.model.name}': {len(self.sigmas)} equations, {len(self.parameters)} parameters>"
        )

    def __str__(self) -> str:
        return self.summary()


def _lag_one(pieces: Sequence[_Array]) -> float:
    squares = sum(float((p**2).sum()) for p in pieces)
    return sum(float((p[1:] * p[:-1]).sum()) for p in pieces) / squares if squares > 0 else 0.0
