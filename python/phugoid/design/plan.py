"""The evaluation of a planned manoeuvre (`Plan`) by its Fisher information, and of several side by side (`Plans`)."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from ..errors import ModelError, OptionError, UnknownName, did_you_mean, listing
from ..figures import LIMIT, SERIES, WIDTH, Panels, labelled, plain, styled
from ..notebook import Rows, overview, sparkline
from ..parameters import Estimates, correlation_matrix, text_table
from ..records import Record
from ..time_unit import SECONDS, TimeUnit, time_unit_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "Criterion",
    "Excursion",
    "Information",
    "Limits",
    "ParameterDirection",
    "Plan",
    "Plans",
    "criterion_of",
    "excursions_of",
]

_Array = NDArray[np.float64]
Criterion: TypeAlias = Literal["D", "A", "worst"]
Limits: TypeAlias = Mapping[str, float | tuple[float, float]]
"""Channel -> greatest size, or (lower, upper)."""


# An eigenvalue of the correlation form below this belongs to a direction that the data do not determine.
_SINGULAR = 1e-11
# Parts of a direction below this are not worth naming.
_PART = 0.1


@dataclass(frozen=True)
class ParameterDirection:
    """A combination of parameters.

    parts      name -> share of the unit vector, each parameter in units of its size; those above 0.1.
    std_error  of a move along it, in these units; infinite where the manoeuvre does not determine it.
    """

    parts: dict[str, float]
    std_error: float

    def __str__(self) -> str:
        text = " ".join(f"{share:+.2f} {name}" for name, share in self.parts.items())
        return f"{text}: {'not determined' if not np.isfinite(self.std_error) else f'± {100 * self.std_error:.3g} %'}"


@dataclass(frozen=True, eq=False)
class Information:
    """Fisher information about parameters.

    names   (n) of the parameters.
    matrix  (n, n), in the units of the parameters, inverse.
    """

    names: Sequence[str]
    matrix: _Array

    @cached_property
    def _directions(self) -> tuple[_Array, _Array, _Array]:
        """Scales (n,), eigenvalues of the matrix with a diagonal of ones, eigenvectors as columns."""
        scale = np.sqrt(np.diag(self.matrix))
        safe = np.where(scale > 0.0, scale, 1.0)
        values, vectors = np.linalg.eigh(self.matrix / np.outer(safe, safe))
        return safe, values, vectors

    @cached_property
    def covariance(self) -> _Array:
        """(n, n); infinite variance, and NaN beside it, for parameters that are not determined (also in
        combinations)."""
        scale, values, vectors = self._directions
        determined = values > _SINGULAR
        part = vectors[:, determined]
        cov = (part / values[determined]) @ part.T / np.outer(scale, scale)
        lost = (np.abs(vectors[:, ~determined]) > 1e-4).any(axis=1)
        cov[lost], cov[:, lost] = np.nan, np.nan
        cov[lost, lost] = np.inf
        return np.asarray(cov)

    @property
    def std_errors(self) -> _Array:
        """(n,) standard errors; infinite for parameters that are not determined."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> _Array:
        """(n, n) correlations; NaN for parameters that are not determined."""
        return correlation_matrix(self.covariance)

    def weak(self, sizes: _Array, n: int = 3) -> tuple[ParameterDirection, ...]:
        """Return the directions that are determined least, worst first, parameters in units of ``sizes`` (n,)."""
        values, vectors = np.linalg.eigh(self.matrix * np.outer(sizes, sizes))
        scale, eigen, own = self._directions
        found = []
        for column in own[:, eigen <= _SINGULAR].T:  # not determined at all
            direction = column / scale / sizes
            found.append(self._named(direction / np.linalg.norm(direction), np.inf))
        for value, vector in list(zip(values, vectors.T, strict=True))[len(found) :][:n]:
            found.append(self._named(vector, float(1.0 / np.sqrt(value)) if value > 0.0 else np.inf))
        return tuple(found[:n])

    def criteria(self, sizes: _Array, of: Collection[str] | None) -> dict[Criterion, float]:
        """Return `Plan.criteria` of the parameters ``of``, None for all, errors in units of ``sizes`` (n,)."""
        names = list(self.names)
        for n in of or ():
            if n not in names:
                raise ModelError(f"plan: of: '{n}' is not a parameter that is estimated.{listing(n, names)}")
        chosen = [i for i, n in enumerate(names) if (of is None or n in of) and np.isfinite(sizes[i])]
        if not chosen:
            raise OptionError("plan: no parameter has a size in which its error counts: give sizes={'name': ...}")
        block = self.covariance[np.ix_(chosen, chosen)] / np.outer(sizes[chosen], sizes[chosen])
        if not np.isfinite(block).all():
            return {"D": np.inf, "A": np.inf, "worst": np.inf}
        variance = np.diag(block)
        scale = np.sqrt(variance)
        _, log_det = np.linalg.slogdet(block / np.outer(scale, scale))
        log_det += 2.0 * np.log(scale).sum()
        return {
            "D": float(np.exp(0.5 * log_det / len(chosen))),
            "A": float(np.sqrt(variance.mean())),
            "worst": float(scale.max()),
        }

    def _named(self, vector: _Array, error: float) -> ParameterDirection:
        order = np.argsort(-np.abs(vector))
        vector = vector * np.sign(vector[order[0]])
        return ParameterDirection({self.names[i]: float(vector[i]) for i in order if abs(vector[i]) > _PART}, error)


