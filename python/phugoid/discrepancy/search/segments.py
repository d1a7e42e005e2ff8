"""Records as a diagnosis takes them: cut into segments, each with initial states of its own, where a simulation of the
whole drifts away from them; fits that ended at no optimum, estimated again; thinned where they are sampled much faster
than anything in them happens.

Of a system that integrates, is unstable, or stands in a closed loop, whose inputs go by what it does, a free simulation
with a model that lacks something ends far from the record. To first order about such a motion next to nothing is true:
a friction has the wrong sign of the rate, and a term that holds the motion near the record looks like the cause.
Simulated over a horizon, the motion stays near what was measured.

Why an estimation fails is often what a diagnosis is asked for: a model that lacks something, a large bias or noise on a
recorded input leads the path of a whole record astray. Over short segments with initial states of their own it is not.

Of two records of one motion, that with more samples has the same to say of the vehicle, and more of the noise. An
autoregression of a few samples spans a time in which the vehicle does not move, and thresholds in samples mean another
time. Means over blocks keep what the samples say of a motion that is slow beside a block, and their noise is less by
the root of the samples in it. Inputs keep their own samples: what is quick in them acts as it did.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...data.experiment import Experiment
from ...data.filtering import EVEN, Signal
from ...fit_result import dataset, mean_square
from ...residual_noise import resolution_of
from ...residual_noise.whitening import Whitening
from ..candidates.model_structure import ModelStructure
from .refit import Refit, fitted_to, is_structured, values_of

__all__ = [
    "Segments",
    "Thinned",
    "fitted_to_segments",
    "segments_of",
    "short_segments",
    "thinned",
]

# Segments of all records, and samples that each has at least: a tenth of a record holds a few of the motions that the
# record was made for. Short ones, about which candidates are proposed, are as many as these samples allow.
_COUNT, _SHORT, _SAMPLES = 10, 80, 40
# Part of the residuals' power that is predictable, from which on the model is thought far from the record.
_ERROR = 0.5
# Part of the RMS of every output that is left over segments, where it is the drift that made the rest. A stable
# system, which forgets its initial states, keeps more.
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
        length = self.base.fit.model.time_unit.of(f"{self.horizon:.3g}")
        return (
            "Over a whole record the simulation drifts away from the measurements. The records, and those held out, "
            f"were simulated in segments of {length}, each with initial states of its own."
        )


def segments_of(base: Refit, validation: Sequence[Experiment], farthest: bool = False) -> Segments | None:
    """Return the records of a fit in segments, where the model is far from the records as a whole and much nearer to
    segments of them in all outputs, or, with ``farthest``, in the output that it is farthest from; None else, and where
    initial states or parameters belong to a whole record."""
    found, length = fitted_to_segments(base, _COUNT) if is_structured(base, _ERROR) else (None, 0)
    if found is None:
        return None
    names = base.fit.model.output_names
    before, after = (np.array([mean_square(r.fit, n) for n in names]) for r in (base, found))
    nearer = _is_nearer(base, before, found, after) if farthest else bool(np.all(after < _LEFT**2 * before))
    return Segments.of(found, length, validation) if nearer else None


def _is_nearer(base: Refit, before: _Array, pieces: Refit, after: _Array) -> bool:
    """Return whether over segments the misfit is mostly gone in the output that the fit to whole records is farthest
    from, and all together are likelier, by mean squares of the residuals (n_y,). In other outputs it may stay:
    parameters that follow a path that drifts hide what is missing in an acceleration, say."""
    noise, known = (_innovations(r) for r in (pieces, base))
    n = int(np.argmax(before / known))
    left = max(after[n] - noise[n], 0.0) / max(before[n] - noise[n], 1e-300)
    return bool(left < _LEFT**2 and np.log(after / before).sum() < 0.0)


def _innovations(at: Refit) -> _Array:
    """Return the variances (n_y,) of the outputs' residuals that their past does not predict."""
    return np.array([c.power for c in Whitening.of(at.linear.residuals, at.linear.structure).channels])


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
    # The path is initialised again: that of the fit is the one that drifts.
    pieces = [piece for e in records for piece in _cut(e, length)]
    return fitted_to(Refit((), fit), pieces, start=values_of(fit), solver=None), length


