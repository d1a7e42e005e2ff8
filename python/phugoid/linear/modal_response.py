"""Modal responses to the inputs of a record, and their derivatives by the eigenvalues."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..data.experiment import Experiment
from ..data.interpolation import interpolated

__all__ = ["Answers", "Driven"]

_Array: TypeAlias = NDArray[np.float64]
_Complex: TypeAlias = NDArray[np.complex128]

# Nodes of Gauss-Legendre on each piece of the input: exact to rounding for a cubic times a mode below the Nyquist rate.
_NODES = 8
# Samples whose free motions are products of a first one and of steps: rounding grows with neither.
_STRIDE = 256


@dataclass(frozen=True, eq=False)
class Answers:
    """Modal responses in an experiment: free (r, N), as `Driven.free` defines it, and forced, (r, N) for each input."""

    driven: Driven
    values: _Complex
    free: _Complex
    forced: Sequence[_Complex]

    def states(self, B: _Complex, motion: _Complex) -> _Complex:
        """Return modal states (r, N) for given B (r, m) and factors of the free motions (r,)."""
        xi = motion[:, None] * self.free
        for b, response in zip(B.T, self.forced, strict=True):
            xi += b[:, None] * response
        return xi

    def slopes(self, B: _Complex, motion: _Complex) -> tuple[_Complex, _Complex]:
        """Return modal states, and their derivatives by the eigenvalues."""
        xi = self.states(B, motion)
        return xi, self.driven.slopes(self.values, xi, B)


class Driven:
    """An experiment prepared for modal responses: its inputs at quadrature nodes between the samples.

    run, inputs  the experiment, and the names of its inputs, m of them.
    u            (m, N) at the samples.
    """

    def __init__(self, run: Experiment, inputs: Sequence[str]) -> None:
        self.run, self.inputs = run, tuple(inputs)
        self.u: _Array = np.array([run.input(name) for name in inputs]).reshape(len(inputs), run.n)
        self._signals = [_Signal(run, name) for name in inputs]

    def forced(self, values: _Complex) -> list[_Complex]:
        """Return for each input the response (r, N) of each mode, xi' = lambda xi + u, from zero at the start, or at
        the end for growing modes, so that these are as well conditioned. It is exact for inputs that run as the
        experiment says."""
        return [signal.responses(values) for signal in self._signals]

    def free(self, values: _Complex) -> _Complex:
        """Return e^(lambda t), (r, N), from the end where it is 1 to where it has decayed."""
        step, n = _step(self.run), self.run.n
        decay, k = _decay(values) * step, np.arange(0, n, _STRIDE)
        each = np.exp(decay[:, None] * k)[:, :, None] * np.exp(decay[:, None] * np.arange(_STRIDE))[:, None, :]
        found = each.reshape(values.size, -1)[:, :n]
        growing = values.real > 0.0
        found[growing] = found[growing, ::-1]
        return found

    def answers(self, values: _Complex) -> Answers:
        """Return the free and the forced responses."""
        return Answers(self, values, self.free(values), self.forced(values))

    def slopes(self, values: _Complex, xi: _Complex, B: _Complex) -> _Complex:
        """Return d xi / d lambda, (r, N), of modal states xi: the recursion of `forced`, differentiated, for all
        inputs."""
        growing = values.real > 0.0
        push = np.zeros((values.size, self.run.n - 1), dtype=np.complex128)
        for b, signal in zip(B.T, self._signals, strict=True):
            push += b[:, None] * signal.pushed_slope(values)
        step = _step(self.run)
        over = step * np.exp(_decay(values) * step)[:, None]
        # Free motions are part of xi: d/d lambda of e^(lambda t) obeys the same recursion.
        push += np.where(growing[:, None], -over * xi[:, 1:], over * xi[:, :-1])
        return _recursion(values, push, step)


class _Signal:
    """One input: ``u`` (N - 1, nodes) in all intervals, and the offsets ``at`` (nodes,) of the nodes, s."""

    def __init__(self, run: Experiment, name: str) -> None:
        self.step = _step(run)
        pieces = _pieces(run, name, self.step)
        x, w = np.polynomial.legendre.leggauss(_NODES)
        # Nodes of all pieces of a sampling interval, as parts of it.
        at = (np.arange(pieces)[:, None] + 0.5 * (x + 1.0)).ravel() / pieces
        self.weights = np.tile(0.5 * w, pieces) / pieces * self.step
        times = (run.t[:-1, None] + at * np.diff(run.t)[:, None]).ravel()
        self.u = _between(run, name, times).reshape(run.n - 1, at.size)
        self.at = at * self.step

    def responses(self, values: _Complex) -> _Complex:
        growing = values.real > 0.0
        # For a growing mode xi(t) = -integral from t to the end of e^(lambda (t - s)) u(s) ds.
        sign = np.where(growing, -1.0 + 0.0j, 1.0)
        push = self._pushed(sign * np.exp(_decay(values) * self._reach(growing)))
        return _recursion(values, push, self.step)

    def pushed_slope(self, values: _Complex) -> _Complex:
        """Return the derivatives by the eigenvalues of the input's contribution in each interval, (r, N - 1)."""
        reach = self._reach(values.real > 0.0)
        return self._pushed(np.asarray(reach * np.exp(_decay(values) * reach)))

    def _reach(self, growing: NDArray[np.bool_]) -> _Array:
        """Return the time (nodes, r) from a node to the end of its interval; for growing modes to the start."""
        return np.asarray(np.where(growing, self.at[:, None], self.step - self.at[:, None]))

    def _pushed(self, kernel: _Complex) -> _Complex:
        """Return the input's contribution to each mode in each interval, (r, N - 1): integrals with kernels
        (nodes, r)."""
        weighted = np.ascontiguousarray(self.weights[:, None] * kernel)
        both = self.u @ weighted.view(np.float64)  # real and imaginary parts in one product
        return np.asarray(both.view(np.complex128).T)


def _step(run: Experiment) -> float:
    """Return the sampling interval, s."""
    return float(run.t[-1] - run.t[0]) / (run.n - 1)


def _recursion(values: _Complex, push: _Complex, step: float) -> _Complex:
    """Solve xi(t + step) = e^(lambda step) xi(t) + push from zero; for growing modes backwards from the end."""
    from scipy.signal import lfilter

    xi = np.zeros((values.size, push.shape[1] + 1), dtype=np.complex128)
    for i, (grows, over) in enumerate(zip(values.real > 0.0, np.exp(_decay(values) * step), strict=True)):
        if grows:
            xi[i, -2::-1] = lfilter([1.0], [1.0, -over], push[i, ::-1])
        else:
            xi[i, 1:] = lfilter([1.0], [1.0, -over], push[i])
    return xi


def _decay(values: _Complex) -> _Complex:
    """Return the eigenvalues in the direction of time in which the modes decay."""
    return np.asarray(np.where(values.real > 0.0, -values, values))


def _pieces(run: Experiment, name: str, step: float) -> int:
    """Return the number of intervals of the input's own samples within one of the record."""
    signal = run.signal(name)
    if signal is None:
        return 1
    return max(1, math.ceil(step / float(np.median(np.diff(signal[0]))) - 0.01))


def _between(run: Experiment, name: str, times: _Array) -> _Array:
    """Return an input interpolated at any times."""
    signal = run.signal(name)
    if signal is not None and signal[3] == 0:
        t, samples, delay, _ = signal
        times = np.clip(times - delay, t[0], t[-1])
    else:
        t, samples = run.t, run.input(name)
    return interpolated(run.interpolation_of(name), t, samples, times)
