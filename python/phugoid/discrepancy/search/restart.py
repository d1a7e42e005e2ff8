"""Fits that ended at no optimum, estimated again or with one term more."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...data.experiment import Experiment
from ...errors import PhugoidError
from ...estimation import estimate
from ...filter_error import FilterError
from ...fit_result import ENDED_WELL, FitResult, dataset
from ...modelling.model import Model
from ...solvers import HINTS, check_time
from ...solvers.newton import Newton
from ...transcription import Transcription
from ..candidates.candidate import Candidate
from ..candidates.shared_terms import with_shared_terms
from .refit import Refit, refit, values_of
from .screen import complexity
from .segments import Segments, fitted_to_segments

__all__ = ["Restart", "of_shared_terms", "restarted", "with_optimum"]

# Iterations and seconds of each estimation, beside as many times what the fit itself took.
_ITERATIONS, _SECONDS, _TIMES = 400, 20.0, 5.0
# Log-likelihoods of one optimum differ by less.
_SAME = 0.1


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


def of_shared_terms(fit: FitResult) -> FitResult:
    """Return the fit of the same model with quantities declared for the terms that its equations share
    (`with_shared_terms`), estimated from there; the fit itself where there is none, or no such estimate."""
    model = with_shared_terms(fit.model)
    if model is fit.model or fit.status not in ENDED_WELL:
        return fit
    again = _estimated(fit, model, start=fit, transcription=fit.transcription)
    # The problem is the same: another optimum is not what was asked about.
    same = again is not None and abs(again.log_likelihood - fit.log_likelihood) < _SAME
    return again if again is not None and same else fit


def restarted(fit: FitResult, validation: Sequence[Experiment]) -> Restart:
    """Return a fit of the same model at an optimum: continued; with parameters fixed that the data do not determine;
    begun again from the measured path, or from the estimates on short segments; or that to the segments."""
    status = f"The fit that was given ended as '{fit.status}' ({fit.message or HINTS.get(fit.status, '')})"
    again = _estimated(fit, fit.model, start=fit) or _estimated(fit, fit.model)
    if again is not None:
        return Restart(again, f"{status}; it was estimated again, which converged, and that fit was diagnosed.")
    if fit.status == "unidentifiable":
        again, fixed = _with_fixed(fit)
        if again is not None:
            which = ", ".join(fixed)
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
                f"{status}; started again from the parameters estimated from short segments of the records it "
                "converged, and that fit was diagnosed.",
            )
        segments = Segments.of(pieces, length, validation)
        return Restart(
            near, f"{status}. It converged over short segments, each with initial states of its own.", segments
        )
    return Restart(
        None,
        f"{status}, and neither from the measured path nor over short segments of the records does an estimation "
        "converge. Residuals away from an optimum may be those of wrong parameters as well as of a wrong model, so "
        "that no cause can be named. Check units, signs, start values, bounds, and the records for biases and faults",
    )


def _with_fixed(fit: FitResult) -> tuple[FitResult | None, list[str]]:
    """Return an estimation that ended at an optimum with parameters fixed that the data do not determine, and these: as
    few as possible, for of a scale that is free one determines all others."""
    declared, fixed, now = fit.model.declared_parameters, list[str](), fit
    while now.status == "unidentifiable":
        left = [n for n, e in now.parameters.items() if not (e.fixed or np.isfinite(e.std_error))]
        left = [n for n in left if n in declared and n not in fixed and not declared[n].per_experiment]
        if not left:
            return None, []
        fixed.append(left[0])
        held = {n: replace(declared[n], start=fit.parameters[n].value, fixed=True) for n in fixed}
        following = _ended(fit, fit.model.with_parameters(held), now)
        if following is None:
            return None, []
        now = following
    return (now, fixed) if now.status in ENDED_WELL else (None, [])


def _estimated(
    fit: FitResult,
    model: Model,
    start: FitResult | dict[str, float] | None = None,
    transcription: Transcription | FilterError | None = None,
) -> FitResult | None:
    """Return an estimation from the same records that ended at an optimum; None else."""
    found = _ended(fit, model, start, transcription)
    return found if found is not None and found.status in ENDED_WELL else None


def _ended(
    fit: FitResult,
    model: Model,
    start: FitResult | dict[str, float] | None,
    transcription: Transcription | FilterError | None = None,
) -> FitResult | None:
    """Return an estimation from the same records, however it ended; None where it cannot be made."""
    check_time()
    solver = Newton(max_iterations=_ITERATIONS, time_limit=max(_SECONDS, _TIMES * fit.time))
    try:
        found = estimate(model, dataset(fit), transcription=transcription, noise=fit.noise, start=start, solver=solver)
    except (PhugoidError, np.linalg.LinAlgError):
        return None
    if found.status == "interrupted":
        raise KeyboardInterrupt
    return found


# Log-likelihood that a term must gain over a fit without an optimum, and how many of them are reported.
_MUCH, _REPORTED = 20.0, 3


def with_optimum(fit: FitResult, candidates: Sequence[Candidate]) -> list[Refit]:
    """Return the fits with a constant or linear term more in an equation of motion, or a quantity, that have an optimum
    where the model without has none, and are much likelier than that is where it was left; the likeliest first."""
    found = []
    for c in candidates:
        if c.place.kind not in ("equation", "quantity") or complexity(c) > 1 or not c.transferable:
            continue
        check_time()
        again = refit(fit, [c], {}, fit, measured=True)
        if again is not None and again.fit.log_likelihood > fit.log_likelihood + _MUCH:
            found.append(again)
    return sorted(found, key=lambda r: -r.fit.log_likelihood)[:_REPORTED]
