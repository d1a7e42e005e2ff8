"""Trim: states and inputs at which all derivatives of a model have given values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from .._core import Expr
from ..errors import EvaluationError, ModelError, OptionError, finite, listing
from ..fit_result import FitResult
from ..modelling.model import Model
from ..notebook import Rows, overview
from ..parameters import text_table
from .linearise import numbers_of

__all__ = ["Trim", "trim"]

_Array: TypeAlias = NDArray[np.float64]

# Largest residual of an equation, relative to its terms (each derivative times its unknown), where it is satisfied.
_MET = 1e-9
# Unknowns are taken to be of this size at least there, and to be 0 where they are as small as the other.
_LEAST, _ROUNDING = 1e-6, 1e-20
# Unknowns whose direction is this much weaker than the strongest are not determined by the equations.
_FREE = 1e-9
_STEPS = 20


@dataclass(frozen=True, eq=False, repr=False)
class Trim(Mapping[str, float]):
    """A trim point: name -> value of all states and inputs (and time), as `linearise` and `modes` take it (``at=``).

    states, inputs, outputs  name -> value, in their units.
    rates      state -> its derivative there, per s; what was asked for but for rounding.
    found      names that were solved for; the others were held.
    warnings   in words.
    """

    states: Mapping[str, float]
    inputs: Mapping[str, float]
    outputs: Mapping[str, float]
    rates: Mapping[str, float]
    found: tuple[str, ...]
    units: Mapping[str, str] = field(default_factory=dict)
    time: float = 0.0
    warnings: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> float:
        return {**self.states, **self.inputs, "time": self.time}[name]

    def _ipython_key_completions_(self) -> list[str]:
        return list(self)

    def __iter__(self) -> Iterator[str]:
        return iter([*self.states, *self.inputs, "time"])

    def __len__(self) -> int:
        return len(self.states) + len(self.inputs) + 1

    def __repr__(self) -> str:
        return f"<Trim: {', '.join(f'{n} = {v:.6g}' for n, v in {**self.states, **self.inputs}.items())}>"

    def __str__(self) -> str:
        return text_table(*self._rows()) + "".join(f"\n\nWarning: {w}" for w in self.warnings)

    def _repr_html_(self) -> str:
        return overview("Trim", self._rows(), remarks=self.warnings)

    def _rows(self) -> Rows:
        rows = []
        for kind, group in (("state", self.states), ("input", self.inputs), ("output", self.outputs)):
            for name, value in group.items():
                remark = "" if kind == "output" or name in self.found else "held"
                rows.append([kind, name, f"{value:.6g}", self.units.get(name, ""), remark])
        return ["", "name", "value", "unit", ""], rows, "lsrll"


def trim(
    fit: FitResult | Model,
    parameters: Mapping[str, Any] | None = None,
    *,
    at: Mapping[str, float] | None = None,
    rates: Mapping[str, float | None] | None = None,
    outputs: Mapping[str, float] | None = None,
    start: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    experiment: str | None = None,
) -> Trim:
    """Find states and inputs at which all derivatives vanish: f(x, u, theta) = 0, by Newton's method with exact
    derivatives, globalised by a trust region (`scipy.optimize.least_squares`).

    ``fit``, ``parameters``, ``experiment``  as in `linearise`.
    ``at``       states, inputs (and time) that are held, by name, in their units. As many as there are inputs must be
                 held, or given as ``outputs``, so that there are as many unknowns as equations.
    ``rates``    derivatives by state, per s, that are not to be 0, as in a steady climb or turn; None where any value
                 is allowed, as for a position.
    ``outputs``  outputs with a given value: ``{"az": -9.81}``.
    ``start``    start values; else the first sample of the fit's record, 0 without a fit.
    ``bounds``   (lower, upper) of unknowns.

    Raises ModelError for unknown names and values that are missing; OptionError where unknowns and equations
    do not match in number, and where no trim was found, with what is left; EvaluationError where the model is not
    finite at the start.

    >>> m = Model("pendulum with a motor")
    >>> phi, w = m.states(phi="rad", w="rad/s")
    >>> T, = m.inputs(T="rad/s**2")
    >>> from phugoid import sin
    >>> m.dynamics(phi=w, w=T - 9.81*sin(phi))
    >>> m.outputs(phi=phi)
    >>> trim(m, at={"phi": 0.5})
    <Trim: phi = 0.5, w = 0, T = 4.70316>
    """
    model, values = numbers_of("trim", fit, parameters, experiment)
    begin = _start(model, fit if isinstance(fit, FitResult) else None, experiment, dict(start or {}))
    problem = _TrimEquations(model, values, dict(at or {}), dict(rates or {}), dict(outputs or {}))
    if isinstance(fit, FitResult) and experiment is None and parameters is None and len(fit.records) > 1:
        own = [n for n in sorted(problem.used) if f"{n}[{fit.records[0].name}]" in fit.parameters]
        if own:
            raise ModelError(
                f"trim: each experiment has its own {own[0]}: say which, experiment='{fit.records[0].name}'"
            )
    return problem.solve(np.array([begin[n] for n in problem.unknown]), _bounds(problem.unknown, dict(bounds or {})))


class _TrimEquations:
    """Equations and unknowns of a trim point. A delayed input equals the input, since all is constant."""

    def __init__(
        self,
        model: Model,
        values: Mapping[str, float],
        held: dict[str, float],
        rates: dict[str, float | None],
        outputs: dict[str, float],
    ) -> None:
        self.model, self.values = model, values
        self.held = {name: finite(f"trim: at: {name}", value, ModelError) for name, value in held.items()}
        _known("at", held, (*model.state_names, *model.input_names, "time"))
        _known("rates", rates, model.state_names)
        _known("outputs", outputs, model.output_names)
        same = {late: Expr.symbol(of) for late, (of, _) in model.delays.inputs.items()}
        self.f = {name: Expr(e.substitute(same)) for name, e in model.state_expressions().items()}
        self.g = {name: Expr(Expr(e).substitute(same)) for name, e in model.output_expressions().items()}
        targets = {name: 0.0 for name in model.state_names} | rates
        goals = {f"{n}'": (self.f[n], value) for n, value in targets.items() if value is not None}
        goals |= {n: (self.g[n], value) for n, value in outputs.items()}
        self.names = list(goals)
        self.equations = [Expr(e - finite(f"trim: {n}", value, ModelError)) for n, (e, value) in goals.items()]
        self.unknown = [n for n in (*model.state_names, *model.input_names) if n not in held]
        self.used = {n for e in (*self.equations, *self.f.values()) for n in e.symbols}
        if "time" in self.used and "time" not in held:
            raise ModelError("trim: the equations depend on time: say when, as in at={'time': 0.0}")
        self._check_count()
        self.slopes = [
            {k: d for k, n in enumerate(self.unknown) if n in e.symbols and (d := e.diff(n)).constant != 0.0}
            for e in self.equations
        ]

    def _check_count(self) -> None:
        more = len(self.unknown) - len(self.equations)
        if more > 0:
            raise OptionError(
                f"trim: {len(self.unknown)} unknowns ({', '.join(self.unknown)}) and {len(self.equations)} equations "
                f"({', '.join(self.names)}): give {more} more, as in at={{'{self.unknown[0]}': ...}}, or say what "
                "outputs are to be"
            )
        if not self.unknown:
            raise OptionError("trim: all states and inputs are given, so that there is no unknown")

    def numbers(self, x: _Array) -> dict[str, float]:
        return {**self.values, **self.held, **dict(zip(self.unknown, x.tolist(), strict=True))}

    def residuals(self, x: _Array) -> _Array:
        numbers = self.numbers(x)
        return np.array([_at(e, numbers) for e in self.equations])

    def jacobian(self, x: _Array) -> _Array:
        numbers, found = self.numbers(x), np.zeros((len(self.equations), len(self.unknown)))
        for i, row in enumerate(self.slopes):
            for k, d in row.items():
                found[i, k] = _at(d, numbers)
        return found

    def solve(self, begin: _Array, bounds: tuple[_Array, _Array]) -> Trim:
        from scipy.optimize import least_squares

        x = np.clip(begin, *bounds)
        if not (np.isfinite(self.residuals(x)).all() and np.isfinite(self.jacobian(x)).all()):
            first = ", ".join(f"{n} = {v:g}" for n, v in zip(self.unknown, x, strict=True))
            raise EvaluationError(f"trim: the equations or their derivatives are not finite at {first}: give a start")
        for _ in range(2):  # again from the end point: scales are those of its Jacobian
            try:
                with np.errstate(all="ignore"):
                    x = least_squares(
                        self.residuals, x, self.jacobian, bounds, xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale="jac"
                    ).x
            except (ValueError, np.linalg.LinAlgError):  # not finite on the way: the last point is judged
                break
        x = self._refined(x, bounds)
        left = np.abs(self.residuals(x))
        jacobian = self.jacobian(x)
        sizes = np.maximum(np.maximum(np.abs(x), np.abs(begin)), _LEAST)
        terms = np.abs(jacobian) @ sizes + np.finfo(np.float64).eps
        worst = int(np.argmax(left / terms))
        if not left[worst] <= _MET * terms[worst]:
            at = ", ".join(f"{n} = {v:.4g}" for n, v in self.numbers(x).items() if n not in self.values)
            raise OptionError(
                f"trim: no trim was found: {self.names[worst]} comes no nearer than {left[worst]:.3g} (at {at}); hold "
                "other values, begin elsewhere (start=...), or widen bounds"
            )
        return self._result(np.where(np.abs(x) < _ROUNDING, 0.0, x), self._undetermined(jacobian, sizes))

    def _refined(self, x: _Array, bounds: tuple[_Array, _Array]) -> _Array:
        """Improve the solution by Newton steps, as long as they reduce the residuals."""
        for _ in range(_STEPS):
            step = np.linalg.lstsq(self.jacobian(x), -self.residuals(x), rcond=_FREE)[0]
            trial = np.clip(x + step, *bounds)
            r = self.residuals(trial)
            if not np.isfinite(r).all() or np.linalg.norm(r) >= np.linalg.norm(self.residuals(x)):
                break
            x = trial
        return x

    def _undetermined(self, jacobian: _Array, sizes: _Array) -> list[str]:
        """Return the unknowns that the equations do not determine: those in the null space."""
        scaled = jacobian * sizes
        rows = np.abs(scaled).max(axis=1, keepdims=True)
        _, values, directions = np.linalg.svd(scaled / np.where(rows > 0.0, rows, 1.0))
        values = np.pad(values, (0, len(self.unknown) - values.size))
        null = directions[values <= _FREE * values.max()]
        return [n for k, n in enumerate(self.unknown) if null.size and np.abs(null[:, k]).max() > 1e-6]

    def _result(self, x: _Array, undetermined: Sequence[str]) -> Trim:
        numbers, model = self.numbers(x), self.model
        late = {name: numbers[of] for name, (of, _) in model.delays.inputs.items()}
        warnings: tuple[str, ...] = ()
        if undetermined:
            what = "is" if len(undetermined) == 1 else "are"
            warnings = (f"{', '.join(undetermined)} {what} not determined by the equations: give a value",)
        return Trim(
            states={n: numbers[n] for n in model.state_names},
            inputs={n: {**numbers, **late}[n] for n in model.declared_inputs},
            outputs={n: _at(e, {"time": 0.0, **numbers}) for n, e in self.g.items()},
            rates={n: _at(self.f[n], numbers) for n in model.state_names},
            found=tuple(self.unknown),
            units=model.units,
            time=self.held.get("time", 0.0),
            warnings=warnings,
        )


def _at(e: Expr, numbers: Mapping[str, float]) -> float:
    return e.evaluate({n: numbers[n] for n in e.symbols})


def _start(model: Model, fit: FitResult | None, experiment: str | None, given: dict[str, float]) -> dict[str, float]:
    names = (*model.state_names, *model.input_names)
    _known("start", given, names)
    found = dict.fromkeys(names, 0.0)
    if fit is not None:
        record = next(r for r in fit.records if experiment in (None, r.name))
        found |= {n: float(v[0]) for n, v in {**record.inputs, **record.states}.items()}
    return found | {n: finite(f"trim: start: {n}", v, ModelError) for n, v in given.items()}


def _bounds(unknown: Sequence[str], given: dict[str, tuple[float, float]]) -> tuple[_Array, _Array]:
    _known("bounds", given, unknown)
    pairs = [given.get(n, (-np.inf, np.inf)) for n in unknown]
    try:
        lower, upper = (np.array([float(p[i]) for p in pairs]) for i in range(2))
    except (TypeError, ValueError, IndexError):
        raise OptionError(f"trim: bounds are pairs (lower, upper) by name, not {given!r}") from None
    if not (lower < upper).all():
        name = unknown[int(np.argmin(lower < upper))]
        raise OptionError(f"trim: the bounds of {name} are not (lower, upper): {given[name]!r}")
    return lower, upper


def _known(what: str, given: Mapping[str, Any], names: Sequence[str]) -> None:
    for name in given:
        if name not in names:
            raise ModelError(f"trim: {what}: '{name}' is not there.{listing(str(name), names)}")
