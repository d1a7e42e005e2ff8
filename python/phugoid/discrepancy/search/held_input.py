"""Inputs that are held between their samples, and that a record was taken to join by straight lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ...data.experiment import Experiment
from ...errors import PhugoidError
from ...estimation.estimate import estimate
from ...fit_result import FitResult
from ...sensitivities.collocated import dataset
from ...solvers import Newton
from .free_run import Explained, Misfitting, Simulated
from .refit import HeldOut, Refit, gain_on_other_data, on_other_data

__all__ = ["HeldInput", "held_input"]

# Log-likelihood by which a held input must be ahead of all else that it is compared with.
_MARGIN = 8.0
_ITERATIONS = 40


@dataclass(frozen=True, eq=False)
class HeldInput:
    """An input that is held.

    name        of the input.
    refit       the fit with it held.
    validation  the other records with it held.
    gain        in log-likelihood, coloured noise.
    held_out    the same on the other records; None without any.
    explained   what it explains of their misfit in free simulation; None without any.
    """

    name: str
    refit: Refit
    validation: Sequence[Experiment]
    gain: float
    held_out: HeldOut | None
    explained: Explained | None


def held_input(base: Refit, validation: Sequence[Experiment], free: Sequence[str] | None) -> HeldInput | None:
    """Return the input that the data say is held between its samples, the clearest of them; None where there is none.

    A delay of half a sample does nearly the same: where a held input predicts other data better than straight lines do,
    it is named first, since it has no parameter.
    """
    fit = base.fit
    data = dataset(fit)
    found: HeldInput | None = None
    for name in fit.model.declared_inputs:
        if any(e.interpolation_of(name) == "hold" or e.signal(name) is not None for e in data):
            continue
        refit = _with(fit, _held(data, name))
        if refit is None or refit.merit - base.merit < max(_MARGIN, found.gain if found else 0.0):
            continue
        other = _held(validation, name)
        gain, explained = None, None
        if validation:
            try:
                before, after = on_other_data(base, validation, None, free), on_other_data(refit, other, None, free)
            except PhugoidError:
                continue
            gain = gain_on_other_data(before, after)
            explained = Simulated.of(after).explained(Simulated.of(before), Misfitting.of(before))
            if gain.gain <= 0.0 or not explained.significant:
                continue
        found = HeldInput(name, refit, other, refit.merit - base.merit, gain, explained)
    return found


def _held(data: Sequence[Experiment], name: str) -> list[Experiment]:
    return [e.with_interpolation({name: "hold"}) for e in data]


def _with(fit: FitResult, data: Sequence[Experiment]) -> Refit | None:
    """The same estimate from other records; None where it does not come to an end."""
    try:
        found = estimate(
            fit.model,
            data,
            transcription=fit.transcription,
            noise=fit.noise,
            start=fit,
            solver=Newton(max_iterations=_ITERATIONS),
        )
    except PhugoidError:
        return None
    return Refit((), found) if found.status in ("converged", "acceptable") else None
