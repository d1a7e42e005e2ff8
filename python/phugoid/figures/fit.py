"""Figures of time histories: the proof of match of a fit, and a simulated record."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..data.filtering import kind_of
from ..errors import DataError, UnknownName, did_you_mean
from ..fit_result import FitResult
from ..goodness_of_fit import Tolerance, match, tolerances_by_output
from ..records import Record
from ..time_unit import TimeUnit, time_unit_of
from . import (
    BAND,
    INPUT,
    LIMIT,
    MEASURED,
    MODEL,
    RESIDUAL,
    STATE,
    TOLERANCE,
    WIDTH,
    Panels,
    figure_of,
    headline,
    labelled,
    plain,
    styled,
    with_gaps,
    write_keys,
)
from .ticks import prepare

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["choose_record", "draw_channel", "draw_residual", "plot_fit", "plot_record", "plot_validation", "sigmas_of"]

_Array: TypeAlias = NDArray[np.float64]

_LETTER = 0.58  # mean width of a letter, in units of the font's size
_FAR = 3.0  # a tolerance so many times as large as the data is left out of a panel's range


def draw_channel(axis: Axes, record: Record, name: str, tolerance: Tolerance | None = None) -> None:
    """Draw an output (measured points, model, band of the tolerance), an input or a state."""
    many = record.n > 5000  # as vectors, so many points would make a PDF heavy
    if name in record.outputs:
        if name in record.measured:
            if tolerance is not None:
                _draw_tolerance(axis, record, name, tolerance)
                _write_share(axis, record, name, tolerance)
            size = 2.0 if record.n <= 1000 else 1.2
            axis.plot(
                record.t,
                record.measured[name],
                ".",
                color=MEASURED,
                ms=size,
                label="measured",
                rasterized=many,
            )
        axis.plot(record.t, record.outputs[name], color=MODEL, linewidth=1.0, label="model", rasterized=many)
        if tolerance is not None and name in record.measured:
            _keep_in_view(axis, record, name, tolerance)
    elif name in record.inputs:
        steps = "steps-post" if kind_of(record.interpolation, name) == "hold" else "default"
        axis.plot(
            record.t, record.inputs[name], color=INPUT, linewidth=0.8, label="input", rasterized=many, drawstyle=steps
        )
    else:
        axis.plot(record.t, record.states[name], color=STATE, linewidth=0.9, label="state", rasterized=many)
    text = labelled(name, record.units)
    # The label must not reach into the panels above and below: two lines first, then smaller letters.
    room = 72.0 * axis.get_position().height * float(figure_of(axis).get_size_inches()[1]) / _LETTER
    if len(text) * 8.0 > room:
        text = text.replace(", ", ",\n")
    longest = max(map(len, text.split("\n")))
    axis.set_ylabel(plain(text), fontsize=min(7.0 if "\n" in text else 8.0, max(room / longest, 4.5)))
    axis.locator_params(axis="y", nbins=5)


def _measured(record: Record, name: str) -> list[tuple[_Array, _Array]]:
    """Return times and measurements in pieces between long gaps; a short gap does not end a piece."""
    there = np.isfinite(record.measured[name])
    t, z = record.t[there], record.measured[name][there]
    if t.size < 2:
        return []
    gaps = np.diff(t)
    pieces = np.flatnonzero(gaps > 5.0 * np.median(gaps)) + 1
    return list(zip(np.split(t, pieces), np.split(z, pieces), strict=True))


def _draw_tolerance(axis: Axes, record: Record, name: str, tolerance: Tolerance) -> None:
    """Draw the tolerance band about the measurements."""
    for t, z in _measured(record, name):
        low, high = z - tolerance.at(z), z + tolerance.at(z)
        axis.fill_between(t, low, high, color=TOLERANCE, alpha=0.55, linewidth=0.0, label="tolerance", zorder=0.5)


def _write_share(axis: Axes, record: Record, name: str, tolerance: Tolerance) -> None:
    """Write the part of the samples that lies within the tolerance above the panel."""
    inside = match(record, name, tolerance=tolerance).inside
    if inside == inside:
        within = tolerance.text(record.units.get(name, ""))
        axis.set_title(plain(f"{100.0 * inside:.1f} % within {within}"), loc="right", fontsize=6.5, pad=1.5)


def _keep_in_view(axis: Axes, record: Record, name: str, tolerance: Tolerance) -> None:
    """Limit the panel to the data where the tolerance band is far wider than these."""
    drawn = np.concatenate([record.measured[name], record.outputs[name]])
    drawn = drawn[np.isfinite(drawn)]
    span = float(np.ptp(drawn)) if drawn.size else 0.0
    if 0.0 < _FAR * span < float(np.nanmax(tolerance.at(record.measured[name]), initial=0.0)):
        axis.set_ylim(float(drawn.min()) - span, float(drawn.max()) + span)


def draw_residual(
    axis: Axes, record: Record, name: str, sigma: float | None, tolerance: Tolerance | None = None
) -> None:
    """Draw residuals about zero, the band of ±2σ and the limits of the tolerance."""
    residual = record.residuals[name]
    if sigma is not None:
        axis.axhspan(-2.0 * sigma, 2.0 * sigma, color=BAND, linewidth=0.0, label="±2σ")
    axis.axhline(0.0, color=INPUT, linewidth=0.5)
    many = record.n > 5000
    t, shown = _line_through(record.t, residual)
    axis.plot(t, shown, color=RESIDUAL, linewidth=0.6, label="residual", rasterized=many)
    # Symmetric about zero, so that a bias is seen at a glance.
    largest = float(np.nanmax(np.abs(residual))) if not np.isnan(residual).all() else 0.0
    limit = 1.08 * max(largest, 2.0 * (sigma or 0.0))
    if tolerance is not None:
        limit = _draw_limits(axis, record, name, tolerance, limit)
    if limit > 0.0:
        axis.set_ylim(-limit, limit)
    axis.locator_params(axis="y", nbins=3)
    axis.set_ylabel("resid.", fontsize=6.5)
    # The common factor of the ticks is written inside the strip: above, it would be in the panel of the output.
    axis.yaxis.get_offset_text().set(va="top", ha="left", size="small")


def _draw_limits(axis: Axes, record: Record, name: str, tolerance: Tolerance, limit: float) -> float:
    """Draw the limits of the tolerance, unless they are so far away that they would flatten the residuals; return the
    panel's limit."""
    widths = tolerance.at(record.measured[name])
    if not np.isfinite(widths).any() or np.nanmin(widths) >= _FAR * limit:
        return limit
    style: dict[str, Any] = {"color": LIMIT, "linewidth": 0.7, "linestyle": "--", "label": "tolerance"}
    for sign in (-1.0, 1.0):
        if not tolerance.relative:
            axis.axhline(sign * tolerance.absolute, **style)
        for t, z in _measured(record, name) if tolerance.relative else ():
            axis.plot(t, sign * tolerance.at(z), rasterized=record.n > 5000, **style)
    return max(limit, 1.08 * min(float(np.nanmax(widths)), _FAR * limit))