def _cut(e: Experiment, length: int) -> list[Experiment]:
    """Return a record in parts of about so many samples."""
    parts = np.array_split(np.arange(e.n), max(round(e.n / length), 1))
    if len(parts) == 1:
        return [e]
    return [e.window(e.t[p[0]], e.t[p[-1]], name=f"{e.name} from {e.t[p[0]]:.4g}") for p in parts]


_Array = NDArray[np.float64]

# Samples of a block: odd, so that its middle is a sample. Fewer than the least are not worth another estimation.
_LEAST, _MOST = 3, 201
# Samples that are left of all records, at least.
_SAMPLES_LEFT = 600
# RMS of what a block's mean differs from the motion in its middle, in standard deviations of that mean.
_BIAS = 0.1
# Power of the residuals at a frequency that is lost, over that about the highest which is left: of white noise it is 1,
# and a mode of the vehicle stands out. The spectrum is averaged over so many segments.
_PEAK, _AVERAGED = 4.0, 8
# Part of an input's range by which a sample may be off the straight line through its neighbours: else it has a corner
# there.
_CORNER = 0.01
# Part of the samples of an output that may be missing.
_MISSING = 0.02


@dataclass(frozen=True)
class Thinned:
    """The fit to thinned records, validation records likewise, the samples of a block, and the rate left, in Hz."""

    base: Refit
    validation: Sequence[Experiment]
    factor: int
    rate: float

    @property
    def note(self) -> str:
        """The note for the user."""
        return (
            f"The records are sampled much faster than the motion: the diagnosis uses means over {self.factor} "
            f"samples, at {self.rate:.3g} {self.base.fit.model.time_unit.frequency}."
        )


