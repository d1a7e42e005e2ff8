"""B, D and initial states of a linear system whose A and C are known: linear least squares on the simulated outputs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from . import _core
from .experiment import Experiment
from .hankel import rows_at_once, triangle

__all__ = ["Regression", "regression"]

_Array: TypeAlias = NDArray[np.float64]
_Complex: TypeAlias = NDArray[np.complex128]

# Nodes of Gauss-Legendre on each piece of the input: exact to rounding for a cubic times a mode below the Nyquist rate.
_NODES = 8
# Outputs are weighted by their residuals: so many times anew.
_PASSES = 3
# Directions of the unknowns that matter less than this part of the greatest are left at zero.
_RANK = 1e-12


@dataclass(frozen=True)
class Regression:
    """What the least squares found.

    B (r, m), complex, of the modal coordinates; D (p, m); x0: experiment -> (r,), complex; offsets: experiment -> (p,);
    rms (p,) of the residuals; gains (r,), if asked for: by how much the sum of squares, in units of the noise, would be
    greater without each mode.
    """

    B: _Complex
    D: _Array
    x0: Mapping[str, _Complex]
    offsets: Mapping[str, _Array]
    rms: _Array
    gains: _Array


def regression(
    data: Sequence[Experiment],
    values: _Complex,
    C: _Complex,
    inputs: Sequence[str],
    outputs: Sequence[str],
    feedthrough: Sequence[bool],
    offset: bool,
    gains: bool = False,
) -> Regression:
    """B, D, x0 and offsets such that y_j = Re(C_j xi) + D_j u + offset_j, xi' = lambda xi + B u, fits best.

    ``values`` (r,): eigenvalues, of a pair one. C (p, r), complex. ``feedthrough``: which outputs have D. The inputs
    between samples are taken to run as the experiment says (linear, cubic, or with samples of their own): the response
    of each mode to each input is exact. An eigenvalue with a positive real part is integrated from the end of the
    record backwards, its state there being free, so that unstable systems are as well conditioned as stable ones.
    """
    layout = _Layout(values.imag != 0.0, len(inputs), tuple(feedthrough), offset, len(data))
    triangles = [_triangles(run, values, C, inputs, outputs, layout) for run in data]
    solution, rms, gained = _solved(triangles, layout, sum(run.n for run in data), gains)
    x0, offsets = {}, {}
    B = np.array([_complex(row, layout.paired) for row in solution[layout.common].reshape(layout.m, -1)])
    B = B.reshape(layout.m, values.size).T
    for e, run in enumerate(data):
        own = solution[layout.own(e)]
        x0[run.name] = _first(run, values, inputs, B, _complex(own[: layout.width], layout.paired))
        offsets[run.name] = own[layout.width :] if offset else np.zeros(len(outputs))
    D = np.zeros((len(outputs), layout.m))
    for j in range(len(outputs)):
        if feedthrough[j]:
            D[j] = solution[layout.direct(j)]
    return Regression(B=B, D=D, x0=x0, offsets=offsets, rms=rms, gains=gained)


@dataclass(frozen=True)
class _Layout:
    """Places of the unknowns: of each experiment first states and offsets; then B; D of the outputs that have it."""

    paired: NDArray[np.bool_]
    m: int
    feedthrough: tuple[bool, ...]
    offset: bool
    runs: int

    @property
    def width(self) -> int:
        """Real unknowns of a modal state: two for a pair."""
        return int(np.where(self.paired, 2, 1).sum())

    def own(self, e: int) -> slice:
        """Of an experiment: first states, then offsets of all outputs."""
        size = self.width + len(self.feedthrough) * int(self.offset)
        return slice(e * size, (e + 1) * size)

    @property
    def common(self) -> slice:
        """B, input by input."""
        start = self.own(self.runs).start
        return slice(start, start + self.width * self.m)

    def direct(self, j: int) -> slice:
        """D of output j; empty where it has none."""
        start = self.common.stop + self.m * sum(self.feedthrough[:j])
        return slice(start, start + self.m * int(self.feedthrough[j]))

    @property
    def total(self) -> int:
        """Number of unknowns."""
        return int(self.direct(len(self.feedthrough) - 1).stop)

    def of_mode(self, i: int) -> list[int]:
        """Its first states in all experiments, and its row of B."""
        first = int(np.where(self.paired[:i], 2, 1).sum())
        parts = range(first, first + (2 if self.paired[i] else 1))
        starts = [self.own(e).start for e in range(self.runs)]
        starts += [self.common.start + k * self.width for k in range(self.m)]
        return [start + k for start in starts for k in parts]

    def columns(self, e: int, j: int) -> list[int]:
        """The unknowns that output j of experiment e depends on, in the order of `_rows`."""
        first = self.own(e).start
        offset = [first + self.width + j] if self.offset else []
        places = [self.common, self.direct(j)]
        return [*range(first, first + self.width), *offset, *(k for s in places for k in range(s.start, s.stop))]


def _triangles(
    run: Experiment, values: _Complex, C: _Complex, inputs: Sequence[str], outputs: Sequence[str], layout: _Layout
) -> list[_Array]:
    """The least squares of each output of an experiment, reduced to a triangle; the last column is the output."""
    forced, free = _responses(run, values, inputs), _transients(run, values)
    u = np.array([run.input(name) for name in inputs]).reshape(len(inputs), -1)
    found = []
    for j, name in enumerate(outputs):
        seen = u if layout.feedthrough[j] else u[:0]
        found.append(triangle(_rows(C[j], layout.paired, free, forced, seen, run.output(name), layout.offset)))
    return found


def _solved(
    triangles: Sequence[Sequence[_Array]], layout: _Layout, samples: int, gains: bool
) -> tuple[_Array, _Array, _Array]:
    """All unknowns; the root mean square (p,) of the residuals, by which outputs are weighted; gains of modes."""
    from scipy.linalg import lstsq

    p = len(layout.feedthrough)
    rms = np.sqrt([sum(float(np.sum(each[j][:, -1] ** 2)) for each in triangles) / samples for j in range(p)])
    solution: _Array = np.zeros(layout.total)
    for _ in range(1 if p == 1 else _PASSES):
        blocks = []
        for e, each in enumerate(triangles):
            for j, R in enumerate(each):
                wide = np.zeros((R.shape[0], layout.total + 1))
                wide[:, [*layout.columns(e, j), layout.total]] = R / (rms[j] or 1.0)
                blocks.append(wide)
        whole = triangle(blocks)
        size = np.linalg.norm(whole[:, :-1], axis=0)
        size[size == 0.0] = 1.0
        solution = lstsq(whole[:, :-1] / size, whole[:, -1], cond=_RANK)[0] / size
        squares = np.zeros(p)
        for e, each in enumerate(triangles):
            for j, R in enumerate(each):
                squares[j] += np.sum((R[:, -1] - R[:, :-1] @ solution[layout.columns(e, j)]) ** 2)
        rms = np.sqrt(squares / samples)
    return solution, rms, _gains(whole, size, layout, p * samples) if gains else np.empty(0)


def _gains(whole: _Array, size: _Array, layout: _Layout, samples: int) -> _Array:
    """By how much the sum of squares grows without each mode, the others found anew, in units of the noise."""
    from scipy.linalg import lstsq

    def squares(kept: NDArray[np.intp]) -> float:
        some = lstsq(whole[:, kept] / size[kept], whole[:, -1], cond=_RANK)[0] / size[kept]
        return float(np.sum((whole[:, kept] @ some - whole[:, -1]) ** 2))

    every = np.arange(layout.total)
    least = squares(every)
    without = [squares(np.setdiff1d(every, layout.of_mode(i))) for i in range(layout.paired.size)]
    return (np.array(without) - least) / max(least / samples, np.finfo(np.float64).tiny)


def _first(run: Experiment, values: _Complex, inputs: Sequence[str], B: _Complex, free: _Complex) -> _Complex:
    """Modal states at the first sample: of growing modes those found are at the last."""
    growing = values.real > 0.0
    if not growing.any():
        return free
    forced = np.array([xi[:, 0] for xi in _responses(run, values, inputs)]).reshape(len(inputs), values.size)
    back = np.exp(np.where(growing, -values * (run.t[-1] - run.t[0]), 0.0))
    return np.asarray(free * back + np.where(growing, np.sum(forced * B.T, axis=0), 0.0))


def _complex(numbers: _Array, paired: NDArray[np.bool_]) -> _Complex:
    """Modal coordinates from their real unknowns."""
    found, k = np.zeros(paired.size, dtype=np.complex128), 0
    for i, two in enumerate(paired):
        found[i] = complex(numbers[k], numbers[k + 1]) if two else numbers[k]
        k += 2 if two else 1
    return found


def _columns(c: _Complex, paired: NDArray[np.bool_], xi: _Complex) -> Iterator[_Array]:
    """Re(c b xi) as columns times the real unknowns of b."""
    for i, two in enumerate(paired):
        seen = c[i] * xi[i]
        yield seen.real
        if two:
            yield -seen.imag


def _rows(
    c: _Complex,
    paired: NDArray[np.bool_],
    free: _Complex,
    modes: Sequence[_Complex],
    u: _Array,
    z: _Array,
    offset: bool,
) -> Iterator[_Array]:
    """Rows of the least squares of one output, some at a time; samples that are missing are left out."""
    count = int(np.where(paired, 2, 1).sum()) * (1 + len(modes)) + int(offset) + len(u) + 1
    step = rows_at_once(count)
    for a in range(0, z.size, step):
        b = min(a + step, z.size)
        block = np.ones((b - a, count), order="F")
        k = 0
        for column in _columns(c, paired, free[:, a:b]):
            block[:, k] = column
            k += 1
        k += int(offset)
        for xi in modes:
            for column in _columns(c, paired, xi[:, a:b]):
                block[:, k] = column
                k += 1
        block[:, k:-1] = u[:, a:b].T
        block[:, -1] = z[a:b]
        yield block[np.isfinite(block[:, -1])]


def _transients(run: Experiment, values: _Complex) -> _Complex:
    """e^(lambda t) from the end where it is 1 to where it has decayed, (r, N)."""
    t = run.t
    reference = np.where(values.real > 0.0, t[-1], t[0])
    return np.asarray(np.exp(values[:, None] * (t - reference[:, None])))


def _responses(run: Experiment, values: _Complex, inputs: Sequence[str]) -> list[_Complex]:
    """Of each input the response (r, N) of each mode, from zero at the start; at the end for those that grow."""
    from scipy.signal import lfilter

    step = (run.t[-1] - run.t[0]) / (run.n - 1)
    found = []
    for name in inputs:
        pieces = _pieces(run, name, step)
        x, w = np.polynomial.legendre.leggauss(_NODES)
        # Nodes of all pieces of a sampling interval, as parts of it.
        at = (np.arange(pieces)[:, None] + 0.5 * (x + 1.0)).ravel() / pieces
        weights = np.tile(0.5 * w, pieces) / pieces * step
        times = (run.t[:-1, None] + at * np.diff(run.t)[:, None]).ravel()
        u = _between(run, name, times).reshape(run.n - 1, at.size)
        xi = np.zeros((values.size, run.n), dtype=np.complex128)
        for i, value in enumerate(values):
            if value.real > 0.0:
                # xi(t) = -integral from t to the end of e^(lambda (t - s)) u(s) ds.
                push = u @ (-weights * np.exp(-value * at * step))
                xi[i, -2::-1] = lfilter([1.0], [1.0, -np.exp(-value * step)], push[::-1])
            else:
                push = u @ (weights * np.exp(value * (1.0 - at) * step))
                xi[i, 1:] = lfilter([1.0], [1.0, -np.exp(value * step)], push)
        found.append(xi)
    return found


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
