"""Evenly sampled records and their block Hankel matrices, for the identification of linear systems."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..data.experiment import Experiment, as_experiments
from ..data.filtering import EVEN, intervals
from ..errors import DataError, OptionError, listing
from .modal_response import Driven

__all__ = ["Observability", "Sampled", "chosen_outputs", "observability", "triangle"]

_Array: TypeAlias = NDArray[np.float64]

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
                f"t = {run.t[worst]:g} s is {steps[worst]:g} s and others are {step:g} s: cut the record there with "
                ".window, or resample it"
            )
        rates.append((run.n - 1) / float(run.t[-1] - run.t[0]))
    for run, rate in zip(runs, rates, strict=True):
        if abs(rate - rates[0]) > EVEN * rates[0]:
            raise DataError(
                f"{caller}: needs one sampling rate, but experiment '{runs[0].name}' has {rates[0]:g} Hz and "
                f"'{run.name}' {rate:g} Hz"
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
                f"{caller}: experiment '{run.name}', output '{name}': sample {k} (t = {run.t[k]:.6g} s) is missing"
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
            raise OptionError(f"{caller}: feedthrough: '{name}' is no output.{listing(str(name), outputs)}")
    return [name in chosen for name in outputs]
