"""The equation-error method: regression on measured states, their slopes and the other outputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..data.experiment import Experiment, as_experiments
from ..data.units import check_units
from ..errors import ByName, DataError, ModelError, OptionError, counted
from ..figures import fit as plot
from ..initialisation import check_names, parameter_start
from ..modelling.model import Model
from ..notebook import Html, bullets, notebook_page, table
from ..parameters import Estimate, Estimates, estimates_html, estimates_table, text_table
from ..records import Record
from . import Equation, EquationSides, Evaluation, Unknown, channels, equations, groups, unknowns_of
from .least_squares import Differentiator, FourierSmoothing, Regression, SavitzkyGolay, SmoothingSpline, regress
from .term_selection import (
    SelectedTerms,
    TermSelection,
    check_keep,
    select_terms,
    selection_options,
    with_candidates,
    without,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "EquationError",
    "equation_error",
]


_Array: TypeAlias = NDArray[np.float64]

_HEADS, _ALIGN = ["equation", "RMS residual", "unit", "R²", "lag-1 corr.", "samples"], "lrlrrr"
_ERRORS = ["parameter", "std error, if white", "|t|"]


@dataclass(frozen=True, eq=False, repr=False)
class EquationError:
    """The result of `equation_error`.

    parameters         by name; their standard errors are corrected for the autocorrelation of the residuals.
    white_std_errors   name -> standard error without this correction, as for white residuals (it is too small).
    r_squared          equation -> coefficient of determination; NaN where the left side does not move.
    sigmas             equation -> root mean square of its residuals, in its unit.
    groups             the equations that were solved together, since they share parameters.
    collinear          (names, condition index): parameters that compensate each other (index from 30); infinite
                       where the data do not distinguish them at all.
    records            one an experiment. Its outputs are the equations, named after the output or the state with a
                       prime: measured left-hand sides, right-hand sides, residuals; its states are smoothed.
    warnings           in words.
    selection          equation -> which terms were selected, and how; empty without ``select``.
    """

    model: Model
    parameters: Estimates
    white_std_errors: Mapping[str, float]
    r_squared: Mapping[str, float]
    sigmas: Mapping[str, float]
    groups: Sequence[tuple[str, ...]]
    collinear: Sequence[tuple[tuple[str, ...], float]]
    records: Sequence[Record]
    warnings: tuple[str, ...] = ()
    selection: Mapping[str, SelectedTerms] = field(default_factory=dict)
    solution: None = field(default=None, init=False)  # an estimation started from here has no multipliers

    @property
    def t_statistics(self) -> dict[str, float]:
        """Name -> value over standard error (coloured residuals); NaN where there is none."""
        return {name: e.value / e.std_error if e.std_error > 0 else np.nan for name, e in self.parameters.items()}

    @property
    def residuals(self) -> Mapping[str, _Array]:
        """Equation -> (N,), NaN where there is no row, of the only experiment."""
        if len(self.records) > 1:
            raise DataError(f"the regression has {len(self.records)} experiments: use result.records[i].residuals")
        return self.records[0].residuals

    def as_start(self) -> dict[str, float]:
        """Return the parameters as start values of an estimation."""
        return self.parameters.to_dict()

    def _tables(self) -> tuple[list[list[str]], list[list[str]]]:
        """Return the rows of the table of equations, and of that of the standard errors for white residuals."""
        rows = []
        for name, sigma in self.sigmas.items():
            pieces = [r.residuals[name][np.isfinite(r.residuals[name])] for r in self.records]
            colour = _lag_one(pieces)
            unit = self.records[0].units.get(name, "")
            count = str(sum(p.size for p in pieces))
            r2 = self.r_squared[name]
            rows.append([name, f"{sigma:.4g}", unit, f"{r2:.4f}" if np.isfinite(r2) else "", f"{colour:.2f}", count])
        t = self.t_statistics
        lines = []
        for name in self._shown():
            white = self.white_std_errors[name]
            known = np.isfinite(t[name])
            lines.append([name, f"{white:.2g}" if known else "", f"{abs(t[name]):.1f}" if known else ""])
        return rows, lines

    def _shown(self) -> dict[str, Estimate]:
        """Return the parameters without those that a selection left out."""
        dropped = {name for s in self.selection.values() for name in s.dropped}
        return {name: e for name, e in self.parameters.items() if name not in dropped}

    def summary(self) -> str:
        """Return the regression as plain-text tables."""
        rows, lines = self._tables()
        once = dict.fromkeys(self.selection.values())  # equations that share parameters have one selection
        parts = [
            f"{self.model.name}: equation error",
            text_table(_HEADS, rows, _ALIGN),
            *(s.summary() for s in once),
            estimates_table(self._shown().values()),
            text_table(_ERRORS, lines, "srr"),
            *(f"Warning: {w}" for w in self.warnings),
        ]
        return "\n\n".join(parts)

    def _repr_html_(self) -> str:
        rows, lines = self._tables()
        return notebook_page(
            f"{self.model.name}: equation error",
            table(_HEADS, rows, _ALIGN),
            estimates_html(self._shown().values()),
            table(_ERRORS, lines, "srr"),
            *(Html(s._repr_html_()) for s in dict.fromkeys(self.selection.values())),
            bullets(self.warnings),
        )

    def plot(self, record: int | str = 0, channels: Sequence[str] | None = None) -> tuple[Figure, dict[str, Axes]]:
        """Plot both sides of the equations over time, residuals and inputs, of one experiment."""
        chosen = plot.choose_record(self.records, record)
        return plot.plot_record(chosen, channels, title=f"{self.model.name}: {chosen.name}")

    def __repr__(self) -> str:
        return (
            f"<EquationError of '{self.model.name}': {counted(len(self.sigmas), 'equation')}, "
            f"{counted(len(self.parameters), 'parameter')}>"
        )

    def __str__(self) -> str:
        return self.summary()


def _lag_one(pieces: Sequence[_Array]) -> float:
    squares = sum(float((p**2).sum()) for p in pieces)
    return sum(float((p[1:] * p[:-1]).sum()) for p in pieces) / squares if squares > 0 else 0.0


# A positive parameter falls no lower than this part of its start.
_POSITIVE = 1e-12


def equation_error(
    model: Model,
    data: Experiment | Sequence[Experiment],
    *,
    differentiation: Differentiator | None = None,
    start: Mapping[str, float] | None = None,
    terms: Mapping[str, Any] | None = None,
    select: Literal["stepwise", "all", "orthogonal"] | TermSelection | None = None,
    held_out: Experiment | Sequence[Experiment] | None = None,
) -> EquationError:
    """Estimate by regression: the model's equations at the measured states, without integration.

    Every state must be measured by an output of its own (``q=q + bias``). Measured states are smoothed; the left side
    of a state equation is the slope of the smoothed channel, unless another output measures the slope itself; outputs
    that measure no state are regression equations of their own, and a model may have these alone, without states.
    Equations that share parameters are solved together, weighted with their residuals: by linear least
    squares where all are linear in the parameters, else by Gauss-Newton from ``start`` (values by name; those not named
    as declared). Bounds, priors and fixed parameters are kept. Noise in the states biases the estimate, which
    `estimate` avoids: the result serves as a start for it, and as a check.

    differentiation  `SmoothingSpline` (the default), `FourierSmoothing` or `SavitzkyGolay`.
    terms            further terms of the equations, each with a parameter of its own, such as `monomials` gives: by the
                     name of a quantity, an output (``"Cm"``) or a state equation (``"q'"``) a list of expressions,
                     whose parameters are called ``Cm_alpha2``, ..., or a mapping from the names that they are to have.
    select           which terms stay: "stepwise" regression by partial F, "all" subsets by PRESS or by held-out data,
                     "orthogonal" functions by their predicted squared error, or a `TermSelection`. A candidate is each
                     free parameter that is not the constant of an equation. Equations that are not linear in their
                     parameters are left as they are, with a warning. The result's ``selection`` has the steps by
                     equation, its ``model`` the parameters that were not selected fixed at 0. Bounds and priors act on
                     the final regression alone; parameters that have a value an experiment stay.
    held_out         records for the error of each subset on data that are not used for estimates.

    Standard errors are corrected for residual autocorrelation (V. Klein and E. A. Morelli, Aircraft System
    Identification, AIAA 2006, ch. 5); they do not account for the selection. Directions that the data do not determine
    stay at the start, and are named in the warnings.

    Raises ModelError for a state that is not measured, DataError or OptionError for invalid arguments, EvaluationError
    where an equation is not finite at the start.
    """
    runs = as_experiments(data, "equation_error")
    others = [] if held_out is None else as_experiments(held_out, "equation_error: held_out")
    if not isinstance(model, Model):
        raise ModelError(f"equation_error: the first argument is a Model, not a {type(model).__name__}")
    options = None if select is None else selection_options(select)
    if options is None and others:
        raise OptionError(
            "equation_error: held_out is for a selection of terms: give select='stepwise' or another, too"
        )
    if terms:
        model, _ = with_candidates(model, terms)
    _check(model)
    if options is not None:
        check_keep(options.keep, model.parameter_names)
    way = differentiation or SmoothingSpline()
    if not isinstance(way, (SmoothingSpline, FourierSmoothing, SavitzkyGolay)):
        raise OptionError(f"equation_error: differentiation is SmoothingSpline(...) or another such, not {way!r}")
    if not isinstance(start, (Mapping, type(None))):
        raise OptionError(f"equation_error: start holds values by name, not {start!r}")
    for run in (*runs, *others):
        run.check_for(model.input_names, model.output_names, model.output_names, conditions=model.condition_names)
    check_units(model, [*runs, *others], "equation_error")
    check_names(model, start or {}, runs)
    values = [parameter_start(model, start or {}, run.name) for run in runs]  # those of each experiment
    measured = channels(model, values[0])
    listed = equations(model, measured, values[0], runs)
    sides = [EquationSides(model, run, measured, listed, way) for run in runs]
    apart = [EquationSides(model, run, measured, listed, way) for run in others]

    free = {n for n, p in model.declared_parameters.items() if not p.fixed}
    inside = [free.intersection(e.right.symbols) for e in listed]
    found: dict[str, tuple[Regression, int]] = {}
    collinear: list[tuple[tuple[str, ...], float]] = []
    warnings: list[str] = []
    selection: dict[str, SelectedTerms] = {}
    together = groups(inside)
    for members in together:
        names = [n for n in model.parameter_names if any(n in inside[k] for k in members)]
        group = [listed[k] for k in members]
        if options is not None:
            whole = _regression(model, unknowns_of(model, names, runs), group, members, sides, values)
            if not Evaluation(model, group, names).linear:
                warnings.append(
                    f"{', '.join(e.name for e in group)}: not linear in {', '.join(names)}; all these terms are kept"
                )
            elif chosen := select_terms(model, listed, names, sides, values, members, whole.sigmas, apart, options):
                selection |= dict.fromkeys(chosen.equations, chosen)
                model = without(model, chosen.dropped)
                for own in values:
                    own.update(dict.fromkeys(chosen.dropped, 0.0))
                names = [n for n in names if n not in chosen.dropped]
        unknowns = unknowns_of(model, names, runs)
        solved = _regression(model, unknowns, group, members, sides, values)
        found |= {unknown.label: (solved, j) for j, unknown in enumerate(unknowns)}
        labels = [unknown.label for unknown in unknowns]
        collinear += [(tuple(labels[j] for j in c.parameters), c.condition_index) for c in solved.collinear]
        if not solved.settled:
            warnings.append(f"the regression of {', '.join(labels)} did not settle: give another start, or fix some")
    if options is not None and not selection:
        raise OptionError("equation_error: there are no terms to select from: all are kept, constants or not linear")
    warnings += [_warning(names, index) for names, index in collinear]
    everything = unknowns_of(model, model.parameter_names, runs)
    declared = model.declared_parameters
    idle = [u.label for u in everything if not declared[u.name].fixed and u.label not in found]
    if idle:
        warnings.append(f"{', '.join(idle)} appears in no equation and stays at its start")
    records = [side.record(own) for side, own in zip(sides, values, strict=True)]
    return EquationError(
        model=model,
        parameters=Estimates(_estimate(model, u, u.among(values)[0][u.name], found.get(u.label)) for u in everything),
        white_std_errors={u.label: _deviation(found.get(u.label), white=True) for u in everything},
        r_squared=ByName("equation", {e.name: _r_squared(records, e.name) for e in listed}),
        sigmas=ByName("equation", {e.name: _rms(records, e.name) for e in listed}),
        groups=[tuple(listed[k].name for k in members) for members in together],
        collinear=collinear,
        records=records,
        warnings=tuple(warnings),
        selection=ByName("equation", selection),
    )


def _check(model: Model) -> None:
    """Raise ModelError for a model that is not complete; unlike `Model.check` it may be without states."""
    if model.state_names:
        model.check()
        return
    if not model.output_names:
        raise ModelError(
            f"model '{model.name}': it has neither states nor outputs; declare outputs, as in outputs(Cm=...)"
        )
    complete = model.copy()
    (unused,) = complete.states(unused_state="")
    complete.dynamics(unused_state=0.0 * unused)
    complete.check()


def _regression(
    model: Model,
    unknowns: Sequence[Unknown],
    group: Sequence[Equation],
    members: Sequence[int],
    sides: Sequence[EquationSides],
    values: Sequence[dict[str, float]],
) -> Regression:
    """Return the regression of a group of equations, and put its estimates into ``values``."""
    solved = _solve(model, unknowns, group, members, sides, values)
    for j, unknown in enumerate(unknowns):
        for own in unknown.among(values):
            own[unknown.name] = float(solved.values[j])
    return solved


def _solve(
    model: Model,
    unknowns: Sequence[Unknown],
    listed: Sequence[Equation],
    members: Sequence[int],
    sides: Sequence[EquationSides],
    values: Sequence[Mapping[str, float]],
) -> Regression:
    names = list(dict.fromkeys(u.name for u in unknowns))
    evaluation = Evaluation(model, listed, names)
    lefts = [side.left[members] for side in sides]
    masks = [side.mask[members] for side in sides]

    # Which unknowns, and which columns of the derivatives, an experiment has.
    own = [[k for k, u in enumerate(unknowns) if u.experiment in (None, i)] for i in range(len(sides))]
    columns = [[names.index(unknowns[k].name) for k in inside] for inside in own]

    def rows(theta: _Array) -> list[tuple[_Array, _Array]]:
        parts = []
        for i, (side, left, mask) in enumerate(zip(sides, lefts, masks, strict=True)):
            now = {**values[i], **{unknowns[k].name: theta[k] for k in own[i]}}
            right, derivatives = evaluation(now, side.columns)
            regressors = np.zeros((*mask.shape, theta.size))
            regressors[:, :, own[i]] = np.where(mask[:, :, None], derivatives[:, :, columns[i]], 0.0)
            parts.append((np.where(mask, left - right, 0.0), regressors))
        return parts

    start = np.array([u.among(values)[0][u.name] for u in unknowns])
    for i, (side, mask) in enumerate(zip(sides, masks, strict=True)):
        evaluation.check(*evaluation(values[i], side.columns), mask, side.run)
    scales = np.empty(len(listed))
    for i in range(len(listed)):
        left = np.concatenate([left[i][mask[i]] for left, mask in zip(lefts, masks, strict=True)])
        scales[i] = (float(left.std()) if left.size else 0.0) or 1.0
    declared = [model.declared_parameters[u.name] for u in unknowns]
    # A parameter that is estimated in its logarithm afterwards must stay positive.
    least = [_POSITIVE * p.start if p.transform == "log" else -np.inf for p in declared]
    lower = np.maximum([p.bounds[0] for p in declared], least)
    bounds = (lower, np.array([p.bounds[1] for p in declared]))
    return regress(rows, masks, scales, start, bounds, [p.prior for p in declared], evaluation.linear)


def _deviation(of: tuple[Regression, int] | None, white: bool = False) -> float:
    if of is None:
        return np.nan
    solved, j = of
    variance = (solved.white_covariance if white else solved.covariance)[j, j]
    return float(np.sqrt(variance)) if variance >= 0 else np.nan


def _estimate(model: Model, unknown: Unknown, value: float, of: tuple[Regression, int] | None) -> Estimate:
    p = model.declared_parameters[unknown.name]
    side = of[0].active[of[1]] if of else 0
    active: Any = {-1: "lower", 1: "upper"}.get(int(side))
    return Estimate(unknown.label, value, _deviation(of), p.unit, p.start, p.bounds, p.fixed, active)


def _warning(names: Sequence[str], index: float) -> str:
    listed = ", ".join(names)
    if np.isfinite(index):
        return (
            f"{listed} are nearly collinear (condition index {index:.0f}): errors of one are compensated by the others"
        )
    if len(names) == 1:
        return f"{listed} has no influence on the equations with these data, and stays at its start"
    return f"{listed} cannot be distinguished with these data: fix one of them, or give it a prior"


def _joined(records: Sequence[Record], name: str) -> tuple[_Array, _Array]:
    left = np.concatenate([r.measured[name] for r in records])
    residual = np.concatenate([r.residuals[name] for r in records])
    present = np.isfinite(residual)
    return left[present], residual[present]


def _r_squared(records: Sequence[Record], name: str) -> float:
    left, residual = _joined(records, name)
    scatter = float(((left - left.mean()) ** 2).sum()) if left.size else 0.0
    return 1.0 - float((residual**2).sum()) / scatter if scatter > 0 else np.nan


def _rms(records: Sequence[Record], name: str) -> float:
    residual = _joined(records, name)[1]
    return float(np.sqrt(np.mean(residual**2))) if residual.size else np.nan
