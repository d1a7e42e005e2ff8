"""Linear least squares for B, D and initial states of a linear system whose A and C are known."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..data.experiment import Experiment
from .sampled import Answers, Sampled, rows_at_once, triangle
from .state_space import StateSpace

__all__ = ["Layout", "ModalRegression", "identified", "path", "regression", "rows", "samples_of"]

_Array: TypeAlias = NDArray[np.float64]
_Complex: TypeAlias = NDArray[np.complex128]

# Passes of the weighting of outputs by their residuals.
_PASSES = 3
# Directions of the unknowns that matter less than this part of the greatest are left at zero.
_RANK = 1e-12


@dataclass(frozen=True)
class ModalRegression:
    """The least-squares solution.

    B (r, m), complex, of the modal coordinates; D (p, m); x0: experiment -> (r,), complex; offsets: experiment -> (p,);
    rms (p,) of the residuals; gains (r,), if asked for: by how much the sum of squares, in units of the noise, would be
    greater without each mode. motion: experiment -> (r,), what multiplies `free`.
    """

    B: _Complex
    D: _Array
    x0: Mapping[str, _Complex]
    offsets: Mapping[str, _Array]
    rms: _Array
    gains: _Array
    motion: Mapping[str, _Complex]


def regression(
    data: Sequence[Answers],
    C: _Complex,
    outputs: Sequence[str],
    feedthrough: Sequence[bool],
    offset: bool,
    gains: bool = False,
) -> ModalRegression:
    """Estimate B, D, x0 and offsets such that y_j = Re(C_j xi) + D_j u + offset_j, xi' = lambda xi + B u, fits best.

    ``data``: of each experiment what modes of the same eigenvalues (r,), of a pair one, do there. C (p, r), complex.
    ``feedthrough``: which outputs have D. The inputs between samples are taken to run as the experiment says (linear,
    cubic, or with samples of their own): the response of each mode to each input is exact. An eigenvalue with a
    positive real part is integrated from the end of the record backwards, its state there being free, so that unstable
    systems are as well conditioned as stable ones.
    """
    values, runs = data[0].values, [answers.driven.run for answers in data]
    layout = Layout(values.imag != 0.0, len(data[0].forced), tuple(feedthrough), offset, len(data))
    triangles = [_triangles(answers, C, outputs, layout) for answers in data]
    solution, rms, gained = _solved(triangles, layout, samples_of(runs, outputs), gains)
    x0, offsets, motion = {}, {}, {}
    B = np.array([_complex(row, layout.paired) for row in solution[layout.common].reshape(layout.m, -1)])
    B = B.reshape(layout.m, values.size).T
    for e, answers in enumerate(data):
        own, name = solution[layout.own(e)], runs[e].name
        motion[name] = _complex(own[: layout.width], layout.paired)
        x0[name] = _first(answers, B, motion[name])
        offsets[name] = own[layout.width :] if offset else np.zeros(len(outputs))
    D = np.zeros((len(outputs), layout.m))
    for j in range(len(outputs)):
        if feedthrough[j]:
            D[j] = solution[layout.direct(j)]
    return ModalRegression(B=B, D=D, x0=x0, offsets=offsets, rms=rms, gains=gained, motion=motion)


def path(answers: Answers, C: _Complex, found: ModalRegression) -> _Array:
    """Return the outputs (p, N) of an experiment."""
    run = answers.driven.run
    xi = answers.states(found.B, found.motion[run.name])
    return np.asarray((C @ xi).real + found.D @ answers.driven.u + found.offsets[run.name][:, None])


@dataclass(frozen=True)
class Layout:
    """Indices of the unknowns: of each experiment initial states and offsets; then B; D of the outputs that have it."""

    paired: NDArray[np.bool_]
    m: int
    feedthrough: tuple[bool, ...]
    offset: bool
    runs: int

    @property
    def width(self) -> int:
        """Number of real unknowns of a modal state: two for a pair."""
        return int(np.where(self.paired, 2, 1).sum())

    def own(self, e: int) -> slice:
        """Return the indices of an experiment: initial states, then offsets of all outputs."""
        size = self.width + len(self.feedthrough) * int(self.offset)
        return slice(e * size, (e + 1) * size)

    @property
    def common(self) -> slice:
        """Indices of B, input by input."""
        start = self.own(self.runs).start
        return slice(start, start + self.width * self.m)

    def direct(self, j: int) -> slice:
        """Return the indices of D of output j; empty where it has none."""
        start = self.common.stop + self.m * sum(self.feedthrough[:j])
        return slice(start, start + self.m * int(self.feedthrough[j]))

    @property
    def total(self) -> int:
        """Number of unknowns."""
        return int(self.direct(len(self.feedthrough) - 1).stop)

    def of_mode(self, i: int) -> list[int]:
        """Return the indices of a mode: its initial states in all experiments, and its row of B."""
        first = int(np.where(self.paired[:i], 2, 1).sum())
        parts = range(first, first + (2 if self.paired[i] else 1))
        starts = [self.own(e).start for e in range(self.runs)]
        starts += [self.common.start + k * self.width for k in range(self.m)]
        return [start + k for start in starts for k in parts]

    def columns(self, e: int, j: int) -> list[int]:
        """Return the indices of the unknowns that output j of experiment e depends on, in the order of `rows`."""
        first = self.own(e).start
        offset = [first + self.width + j] if self.offset else []
        places = [self.common, self.direct(j)]
        return [*range(first, first + self.width), *offset, *(k for s in places for k in range(s.start, s.stop))]


def _triangles(answers: Answers, C: _Complex, outputs: Sequence[str], layout: Layout) -> list[_Array]:
    """Reduce the least squares of each output of an experiment to a triangle, whose last column is the output."""
    found = []
    for j, name in enumerate(outputs):
        z = answers.driven.run.output(name)
        found.append(triangle(rows(C[j], answers, layout.feedthrough[j], z, layout.offset)))
    return found


def samples_of(data: Sequence[Experiment], outputs: Sequence[str]) -> NDArray[np.intp]:
    """Return the number of samples of each output, (p,)."""
    return np.array([sum(int(np.isfinite(run.output(name)).sum()) for run in data) for name in outputs])


def _solved(
    triangles: Sequence[Sequence[_Array]], layout: Layout, samples: NDArray[np.intp], gains: bool
) -> tuple[_Array, _Array, _Array]:
    """Solve for all unknowns; return them, the rms (p,) of the residuals, which are the weights, and gains of modes."""
    from scipy.linalg import lstsq

    p = len(layout.feedthrough)
    rms = np.sqrt([sum(float(np.sum(each[j][:, -1] ** 2)) for each in triangles) / samples[j] for j in range(p)])
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
    return solution, rms, _gains(whole, size, layout, int(samples.sum())) if gains else np.empty(0)


def _gains(whole: _Array, size: _Array, layout: Layout, samples: int) -> _Array:
    """Return the growth of the sum of squares without each mode, the others re-estimated, in units of the noise."""
    from scipy.linalg import lstsq

    def squares(kept: NDArray[np.intp]) -> float:
        some = lstsq(whole[:, kept] / size[kept], whole[:, -1], cond=_RANK)[0] / size[kept]
        return float(np.sum((whole[:, kept] @ some - whole[:, -1]) ** 2))

    every = np.arange(layout.total)
    least = squares(every)
    without = [squares(np.setdiff1d(every, layout.of_mode(i))) for i in range(layout.paired.size)]
    return (np.array(without) - least) / max(least / samples, np.finfo(np.float64).tiny)


def _first(answers: Answers, B: _Complex, found: _Complex) -> _Complex:
    """Return the modal states at the first sample; those of growing modes are estimated at the last."""
    values = answers.values
    growing = values.real > 0.0
    if not growing.any():
        return found
    start = np.array([xi[:, 0] for xi in answers.forced]).reshape(len(answers.forced), values.size)
    t = answers.driven.run.t
    back = np.exp(np.where(growing, -values * (t[-1] - t[0]), 0.0))
    return np.asarray(found * back + np.where(growing, np.sum(start * B.T, axis=0), 0.0))


def _complex(numbers: _Array, paired: NDArray[np.bool_]) -> _Complex:
    """Return modal coordinates made of their real unknowns."""
    found, k = np.zeros(paired.size, dtype=np.complex128), 0
    for i, two in enumerate(paired):
        found[i] = complex(numbers[k], numbers[k + 1]) if two else numbers[k]
        k += 2 if two else 1
    return found


def rows(
    c: _Complex,
    answers: Answers,
    direct: bool,
    z: _Array,
    offset: bool,
    more: _Array | None = None,
) -> Iterator[_Array]:
    """Yield the rows of the least squares of one output, block by block, without missing samples. ``c`` is (r,).

    Columns: free motions, offset, responses to each input, inputs, and ``more`` (k, N) of them; the last is the output.
    """
    paired = answers.values.imag != 0.0
    # Real and imaginary parts of the contribution of each mode; real modes have no imaginary part.
    parts = np.flatnonzero(np.column_stack([np.ones_like(paired), paired]))
    seen = [answers.free, *answers.forced]
    count = parts.size * len(seen) + int(offset)
    others = [answers.driven.u] if direct else []
    others += [] if more is None else [more]
    total = count + sum(map(len, others)) + 1
    step = rows_at_once(total)
    for a in range(0, z.size, step):
        b = min(a + step, z.size)
        block = np.empty((total, b - a))
        each = np.empty((paired.size, 2, b - a))
        k = 0
        for xi in seen:
            turned = c[:, None] * xi[:, a:b]
            each[:, 0], each[:, 1] = turned.real, -turned.imag
            block[k : k + parts.size] = each.reshape(-1, b - a)[parts]
            k += parts.size
            if offset and xi is answers.free:
                block[k] = 1.0
                k += 1
        for rest in others:
            block[k : k + len(rest)] = rest[:, a:b]
            k += len(rest)
        block[-1] = z[a:b]
        there = np.isfinite(block[-1])
        yield (block if there.all() else block[:, there]).T


def identified(records: Sampled, values: _Complex, C: _Complex, found: ModalRegression, **more: Any) -> StateSpace:
    """Return the system with these eigenvalues (r,), one of each pair, and C (p, r); ``more`` as `StateSpace`
    takes it."""
    A, B, C_real, states = _real(values, C, found.B)
    return StateSpace(
        A=A,
        B=B,
        C=C_real,
        D=found.D,
        inputs=tuple(records.inputs),
        outputs=tuple(records.outputs),
        x0={name: states(x) for name, x in found.x0.items()},
        offsets=found.offsets,
        rate=records.rate,
        residual_rms=dict(zip(records.outputs, found.rms.tolist(), strict=True)),
        **more,
    )


def _real(values: _Complex, c: _Complex, b: _Complex) -> tuple[_Array, _Array, _Array, Callable[[_Complex], _Array]]:
    """Return A, B and C in real blocks, of a pair [[sigma, omega], [-omega, sigma]], and the map from modal to such
    states.

    With xi = x_a - j x_b, xi' = (sigma + j omega) xi and Re(c xi) = Re(c) x_a + Im(c) x_b.
    """
    place, width = [], 0
    for value in values:
        place.append(width)
        width += 2 if value.imag != 0.0 else 1
    A, C = np.zeros((width, width)), np.zeros((c.shape[0], width))
    for k, value, seen in zip(place, values, c.T, strict=True):
        A[k, k] = value.real
        C[:, k] = seen.real
        if value.imag != 0.0:
            A[k : k + 2, k : k + 2] = [[value.real, value.imag], [-value.imag, value.real]]
            C[:, k + 1] = seen.imag

    def states(xi: _Complex) -> _Array:
        x = np.zeros((width, *xi.shape[1:]))
        for k, value, each in zip(place, values, xi, strict=True):
            x[k] = each.real
            if value.imag != 0.0:
                x[k + 1] = -each.imag
        return x

    return A, states(b), C, states
