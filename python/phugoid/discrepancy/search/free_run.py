"""Free simulation of data held out: the part of a misfit that a term explains there.

An autoregressive noise model takes a slow, deterministic misfit for noise, so that a term which halves the error of a
simulation may gain little likelihood, and a negligible one may gain much. The error of the simulation itself, with
nothing but initial states and biases estimated, does not depend on any noise model.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...residual_noise import ROUNDED, resolution_of
from ...residual_noise.whitening import Whitening
from ...sensitivities.linearised import Linearised

__all__ = ["LEAST", "Explained", "Misfitting", "Simulated"]

_Array = NDArray[np.float64]

# Blocks of time, over all records, that a bootstrap draws from, its draws, and the probability of its interval.
_BLOCKS, _DRAWS, _INTERVAL = 24, 400, 0.95
# Longer blocks, for the scatter from one manoeuvre to another.
_LONG = 6
LEAST = 0.02
"""Parts of an output's power that is not noise below this are taken as this: of white residuals there is nothing to
explain, and a ratio to it would say nothing."""


@dataclass(frozen=True)
class Explained:
    """The part of the misfit that a term explains in free simulation of data held out.

    The misfit of an output is the mean square of the residuals of the model that was diagnosed, less the variance of
    their innovations, which no model explains.

    part       of the misfit, the mean of the outputs weighted by the part of their residuals that is misfit; below 0
               where the term makes the simulation worse.
    interval   95 %, by a block bootstrap over time.
    another    95 % prediction interval for another record of the same kind and length: the scatter of a bootstrap of
               few long blocks, by Student's t, and once more for the record itself.
    outputs    output -> reduction of the mean square of its residuals over that of the model diagnosed.
    harm       part of the misfit by which the outputs that become worse beyond chance become worse; it is in ``part``.
    """

    part: float
    interval: tuple[float, float]
    another: tuple[float, float]
    outputs: Mapping[str, float]
    harm: float = 0.0

    @property
    def significant(self) -> bool:
        """Return whether the simulation becomes better beyond chance."""
        return self.interval[0] > 0.0

    @property
    def worse(self) -> bool:
        """Return whether the simulation becomes worse beyond chance."""
        return self.interval[1] < 0.0


@dataclass(frozen=True, eq=False)
class Simulated:
    """Errors of a free simulation: measured minus simulated.

    names    of the outputs.
    errors   (n,) of all samples, output by output; NaN where the simulation has none.
    output   (n,) index of the output of each.
    block    (n,) index of its block of time.
    """

    names: tuple[str, ...]
    errors: _Array
    output: NDArray[np.intp]
    block: NDArray[np.intp]

    @staticmethod
    def of(linear: Linearised, residuals: _Array | None = None) -> Simulated:
        """Return the residuals of a fit, or others of the same rows."""
        errors = np.full(linear.n_measured, np.nan)
        output, block = (np.zeros(linear.n_measured, dtype=np.intp) for _ in range(2))
        at = linear.measured_rows
        errors[at] = linear.residuals if residuals is None else residuals
        each = -(-_BLOCKS // len(linear.experiments))
        for i, line in enumerate(linear.rows):
            for e, rows in enumerate(line):
                t = linear.experiments[e].t
                share = (linear.times[rows] - t[0]) / (t[-1] - t[0])
                output[at[rows]] = i
                block[at[rows]] = e * each + np.clip((share * each).astype(np.intp), 0, each - 1)
        return Simulated(linear.model.output_names, errors, output, block)

    def explained(self, without: Simulated, misfit: Misfitting) -> Explained:
        """Return what the terms that this model has and another has not explain of a misfit."""
        whole = misfit.errors
        there = np.isfinite(self.errors) & np.isfinite(without.errors) & np.isfinite(whole)
        output, block = self.output[there], self.block[there]
        n = len(self.names)
        count = np.maximum(np.bincount(output, minlength=n), 1)
        size = 1.0 / (count * np.maximum(misfit.powers, 1e-300))
        less = (without.errors[there] ** 2 - self.errors[there] ** 2) * size[output]
        # The part of each square that is misfit: of all of an output it is that part of its mean square.
        wrong = (whole[there] ** 2 * misfit.parts[output]) * size[output]
        blocks = np.flatnonzero(np.bincount(block))
        sums, wholes = (np.bincount(block, weights=w)[blocks].astype(float) for w in (less, wrong))
        part = _ratio(sums.sum(), wholes.sum())
        of_outputs = np.bincount(output, weights=less, minlength=n)
        named = dict(zip(self.names, of_outputs.tolist(), strict=True))
        interval = _bootstrap(sums, wholes)
        each = np.bincount(block * n + output, weights=less, minlength=n * (block.max(initial=-1) + 1)).reshape(-1, n)
        harm = -of_outputs[_worse(each[blocks].astype(float))].sum() / max(float(wholes.sum()), LEAST)
        another = _of_another_record(float(part), interval, sums, wholes)
        return Explained(float(part), interval, another, named, float(harm))


def _ratio(explained: Any, misfit: Any) -> Any:
    """Return the part of a misfit that is explained. Whatever is explained was misfit, be it as quick as noise."""
    return explained / np.maximum(np.maximum(misfit, explained), LEAST)


def _bootstrap(sums: _Array, wholes: _Array) -> tuple[float, float]:
    """Return the interval of the part explained by blocks (n_blocks,) drawn with replacement."""
    drawn = _drawn(sums.size)
    tail = 50.0 * (1.0 - _INTERVAL)
    low, high = np.percentile(_ratio(sums[drawn].sum(axis=1), wholes[drawn].sum(axis=1)), [tail, 100.0 - tail])
    return float(low), float(high)


def _drawn(blocks: int) -> NDArray[np.intp]:
    """Return the blocks (n_draws, n_blocks) of each draw of a bootstrap, the same for the same number of them."""
    return np.asarray(np.random.default_rng(0).integers(blocks, size=(_DRAWS, blocks)))


def _worse(sums: _Array) -> NDArray[np.bool_]:
    """Return which outputs of blocks (n_blocks, n_y) become worse beyond chance: (n_y,)."""
    return np.asarray(np.percentile(sums[_drawn(len(sums))].sum(axis=1), 50.0 * (1.0 + _INTERVAL), axis=0) < 0.0)


def _of_another_record(part: float, interval: tuple[float, float], sums: _Array, wholes: _Array) -> tuple[float, float]:
    """Return the prediction interval for another record, no narrower than that of this one. Its own scatter is that of
    this record, so that the variances of both add up; few blocks say little of it."""
    from scipy.special import ndtri, stdtrit  # not at import: it takes its time

    if sums.size < 2:
        return -math.inf, 1.0
    begins = np.unique(np.arange(min(_LONG, sums.size)) * sums.size // min(_LONG, sums.size))
    low, high = _bootstrap(*(np.add.reduceat(x, begins) for x in (sums, wholes)))
    k, p = begins.size, 0.5 * (1.0 + _INTERVAL)
    wider = math.sqrt(2.0 * k / (k - 1)) * float(stdtrit(k - 1, p) / ndtri(p))
    return min(part - wider * (part - low), interval[0]), min(max(part + wider * (high - part), interval[1]), 1.0)


@dataclass(frozen=True, eq=False)
class Misfitting:
    """The misfit of a model: (n,) errors of its free simulation, (n_y,) their mean squares, and the parts of these that
    are not noise."""

    errors: _Array
    powers: _Array
    parts: _Array

    @staticmethod
    def of(linear: Linearised, simulated: Simulated | None = None) -> Misfitting:
        """Return the misfit of a fit; or of errors simulated with it, beside the same noise."""
        simulated = simulated or Simulated.of(linear)
        noise = [
            # Below the resolution of an encoder there is nothing to explain.
            max(channel.power, ROUNDED * resolution_of([x.output(name) for x in linear.experiments]) ** 2)
            for name, channel in zip(
                linear.model.output_names, Whitening.of(linear.residuals, linear.structure).channels, strict=True
            )
        ]
        e, there, n = simulated.errors, np.isfinite(simulated.errors), len(noise)
        count = np.maximum(np.bincount(simulated.output[there], minlength=n), 1)
        powers = np.bincount(simulated.output[there], weights=e[there] ** 2, minlength=n) / count
        parts = 1.0 - np.array(noise) / np.maximum(powers, 1e-300)
        return Misfitting(e, powers, np.clip(parts, 0.0, 1.0))
