"""Candidates, by number and by name, and those that the user writes; which of them say something that the model does
not, and that no other candidate does.

At random points (states, inputs, time, parameters) a model's parameters each move its equations in some direction: the
derivatives of all quantities, state equations and outputs with respect to it. A candidate within the span of these is
in the model already; two that are parallel beside it are the same. This finds ``alpha^2`` about another centre, a bias
beside a constant, or the scale of an input that only ever stands beside free parameters, without any symbolic algebra.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from ..._core import Expr
from ...errors import DataError, ModelError, UnknownName, did_you_mean
from ...modelling.compiled import CompiledModel
from ...modelling.declared import Key
from ...modelling.model import Model
from ...notebook import notebook_page, table
from ...parameters import text_table
from ...sensitivities import Place, Points
from .candidate import Candidate, Effect
from .scales import Scales

__all__ = [
    "Candidates",
    "Directions",
    "Verdict",
    "read_terms",
]

# Whoever looks for the scale of an input whose derivatives are free does not find it.
_LEFT_OUT = " Effects that the parameters of the model can represent are left out."
# What a diagnosis compares with all candidates, and is none of them.
_NO_TERMS = ("noise", "event", "hold", "cubic", "clock", "f(")


def _unknown(wanted: str, known: Mapping[str, Candidate]) -> UnknownName:
    """Return the error for a name or a pattern that no candidate has."""
    _, _, kind = wanted.rpartition(":")
    if kind.strip("*").startswith(_NO_TERMS):
        why = (
            " Disturbances, unknown functions and what an input does between its samples are no candidates: a "
            "diagnosis tries them by itself."
        )
    else:
        why = f"{did_you_mean(wanted, known)}{_LEFT_OUT}"
    return UnknownName(f"there is no candidate '{wanted}'.{why}")


class Candidates(Sequence[Candidate]):
    """Things that a model may be missing: a sequence, read-only, also by name.

    >>> from phugoid import Model, candidates
    >>> m = Model("oscillator")
    >>> x, v = m.states("x v")
    >>> k, c = m.parameters("k c")
    >>> m.dynamics(x=v, v=-k*x - c*v)
    >>> m.outputs(x=x)
    >>> library = candidates(m)
    >>> library["v':x^3"]
    <v':x^3: v' contains a term proportional to the cube of x>
    >>> library.only("v':x*").names
    ("v':x^2", "v':x*v", "v':x^2*v", "v':x^3", "v':x|x|")
    """

    def __init__(self, candidates: Iterable[Candidate] = ()) -> None:
        self._all = tuple(candidates)
        self._by_name: dict[str, Candidate] = {}
        parameters: dict[str, str] = {}
        for c in self._all:
            if not isinstance(c, Candidate):
                raise ModelError(f"candidates: {c!r} is a {type(c).__name__}, not a candidate")
            if c.name in self._by_name:
                raise ModelError(f"candidates: '{c.name}' is given twice")
            self._by_name[c.name] = c
            for name in c.parameters:
                if name in parameters:
                    raise ModelError(f"candidates: '{parameters[name]}' and '{c.name}' both name a parameter '{name}'")
                parameters[name] = c.name

    @overload
    def __getitem__(self, key: int | str) -> Candidate: ...
    @overload
    def __getitem__(self, key: slice) -> Candidates: ...
    def __getitem__(self, key: int | str | slice) -> Candidate | Candidates:
        if isinstance(key, slice):
            return Candidates(self._all[key])
        if isinstance(key, str):
            if key not in self._by_name:
                raise _unknown(key, self._by_name)
            return self._by_name[key]
        return self._all[key]

    def __len__(self) -> int:
        return len(self._all)

    def __iter__(self) -> Iterator[Candidate]:
        return iter(self._all)

    def __contains__(self, key: object) -> bool:
        return key in self._by_name if isinstance(key, str) else key in self._all

    @property
    def names(self) -> tuple[str, ...]:
        """The names, in order."""
        return tuple(self._by_name)

    def __add__(self, other: Iterable[Candidate]) -> Candidates:
        """Both; raises ModelError where a name is in both."""
        return Candidates([*self._all, *other])

    def without(self, *names: str) -> Candidates:
        """Return all but some, by name or by pattern: ``without("CL:periodic", "*:lag_*")``.

        Raises UnknownName for a name or pattern that fits none.
        """
        out = self._matching(names)
        return Candidates(c for c in self._all if c.name not in out)

    def only(self, *names: str) -> Candidates:
        """Return some, by name or by pattern: ``only("CL:*", "de:delay")``."""
        kept = self._matching(names)
        return Candidates(c for c in self._all if c.name in kept)

    def _matching(self, patterns: Sequence[str]) -> set[str]:
        found: set[str] = set()
        for pattern in patterns:
            # A product's own star is no wild card.
            fits = {pattern} if pattern in self._by_name else {n for n in self._by_name if fnmatchcase(n, pattern)}
            if not fits:
                raise _unknown(pattern, self._by_name)
            found |= fits
        return found

    def on(self, points: Sequence[Points], trim: Mapping[str, float] | None = None) -> Candidates:
        """Return the same with centres, widths and grids for a record; without those that it cannot determine, since
        a variable does not vary or (sign forms) does not change sign. Others' candidates stay as they are."""
        if not points:
            raise DataError("candidates: there are no points")
        scales = Scales.of(points, trim)
        bound = [c.on(scales) if isinstance(c, Effect) else c for c in self._all]
        return Candidates(c for c in bound if not isinstance(c, Effect) or c.worthwhile())

    @property
    def families(self) -> dict[str, int]:
        """How many there are of each family."""
        counts: dict[str, int] = {}
        for c in self._all:
            family = c.family if isinstance(c, Effect) else "other"
            counts[family] = counts.get(family, 0) + 1
        return counts

    def __repr__(self) -> str:
        counts = ", ".join(f"{count} {family}" for family, count in self.families.items())
        return f"<{len(self)} candidates: {counts}>" if counts else "<no candidates>"

    def _ipython_key_completions_(self) -> list[str]:
        return list(self._by_name)

    def _repr_html_(self) -> str:
        counts = ", ".join(f"{count} {family}" for family, count in self.families.items())
        return notebook_page(f"{len(self)} candidates", table(_HEADS, self._rows(), _ALIGN), note=counts)

    def __str__(self) -> str:
        return text_table(_HEADS, self._rows(), _ALIGN)

    def _rows(self) -> list[list[str]]:
        return [[c.name, c.explanation, ", ".join(c.parameters), str(len(c.shapes))] for c in self._all]


