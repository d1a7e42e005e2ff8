"""Which candidates say something that the model does not, and that no other candidate does.

At random points (states, inputs, time, parameters) a model's parameters each move its equations in some direction: the
derivatives of all quantities, state equations and outputs with respect to it. A candidate within the span of these is
in the model already; two that are parallel beside it are the same. This finds ``alpha^2`` about another centre, a bias
beside a constant, or the scale of an input that only ever stands beside free parameters, without any symbolic algebra.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..._core import Expr
from ...errors import ModelError
from ...modelling.compiled import CompiledModel
from ...modelling.declared import Key
from ...modelling.model import Model
from ...sensitivities.trajectory import Points
from .candidate import Candidate
from .scales import Scales

__all__ = ["Directions", "Verdict"]

_Array = NDArray[np.float64]

# Length beside the parameters' span, of a direction of length 1, that counts as nothing; and of how much the cosine of
# two that count as one falls short of 1.
_SPANNED, _PARALLEL = 1e-7, 1e-9


@dataclass(frozen=True)
class Verdict:
    """On a candidate: whether the model's parameters move the equations just so; else which earlier one does."""

    spanned: bool = False
    twin: int | None = None


class Directions:
    """Directions of a model's free parameters at random points."""

    def __init__(self, model: Model, scales: Scales, seed: int = 0) -> None:
        free = [name for name, p in model.declared_parameters.items() if not p.fixed]
        equations = {k: e for k, e in model._right_hand_sides().items() if k[0] in ("quantity", "equation", "output")}
        self._keys: list[Key] = list(equations)
        inputs = list(model.declared_inputs)
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

    def verdicts(self, candidates: Sequence[Candidate]) -> list[Verdict]:
        """Return the verdict on each of some candidates that have one signal, which depends on no shape."""
        found = [Verdict()] * len(candidates)
        groups: dict[tuple[Key, ...], list[tuple[int, _Array]]] = {}
        for i, c in enumerate(candidates):
            blocks = self._blocks(c)
            groups.setdefault(tuple(blocks), []).append((i, np.concatenate([np.zeros(0), *blocks.values()])))
        for keys, members in groups.items():
            v = np.stack([vector for _, vector in members])
            size = np.linalg.norm(v, axis=1)
            v = v / np.where(size > 0, size, 1.0)[:, np.newaxis]
            along = v @ np.concatenate([self._basis[key] for key in keys]) if keys else v
            # Of the parts beside the parameters' span; the square of their lengths carries rounding errors of 1e-16.
            product = v @ v.T - along @ along.T
            beside = np.sqrt(np.maximum(np.diag(product), 0.0))
            kept: list[int] = []
            for row, (i, _) in enumerate(members):
                if beside[row] <= _SPANNED:
                    found[i] = Verdict(spanned=True)
                    continue
                cosine = np.abs(product[row, kept]) / (beside[row] * beside[kept])
                twins = np.flatnonzero(1.0 - cosine < _PARALLEL)
                if twins.size:
                    found[i] = Verdict(twin=members[kept[twins[0]]][0])
                else:
                    kept.append(row)
        return found

    def _blocks(self, candidate: Candidate) -> dict[Key, _Array]:
        """Return how a candidate moves the equations: values for each that it moves."""
        signal = np.nan_to_num(candidate.signals(self.points, {})[0], posinf=0.0, neginf=0.0)
        if candidate.place.kind == "input":
            slopes = self._slopes.get(candidate.place.name, {})
            return {key: slope * signal / self._unit[key] for key, slope in slopes.items()}
        key = (candidate.place.kind, candidate.place.name)
        return {key: signal / self._unit[key]}


def _random(
    model: Model, scales: Scales, equations: dict[Key, Expr], wanted: Sequence[Expr], n: int, seed: int
) -> tuple[Points, list[_Array]]:
    """Random points, and values of expressions there; only points at which everything is finite."""
    random = np.random.default_rng(seed)
    names, quantities = [*model.declared_inputs, *model.state_names], model.quantity_names
    every = [Expr.symbol(name) for name in quantities] + [equations["equation", name] for name in model.state_names]
    # A delay of an output stands in no equation, which an evaluator takes for a slip: here all stand in the last.
    every_parameter = [Expr(sum((Expr.symbol(name) for name in model.parameter_names), Expr(0.0)))]
    added = {f"no_output__{i}": e for i, e in enumerate([*every, *wanted, *every_parameter])}
    # Half of them on the positive side: equations may hold a root or a logarithm.
    draws = random.uniform(-1.0, 1.0, (len(names), 4 * n))
    draws[:, ::2] = np.abs(draws[:, ::2])
    # Wider than the record: where a speed hardly varies, what goes with it would look like a constant.
    widths = [max(1.3 * scales.span(name), 0.3 * abs(scales.centre(name))) for name in names]
    columns = [scales.centre(name) + w * row for name, w, row in zip(names, widths, draws, strict=True)]
    t = scales.begin + scales.duration * np.sort(random.random(4 * n))
    theta = random.uniform(0.5, 1.5, len(model.parameter_names))
    y = CompiledModel(model._changed(outputs=added)).outputs(theta, np.vstack([t, *columns]))
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
