"""The selection of the terms of an equation-error regression: from candidates, its equations and its data to the terms
that stay."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from numbers import Real
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from .._core import Expr
from ..errors import ModelError, OptionError, did_you_mean, is_whole, listing
from ..figures import MEASURED, MODEL, RULE, STATE, WIDTH, Panels, plain, styled
from ..modelling.model import Model
from ..notebook import notebook_page, paragraph, table
from ..parameters import text_table
from . import Equation, EquationSides, Evaluation
from .least_squares import coloured_middle
from .subsets import Block, Path, SubsetStatistics, TermData, best_subsets, orthogonal, stepwise

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "SelectedTerms",
    "SelectionStep",
    "TermSelection",
    "check_keep",
    "monomials",
    "select_terms",
    "selection_options",
    "with_candidates",
    "without",
]

_Array: TypeAlias = NDArray[np.float64]
_Rows: TypeAlias = tuple[_Array, _Array, NDArray[np.bool_]]
Method: TypeAlias = Literal["stepwise", "all", "orthogonal"]
Criterion: TypeAlias = Literal["press", "pse", "held_out"]

_CALLED = {"press": "PRESS", "pse": "predicted squared error", "held_out": "the error on held-out data"}


@dataclass(frozen=True)
class TermSelection:
    """Says how `equation_error` selects the terms of its equations.

    ``select="stepwise"`` is ``TermSelection("stepwise")``.

    method     "stepwise": terms enter and leave by their partial F. "all": of all subsets of each size the one with the
               least sum of squares, then the size by ``criterion``. "orthogonal": the terms made orthogonal to each
               other, the one that explains most first, as many as ``criterion`` asks for.
    criterion  of "all" and "orthogonal": "press" (each sample predicted without it), "pse" (predicted squared error) or
               "held_out" (the error on ``held_out``). None: "pse" for "orthogonal"; for "all" "held_out" where
               there are held-out data, else "press".
    f_in       partial F above which a term enters. None: exceeded by chance for one of all candidates in 5 % of cases.
    f_out      partial F below which a term leaves, no more than ``f_in``; None: ``f_in``.
    least_gain what a term adds to R² at least, to enter; for "stepwise".
    corrected  whether F is corrected for the autocorrelation of the residuals: that for white ones is, in flight data,
               too large by the number of samples over which they are correlated.
    keep       parameters whose terms are always kept. Constants of the equations (such as Cm0) always are, too.
    most       the most candidates of "all", whose subsets number 2 to the power of it.

    (V. Klein and E. A. Morelli, Aircraft System Identification, AIAA 2006, ch. 5.) Raises OptionError for bad values.
    """

    method: Method = "stepwise"
    criterion: Criterion | None = None
    f_in: float | None = None
    f_out: float | None = None
    least_gain: float = 0.0
    corrected: bool = True
    keep: tuple[str, ...] = ()
    most: int = 18

    def __post_init__(self) -> None:
        def one_of(what: str, value: Any, known: Sequence[str], none: str) -> None:
            if value not in known:
                raise OptionError(f"TermSelection: {what} is {none}, not {value!r}.{did_you_mean(str(value), known)}")

        one_of("method", self.method, get_args(Method), "'stepwise', 'all' or 'orthogonal'")
        if self.criterion is not None:
            one_of("criterion", self.criterion, get_args(Criterion), "'press', 'pse', 'held_out' or None")
            if self.method == "stepwise":
                raise OptionError("TermSelection: stepwise regression decides by f_in and f_out, not by a criterion")
        for name in ("f_in", "f_out", "least_gain"):
            value = getattr(self, name)
            if value is not None and not (isinstance(value, Real) and 0 <= float(value) < math.inf):
                raise OptionError(f"TermSelection: {name} is a number from 0, not {value!r}")
        if self.f_out is not None and self.f_in is not None and self.f_out > self.f_in:
            raise OptionError(f"TermSelection: f_out ({self.f_out:g}) is no more than f_in ({self.f_in:g})")
        object.__setattr__(self, "keep", (self.keep,) if isinstance(self.keep, str) else tuple(self.keep))
        if not is_whole(self.most) or not 1 <= self.most <= 24:
            raise OptionError(f"TermSelection: most is a whole number from 1 to 24, not {self.most!r}")

    def thresholds(self, candidates: int) -> tuple[float, float]:
        """Return the F to enter and the F to leave among so many candidates."""
        from scipy.special import chdtri

        f_in = float(chdtri(1, 0.05 / max(candidates, 1))) if self.f_in is None else float(self.f_in)
        return f_in, f_in if self.f_out is None else min(float(self.f_out), f_in)

    def criterion_with(self, held_out: bool) -> Criterion:
        """Return the criterion that decides, by whether there are held-out data."""
        if self.criterion is not None:
            return self.criterion
        return "pse" if self.method == "orthogonal" else "held_out" if held_out else "press"


def selection_options(given: Any) -> TermSelection:
    """Return the options of a selection, given as such or by the name of the method; raise OptionError for others."""
    if isinstance(given, TermSelection):
        return given
    known = get_args(Method)
    if given not in known:
        raise OptionError(
            f"equation_error: select is one of {', '.join(map(repr, known))}, or a TermSelection, not {given!r}."
            f"{did_you_mean(str(given), known)}"
        )
    return TermSelection(given)


@dataclass(frozen=True)
class SelectionStep:
    """One subset of the terms that a selection compares.

    action       by what it differs from the one before: "+ Cma", "- Cmq", "- Cmq + Cma + CmV"; "" for the first one.
    terms        the candidates that are in it.
    statistics   its RMS, R², PRESS, predicted squared error and error on held-out data.
    f            partial F of the term that entered or left, for white residuals; NaN where none did.
    f_corrected  the same, corrected for the autocorrelation of the residuals.
    """

    action: str
    terms: tuple[str, ...]
    statistics: SubsetStatistics
    f: float = math.nan
    f_corrected: float = math.nan


@dataclass(frozen=True, eq=False, repr=False)
class SelectedTerms:
    """The selection of the terms of one regression equation, or of several that share parameters.

    equations  their names; of several, RMS, PRESS and PSE are in standard deviations of their residuals.
    kept       parameters of terms that are always there.
    selected   parameters of the candidates that were selected.
    dropped    those that were not: fixed at 0 in the model of the result.
    steps      the subsets that were compared, in order.
    chosen     the number of the step that is the result.
    reason     what decided, in words.
    """

    equations: tuple[str, ...]
    kept: tuple[str, ...]
    selected: tuple[str, ...]
    dropped: tuple[str, ...]
    steps: tuple[SelectionStep, ...]
    chosen: int
    reason: str
    unit: str = ""

    def _rows(self) -> tuple[list[str], list[list[str]], str]:
        heads = ["", "step", "terms", "partial F", "corrected", "R²", "RMS", "PRESS", "√PSE", "held out"]
        rows = []
        for i, step in enumerate(self.steps):
            s = step.statistics
            rows.append(
                [
                    "*" if i == self.chosen else "",
                    step.action or "(no candidate)",
                    str(len(step.terms)),
                    *(_number(f, ".1f") for f in (step.f, step.f_corrected)),
                    _number(s.r_squared, ".5f"),
                    *(_number(v, ".4g") for v in (s.rms, s.press, s.pse, s.held_out)),
                ]
            )
        return heads, rows, "llrrrrrrrr"

    def _sentences(self) -> list[str]:
        texts = [f"Selected (*), {self.reason}: {', '.join(self.selected) or 'none'}."]
        if self.kept:
            texts.append(f"Always kept: {', '.join(self.kept)}.")
        if self.dropped:
            texts.append(f"Not in the model, fixed at 0: {', '.join(self.dropped)}.")
        return texts

    @property
    def _title(self) -> str:
        return f"Terms of {', '.join(self.equations)}"

    def summary(self) -> str:
        """Return the steps as a plain-text table."""
        return "\n".join([self._title, "", text_table(*self._rows()), "", *self._sentences()])

    def plot(self) -> tuple[Figure, dict[str, Axes]]:
        """Plot the errors over the steps of the selection, on the data, by PRESS, by PSE and on held-out data.

        Returns the figure and its axes, ``{"error": ...}``.
        """
        at = list(range(len(self.steps)))
        curves = (
            ("RMS", "rms", MEASURED, "o-"), ("PRESS", "press", MODEL, "s--"), ("√PSE", "pse", STATE, "^:"),
            ("held out", "held_out", "#000000", "D-."),
        )  # fmt: skip
        with styled() as plt:
            figure, axis = plt.subplots(figsize=(WIDTH, 2.8), layout="constrained")
            axis.axvline(self.chosen, color=RULE, linewidth=4.0, zorder=0)
            for label, name, color, style in curves:
                values = [getattr(s.statistics, name) for s in self.steps]
                if any(math.isfinite(v) for v in values):
                    axis.plot(at, values, style, color=color, label=label, markersize=3.5, linewidth=1.0)
            axis.set_yscale("log")
            axis.set_xticks(at, [plain(s.action or "start") for s in self.steps])
            axis.tick_params(axis="x", labelrotation=60)
            axis.set_ylabel(f"error, {self.unit}" if self.unit else "error")
            axis.set_title(plain(self._title), loc="left", fontsize=9.0)
            axis.legend(frameon=False)
        return figure, Panels({"error": axis})

    def _repr_html_(self) -> str:
        return notebook_page(self._title, table(*self._rows()), paragraph(" ".join(self._sentences())))

    def __repr__(self) -> str:
        return f"<SelectedTerms of {', '.join(self.equations)}: {', '.join(self.selected) or 'none'}>"

    def __str__(self) -> str:
        return self.summary()


def _number(value: float, form: str) -> str:
    return format(value, form) if math.isfinite(value) else ""


def check_keep(keep: Sequence[str], parameters: Sequence[str]) -> None:
    """Raise OptionError for a name in ``keep`` that is not a parameter."""
    for name in keep:
        if name not in parameters:
            raise OptionError(f"TermSelection: keep: '{name}' is not a parameter.{listing(name, parameters)}")


def _reason(criterion: Criterion | None, f_in: float, f_out: float, corrected: bool) -> str:
    """Return what decided a selection, in words."""
    if criterion is not None:
        return f"by the least {_CALLED[criterion].removeprefix('the ')}"
    leave = "" if f_out == f_in else f", {f_out:.3g} to leave"
    return f"by a partial F of {f_in:.3g} to enter{leave}{', corrected for coloured residuals' if corrected else ''}"


def monomials(*variables: Expr, degree: int = 2, orders: Sequence[int] | None = None) -> list[Expr]:
    """Return all products of powers of the variables up to a total ``degree``, the lowest first, without the constant.

    ``orders``: the greatest power of each variable; None: ``degree``. They are the candidates of
    ``equation_error(..., terms=...)``, as in E. A. Morelli, J. Aircraft 32(2), 1995.

    Raises OptionError for a degree or orders that are not whole numbers, or no symbols.

    >>> import phugoid as ph
    >>> a, q = ph.Model("Cm").inputs(alpha="rad", q="rad/s")
    >>> [str(term) for term in ph.monomials(a, q, degree=2)]
    ['alpha', 'q', 'alpha**2', 'alpha*q', 'q**2']
    """
    if not variables or not all(isinstance(v, Expr) for v in variables):
        raise OptionError("monomials: the variables are expressions of a model, as in monomials(alpha, q, degree=3)")
    if not is_whole(degree) or degree < 1:
        raise OptionError(f"monomials: degree is a whole number from 1, not {degree!r}")
    most = [degree] * len(variables) if orders is None else list(orders)
    if len(most) != len(variables) or not all(is_whole(k) and k >= 0 for k in most):
        raise OptionError(f"monomials: orders holds a whole number from 0 for each of the {len(variables)} variables")
    found = []
    for total in range(1, degree + 1):
        for powers in combinations_with_replacement(range(len(variables)), total):
            counts = [powers.count(k) for k in range(len(variables))]
            if all(count <= limit for count, limit in zip(counts, most, strict=True)):
                factors = [v**c if c > 1 else v for v, c in zip(variables, counts, strict=True) if c]
                product = factors[0]
                for factor in factors[1:]:
                    product = product * factor
                found.append(product)
    return found


def with_candidates(model: Model, terms: Mapping[str, Any]) -> tuple[Model, list[str]]:
    """Return the model with terms added to its equations, each with a parameter of its own, and their names.

    ``terms``: what they are added to (a quantity or an output, ``"Cm"``; a state equation, ``"q'"``) -> expressions in
    a list, whose parameters are called ``Cm_alpha2``, ``Cm_alpha_q``, ..., or by the names that they are to have.
    Raises ModelError for an unknown equation or name, OptionError for no expressions.
    """
    if not isinstance(terms, Mapping):
        raise OptionError(f"equation_error: terms holds expressions by equation, as in {{'Cm': [a**2]}}, not {terms!r}")
    keys = {**{f"y:{n}": n for n in model.output_names}, **{n: n for n in model.quantity_names}}
    keys |= {f"{n}'": f"{n}_dot" for n in model.state_names}
    taken = set(model.parameter_names)
    added: list[str] = []
    sums: dict[str, Any] = {}
    for place, given in terms.items():
        key = place if place in keys else f"y:{place}"
        if f"{place}'" in keys and key in keys:
            raise ModelError(
                f"equation_error: terms: '{place}' is both a state and an output: write \"{place}'\" for the state "
                f"equation, or '{key}' for the output equation"
            )
        if key not in keys:
            raise ModelError(f"equation_error: terms: '{place}' is not an equation.{listing(str(place), list(keys))}")
        named = given if isinstance(given, Mapping) else None
        if named is None and not isinstance(given, (list, tuple)):
            raise OptionError(f"equation_error: terms of '{place}' are a list of expressions, not {given!r}")
        expressions = list(named.values()) if named is not None else list(given)
        for i, e in enumerate(expressions):
            if not isinstance(e, Expr):
                raise OptionError(
                    f"equation_error: terms of '{place}': {e!r} is not an expression in the model's symbols"
                )
            name = list(named)[i] if named is not None else _called(keys[key], str(e))
            if name in taken:
                raise ModelError(f"equation_error: terms of '{place}': there is a parameter '{name}' already")
            taken.add(name)
            added.append(name)
            sums[key] = sums.get(key, 0.0) + Expr.symbol(name) * e
    return model.with_terms(sums, dict.fromkeys(added, 0.0)), added


def without(model: Model, names: Sequence[str]) -> Model:
    """Return the model with parameters fixed at 0, whatever their declared bounds."""
    unbounded = (-math.inf, math.inf)
    declared = model.declared_parameters
    return model.with_parameters(
        {n: replace(declared[n], start=0.0, bounds=unbounded, prior=None, transform=None, fixed=True) for n in names}
    )


def _called(stem: str, term: str) -> str:
    """Return the name of the parameter of a term.

    >>> _called("Cm", "alpha**2*q")
    'Cm_alpha2_q'
    """
    text = re.sub(r"\W+", "_", term.replace("**", "")).strip("_")
    return f"{stem}_{text}"


def select_terms(
    model: Model,
    listed: Sequence[Equation],
    names: Sequence[str],
    sides: Sequence[EquationSides],
    values: Sequence[Mapping[str, float]],
    members: Sequence[int],
    sigmas: _Array,
    held_out: Sequence[EquationSides],
    options: TermSelection,
) -> SelectedTerms | None:
    """Return which of the parameters ``names`` stay in the equations ``members``; None where there is no candidate.

    ``sigmas``: (E,) standard deviations by which equations that share parameters are weighted. Raises OptionError for
    parameters that have a value an experiment where data are held out, and for too many candidates of all subsets.
    """
    declared = model.declared_parameters
    own = [n for n in names if declared[n].per_experiment]
    if own and held_out:
        raise OptionError(
            f"equation_error: {', '.join(own)} has a value for each experiment, and none for held-out data: declare it "
            "without per_experiment, or select without held_out"
        )
    shared = [n for n in names if n not in own]
    equations = [listed[k] for k in members]
    weights = 1.0 / sigmas if len(members) > 1 else np.ones(1)
    evaluation = Evaluation(model, equations, shared)
    # Parameters of single experiments keep the values of the full regression.
    parts = [_rows(evaluation, side, v, members, weights) for side, v in zip(sides, values, strict=True)]
    y, x = _stacked(parts)
    constant = [n for j, n in enumerate(shared) if _is_constant(parts, j)]
    kept = [n for n in shared if n in options.keep or n in constant]
    candidates = [n for n in shared if n not in kept]
    if not candidates:
        return None
    if options.method == "all" and len(candidates) > options.most:
        raise OptionError(
            f"equation_error: {', '.join(e.name for e in equations)}: {len(candidates)} candidates have "
            f"{2 ** len(candidates):,} subsets: use select='stepwise' or 'orthogonal', or TermSelection(most=...)"
        )
    order = [shared.index(n) for n in (*kept, *candidates)]
    others = None
    if held_out:
        more = [_rows(evaluation, side, values[0], members, weights) for side in held_out]
        z, regressors = _stacked(more)
        others = z, regressors[:, order]
    left = [weights[:, None] * side.left[members] for side in sides]
    deviations = []
    for e in range(len(members)):
        z = np.concatenate([a[e][m[e]] for a, (_, _, m) in zip(left, parts, strict=True)])
        deviations.append(z - z.mean() if z.size else z)
    scatter = float(np.mean(np.concatenate(deviations) ** 2))
    x = x[:, order]
    middle = np.zeros((len(order), len(order))) if options.corrected else None
    if middle is not None:
        theta = np.linalg.lstsq(x, y, rcond=None)[0]
        for r, a, m in parts:
            middle += coloured_middle(r - a[:, :, order] @ theta, a[:, :, order], m)
    data = TermData(y, x, len(kept), scatter, others, middle)
    steps, chosen, why = _search(data, options, bool(held_out))
    terms = [*kept, *candidates]
    blocks = [frozenset[int](), *(block for block, _ in steps)]
    found = [
        SelectionStep(
            action=_change(blocks[i], block, terms),
            terms=tuple(terms[k] for k in sorted(block)),
            statistics=data.statistics(block),
            f=f[0],
            f_corrected=f[1] if options.corrected else np.nan,
        )
        for i, (block, f) in enumerate(steps)
    ]
    selected = found[chosen].terms
    return SelectedTerms(
        equations=tuple(e.name for e in equations),
        kept=(*kept, *own),
        selected=selected,
        dropped=tuple(n for n in candidates if n not in selected),
        steps=tuple(found),
        chosen=chosen,
        reason=why,
        unit=sides[0].unit(equations[0]) if len(members) == 1 else "",
    )


def _search(data: TermData, options: TermSelection, held_out: bool) -> tuple[Path, int, str]:
    if options.method == "stepwise":
        f_in, f_out = options.thresholds(len(data.candidates))
        steps = stepwise(data, f_in, f_out, options.least_gain, options.corrected)
        return steps, len(steps) - 1, _reason(None, f_in, f_out, options.corrected)
    criterion = options.criterion_with(held_out)
    if criterion == "held_out" and not held_out:
        raise OptionError("equation_error: the criterion 'held_out' needs data: give held_out=...")
    steps = best_subsets(data) if options.method == "all" else orthogonal(data)
    errors = [getattr(data.statistics(block), criterion) for block, _ in steps]
    return steps, int(np.argmin(errors)), _reason(criterion, np.nan, np.nan, options.corrected)


def _change(before: Block, after: Block, terms: Sequence[str]) -> str:
    """Return by which terms a subset differs from another, as in "- Cmq + Cma"."""
    signed = [*(f"- {terms[k]}" for k in sorted(before - after)), *(f"+ {terms[k]}" for k in sorted(after - before))]
    return " ".join(signed)


def _rows(
    evaluation: Evaluation, side: EquationSides, values: Mapping[str, float], members: Sequence[int], weights: _Array
) -> _Rows:
    """Return weighted left-hand sides less what does not depend on the parameters (E, N), regressors, valid rows."""
    right, regressors = evaluation({**values, **dict.fromkeys(evaluation.names, 0.0)}, side.columns)
    mask = side.mask[members]
    y = np.where(mask, weights[:, None] * (side.left[members] - right), 0.0)
    return y, np.where(mask[:, :, None], weights[:, None, None] * regressors, 0.0), mask


def _stacked(parts: Sequence[_Rows]) -> tuple[_Array, _Array]:
    """Return left-hand sides (n,) and regressors (n, p) of all valid rows."""
    return np.concatenate([y[m] for y, _, m in parts]), np.concatenate([a[m] for _, a, m in parts])


def _is_constant(parts: Sequence[_Rows], j: int) -> bool:
    """Return whether the regressor is the same at all samples of each equation, as that of a constant is."""
    for e in range(parts[0][0].shape[0]):
        column = np.concatenate([a[e, m[e], j] for _, a, m in parts])
        if column.size and np.ptp(column) > 1e-12 * np.abs(column).max():
            return False
    return True
