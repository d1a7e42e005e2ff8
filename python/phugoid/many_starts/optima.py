"""Optima that starts reached: starts that ended at one point, and their figure."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..estimation.starts import Outcome
from ..figures import GREY, INPUT, MEASURED, ORANGE, PURPLE, RULE, STATE, WIDTH, Panels, figure_of, headline, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["LOG_LIKELIHOOD", "PARAMETERS", "Optimum", "group", "plot_waterfall", "same"]

LOG_LIKELIHOOD = 1e-3
"""Outcomes of one optimum differ by no more than this in log-likelihood,"""
PARAMETERS = 0.01
"""and in each parameter by no more than this many standard errors, or this part of its value where it has none."""


@dataclass(frozen=True, eq=False)
class Optimum:
    """An optimum that one start or several reached.

    log_likelihood  the highest of its outcomes.
    parameters      name -> value, of the representative: the outcome with that log-likelihood.
    std_errors      name -> standard error, of the representative.
    index           number of the start that is the representative.
    indices         numbers of all starts that reached it, ascending.
    """

    log_likelihood: float
    parameters: Mapping[str, float]
    std_errors: Mapping[str, float]
    index: int
    indices: tuple[int, ...]

    @property
    def count(self) -> int:
        """How many starts reached it."""
        return len(self.indices)


def same(one: Outcome, other: Outcome, log_likelihood: float = LOG_LIKELIHOOD, parameters: float = PARAMETERS) -> bool:
    """Return whether two outcomes are the same optimum; the standard errors are those of the first.

    Where one of them is unidentifiable, parameters without a standard error may differ by any amount.
    """
    if not abs(one.log_likelihood - other.log_likelihood) <= log_likelihood:
        return False
    a, b, error = (
        np.fromiter(v.values(), dtype=np.float64) for v in (one.parameters, other.parameters, one.std_errors)
    )
    open_to = np.inf if "unidentifiable" in (one.status, other.status) else np.maximum(np.abs(a), np.abs(b))
    unit = np.where(error > 0, error, open_to)
    return bool(np.all(np.abs(a - b) <= parameters * unit))


def group(
    outcomes: Iterable[Outcome], log_likelihood: float = LOG_LIKELIHOOD, parameters: float = PARAMETERS
) -> tuple[Optimum, ...]:
    """Group the outcomes that ended at an optimum by it, best first.

    From the highest log-likelihood downwards, an outcome joins the first optimum whose representative is the `same`,
    or starts a new one.
    """
    sound = (o for o in outcomes if o.at_optimum)
    groups: list[list[Outcome]] = []
    first = 0  # groups before this one lie too high for all that still come
    for outcome in sorted(sound, key=lambda o: (-o.log_likelihood, o.index)):
        while first < len(groups) and groups[first][0].log_likelihood - outcome.log_likelihood > log_likelihood:
            first += 1
        for members in groups[first:]:
            if same(members[0], outcome, log_likelihood, parameters):
                members.append(outcome)
                break
        else:
            groups.append([outcome])
    return tuple(
        Optimum(
            members[0].log_likelihood,
            members[0].parameters,
            members[0].std_errors,
            members[0].index,
            tuple(sorted(o.index for o in members)),
        )
        for members in groups
    )


# Neighbours differ in shape as well, for grey prints.
_BEST = (MEASURED, "o")
_OTHERS = ((ORANGE, "s"), (STATE, "^"), (PURPLE, "D"))
_SINGLE = (GREY, ".")
_FAILED = (INPUT, "x")

# Inches.
_HEIGHT, _ROW = 3.6, 0.17
_LEFT, _RIGHT, _TOP, _BOTTOM, _GAP = 0.78, 0.3, 0.34, 0.46, 0.08
_NAMES = 1.2  # left margin that the names of statuses need
_LABEL = (0.34, 0.13)  # room that a count needs
_HIGHEST = 1.0  # the axis reaches at least so far


def plot_waterfall(
    outcomes: Sequence[Outcome], optima: Sequence[Optimum], title: str
) -> tuple[Figure, dict[str, Axes]]:
    """Gap of each converged outcome to the best log-likelihood, from the best to the worst.

    The gap's axis is linear about zero and logarithmic from there. An optimum is a plateau with the number of starts
    that reached it (the larger ones, where there is no room for all); one that a single start reached is a grey dot.
    The others stand in a strip above, in one row a status, since the log-likelihood of what has not converged
    compares with nothing.

    Returns the figure and the axes by name: ``"gap"``, and ``"not converged"`` where there are any.
    """
    counts = Counter(o.status for o in outcomes if not o.at_optimum)
    left = _NAMES if counts else _LEFT
    strip = (len(counts) + 0.4) * _ROW if counts else 0.0
    height = _HEIGHT + strip
    with styled() as plt:
        figure = plt.figure(figsize=(WIDTH, height))
        width = (WIDTH - left - _RIGHT) / WIDTH
        gap_height = _HEIGHT - _TOP - _BOTTOM - (_GAP if counts else 0.0)
        axis = figure.add_axes((left / WIDTH, _BOTTOM / height, width, gap_height / height))
        axes = {"gap": axis}
        rank = _draw_optima(axis, outcomes, optima)
        if counts:
            bottom = (_BOTTOM + gap_height + _GAP) / height
            above = figure.add_axes((left / WIDTH, bottom, width, strip / height), sharex=axis)
            axes["not converged"] = above
            _draw_failures(above, counts, rank)
        axis.set_xlabel("starts, best first")
        headline(figure, left / WIDTH, title)
    return figure, Panels(axes)


def _draw_optima(axis: Axes, outcomes: Sequence[Outcome], optima: Sequence[Optimum]) -> int:
    """Draws the plateaus; how many starts they hold."""
    reached = {o.index: o.log_likelihood for o in outcomes}
    best = optima[0].log_likelihood if optima else 0.0
    size = 3.5 if len(outcomes) <= 300 else 2.5
    rank, other = 0, 0
    plateaus: list[tuple[int, float, float]] = []  # count, middle, level
    for i, optimum in enumerate(optima):
        gaps = np.sort([best - reached[index] for index in optimum.indices])
        ranks = np.arange(rank + 1, rank + optimum.count + 1)
        color, marker = _BEST if i == 0 else _OTHERS[other % len(_OTHERS)] if optimum.count > 1 else _SINGLE
        other += i > 0 and optimum.count > 1
        level = best - optimum.log_likelihood
        if optimum.count > 1:
            axis.plot([ranks[0] - 0.5, ranks[-1] + 0.5], [level, level], color=color, linewidth=4, alpha=0.3)
        axis.plot(ranks, gaps, marker, color=color, ms=size, clip_on=False, rasterized=len(outcomes) > 5000)
        if i == 0 or optimum.count > 1:
            plateaus.append((optimum.count, rank + 0.5 + 0.5 * optimum.count, level))
        rank += optimum.count
    _scale([best - o.log_likelihood for o in optima], axis)
    axis.set_xlim(0.5 - 0.01 * len(outcomes), 0.5 + 1.01 * len(outcomes))
    _label_counts(axis, plateaus)
    axis.axhline(0.0, color=RULE, linewidth=0.5, zorder=0)
    if not optima:
        axis.text(0.5, 0.5, "no start converged", transform=axis.transAxes, ha="center", va="center")
    return rank


def _scale(gaps: Sequence[float], axis: Axes) -> None:
    """Logarithmic from a decade below the smallest gap; zero is at the foot."""
    from matplotlib.ticker import MaxNLocator, NullLocator

    apart = [gap for gap in gaps if gap > LOG_LIKELIHOOD]
    linear = max(LOG_LIKELIHOOD, 10.0 ** (math.floor(math.log10(min(apart))) - 1)) if apart else LOG_LIKELIHOOD
    top = 4.0 * max([*apart, _HIGHEST])
    axis.set_yscale("symlog", linthresh=linear, linscale=0.6)
    axis.set_ylim(-0.35 * linear, top)
    decades = range(round(math.log10(linear)), math.floor(math.log10(top)) + 1)
    axis.set_yticks([0.0, *(10.0**k for k in decades[:: 1 + len(decades) // 9])])
    axis.yaxis.set_minor_locator(NullLocator())
    axis.xaxis.set_major_locator(MaxNLocator(integer=True))
    axis.set_ylabel("log-likelihood below the best")


def _label_counts(axis: Axes, plateaus: Sequence[tuple[int, float, float]]) -> None:
    """Write each plateau's number of starts above its middle, the largest first, as long as there is room."""
    taken: list[Any] = []
    dpi = figure_of(axis).dpi
    for i, (count, middle, level) in sorted(enumerate(plateaus), key=lambda p: (p[0] > 0, -p[1][0])):
        place = axis.transData.transform((middle, level)) / dpi
        if any(np.all(np.abs(place - other) < _LABEL) for other in taken):
            continue
        taken.append(place)
        text = f"{count} start{'s' * (count > 1)}" if i == 0 else f"×{count}"
        left = i == 0 and count < 0.1 * axis.get_xlim()[1]  # else it would reach over the axis
        axis.annotate(
            text,
            (0.5 if left else middle, level),
            (0, 5),
            textcoords="offset points",
            ha="left" if left else "center",
            va="bottom",
            fontsize=7.5,
        )


def _draw_failures(axis: Axes, counts: Counter[str], rank: int) -> None:
    """Draw one row a status, the commonest at the bottom; ranks go on from those that converged."""
    color, marker = _FAILED
    rows = counts.most_common()
    for row, (_, count) in enumerate(rows):
        axis.plot(np.arange(rank + 1, rank + count + 1), np.full(count, row), marker, color=color, ms=3.0, mew=0.7)
        rank += count
    axis.set_ylim(-0.7, len(rows) - 0.3)
    axis.set_yticks(range(len(rows)), [f"{status}, {count}" for status, count in rows])
    axis.tick_params(labelbottom=False, bottom=False, left=False)
    axis.spines["bottom"].set_visible(False)
