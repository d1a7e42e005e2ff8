"""Panels of a time history: an output with what was measured, and the strip of its residuals."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .figure_style import (
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
from .match import match
from .records import Record

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_channel", "draw_residual"]

_LETTER = 0.58  # mean width of a letter, in units of the font's size
_FAR = 3.0  # a tolerance of so many times what a panel must show is left out of its range


def draw_channel(axis: Axes, record: Record, name: str, tolerance: float | None = None) -> None:
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
        axis.plot(record.t, record.inputs[name], color=INPUT, linewidth=0.8, label="input", rasterized=many)
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


def _draw_tolerance(axis: Axes, record: Record, name: str, tolerance: float) -> None:
    """The band about the measurements that the model should stay in; a short gap does not end it."""
    there = np.isfinite(record.measured[name])
    t, z = record.t[there], record.measured[name][there]
    if t.size < 2:
        return
    gaps = np.diff(t)
    pieces = np.flatnonzero(gaps > 5.0 * np.median(gaps)) + 1
    for part, values in zip(np.split(t, pieces), np.split(z, pieces), strict=True):
        low, high = values - tolerance, values + tolerance
        axis.fill_between(part, low, high, color=TOLERANCE, alpha=0.55, linewidth=0.0, label="tolerance", zorder=0.5)


def _write_share(axis: Axes, record: Record, name: str, tolerance: float) -> None:
    """The part of the samples that lies within."""
    inside = match(record, name, tolerance=tolerance).inside
    if inside == inside:
        unit = record.units.get(name, "")
        size = f"{tolerance:.4g}{'' if unit in ('', '1', '-') else f' {unit}'}"
        axis.set_title(plain(f"{100.0 * inside:.1f} % within ±{size}"), loc="right", fontsize=6.5, pad=1.5)


def _keep_in_view(axis: Axes, record: Record, name: str, tolerance: float) -> None:
    """A band far wider than what it is about reaches out of the panel, or nothing else would be seen."""
    drawn = np.concatenate([record.measured[name], record.outputs[name]])
    drawn = drawn[np.isfinite(drawn)]
    span = float(np.ptp(drawn)) if drawn.size else 0.0
    if 0.0 < _FAR * span < tolerance:
        axis.set_ylim(float(drawn.min()) - span, float(drawn.max()) + span)


def draw_residual(axis: Axes, record: Record, name: str, sigma: float | None, tolerance: float | None = None) -> None:
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
    if tolerance is not None and tolerance < _FAR * limit:  # one far away would flatten the residual
        limit = max(limit, 1.08 * tolerance)
        for side in (-tolerance, tolerance):
            axis.axhline(side, color=LIMIT, linewidth=0.7, linestyle="--", label="tolerance")
    if limit > 0.0:
        axis.set_ylim(-limit, limit)
    axis.locator_params(axis="y", nbins=3)
    axis.set_ylabel("resid.", fontsize=6.5)
    # A common factor of the ticks belongs into the strip: above it, it would stand in the panel of the output.
    axis.yaxis.get_offset_text().set(va="top", ha="left", size="small")


def _seen(t: NDArray[np.float64], r: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """For a line: as it is, unless so many samples stand alone between missing ones that little would be drawn."""
    there = np.isfinite(r)
    alone = there & ~np.append(there[1:], False) & ~np.insert(there[:-1], 0, False)
    return with_gaps(t, r) if 3 * alone.sum() > there.sum() else (t, r)
