"""Evenly sampled records, their block Hankel matrices and modal responses, to identify linear systems."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..data.experiment import Experiment, as_experiments
from ..data.filtering import EVEN, interpolated, intervals
from ..errors import DataError, OptionError, listing

__all__ = [
    "Answers",
    "Driven",
    "Observability",
    "Sampled",
    "chosen_outputs",
    "observability",
    "triangle",
]

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


# Rows reduced at once, few enough for the cache; and columns of a panel.
_ROWS, _PANEL = 1000, 16


def triangle(blocks: Iterable[_Array]) -> _Array:
    """Return R (k, k) of the QR factorisation of the stacked blocks (rows, k); the blocks are overwritten."""
    from scipy.linalg.lapack import dtpqrt

    R: _Array | None = None
    for block in blocks:
        k = block.shape[1]
        if R is None:
            R = np.zeros((k, k), order="F")
        # R is triangular and stays so: LAPACK's triangular-pentagonal QR makes use of it.
        R, *_ = dtpqrt(0, min(_PANEL, k), R, np.asfortranarray(block), overwrite_a=True, overwrite_b=True)
    assert R is not None
    return np.asarray(R)


def rows_at_once(columns: int) -> int:
    """Return the rows of a block with so many columns: at least as many as columns, or the work is in R."""
    return max(columns, _ROWS)


@dataclass(frozen=True)
class Observability:
    """The extended observability matrix, (i p, n) for each order n, in a basis of falling importance.

    singular_values  canonical correlations of past and future ("cva"), or singular values over the greatest ("moesp").
    """

    singular_values: _Array
    directions: _Array

    def system(self, order: int, outputs: int) -> tuple[_Array, _Array]:
        """Return the discrete A (n, n) and C (p, n), from the shift of the matrix."""
        from scipy.linalg import lstsq

        gamma = self.directions[:, :order]
        A = lstsq(gamma[:-outputs], gamma[outputs:])[0]
        return np.asarray(A), gamma[:outputs]


def observability(runs: Sequence[tuple[_Array, _Array]], block_rows: int, weighting: str) -> Observability:
    """Estimate the extended observability matrix from what past inputs and outputs predict of future outputs.

    ``runs``: of each experiment inputs (m, N) and outputs (p, N), of about unit size. Rows of the block Hankel matrices
    are, with i block rows: future inputs, past inputs and outputs, future outputs. With the L of their LQ factorisation
    the projection of MOESP is L32 (Verhaegen, Automatica 30(1), 1994: past outputs as instruments), and canonical
    variates weigh it with the inverse root of L32 L32' + L33 L33' (Van Overschee and De Moor, Subspace Identification
    for Linear Systems, 1996, sec. 4.3). The mean of each row is taken out, in each experiment: a constant of its own in
    any channel makes no difference.
    """
    from scipy.linalg import cholesky, solve_triangular, svd

    i, m, p = block_rows, runs[0][0].shape[0], runs[0][1].shape[0]
    L = triangle(block for u, y in runs for block in _blocks(u, y, i)).T
    past, future = m * i, m * i + (m + p) * i
    shared, rest = L[future:, past:future], L[future:, future:]
    if weighting == "moesp":
        U, s, _ = svd(shared, full_matrices=False)
        return Observability(s / s[0], U * np.sqrt(s / s[0]))
    # A part in 1e12 more than there is: noise-free outputs have no inverse root.
    power = shared @ shared.T + rest @ rest.T
    power[np.diag_indices_from(power)] += 1e-12 * np.trace(power) / power.shape[0]
    root = cholesky(power, lower=True)
    U, s, _ = svd(solve_triangular(root, shared, lower=True), full_matrices=False)
    return Observability(s, root @ (U * np.sqrt(s)))


def _blocks(u: _Array, y: _Array, i: int) -> Iterator[_Array]:
    """Yield the columns of the Hankel matrices of one experiment, transposed, block by block."""
    m, p, count = u.shape[0], y.shape[0], u.shape[1] - 2 * i + 1
    # Column k of the block is channel `row` delayed by `lag`.
    channels = [(u[r], lag) for lag in range(i, 2 * i) for r in range(m)]
    channels += [(u[r], lag) for lag in range(i) for r in range(m)]
    channels += [(y[r], lag) for lag in range(2 * i) for r in range(p)]
    means = [float(w[lag : lag + count].mean()) for w, lag in channels]
    step = rows_at_once(len(channels))
    for first in range(0, count, step):
        last = min(first + step, count)
        block = np.empty((last - first, len(channels)), order="F")
        for k, ((w, lag), mean) in enumerate(zip(channels, means, strict=True)):
            block[:, k] = w[first + lag : last + lag] - mean
        yield block


@dataclass(frozen=True, eq=False)
class Sampled:
    """Experiments, and of each inputs (m, N) and outputs (p, N) over their sizes ``u_size`` (m,), ``y_size`` (p,).

    Sizes are standard deviations about the mean of each experiment. ``rate`` is that of the samples, Hz.
    """

    runs: Sequence[Experiment]
    inputs: Sequence[str]
    outputs: Sequence[str]
    columns: Sequence[tuple[_Array, _Array]]
    u_size: _Array
    y_size: _Array
    rate: float

    @cached_property
    def driven(self) -> list[Driven]:
        """The experiments prepared for modal responses."""
        return [Driven(run, self.inputs) for run in self.runs]

    @property
    def lengths(self) -> list[int]:
        """Samples of each experiment, N."""
        return [run.n for run in self.runs]

    @classmethod
    def of(
        cls,
        data: Any,
        inputs: str | Sequence[str] | None,
        outputs: str | Sequence[str] | None,
        caller: str = "subspace",
        complete: bool = True,
    ) -> Sampled:
        """Return the experiments with scaled channels. Raises DataError where a channel is missing or never changes, or
        time is uneven; and, with ``complete``, where a sample is missing."""
        runs = as_experiments(data, caller)
        u_names = _names(caller, "inputs", inputs, runs[0])
        y_names = _names(caller, "outputs", outputs, runs[0])
        rate = _rate(caller, runs)
        columns = [_columns(caller, run, u_names, y_names, complete) for run in runs]
        u_size, y_size = (_sizes([pair[k] for pair in columns]) for k in (0, 1))
        for name, size in zip([*u_names, *y_names], [*u_size, *y_size], strict=True):
            if not size > 0.0:
                raise DataError(f"{caller}: '{name}' never changes: leave it out")
        scaled = [(u / u_size[:, None], y / y_size[:, None]) for u, y in columns]
        return cls(runs, u_names, y_names, scaled, u_size, y_size, rate)


def _names(
    caller: str, kind: Literal["inputs", "outputs"], given: str | Sequence[str] | None, run: Experiment
) -> list[str]:
    if given is None:
        names = list(run.inputs if kind == "inputs" else run.outputs)
        if not names:
            raise DataError(
                f"{caller}: experiment '{run.name}' does not say which channels are {kind}: name them, {kind}=..."
            )
        return names
    names = given.replace(",", " ").split() if isinstance(given, str) else list(given)
    if not names or len(set(names)) < len(names):
        raise OptionError(f"{caller}: {kind} names channels, each once, not {given!r}")
    return names


def _rate(caller: str, runs: Sequence[Experiment]) -> float:
    """Return the sampling rate of all experiments, Hz."""
    rates = []
    for run in runs:
        step, steps, uneven = intervals(run.t)
        if uneven.size:
            worst = int(np.argmax(np.abs(steps - step)))
            raise DataError(
                f"{caller}: needs evenly spaced samples, but in experiment '{run.name}' the interval after "
                f"t = {run.t[worst]:g} is {steps[worst]:g} and others are {step:g}: cut the record there with "
                ".window, or resample it"
            )
        rates.append((run.n - 1) / float(run.t[-1] - run.t[0]))
    for run, rate in zip(runs, rates, strict=True):
        if abs(rate - rates[0]) > EVEN * rates[0]:
            raise DataError(
                f"{caller}: needs one sampling rate, but experiment '{runs[0].name}' has {rates[0]:g} and "
                f"'{run.name}' {rate:g}"
            )
    return rates[0]


def _columns(
    caller: str, run: Experiment, inputs: Sequence[str], outputs: Sequence[str], complete: bool
) -> tuple[_Array, _Array]:
    """Return inputs (m, N) and outputs (p, N)."""
    run.check_for(inputs, outputs, outputs)
    for name in outputs if complete else ():
        missing = np.flatnonzero(np.isnan(run.output(name)))
        if missing.size:
            k = int(missing[0])
            raise DataError(
                f"{caller}: experiment '{run.name}', output '{name}': sample {k} (t = {run.t[k]:.6g}) is missing"
                f"{f' (and {missing.size - 1} more)' if missing.size > 1 else ''}: cut the record there with .window "
                "and give the parts as several experiments, or fill the gap"
            )
    u = np.array([run.input(name) for name in inputs]).reshape(len(inputs), run.n)
    return u, np.array([run.output(name) for name in outputs])


def _sizes(channels: Sequence[_Array]) -> _Array:
    """Return the standard deviation of each channel about the mean of each experiment."""
    squares = [np.nansum((c - np.nanmean(c, axis=1, keepdims=True)) ** 2, axis=1) for c in channels]
    count = np.sum([np.isfinite(c).sum(axis=1) for c in channels], axis=0)
    size = np.sqrt(np.sum(squares, axis=0) / count)
    level = np.max([np.nanmax(np.abs(c), axis=1) for c in channels], axis=0)
    return np.asarray(np.where(size > 1e-13 * level, size, 0.0))


def chosen_outputs(caller: str, feedthrough: bool | Collection[str], outputs: Sequence[str]) -> list[bool]:
    """Return for each output whether inputs act on it directly: on all, or on those named."""
    if isinstance(feedthrough, bool):
        return [feedthrough] * len(outputs)
    chosen = [feedthrough] if isinstance(feedthrough, str) else list(feedthrough)
    for name in chosen:
        if name not in outputs:
            raise OptionError(f"{caller}: feedthrough: '{name}' is not an output.{listing(str(name), outputs)}")
    return [name in chosen for name in outputs]
