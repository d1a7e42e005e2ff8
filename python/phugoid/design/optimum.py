"""Optimisation of a manoeuvre within a family."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..data.experiment import Experiment
from ..errors import EvaluationError, OptionError, whole
from ..fit_result import FitResult
from ..modelling.model import Model
from ..solvers import check_time, limited
from .design_evaluation import plan
from .plan import Criterion, Plan, criterion_of
from .steps import number

__all__ = ["optimal_plan"]

# Members of the population for each number that is chosen, and at least; steps of the search that follows it, and where
# it ends (of the logarithm of the criterion).
_MEMBERS, _FEWEST, _STEPS, _CLOSE = 6, 8, 25, 1e-3
# Penalty for leaving limits by their size; cost of a manoeuvre that cannot be simulated.
_BEYOND, _NEVER = 10.0, 1e3


def optimal_plan(
    source: Model | FitResult,
    make: Callable[..., Experiment | Sequence[Experiment]],
    bounds: Mapping[str, tuple[float, float]],
    *,
    criterion: Criterion = "D",
    generations: int = 12,
    seed: int = 0,
    time_limit: float | None = None,
    **options: Any,
) -> Plan:
    """Return the most informative manoeuvre of a family that keeps its limits.

    make         function that returns the manoeuvre for numbers by name: ``make(width=0.5, amplitude=0.03)``. Measured
                 conditions need not be in it: they are constant, as in `plan`.
    bounds       name -> (lower, upper) of these numbers.
    criterion    the criterion to minimise: "D", "A" or "worst" (`Plan.criteria`), of the parameters in the option
                 ``of``.
    generations  of differential evolution (Storn and Price, J. Global Optim. 11, 1997), which works with widths that
                 jump from sample to sample; a simplex search (Nelder and Mead) ends it. About (generations + 1) times 6
                 plans for each number, and 25. ``seed``: of its random numbers.
    time_limit   in seconds, of the whole. It ends the search as Ctrl-C does: the best plan so far is the result, with a
                 warning.
    options      those of `plan`: values, noise, limits, after, ...

    Returns the best plan that was found; ``plan.choice`` holds the numbers. It is near the optimum, but not at it to
    many digits. Raises OptionError where no manoeuvre that was tried keeps its limits. Manoeuvres that cannot be made
    or simulated (OptionError, EvaluationError) are skipped.
    """
    from scipy.optimize import differential_evolution, minimize

    deadline = limited("optimal_plan", time_limit)
    kind = criterion_of("optimal_plan", criterion)
    names = list(bounds)
    if not names:
        raise OptionError("optimal_plan: bounds says what is chosen, as in {'width': (0.2, 1.0)}")
    whole("optimal_plan: generations", generations, 1)
    for n, pair in bounds.items():
        low, high = (number("optimal_plan", f"a bound of {n}", b) for b in pair)
        if not low < high:
            raise OptionError(f"optimal_plan: bounds of {n} are (lower, upper), not {pair!r}")
    ends = np.array([bounds[n] for n in names], dtype=np.float64)
    # Sizes that span decades are searched in their logarithm.
    log = ends[:, 0] > 0.0
    ends[log] = np.log(ends[log])
    best: Plan | None = None
    nearest = (np.inf, "nothing could be made")

    def cost(point: NDArray[np.float64]) -> float:
        nonlocal best, nearest
        inside = np.clip(point, ends[:, 0], ends[:, 1])
        values = np.where(log, np.exp(np.where(log, inside, 0.0)), inside)
        check_time()
        choice = dict(zip(names, values.tolist(), strict=True))
        try:
            made = plan(source, make(**choice), **options)
        except (OptionError, EvaluationError) as error:
            nearest = min(nearest, (_NEVER, str(error)), key=lambda pair: pair[0])
            return _NEVER
        value = made.criteria[kind]
        excess = max(e.excess for channels in made.excursions.values() for e in channels.values())
        if made.within_limits:
            if best is None or value < best.criteria[kind]:
                best = replace(made, choice=choice)
        elif excess < nearest[0]:
            nearest = excess, "; ".join(made.violations)
        outside = float(np.abs(point - inside).max())
        return (float(np.log(value)) if np.isfinite(value) else 0.5 * _NEVER) + _BEYOND * (excess + outside)

    members = max(_MEMBERS * len(names), _FEWEST)
    rng = np.random.default_rng(seed)
    # One of each row and column of a grid: a Latin hypercube.
    parts = np.array([(rng.permutation(members) + rng.uniform(size=members)) / members for _ in names]).T
    first = ends[:, 0] + parts * (ends[:, 1] - ends[:, 0])
    cost(first[0])  # mistakes in the call show themselves here, as they are
    evolution = {"init": first, "maxiter": generations, "seed": rng, "polish": False, "tol": 0.0}
    ended = ""
    try:
        with deadline.in_force():
            found = differential_evolution(cost, ends.tolist(), **evolution)
            small = 0.05 * (ends[:, 1] - ends[:, 0])
            corners = np.vstack([found.x, found.x + np.diag(np.where(found.x + small > ends[:, 1], -small, small))])
            settings = {"initial_simplex": corners, "maxfev": _STEPS * len(names), "xatol": np.inf, "fatol": _CLOSE}
            minimize(cost, found.x, method="Nelder-Mead", options=settings)
    except KeyboardInterrupt:
        ended = deadline.ended()
    if best is None:
        early = f" before the end ({ended})" if ended else ""
        raise OptionError(f"optimal_plan: nothing that was tried{early} keeps its limits. The nearest: {nearest[1]}")
    return replace(best, warnings=(*best.warnings, f"{ended}: this is the best plan so far")) if ended else best
