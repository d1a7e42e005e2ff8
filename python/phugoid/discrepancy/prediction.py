"""What can be predicted of a channel's residual from its past, by an autoregressive model, also past a gap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .autoregression import burg
from .strands import Strand

__all__ = ["Channel", "Passage", "autoregressive"]

_Array = NDArray[np.float64]

# Over gaps longer than this, variances are those of the process, less what is left of knowledge; else they are summed
# up step by step, which loses no digits.
_LONG = 64


@dataclass(frozen=True, eq=False)
class Channel:
    """The autoregressive model of one channel.

    predictors  predictors[k] (k,) is the best predictor from k samples: r_t is about sum_i predictors[k][i] r_{t-1-i}.
    sigmas      (p + 1,) standard deviations of their errors.
    """

    predictors: tuple[_Array, ...]
    sigmas: _Array

    @property
    def order(self) -> int:
        """p."""
        return len(self.predictors) - 1

    @cached_property
    def transition(self) -> _Array:
        """(p, p) from the last p values, the newest first, to those one step later, but for the error."""
        p = self.order
        step = np.eye(p, k=-1)
        step[:1] = self.predictors[p]
        return step

    @cached_property
    def covariance(self) -> _Array:
        """(p, p) of p values in a row, by Levinson's recursion."""
        gamma = [self.sigmas[0] ** 2]
        for k in range(1, self.order):
            known = np.array(gamma[::-1][: k - 1])
            reflection = self.predictors[k][-1]
            gamma.append(float(self.predictors[k - 1] @ known + reflection * self.sigmas[k - 1] ** 2))
        at = np.arange(self.order)
        return np.asarray(np.array(gamma)[np.abs(at[:, None] - at)])


def autoregressive(runs: Sequence[_Array]) -> Channel:
    """The model of residuals, runs of equally spaced samples."""
    model = burg(runs)
    return Channel(model.predictors, np.sqrt(np.maximum(model.powers, np.finfo(float).tiny)))


@dataclass(frozen=True, eq=False)
class _Step:
    """To a sample whose last p places are not all there, by Kalman's filter (1960).

    transition  (p, p) from what was known of p values at the sample before.
    gain        (p,) what the sample's error says of them.
    sigma       standard deviation of that error.
    """

    transition: _Array
    gain: _Array
    sigma: float


class Passage:
    """A channel's model along a strand: each sample predicted from all before it.

    The errors are those of the exact likelihood. Where the last p samples are there, they alone count; at the beginning
    and after a gap, p samples long at most, Kalman's filter says what is known.
    """

    def __init__(self, channel: Channel, strand: Strand) -> None:
        self.channel, self.runs = channel, strand.runs
        p, places = channel.order, strand.places
        self._steps: list[list[_Step]] = []
        known = channel.covariance  # of the error of what is known of the last p values
        for run in self.runs:
            steps = []
            for i in range(run.start, min(run.start + p, run.stop)):
                gap = int(places[i] - places[i - 1]) if i else 0
                transition, known = self._later(known, gap)
                gain = known[:, 0] / known[0, 0]
                steps.append(_Step(transition, gain, float(np.sqrt(known[0, 0]))))
                known = known - np.outer(gain, known[0])
            self._steps.append(steps)
            if run.stop - run.start >= p:
                known = np.zeros((p, p))

    def _later(self, known: _Array, steps: int) -> tuple[_Array, _Array]:
        """So many steps later: the transition, and the covariance of what is known."""
        channel = self.channel
        transition = np.linalg.matrix_power(channel.transition, steps)
        if steps > _LONG:
            return transition, channel.covariance + transition @ (known - channel.covariance) @ transition.T
        for _ in range(steps):
            known = channel.transition @ known @ channel.transition.T
            known[0, 0] += channel.sigmas[-1] ** 2
        return transition, known

    def errors(self, x: _Array) -> _Array:
        """Prediction errors of samples (..., n), in units of their standard deviations."""
        channel, p = self.channel, self.channel.order
        out = x / channel.sigmas[-1]
        state = np.zeros((*x.shape[:-1], p))
        for run, steps in zip(self.runs, self._steps, strict=True):
            block, result = x[..., run], out[..., run]
            n = block.shape[-1]
            for i, a in enumerate(channel.predictors[p] / channel.sigmas[-1], start=1):
                result[..., p:] -= a * block[..., p - i : max(n - i, p - i)]
            for t, step in enumerate(steps):
                state = state @ step.transition.T
                error = block[..., t] - state[..., 0]
                result[..., t] = error / step.sigma
                state = state + error[..., None] * step.gain
            if n >= p:
                state = block[..., n - p :][..., ::-1]
        return np.asarray(out)

    @cached_property
    def log_scales(self) -> _Array:
        """(n,) logarithms of the standard deviations of the errors."""
        out = np.full(self.runs[-1].stop, np.log(self.channel.sigmas[-1]))
        for run, steps in zip(self.runs, self._steps, strict=True):
            out[run.start : run.start + len(steps)] = [np.log(step.sigma) for step in steps]
        return out