# Correlations from here on are worth naming.
_CORRELATED = 0.9


@dataclass(frozen=True)
class Excursion:
    """The range of a channel in a planned manoeuvre, and its limits.

    least, greatest  over the record, in ``unit``.
    limit            (lower, upper) that was given, or None; ``when``: the first time beyond it, or None.
    """

    least: float
    greatest: float
    unit: str = ""
    limit: tuple[float, float] | None = None
    when: float | None = None
    time_unit: TimeUnit = SECONDS

    @property
    def within(self) -> bool:
        """Whether the limits are kept."""
        return self.when is None

    @property
    def excess(self) -> float:
        """How far beyond its limits, over half the distance between them (or the size of the only one); 0 within."""
        if self.limit is None or self.within:
            return 0.0
        low, high = self.limit
        room = 0.5 * (high - low) if np.isfinite(high - low) else max(abs(b) for b in self.limit if np.isfinite(b))
        return max(low - self.least, self.greatest - high) / (room or 1.0)


def excursions_of(record: Record, limits: Limits) -> dict[str, Excursion]:
    """Return the ranges of inputs, states and outputs of a planned record by name."""
    channels = {**record.inputs, **record.states, **record.outputs}
    for n in limits:
        if n not in channels:
            raise ModelError(f"plan: limits: '{n}' is not an input, state or output.{listing(str(n), list(channels))}")
    found = {}
    for n, v in channels.items():
        bound = limits.get(n)
        limit: tuple[float, float] | None = None
        if bound is not None:
            low, high = (-bound, bound) if isinstance(bound, (int, float)) else bound
            if not low < high:
                raise OptionError(f"plan: limits of '{n}' are a size, or (lower, upper), not {bound!r}")
            limit = float(low), float(high)
        # A limit that is an amplitude is reached, not left.
        slack = 1e-9 * max((abs(b) for b in limit or () if np.isfinite(b)), default=0.0)
        beyond = np.zeros(v.size, dtype=bool) if limit is None else (v < limit[0] - slack) | (v > limit[1] + slack)
        when = float(record.t[np.argmax(beyond)]) if beyond.any() else None
        unit, time = record.units.get(n, ""), time_unit_of(record.units)
        found[n] = Excursion(float(v.min()), float(v.max()), unit, limit, when, time)
    return found


