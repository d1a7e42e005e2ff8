"""Residuals that ring at a lightly damped mode of the model, and noise that does not; random walks of sensors, beside
which a drift must be the likelier cause.

A term that the model lacks drives the vehicle, which answers at its modes. Where one is lightly damped the residual
rings at its frequency, as narrow in the spectrum as noise of a sharp resonance would be; an autoregressive model learns
that resonance and takes nearly all of the misfit for noise. A term that explains the misfit whole gains by that noise
all the same, for what is left of the residual rings no more; one that explains but a part of it gains nothing.

Sensors have no such noise: what rings at a mode has come through the vehicle, be it turbulence or a term that is
missing. So there is a second model of the noise, the same but for its poles near lightly damped modes, which are damped
well. It does not distinguish turbulence from a missing term, and so nothing is named by it; but it shows that there is
one of the two.

The sum of many small steps rises or falls over a record by chance, and a straight line fits it better than stationary
noise does, the more significantly the longer the record is (Granger and Newbold 1974, Durlauf and Phillips 1988). A
drift of a sensor, or of a parameter, is known for one only where the line is likelier than a walk.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...errors import PhugoidError
from ...fit_result import FitResult
from ...linear.linearise import numbers_of
from ...modelling.compiled import Jacobians
from ...residual_noise.autoregression import Autoregression
from ...residual_noise.whitening import Whitening
from ...sensitivities import Place
from ...sensitivities.linearised import Linearised
from ...sensitivities.whitened import RandomEffects, Whitened, at_knots
from ...solvers import check_time
from .refit import Refit

__all__ = [
    "Ringing",
    "is_near",
    "light_modes",
    "random_walk_gain",
    "ringing_of",
]

_Array = NDArray[np.float64]
_Complex = NDArray[np.complex128]

# A mode of less damping is light; of noise that rings at it the damping is put at that of a broad peak.
_LIGHT, _BROAD = 0.05, 0.2
# Part of a mode's frequency within which a pole of the noise is near it.
_NEAR = 0.1
# Cycles of a mode that a record is to have: of fewer a slow drift might be made.
_CYCLES = 5
# Radians from one sample to the next up to which a mode is seen as what it is.
_NYQUIST = 0.8 * np.pi


@dataclass(frozen=True, eq=False)
class Ringing:
    """Noise that rings at modes, and what it would be if it did not.

    filter       the model of the noise without sharp resonances at these modes; channels one by one.
    frequencies  Hz, of the modes, increasing.
    """

    filter: Whitening
    frequencies: tuple[float, ...]


def is_near(frequency: float, mode: float) -> bool:
    """Return whether a frequency is that of a mode, as far as records resolve it; both in the same unit."""
    return abs(frequency - mode) < _NEAR * mode


def light_modes(fit: FitResult) -> _Complex:
    """Eigenvalues (1/s, of positive imaginary part) of the lightly damped modes of a fitted model, about the mean of
    the first record's path. None where the model has no derivatives there."""
    record = fit.records[0]
    try:
        model, values = numbers_of("diagnose", fit, None, record.name)
        at = {n: float(np.mean(record.states[n])) for n in model.state_names}
        at |= {n: float(np.mean(record.inputs[n])) for n in model.input_names}
        at |= {late: at[of] for late, (of, _) in model.delays.inputs.items()}
        jacobians = Jacobians(model, "diagnose", "A")
        point = jacobians.point(values, {**at, "time": float(record.t.mean())})
        found = np.linalg.eigvals(jacobians.matrix("A", point))
    except (PhugoidError, np.linalg.LinAlgError):
        return np.empty(0, dtype=np.complex128)
    return np.asarray(found[(found.imag > 0.0) & (np.abs(found.real) < _LIGHT * np.abs(found))], dtype=np.complex128)


def ringing_of(filter: Whitening, residuals: _Array, linear: Linearised, modes: _Complex) -> Ringing | None:
    """Return what is ringing in a model of the noise in residuals (n_rows,), or None."""
    channels: list[Autoregression] = []
    found: set[float] = set()
    for channel, line in zip(filter.channels, filter.rows.segments, strict=True):
        times = [linear.times[segment.rows] for segment in line]
        lasting = max((float(np.ptp(t)) for t in times), default=0.0)
        if lasting == 0.0:
            channels.append(channel)
            continue
        step = float(np.median(np.concatenate([np.diff(t) for t in times])))
        seen = [m for m in modes if 2 * np.pi * _CYCLES / lasting <= m.imag <= _NYQUIST / step]
        damped, at = _damped(channel.predictors[-1], step, seen)
        channels.append(channel if damped is channel.predictors[-1] else _predicting(damped))
        found |= at
    if not found:
        return None
    errors = Whitening(channels, filter.rows)(residuals)
    for i, line in enumerate(filter.rows.segments):
        e = np.concatenate([errors[segment.rows] for segment in line])
        size = max(float(np.sqrt(np.mean(e**2))), float(np.sqrt(np.finfo(float).tiny)))
        channels[i] = Autoregression(channels[i].predictors, channels[i].powers * size**2)
    return Ringing(Whitening(channels, filter.rows), tuple(sorted(found)))