def thinned(base: Refit, validation: Sequence[Experiment]) -> Thinned | None:
    """Return the fit to means over blocks of samples, as long as the motion and the spectrum of the residuals allow;
    None where blocks are not worth it, or samples are uneven or missing; and for a model with dry friction, of which
    the reversals are quicker than the motion."""
    structure = ModelStructure(base.fit.model)
    if any(structure.has_friction(p, x) for p in structure.places for x in base.fit.model.state_names):
        return None
    data = [_assigned(e, base) for e in dataset(base.fit)]
    step = _step(data)
    if step is None:
        return None
    total = sum(e.n for e in data)
    factor = 1
    for k in range(_LEAST, min(_MOST, total // _SAMPLES_LEFT) + 1, 2):
        if not _is_slow(base, data, k):
            break
        factor = k
    while factor >= _LEAST and not _is_empty_above(base, factor):
        factor -= 2
    if factor < _LEAST:
        return None
    found = fitted_to(base, [_thin(e, factor) for e in data], solver=None)
    if found is None:
        return None
    held_out = [_assigned(e, base) for e in validation]
    own = _step(held_out) if held_out else None
    others = [_thin(e, factor) for e in held_out] if own and abs(own - step) <= EVEN * step else validation
    return Thinned(found, others, factor, 1.0 / (factor * step))


def _assigned(e: Experiment, base: Refit) -> Experiment:
    """Return a record whose columns are assigned as the model takes them; with signals and mesh as they are."""
    model = base.fit.model
    inputs = {n: e.input(n) for n in model.input_names}
    outputs = {n: e.output(n) for n in model.output_names}
    kinds = {n: e.interpolation_of(n) for n in inputs}
    found = Experiment(e.t, inputs, outputs, name=e.name, interpolation=kinds, units=e._units_of(inputs, outputs))
    signals = {n: s for n in inputs if (s := e.signal(n)) is not None}
    return found._sampled(signals, e.mesh_times)


def _step(data: Sequence[Experiment]) -> float | None:
    """Return the interval between samples, s; None where that differs, or outputs are missing at many."""
    steps = np.concatenate([np.diff(e.t) for e in data])
    step = float(np.median(steps))
    even = bool(np.abs(steps - step).max() <= EVEN * step)
    complete = all(np.mean(~np.isfinite(y)) <= _MISSING for e in data for y in e.outputs.values())
    own = any(e.signal(n) is not None for e in data for n in e.inputs) or any(e.mesh_times is not None for e in data)
    return step if even and complete and not own and all(e.n > 2 * _LEAST for e in data) else None


def _means(y: _Array, k: int) -> _Array:
    """Return the means over blocks of k samples, without those that are left over."""
    return np.asarray(y[: y.size // k * k].reshape(-1, k).mean(axis=1))


def _middles(y: _Array, k: int) -> _Array:
    return y[k // 2 : y.size // k * k : k]


def _corners(e: Experiment) -> NDArray[np.bool_]:
    """Mark the samples (N,) at which an input has a corner or jumps."""
    found = np.zeros(e.n, dtype=bool)
    for u in e.inputs.values():
        off = np.abs(u[1:-1] - 0.5 * (u[:-2] + u[2:]))
        found[1:-1] |= off > _CORNER * max(float(np.ptp(u)), 1e-300)
    return found


def _is_slow(base: Refit, data: Sequence[Experiment], k: int) -> bool:
    """Return whether the fitted outputs hardly move within a block, compared with the noise of its mean; blocks in
    which an input jumps do not count."""
    filter = base.own.filter
    assert isinstance(filter, Whitening)  # channel by channel
    for name, channel in zip(base.linear.model.output_names, filter.channels, strict=True):
        off = []
        for record, e in zip(base.fit.records, data, strict=True):
            y = np.interp(e.t, record.t, record.outputs[name])
            own = _means(y, k) - _middles(y, k)
            off.append(own[_means(_corners(e).astype(float), k) == 0.0])
        every = np.concatenate(off)
        if not every.size or float(np.mean(every**2)) * k > _BIAS**2 * channel.power:
            return False
    return True


def _is_empty_above(base: Refit, k: int) -> bool:
    """Return whether the residuals' spectrum has no peak above the frequencies that blocks of k samples leave."""
    from scipy.signal import welch

    for name in base.linear.model.output_names:
        for record in base.fit.records:
            r = record.residuals[name]
            r = r[np.isfinite(r)]
            f, power = welch(r, nperseg=max(2 * r.size // (_AVERAGED + 1), 8), detrend="linear")
            highest = 0.5 / k
            near, above = power[(f > 0.5 * highest) & (f <= highest)], power[f > highest]
            if near.size and above.size and float(above.max()) > _PEAK * float(np.mean(near)):
                return False
    return True


def _thin(e: Experiment, k: int) -> Experiment:
    """Return a record of means over k samples at their middles. The first and the last time stay, without outputs, so
    that states there are what they were; and so do times at which an input has a corner, within the mesh."""
    corners = _corners(e)
    middles = _middles(e.t, k)
    t = np.concatenate([e.t[:1], middles, e.t[-1:]])
    # Many corners are noise of the record, which has a mean as the outputs have.
    noisy = corners.sum() > middles.size
    # Where an input jumps the outputs may, too, and a mean says nothing of the middle.
    clear = np.full(middles.size, True) if noisy else _means(corners.astype(float), k) == 0.0
    outputs = {}
    for name, y in e.outputs.items():
        # Rounded samples stay so: rounding is no noise, and means would hide it.
        own = _middles(y, k) if resolution_of([y]) else np.where(clear, _means(y, k), np.nan)
        outputs[name] = np.concatenate([[np.nan], own, [np.nan]])
    signals: dict[str, Signal] = {}
    inputs = {}
    for name, u in e.inputs.items():
        if noisy and e.interpolation_of(name) == "hold":
            # As much of it acts in each interval: a mesh with every step of a controller's output would be no thinner.
            begins = np.r_[0, np.arange(k // 2, u.size // k * k, k), u.size - 1]
            inputs[name] = np.r_[np.add.reduceat(u[:-1], begins[:-1]) / np.diff(begins), u[-1]]
        elif noisy:
            inputs[name] = np.concatenate([u[:1], _means(u, k), u[-1:]])
        else:
            inputs[name] = np.concatenate([u[:1], _middles(u, k), u[-1:]])
            signals[name] = e.t, u, 0.0, 0
    mesh = t if noisy else np.unique(np.concatenate([t, e.t[corners]]))
    found = Experiment(t, inputs, outputs, name=e.name, interpolation=e.interpolation, units=e.units)
    return found._sampled(signals, mesh)
