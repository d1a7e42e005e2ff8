"""Axes of figures that are laid out by hand: ticks only where they are seen, labels at fixed places, and powers of ten
as text. Otherwise matplotlib spends most of its time on the measuring of numbers.

It is imported by functions that draw, since it imports matplotlib.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from . import figure_of

__all__ = ["LinearTicks", "LogTicks", "label_decades", "make_ticks_in_view", "prepare"]

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_ROUNDING = 1e-6  # of the view


class LinearTicks(MaxNLocator):
    """The ticks of `matplotlib.ticker.AutoLocator` that are in view; of each beyond it five objects would be made."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**{"nbins": "auto", "steps": [1, 2, 2.5, 5, 10], **options})

    def tick_values(self, vmin: float, vmax: float) -> Any:
        """Return the places of ticks between two values."""
        low, high = min(vmin, vmax), max(vmin, vmax)
        slack = _ROUNDING * (high - low)
        ticks = np.asarray(super().tick_values(vmin, vmax))
        return ticks[(ticks >= low - slack) & (ticks <= high + slack)]


class LogTicks(LogLocator):
    """The ticks of `matplotlib.ticker.LogLocator` that are in view."""

    def tick_values(self, vmin: float, vmax: float) -> Any:
        """Return the places of ticks between two values."""
        low, high = min(vmin, vmax), max(vmin, vmax)
        ticks = np.asarray(super().tick_values(vmin, vmax))
        return ticks[(ticks >= low * (1.0 - _ROUNDING)) & (ticks <= high * (1.0 + _ROUNDING))]


def prepare(axis: Axes, left: float, below: float = 0.24) -> None:
    """Have ticks made in view only, and the labels of an axis placed so many inches left of it (the middle of the
    label) and below it (its upper edge), for which nothing needs to be measured."""
    width, height = axis.get_position().size * figure_of(axis).get_size_inches()
    axis.yaxis.set_label_coords(-left / width, 0.5)
    axis.xaxis.set_label_coords(0.5, -below / height)
    make_ticks_in_view(axis)


def make_ticks_in_view(axis: Axes) -> None:
    """Have ticks of linear scales made in view only."""
    for part in (axis.xaxis, axis.yaxis):
        part.set_major_locator(LinearTicks())


def label_decades(part: Axis) -> None:
    """Label powers of ten with 10⁻³ as text; mathematics takes far longer to draw."""
    part.set_major_formatter(FuncFormatter(lambda value, _: "10" + f"{math.log10(value):.0f}".translate(_RAISED)))
    part.set_minor_formatter(NullFormatter())