def _damped(a: _Array, step: float, modes: Sequence[complex]) -> tuple[_Array, set[float]]:
    """Coefficients of an autoregression (p,) whose poles near modes are well damped, and the modes' frequencies (Hz)
    where such poles were light too."""
    if a.size < 2 or not modes:
        return a, set()
    poles, moved = np.roots(np.r_[1.0, -a]).astype(complex), False
    rates = np.log(np.where(poles == 0.0, 1e-300, poles)) / step
    found: set[float] = set()
    for i, rate in enumerate(rates):
        mode = min(modes, key=lambda m: abs(m.imag - abs(rate.imag)))
        if is_near(abs(rate.imag), mode.imag) and -rate.real < _BROAD * abs(rate):
            decay = _BROAD / np.sqrt(1.0 - _BROAD**2) * abs(rate.imag)
            poles[i] = np.exp((-decay + 1j * rate.imag) * step)
            moved = True
            if -rate.real < _LIGHT * abs(rate):
                found.add(float(mode.imag / (2.0 * np.pi)))
    return (-np.real(np.poly(poles))[1:] if moved else a), found


def _predicting(a: _Array) -> Autoregression:
    """Return the model with coefficients (p,), of innovations of size 1, with its predictors from fewer samples, by
    Levinson's recursion backwards."""
    predictors, powers = [a], [1.0]
    while a.size:
        k, rest = a[-1], a[:-1]
        a = (rest + k * rest[::-1]) / (1.0 - k * k)
        predictors.append(a)
        powers.append(powers[-1] / (1.0 - k * k))
    return Autoregression(tuple(predictors[::-1]), np.array(powers[::-1]))


# Knots of a walk, over all records.
_KNOTS = 100


def random_walk_gain(at: Refit, outputs: Sequence[str]) -> float:
    """Return by how much the log-likelihood of a refit's residuals, less the number of its parameters, rises where the
    noise of outputs is a random walk with white noise on it in place of an autoregression; of those where it does."""
    filter = at.own.filter
    assert isinstance(filter, Whitening)  # channel by channel
    linear, total = at.linear, 0.0
    alone = Whitened(linear, Whitening(filter.channels, linear.structure))
    names = linear.model.output_names
    lines, covariance = _lines(linear), _walk(linear)
    for output in outputs:
        check_time()
        which = names.index(output)
        channels = list(filter.channels)
        channels[which] = Autoregression((np.empty(0),), np.array([channels[which].power]))
        own = Whitening(channels, linear.structure)
        answers = linear.answers(Place("output", output), lines)
        walk = RandomEffects(linear, answers, own).with_correlation(covariance).maximised(np.ones(len(names)))
        total += max(walk.log_likelihood - own.parameters - 1.0 - alone.lenient_merit, 0.0)
    return total


def _knots(linear: Linearised) -> list[_Array]:
    """Return the times of the knots of each record."""
    spans = [float(p.t[-1] - p.t[0]) for p in linear.points]
    counts = [max(round(_KNOTS * s / sum(spans)), 2) for s in spans]
    return [np.linspace(p.t[0], p.t[-1], n) for p, n in zip(linear.points, counts, strict=True)]


def _lines(linear: Linearised) -> list[_Array]:
    """Return broken lines (k, n) of all knots along each record: zero in the others."""
    knots = _knots(linear)
    ends = np.cumsum([0, *(k.size for k in knots)])
    found = []
    for e, p in enumerate(linear.points):
        signals = np.zeros((int(ends[-1]), p.n))
        signals[ends[e] : ends[e + 1]] = at_knots(p.t, knots[e])
        found.append(signals)
    return found


def _walk(linear: Linearised) -> _Array:
    """Return the covariance (k, k) of walks of unit steps, one in each record."""
    knots = _knots(linear)
    out = np.zeros((sum(k.size for k in knots),) * 2)
    first = 0
    for k in knots:
        index = np.arange(1.0, k.size + 1.0)
        out[first : first + k.size, first : first + k.size] = np.minimum(index[:, None], index)
        first += k.size
    return out
