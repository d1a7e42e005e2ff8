"""A frequency response from one input to one output: what records show, and what models say."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["FrequencyResponse"]

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
        """The part from ``low`` to ``high`` in Hz, both included; DataError where no frequency lies between."""
        kept = (self.frequencies_hz >= low) & (self.frequencies_hz <= high)
        if not kept.any():
            f = self.frequencies_hz
            span = f"they run from {f[0]:g} to {f[-1]:g} Hz" if f.size else "there are none"
            raise DataError(f"{self._name}: no frequency lies between {low:g} and {high:g} Hz; {span}")
        return replace(
            self,
            frequencies_hz=self.frequencies_hz[kept],
            response=self.response[kept],
            coherence=None if self.coherence is None else self.coherence[kept],
            std_error=None if self.std_error is None else self.std_error[kept],
        )

    def plot(self, *models: FrequencyResponse, **options: Any) -> tuple[Figure, dict[str, Axes]]:
        """Magnitude over frequency, this response as points and those of models as lines.

        ``options``: phase, coherence, logarithmic, band, axes, as for `frequency_plot.plot_frequency_response`.
        """
        from ..figures.frequency import plot_frequency_response

        return plot_frequency_response(self, *models, **options)

    @property
    def _name(self) -> str:
        return f"frequency response {self.input} to {self.output}"

    def __repr__(self) -> str:
        f = self.frequencies_hz
        span = f"{f.size} frequencies, {f[0]:g} to {f[-1]:g} Hz" if f.size else "no frequencies"
        label = f", '{self.label}'" if self.label else ""
        return f"FrequencyResponse({self.input} to {self.output}{label}, {span})"
