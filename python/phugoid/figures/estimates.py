"""Figures of estimates: their intervals in one or several fits, and the convergence of the solver."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, OptionError, UnknownName, listing
from ..fit_result import FitResult
from ..parameters import Estimate, plus_minus
from . import (
    GREY,
    MEASURED,
    MODEL,
    RESIDUAL,
    RULE,
    SERIES,
    STATE,
    WIDTH,
    Panels,
    headline,
    plain,
    styled,
)
from .ticks import label_decades, linear_ticks, log_ticks, prepare

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["plot_convergence", "plot_parameters"]

_SIDE = 1.959963984540054  # standard errors on either side: 95 % of a normal distribution
_ROW, _MORE = 0.21, 0.09  # inches: a parameter, and each fit more
_PAGE, _LOWEST = 9.2, 0.1  # inches: all rows of a page, and the lowest of them
_PERCENT = 100.0  # the scale ends here: a longer interval includes zero
_SMALL = 0.01  # per cent; below, in millionths
_WIDE = 10.0  # times the median from which on the scale is logarithmic
_FAR = 3.0  # in comparisons the scale ends at so many times the median reach


def plot_parameters(
    fits: Sequence[Any], names: Sequence[str] | None = None, labels: Sequence[str] | None = None
) -> tuple[Figure, dict[str, Axes]]:
    """Plot estimates with the interval of ±1.96 standard errors, one row a parameter.

    Units differ, so rows are scaled. Of one fit: deviation from the estimate in per cent of it (in millionths where all
    are tiny), on a scale that is logarithmic away from zero where intervals differ much; one beyond 100 % includes
    zero. Of several: deviation from the estimate of the first fit, in its standard errors, so that its intervals are
    equally long and others are shown relative to its uncertainty. (A parameter that the first has no standard error of
    is scaled by the next fit that has one.) What reaches beyond the scale ends in an arrow, with the number
    beside it. On the right is the estimate of the first fit ± its standard error, as in tables.

    fits    with .parameters; fits, regressions or anything else that has them.
    names   the parameters to show, in this order; None: those of the model, without the noise's.
    labels  what the fits are called in the legend; None: by model or records, whichever differ.

    Standard errors are those of ``fit.parameters``, which take residuals for white. A parameter that no fit has a
    standard error of (fixed, or at a bound) is left out, and named at the foot of the figure.

    Returns the figure and the axes by ``"parameters"``. Raises UnknownName for a parameter that no fit has, DataError
    where there is none with a standard error, OptionError for labels that are not one a fit.
    """
    called = _labels(fits, labels)
    shown, without = _chosen(fits, names)
    rows = [_row(fits, name) for name in shown]
    limit = _limit(rows, len(fits))
    # With many parameters rows are lower, as far as their names can be read; then the figure grows beyond a page.
    row = min(_ROW + _MORE * (len(fits) - 1), max(_PAGE / len(shown), _LOWEST + 0.5 * _MORE * (len(fits) - 1)))
    letters = min(7.0, 72.0 * 0.85 * row)
    with styled() as plt:
        height = row * len(shown) + 0.95 + (0.18 if without else 0.0)
        figure, axis = plt.subplots(figsize=(WIDTH, height), layout="constrained")
        axis.axvline(0.0, color=GREY, linewidth=0.7, zorder=0.5)
        for i, each in enumerate(rows):
            if i % 2:
                axis.axhspan(i - 0.5, i + 0.5, color="#F5F5F5", linewidth=0.0, zorder=0.0)
            for j, interval in enumerate(each):
                if interval is not None:
                    at = i + (j - 0.5 * (len(fits) - 1)) * 0.7 / len(fits)
                    _draw(axis, at, *interval, limit, SERIES[j % len(SERIES)], alone=len(fits) == 1)
            axis.annotate(
                plain(_value(fits, shown[i])),
                (1.0, i),
                (6.0, 0.0),
                xycoords=axis.get_yaxis_transform(),
                textcoords="offset points",
                va="center",
                fontsize=letters,
                annotation_clip=False,
            )
        axis.set_yticks(range(len(shown)), [plain(name) for name in shown], fontsize=letters)
        axis.set_ylim(len(shown) - 0.5, -0.5)
        axis.tick_params(axis="y", length=0.0)
        if len(fits) == 1:
            _scale(axis, rows, limit)
        else:
            axis.set_xlim(-1.12 * limit, 1.12 * limit)
            axis.set_xlabel(plain(f"deviation from '{called[0]}', in its standard errors; 95 % intervals"))
            _legend(figure, called)
        title = getattr(getattr(fits[0], "model", None), "name", "") if len(fits) == 1 else ""
        figure.suptitle(plain(f"{title}: parameters" if title else "parameters"), x=0.01, ha="left", fontsize=9.5)
        if without:
            figure.supxlabel(plain(f"without a standard error: {', '.join(without)}"), fontsize=6.5, x=0.01, ha="left")
    return figure, Panels({"parameters": axis})


_Interval = tuple[float, float] | None  # deviation, and half of the interval's width, on the scale of its row


def _row(fits: Sequence[Any], name: str) -> list[_Interval]:
    there = [fit.parameters.get(name) for fit in fits]
    first = next(e for e in there if e is not None and e.std_error > 0.0)
    scale = first.std_error
    if len(fits) == 1:
        scale = abs(first.value) / _PERCENT
    found: list[_Interval] = []
    for e in there:
        if e is None:
            found.append(None)
            continue
        half = _SIDE * e.std_error if e.std_error > 0.0 else 0.0  # fixed: a point
        found.append(((e.value - first.value) / scale, half / scale) if scale > 0.0 else (0.0, math.inf))
    return found


def _limit(rows: Sequence[Sequence[_Interval]], fits: int) -> float:
    """Return where the scale ends: at the largest deviation, unless some lie far beyond the others."""
    reach = np.array([max(abs(v[0]) + v[1] for v in row if v is not None) for row in rows])
    largest = float(reach.max())
    if fits == 1:
        return min(largest, _PERCENT)
    usual = _FAR * float(np.median(reach))
    return largest if largest <= 1.3 * usual else usual


def _scale(axis: Axes, rows: Sequence[Sequence[_Interval]], limit: float) -> None:
    """Set the horizontal axis in per cent: linear, or logarithmic where intervals differ much in size."""
    from matplotlib.ticker import FuncFormatter, NullLocator

    halves = np.array([row[0][1] for row in rows if row[0] is not None])
    usual = float(np.median(halves))
    unit, size = ("%", 1.0) if limit > _SMALL else ("millionths", 1e4)
    if limit > _WIDE * usual:
        linear = 10.0 ** math.floor(math.log10(usual))
        axis.set_xscale("symlog", linthresh=linear, linscale=0.7)
        decades = [linear * 10.0**k for k in range(1 + math.floor(math.log10(limit / linear) + 1e-9))]
        axis.set_xticks([-d for d in reversed(decades)] + [0.0, *decades])
        axis.xaxis.set_minor_locator(NullLocator())
    margin = 1.12 if axis.get_xscale() == "linear" else 1.4
    axis.set_xlim(-margin * limit, margin * limit)
    axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value * size:g}".replace("-", "−")))
    kind = "" if axis.get_xscale() == "linear" else f" (logarithmic beyond ±{linear * size:g})"
    axis.set_xlabel(f"95 % interval, {unit} of the estimate{kind}")


def _draw(
    axis: Axes, at: float, middle: float, half: float, limit: float, style: tuple[str, str], *, alone: bool
) -> None:
    colour, marker = style
    low, high = max(middle - half, -limit), min(middle + half, limit)
    if low < high:
        axis.plot([low, high], [at, at], color=colour, linewidth=1.5, solid_capstyle="butt")
    for out, side in ((middle - half < -limit, -1.0), (middle + half > limit, 1.0)):
        if out:
            arrow = "<" if side < 0.0 else ">"
            axis.plot([side * 1.02 * limit], [at], arrow, color=colour, ms=4.0, clip_on=False, zorder=3)
    if abs(middle) <= limit:
        axis.plot([middle], [at], marker, color=colour, ms=4.0, mec="white", mew=0.5, label="estimate", zorder=3)
    if alone and half > limit:
        text, side, place = f"±{_percent(half)}", 1.0, 0.96 * limit
    elif abs(middle) > limit:
        side = math.copysign(1.0, middle)
        text, place = f"{middle:+.3g}".replace("-", "−"), side * 0.99 * limit
    else:
        return
    axis.annotate(
        text,
        (place, at),
        (-3.0 * side, 3.5 if alone else 0.0),
        textcoords="offset points",
        ha="right" if side > 0.0 else "left",
        va="center",
        fontsize=6.0,
        color=colour,
    )


def _percent(half: float) -> str:
    return f"{half:.0f} %" if half < 1e5 else "more than 100 000 %"


def _value(fits: Sequence[Any], name: str) -> str:
    """Return the text of the estimate that the row is about, with its standard error, as in tables."""
    first: Estimate = next(
        fit.parameters[name] for fit in fits if name in fit.parameters and fit.parameters[name].std_error > 0.0
    )
    return f"{plus_minus(first.value, first.std_error)} {first.unit}".rstrip().replace("-", "−", 1)


def _legend(figure: Figure, called: Sequence[str]) -> None:
    from matplotlib.lines import Line2D

    handles = []
    for j, text in enumerate(called):
        colour, marker = SERIES[j % len(SERIES)]
        handles.append(Line2D([], [], color=colour, marker=marker, ms=4.0, linewidth=1.5, label=plain(text)))
    figure.legend(handles=handles, loc="outside upper right", ncols=min(len(called), 3), frameon=False, fontsize=7.5)


def _labels(fits: Sequence[Any], labels: Sequence[str] | None) -> list[str]:
    if not fits:
        raise DataError("plot_parameters: give one fit or several")
    for fit in fits:
        if not hasattr(fit, "parameters"):
            raise DataError(f"plot_parameters: give fits, or other results with parameters, not a {type(fit).__name__}")
    if labels is not None:
        if isinstance(labels, str) or len(labels) != len(fits):
            raise OptionError(f"plot_parameters: labels={labels!r} must be a list of {len(fits)}, one for each fit")
        return [str(text) for text in labels]
    models = [str(getattr(getattr(fit, "model", None), "name", "")) for fit in fits]
    records = [", ".join(r.name for r in getattr(fit, "records", ())) for fit in fits]
    kinds = [type(fit).__name__.lower() for fit in fits]
    for names in (models, records, kinds, [f"{m}, {r}" for m, r in zip(models, records, strict=True)]):
        if len(set(names)) == len(fits) and all(names):
            return names
    return [f"fit {i}" for i in range(1, len(fits) + 1)]


def _chosen(fits: Sequence[Any], names: Sequence[str] | None) -> tuple[list[str], list[str]]:
    """Return the names to show, and those that no fit has a standard error of."""
    if isinstance(names, str):
        raise DataError(f"plot_parameters: names='{names}' is text: give a list, such as names=['{names}']")
    every = dict.fromkeys(name for fit in fits for name in fit.parameters)
    if names is None:
        noise = {name for fit in fits for name in getattr(fit, "noise_parameters", ())}
        chosen = [name for name in every if name not in noise]
    else:
        chosen = list(dict.fromkeys(names))
        for name in chosen:
            if name not in every:
                raise UnknownName(f"plot_parameters: there is no parameter '{name}'.{listing(name, every)}")
    known = {n for fit in fits for n, e in fit.parameters.items() if e.std_error > 0.0}
    shown = [name for name in chosen if name in known]
    if not shown:
        raise DataError("plot_parameters: no parameter has a standard error, so there is no interval to show")
    return shown, [name for name in chosen if name not in known]


_Array = NDArray[np.float64]

# Inches.
_PANEL, _GAP, _HEAD, _FOOT = 1.08, 0.32, 0.46, 0.4
_LEFT, _RIGHT = 0.42, 0.06
_SMALLEST = 1e-16  # of what is drawn; a zero has no logarithm


def plot_convergence(fit: FitResult) -> tuple[Figure, dict[str, Axes]]:
    """Plot each column of the iteration table over the iterations, on a logarithmic scale where it changes much.

    Log-likelihood: the distance from that of the last iteration; hollow where it was above, which a point can be that
    does not meet the equations yet. Defect: the largest scaled violation of the equations; zero with shooting, which
    has none. Distance from the optimum: what `Newton` expects the next step to gain in log-likelihood; with Ipopt the
    largest scaled entry of the gradient. Step: as a part of the full one; a ring where shorter ones had to be tried.

    Where iterations start again, as with mesh refinement, they are counted on, and a line marks the place.

    Returns the figure and the axes by ``"log-likelihood"``, ``"defect"``, ``"optimum"`` and ``"step"``. Raises
    DataError for a fit without iterations, such as one whose solver keeps no table.
    """
    history = list(fit.history)
    if not history:
        raise DataError("plot_convergence: the fit has no history of iterations")
    number = _consecutive([line.number for line in history])
    anew = [number[i] - 0.5 for i in range(1, len(history)) if history[i].number <= history[i - 1].number]
    likelihood = np.array([line.log_likelihood for line in history], dtype=float)
    names = ("log-likelihood", "defect", "optimum", "step")
    with styled() as plt:
        height = 2.0 * _PANEL + _GAP + _HEAD + _FOOT
        frame = {
            "left": _LEFT / WIDTH,
            "right": 1.0 - _RIGHT / WIDTH,
            "bottom": _FOOT / height,
            "top": 1.0 - _HEAD / height,
            "hspace": _GAP / _PANEL,
            "wspace": (_LEFT + _RIGHT) / (0.5 * WIDTH - _LEFT - _RIGHT),
        }
        figure, panels = plt.subplots(2, 2, sharex=True, figsize=(WIDTH, height), gridspec_kw=frame)
        axes: dict[str, Any] = dict(zip(names, panels.flat, strict=True))
        for axis in axes.values():
            prepare(axis, _LEFT)
        below = likelihood[-1] - likelihood
        _draw_iterations(axes["log-likelihood"], number[:-1], np.abs(below[:-1]), MEASURED, hollow=below[:-1] < 0.0)
        _draw_iterations(axes["defect"], number, np.array([line.defect for line in history]), MODEL)
        _draw_iterations(axes["optimum"], number, np.array([line.dual for line in history]), STATE)
        taken = np.array([line.trials for line in history])
        steps = np.array([line.step for line in history])
        moved = taken > 0  # at the start there is no step
        _draw_iterations(axes["step"], number[moved], steps[moved], RESIDUAL)
        again = moved & (taken > 1)
        if again.any():
            axes["step"].plot(number[again], steps[again], "o", mfc="none", mec=MODEL, ms=7.0, mew=0.9, label="retried")
            axes["step"].legend(frameon=False, fontsize=7.0, loc="best")
        titles = (
            f"log-likelihood, distance from the last, {likelihood[-1]:.8g}",
            "defect, largest scaled",
            "distance from the optimum",
            "step, part of the full one",
        )
        for axis, title in zip(axes.values(), titles, strict=True):
            logarithmic = axis.get_yscale() == "log"
            # There is nothing above a logarithmic axis; above others the factor of its numbers may be.
            axis.set_title(title, fontsize=8.0, loc="left", y=1.0 if logarithmic else None)
            axis.xaxis.set_major_locator(linear_ticks(integer=True))
            if logarithmic:
                axis.yaxis.set_major_locator(log_ticks(numticks=6))
                label_decades(axis.yaxis)
            for place in anew:
                axis.axvline(place, color=RULE, linewidth=0.8, linestyle="--", zorder=0.5)
        for axis in panels[-1]:
            axis.set_xlabel("iteration")
        status = f"{fit.model.name}: {fit.status} after {fit.iterations} iterations, {fit.time:.2g} s"
        headline(figure, 0.01, status)
    return figure, Panels(axes)


def _consecutive(numbers: Sequence[int]) -> _Array:
    """Return the numbers, counted on where the table starts again."""
    found: list[int] = []
    offset = 0
    for i, number in enumerate(numbers):
        if i and number <= numbers[i - 1]:
            offset = found[-1] + 1 - number
        found.append(number + offset)
    return np.array(found, dtype=float)


def _draw_iterations(
    axis: Axes, number: _Array, values: _Array, colour: str, hollow: NDArray[np.bool_] | None = None
) -> None:
    values = np.where(np.isfinite(values), values, np.nan)
    axis.set_yscale("log")
    shown = values > _SMALLEST
    if not shown.any():
        axis.text(
            0.5, 0.5, "zero, or none, throughout", transform=axis.transAxes, ha="center", va="center", fontsize=7.0
        )
        axis.set_yscale("linear")
        axis.set_yticks([])
        return
    axis.plot(number, np.where(shown, values, np.nan), color=colour, linewidth=0.9)
    hollow = np.zeros(number.size, dtype=bool) if hollow is None else hollow
    for which, face in ((~hollow, colour), (hollow, "white")):
        chosen = which & shown
        axis.plot(number[chosen], values[chosen], "o", ms=3.5, mfc=face, mec=colour, mew=0.9)
    low, high = float(np.nanmin(values[shown])), float(np.nanmax(values[shown]))
    if high < 10.0 * low:
        axis.set_yscale("linear")
        axis.set_ylim(0.0, 1.15 * high)
