"""Figures of time histories: the proof of match of a fit, and a simulated record."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from ..errors import DataError, UnknownName, did_you_mean
from ..fit_result import FitResult
from ..records import Record
from ..tolerance import Tolerance, tolerances_by_output
from .style import STYLE, WIDTH, figure_of, headline
from .time_panels import draw_channel, draw_residual

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["choose_record", "plot_fit", "plot_record", "plot_validation", "sigmas_of"]

# Inches. The figure fits between the margins of an A4 page; its own margins are fixed, not found from the
# labels, so that all time axes of a column are exactly as long.
_MAX_HEIGHT = 10.2
_OUTPUT, _STRIP, _INPUT_PANEL = 1.25, 0.42, 0.8  # heights
_INNER_GAP, _GAP = 0.05, 0.16
_LEFT, _RIGHT, _TOP, _BOTTOM = 0.78, 0.12, 0.56, 0.42
_LABEL = 0.53  # from the axis to the middle of its label
_TWO_COLUMNS_FROM = 7


def plot_fit(
    fit: FitResult,
    record: int | str = 0,
    channels: Sequence[str] | None = None,
    axes: Mapping[str, Axes] | None = None,
    tolerances: Mapping[str, float | Tolerance] | None = None,
) -> tuple[Figure, dict[str, Axes]]:
    """Proof of match of one experiment: per output measured points, the model's line, the residual beneath.

    fit         whose ``sigma_<output>`` gives the band of ±2σ.
    record      index or name of the experiment.
    channels    the outputs, inputs and states to show; None: all outputs, then all inputs.
    axes        name -> axes of your own to draw into; ``"<output> residual"`` takes the strip.
    tolerances  output -> greatest deviation in its unit, or a `Tolerance`: a band about the measurements, as flight
                simulators are qualified with (14 CFR Part 60), and the part of the samples within.

    Returns the figure and the axes by name. Raises UnknownName for a channel or a record that is not there, OptionError
    for a tolerance that is none.
    """
    chosen = choose_record(fit.records, record)
    limits = tolerances_by_output("plot", list(chosen.outputs), tolerances)
    return _draw(chosen, channels, axes, sigmas_of(fit, chosen), f"{fit.model.name}: {chosen.name}", limits)


def plot_validation(
    validation: Any, record: int | str = 0, channels: Sequence[str] | None = None
) -> tuple[Figure, dict[str, Axes]]:
    """`plot_fit` of a `Validation`, with its tolerances as bands about the measurements."""
    chosen = choose_record(validation.records, record)
    sigma = {name: m.sigma for name, m in validation.matches.items() if math.isfinite(m.sigma)}
    title = f"{validation.model.name}: {chosen.name}, validation"
    return _draw(chosen, channels, None, sigma, title, validation.tolerances)


def plot_record(
    record: Record,
    channels: Sequence[str] | None = None,
    axes: Mapping[str, Axes] | None = None,
    title: str | None = None,
) -> tuple[Figure, dict[str, Axes]]:
    """The time histories of one record, such as a simulation; measured points are drawn where there are any.

    Parameters, return value and errors as for `plot_fit`.
    """
    return _draw(record, channels, axes, {}, record.name if title is None else title)


def sigmas_of(fit: FitResult, record: Record) -> dict[str, float]:
    """Output -> standard deviation (scale) of its noise in a record: estimated, for all or for this one, or known."""
    found = dict(fit.noise.known_sigmas(tuple(record.outputs)))
    for name in record.outputs:
        for label in (f"sigma_{name}", f"sigma_{name}[{record.name}]"):
            if label in fit.parameters:
                found[name] = fit.parameters[label].value
    return found


def choose_record(records: Sequence[Record], which: int | str) -> Record:
    """The record of that index or name; UnknownName where there is none."""
    if isinstance(which, str):
        for record in records:
            if record.name == which:
                return record
        names = [record.name for record in records]
        raise UnknownName(f"there is no record '{which}'.{did_you_mean(which, names)} There are: {', '.join(names)}.")
    try:
        return records[which]
    except IndexError:
        raise UnknownName(f"there is no record {which}: the fit has {len(records)}, counted from 0") from None


def _draw(
    record: Record,
    channels: Sequence[str] | None,
    axes: Mapping[str, Axes] | None,
    sigma: Mapping[str, float],
    title: str,
    tolerances: Mapping[str, Tolerance] = MappingProxyType({}),
) -> tuple[Figure, dict[str, Axes]]:
    from matplotlib import rc_context

    if isinstance(channels, str):
        raise DataError(f"channels='{channels}' is text: give a list, such as channels=['{channels}']")
    if channels is None:
        everything = [*record.outputs, *(name for name in record.inputs if name not in record.outputs)]
        channels = everything if axes is None else [n for n in axes if not n.endswith(" residual")]
    known = [*record.outputs, *record.inputs, *record.states]
    for name in channels:
        if name not in known:
            raise UnknownName(
                f"record '{record.name}' has no channel '{name}'.{did_you_mean(name, known)} "
                f"There are: {', '.join(dict.fromkeys(known))}."
            )
    if not channels:
        raise DataError(f"record '{record.name}': there is no channel to plot")
    if axes is not None and not axes:
        raise DataError("axes={}: give at least one axis, or None for a new figure")
    with rc_context(STYLE):
        if axes is None:
            figure, panels = _layout(record, channels)
        else:
            panels = dict(axes)
            figure = figure_of(next(iter(panels.values())))
        for name in channels:
            if name in panels:
                draw_channel(panels[name], record, name, tolerances.get(name))
            if name in record.residuals and f"{name} residual" in panels:
                draw_residual(panels[f"{name} residual"], record, name, sigma.get(name), tolerances.get(name))
        if axes is None:
            _finish(figure, panels, title)
    return figure, panels


def _layout(record: Record, channels: Sequence[str]) -> tuple[Figure, dict[str, Axes]]:
    """A new figure: outputs (and states) on top, down the columns, each over its strip; inputs below them."""
    import matplotlib.pyplot as plt

    upper = [name for name in channels if name in record.outputs or name not in record.inputs]
    lower = [name for name in channels if name not in upper]
    columns = 2 if len(upper) >= _TWO_COLUMNS_FROM else 1
    upper_rows, lower_rows = math.ceil(len(upper) / columns), math.ceil(len(lower) / columns)
    upper_block = [_OUTPUT, _INNER_GAP, _STRIP, _GAP] if record.residuals else [_OUTPUT, _GAP]
    heights = upper_block * upper_rows + [_INPUT_PANEL, _GAP] * lower_rows
    del heights[-1]
    height = min(sum(heights) + _TOP + _BOTTOM, _MAX_HEIGHT)
    figure = plt.figure(figsize=(WIDTH, height))
    width = (WIDTH - columns * (_LEFT + _RIGHT)) / columns
    grid = figure.add_gridspec(
        len(heights),
        columns,
        height_ratios=heights,
        hspace=0.0,
        wspace=(_LEFT + _RIGHT) / width,
        left=_LEFT / WIDTH,
        right=1.0 - _RIGHT / WIDTH,
        bottom=_BOTTOM / height,
        top=1.0 - _TOP / height,
    )
    panels: dict[str, Axes] = {}
    share: Axes | None = None
    for i, name in enumerate(upper):
        row, column = len(upper_block) * (i % upper_rows), i // upper_rows
        last = row if name in record.residuals else row + len(upper_block) - 2
        panels[name] = share = figure.add_subplot(grid[row : last + 1, column], sharex=share)
        if name in record.residuals:
            panels[f"{name} residual"] = figure.add_subplot(grid[row + 2, column], sharex=share)
    for i, name in enumerate(lower):
        row = len(upper_block) * upper_rows + 2 * (i // columns)
        panels[name] = share = figure.add_subplot(grid[row, i % columns], sharex=share)
    for axis in panels.values():
        axis.yaxis.set_label_coords(-_LABEL / width, 0.5)
    return figure, panels


def _finish(figure: Figure, panels: Mapping[str, Axes], title: str) -> None:
    """Time labels at the foot of each column only, a title, and one legend for all panels."""
    lowest: dict[float, Axes] = {}
    handles: dict[str, Any] = {}
    for axis in panels.values():
        axis.tick_params(labelbottom=False)
        box = axis.get_position()
        if box.x0 not in lowest or box.y0 < lowest[box.x0].get_position().y0:
            lowest[box.x0] = axis
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    for axis in lowest.values():
        axis.tick_params(labelbottom=True)
        axis.set_xlabel("time, s")
    next(iter(panels.values())).margins(x=0.01)
    height = float(figure.get_size_inches()[1])
    left = _LEFT / WIDTH
    headline(figure, left, title)
    order = [
        name for name in ("measured", "tolerance", "model", "state", "input", "residual", "±2σ") if name in handles
    ]
    figure.legend(
        [handles[name] for name in order],
        order,
        loc="upper left",
        bbox_to_anchor=(left, 1.0 - 0.26 / height),
        ncols=len(order),
        frameon=False,
        borderpad=0.0,
        borderaxespad=0.0,
        columnspacing=1.6,
        markerscale=2.5,
    )
