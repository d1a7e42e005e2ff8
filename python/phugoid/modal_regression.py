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


@dataclass(frozen=True)
class Regression:
    """What the least squares found.

    B (r, m), complex, of the modal coordinates; D (p, m); x0: experiment -> (r,), complex; offsets: experiment -> (p,);
    rms (p,) of the residuals.
    """

    B: _Complex
    D: _Array
    x0: Mapping[str, _Complex]
    offsets: Mapping[str, _Array]
    rms: _Array


def regression(
    data: Sequence[Experiment],
    values: _Complex,
    C: _Complex,
    inputs: Sequence[str],
    outputs: Sequence[str],
    feedthrough: Sequence[bool],
    offset: bool,
) -> Regression:
    """B, D, x0 and offsets such that y_j = Re(C_j xi) + D_j u + offset_j, xi' = lambda xi + B u, fits best.

    ``values`` (r,): eigenvalues, of a pair one. C (p, r), complex. ``feedthrough``: which outputs have D. The inputs
    between samples are taken to run as the experiment says (linear, cubic, or with samples of their own): the response
    of each mode to each input is exact. An eigenvalue with a positive real part is integrated from the end of the
    record backwards, its state there being free, so that unstable systems are as well conditioned as stable ones.
    """
    from scipy.linalg import lstsq

    r, m, p = values.size, len(inputs), len(outputs)
    paired = values.imag != 0.0
    # Real unknowns of a modal coordinate: two for a pair.
    width = int(np.where(paired, 2, 1).sum())
    n_common = width * m

    # Each output of each experiment as a triangle of [x0, offset | B, D_j | z_j].
    triangles: list[list[_Array]] = []
    counts = np.zeros(p)
    for run in data:
        modes = _responses(run, values, inputs)
        free = _transients(run, values)
        u = np.array([run.input(name) for name in inputs]).reshape(m, -1)
        z = np.array([run.output(name) for name in outputs])
        counts += run.n
        triangles.append(
            [triangle(_rows(C[j], paired, free, modes, u if feedthrough[j] else u[:0], z[j], offset)) for j in range(p)]
        )

    starts = np.cumsum([0, *(m if f else 0 for f in feedthrough)])
    n_total = len(data) * (width + p * int(offset)) + n_common + int(starts[-1])
    base = len(data) * (width + p * int(offset))
    rms = np.array([np.sqrt(sum(np.sum(t[j][:, -1] ** 2) for t in triangles) / counts[j]) for j in range(p)])
    solution: _Array = np.zeros(n_total)
    for _ in range(1 if p == 1 else _PASSES):
        blocks, places = [], []
        for e, each in enumerate(triangles):
            for j, R in enumerate(each):
                first = e * (width + p * int(offset))
                place = [*range(first, first + width)]
                place += [first + width + j] if offset else []
                place += range(base, base + n_common)
                place += range(base + n_common + int(starts[j]), base + n_common + int(starts[j + 1]))
                wide = np.zeros((R.shape[0], n_total + 1))
                wide[:, [*place, n_total]] = R / (rms[j] or 1.0)
                blocks.append(wide)
                places.append(place)
        whole = triangle(blocks)
        size = np.linalg.norm(whole[:, :-1], axis=0)
        size[size == 0.0] = 1.0
        solution = lstsq(whole[:, :-1] / size, whole[:, -1], cond=1e-12)[0] / size
        squares = np.zeros(p)
        for k, R in enumerate(R for each in triangles for R in each):
            squares[k % p] += np.sum((R[:, -1] - R[:, :-1] @ solution[places[k]]) ** 2)
        rms = np.sqrt(squares / counts)

    common = solution[base : base + n_common].reshape(m, width)
    B = np.array([_complex(row, paired) for row in common]).reshape(m, r).T
    D = np.zeros((p, m))
    for j in range(p):
        if feedthrough[j]:
            D[j] = solution[base + n_common + starts[j] : base + n_common + starts[j + 1]]
    x0, offsets = {}, {}
    for e, run in enumerate(data):
        mine = solution[e * (width + p * int(offset)) :][: width + p * int(offset)]
        begin = _complex(mine[:width], paired)
        growing = values.real > 0.0
        if growing.any():
            begin = begin * np.exp(np.where(growing, -values * (run.t[-1] - run.t[0]), 0.0))
            forced = np.array([f[:, 0] for f in _responses(run, values, inputs)]).reshape(m, r)
            begin = begin + np.where(growing, np.sum(forced * B.T, axis=0), 0.0)
        x0[run.name] = begin
        offsets[run.name] = mine[width:] if offset else np.zeros(p)
    return Regression(B=B, D=D, x0=x0, offsets=offsets, rms=rms)


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
