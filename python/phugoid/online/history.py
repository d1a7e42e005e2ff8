"""Estimates over the time of a record that was streamed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import OptionError, did_you_mean
from ..figures import SERIES, WIDTH, Panels, figure_of
from .estimate import Alarm

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["OnlineHistory"]

_Array = NDArray[np.float64]


@dataclass(frozen=True)
class OnlineHistory:
    """Estimates after each of N samples, arrays (N,) by name.

    ``t``: times, in s. ``states``, ``parameters``, ``sigma``, ``innovations`` and ``normalised`` as in `OnlineEstimate`, with
    ``state_errors``, ``parameter_errors`` and ``innovation_errors``. ``iterations``: Gauss-Newton iterations of each sample.
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
    ) -> tuple[Figure, dict[str, Axes]]:
        """Plot parameters over time with a band of two standard errors.

        ``names``: the parameters, all by default. ``reference``: values to compare with, such as those of a fit of the whole
        record. Vertical axes show the last three quarters of the time in full. Returns the figure and its axes by name. Raises
        OptionError for a name that is no parameter.
        """
        names = list(self.parameters) if names is None else list(names)
        for name in names:
            if name not in self.parameters:
                raise OptionError(f"plot: '{name}' is not a parameter.{did_you_mean(name, list(self.parameters))}")
        panels: Any = {}
        figure, panels = _panels(names)
        settled = self.t >= self.t[0] + 0.25 * (self.t[-1] - self.t[0])
        for name in names:
            axes, value, error = panels[name], self.parameters[name], self.parameter_errors[name]
            axes.fill_between(self.t, value - 2 * error, value + 2 * error, color=SERIES[0], alpha=0.2, lw=0)
            axes.plot(self.t, value, color=SERIES[0], lw=1.2)
            low, high = (value - 3 * error)[settled].min(), (value + 3 * error)[settled].max()
            if reference is not None and name in reference:
                axes.axhline(reference[name], color=SERIES[1], lw=1, ls="--")
                low, high = min(low, reference[name]), max(high, reference[name])
            if self.alarm is not None:
                axes.axvline(self.alarm.since, color=SERIES[2], lw=1)
            if np.isfinite([low, high]).all() and low < high:
                axes.set_ylim(low, high)
            axes.set_ylabel(name)
        return figure, panels


def _panels(names: list[str]) -> tuple[Figure, dict[str, Axes]]:
    """Return a figure with a panel for each name, two side by side."""
    rows = -(-len(names) // 2)
    figure = figure_of(WIDTH, 1.3 * rows + 0.6)
    axes = figure.subplots(rows, 2, sharex=True, squeeze=False).ravel()
    for spare in axes[len(names) :]:
        spare.set_visible(False)
    for own in axes[max(len(names) - 2, 0) : len(names)]:
        own.set_xlabel("t, s")
        own.tick_params(labelbottom=True)
    return figure, dict(zip(names, axes, strict=False))
