"""The gain of an extension on data that its parameters were not fitted to."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...data.experiment import Experiment
from ...errors import DataError
from ...estimation.estimate import estimate
from ...validation.biases import biases
from ...validation.held import held_model, held_noise, mesh_for
from ..candidates.candidate import Candidate
from .least_squares import Whitened, own_whitening
from .linearised import Linearised
from .refit import Refit, started_from

__all__ = ["HeldOut", "across_blocks", "gain_on_other_data", "on_other_data"]

_Array = NDArray[np.float64]

# Blocks of each record that are left out in turn.
_BLOCKS = 4
# Of what a block says of a parameter: the precision that all data together have is 1.
_LOOSE, _TINY = 0.01, 1e-9


class HeldOut(NamedTuple):
    """A gain on held-out data.

    gain       in whitened log-likelihood.
    deviation  its standard deviation.
    elsewhere  the gain without the block of the records that gains most: one block alone is no confirmation, for
               whatever is wrong there would look like a gain. On other records the gain itself.
    """

    gain: float
    deviation: float
    elsewhere: float


def across_blocks(base: Refit, more: Refit, new: Sequence[Candidate]) -> HeldOut:
    """Gain in whitened log-likelihood of the blocks of the records, each predicted by what the others say of the new
    candidates.

    About the fit without them, to first order: their coefficients are those that the other blocks ask for, none
    where these say nothing of them. Parameters may follow by ten standard errors.
    """
    linear = base.linear
    whitened = base.through(more.own.filter)
    columns, _, _ = linear.columns([(c, {n: more.fit.parameters[n].value for n in c.shape_names}) for c in new])
    c = whitened.filter(columns).T
    c /= np.maximum(np.linalg.norm(c, axis=0), 1e-300)
    e = whitened.errors
    block, gain = _blocks(linear), np.zeros(linear.n_rows)
    for b in range(_BLOCKS):
        inside = block == b
        for sign, parts in ((-1.0, whitened.basis), (1.0, np.hstack([whitened.basis, c]))):
            seen = parts[~inside]
            damping = np.r_[np.full(whitened.basis.shape[1], _LOOSE), np.full(parts.shape[1], _TINY)][: parts.shape[1]]
            step = np.linalg.solve(seen.T @ seen + np.diag(damping), seen.T @ e[~inside])
            gain[inside] -= sign * 0.5 * (e[inside] - parts[inside] @ step) ** 2
    total = float(gain.sum())
    best = max(float(gain[block == b].sum()) for b in range(_BLOCKS))
    return HeldOut(total, float(np.sqrt(gain.size) * gain.std()), total - best)


def _blocks(linear: Linearised) -> NDArray[np.intp]:
    """The block of each row."""
    block = np.empty(linear.n_rows, dtype=np.intp)
    for line in linear.rows:
        for e, rows in enumerate(line):
            t = linear.experiments[e].t
            share = (linear.times[rows] - t[0]) / (t[-1] - t[0])
            block[rows] = np.minimum((share * _BLOCKS).astype(np.intp), _BLOCKS - 1)
    return block


def on_other_data(refit: Refit, data: Sequence[Experiment], near: Linearised | None = None) -> Linearised:
    """A refit's model on other data, linearised: first states and biases are free, all else is as fitted.

    ``near`` is another model's, whose path is a start.

    Raises DataError where there is no such fit.
    """
    fit, free = refit.fit, biases(refit.fit.model)
    values = {n: e.value for n, e in fit.parameters.items()}
    own = [n for n in fit.model.parameter_names if n not in values and n not in free]
    if own:
        raise DataError(
            f"diagnose: {', '.join(own)} has a value for each experiment of the fit, so none for the validation "
            "record: leave validation out"
        )
    model, noise = held_model(fit.model, values, free), held_noise(fit)[0]
    start = started_from(near.fit, ()) if near else {n: values[n] for n in free if n in values}
    mesh = mesh_for(fit, data)
    found = estimate(model, list(data), transcription=mesh, noise=noise, start=start)
    if found.status not in ("converged", "acceptable", "unidentifiable"):
        raise DataError(f"diagnose: the model cannot be fitted to the validation record: {found.message}")
    return Linearised(found)


def gain_on_other_data(base: Linearised, more: Linearised) -> HeldOut:
    """Gain on other data, through the likeliest filter of ``more``."""
    own = own_whitening(more)
    other = Whitened(base, own.filter.on(base.structure))
    d = own.log_densities - other.log_densities
    d = d[np.isfinite(d)]
    return HeldOut(float(d.sum()), float(np.sqrt(d.size) * d.std()), float(d.sum()))
