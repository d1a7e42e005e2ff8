"""Which terms of regression equations the data support: the options, and the result as a table and a figure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

from ..errors import OptionError, did_you_mean, is_whole, listing
from ..figures import MEASURED, MODEL, RULE, STATE, WIDTH, Panels, plain, styled
from ..notebook import notebook_page, paragraph, table
from ..parameters import text_table
from .subsets import SubsetStatistics

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["SelectedTerms", "SelectionStep", "TermSelection", "check_keep", "reason", "selection_options"]

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
    """One subset of the terms on the way of a selection.

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
        """Plot what is left in error against the steps, on the data, by PRESS, by PSE and on held-out data.

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


def reason(criterion: Criterion | None, f_in: float, f_out: float, corrected: bool) -> str:
    """Return what decided a selection, in words."""
    if criterion is not None:
        return f"by the least {_CALLED[criterion].removeprefix('the ')}"
    leave = "" if f_out == f_in else f", {f_out:.3g} to leave"
    return f"by a partial F of {f_in:.3g} to enter{leave}{', corrected for coloured residuals' if corrected else ''}"
