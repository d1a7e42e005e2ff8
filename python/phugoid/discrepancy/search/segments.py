"""Records cut into segments, each with first states of its own, where a simulation of the whole drifts away from them.

Of a system that integrates, is unstable, or stands in a closed loop, whose inputs go by what it does, a free simulation
with a model that lacks something ends far from the record. To first order about such a motion next to nothing is true:
a friction has the wrong sign of the rate, and a term that holds the motion near the record looks like the cause.
Simulated over a horizon, the motion stays near what was measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...data.experiment import Experiment
from ...errors import PhugoidError
from ...estimation import estimate
from ...fit_result import ENDED_WELL, FitResult, dataset
from ...modelling.model import Model
from ...solvers import HINTS, Newton
from ...solvers.solution import check_time
from .evidence import is_structured
from .refit import Refit, fitted_to, values_of

__all__ = [
    "Restart",
    "Segments",
    "fitted_to_segments",
    "restarted",
    "segments_of",
    "short_segments",
]

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


# Iterations and seconds of each estimation, beside as many times what the fit itself took.
_ITERATIONS, _SECONDS, _TIMES = 400, 20.0, 5.0


@dataclass(frozen=True, eq=False)
class Restart:
    """Says what became of a fit that ended at no optimum.

    fit       at an optimum; None where no estimation ended there.
    words     what was done, and what the status of the first fit means for the diagnosis.
    segments  of the records, where only these can be fitted.
    """

    fit: FitResult | None
    words: str
    segments: Segments | None = None


def restarted(fit: FitResult, validation: Sequence[Experiment]) -> Restart:
    """Return a fit of the same model at an optimum: continued; with parameters fixed that the data do not determine;
    begun again from the measured path, or from what short segments tell; or that to the segments."""
    status = f"The fit that was given ended as '{fit.status}' ({fit.message or HINTS.get(fit.status, '')})"
    again = _estimated(fit, fit.model, start=fit) or _estimated(fit, fit.model)
    if again is not None:
        return Restart(again, f"{status}; it was estimated again, which converged, and that fit was diagnosed.")
    undetermined = [n for n, e in fit.parameters.items() if not (e.fixed or np.isfinite(e.std_error))]
    declared = fit.model.declared_parameters
    undetermined = [n for n in undetermined if n in declared and not declared[n].per_experiment]
    if fit.status == "unidentifiable" and undetermined:
        fixed = {n: replace(declared[n], start=fit.parameters[n].value, fixed=True) for n in undetermined}
        again = _estimated(fit, fit.model.with_parameters(fixed), start=fit)
        if again is not None:
            which = ", ".join(undetermined)
            return Restart(
                again, f"{status}; the model was diagnosed with {which} fixed, which the data do not determine."
            )
    pieces, length = fitted_to_segments(Refit((), fit))
    if pieces is not None:
        near = pieces.fit
        again = _estimated(fit, fit.model, start=values_of(near))
        if again is not None:
            return Restart(
                again,
                f"{status}; begun again with the parameters that short segments of the records determine it converged, "
                "and that fit was diagnosed.",
            )
        segments = Segments.of(pieces, length, validation)
        return Restart(near, f"{status}. Over short segments, each with its own first states, it converged.", segments)
    return Restart(
        None,
        f"{status}, and neither from the measured path nor over short segments of the records does an estimation "
        "converge. Residuals away from an optimum may be those of wrong parameters as well as of a wrong model, so "
        "that no cause can be named. Check units, signs, start values, bounds, and the records for biases and faults",
    )


def _estimated(fit: FitResult, model: Model, start: FitResult | dict[str, float] | None = None) -> FitResult | None:
    """Return an estimation from the same records that ended at an optimum; None else."""
    check_time()
    solver = Newton(max_iterations=_ITERATIONS, time_limit=max(_SECONDS, _TIMES * fit.time))
    try:
        found = estimate(model, dataset(fit), noise=fit.noise, start=start, solver=solver)
    except (PhugoidError, np.linalg.LinAlgError):
        return None
    if found.status == "interrupted":
        raise KeyboardInterrupt
    return found if found.status in ENDED_WELL else None
