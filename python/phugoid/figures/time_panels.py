"""Panels of a time history: an output with what was measured, and the strip of its residuals."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..data.interpolation import kind_of
from ..match import match
from ..records import Record
from ..tolerance import Tolerance
from .style import (
    BAND,
    INPUT,
    LIMIT,
    MEASURED,
    MODEL,
    RESIDUAL,
    STATE,
    TOLERANCE,
    figure_of,
    labelled,
    plain,
    with_gaps,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_channel", "draw_residual"]

_Array: TypeAlias = NDArray[np.float64]

_LETTER = 0.58  # mean width of a letter, in units of the font's size
_FAR = 3.0  # a tolerance of so many times what a panel must show is left out of its range


def draw_channel(axis: Axes, record: Record, name: str, tolerance: Tolerance | None = None) -> None:
    """An output (measured points, model, band of the tolerance), an input or a state."""
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
    """Times and measurements between long gaps; a short one does not end a band."""
    there = np.isfinite(record.measured[name])
    t, z = record.t[there], record.measured[name][there]
    if t.size < 2:
        return []
    gaps = np.diff(t)
    pieces = np.flatnonzero(gaps > 5.0 * np.median(gaps)) + 1
    return list(zip(np.split(t, pieces), np.split(z, pieces), strict=True))


def _draw_tolerance(axis: Axes, record: Record, name: str, tolerance: Tolerance) -> None:
    """The band about the measurements that the model should stay in."""
    for t, z in _measured(record, name):
        low, high = z - tolerance.at(z), z + tolerance.at(z)
        axis.fill_between(t, low, high, color=TOLERANCE, alpha=0.55, linewidth=0.0, label="tolerance", zorder=0.5)


def _write_share(axis: Axes, record: Record, name: str, tolerance: Tolerance) -> None:
    """The part of the samples that lies within."""
    inside = match(record, name, tolerance=tolerance).inside
    if inside == inside:
        within = tolerance.text(record.units.get(name, ""))
        axis.set_title(plain(f"{100.0 * inside:.1f} % within {within}"), loc="right", fontsize=6.5, pad=1.5)


def _keep_in_view(axis: Axes, record: Record, name: str, tolerance: Tolerance) -> None:
    """A band far wider than what it is about reaches out of the panel, or nothing else would be seen."""
    drawn = np.concatenate([record.measured[name], record.outputs[name]])
    drawn = drawn[np.isfinite(drawn)]
    span = float(np.ptp(drawn)) if drawn.size else 0.0
    if 0.0 < _FAR * span < float(np.nanmax(tolerance.at(record.measured[name]), initial=0.0)):
        axis.set_ylim(float(drawn.min()) - span, float(drawn.max()) + span)


def draw_residual(
    axis: Axes, record: Record, name: str, sigma: float | None, tolerance: Tolerance | None = None
) -> None:
    """Residuals about zero, the band of ±2σ and the limits of the tolerance."""
    residual = record.residuals[name]
    if sigma is not None:
        axis.axhspan(-2.0 * sigma, 2.0 * sigma, color=BAND, linewidth=0.0, label="±2σ")
    axis.axhline(0.0, color=INPUT, linewidth=0.5)
    many = record.n > 5000
    t, shown = _seen(record.t, residual)
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
    # A common factor of the ticks belongs into the strip: above it, it would stand in the panel of the output.
    axis.yaxis.get_offset_text().set(va="top", ha="left", size="small")


def _draw_limits(axis: Axes, record: Record, name: str, tolerance: Tolerance, limit: float) -> float:
    """What residuals are held against, unless it is so far away that it would flatten them; gives the panel's limit."""
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


def _seen(t: _Array, r: _Array) -> tuple[_Array, _Array]:
    """For a line: as it is, unless so many samples stand alone between missing ones that little would be drawn."""
    there = np.isfinite(r)
    alone = there & ~np.append(there[1:], False) & ~np.insert(there[:-1], 0, False)
    return with_gaps(t, r) if 3 * alone.sum() > there.sum() else (t, r)
