"""The result of many starts: their outcomes, grouped by the optimum that they reached, with remarks on local ones."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ..errors import EvaluationError, OptionError, PhugoidError
from ..estimation.starts import Outcome, Problem
from ..fit_result import FitResult
from ..notebook import Rows, bullets, overview
from ..parameters import Parameter, facts_text, text_table
from ..result import Fit
from ..summary import _duration
from ..tabular import package
from .optima import LOG_LIKELIHOOD, PARAMETERS, Optimum, group, plot_waterfall, same

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "Multistart",
    "at_bounds",
    "below_best",
    "local_optima",
]


# Statuses of runs that ended before their end.
_CUT = ("time limit", "iteration limit", "interrupted")
# A summary shows so many optima, so many of them with parameters, and so many numbers of starts that failed.
_OPTIMA, _COLUMNS, _NUMBERS = 10, 4, 12


def _of_all(count: int, done: int) -> str:
    return f"{count}" + (f" ({100 * count / done:.3g} %)" if done else "")


@dataclass(frozen=True, eq=False, repr=False)
class Multistart:
    """The result of `multistart`.

    outcomes  what came of each start that is finished, in the order of their numbers.
    n         how many starts were asked for.
    status    "complete", or "interrupted" or "time limit" where outcomes are missing.
    warnings  what went wrong with the executor or the journal, in words.
    time      s, of the call; what a journal held already took none.
    problem   what all starts share.
    """

    outcomes: tuple[Outcome, ...]
    n: int
    status: str
    problem: Problem
    warnings: tuple[str, ...] = ()
    time: float = 0.0

    @cached_property
    def optima(self) -> tuple[Optimum, ...]:
        """The optima that outcomes reached, best first: `group` with its default tolerances."""
        return self.group()

    def group(self, log_likelihood: float = LOG_LIKELIHOOD, parameters: float = PARAMETERS) -> tuple[Optimum, ...]:
        """Return the optima that outcomes reached, best first.

        An outcome counts where it converged, where the data leave directions undetermined ("unidentifiable"), and where
        only rounding kept it from its tolerances ("acceptable").
        Two outcomes are the same optimum where their log-likelihoods differ by no more than ``log_likelihood``, and
        each parameter by no more than ``parameters`` standard errors; one without standard error (it is at a bound,
        or cannot be identified) by no more than that part of its value.
        """
        return group(self.outcomes, log_likelihood, parameters)

    @cached_property
    def best(self) -> Fit:
        """The fit at the best optimum, with states, outputs and residuals.

        Outcomes are kept without time histories, so it is solved again when first asked for: from the values of the
        best outcome, and where this leads elsewhere, from its start. Where no start converged, it is the fit from the
        start that reached the highest log-likelihood, or from the first where none ended at a solution of the
        equations; see ``best.status``. Its warnings say where other starts ended at local optima.

        Raises EvaluationError where no start led anywhere.
        """
        fit = self._solved_again()
        remarks = filter(None, [local_optima(self.optima, len(self.outcomes)), self._above(), self._missing()])
        return Fit._of(replace(fit, warnings=(*fit.warnings, *remarks)))

    def fit(self, index: int) -> Fit:
        """Return the fit from one start, solved again, with states, outputs and residuals.

        Where it ends at an optimum below the best one known, its warnings say that the optimum is local; where another
        start was cut above the best one, they say that.
        Raises OptionError for a number of no finished start.
        """
        outcome = next((o for o in self.outcomes if o.index == index), None)
        if outcome is None:
            raise OptionError(f"fit: start {index!r} is none of the {len(self.outcomes)} finished starts")
        fit = self.problem.fit(outcome.start)
        reached = replace(outcome, status=fit.status, log_likelihood=fit.ranked_log_likelihood)
        return Fit._of(replace(fit, warnings=(*fit.warnings, *filter(None, [self._remark(reached)]))))

    def _solved_again(self) -> FitResult:
        if not self.optima:
            ended = [o for o in self.outcomes if o.parameters]
            if not ended:
                raise EvaluationError(f"none of the {len(self.outcomes)} starts led to an estimate\n{self._failures()}")
            return self.problem.fit(max(ended, key=lambda o: float(np.nan_to_num(o.log_likelihood, nan=-np.inf))).start)
        wanted = next(o for o in self.outcomes if o.index == self.optima[0].index)
        fixed = {name for name, p in self.problem.model.declared_parameters.items() if p.fixed}
        values = {name: value for name, value in wanted.parameters.items() if name not in fixed}
        try:
            fit = self.problem.fit({**wanted.start, **values})
        except PhugoidError:  # rounding has put a value outside its bounds
            return self.problem.fit(wanted.start)
        reached = Outcome(0, {}, fit.status, "", fit.ranked_log_likelihood, fit.parameters.to_dict())
        return fit if reached.at_optimum and same(wanted, reached) else self.problem.fit(wanted.start)

    def _above(self) -> str:
        """Return which starts were cut at a higher log-likelihood than that of the best optimum; "" where none was."""
        if not self.optima:
            return ""
        gain = {
            o.index: o.log_likelihood - self.optima[0].log_likelihood
            for o in self.outcomes
            if o.status in _CUT and o.log_likelihood > self.optima[0].log_likelihood + LOG_LIKELIHOOD
        }
        if not gain:
            return ""
        most = max(gain, key=lambda index: gain[index])
        number = "1 start was" if len(gain) == 1 else f"{len(gain)} starts were"
        return (
            f"{number} cut at a log-likelihood above that of the best optimum, start {most} by {gain[most]:.4g}: there "
            "is a better optimum; allow each start more time"
        )

    def _missing(self) -> str:
        """Return what is missing where the time limit or the user ended the run; "" where nothing is."""
        if self.status == "complete":
            return ""
        by = "the time limit" if self.status == "time limit" else "the user"
        done = len(self.outcomes)
        return f"{by} ended the multistart after {done} of {self.n} starts: the others may lead to better optima"

    @property
    def success_rate(self) -> float:
        """Which part of the finished starts reached the best log-likelihood, 0 to 1; NaN where none is finished.

        Where several optima have it, all count.
        """
        return sum(o.count for o in self._best_optima()) / len(self.outcomes) if self.outcomes else float("nan")

    @property
    def counts(self) -> dict[str, int]:
        """Status -> how many finished starts have it, the commonest first."""
        return dict(Counter(o.status for o in self.outcomes).most_common())

    def summary(self) -> str:
        """Plain text: which optima there are, how many starts reached them, and which starts failed how."""
        parts = [facts_text(f"{self.problem.model.name}: multistart, {self.status}", self._entries())]
        if self.optima:
            more = self._more_optima()
            parts.append(text_table(*self._optima_rows()) + (f"\n{more}" if more else ""))
            parts += [text_table(*self._parameter_rows()), "\n".join(self._judgement())]
        if any(not o.at_optimum for o in self.outcomes):
            parts.append(self._failures())
        return "\n\n".join(parts) + "".join(f"\n\nWarning: {w}" for w in self.warnings)

    def plot(self) -> tuple[Figure, dict[str, Axes]]:
        """Draw the waterfall figure: how far below the best each start ended, in order; optima are plateaus.

        Returns the figure and its axes by name: ``"gap"``, and ``"not converged"`` where there are such starts.
        """
        rate = f", {100 * self.success_rate:.3g} % reached the best" if self.optima else ""
        title = f"{self.problem.model.name}: {len(self.outcomes)} starts{rate}"
        return plot_waterfall(self.outcomes, self.optima, title)

    def to_pandas(self) -> pandas.DataFrame:
        """Return a table with one row a finished start, its number as index.

        Columns: optimum (from 1, NA where none was reached), status, log_likelihood, iterations, time (s), message
        (with a remark where the optimum is below the best one known);
        then each parameter by its name, ``std_error_<name>``, and ``start_<name>`` of what was drawn or given.
        Raises MissingDependency without pandas.
        """
        pd = package("pandas", "to_pandas")
        number = {index: i for i, optimum in enumerate(self.optima, 1) for index in optimum.indices}
        plain_fields = ("status", "log_likelihood", "iterations", "time", "message")
        rows = [
            {
                "optimum": number.get(o.index),
                **{name: getattr(o, name) for name in plain_fields},
                "message": self._message(o),
                **o.parameters,
                **{f"std_error_{name}": value for name, value in o.std_errors.items()},
                **{f"start_{name}": value for name, value in o.start.items()},
            }
            for o in self.outcomes
        ]
        frame = pd.DataFrame(rows, index=pd.Index([o.index for o in self.outcomes], name="start"))
        # Where the first starts failed, their parameters would stand last.
        names = ["optimum", *plain_fields]
        for prefix, key in (("", "parameters"), ("std_error_", "std_errors"), ("start_", "start")):
            names += dict.fromkeys(f"{prefix}{name}" for o in self.outcomes for name in getattr(o, key))
        return frame.reindex(columns=names).astype({"optimum": "Int64"})

    def _message(self, outcome: Outcome) -> str:
        return "; ".join(filter(None, [outcome.message, self._remark(outcome)]))

    def _remark(self, outcome: Outcome) -> str:
        """Return what to say of an end at an optimum where a better one is known, or where a start was cut above it."""
        below = below_best(outcome, self.optima, len(self.outcomes))
        return below or (self._above() if outcome.at_optimum else "")

    def _best_optima(self) -> list[Optimum]:
        return [o for o in self.optima if self.optima[0].log_likelihood - o.log_likelihood <= LOG_LIKELIHOOD]

    def _repr_html_(self) -> str:
        tables = [self._optima_rows(), self._parameter_rows()] if self.optima else []
        failed = self._failures().splitlines() if any(not o.at_optimum for o in self.outcomes) else []
        return overview(
            f"{self.problem.model.name}: multistart",
            bullets(f"{name}: {text}" for name, text in self._entries().items()),
            *tables,
            remarks=[*filter(None, [self._more_optima()]), *self._judgement(), *failed, *self.warnings],
            note=self.status,
        )

    def _entries(self) -> dict[str, str]:
        """Return the facts of the starts, by heading."""
        done, converged = len(self.outcomes), [o for o in self.outcomes if o.converged]
        ended = [o for o in self.outcomes if o.at_optimum]
        entries = {"starts": f"{self.n}, all finished"}
        if self.status != "complete":
            entries["starts"] = f"{done} of {self.n} finished; the same call with the same journal goes on"
        entries["converged"] = _of_all(len(converged), done)
        if len(ended) > len(converged):
            entries["at an optimum"] = (
                f"{_of_all(len(ended), done)}, with those where the data do not determine all parameters"
            )
        if ended:
            iterations = [o.iterations for o in ended]
            entries["iterations"] = f"median {np.median(iterations):g}, most {max(iterations)}"
        if done:
            times = [o.time for o in self.outcomes]
            entries["time"] = (
                f"{_duration(self.time)}; a start: median {_duration(float(np.median(times)))}, "
                f"most {_duration(max(times))}"
            )
        return entries

    def _optima_rows(self) -> Rows:
        best, done = self.optima[0].log_likelihood, len(self.outcomes)
        rows = [
            [
                str(i),
                f"{o.log_likelihood:.3f}",
                f"{best - o.log_likelihood:.3f}",
                str(o.count),
                f"{100 * o.count / done:.1f}",
                str(o.index),
            ]
            for i, o in enumerate(self.optima[:_OPTIMA], 1)
        ]
        header = ["optimum", "log-likelihood", "below best", "starts", "in %", "first start"]
        return header, rows, "rrrrrr"

    def _more_optima(self) -> str:
        rest = self.optima[_OPTIMA:]
        return f"and {len(rest)} more, of {sum(o.count for o in rest)} start(s)" if rest else ""

    def _parameter_rows(self) -> Rows:
        shown = self.optima[:_COLUMNS]
        units = self.problem.model.units
        header = ["parameter", "optimum 1", "std error", *(f"optimum {i + 1}" for i in range(1, len(shown))), "unit"]
        rows = []
        for name, value in shown[0].parameters.items():
            error = shown[0].std_errors[name]
            others = [f"{o.parameters[name]:.5g}" for o in shown[1:]]
            text = f"{error:.2g}" if np.isfinite(error) else ""
            rows.append([name, f"{value:.5g}", text, *others, units.get(name.removeprefix("sigma_"), "")])
        return header, rows, "srr" + "r" * (len(shown) - 1) + "l"

    def _judgement(self) -> list[str]:
        """Return what follows of the optima, in sentences."""
        if not self.optima:
            return []
        best, done = self._best_optima(), len(self.outcomes)
        count = sum(o.count for o in best)
        text = (
            f"{count} of {done} starts ({100 * self.success_rate:.3g} %) reached the best optimum. That it repeats is "
            "evidence that it is the global one, not proof."
        )
        if count == 1:
            text = f"1 of {done} starts reached the best optimum: there may well be a better one. Take more starts."
        if done == 1:
            text = "One start does not show whether there are other optima."
        said = [text]
        first = next(o for o in self.outcomes if o.index == self.optima[0].indices[0])
        if not first.converged:
            said.append(f"Optimum 1: {first.message}.")
        if len(best) > 1:
            said.append(
                f"It is {len(best)} optima with the same log-likelihood: the data do not distinguish their parameters."
            )
        said += [f"{text[0].upper()}{text[1:]}." for text in (self._above(), self._missing()) if text]
        others = local_optima(self.optima, done)
        bounds = at_bounds(self.optima[0].parameters, self.problem.model.declared_parameters)
        said += [f"{others}."] if others else []
        return [*said, f"At bounds in optimum 1: {bounds}."] if bounds else said

    def _failures(self) -> str:
        lines = []
        for status, count in self.counts.items():
            those = [o for o in self.outcomes if o.status == status and not o.at_optimum]
            if not those:
                continue
            numbers = ", ".join(str(o.index) for o in those[:_NUMBERS]) + (", ..." if count > _NUMBERS else "")
            lines.append(f"{status}: {count} start(s), number {numbers}\n  the first: {those[0].message}")
        return "\n".join(lines)

    def __repr__(self) -> str:
        return (
            f"<Multistart of '{self.problem.model.name}': {self.status}, {len(self.outcomes)} of {self.n} starts, "
            f"{len(self.optima)} optima, {100 * self.success_rate:.3g} % reached the best>"
        )

    def __str__(self) -> str:
        return self.summary()


# A value is at a bound within this part of its size, as for a single fit.
_THERE = 1e-6


def below_best(outcome: Outcome, optima: Sequence[Optimum], starts: int) -> str:
    """Return what to say of an end at an optimum that is not the best one known; "" for all other ends."""
    if not optima or not outcome.at_optimum:
        return ""
    gap = optima[0].log_likelihood - outcome.log_likelihood
    if gap <= LOG_LIKELIHOOD:
        return ""
    count = sum(o.count for o in optima if optima[0].log_likelihood - o.log_likelihood <= LOG_LIKELIHOOD)
    return (
        f"this optimum is local: {count} of {starts} starts reached one whose log-likelihood is higher by {gap:.4g}, "
        f"such as start {optima[0].index}"
    )


def local_optima(optima: Sequence[Optimum], starts: int) -> str:
    """Return how many optima below the best one the starts reached, and with what share; "" where there is none."""
    others = [o for o in optima if optima[0].log_likelihood - o.log_likelihood > LOG_LIKELIHOOD]
    if not others:
        return ""
    count = sum(o.count for o in others)
    gap = optima[0].log_likelihood - others[0].log_likelihood
    are = "local optimum is" if len(others) == 1 else "local optima are"
    return (
        f"{len(others)} other {are} known, where {count} of {starts} starts ({100 * count / starts:.3g} %) ended; "
        f"log-likelihood lower by {gap:.4g}{'' if len(others) == 1 else ' or more'}"
    )


def at_bounds(values: Mapping[str, float], declared: Mapping[str, Parameter]) -> str:
    """Return all parameters whose values are at a bound, each with the bound; "" where there is none."""
    found = []
    for name, value in values.items():
        parameter = declared.get(name)
        if parameter is None or parameter.fixed:
            continue
        for side, bound in zip(("lower", "upper"), parameter.bounds, strict=True):
            if math.isfinite(bound) and abs(value - bound) <= _THERE * max(abs(value), abs(bound)):
                found.append(f"{name} ({side})")
    return ", ".join(found)
