"""Estimates over the time of a record that was streamed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import OptionError, did_you_mean
from ..figures import LIMIT, MEASURED, MODEL, WIDTH, Panels, styled
from .estimate import Alarm

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["OnlineHistory"]

_Array = NDArray[np.float64]


@dataclass(frozen=True)
class OnlineHistory:
    """Estimates after each of N samples, arrays (N,) by name.

    ``t``: times, in s. ``states``, ``parameters``, ``sigma``, ``innovations`` and ``normalised`` as in
    `OnlineEstimate`, with
    ``state_errors``, ``parameter_errors`` and ``innovation_errors``. ``iterations``: Gauss-Newton iterations of each
    sample.
    ``alarm``: what the detector says at the end.
    """

    name: str
    t: _Array
    states: dict[str, _Array]
    state_errors: dict[str, _Array]
    parameters: dict[str, _Array]
    parameter_errors: dict[str, _Array]
    sigma: dict[str, _Array]
    innovations: dict[str, _Array]
    innovation_errors: dict[str, _Array]
    normalised: dict[str, _Array]
    iterations: _Array
    alarm: Alarm | None

    def plot(
        self, names: Sequence[str] | None = None, *, reference: dict[str, float] | None = None
    ) -> tuple[Figure, Panels]:
        """Plot parameters over time with a band of two standard errors.

        ``names``: the parameters, all by default. ``reference``: values to compare with, such as those of a fit of
        the whole record. Vertical axes show the last three quarters of the time in full. Returns the figure and its
        axes by name. Raises OptionError for a name that is no parameter.
        """
        names = list(self.parameters) if names is None else list(names)
        for name in names:
            if name not in self.parameters:
                raise OptionError(f"plot: '{name}' is not a parameter.{did_you_mean(name, list(self.parameters))}")
        with styled() as plt:
            rows = -(-len(names) // 2)
            figure, grid = plt.subplots(
                rows, 2, sharex=True, squeeze=False, figsize=(WIDTH, 1.1 * rows + 0.5), layout="constrained"
            )
            for spare in grid.ravel()[len(names) :]:
                spare.set_visible(False)
            panels = dict(zip(names, grid.ravel(), strict=False))
            self._draw(panels, reference or {})
            for name in names[-2:]:
                panels[name].set_xlabel("t, s")
                panels[name].tick_params(labelbottom=True)
        return figure, Panels(panels)

    def _draw(self, panels: dict[str, Any], reference: dict[str, float]) -> None:
        settled = self.t >= self.t[0] + 0.25 * (self.t[-1] - self.t[0])
        for name, axes in panels.items():
            value, error = self.parameters[name], self.parameter_errors[name]
            axes.fill_between(self.t, value - 2 * error, value + 2 * error, color=MEASURED, alpha=0.2, lw=0)
            axes.plot(self.t, value, color=MEASURED, lw=1.2)
            low, high = (value - 3 * error)[settled].min(), (value + 3 * error)[settled].max()
            if name in reference:
                axes.axhline(reference[name], color=MODEL, lw=1, ls="--")
                low, high = min(low, reference[name]), max(high, reference[name])
            if self.alarm is not None:
                axes.axvline(self.alarm.since, color=LIMIT, lw=1)
            if np.isfinite([low, high]).all() and low < high:
                axes.set_ylim(low, high)
            axes.set_ylabel(name)
