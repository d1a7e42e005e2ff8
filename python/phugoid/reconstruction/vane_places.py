"""Positions of vanes off the centre of gravity, tried in place of delays: which of the two the data prefer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..errors import PhugoidError
from ..noise.noise import Gaussian
from ..parameters import Estimate
from ..result import Fit

__all__ = ["VanePlaces", "compare_places"]

_Array = NDArray[np.float64]

# Parts of each record whose gains are treated as independent, since residuals are coloured.
_BLOCKS = 10
# Standard deviations from which on a gain is significant.
_CLEAR = 2.0
# Standard errors from which on a vane is off the centre of gravity.
_OFF = 3.0


@dataclass(frozen=True, eq=False, repr=False)
class VanePlaces:
    """A fit with the positions of vanes estimated, in place of the delays of these channels that were asked for.

    channels   those of ``alpha`` and ``beta`` whose vane was given no position.
    delayed    those of them that are delayed in the other fit.
    fit        with ``x_alpha_vane``, ``x_beta_vane`` (m ahead of the centre of gravity).
    gain       in log-likelihood over the other fit, on the samples that both have: a delayed sensor has none at first.
    deviation  its standard deviation, from the scatter between parts of the records, since residuals are coloured.
    """

    channels: tuple[str, ...]
    delayed: tuple[str, ...]
    fit: Fit
    gain: float
    deviation: float

    @property
    def preferred(self) -> bool | None:
        """Whether the data prefer positions (True) or the other fit (False) by two standard deviations; None: neither.
        A position that is preferred also differs from the centre of gravity by more than three standard errors."""
        if abs(self.gain) <= _CLEAR * self.deviation:
            return None
        if self.gain < 0.0:
            return False
        errors = self._errors
        off = any(abs(self.fit.parameters[n].value) > _OFF * errors[n] for n in map(_name, self.channels))
        return True if off else None

    @cached_property
    def _errors(self) -> dict[str, float]:
        """Standard errors, corrected for coloured residuals where that can be."""
        plain = {n: e.std_error for n, e in self.fit.parameters.items()}
        try:
            found = {n: e.std_error for n, e in self.fit.robust().parameters.items()}
        except PhugoidError:
            return plain
        return plain | {n: v for n, v in found.items() if np.isfinite(v)}

    def summary(self) -> str:
        """Return what was found, and what follows of it."""
        fit = self.fit
        shown = [_name(c) for c in self.channels]
        shown += [f"K_{c}" for c in self.channels if f"K_{c}" in fit.parameters]
        found = []
        for n in shown:
            e = fit.parameters[n]
            found.append(repr(Estimate(n, e.value, self._errors[n], e.unit)))
        instead = f" instead of delays of {' and '.join(self.delayed)}" if self.delayed else ""
        without = "delays" if self.delayed else "vanes at the centre of gravity"
        gain = f"log-likelihood {self.gain:+.0f} ± {self.deviation:.0f} on the same samples"
        verdict = {
            True: f"the data prefer positions to {without}",
            False: f"the data prefer {without}",
            None: f"the data do not distinguish positions from {without}",
        }[self.preferred]
        text = f"Positions of vanes estimated{instead}: {', '.join(found)}; {gain}: {verdict}."
        if self.preferred is False or (self.preferred is None and not self.delayed):
            return text
        given = ", ".join(f"{c}_vane=(x, y, z)" for c in self.channels)
        return (
            f"{text} A vane ahead of the centre of gravity by x reads like one that is delayed by x/V: give the "
            f"positions as measured on the aircraft, {given}, before any delay."
        )

    def __str__(self) -> str:
        return self.summary()

    def __repr__(self) -> str:
        return f"<Positions of vanes of {', '.join(self.channels)}: {self.gain:+.1f} ± {self.deviation:.1f}>"


def compare_places(fit: Fit, places: Fit, channels: Sequence[str]) -> VanePlaces | None:
    """Compare a fit with another of the same records that estimates places; None where they do not compare."""
    usable = ("converged", "acceptable")
    if fit.status not in usable or places.status not in usable:
        return None
    one, other = _log_densities(fit), _log_densities(places)
    if one is None or other is None:
        return None
    gains = np.array(
        [part.sum() for a, b in zip(one, other, strict=True) for part in np.array_split(np.nansum(b - a, 0), _BLOCKS)]
    )
    delayed = tuple(c for c in channels if c in fit.model.delays.outputs)
    deviation = float(np.sqrt(gains.size) * np.std(gains, ddof=1))
    return VanePlaces(tuple(channels), delayed, places, float(gains.sum()), deviation)


def _log_densities(fit: Fit) -> list[_Array] | None:
    """Return the log-density of each value (n_y, N) of each record, without the constant, NaN where missing; None for
    other than independent Gaussian noise."""
    outputs = fit.model.output_names
    known = fit.noise.known_sigmas(outputs)
    values = {n: fit.parameters[f"sigma_{n}"].value for n in outputs if f"sigma_{n}" in fit.parameters}
    sigma = {**known, **values}
    if not isinstance(fit.noise, Gaussian) or fit.noise.correlated or any(n not in sigma for n in outputs):
        return None
    return [
        np.array([-0.5 * (r.residuals[n] / sigma[n]) ** 2 - np.log(sigma[n]) for n in outputs]) for r in fit.records
    ]


def _name(channel: str) -> str:
    return f"x_{channel}_vane"
