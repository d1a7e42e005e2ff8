"""Measured conditions in planned manoeuvres: constant at their mean in the records, unless they are given."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..data.experiment import Experiment
from ..fit_result import FitResult
from ..modelling.model import Model

__all__ = ["condition_warnings", "with_conditions"]

# A condition that changes by less than this part of its size is constant.
_CONSTANT = 1e-9


def with_conditions(model: Model, fit: FitResult | None, runs: Sequence[Experiment]) -> list[Experiment]:
    """Return the manoeuvres with the conditions that they do not give: constant, at their mean in the records of the
    fit. Without a fit the manoeuvres are returned as they are."""
    if fit is None:
        return list(runs)
    return [_completed(model, fit, run) for run in runs]


def _completed(model: Model, fit: FitResult, run: Experiment) -> Experiment:
    lacking = [n for n in model.condition_names if n not in run.inputs and n not in run.channels]
    if not lacking:
        return run
    means = {n: float(np.mean(np.concatenate([r.inputs[n] for r in fit.records]))) for n in lacking}
    columns = run._columns_of()
    held = {n: np.full(run.n, mean) for n, mean in means.items()}
    said = ", ".join(f"{n} = {mean:.6g}" for n, mean in means.items())
    return run._stepped(
        f"conditions as in the records: {said}",
        {**columns, "input": {**columns["input"], **held}},
        run._signals_of(),
    )


def condition_warnings(model: Model, runs: Sequence[Experiment]) -> tuple[str, ...]:
    """Return a warning for each condition that a manoeuvre is planned to change."""
    found = []
    for run in runs:
        for name in model.condition_names:
            u = run.input(name)
            if np.ptp(u) > _CONSTANT * float(np.abs(u).max()):
                found.append(
                    f"'{name}' is a measured condition, not a control, and changes from {u.min():.4g} to "
                    f"{u.max():.4g} in '{run.name}': the plan holds only where it does so in flight"
                )
    return tuple(found)
