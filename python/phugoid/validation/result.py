"""The result of a validation: a fitted model on experiments that it was not fitted to."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..figures import fit as plot
from ..goodness_of_fit import Match, Tolerance, match_rows
from ..modelling.model import Model
from ..modelling.noise import Noise
from ..notebook import bullets, overview, sparkline
from ..parameters import Estimates, estimates_html, estimates_table, facts_text, text_table
from ..records import Record, only

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Validation"]

_Array = NDArray[np.float64]

# Residuals are called coloured below this p-value, and their error an offset above this part of their mean square.
_WHITE, _MOSTLY = 0.01, 0.5
_WIDTH = 120  # of lines of text


@dataclass(frozen=True, eq=False, repr=False)
class Validation:
    """The result of `Fit.validate`: the model as fitted, with only initial states and biases re-estimated.

    model           as fitted.
    noise           that of the fit, every number known.
    fitted_to       names of the experiments that the fit was made on.
    records         one an experiment: measured, outputs, residuals, states.
    held            parameter -> fixed value.
    freed           estimates of the biases (and what else was named), with standard errors.
    initial_states  experiment -> state -> estimate of the state at the first sample. Standard errors, here and of
                    ``freed``, take held parameters for exact and the noise for that of the fit.
    log_likelihood  of these measurements, at the noise of the fit: as `Fit.log_likelihood`, without the constant
                    -N n_y/2 ln 2 pi. On the same experiments it compares models, the greater the better.
                    With process noise it is the marginal one.
    chi_square      sum of squared residuals over the fit's variances (r' R^-1 r where noise is correlated); NaN where
                    noise is not Gaussian or there is process noise. Where model and parameters are exact its
                    expectation is ``degrees_of_freedom``: the number of measured values minus what was estimated.
    matches         output -> `Match` over all experiments: Theil's coefficient and more. ``sigma`` in it is that of
                    the fit's noise.
    by_experiment   experiment -> output -> `Match`.
    status          "converged", or what else happened; ``message`` says what to do then.
    warnings        in words.
    tolerances      output -> `Tolerance`, as given.

    With process noise (`FilterError`) intensities are held too, initial states are integrated out, and outputs and
    residuals are those of predictions from the samples before, since the most probable path follows any measurements;
    ``sigma`` of a `Match` is what the root mean square of these residuals should be.
    """

    model: Model
    noise: Noise
    fitted_to: tuple[str, ...]
    records: Sequence[Record]
    held: Mapping[str, float]
    freed: Estimates
    initial_states: Mapping[str, Estimates]
    log_likelihood: float
    chi_square: float
    degrees_of_freedom: int
    matches: Mapping[str, Match]
    by_experiment: Mapping[str, Mapping[str, Match]]
    status: str
    message: str
    warnings: tuple[str, ...] = ()
    tolerances: Mapping[str, Tolerance] = field(default_factory=dict)

    @property
    def converged(self) -> bool:
        """Whether the initial states and biases were found."""
        return self.status == "converged"

    @property
    def residuals(self) -> Mapping[str, _Array]:
        """Output -> (N,) measured minus model, NaN where missing, of the only experiment; those of several are in
        ``records``.

        Raises DataError where there are several experiments.
        """
        return only(self.records, "validation", "residuals").residuals

    @property
    def _predicted(self) -> bool:
        return any(r.innovations for r in self.records)

    def summary(self) -> str:
        """Return the validation in plain text: fixed and re-estimated values, goodness of fit of each output, and its
        meaning."""
        parts = [facts_text(f"{self.model.name}: validation", self._entries())]
        if self.freed:
            parts.append(estimates_table(self.freed.values(), title="freed"))
        parts.append(text_table(*match_rows(self.matches.values())))
        if len(self.records) > 1:
            parts += [
                f"{name} alone\n{text_table(*match_rows(each.values()))}" for name, each in self.by_experiment.items()
            ]
        parts.append("\n".join(textwrap.fill(line, _WIDTH, subsequent_indent="  ") for line in self.in_words()))
        return "\n\n".join(parts) + "".join(f"\n\nWarning: {w}" for w in self.warnings)

    def plot(self, record: int | str = 0, channels: Sequence[str] | None = None) -> tuple[Figure, dict[str, Axes]]:
        """Plot the proof of match of an experiment: measured points with their tolerance bands, model, residuals,
        inputs. Return the figure and the axes by name, as `Fit.plot` does."""
        return plot.plot_validation(self, record, channels)

    def _repr_html_(self) -> str:
        entries, first = self._entries(), self.records[0]
        shown = [n for n in ("validated on", "log-likelihood", "chi-square") if n in entries]
        return overview(
            f"{self.model.name}: validation",
            bullets(f"{name}: {entries[name]}" for name in shown),
            estimates_html(self.freed.values()),
            match_rows(self.matches.values()),
            remarks=[*self.in_words(), *self.warnings],
            pictures={n: sparkline(z, first.outputs[n], first.t) for n, z in first.measured.items()},
            note=self.status,
        )

    def _entries(self) -> dict[str, str]:
        """Return the facts of the validation, by heading."""
        names = ", ".join(f"'{r.name}'" for r in self.records)
        samples = sum(m.samples for m in self.matches.values())
        first = sum(map(len, self.initial_states.values()))
        entries = {
            "validated on": f"{names}: {samples} measured values",
            "fitted to": ", ".join(f"'{name}'" for name in self.fitted_to),
            "status": f"{self.status}: {self.message}" if self.message else self.status,
            "fixed": ", ".join(self.held) or "nothing",
            "re-estimated": ", ".join([f"{first} initial states", *self.freed]),
            "log-likelihood": f"{self.log_likelihood:.3f} at the noise of the fit",
        }
        if self._predicted:
            entries["residuals"] = "of predictions from the samples before"
        if math.isfinite(self.chi_square):
            entries["chi-square"] = f"{self.chi_square:.1f} on {self.degrees_of_freedom} degrees of freedom"
        if self.noise.description:
            entries["noise"] = self.noise.description
        return entries

    def in_words(self) -> list[str]:
        """Return the meaning of the numbers, one sentence for each output."""
        lines = []
        for m in self.matches.values():
            if not m.samples:
                lines.append(f"{m.output}: nothing was measured that the model could be compared with.")
                continue
            if not math.isfinite(m.rms):
                lines.append(f"{m.output}: no motion of the model was found that could be compared.")
                continue
            said = []
            if math.isfinite(m.sigma):
                what = "the value that the fit predicts" if self._predicted else "the fit's noise"
                said.append(f"RMS is {m.rms / m.sigma:.2g} times {what}")
            if m.tolerance is not None:
                said.append(f"{100 * m.inside:.1f} % of the samples lie within {m.tolerance.text(m.unit)}")
            parts = {"a constant offset": m.bias, "a difference in amplitude": m.variance}
            said += [f"the error is mostly {what}" for what, part in parts.items() if part > _MOSTLY]
            if m.whiteness < _WHITE:
                said.append(f"its residuals are coloured (lag-1 correlation {m.lag_one:.2f})")
            elif math.isfinite(m.whiteness):
                said.append("its residuals are not significantly coloured")
            lines.append(f"{m.output}: {'; '.join(said)}.")
        return lines

    def __repr__(self) -> str:
        names = ", ".join(f"'{r.name}'" for r in self.records)
        return (
            f"<Validation of '{self.model.name}' on {names}: {self.status}, log-likelihood {self.log_likelihood:.6g}>"
        )

    def __str__(self) -> str:
        return self.summary()