@dataclass(frozen=True, eq=False, repr=False)
class Plan:
    """The evaluation of a planned manoeuvre. All errors are Cramér-Rao bounds for white noise, initial states free.

    name         of the manoeuvre.
    parameters   by name: the values that were assumed, and the standard error that an estimation would have. Infinite
                 for a parameter that is not determined, alone or in a combination; NaN for one that is fixed.
    information  `Information` on the parameters that are estimated: matrix, covariance, correlation.
    excursions   manoeuvre -> channel (inputs, states, outputs) -> `Excursion`.
    records      the predictions of the model, one for each record.
    sizes        (n,) in which criteria measure errors: the sizes of the values, unless given. NaN where there is
                 neither.
    criteria     "D": geometric mean of relative errors along the axes of the confidence ellipsoid; "A": root of the
                 mean of their squares; "worst": the greatest relative error of a parameter. Small is good, infinite is
                 not determined.
    choice       what `optimal_plan` chose.
    warnings     in words: a measured condition that the manoeuvre changes; an early end of the search.
    """

    name: str
    parameters: Estimates
    information: Information
    excursions: Mapping[str, Mapping[str, Excursion]]
    records: Sequence[Record]
    sizes: _Array
    criteria: Mapping[Criterion, float]
    sigmas: Mapping[str, float]
    choice: Mapping[str, float] = field(default_factory=dict)
    added: str = ""
    warnings: tuple[str, ...] = ()

    @property
    def weak(self) -> tuple[ParameterDirection, ...]:
        """The three combinations of parameters that are determined least, worst first."""
        return self.information.weak(np.where(np.isfinite(self.sizes), self.sizes, 1.0))

    @property
    def correlated(self) -> list[tuple[str, str, float]]:
        """Pairs whose estimates would be correlated by 0.9 or more, worst first."""
        found, names = self.information.correlation, list(self.information.names)
        pairs = [(names[i], names[j], float(found[i, j])) for i in range(len(names)) for j in range(i)]
        return sorted([p for p in pairs if abs(p[2]) >= _CORRELATED], key=lambda p: -abs(p[2]))

    @property
    def within_limits(self) -> bool:
        """Whether every channel keeps its limits."""
        return all(e.within for channels in self.excursions.values() for e in channels.values())

    @property
    def violations(self) -> tuple[str, ...]:
        """The violations of limits, in words."""
        return tuple(
            f"{channel} of '{run}' leaves {e.limit[0]:g} to {e.limit[1]:g} {e.unit}".rstrip()
            + f" at {e.when:.3g} {e.time_unit}: it goes from {e.least:.4g} to {e.greatest:.4g}"
            for run, channels in self.excursions.items()
            for channel, e in channels.items()
            if e.limit is not None and e.when is not None
        )

    def summary(self) -> str:
        """Return tables of standard errors, weak directions, and excursions."""
        title = f"Planned: {self.name}" + (f", {self.added}" if self.added else "")
        errors, ranges = (text_table(*rows) for rows in (self._error_rows(), self._range_rows()))
        text = [f"{title} ({self._length()})", "", errors]
        text += ["", "determined least (unit vectors, parameters in units of their sizes):"]
        text += [f"  {direction}" for direction in self.weak]
        pairs = ", ".join(f"{a} and {b} {r:+.3f}" for a, b, r in self.correlated[:6])
        text += [f"correlated: {pairs}"] if pairs else []
        text += ["", ranges]
        return "\n".join([*text, *(f"Limit: {v}" for v in self.violations), *(f"Warning: {w}" for w in self.warnings)])

    def _repr_html_(self) -> str:
        first = self.records[0]
        pictures = {n: sparkline(v, t=first.t) for n, v in {**first.states, **first.outputs, **first.inputs}.items()}
        weak = [f"determined least: {self.weak[0]}"] if self.weak else []
        return overview(
            f"Planned: {self.name}" + (f", {self.added}" if self.added else ""),
            self._error_rows(),
            self._range_rows(),
            remarks=[*weak, *self.violations, *self.warnings],
            pictures=pictures,
            note=self._length(),
        )

    def _length(self) -> str:
        return ", ".join(f"{r.t[-1] - r.t[0]:g} {time_unit_of(r.units)}, {r.t.size} samples" for r in self.records)

    def _error_rows(self) -> Rows:
        rows = []
        for e in self.parameters.values():
            percent = 100.0 * e.relative_std_error
            error = "not determined" if np.isinf(e.std_error) else f"{e.std_error:.3g}" if e.std_error >= 0.0 else ""
            rows.append([e.name, f"{e.value:.6g}", error, f"{percent:.3g}" if np.isfinite(percent) else "", e.unit])
        rows = [[*row, e.remark] for row, e in zip(rows, self.parameters.values(), strict=True)]
        return ["parameter", "assumed", "std error", "in %", "unit", "remark"], rows, "srrrll"

    def _range_rows(self) -> Rows:
        many = len(self.excursions) > 1
        ranges = [
            [f"{channel} [{run}]" if many else channel, f"{e.least:.4g}", f"{e.greatest:.4g}", e.unit, _limit(e)]
            for run, channels in self.excursions.items()
            for channel, e in channels.items()
        ]
        return ["channel", "least", "greatest", "unit", "limit"], ranges, "lrrll"

    def plot(self) -> tuple[Figure, dict[str, Axes]]:
        """Plot inputs and predicted outputs over time with their limits, and the predicted errors."""
        return Plans({self.name: self}).plot()

    def __str__(self) -> str:
        return self.summary()

    def __repr__(self) -> str:
        worst = self.criteria["worst"]
        quality = "does not determine all parameters" if np.isinf(worst) else f"worst error {100 * worst:.3g} %"
        return f"<Plan '{self.name}': {quality}{'' if self.within_limits else ', leaves its limits'}>"


