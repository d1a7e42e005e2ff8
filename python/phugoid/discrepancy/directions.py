"""Which candidates say something that the model does not, and that no other candidate does.

At random points (states, inputs, time, parameters) a model's parameters each move its equations in some direction: the
derivatives of all quantities, state equations and outputs with respect to it. A candidate within the span of these is
in the model already; two that are parallel beside it are the same. This finds ``alpha^2`` about another centre, a bias
beside a constant, or the scale of an input that only ever stands beside free parameters, without any symbolic algebra.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .. import _core
from .._core import Expr
from ..errors import ModelError
from ..model import Model
from ..rebuilt import Key, rebuilt
from .candidate import Candidate
from .points import Points
from .scales import Scales

__all__ = ["Direction", "Directions"]

_Array = NDArray[np.float64]

# Sine of the angle between directions that count as one.
_SAME = 1e-7


class Direction:
    """How a candidate moves the equations: (rows,) values in some blocks of rows, beside the parameters' span."""

    def __init__(self, blocks: dict[Key, _Array], along: _Array) -> None:
        self.blocks, self.along = blocks, along
        total = sum(float(v @ v) for v in blocks.values())
        self.size = math.sqrt(total)
        self.beside = math.sqrt(max(total - float(along @ along), 0.0))

    @property
    def spanned(self) -> bool:
        """Whether the model's parameters move the equations so too."""
        # Both squares carry rounding errors of 1e-16 or so, their difference's root 1e-8.
        return self.beside <= _SAME * self.size

    def parallel(self, other: Direction) -> bool:
        """Whether both are the same beside the parameters."""
        common = self.blocks.keys() & other.blocks.keys()
        if not common or self.spanned or other.spanned:
            return False
        product = sum(float(self.blocks[key] @ other.blocks[key]) for key in common) - float(self.along @ other.along)
        cosine = float(product / (self.beside * other.beside))
        return 1.0 - abs(cosine) < 1e-9


class Directions:
    """Directions of a model's free parameters at random points."""

    def __init__(self, model: Model, scales: Scales, seed: int = 0) -> None:
        free = [name for name, p in model.declared_parameters.items() if not p.fixed]
        core = model._core
        kinds = {"quantity": core.quantities, "equation": core.dynamics, "output": core.outputs}
        self._keys: list[Key] = [(kind, name) for kind, group in kinds.items() for name, *_ in group]
        equations = {(kind, name): e for kind, group in kinds.items() for name, e, *_ in group}
        inputs = [name for name, _ in core.inputs]
        wanted = {(key, name): Expr(equations[key].diff(name)) for key in self._keys for name in (*free, *inputs)}
        wanted = {key: e for key, e in wanted.items() if e.constant != 0.0}
        n = 64 + 2 * len(free)
        self.points, values = _random(model, scales, equations, list(wanted.values()), n, seed)
        partial = dict(zip(wanted, values, strict=True))
        self._slopes = {
            name: {key: partial[key, name] for key in self._keys if (key, name) in partial} for name in inputs
        }
        self._unit = dict.fromkeys(self._keys, 1.0)
        columns = np.zeros((len(self._keys) * self.points.n, len(free)))
        for i, key in enumerate(self._keys):
            rows = slice(i * self.points.n, (i + 1) * self.points.n)
            for j, name in enumerate(free):
                if (key, name) in partial:
                    columns[rows, j] = partial[key, name]
            # Equations differ in unit by many orders of magnitude: none may drown the others.
            largest = float(np.abs(columns[rows]).max(initial=0.0))
            self._unit[key] = largest if largest > 0 else 1.0
            columns[rows] /= self._unit[key]
        lengths = np.linalg.norm(columns, axis=0)
        columns = columns[:, lengths > 0] / lengths[lengths > 0]
        u, s, _ = np.linalg.svd(columns, full_matrices=False)
        basis = u[:, s > 1e-12 * s.max(initial=0.0)]
        self._basis = {key: basis[i * self.points.n : (i + 1) * self.points.n] for i, key in enumerate(self._keys)}

    def of(self, candidate: Candidate) -> Direction:
        """The direction of a candidate with one signal that depends on no shape."""
        signal = np.nan_to_num(candidate.signals(self.points, {})[0], posinf=0.0, neginf=0.0)
        if candidate.place.kind == "input":
            blocks = {key: slope * signal for key, slope in self._slopes.get(candidate.place.name, {}).items()}
        else:
            blocks = {(candidate.place.kind, candidate.place.name): signal}
        blocks = {key: v / self._unit[key] for key, v in blocks.items()}
        size = sum(float(v @ v) for v in blocks.values()) ** 0.5
        if size > 0:
            blocks = {key: v / size for key, v in blocks.items()}
        first = next(iter(self._basis.values()), np.zeros((0, 0)))
        along = np.zeros(first.shape[1])
        for key, v in blocks.items():
            along += self._basis[key].T @ v
        return Direction(blocks, along)


def _random(
    model: Model, scales: Scales, equations: dict[Key, Expr], wanted: Sequence[Expr], n: int, seed: int
) -> tuple[Points, list[_Array]]:
    """Random points, and values of expressions there; only points at which everything is finite."""
    old, random = model._core, np.random.default_rng(seed)
    names = [name for name, _ in old.inputs] + list(model.state_names)
    quantities = [name for name, *_ in old.quantities]

    def declare(core: _core.Model, declared: object) -> None:
        core.parameter(*declared)  # type: ignore[misc]

    core = rebuilt(old, old.inputs, declare)
    every = [Expr.symbol(name) for name in quantities] + [equations["equation", name] for name in model.state_names]
    # A delay of an output stands in no equation, which an evaluator takes for a slip: here all stand in the last.
    every_parameter = [Expr(sum((Expr.symbol(name) for name in model.parameter_names), Expr(0.0)))]
    for i, e in enumerate([*every, *wanted, *every_parameter]):
        core.output(f"no_output__{i}", e, "", None)
    # Half of them on the positive side: equations may hold a root or a logarithm.
    draws = random.uniform(-1.0, 1.0, (len(names), 4 * n))
    draws[:, ::2] = np.abs(draws[:, ::2])
    # Wider than the record: where a speed hardly varies, what goes with it would look like a constant.
    widths = [max(1.3 * scales.span(name), 0.3 * abs(scales.centre(name))) for name in names]
    columns = [scales.centre(name) + w * row for name, w, row in zip(names, widths, draws, strict=True)]
    t = scales.begin + scales.duration * np.sort(random.random(4 * n))
    theta = random.uniform(0.5, 1.5, len(model.parameter_names))
    y = _core.Evaluator(core).outputs(theta, np.vstack([t, *columns]))
    good = np.flatnonzero(np.isfinite(y).all(axis=0))[-n:]
    if good.size < 16:
        raise ModelError(
            "candidates: the model's equations are hardly anywhere finite at random points about zero or the trims; "
            "give trim=..., typical values of states and inputs"
        )
    y, t = y[:, good], t[good]
    m, n_q, n_x = len(model.output_names), len(quantities), len(model.state_names)
    values = {name: column[good] for name, column in zip(names, columns, strict=True)}
    values |= dict(zip(quantities, y[m : m + n_q], strict=True))
    rates = dict(zip(model.state_names, y[m + n_q : m + n_q + n_x], strict=True))
    outputs = dict(zip(model.output_names, y[:m], strict=True))
    return Points("random", t, values, rates, outputs, {}), list(y[m + n_q + n_x : -1])
