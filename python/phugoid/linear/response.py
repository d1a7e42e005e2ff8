"""A frequency response from one input to one output, estimated from a record or computed from a model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import cycle
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from ..figures import (
    BAND,
    MEASURED,
    MODEL,
    ORANGE,
    PURPLE,
    RESIDUAL,
    STATE,
    WIDTH,
    Panels,
    figure_of,
    headline,
    plain,
    styled,
    write_keys,
)
from ..notebook import overview, sparkline
from ..time_unit import SECONDS, TimeUnit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["FrequencyResponse", "plot_frequency_response"]

# Models differ in colour and in dashes, so that they do in grey too.
_MODELS = ((MODEL, "-"), (STATE, "--"), (PURPLE, "-."), (ORANGE, ":"))
# Inches: the left margin, the panels, the title, a row of the legend, what is below.
_LEFT, _MAGNITUDE, _SMALL, _HEAD, _ROW, _FOOT = 0.78, 2.9, 1.2, 0.34, 0.18, 0.45
_COLUMNS = 3


def plot_frequency_response(
    empirical: Any,
    *models: Any,
    phase: bool = False,
    coherence: bool = False,
    logarithmic: bool = False,
    band: tuple[float, float] | None = None,
    axes: Mapping[str, Axes] | None = None,
) -> tuple[Figure, dict[str, Axes]]:
    """Plot magnitude in dB over frequency in Hz: the empirical response as points, each model's as a line.

    empirical, models  `FrequencyResponse` objects of one input and output; a band of ±2 standard errors is drawn
                       where the empirical one has them.
    phase, coherence   panels of these beneath; the phase in degrees, the coherence of the empirical response.
    logarithmic        the axis of frequencies.
    band               ``(low, high)`` in Hz that is shown; None: that of the empirical response.
    axes               "magnitude", "phase", "coherence" -> axes of your own; those given are drawn.

    Returns the figure and the axes by name. Raises DataError where a model is of another input or output, or the
    coherence is asked for and not known, or nothing lies in the band.
    """
    for model in models:
        if (model.input, model.output) != (empirical.input, empirical.output):
            raise DataError(
                f"'{model.label}' is the response of {model.output} to {model.input}, and '{empirical.label}' that of "
                f"{empirical.output} to {empirical.input}: one figure shows one"
            )
    panel_names = ["magnitude", *["phase"] * phase, *["coherence"] * coherence] if axes is None else list(axes)
    for name in panel_names:
        if name not in ("magnitude", "phase", "coherence"):
            raise DataError(f"axes: there are magnitude, phase and coherence, but no '{name}'")
    if not panel_names:
        raise DataError("axes={}: give at least one axis, or None for a new figure")
    if "coherence" in panel_names and empirical.coherence is None:
        raise DataError(
            f"'{empirical.label}' has no coherence: take method='h1', smoothing or several periods in "
            "frequency_response"
        )
    with styled():
        rows = -(-(1 + len(models) + (empirical.std_error is not None)) // _COLUMNS)
        panels = _layout(panel_names, rows) if axes is None else dict(axes)
        figure = figure_of(panels[panel_names[0]])
        shown = empirical if band is None else empirical.band(*band)
        for name in panel_names:
            _draw(panels[name], name, shown, models)
        low, high = shown.frequencies_hz[[0, -1]] if band is None else band
        for name in panel_names:
            if logarithmic:
                panels[name].set_xscale("log")
            panels[name].set_xlim(low, high)
        panels[panel_names[-1]].set_xlabel(plain(f"frequency, {TimeUnit(empirical.time_unit).frequency}"))
        if axes is None:
            _finish(figure, panels["magnitude"], f"{empirical.output} from {empirical.input}")
    return figure, Panels(panels)


def _layout(panel_names: list[str], rows: int) -> dict[str, Axes]:
    """Create panels below one another, with room for the rows of a legend above."""
    import matplotlib.pyplot as plt

    heights = [_MAGNITUDE] + [_SMALL] * (len(panel_names) - 1)
    top = _HEAD + _ROW * rows
    height = sum(heights) + top + _FOOT + 0.12 * (len(panel_names) - 1)
    figure = plt.figure(figsize=(WIDTH, height))
    grid = figure.add_gridspec(
        len(panel_names),
        1,
        height_ratios=heights,
        hspace=0.12,
        left=_LEFT / WIDTH,
        right=1.0 - 0.15 / WIDTH,
        bottom=_FOOT / height,
        top=1.0 - top / height,
    )
    panels: dict[str, Axes] = {}
    for row, name in enumerate(panel_names):
        panels[name] = figure.add_subplot(grid[row, 0], sharex=panels[panel_names[0]] if row else None)
        panels[name].tick_params(labelbottom=row == len(panel_names) - 1)
    return panels


def _finish(figure: Figure, magnitude: Axes, title: str) -> None:
    left = _LEFT / WIDTH
    headline(figure, left, title)
    write_keys(figure, left, magnitude.get_legend_handles_labels()[0], _COLUMNS, fontsize=8.0)
    figure.align_ylabels()


def _draw(axis: Axes, name: str, empirical: Any, models: tuple[Any, ...]) -> None:
    f = empirical.frequencies_hz
    many = f.size > 5000  # as vectors, so many points would make a PDF heavy
    if name == "coherence":
        axis.plot(*_apart(f, empirical.coherence), color=RESIDUAL, linewidth=0.7, rasterized=many)
        axis.set_ylim(0.0, 1.02)
        axis.set_ylabel("coherence")
        return
    values = _values(empirical, name)
    label = plain(empirical.label or "empirical")
    style: dict[str, Any] = {"color": MEASURED, "marker": ".", "ms": 3.0 if f.size <= 400 else 1.5, "linewidth": 0.4}
    axis.plot(*_apart(f, values), label=label, rasterized=many, **style)
    for model, (color, dashes) in zip(models, cycle(_MODELS), strict=False):
        label = plain(model.label or "model")
        style = {"color": color, "linestyle": dashes, "linewidth": 1.1}
        axis.plot(model.frequencies_hz, _values(model, name), label=label, **style)
    if name == "magnitude" and empirical.std_error is not None:
        size, spread = empirical.magnitude, 2.0 * empirical.std_error
        # Below a hundredth of the response the lower bound says no more, and its logarithm ends nowhere.
        bounds = [np.maximum(size - spread, 0.01 * size), size + spread]
        with np.errstate(divide="ignore"):
            (where, low), (_, high) = (_apart(f, 20.0 * np.log10(bound)) for bound in bounds)
        axis.fill_between(where, low, high, color=BAND, linewidth=0.0, label="±2 standard errors", rasterized=many)
    if name == "phase":
        axis.set_ylim(-185.0, 185.0)
        axis.set_yticks([-180, -90, 0, 90, 180])
        axis.set_ylabel("phase, deg")
    else:
        unit = empirical.unit
        axis.set_ylabel(f"magnitude, dB{f' re 1 {plain(unit)}' if unit not in ('', '1') else ''}")
        finite = values[np.isfinite(values)]
        if finite.size:
            # The points set the range: a model may fall far below them.
            margin = 0.05 * max(float(np.ptp(finite)), 1.0)
            axis.set_ylim(float(finite.min()) - margin, float(finite.max()) + 2.0 * margin)


def _values(response: Any, name: str) -> Any:
    if name == "magnitude":
        return response.magnitude_db
    phase = response.phase_deg
    # A line through a jump from 180 to -180 degrees would cross the whole panel.
    jumps = np.flatnonzero(np.abs(np.diff(phase)) > 180.0)
    return np.where(np.isin(np.arange(phase.size), jumps), np.nan, phase)


def _apart(f: Any, values: Any) -> tuple[Any, Any]:
    """Return frequencies and values with NaN where frequencies were left out, so that no line bridges the gap."""
    steps = np.diff(f)
    gaps = np.flatnonzero(steps > 3.0 * np.median(steps)) + 1 if steps.size else np.zeros(0, dtype=np.intp)
    return np.insert(f, gaps, np.nan), np.insert(values, gaps, np.nan)


_Array: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """Response of ``output`` to ``input`` at F frequencies, estimated from a record or of a model.

    frequencies_hz  (F,): Hz, not negative, increasing.
    response        (F,), complex: Fourier transform of the output over that of the input, in ``unit``.
    input, output   names of the channels.
    label           what legends call it.
    coherence       (F,): part of the output's power that follows the input linearly, 0 to 1; None where not known.
    std_error       (F,): standard error of the magnitude, in ``unit``; None where not known.
    unit            of the response, such as "m/s²/N"; empty where it is not known.
    time_unit       of the model or the record, which frequencies are 1 over.

    Arrays are copied and made read-only. Raises DataError for shapes that differ, and frequencies out of order.

    >>> lag = FrequencyResponse(np.array([0.1, 1.0]), np.array([1.0, -0.1j]), "u", "y")
    >>> lag.magnitude_db, lag.phase_deg
    (array([  0., -20.]), array([  0., -90.]))
    """

    frequencies_hz: _Array
    response: NDArray[np.complex128]
    input: str
    output: str
    label: str = ""
    coherence: _Array | None = None
    std_error: _Array | None = None
    unit: str = ""
    time_unit: str = SECONDS

    def __post_init__(self) -> None:
        frequencies = np.array(self.frequencies_hz, dtype=np.float64)
        if frequencies.ndim != 1:
            raise DataError(f"{self._name}: frequencies_hz has shape {frequencies.shape}; give one list of them")
        in_order = np.isfinite(frequencies).all() and np.all(np.diff(frequencies) > 0) and not np.any(frequencies < 0)
        if not in_order:
            raise DataError(f"{self._name}: frequencies_hz are not all finite, not negative and increasing")
        for field in ("frequencies_hz", "response", "coherence", "std_error"):
            if getattr(self, field) is None:
                continue
            values = np.array(getattr(self, field), dtype=np.complex128 if field == "response" else np.float64)
            if values.shape != frequencies.shape:
                raise DataError(
                    f"{self._name}: {field} has shape {values.shape}, but there are {frequencies.size} frequencies"
                )
            values.setflags(write=False)
            object.__setattr__(self, field, values)

    @property
    def magnitude(self) -> _Array:
        """Absolute value, (F,), in the unit of the response."""
        return np.abs(self.response)

    @property
    def magnitude_db(self) -> _Array:
        """Magnitude in dB, (F,): 20 log10 of the absolute value; minus infinity where that is zero."""
        with np.errstate(divide="ignore"):
            return np.asarray(20.0 * np.log10(self.magnitude))

    @property
    def phase_deg(self) -> _Array:
        """Phase in degrees, (F,), from -180 to 180; negative where the output lags."""
        return np.asarray(np.angle(self.response, deg=True))

    def band(self, low: float, high: float) -> FrequencyResponse:
        """Return the part from ``low`` to ``high`` in Hz, both included; raise DataError where no frequency lies
        between."""
        kept = (self.frequencies_hz >= low) & (self.frequencies_hz <= high)
        if not kept.any():
            f = self.frequencies_hz
            span = TimeUnit(self.time_unit).per(f"they run from {f[0]:g} to {f[-1]:g}") if f.size else "there are none"
            raise DataError(f"{self._name}: no frequency lies between {low:g} and {high:g}; {span}")
        return replace(
            self,
            frequencies_hz=self.frequencies_hz[kept],
            response=self.response[kept],
            coherence=None if self.coherence is None else self.coherence[kept],
            std_error=None if self.std_error is None else self.std_error[kept],
        )

    def plot(self, *models: FrequencyResponse, **options: Any) -> tuple[Figure, dict[str, Axes]]:
        """Plot magnitude over frequency, this response as points and those of models as lines.

        ``options``: phase, coherence, logarithmic, band, axes, as for `frequency_plot.plot_frequency_response`.
        """

        return plot_frequency_response(self, *models, **options)

    @property
    def _name(self) -> str:
        return f"frequency response {self.input} to {self.output}"

    def _repr_html_(self) -> str:
        re = f" re 1 {self.unit}" if self.unit not in ("", "1") else ""
        curves = {f"magnitude, dB{re}": self.magnitude_db, "phase, deg": self.phase_deg}
        if self.coherence is not None:
            curves["coherence"] = self.coherence
        rows, pictures = [], {}
        for name, values in curves.items():
            known = np.where(np.isfinite(values), values, np.nan)
            there, f = known[np.isfinite(known)], self.frequencies_hz
            least, greatest = (f"{there.min():.4g}", f"{there.max():.4g}") if there.size else ("", "")
            rows.append([name, least, greatest])
            apart = f.size > 1 and f[0] > 0.0 and f[-1] > 10.0 * f[0]
            pictures[name] = sparkline(known, t=np.log(f) if apart else f)
        title = f"{self.input} to {self.output}" + (f", {self.label}" if self.label else "")
        return overview(title, (["", "least", "greatest"], rows, "lrr"), pictures=pictures, note=self._span())

    def _span(self) -> str:
        f = self.frequencies_hz
        span = f"{f.size} frequencies, {f[0]:g} to {f[-1]:g}" if f.size else ""
        return TimeUnit(self.time_unit).per(span) if span else "no frequencies"

    def __repr__(self) -> str:
        label = f", '{self.label}'" if self.label else ""
        return f"FrequencyResponse({self.input} to {self.output}{label}, {self._span()})"
