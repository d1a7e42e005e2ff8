"""Inputs that act otherwise than they are recorded: held between their samples, smooth there, or without the noise that
their records have.

The output-error method takes inputs as known. Noise on a recorded input acts like process noise in the model's response
and biases the estimates (Jategaonkar 2015, ch. 5): where the data say so, the noise is filtered out of the record.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ...data.experiment import Experiment
from ...errors import PhugoidError
from ...fit_result import dataset
from ...sensitivities.linearised import Linearised
from ...sensitivities.trajectory import Place
from ...sensitivities.whitened import Whitened
from .evidence import AssessmentSettings
from .free_run import Explained, Misfitting, Simulated
from .refit import HeldOut, Refit, fitted_to, gain_on_other_data, on_other_data
from .refit_cache import RefitCache

__all__ = ["RecordedInput", "recorded_input"]

_Array = NDArray[np.float64]
_Kind = Literal["hold", "cubic", "noise"]
_KINDS: tuple[_Kind, ...] = ("hold", "cubic", "noise")

# Log-likelihood by which another input must be ahead of the one recorded, joined by straight lines.
_MARGIN = 8.0
# Filters that take noise away and leave steps and doublets of the pilot, in samples: running medians, and means whose
# weights fall with the distance in time and, within a part of the noise, in the filtered value.
_MEDIANS, _MEANS = (5, 11), (8, 20, 60)
_FIRST, _ALIKE = 5, 1.5
# To first order the data ask for so much of what the filter takes away: about all of it.
_ALL = (0.4, 1.6)


@dataclass(frozen=True, eq=False)
class RecordedInput:
    """How an input acts, where it acts otherwise than it is recorded.

    name        of the input.
    kind        "hold": constant until the next sample; "cubic": smooth between samples; "noise": without the noise that
                is on the record.
    refit       the fit with it so.
    validation  the other records with it so; those that are no better so as they are.
    gain        in log-likelihood, coloured noise.
    held_out    the same on the other records; None without any.
    explained   what it explains of their misfit in free simulation; without other records, of that of the fit's own.
    noise       RMS of the noise, in the input's unit; 0 for the other kinds.
    """

    name: str
    kind: _Kind
    refit: Refit
    validation: Sequence[Experiment]
    gain: float
    held_out: HeldOut | None
    explained: Explained | None
    noise: float = 0.0

    @property
    def cause(self) -> str:
        """Canonical name."""
        return f"{self.name}:{self.kind}"


def recorded_input(search: RefitCache) -> RecordedInput | None:
    """Return the input that the data say is held between its samples, smooth there, or recorded with noise, the
    clearest of them; None where there is none.

    A delay of half a sample does nearly the same as an input that is held: where that predicts other data better than
    straight lines do, it is named first, since it has no parameter.
    """
    base, validation = search.base, search.validation
    data, found = dataset(base.fit), None
    try:
        before = search.on_validation(base)
    except PhugoidError:
        return None
    for name in base.fit.model.declared_inputs:
        if any(e.interpolation_of(name) != "linear" or e.signal(name) is not None for e in data):
            continue
        noise = _without_noise(base.own, name)
        least = max(_MARGIN, found.gain if found else 0.0)
        for kind in _KINDS:
            treated = noise if kind == "noise" else [e.with_interpolation({name: kind}) for e in data]
            refit = fitted_to(base, treated) if treated else None
            if refit is None or refit.merit - base.merit < least:
                continue
            one = RecordedInput(name, kind, refit, validation, refit.merit - base.merit, None, None)
            one = replace(one, noise=_rms(data, treated, name)) if kind == "noise" else one
            confirmed = _confirmed(one, before, base, search.biases) if before is not None else _explaining(one, base)
            if confirmed is not None:
                found, least = confirmed, confirmed.gain
    return found


def _explaining(one: RecordedInput, base: Refit) -> RecordedInput | None:
    """Return what the records themselves say of it, where none are held out; None where it explains next to nothing of
    their misfit, however likely it is."""
    misfit = Misfitting.of(base.linear)
    explained = Simulated.of(one.refit.linear).explained(Simulated.of(base.linear), misfit)
    return replace(one, explained=explained) if one.kind == "cubic" or _counts(explained) else None


def _counts(explained: Explained) -> bool:
    """Tell whether it explains more than a minor finding does, and more than chance."""
    return explained.significant and explained.part >= AssessmentSettings().minor


def _confirmed(one: RecordedInput, before: Linearised, base: Refit, free: Sequence[str] | None) -> RecordedInput | None:
    """Return what data held out say of it; None where they speak against it."""
    name, kind = one.name, one.kind
    if kind == "noise":
        other = _without_noise(Whitened(before, base.own.filter.on(before.structure)), name)
    else:
        other = [e.with_interpolation({name: kind}) for e in one.validation]
    if not other:
        return None
    try:
        after = on_other_data(one.refit, other, None, free)
    except PhugoidError:
        return None
    gain = gain_on_other_data(before, after)
    explained = Simulated.of(after).explained(Simulated.of(before), Misfitting.of(before))
    if kind != "cubic" and not (gain.gain > 0.0 and _counts(explained)):
        return None
    if gain.gain <= 0.0:  # of another manoeuvre inputs may not be smooth
        other = list(one.validation)
    return replace(one, validation=other, held_out=gain, explained=explained)


def _without_noise(at: Whitened, name: str) -> list[Experiment]:
    """Return the records of a fit with an input filtered as it fits best to first order; none where the data do not ask
    for about all that any filter takes away."""
    linear, data, place = at.linear, at.linear.experiments, Place("input", name)
    inputs = [e.input(name) for e in data]
    if place not in linear.places or any(_noise_of(u) == 0.0 for u in inputs):
        return []
    filtered = [
        [_median(u, size) for size in _MEDIANS] + [_edge_preserving(u, width) for width in _MEANS] for u in inputs
    ]
    signals = [
        np.stack([np.interp(p.t, e.t, row - u) for row in rows])
        for p, e, u, rows in zip(linear.points, data, inputs, filtered, strict=True)
    ]
    columns = at.filter(linear.answers(place, signals))
    columns = columns - (columns @ at.basis) @ at.basis.T
    power = np.maximum(np.sum(columns**2, axis=1), 1e-300)
    asked = columns @ at.errors / power
    gain = np.where((asked >= _ALL[0]) & (asked <= _ALL[1]), 0.5 * power * asked**2, 0.0)
    best = int(np.argmax(gain))
    if gain[best] <= _MARGIN:
        return []
    return [e.with_channels({name: rows[best]}) for e, rows in zip(data, filtered, strict=True)]


def _rms(data: Sequence[Experiment], treated: Sequence[Experiment], name: str) -> float:
    taken = np.concatenate([a.input(name) - b.input(name) for a, b in zip(data, treated, strict=True)])
    return float(np.sqrt(np.mean(taken**2)))


def _noise_of(u: _Array) -> float:
    """Return the standard deviation of white noise on a signal that is smooth in most places, by second differences."""
    return float(np.median(np.abs(np.diff(u, 2))) / (0.6745 * np.sqrt(6.0))) if u.size > 2 else 0.0


def _median(u: _Array, size: int) -> _Array:
    from scipy.ndimage import median_filter  # not at import: it takes its time

    return np.asarray(median_filter(u, size, mode="nearest"))


def _edge_preserving(u: _Array, width: int) -> _Array:
    """Filter by means over samples that are near in time and alike in value (bilateral filter, Tomasi and Manduchi
    1998)."""
    alike = _ALIKE * max(_noise_of(u), 1e-300)
    reach = 3 * width
    rough, padded = np.pad(_median(u, _FIRST), reach, mode="edge"), np.pad(u, reach, mode="edge")
    n, middle = u.size, rough[reach : reach + u.size]
    total, weights = np.zeros(n), np.zeros(n)
    for shift in range(2 * reach + 1):
        away = (rough[shift : shift + n] - middle) / alike
        weight = np.exp(-0.5 * (((shift - reach) / width) ** 2 + away**2))
        total += weight * padded[shift : shift + n]
        weights += weight
    return total / weights