_HEADS, _ALIGN = ("candidate", "explanation", "parameters", "shapes"), "lllr"


_JUMPS = {
    "sign": "smooth_sign(x, width)",
    "lt": "smooth_step(x, width)",
    "le": "smooth_step(x, width)",
    "not": "smooth_step(x, width)",
    "and": "a product of smooth_step(x, width)",
    "or": "smooth_step(x, width)",
}


def read_terms(model: Model, terms: Mapping[str, Any]) -> Iterator[tuple[Place, str, Expr]]:
    """Place, name (second part) and expression of each of ``terms``, as `candidates` takes them.

    Raises ModelError for a place that is not there, and for an expression with unknown symbols, parameters, or jumps.
    """
    if not isinstance(terms, Mapping):
        raise ModelError(f"terms: give expressions by place, as in {{'Cm': [alpha*q**2]}}, not {terms!r}")
    for key, value in terms.items():
        place, what = _place(model, str(key))
        several = isinstance(value, Sequence) and not isinstance(value, str)
        expressions = list(value) if several else [value]
        if what and len(expressions) > 1:
            raise ModelError(f"terms: '{key}' names one term, but {len(expressions)} are given")
        for given in expressions:
            e = _checked(model, place, str(key), given)
            yield place, what or str(e).replace("**", "^").replace(" ", ""), e


