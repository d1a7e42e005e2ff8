"""What modes answer to the inputs of a record, and how that moves with their eigenvalues."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from . import _core
from .experiment import Experiment

__all__ = ["Driven"]

_Array: TypeAlias = NDArray[np.float64]
_Complex: TypeAlias = NDArray[np.complex128]

# Nodes of Gauss-Legendre on each piece of the input: exact to rounding for a cubic times a mode below the Nyquist rate.
_NODES = 8


class Driven:
    """An experiment as modes see it: its inputs at the nodes of a quadrature between the samples.

    run, inputs  the experiment, and the names of its inputs, m of them.
    u            (m, N) at the samples.
    """

    def __init__(self, run: Experiment, inputs: Sequence[str]) -> None:
        self.run, self.inputs = run, tuple(inputs)
        self.u: _Array = np.array([run.input(name) for name in inputs]).reshape(len(inputs), run.n)
        self._signals = [_Signal(run, name) for name in inputs]

    def forced(self, values: _Complex) -> list[_Complex]:
        """Of each input the response (r, N) of each mode, xi' = lambda xi + u, from zero at the start; at the end for
        modes that grow, so that these are as well conditioned. Exact for inputs that run as the experiment says."""
        return [signal.responses(values) for signal in self._signals]

    def forced_slopes(self, values: _Complex) -> list[tuple[_Complex, _Complex]]:
        """Of each input the responses (r, N), and their derivatives by the eigenvalue."""
        responses = self.forced(values)
        return [(xi, signal.slopes(values, xi)) for signal, xi in zip(self._signals, responses, strict=True)]

    def free(self, values: _Complex) -> _Complex:
        """e^(lambda t) from the end where it is 1 to where it has decayed, (r, N)."""
        return np.asarray(np.exp(values[:, None] * self._since(values)))

    def free_slopes(self, values: _Complex) -> tuple[_Complex, _Complex]:
        """The free motion, and its derivative by the eigenvalue."""
        motion = self.free(values)
        return motion, np.asarray(self._since(values) * motion)

    def _since(self, values: _Complex) -> _Array:
        """Time (r, N) from the end at which the free motion is 1."""
        t = self.run.t
        return np.asarray(t - np.where(values.real > 0.0, t[-1], t[0])[:, None])


class _Signal:
    """One input, ``u`` (N - 1, nodes) of all intervals; ``at`` (nodes,) are their places, s."""

    def __init__(self, run: Experiment, name: str) -> None:
        self.step = (run.t[-1] - run.t[0]) / (run.n - 1)
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
        # Of a growing mode xi(t) = -integral from t to the end of e^(lambda (t - s)) u(s) ds.
        sign = np.where(growing, -1.0 + 0.0j, 1.0)
        push = self._pushed(sign * np.exp(_decay(values) * self._reach(growing)))
        return self._recursion(values, push)

    def slopes(self, values: _Complex, xi: _Complex) -> _Complex:
        """d xi / d lambda: the recursion of `responses`, differentiated."""
        growing = values.real > 0.0
        reach = self._reach(growing)
        push = self._pushed(np.asarray(reach * np.exp(_decay(values) * reach)))
        over = self.step * np.exp(_decay(values) * self.step)[:, None]
        push += np.where(growing[:, None], -over * xi[:, 1:], over * xi[:, :-1])
        return self._recursion(values, push)

    def _reach(self, growing: NDArray[np.bool_]) -> _Array:
        """Time (nodes, r) from a node to the end of its interval; of growing modes to the start."""
        return np.asarray(np.where(growing, self.at[:, None], self.step - self.at[:, None]))

    def _pushed(self, kernel: _Complex) -> _Complex:
        """What the input adds to each mode in each interval, (r, N - 1): integrals with kernels (nodes, r)."""
        weighted = np.ascontiguousarray(self.weights[:, None] * kernel)
        both = self.u @ weighted.view(np.float64)  # real and imaginary parts in one product
        return np.asarray(both.view(np.complex128).T)

    def _recursion(self, values: _Complex, push: _Complex) -> _Complex:
        """xi(t + step) = e^(lambda step) xi(t) + push from zero; of growing modes backwards from the end."""
        from scipy.signal import lfilter

        xi = np.zeros((values.size, len(self.u) + 1), dtype=np.complex128)
        for i, (grows, over) in enumerate(zip(values.real > 0.0, np.exp(_decay(values) * self.step), strict=True)):
            if grows:
                xi[i, -2::-1] = lfilter([1.0], [1.0, -over], push[i, ::-1])
            else:
                xi[i, 1:] = lfilter([1.0], [1.0, -over], push[i])
        return xi


def _decay(values: _Complex) -> _Complex:
    """Eigenvalues in the direction of time in which the modes decay."""
    return np.asarray(np.where(values.real > 0.0, -values, values))


def _pieces(run: Experiment, name: str, step: float) -> int:
    """Intervals of the input's own samples within one of the record."""
    signal = run.signal(name)
    if signal is None:
        return 1
    return max(1, math.ceil(step / float(np.median(np.diff(signal[0]))) - 0.01))


def _between(run: Experiment, name: str, times: _Array) -> _Array:
    """An input at any times."""
    signal = run.signal(name)
    if signal is not None and signal[3] == 0:
        t, samples, delay, _ = signal
        times = np.clip(times - delay, t[0], t[-1])
    else:
        t, samples = run.t, run.input(name)
    return np.array(_core.interpolate(run.interpolation, t.tolist(), samples.tolist(), times.tolist()))
