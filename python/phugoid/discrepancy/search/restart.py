"""A fit that ended at no optimum, estimated again in ways that stay nearer to the records, so that it can be diagnosed.

Why an estimation fails is often what a diagnosis is asked for: a model that lacks something, a large bias or noise on a
recorded input leads the path of a whole record astray. Over short segments with first states of their own it is not.
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
from .refit import Refit, values_of
from .segments import Segments, fitted_to_segments

__all__ = ["Restart", "restarted"]

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