def _place(model: Model, key: str) -> tuple[Place, str]:
    """Place and, where there is one, the user's name for the term: "Cm", "q'", "y:alpha", "Cm:my name"."""
    quantities = list(model.quantity_names)
    head, _, what = key.partition(":")
    if head in quantities:
        return Place("quantity", head), what
    if head.endswith("'") and head[:-1] in model.state_names:
        return Place("equation", head[:-1]), what
    if head == "y":
        head, _, what = what.partition(":")
    if head in model.output_names:
        return Place("output", head), what
    known = [*quantities, *(f"{name}'" for name in model.state_names), *(f"y:{name}" for name in model.output_names)]
    raise ModelError(
        f"terms: '{key}' names no quantity, state equation (with a prime) or output."
        f"{did_you_mean(head, known)} There are: {', '.join(known)}."
    )


def _checked(model: Model, place: Place, key: str, given: Any) -> Expr:
    try:
        e = Expr(given)
    except TypeError:
        raise ModelError(f"terms: '{key}' holds {given!r}, not an expression") from None
    quantities = list(model.quantity_names)
    if place.kind == "quantity":  # it may hold only those above it
        later = quantities[quantities.index(place.name) :]
        for name in {*later}.intersection(e.symbols):
            raise ModelError(f"terms: {e} in '{key}' holds '{name}', which stands below {place.name} in the model")
    known = {*model.state_names, "time", *model.declared_inputs, *quantities}
    for name in e.symbols:
        if name in model.parameter_names:
            raise ModelError(
                f"terms: {e} in '{key}' holds the parameter '{name}'; its coefficient is added, give the rest alone"
            )
        if name not in known:
            raise ModelError(f"terms: {e} in '{key}' holds the unknown '{name}'.{did_you_mean(name, known)}")
    if not {*e.symbols}:
        raise ModelError(f"terms: {e} in '{key}' is a number; the candidate 'bias' is a constant part")
    jump = _jump(e)
    if jump:
        raise ModelError(
            f"terms: {e} in '{key}' jumps, so that no Newton step sees its slope: use {_JUMPS[jump]} in place of {jump}"
        )
    return e


def _jump(e: Expr) -> str | None:
    """Return the first operation in an expression that jumps; conditions of ``where`` are the user's own affair."""
    operation, args = e.operation
    if operation in _JUMPS:
        return operation
    if operation == "where":
        args = args[1:]
    return next((found for a in args if (found := _jump(a))), None)


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
    # A delay of an output is in no equation, which an evaluator takes for a slip: here all stand in the last.
    every_parameter = [Expr(sum((Expr.symbol(name) for name in model.parameter_names), Expr(0.0)))]
    added = {f"no_output__{i}": e for i, e in enumerate([*every, *wanted, *every_parameter])}
    # Half of them on the positive side: equations may hold a root or a logarithm.
    draws = random.uniform(-1.0, 1.0, (len(names), 4 * n))
    draws[:, ::2] = np.abs(draws[:, ::2])
    # Wider than the record: where a speed hardly varies, a term in proportion to it would look like a constant.
    widths = [max(1.3 * scales.span(name), 0.3 * abs(scales.centre(name))) for name in names]
    columns = [scales.centre(name) + w * row for name, w, row in zip(names, widths, draws, strict=True)]
    t = scales.begin + scales.duration * np.sort(random.random(4 * n))
    theta = random.uniform(0.5, 1.5, len(model.parameter_names))
    y = CompiledModel(model._changed(outputs=added)).outputs(theta, np.vstack([t, *columns]))
    good = np.flatnonzero(np.isfinite(y).all(axis=0))[-n:]
    if good.size < 16:
        raise ModelError(
            "candidates: the model's equations are not finite at most random points about zero or the trims; "
            "give trim=..., typical values of states and inputs"
        )
    y, t = y[:, good], t[good]
    m, n_q, n_x = len(model.output_names), len(quantities), len(model.state_names)
    values = {name: column[good] for name, column in zip(names, columns, strict=True)}
    values |= dict(zip(quantities, y[m : m + n_q], strict=True))
    rates = dict(zip(model.state_names, y[m + n_q : m + n_q + n_x], strict=True))
    outputs = dict(zip(model.output_names, y[:m], strict=True))
    parameters = dict(zip(model.parameter_names, theta.tolist(), strict=True))
    return Points("random", t, values, rates, outputs, {}, parameters), list(y[m + n_q + n_x : -1])
