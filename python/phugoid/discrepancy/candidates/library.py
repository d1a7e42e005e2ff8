"""The library of candidates: what a model may be missing, made from the model itself."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

from ...errors import ModelError, OptionError, did_you_mean
from ...modelling.model import Model
from ...sensitivities import Points
from .candidate import Effect
from .catalogue import Catalogue, Names, stem
from .collection import Candidates, Directions, read_terms
from .model_structure import ModelStructure
from .scales import Scales, trim_of
from .terms import Term, where

__all__ = ["FAMILIES", "Candidates", "candidates", "trim_of"]

# In the order in which duplicates count: the first stays.
FAMILIES = (
    "own",
    "bias",
    "scale",
    "drift",
    "linear",
    "square",
    "product",
    "cube",
    "sine",
    "damping",
    "rotation",
    "effectiveness",
    "quadratic",
    "absolute",
    "root",
    "sign",
    "rate",
    "curve",
    "factor",
    "law",
    "lag",
    "delay",
    "deadband",
    "saturation",
    "backlash",
    "rate_limit",
    "clipped",
    "dependence",
    "exponent",
    "saturating",
    "decay",
    "integral",
    "variation",
    "step",
    "stribeck",
    "limit",
    "hysteresis",
    "stall",
    "mode",
    "ripple",
    "periodic",
)
# Those with a signal that depends on no shape: only they can be seen to be the same at single points.
_STATIC = FAMILIES[: FAMILIES.index("lag")]


def candidates(
    model: Model,
    *,
    points: Sequence[Points] | None = None,
    trim: Mapping[str, float] | None = None,
    terms: Mapping[str, Any] | None = None,
    leave_out: Collection[str] = (),
    equations: Literal["own", "all"] = "own",
    base: Model | None = None,
) -> Candidates:
    """Return the candidates for what the model may be missing, by canonical name.

    In quantities, and in state equations that hold parameters but no such quantity: constant and linear terms, squares,
    products and cubes of states and inputs, linear terms, squares and cubes of declared quantities that stand there and
    hold no parameters (an angle of slip), x^2 v for rates v, x^2 u for inputs u, centrifugal and Coriolis forces where
    two or three positions and their rates are states, sin(x), cos(x) and sin(2 x) of an angle that turns by more than 1
    rad, x|x|, |x|, sign(x) of speeds, inputs and currents, square roots of what can be stored (a level, a pressure),
    first-order lags, friction that is larger at rest, hysteresis, stall where the angle of attack acts, a lightly
    damped mode, what is periodic in a position, a periodic disturbance, a limit of the whole where an input stands in
    it. States that go no further than a limit. In outputs: bias, scale, a characteristic that is not straight, drift,
    delay, lag, clipping, play of a position's sensor, linear terms, squares and products of rates, derivatives of
    rates, lags of inputs that act at once. On inputs: scale, bias, dead-band, saturation, backlash, limited rate, lag,
    delay; of conditions (`Model.conditions`) scale, bias and delay. Parameters of the state equations may change in the
    course of a record, alone or several at one time, or with the integral of an input, and so may masses; rates
    saturate with what is stored; forces decay with a position; what is in proportion to an amount may be so to another
    power of it. Effects that the parameters of the model can represent are left out, and of candidates with the same
    effect those remain whose family comes first in `FAMILIES`.

    points     paths that the scales are taken from: centres of powers, widths of rounded corners, grids of time
               constants and frequencies. Without, those of `Scales`; ``library.on(points)`` does it later.
    trim       name -> value at which powers of a state or an input are centred.
    terms      terms of your own by place, ``{"Cm": [alpha*q**2], "q'": ..., "y:alpha": ..., "Cm:my name": ...}``.
    leave_out  families to leave out, such as "periodic" or "cube".
    equations  "all" offers terms in every state equation, also where they would only rename a quantity's.
    base       an earlier form of the model: what its extensions added is not doubted in turn.

    Raises ModelError for terms that cannot be, that the model has already or that are there twice; OptionError for
    unknown families and trims.

    >>> from phugoid import Model
    >>> m = Model("servo")
    >>> w, = m.states(w="rad/s")
    >>> u, = m.inputs(u="V")
    >>> c, k = m.parameters("c k")
    >>> m.dynamics(w=-c*w + k*u)
    >>> m.outputs(w=w)
    >>> candidates(m, leave_out=("lag", "cube", "periodic", "delay")).names[:4]
    ("w':bias", "w':scale*w^2", "w':w^2", "w':u^2")
    """
    _check(model, trim, leave_out, equations, base)
    model.check()
    trim = dict(trim or {})
    trim |= {late: trim[of] for late, (of, _) in model.delays.inputs.items() if of in trim}
    scales = Scales.of(points, trim) if points is not None else Scales(trim=trim)
    structure = ModelStructure(model, equations == "all", base)
    names = Names(model)
    own = list(_own(model, structure, scales, terms or {}, names))
    made = [c for c in Catalogue(structure, scales, names).all() if c.family not in leave_out]
    kept = _distinct(own, made, Directions(model, scales))
    return Candidates(c for c in kept if points is None or c.worthwhile())


def _check(model: Any, trim: Any, leave_out: Any, equations: Any, base: Any) -> None:
    for m in (model, base):
        if not (isinstance(m, Model) or (m is None and model is not None)):
            raise ModelError(f"candidates: give a Model, not a {type(m).__name__}")
    if equations not in ("own", "all"):
        raise OptionError(f'candidates: equations is "own" or "all", not {equations!r}')
    for name in trim or {}:
        known = [*model.state_names, *model.declared_inputs]
        if name not in known:
            raise OptionError(f"candidates: trim names '{name}', no state or input.{did_you_mean(name, known)}")
    if isinstance(leave_out, str):
        raise OptionError(f"candidates: leave_out is several families, as in leave_out=({leave_out!r},)")
    for family in leave_out:
        if family not in FAMILIES:
            hint = did_you_mean(str(family), FAMILIES)
            raise OptionError(f"candidates: there is no family '{family}'.{hint} There are: {', '.join(FAMILIES)}.")


def _own(
    model: Model, structure: ModelStructure, scales: Scales, terms: Mapping[str, Any], names: Names
) -> Iterator[Effect]:
    for place, what, e in read_terms(model, terms):
        name = f"{structure.shown(place)}:{what}"
        words = f"{where(place)} contains a term proportional to {str(e).replace('**', '^')}"
        coefficient = names(f"{stem(place)}_{what}")
        yield Term(name, place, words, "own", scales, (coefficient,), variables=tuple(e.symbols), given=e)


def _distinct(own: Sequence[Effect], made: Sequence[Effect], directions: Directions) -> list[Effect]:
    """Return those that say something new, in the order made, the user's own last; of the user's all must be new."""
    ranked = [*own, *sorted(made, key=lambda c: FAMILIES.index(c.family))]
    ranked = [c for c in ranked if c.family in _STATIC]
    dropped: set[int] = set()
    for c, verdict in zip(ranked, directions.verdicts(ranked), strict=True):
        if c.family == "own" and verdict.spanned:
            raise ModelError(
                f"terms: {c.name}: the model has this already, its parameters change the equations in just that way"
            )
        if c.family == "own" and verdict.twin is not None:
            twin = ranked[verdict.twin].name
            raise ModelError(f"terms: {c.name} and {twin} are the same but for a factor and what the model has")
        if verdict.spanned or verdict.twin is not None:
            dropped.add(id(c))
    kept = [c for c in (*made, *own) if id(c) not in dropped]
    there = {c.name for c in kept}
    # What the model has already need not be found first.
    return [c if not c.beside or c.beside in there else replace(c, beside="") for c in kept]
