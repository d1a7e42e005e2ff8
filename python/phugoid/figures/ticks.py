"""Axes of figures that are laid out by hand: ticks only where they are seen, labels at fixed places, and powers of ten
as text. Otherwise matplotlib spends most of its time on the measuring of numbers."""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from . import figure_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.ticker import Locator

__all__ = ["label_decades", "linear_ticks", "log_ticks", "make_ticks_in_view", "prepare"]

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_ROUNDING = 1e-6  # of the view
_TINY = 1e-300


@cache
def _in_view(kind: Any) -> Any:
    """Return a kind of locator without the ticks beyond the view, for each of which matplotlib would make five objects.

    It is made here, since its base is of matplotlib, which is imported by the functions that draw.
    """

    from matplotlib.ticker import LogLocator

    logarithmic = issubclass(kind, LogLocator)

    class InView(kind):  # type: ignore[misc]
        def tick_values(self, vmin: float, vmax: float) -> Any:
            ticks = np.asarray(super().tick_values(vmin, vmax))
            ends = np.array([min(vmin, vmax), max(vmin, vmax)])
            at, (low, high) = (np.log(ticks), np.log(np.maximum(ends, _TINY))) if logarithmic else (ticks, ends)
            slack = _ROUNDING * (high - low)
            return ticks[(at >= low - slack) & (at <= high + slack)]

        def __reduce__(self) -> Any:  # figures can be pickled
            return _blank, (kind,), vars(self)

    return InView


def _blank(kind: Any) -> Any:
    made = _in_view(kind)
    return made.__new__(made)


def linear_ticks(**options: Any) -> Locator:
    """Return a locator of those ticks of `matplotlib.ticker.AutoLocator` that are in view."""
    from matplotlib.ticker import MaxNLocator

    locator: Locator = _in_view(MaxNLocator)(**{"nbins": "auto", "steps": [1, 2, 2.5, 5, 10], **options})
    return locator


def log_ticks(**options: Any) -> Locator:
    """Return a locator of those ticks of `matplotlib.ticker.LogLocator` that are in view."""
    from matplotlib.ticker import LogLocator

    locator: Locator = _in_view(LogLocator)(**options)
    return locator


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
        part.set_major_locator(linear_ticks())


def label_decades(part: Axis) -> None:
    """Label powers of ten with 10⁻³ as text; mathematics takes far longer to draw."""
    from matplotlib.ticker import FuncFormatter, NullFormatter

    part.set_major_formatter(FuncFormatter(_decade))
    part.set_minor_formatter(NullFormatter())


def _decade(value: float, _: int | None = None) -> str:
    """Return a power of ten as text.

    >>> _decade(1e-12), _decade(10.0)
    ('10⁻¹²', '10¹')
    """
    return "10" + f"{math.log10(value):.0f}".translate(_RAISED)
