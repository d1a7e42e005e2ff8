"""Parameters as the user declares them (`Parameter`), and as a fit estimates them (`Estimate`, `Estimates`)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from ._core import Expr
from .errors import ModelError, OptionError, UnknownName, did_you_mean
from .notebook import Html, notebook_page, table
from .tabular import estimates_frame

if TYPE_CHECKING:
    import pandas

__all__ = [
    "Estimate",
    "Estimates",
    "Parameter",
    "correlation_matrix",
    "derived",
    "estimates_html",
    "estimates_table",
    "facts_text",
    "plus_minus",
    "text_table",
]

_INF = math.inf


@dataclass(frozen=True)
class Parameter:
    """An unknown constant of the model, as declared.

    start    start value of the iterations (in the parameter's unit); the value itself where ``fixed``.
    bounds   ``(lower, upper)``; ``-inf`` and ``inf`` stand for no bound.
    unit     for labels and tables only; nothing is converted.
    prior    ``(mean, std)`` of a Gaussian prior, or None.
    fixed    True keeps the parameter at ``start``.
    per_experiment  True gives each experiment a value of its own, called ``name[experiment]`` in the fit: biases, wind.
    transform       "log" lets the solver search in the logarithm, for positive parameters that may be wrong by
                    orders of magnitude; value, bounds, prior and standard error stay those of the parameter.
    scale           a typical size, which the solver uses as unit. `Newton` needs none.

    Raises ModelError where a value is not a number, the bounds are reversed or equal, ``start`` lies outside
    them, or the prior's standard deviation is not positive.

    >>> Parameter(0.2, bounds=(0, 1), unit="1/s").bounds
    (0.0, 1.0)
    """

    start: float = 0.0
    bounds: tuple[float, float] = (-_INF, _INF)
    unit: str = ""
    prior: tuple[float, float] | None = None
    fixed: bool = False
    per_experiment: bool = False
    transform: Literal["log"] | None = None
    scale: float | None = None

    def __post_init__(self) -> None:
        start = _number(self.start, "start")
        if not math.isfinite(start):
            raise ModelError(f"a parameter's start must be a finite number, but it is {start}")
        lower, upper = _pair(self.bounds, "bounds", "(lower, upper); -inf and inf stand for no bound")
        if lower > upper:
            raise ModelError(f"a parameter's bounds ({lower:g}, {upper:g}) are reversed: give (lower, upper)")
        if lower == upper:
            raise ModelError(
                f"a parameter's bounds ({lower:g}, {upper:g}) leave no room: use Parameter({lower:g}, fixed=True)"
            )
        if not lower <= start <= upper:
            raise ModelError(
                f"a parameter's start {start:g} lies outside its bounds ({lower:g}, {upper:g}): "
                "give a start between them"
            )
        prior = None
        if self.prior is not None:
            mean, std = prior = _pair(self.prior, "prior", "(mean, standard deviation)")
            if not math.isfinite(mean):
                raise ModelError(f"a parameter's prior has mean {mean}: give a finite number")
            if not 0.0 < std < _INF:
                raise ModelError(
                    f"a parameter's prior has standard deviation {std:g}: it must be positive and finite "
                    "(use fixed=True for a known value, prior=None for an unknown one)"
                )
        if not isinstance(self.unit, str):
            raise ModelError(f"a parameter's unit must be text, but it is {self.unit!r}")
        if self.transform not in (None, "log"):
            raise ModelError(f'a parameter\'s transform is "log" or None, not {self.transform!r}')
        if self.transform == "log" and not start > 0.0:
            raise ModelError(f'a parameter\'s start {start:g} has no logarithm: transform="log" is for positive ones')
        if self.scale is not None:
            if self.transform is not None:
                raise ModelError("a parameter has a transform or a scale, not both: a logarithm has no unit")
            scale = _number(self.scale, "scale")
            if not 0.0 < scale < _INF:
                raise ModelError(f"a parameter's scale {scale:g} must be positive and finite")
            object.__setattr__(self, "scale", scale)
        object.__setattr__(self, "start", start)
        object.__setattr__(self, "bounds", (lower, upper))
        object.__setattr__(self, "prior", prior)


@dataclass(frozen=True, repr=False)
class Estimate:
    """The estimate of one parameter; ``float(estimate)`` is its value.

    std_error      standard error from the inverse information matrix (Cramér-Rao bound), in ``unit``; NaN
                   where there is none: the parameter is fixed, at a bound, or not identifiable.
    start, bounds  as declared.
    bounds_active  ``"lower"`` or ``"upper"`` where the estimate lies at that bound, else None.

    >>> Estimate("Mw", 0.21661, 0.00031, "1/s")
    Mw = 0.2166 ± 0.0003 1/s
    """

    name: str
    value: float
    std_error: float = math.nan
    unit: str = ""
    start: float = 0.0
    bounds: tuple[float, float] = (-_INF, _INF)
    fixed: bool = False
    bounds_active: Literal["lower", "upper"] | None = None

    def __post_init__(self) -> None:
        for name in ("value", "std_error", "start"):  # numpy's numbers print otherwise
            object.__setattr__(self, name, float(getattr(self, name)))
        lower, upper = self.bounds
        object.__setattr__(self, "bounds", (float(lower), float(upper)))

    @property
    def relative_std_error(self) -> float:
        """Standard error over the size of the value; NaN where there is no error or the value is zero."""
        return self.std_error / abs(self.value) if self.value != 0.0 else math.nan

    @property
    def remark(self) -> str:
        """For tables: ``"fixed"``, ``"at lower bound"``, ``"at upper bound"`` or ``""``."""
        if self.fixed:
            return "fixed"
        return f"at {self.bounds_active} bound" if self.bounds_active else ""

    def __float__(self) -> float:
        return float(self.value)

    def __repr__(self) -> str:
        text = f"{self.name} = {plus_minus(self.value, self.std_error)} {self.unit}".rstrip()
        return f"{text} ({self.remark})" if self.remark else text


class Estimates(Mapping[str, Estimate]):
    """The estimates of a fit by name, in the model's order; read-only.

    An unknown name raises UnknownName (a KeyError), which says what the nearest name is.
    """

    def __init__(self, estimates: Iterable[Estimate] = ()) -> None:
        self._by_name: dict[str, Estimate] = {}
        for estimate in estimates:
            if estimate.name in self._by_name:
                raise ModelError(f"two parameters are called '{estimate.name}'")
            self._by_name[estimate.name] = estimate

    def __getitem__(self, name: str) -> Estimate:
        try:
            return self._by_name[name]
        except KeyError:
            hint = did_you_mean(str(name), self._by_name) or f" There are: {', '.join(self._by_name)}."
            raise UnknownName(f"there is no parameter '{name}'.{hint}") from None

    def __contains__(self, name: object) -> bool:  # without the words of an unknown name, which take long
        return name in self._by_name

    def __iter__(self) -> Iterator[str]:
        return iter(self._by_name)

    def __len__(self) -> int:
        return len(self._by_name)

    @property
    def names(self) -> tuple[str, ...]:
        """The names, in order."""
        return tuple(self._by_name)

    @property
    def values_array(self) -> NDArray[np.float64]:
        """The values, shape (n,), in the order of ``names``."""
        return np.array([e.value for e in self._by_name.values()], dtype=np.float64)

    @property
    def std_errors_array(self) -> NDArray[np.float64]:
        """The standard errors, shape (n,), in the order of ``names``; NaN where there is none."""
        return np.array([e.std_error for e in self._by_name.values()], dtype=np.float64)

    def conf_int(self, level: float = 0.95) -> dict[str, tuple[float, float]]:
        """Return the interval of each free parameter at a confidence level: the estimate and as many standard errors to
        both sides as the normal distribution asks for, cut off at the bounds. NaN where there is no standard error.

        Raises OptionError for a level that is not between 0 and 1.
        """
        if not 0.0 < level < 1.0:
            raise OptionError(f"conf_int: level is between 0 and 1, not {level!r}")
        from statistics import NormalDist  # not at import: it takes its time

        factor = NormalDist().inv_cdf(0.5 + 0.5 * level)
        found = {}
        for name, e in self._by_name.items():
            if not e.fixed:
                low, high = e.value - factor * e.std_error, e.value + factor * e.std_error
                found[name] = (max(low, e.bounds[0]), min(high, e.bounds[1])) if low <= high else (math.nan, math.nan)
        return found

    def to_dict(self) -> dict[str, float]:
        """Return name -> value, as ``estimate(start=...)`` and ``simulate`` take it."""
        return {name: float(e.value) for name, e in self._by_name.items()}

    def to_pandas(self) -> pandas.DataFrame:
        """Return a table with one row for each estimate, by name: value, std_error, relative_std_error, unit, start,
        lower and upper bound, fixed, bounds_active ("lower", "upper" or ""). Raises MissingDependency without pandas.
        """
        return estimates_frame(self._by_name.values())

    def _ipython_key_completions_(self) -> list[str]:
        return list(self._by_name)

    def _repr_html_(self) -> str:
        return notebook_page(f"{len(self)} estimates", estimates_html(self._by_name.values()))

    def __str__(self) -> str:
        return estimates_table(self._by_name.values())

    def __repr__(self) -> str:
        return f"Estimates({', '.join(map(repr, self._by_name.values()))})"


def derived(estimates: Estimates, covariance: NDArray[np.float64], expressions: Mapping[str, Expr]) -> Estimates:
    """Return estimates of expressions in parameters, with standard errors to first order; see `Fit.derived`."""
    names, values = list(estimates), estimates.to_dict()
    # Parameters that are fixed or at a bound have no error.
    held = [i for i, p in enumerate(estimates.values()) if p.fixed or p.bounds_active]
    found = []
    for name, expression in expressions.items():
        if isinstance(expression, str):
            raise ModelError(
                f"derived '{name}': '{expression}' is text: give an expression of the symbols of the model's "
                "parameters, such as a / b"
            )
        e = Expr(expression)
        for symbol in e.symbols:
            if symbol not in values:
                if own := [n for n in names if n.startswith(f"{symbol}[")]:
                    raise ModelError(
                        f"derived '{name}': '{symbol}' has a value for each experiment ({', '.join(own)}): "
                        "ask for one of them, or of fits to single experiments"
                    )
                raise ModelError(f"derived '{name}': '{symbol}' is not a parameter.{did_you_mean(symbol, names)}")
        slope = np.zeros(len(names))
        for symbol in e.symbols:
            d = e.diff(symbol)
            slope[names.index(symbol)] = d.evaluate({s: values[s] for s in d.symbols})
        free = (slope != 0) & ~np.isin(np.arange(len(names)), held)
        variance = slope[free] @ covariance[np.ix_(free, free)] @ slope[free]
        value = e.evaluate({symbol: values[symbol] for symbol in e.symbols})
        found.append(Estimate(name, value, float(np.sqrt(variance))))
    return Estimates(found)


def estimates_table(
    estimates: Iterable[Estimate], title: str = "parameter", coloured: Mapping[str, Estimate] | None = None
) -> str:
    """Return a table of name, estimate, standard error (absolute, and in % of the value), unit and remark.

    ``coloured``: by name the same with standard errors corrected for coloured residuals, a column of their own.
    """
    return text_table([title, *_HEADS], _estimates_rows(estimates, coloured), _ALIGN)


def estimates_html(estimates: Iterable[Estimate], coloured: Mapping[str, Estimate] | None = None) -> Html:
    """Return the table of `estimates_table` as HTML, for notebooks."""
    return table(["parameter", *_HEADS], _estimates_rows(estimates, coloured), _ALIGN)


_HEADS, _ALIGN = ("estimate", "std error", "in %", "corrected", "unit", "remark"), "srrrrll"


def _estimates_rows(estimates: Iterable[Estimate], coloured: Mapping[str, Estimate] | None) -> list[list[str]]:
    rows = []
    for e in estimates:
        value, std_error = _rounded(e.value, e.std_error)
        relative = 100.0 * e.relative_std_error
        percent = f"{relative:.3g}" if relative < 1000.0 else f"{relative:.1e}"
        other = coloured[e.name].std_error if coloured and e.name in coloured else math.nan
        corrected = _rounded(e.value, other)[1]
        rows.append([e.name, value, std_error, percent if math.isfinite(relative) else "", corrected, e.unit, e.remark])
    return rows


def facts_text(title: str, facts: Mapping[str, str]) -> str:
    """Return plain text of a title and of facts under it, each behind its heading."""
    width = max(map(len, facts))
    return "\n".join([title, *(f"  {heading.ljust(width)}  {text}" for heading, text in facts.items())])


def text_table(header: Sequence[str], rows: Iterable[Sequence[str]], align: str) -> str:
    """Return plain text with aligned columns under a rule; ``align`` holds r for each column of numbers, else l or s.

    A column that is empty in every row is left out.
    """
    body = [list(row) for row in rows]
    kept = [j for j in range(len(header)) if not body or any(row[j] for row in body)]
    widths = {j: max(len(row[j]) for row in [header, *body]) for j in kept}

    def line(cells: Sequence[str]) -> str:
        padded = (cells[j].rjust(widths[j]) if align[j] == "r" else cells[j].ljust(widths[j]) for j in kept)
        return "  ".join(padded).rstrip()

    rule = "  ".join("-" * widths[j] for j in kept)
    return "\n".join([line(header), rule, *map(line, body)])


def _decimals(std_error: float) -> int:
    """Return the decimals worth printing: the error keeps one digit, or two where the first is 1 or 2."""
    digits, exponent = f"{std_error:.15e}".split("e")  # log10 is not exact for the smallest numbers
    return -int(exponent) + (1 if float(digits) < 2.95 else 0)


def _rounded(value: float, std_error: float) -> tuple[str, str]:
    """Return value and standard error as text, rounded to what the error justifies; an unknown error is ""."""
    if not (math.isfinite(value) and math.isfinite(std_error) and std_error > 0.0):
        return f"{value:.6g}", "0" if std_error == 0.0 else ""
    decimals = _decimals(std_error)
    largest = max(abs(value), std_error)
    if -2 <= decimals <= 8 and largest < 1e7:
        places = max(decimals, 0)
        return f"{round(value, decimals) + 0.0:.{places}f}", f"{round(std_error, decimals):.{places}f}"
    places = min(max(decimals + math.floor(math.log10(largest)), 0), 15)
    return f"{value:.{places}e}", f"{std_error:.1e}"


def plus_minus(value: float, std_error: float) -> str:
    """Return ``0.2166 ± 0.0003``; the value alone where there is no error."""
    return " ± ".join(filter(None, _rounded(value, std_error)))


def _number(value: Any, what: str) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        raise ModelError(f"a parameter's {what} must be a number, but it is {value!r}") from None


def _pair(value: Any, what: str, meaning: str) -> tuple[float, float]:
    try:
        first, second = value
    except (TypeError, ValueError):
        raise ModelError(f"a parameter's {what} must be a pair {meaning}, but it is {value!r}") from None
    if what == "bounds" and (first is None or second is None):
        meant = f"({'-inf' if first is None else first}, {'inf' if second is None else second})"
        raise ModelError(f"a parameter's bounds ({first}, {second}) hold None; where there is no bound, write {meant}")
    pair = (_number(first, what), _number(second, what))
    if any(map(math.isnan, pair)):
        raise ModelError(f"a parameter's {what} {pair} holds NaN: give a pair {meaning}")
    return pair


def correlation_matrix(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (n, n) correlations of a covariance (n, n); NaN where a variance is NaN, infinite or not above 0.

    >>> correlation_matrix(np.array([[4.0, 0, 1], [0, np.nan, 0], [1, 0, 1]]))
    array([[1. , nan, 0.5],
           [nan, nan, nan],
           [0.5, nan, 1. ]])
    """
    variance = np.diag(covariance)
    with np.errstate(invalid="ignore"):
        deviation = np.sqrt(np.where((variance > 0.0) & np.isfinite(variance), variance, np.nan))
    return np.asarray(np.clip(covariance / np.outer(deviation, deviation), -1.0, 1.0))
