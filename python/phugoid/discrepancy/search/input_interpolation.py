"""Inputs that are held between their samples, or smooth, where a record was taken to join these by straight lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from ...data.experiment import Experiment
from ...errors import PhugoidError
from ...sensitivities.collocated import dataset
from .free_run import Explained, Misfitting, Simulated
from .refit import HeldOut, Refit, fitted_to, gain_on_other_data, on_other_data

__all__ = ["InputInterpolation", "input_interpolation"]

# Log-likelihood by which another interpolation must be ahead of straight lines.
_MARGIN = 8.0


@dataclass(frozen=True, eq=False)
class InputInterpolation:
    """How an input behaves between its samples.

    name        of the input.
    kind        "hold": constant until the next sample; "cubic": smooth.
    refit       the fit with it so.
    validation  the other records with it so; those that are no better so as they are.
    gain        in log-likelihood, coloured noise.
    held_out    the same on the other records; None without any.
    explained   what it explains of their misfit in free simulation; None without any.
    """

    name: str
    kind: Literal["hold", "cubic"]
    refit: Refit
    validation: Sequence[Experiment]
    gain: float
    held_out: HeldOut | None
    explained: Explained | None


def input_interpolation(
    base: Refit, validation: Sequence[Experiment], free: Sequence[str] | None
) -> InputInterpolation | None:
    """Return the input that the data say is held between its samples, or smooth, the clearest of them; None where there
    is none.

    A delay of half a sample does nearly the same as an input that is held: where that predicts other data better than
    straight lines do, it is named first, since it has no parameter.
    """
    data = dataset(base.fit)
    found: InputInterpolation | None = None
    kinds: tuple[Literal["hold", "cubic"], ...] = ("hold", "cubic")
    for name in base.fit.model.declared_inputs:
        if any(e.interpolation_of(name) != "linear" or e.signal(name) is not None for e in data):
            continue
        for kind in kinds:
            refit = fitted_to(base, _with(data, name, kind))
            if refit is None or refit.merit - base.merit < max(_MARGIN, found.gain if found else 0.0):
                continue
            other = _with(validation, name, kind)
            gain, explained = None, None
            if validation:
                try:
                    before, after = on_other_data(base, validation, None, free), on_other_data(refit, other, None, free)
                except PhugoidError:
                    continue
                gain = gain_on_other_data(before, after)
                explained = Simulated.of(after).explained(Simulated.of(before), Misfitting.of(before))
                if kind == "hold" and not (gain.gain > 0.0 and explained.significant):
                    continue
                if gain.gain <= 0.0:  # of another manoeuvre inputs may not be smooth
                    other = list(validation)
            found = InputInterpolation(name, kind, refit, other, refit.merit - base.merit, gain, explained)
    return found


def _with(data: Sequence[Experiment], name: str, kind: Literal["hold", "cubic"]) -> list[Experiment]:
    return [e.with_interpolation({name: kind}) for e in data]
