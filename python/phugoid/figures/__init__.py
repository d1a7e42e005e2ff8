"""Common style of all figures: colours, font sizes, labels with units."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import ByName
from ..time_unit import SECONDS, TimeUnit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "BAND",
    "GREY",
    "INPUT",
    "LIMIT",
    "MEASURED",
    "MODEL",
    "NARROW",
    "ORANGE",
    "PURPLE",
    "RESIDUAL",
    "RULE",
    "SERIES",
    "SPAN",
    "STATE",
    "STYLE",
    "TOLERANCE",
    "WIDTH",
    "Panels",
    "figure_of",
    "headline",
    "labelled",
    "plain",
    "squared",
    "styled",
    "with_gaps",
    "write_keys",
]


# Okabe and Ito's palette, which colour-blind readers can distinguish; shapes and dashes differ, too, for grey prints.
MEASURED = "#0072B2"
MODEL = "#D55E00"
STATE = "#009E73"
ORANGE = "#E69F00"
PURPLE = "#CC79A7"
INPUT = "#000000"
RESIDUAL = "#4D4D4D"
GREY = "#999999"
BAND = "#DDDDDD"
# Colour of lines that only mark a place.
RULE = "#BBBBBB"
# Paler than anything drawn on it.
SPAN = "#F6D5A8"
TOLERANCE, LIMIT = "#F0E442", "#A08A00"

SERIES = ((MEASURED, "o"), (MODEL, "s"), (STATE, "^"), (PURPLE, "D"), (ORANGE, "v"), (RESIDUAL, "P"))
"""Colour and marker of what stands side by side."""

STYLE: dict[Any, Any] = {
    "font.size": 8.0,
    "axes.labelsize": 8.0,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.formatter.useoffset": False,
    "axes.formatter.limits": (-4, 5),
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
}
"""For `styled`. Letters can be read where the figure is printed 170 mm wide."""

WIDTH = 7.2
"""Inches: between the margins of an A4 page."""

NARROW = 3.9
"""Inches: the width of a phone, where letters have the size that they have on a page."""


class Panels(ByName[Any]):
    """The axes of a figure by name, whose names alone are printed, as where a cell of a notebook ends with a plot.

    >>> Panels({"q": None, "q residual": None})
    <axes: q, q residual>
    """

    def __init__(self, axes: Mapping[str, Axes | None]) -> None:
        super().__init__("panel", axes)

    def __repr__(self) -> str:
        return f"<axes: {', '.join(self)}>"


@contextmanager
def styled(more: Mapping[Any, Any] | None = None) -> Iterator[Any]:
    """Yield `matplotlib.pyplot`, which is imported here, with the common style in force, and ``more``."""
    import matplotlib.pyplot as plt

    # This loads the backend. That of notebooks turns interactive drawing on when it is loaded, which the context would
    # turn off again at its end: then only the first figure of a notebook would be shown.
    plt.draw_if_interactive()  # type: ignore[no-untyped-call]
    with plt.rc_context({**STYLE, **(more or {})}):
        yield plt


def figure_of(axis: Axes) -> Figure:
    """Return the figure that an axis is in, also where it is in a subfigure."""
    parent: Any = axis.figure
    while parent is not parent.figure:
        parent = parent.figure
    figure: Figure = parent
    return figure


def headline(figure: Figure, left: float, text: str) -> None:
    """Write the title of a figure that is laid out by hand at its top, starting at ``left``, a part of its width."""
    figure.text(left, 1.0 - 0.08 / figure.get_figheight(), plain(text), ha="left", va="top", fontsize=9.5)


def write_keys(
    figure: Figure, left: float, handles: Sequence[Any], columns: int | None = None, below: float = 0.27, **look: Any
) -> None:
    """Write the keys of lines and patches in a row, or in so many columns, starting at ``left``, a part of the figure's
    width, and ``below`` its upper edge, inches."""
    figure.legend(
        handles=handles,
        loc="upper left",
        bbox_to_anchor=(left, 1.0 - below / figure.get_figheight()),
        ncols=len(handles) if columns is None else columns,
        frameon=False,
        borderpad=0.0,
        borderaxespad=0.0,
        **{"columnspacing": 1.6, **look},
    )


def labelled(name: str, units: Mapping[str, str]) -> str:
    """Return a name with its unit, where it has one.

    >>> labelled("q", {"q": "rad/s"}), labelled("Mach", {"Mach": "1"})
    ('q, rad/s', 'Mach')
    """
    unit = units.get(name, "")
    return name if unit in ("", "1", "-") else f"{name}, {unit}"


def squared(unit: str, time: TimeUnit = SECONDS) -> str:
    """Return the unit of a power spectral density.

    >>> squared("rad"), squared("rad/s"), squared(""), squared("K", TimeUnit("h"))
    ('rad²/Hz', '(rad/s)²/Hz', '1/Hz', 'K²·h')
    """
    bare = unit in ("", "1", "-")
    power = "1" if bare else f"{unit if unit.isalpha() else f'({unit})'}²"
    return f"{power}/Hz" if time.frequency == "Hz" else time if bare else f"{power}·{time}"


def plain(text: str) -> str:
    """Return a text in which dollar signs are escaped, since matplotlib would take them for mathematics."""
    return text.replace("$", r"\$")


def with_gaps(t: NDArray[np.float64], values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return times and values for a line through the samples that exist, broken where more than a few are missing.

    A channel slower than the record's times has a value at few of them: a line with NaN between would not be seen.

    >>> with_gaps(np.arange(5.0), np.array([1, np.nan, 2, np.nan, 3]))
    (array([0., 2., 4.]), array([1., 2., 3.]))
    """
    there = np.isfinite(values)
    t, values = t[there], values[there]
    steps = np.diff(t)
    gaps = np.flatnonzero(steps > 5.0 * np.median(steps)) + 1 if steps.size else np.zeros(0, dtype=np.intp)
    return np.insert(t, gaps, np.nan), np.insert(values, gaps, np.nan)
