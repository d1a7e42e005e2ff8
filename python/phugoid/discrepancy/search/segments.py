"""Records cut into segments, each with first states of its own, where a simulation of the whole drifts away from them.

Of a system that integrates, is unstable, or stands in a closed loop, whose inputs go by what it does, a free simulation
with a model that lacks something ends far from the record. To first order about such a motion next to nothing is true:
a friction has the wrong sign of the rate, and a term that holds the motion near the record looks like the cause.
Simulated over a horizon, the motion stays near what was measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...data.experiment import Experiment
from ...fit_result import dataset
from .evidence import is_structured
from .refit import Refit, fitted_to, values_of

__all__ = ["Segments", "fitted_to_segments", "segments_of", "short_segments"]

# Segments of all records, and samples that each has at least: a tenth of a record holds a few of the motions that the
# record was made for. Short ones, about which candidates are proposed, are as many as these samples allow.
_COUNT, _SHORT, _SAMPLES = 10, 80, 40
# Part of the residuals' power that is predictable, from which on the model is thought far from the record.
_ERROR = 0.5
# Part of the RMS of every output that is left over segments, where it is the drift that made the rest. A stable
# system, which forgets its first states, keeps more.
_LEFT = 0.25


@dataclass(frozen=True)
class Segments:
    """The fit to the records in segments, validation records likewise, and how long a segment is, in s."""

    base: Refit
    validation: Sequence[Experiment]
    horizon: float

    @staticmethod
    def of(base: Refit, length: int, validation: Sequence[Experiment]) -> Segments:
        """Return the segments of a fit to them, and validation records cut likewise into ``length`` samples each."""
        horizon = float(np.median([e.t[-1] - e.t[0] for e in dataset(base.fit)]))
        return Segments(base, [piece for e in validation for piece in _cut(e, length)], horizon)

    @property
    def note(self) -> str:
        """The note for the user."""
        return (
            f"Over a whole record the simulation drifts away from what was measured. It was simulated over segments of "
            f"{self.horizon:.3g} s, each with its own first states, and so were the data held out."
        )


def segments_of(base: Refit, validation: Sequence[Experiment]) -> Segments | None:
    """Return the records of a fit in segments, where the model is far from the records as a whole and much nearer to
    segments of them; None else, and where first states or parameters belong to a whole record."""
    fit = base.fit
    found, length = fitted_to_segments(base, _COUNT) if is_structured(base, _ERROR) else (None, 0)
    if found is None:
        return None
    for name in fit.model.output_names:
        before, after = (np.concatenate([r.residuals[name] for r in f.fit.records]) for f in (base, found))
        if not np.nanmean(after**2) < _LEFT**2 * np.nanmean(before**2):
            return None
    return Segments.of(found, length, validation)


def short_segments(base: Refit) -> Refit | None:
    """Return the fit to many short segments, along which the motion is nearly that of the record, where the model is
    far from it over longer ones; None else."""
    return fitted_to_segments(base)[0] if is_structured(base, _ERROR) else None


def fitted_to_segments(base: Refit, most: int = _SHORT) -> tuple[Refit | None, int]:
    """Return the model of a fit estimated from segments of its records, ``most`` of them or fewer, and the number of
    their samples; None where that is not possible."""
    fit, records = base.fit, dataset(base.fit)
    own = [n for n, p in fit.model.declared_parameters.items() if p.per_experiment]
    samples = sum(e.n for e in records)
    count = min(most, samples // _SAMPLES)
    if own or fit.model.end_conditions or count < 2 * len(records):
        return None, 0
    length = -(-samples // count)
    # The path is begun anew: that of the fit is the one that drifts.
    pieces = [piece for e in records for piece in _cut(e, length)]
    return fitted_to(Refit((), fit), pieces, start=values_of(fit), solver=None), length


def _cut(e: Experiment, length: int) -> list[Experiment]:
    """Return a record in parts of about so many samples."""
    parts = np.array_split(np.arange(e.n), max(round(e.n / length), 1))
    if len(parts) == 1:
        return [e]
    return [e.window(e.t[p[0]], e.t[p[-1]], name=f"{e.name} from {e.t[p[0]]:.4g} s") for p in parts]
