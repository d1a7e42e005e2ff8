"""Estimates from many starts: is the optimum that was found the best there is?"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import closing, nullcontext
from typing import TYPE_CHECKING, Any

from ..data.experiment import Experiment, as_experiments, completed
from ..errors import ModelError, OptionError, check_progress, whole
from ..estimation.collect import Watch, collect
from ..estimation.starts import Draw, Problem, Range, given, plain, uniform
from ..fit_result import FitResult
from ..modelling.model import Model
from ..modelling.noise import Noise, not_noise
from ..solvers.solution import limited
from ..transcription import Collocation, MultipleShooting, SingleShooting, Transcription
from .result import Multistart

if TYPE_CHECKING:
    import os
    from concurrent.futures import Executor


__all__ = ["Multistart", "multistart"]


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
    start: Mapping[str, Any] | FitResult | None = None,
    solver: Any = None,
    time_limit: float | None = None,
) -> Multistart:
    """Estimates from many starts, to see which optima there are and how many starts reach the best one.

    ``ranges``: name -> (low, high) of parameters, of ``sigma_<output>`` and of states, in their units; each start
    draws from all of them, uniformly; of a parameter with ``transform="log"`` it draws the logarithm. A state drawn is
    constant in time; a standard deviation above the spread of the measurements starts there, as in `estimate`.
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
    is missing (also after ``n`` was raised). One run at a time. Where it can no longer be written, as on a full disk,
    the run goes on without it, and a warning of the result says so.
    ``progress``: True shows a bar; a function is called with each `Outcome` as it comes in.
    ``time_limit``: in seconds, of all starts together; that of a ``solver`` is of each.

    What goes wrong in a run is an outcome, not an error of the whole. If a worker dies, its starts run again, in a
    fresh pool where the old one is broken, or in this process where there can be none (a warning of the result says
    so). A start that loses its worker time and again (three times in a pool), at last running alone, is given up with
    status "killed".
    Ctrl-C returns the outcomes so far, with status "interrupted", and the time limit with status "time limit"; runs
    under way in an executor are not waited for.

    Raises ModelError, DataError or OptionError for what cannot be right, whatever the start, and DataError for a
    journal of another problem.

    >>> import numpy as np
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
    from ..estimation.workers import Crew
    from .journal import Journal

    begin = time.perf_counter()
    deadline = limited("multistart", time_limit)
    problem = _problem(model, data, transcription, noise, start, solver)
    if n is not None:
        whole("multistart: n", n, 1)
    whole("multistart: seed", seed, 0)
    check_progress("multistart", progress)
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
        keep = book.append if book else None
        with deadline.in_force():
            found = collect(crew, missing, progress, problem.model.name, total, known=done, keep=keep, best=True)
    return Multistart(
        outcomes=tuple(found.values()),
        n=total,
        status="complete" if len(found) == total else deadline.ended(),
        problem=problem,
        warnings=crew.warnings + (book.warnings if book else ()),
        time=time.perf_counter() - begin,
    )


def _problem(model: Any, data: Any, transcription: Any, noise: Any, start: Any, solver: Any) -> Problem:
    """Return what all starts share, as far as it can be checked before the first run."""
    if not isinstance(model, Model):
        raise ModelError(f"multistart: the first argument is a Model, not a {type(model).__name__}")
    model.check()
    experiments = tuple(completed(as_experiments(data, "estimate"), model.output_names))
    transcription = transcription or Collocation()
    if not isinstance(transcription, (Collocation, MultipleShooting, SingleShooting)):
        raise OptionError(
            f"multistart: transcription is a Collocation, MultipleShooting or SingleShooting, not {transcription!r}"
        )
    noise = noise or model.noise_model
    if not isinstance(noise, Noise):
        raise OptionError(f"multistart: {not_noise(noise)}")
    if not isinstance(start, (Mapping, FitResult, type(None))):
        raise OptionError(f"multistart: start holds values by name, or is a fit, not {start!r}")
    common = start.as_start() if isinstance(start, FitResult) else start or {}
    return Problem(model, experiments, transcription, noise, solver, {n: plain(v) for n, v in common.items()})
