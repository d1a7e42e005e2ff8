"""Estimates from many starts: is the optimum that was found the best there is?"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, nullcontext
from dataclasses import dataclass
from functools import cached_property
from numbers import Integral
from typing import TYPE_CHECKING, Any

import numpy as np

from .errors import EvaluationError, MissingDependency, ModelError, OptionError, PhugoidError
from .experiment import Experiment, as_experiments
from .model import Model
from .noise import KINDS, Noise
from .optima import LOG_LIKELIHOOD, PARAMETERS, Optimum, group, same
from .outcome import Outcome, Problem
from .parameters import text_table
from .result import Fit
from .shooting import MultipleShooting, SingleShooting, Transcription
from .starts import Draw, Range, given, plain, uniform
from .summary import _duration
from .transcription import Collocation
from .waterfall import plot_waterfall

if TYPE_CHECKING:
    import os
    from concurrent.futures import Executor

    import pandas
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Multistart", "multistart"]

Watch = Callable[[Outcome], None]

# A summary shows so many optima, so many of them with parameters, and so many numbers of starts that failed.
_OPTIMA, _COLUMNS, _NUMBERS = 10, 4, 12


@dataclass(frozen=True, eq=False, repr=False)
class Multistart:
    """The result of `multistart`.

    outcomes  what came of each start that is finished, in the order of their numbers.
    n         how many starts were asked for.
    status    "complete", or "interrupted" where outcomes are missing.
    warnings  what went wrong with the executor, in words.
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
        """The optima that converged outcomes reached, best first: `group` with its default tolerances."""
        return self.group()

    def group(self, log_likelihood: float = LOG_LIKELIHOOD, parameters: float = PARAMETERS) -> tuple[Optimum, ...]:
        """The optima that converged outcomes reached, best first.

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
        start that reached the highest log-likelihood; ``best.status`` tells.

        Raises EvaluationError where no start led anywhere.
        """
        if not self.optima:
            ended = [o for o in self.outcomes if np.isfinite(o.log_likelihood)]
            if not ended:
                raise EvaluationError(f"none of the {len(self.outcomes)} starts led to an estimate\n{self._failures()}")
            return self.problem.fit(max(ended, key=lambda o: o.log_likelihood).start)
        wanted = next(o for o in self.outcomes if o.index == self.optima[0].index)
        fixed = {name for name, p in self.problem.model.declared_parameters.items() if p.fixed}
        values = {name: value for name, value in wanted.parameters.items() if name not in fixed}
        try:
            fit = self.problem.fit({**wanted.start, **values})
        except PhugoidError:  # rounding has put a value outside its bounds
            return self.problem.fit(wanted.start)
        reached = Outcome(0, {}, fit.status, "", fit.log_likelihood, fit.parameters.to_dict())
        return fit if fit.converged and same(wanted, reached) else self.problem.fit(wanted.start)

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
        parts = [self._header()]
        if self.optima:
            parts += [self._optima_table(), self._parameter_table(), self._judgement()]
        if any(not o.converged for o in self.outcomes):
            parts.append(self._failures())
        return "\n\n".join(parts) + "".join(f"\n\nWarning: {w}" for w in self.warnings)

    def plot(self) -> tuple[Figure, dict[str, Axes]]:
        """The waterfall figure: how far below the best each start ended, in order; optima are plateaus.

        Returns the figure and its axes by name: ``"gap"``, and ``"not converged"`` where there are such starts.
        """
        rate = f", {100 * self.success_rate:.3g} % reached the best" if self.optima else ""
        title = f"{self.problem.model.name}: {len(self.outcomes)} starts{rate}"
        return plot_waterfall(self.outcomes, self.optima, title)

    def to_pandas(self) -> pandas.DataFrame:
        """One row a finished start, its number as index.

        Columns: optimum (from 1, NA where none was reached), status, log_likelihood, iterations, time (s), message;
        then each parameter by its name, ``std_error_<name>``, and ``start_<name>`` of what was drawn or given.
        Raises MissingDependency without pandas.
        """
        try:
            import pandas as pd
        except ImportError as error:
            raise MissingDependency(f'to_pandas needs pandas ({error}): pip install "phugoid[pandas]"') from error
        number = {index: i for i, optimum in enumerate(self.optima, 1) for index in optimum.indices}
        plain_fields = ("status", "log_likelihood", "iterations", "time", "message")
        rows = [
            {
                "optimum": number.get(o.index),
                **{name: getattr(o, name) for name in plain_fields},
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

    def _best_optima(self) -> list[Optimum]:
        return [o for o in self.optima if self.optima[0].log_likelihood - o.log_likelihood <= LOG_LIKELIHOOD]

    def _header(self) -> str:
        done, converged = len(self.outcomes), [o for o in self.outcomes if o.converged]
        entries = {"starts": f"{self.n}, all finished"}
        if self.status != "complete":
            entries["starts"] = f"{done} of {self.n} finished; the same call with the same journal goes on"
        entries["converged"] = f"{len(converged)}" + (f" ({100 * len(converged) / done:.3g} %)" if done else "")
        if converged:
            iterations = [o.iterations for o in converged]
            entries["iterations"] = f"median {np.median(iterations):g}, most {max(iterations)}"
        if done:
            times = [o.time for o in self.outcomes]
            entries["time"] = (
                f"{_duration(self.time)}; a start: median {_duration(float(np.median(times)))}, "
                f"most {_duration(max(times))}"
            )
        width = max(map(len, entries))
        lines = [f"  {key.ljust(width)}  {text}" for key, text in entries.items()]
        return "\n".join([f"{self.problem.model.name}: multistart, {self.status}", *lines])

    def _optima_table(self) -> str:
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
        header = ["optimum", "log-likelihood", "below best", "starts", "in %", "such as start"]
        rest = self.optima[_OPTIMA:]
        more = f"\nand {len(rest)} more, of {sum(o.count for o in rest)} start(s)" if rest else ""
        return text_table(header, rows, "rrrrrr") + more

    def _parameter_table(self) -> str:
        shown = self.optima[:_COLUMNS]
        units = self.problem.model.units
        header = ["parameter", "optimum 1", "std error", *(f"optimum {i + 1}" for i in range(1, len(shown))), "unit"]
        rows = []
        for name, value in shown[0].parameters.items():
            error = shown[0].std_errors[name]
            others = [f"{o.parameters[name]:.5g}" for o in shown[1:]]
            text = f"{error:.2g}" if np.isfinite(error) else ""
            rows.append([name, f"{value:.5g}", text, *others, units.get(name.removeprefix("sigma_"), "")])
        return text_table(header, rows, "lrr" + "r" * (len(shown) - 1) + "l")

    def _judgement(self) -> str:
        best, done = self._best_optima(), len(self.outcomes)
        count = sum(o.count for o in best)
        text = (
            f"{count} of {done} starts ({100 * self.success_rate:.3g} %) reached the best optimum. That it repeats is "
            "evidence that it is the global one, not proof."
        )
        if count == 1:
            text = f"1 of {done} starts reached the best optimum: there may well be a better one. Take more starts."
        if len(best) > 1:
            text += (
                f"\nIt is {len(best)} optima with the same log-likelihood: the data do not tell their parameters apart."
            )
        return text

    def _failures(self) -> str:
        lines = []
        for status, count in self.counts.items():
            if status == "converged":
                continue
            those = [o for o in self.outcomes if o.status == status]
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


def multistart(
    model: Model,
    data: Experiment | Sequence[Experiment],
    ranges: Mapping[str, Range] | None = None,
    *,
    n: int | None = None,
    seed: int = 0,
    starts: Sequence[Mapping[str, Any]] | Draw | None = None,
    executor: Executor | None = None,
    journal: str | os.PathLike[str] | None = None,
    progress: bool | Watch = False,
    transcription: Transcription | None = None,
    noise: Noise | None = None,
    start: Mapping[str, Any] | Fit | None = None,
    solver: Any = None,
) -> Multistart:
    """Estimates from many starts, to see which optima there are and how many starts reach the best one.

    ``ranges``: name -> (low, high) of parameters, of ``sigma_<output>`` and of states, in their units; each start
    draws from all of them, uniformly. A state drawn is constant in time; a standard deviation above the spread of the
    measurements starts there, as in `estimate`.
    ``n``: how many starts, 1000 by default. Start i has random numbers of its own, from ``seed`` and i: neither n,
    nor the order, nor the executor changes it.
    ``starts``: instead of ranges, the starts themselves, name -> value each (all of them unless ``n`` says fewer), or
    a function (i, random) -> start, of the start's number and its own `numpy.random.Generator`.
    ``start``: values for all starts, of what they do not give themselves; as in `estimate`, but of a fit only the
    parameters.
    ``transcription``, ``noise``, ``solver``: as in `estimate`, but that the default solver makes no regression on
    the measured states first: it would lead all starts of a model linear in its parameters to one point.
    ``executor``: None runs in this process. Otherwise any `concurrent.futures.Executor`, such as a
    ProcessPoolExecutor, or ``client.get_executor()`` of a Dask client; a start runs on one thread there, unless
    the transcription says how many. Take processes rather than threads: Python's lock is held for part of the work.
    ``journal``: a file to which each finished start is written. The same call with the same journal runs only what
    is missing (also after ``n`` was raised). One run at a time.
    ``progress``: True shows a bar; a function is called with each `Outcome` as it comes in.

    What goes wrong in a run is an outcome, not an error of the whole. If a worker dies, its starts run again, in a
    fresh pool where the old one is broken, or in this process where there can be none (a warning of the result says
    so). A start that loses its worker time and again (three times in a pool), at last running alone, is given up with
    status "killed".
    Ctrl-C returns the outcomes so far, with status "interrupted"; runs under way in an executor are not waited for.

    Raises ModelError, DataError or OptionError for what cannot be right, whatever the start, and DataError for a
    journal of another problem.

    >>> m = Model("known by its square")
    >>> (x,) = m.states("x")
    >>> (a,) = m.parameters("a")
    >>> m.dynamics(x=1 - x)
    >>> m.outputs(y=a**2 * x)
    >>> t = np.linspace(0, 5, 30)
    >>> e = Experiment(t, outputs={"y": 4 * (1 - np.exp(-t)) + 0.01 * np.sin(40 * t)})
    >>> result = multistart(m, e, {"a": (-5, 5)}, n=8)
    >>> sorted(round(o.parameters["a"]) for o in result.optima)
    [-2, 2]
    """
    from .journal import Journal
    from .workers import Crew

    begin = time.perf_counter()
    problem = _problem(model, data, transcription, noise, start, solver)
    if n is not None and not _whole(n, 1):
        raise OptionError(f"multistart: n is a whole number from 1, not {n!r}")
    if not _whole(seed, 0):
        raise OptionError(f"multistart: seed is a whole number from 0, not {seed!r}")
    if not isinstance(progress, bool) and not callable(progress):
        raise OptionError(f"multistart: progress is True, False or a function, not {progress!r}")
    if (ranges is None) == (starts is None):
        raise OptionError("multistart: give either ranges to draw from, or starts")
    if starts is None:
        total = 1000 if n is None else int(n)
        plan: Any = uniform(problem, ranges, int(seed))
    else:
        plan = given(problem, starts, n, int(seed))
        total = len(plan.starts)

    crew = Crew(executor, problem)
    with nullcontext() if journal is None else closing(Journal(journal, problem, plan)) as book:
        known = book.outcomes if book else {}
        done = {index: outcome for index, outcome in known.items() if index < total}
        missing = ((i, plan(i)) for i in range(total) if i not in known)
        with (
            _watching(progress, problem.model.name, total, tuple(done.values())) as watch,
            closing(crew.outcomes(missing)) as coming,
        ):
            try:
                for outcome in coming:
                    if book:
                        book.append(outcome)
                    done[outcome.index] = outcome
                    watch(outcome)
            except KeyboardInterrupt:
                pass
    return Multistart(
        outcomes=tuple(done[i] for i in sorted(done)),
        n=total,
        status="complete" if len(done) == total else "interrupted",
        problem=problem,
        warnings=crew.warnings,
        time=time.perf_counter() - begin,
    )


def _problem(model: Any, data: Any, transcription: Any, noise: Any, start: Any, solver: Any) -> Problem:
    """What all starts share, as far as it can be checked before the first run."""
    if not isinstance(model, Model):
        raise ModelError(f"multistart: the first argument is a Model, not a {type(model).__name__}")
    model.check()
    experiments = tuple(as_experiments(data, "estimate"))
    transcription = transcription or Collocation()
    if not isinstance(transcription, (Collocation, MultipleShooting, SingleShooting)):
        raise OptionError(
            f"multistart: transcription is a Collocation, MultipleShooting or SingleShooting, not {transcription!r}"
        )
    noise = noise or model.noise_model
    if not isinstance(noise, Noise):
        raise OptionError(f"multistart: noise is {KINDS}, not {noise!r}")
    if not isinstance(start, (Mapping, Fit, type(None))):
        raise OptionError(f"multistart: start holds values by name, or is a fit, not {start!r}")
    common = start.as_start() if isinstance(start, Fit) else start or {}
    return Problem(model, experiments, transcription, noise, solver, {n: plain(v) for n, v in common.items()})


@contextmanager
def _watching(progress: bool | Watch, title: str, total: int, done: Sequence[Outcome]) -> Iterator[Watch]:
    """What to call with each outcome: nothing, our bar, or the user's own function."""
    if callable(progress):
        yield progress
        return
    if not progress:
        yield lambda outcome: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    best = [o.log_likelihood for o in done if o.converged]
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, TextColumn("{task.fields[best]}"), console=Console(stderr=True)) as bar:
        task = bar.add_task(title, total=total, completed=len(done), best="")

        def advance(outcome: Outcome) -> None:
            if outcome.converged:
                best[:] = [max([*best, outcome.log_likelihood])]
            bar.update(task, advance=1, best=f"best logL {best[0]:.3f}" if best else "")

        yield advance


def _whole(value: Any, least: int) -> bool:
    return isinstance(value, Integral) and not isinstance(value, bool) and int(value) >= least
