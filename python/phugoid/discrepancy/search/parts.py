"""Windows of long records, in which a search is made instead of in all samples.

A cause that explains a part of the misfit worth a name shows in a few thousand samples, and the time and memory of a
search grow with the samples times the candidates. Long records are searched in windows that are spread over them, each
where the misfit of its stretch is largest, with initial states of its own. What is named is estimated from all samples
in the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...data.experiment import Experiment
from ...fit_result import dataset
from .finding import ExtensionResult
from .refit import Refit, fitted_to, values_of

__all__ = ["Parts", "parts_of"]

# Samples of a search, and rows (samples of all outputs) of it, but not fewer samples than the least. Records that have
# not so many times more are searched whole.
_SAMPLES, _ROWS, _LEAST, _MORE = 6000, 24_000, 2500, 1.5
# Windows of all records together, and samples that each has at least.
_COUNT, _SHORTEST = 10, 200


@dataclass(frozen=True, eq=False)
class Parts:
    """The fit to windows of the records, and windows of the validation records.

    base        the fit to the windows.
    validation  windows of the other records; these themselves where they are short.
    whole       the fit to all samples.
    several     whether there are several windows of one record.
    """

    base: Refit
    validation: Sequence[Experiment]
    whole: Refit
    several: bool

    @property
    def note(self) -> str:
        """The note for the user."""
        total, used = (sum(e.n for e in dataset(r.fit)) for r in (self.whole, self.base))
        return (
            f"The search was made in {len(dataset(self.base.fit))} windows of the records with {used:,} of {total:,} "
            "samples, where the misfit is largest; gains and explained parts refer to these windows. Named causes were "
            "estimated from all samples."
        )

    def estimated(self, at: Refit) -> Refit | None:
        """Return a refit's model estimated from all samples; None where the solver does not come to an end."""
        if not at.candidates:
            return self.whole
        # On its own mesh.
        like = Refit(at.candidates, self.whole.fit)
        return fitted_to(like, dataset(like.fit), model=at.fit.model, start=values_of(at.fit), solver=None)

    def extension(self, of: ExtensionResult, at: Refit | None) -> ExtensionResult:
        """Return an extension with the fit to all samples, ``at``, and what of its gain is known of them."""
        if at is None:
            return of
        gain = of.gain.as_fitted(self.whole.fit, at.fit, self.whole.linear.n_rows)
        gain = replace(gain, rms_before=self.whole.rms, rms_after=at.rms)
        return replace(of, model=at.fit.model, fit=at.fit, gain=gain)


def parts_of(base: Refit, validation: Sequence[Experiment]) -> Parts | None:
    """Return the fit to windows of long records; None where the records are short, where initial states are declared,
    or the windows cannot be fitted."""
    fit, records = base.fit, dataset(base.fit)
    most = max(_LEAST, min(_SAMPLES, _ROWS // len(fit.model.output_names)))
    if fit.model.end_conditions or sum(e.n for e in records) <= _MORE * most:
        return None
    misfits = [_misfit(base, e) for e in range(len(records))]
    one = any(p.per_experiment for p in fit.model.declared_parameters.values())
    windows = _windows(records, misfits, most, one)
    pieces = [piece for of_record in windows for piece in of_record]
    found = fitted_to(Refit((), fit), pieces, start=values_of(fit), solver=None)
    if found is None:
        return None
    others = list(validation)
    if sum(e.n for e in others) > _MORE * most:
        others = [piece for w in _windows(others, [np.ones(e.n) for e in others], most, one) for piece in w]
    return Parts(found, others, base, any(len(of_record) > 1 for of_record in windows))


def _windows(
    records: Sequence[Experiment], misfits: Sequence[NDArray[np.float64]], most: int, one: bool
) -> list[list[Experiment]]:
    """Return windows of each record, of ``most`` samples together, where the misfits (N,) of their stretches are
    largest; ``one`` of each record, or none."""
    count = max(min(max(_COUNT, len(records)), most // _SHORTEST), 1)
    length = most // count
    if len(records) > count:  # some of them, evenly
        chosen = np.unique(np.linspace(0, len(records) - 1, count).round().astype(int)).tolist()
        records, misfits = [records[i] for i in chosen], [misfits[i] for i in chosen]
    total = sum(e.n for e in records)
    found = []
    for e, misfit in zip(records, misfits, strict=True):
        share = 1 if one else max(round(count * e.n / total), 1)
        pieces = []
        for stretch in np.array_split(np.arange(e.n), share):
            own = min(most // len(records) if one else length, stretch.size)
            sums = np.convolve(misfit[stretch], np.ones(own), mode="valid")
            first = int(stretch[0]) + int(np.argmax(sums))
            name = f"{e.name} from {e.t[first]:.4g}"
            pieces.append(e if own == e.n else e.window(e.t[first], e.t[first + own - 1], name=name))
        found.append(pieces)
    return found


def _misfit(base: Refit, record: int) -> NDArray[np.float64]:
    """Return the squares (N,) of the residuals of a record in units of the noise, summed over its outputs."""
    r, linear = base.fit.records[record], base.linear
    total = np.zeros(r.t.size)
    for name, sigma in zip(linear.model.output_names, linear.sigmas, strict=True):
        total += np.nan_to_num(r.residuals[name] / sigma) ** 2
    return total