def _limit(e: Excursion) -> str:
    if e.limit is None:
        return ""
    return f"{e.limit[0]:g} to {e.limit[1]:g}" + ("" if e.within else f", left at {e.when:.3g} {e.time_unit}")


class Plans(Mapping[str, Plan]):
    """Plans by name, in the order given; printed, a table of relative errors side by side."""

    def __init__(self, plans: Mapping[str, Plan]) -> None:
        self._plans = dict(plans)

    def __getitem__(self, name: str) -> Plan:
        try:
            return self._plans[name]
        except KeyError:
            raise UnknownName(f"there is no plan '{name}'.{did_you_mean(str(name), self._plans)}") from None

    def _ipython_key_completions_(self) -> list[str]:
        return list(self)

    def __iter__(self) -> Iterator[str]:
        return iter(self._plans)

    def __len__(self) -> int:
        return len(self._plans)

    def best(self, criterion: Criterion = "D") -> Plan:
        """Return the plan with the least ``criterion`` (see `Plan.criteria`) among those that keep their limits.

        Raises OptionError where none does.
        """
        kind = criterion_of("best", criterion)
        kept = [p for p in self._plans.values() if p.within_limits]
        if not kept:
            raise OptionError(
                "best: no manoeuvre stays within its limits; .summary() says what exceeds them, and by how much"
            )
        return min(kept, key=lambda p: p.criteria[kind])

    def summary(self) -> str:
        """Return a table of relative standard errors in %, criteria, and violated limits, side by side."""
        text, violations = text_table(*self._rows()), self._violations()
        return "\n".join([text, *self._remarks(), *violations])

    def _repr_html_(self) -> str:
        return overview(f"{len(self)} plans", self._rows(), remarks=[*self._remarks(), *self._violations()])

    def _violations(self) -> list[str]:
        return [f"{p.name}: {v}" for p in self._plans.values() for v in p.violations]

    def _remarks(self) -> list[str]:
        starred = any("*" in cell for row in self._rows()[1] for cell in row[1:])
        return ["* of a parameter that is 0 and has no size: in its unit"] if starred else []

    def _rows(self) -> Rows:
        plans = list(self._plans.values())
        names = list(dict.fromkeys(n for p in plans for n in p.parameters))
        rows = [[n, *(_percent(p, n) for p in plans)] for n in names]
        for kind in get_args(Criterion):
            label = {"D": "D (mean axis)", "A": "A (rms)", "worst": "worst"}[kind]
            rows.append([label, *(_number(100.0 * p.criteria[kind]) for p in plans)])
        rows.append(["limits kept", *("yes" if p.within_limits else "no" for p in plans)])
        header = ["std error in %", *(p.name for p in plans)]
        return header, rows, "s" + "r" * len(plans)

    def plot(self) -> tuple[Figure, dict[str, Axes]]:
        """Plot inputs and predicted outputs of all plans over time with their limits, and the predicted errors side by
        side."""
        return _plot(list(self._plans.values()))

    def __str__(self) -> str:
        return self.summary()

    def __repr__(self) -> str:
        return f"Plans({', '.join(map(repr, self._plans.values()))})"


def relative_errors(plan: Plan) -> dict[str, float]:
    """Return the standard errors of the estimated parameters in units of their sizes; NaN where there is no size."""
    return dict(zip(plan.information.names, (plan.information.std_errors / plan.sizes).tolist(), strict=True))