def _line_through(t: _Array, r: _Array) -> tuple[_Array, _Array]:
    """Return times and residuals for a line: unchanged, unless many samples stand alone between missing ones."""
    there = np.isfinite(r)
    alone = there & ~np.append(there[1:], False) & ~np.insert(there[:-1], 0, False)
    return with_gaps(t, r) if 3 * alone.sum() > there.sum() else (t, r)


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
    """Plot the proof of match of one experiment: for each output the measured points, the model, and the residuals
    beneath.

    fit         whose ``sigma_<output>`` gives the band of ±2σ.
    record      index or name of the experiment.
    channels    the outputs, inputs and states to show; None: all outputs, then all inputs.
    axes        name -> axes of your own to draw into; ``"<output> residual"`` takes the strip.
    tolerances  output -> greatest deviation in its unit, or a `Tolerance`: a band about the measurements, as flight
                simulators are qualified with (14 CFR Part 60), and the part of the samples within.

    Returns the figure and the axes by name. Raises UnknownName for an unknown channel or record, OptionError
    for an invalid tolerance.
    """
    chosen = choose_record(fit.records, record)
    limits = tolerances_by_output("plot", list(chosen.outputs), tolerances)
    return _draw(chosen, channels, axes, sigmas_of(fit, chosen), f"{fit.model.name}: {chosen.name}", limits)


def plot_validation(
    validation: Any, record: int | str = 0, channels: Sequence[str] | None = None
) -> tuple[Figure, dict[str, Axes]]:
    """Plot a `Validation` as `plot_fit` does, with its tolerances as bands about the measurements."""
    chosen = choose_record(validation.records, record)
    sigma = {name: m.sigma for name, m in validation.matches.items() if math.isfinite(m.sigma)}
    title = f"{validation.model.name}: {chosen.name}, validation"
    return _draw(chosen, channels, None, sigma, title, validation.tolerances)


def plot_record(
    record: Record, channels: Sequence[str] | None = None, title: str | None = None
) -> tuple[Figure, dict[str, Axes]]:
    """Plot the time histories of one record, such as a simulation, with the measured points where there are any.

    Parameters, return value and errors as for `plot_fit`.
    """
    return _draw(record, channels, None, {}, record.name if title is None else title)


def sigmas_of(fit: FitResult, record: Record) -> dict[str, float]:
    """Return output -> standard deviation (scale) of its noise in a record: estimated, shared or of this record, or
    known."""
    found = dict(fit.noise.known_sigmas(tuple(record.outputs)))
    for name in record.outputs:
        for label in (f"sigma_{name}", f"sigma_{name}[{record.name}]"):
            if label in fit.parameters:
                found[name] = fit.parameters[label].value
    return found


def choose_record(records: Sequence[Record], which: int | str) -> Record:
    """Return the record of that index or name; raise UnknownName where there is none."""
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
    record = record.without_rest()
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
    with styled():
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
            _finish(figure, panels, title, time_unit_of(record.units))
    return figure, Panels(panels)


def _layout(record: Record, channels: Sequence[str]) -> tuple[Figure, dict[str, Axes]]:
    """Create a figure: outputs (and states) on top, column by column, each above its residuals; inputs below them."""
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
        prepare(axis, _LABEL)
    return figure, panels


def _finish(figure: Figure, panels: Mapping[str, Axes], title: str, time: TimeUnit) -> None:
    """Add time labels at the foot of each column only, a title, and one legend for all panels."""
    lowest: dict[float, Axes] = {}
    handles: dict[str, Any] = {}
    for name, axis in panels.items():
        # The residuals beneath have the same times.
        axis.tick_params(bottom=f"{name} residual" not in panels, labelbottom=False)
        box = axis.get_position()
        if box.x0 not in lowest or box.y0 < lowest[box.x0].get_position().y0:
            lowest[box.x0] = axis
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    for axis in lowest.values():
        axis.tick_params(labelbottom=True)
        axis.set_xlabel(plain(time.axis()))
    next(iter(panels.values())).margins(x=0.01)
    left = _LEFT / WIDTH
    headline(figure, left, title)
    order = [
        name for name in ("measured", "tolerance", "model", "state", "input", "residual", "±2σ") if name in handles
    ]
    write_keys(figure, left, [handles[name] for name in order], below=0.26, markerscale=2.5)
