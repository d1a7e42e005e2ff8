"""The selection of the terms of an equation-error regression: from its equations and data to the terms that stay."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..errors import OptionError
from ..modelling.model import Model
from .equation_sides import EquationSides
from .equations import Equation, Evaluation
from .least_squares import coloured_middle
from .selected_terms import SelectedTerms, SelectionStep, TermSelection, reason
from .subsets import Block, Path, TermData, best_subsets, orthogonal, stepwise

__all__ = ["select_terms"]

_Array: TypeAlias = NDArray[np.float64]


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
        return steps, len(steps) - 1, reason(None, f_in, f_out, options.corrected)
    criterion = options.criterion_with(held_out)
    if criterion == "held_out" and not held_out:
        raise OptionError("equation_error: the criterion 'held_out' needs data: give held_out=...")
    steps = best_subsets(data) if options.method == "all" else orthogonal(data)
    errors = [getattr(data.statistics(block), criterion) for block, _ in steps]
    return steps, int(np.argmin(errors)), reason(criterion, np.nan, np.nan, options.corrected)


def _change(before: Block, after: Block, terms: Sequence[str]) -> str:
    """Return by which terms a subset differs from another, as in "- Cmq + Cma"."""
    signed = [*(f"- {terms[k]}" for k in sorted(before - after)), *(f"+ {terms[k]}" for k in sorted(after - before))]
    return " ".join(signed)


_Rows: TypeAlias = tuple[_Array, _Array, NDArray[np.bool_]]


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