def _percent(plan: Plan, name: str) -> str:
    error = plan.parameters[name].std_error if name in plan.parameters else np.nan
    relative = relative_errors(plan).get(name, np.nan)
    if np.isnan(relative) and np.isfinite(error):
        return f"{error:.3g}*"
    return _number(100.0 * relative)


def _number(value: float) -> str:
    return "not determined" if np.isinf(value) else "" if np.isnan(value) else f"{value:.3g}"


def criterion_of(caller: str, criterion: Any) -> Criterion:
    if criterion not in get_args(Criterion):
        raise OptionError(f"{caller}: criterion is one of {', '.join(get_args(Criterion))}, not {criterion!r}")
    found: Criterion = criterion
    return found


# Inches: height of a channel's panel, of the margins around all panels, and the least of the figure.
_CHANNEL, _AROUND, _LEAST = 0.8, 0.9, 3.0


def _plot(plans: Sequence[Plan]) -> tuple[Figure, dict[str, Axes]]:
    """Plot time histories on the left, relative errors of all parameters on the right; axes by channel, and
    "errors"."""
    first = plans[0].records[0]
    channels = [*first.inputs, *first.outputs]
    excursions = plans[0].excursions[first.name]
    channels += [n for n, e in excursions.items() if e.limit is not None and n not in channels]
    with styled() as plt:
        height = max(_CHANNEL * len(channels) + _AROUND, _LEAST)
        figure = plt.figure(figsize=(WIDTH, height), layout="constrained")
        left, right = figure.subfigures(1, 2, width_ratios=(1.25, 1.0), squeeze=False)[0]
        rows = left.subplots(len(channels), 1, sharex=True, squeeze=False)[:, 0]
        axes: dict[str, Axes] = dict(zip(channels, rows, strict=True))
        for i, p in enumerate(plans):
            _histories(axes, p, SERIES[i % len(SERIES)][0])
        for n, a in axes.items():
            _limits(a, excursions[n].limit)
            a.set_ylabel(plain(labelled(n, {n: excursions[n].unit})))
            a.margins(x=0.01)
        rows[-1].set_xlabel(plain(time_unit_of(first.units).axis()))
        left.align_ylabels(list(rows))
        axes["errors"] = _errors(right.subplots(), plans)
    return figure, Panels(axes)


def _histories(axes: Mapping[str, Axes], p: Plan, colour: str) -> None:
    """Draw the time histories, one record after another."""
    offset = 0.0
    for r in p.records:
        t = offset + r.t - r.t[0]
        for n, values in {**r.states, **r.outputs, **r.inputs}.items():
            if n in axes:
                axes[n].plot(t, values, color=colour, linewidth=0.9)
        offset = float(t[-1])


def _limits(a: Axes, limit: tuple[float, float] | None) -> None:
    if limit is None:
        return
    low, high = a.get_ylim()
    for bound in limit:
        if np.isfinite(bound) and low - (high - low) < bound < high + (high - low):
            a.axhline(bound, color=LIMIT, linestyle="--", linewidth=0.8)


def _errors(a: Axes, plans: Sequence[Plan]) -> Axes:
    names = list(dict.fromkeys(n for p in plans for n, v in relative_errors(p).items() if not np.isnan(v)))
    y = np.arange(len(names))[::-1]
    for i, p in enumerate(plans):
        found = relative_errors(p)
        x = 100.0 * np.array([found.get(n, np.nan) for n in names])
        shift = 0.0 if len(plans) == 1 else 0.36 * (0.5 - i / (len(plans) - 1))
        colour, mark = SERIES[i % len(SERIES)]
        finite = np.where(np.isfinite(x), x, np.nan)
        a.plot(finite, y + shift, color=colour, linestyle="", marker=mark, markersize=4, label=plain(p.name))
        for at, value in zip((y + shift).tolist(), x.tolist(), strict=True):
            if np.isinf(value):
                axis = a.get_yaxis_transform()
                a.text(0.98, at, "not determined", color=colour, fontsize=6.5, transform=axis, ha="right", va="center")
    a.grid(axis="both", linewidth=0.3)
    a.set_xscale("log")
    a.xaxis.set_major_formatter("{x:g}")
    a.set_yticks(y, [plain(n) for n in names])
    a.set_ylim(-0.6, len(names) - 0.4)
    a.set_xlabel("expected standard error, % of size")
    a.legend(fontsize=7.0, frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    return a
