"""Candidates, by number and by name, and those that the user writes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any, overload

from ..._core import Expr
from ...errors import DataError, ModelError, UnknownName, did_you_mean
from ...modelling.model import Model
from ...notebook import notebook_page, table
from ...parameters import text_table
from ...sensitivities.trajectory import Place, Points
from .candidate import Candidate, Effect
from .scales import Scales

__all__ = ["Candidates", "read_terms"]

# Whoever looks for the scale of an input whose derivatives are free does not find it.
_LEFT_OUT = " What the model's parameters can do already is left out."


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
    <v':x^3: v' has a part that goes with the cube of x>
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
                raise ModelError(f"candidates: '{c.name}' is there twice")
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
                raise UnknownName(f"there is no candidate '{key}'.{did_you_mean(key, self._by_name)}{_LEFT_OUT}")
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
                raise UnknownName(
                    f"there is no candidate '{pattern}'.{did_you_mean(pattern, self._by_name)}{_LEFT_OUT}"
                )
            found |= fits
        return found

    def on(self, points: Sequence[Points], trim: Mapping[str, float] | None = None) -> Candidates:
        """Return the same with centres, widths and grids for a record; without those of which it can say nothing, since
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
        raise ModelError(f"terms: {e} in '{key}' is a number; a constant part is called 'bias' and is there by itself")
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
