"""``phugoid petab``: a problem in the PEtab format, estimated from many starts."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Mapping
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated

import typer

from ..errors import EvaluationError, OptionError
from ..estimation.starts import Outcome
from ..many_starts.multistart import Multistart, multistart
from ..petab.problem import PetabProblem, read_petab
from ..solvers.newton import Newton
from .options import JsonOption
from .results import INTERRUPTED, NOT_CONVERGED, check_targets, emit_json

__all__ = ["petab"]

# How often steady states are made longer, and the difference of log-likelihoods that is reported.
_LENGTHENED = 3
_DIFFERENT = 0.1


def petab(
    problem: Annotated[Path, typer.Argument(help="The YAML file of the problem.", metavar="PROBLEM.yaml")],
    starts: Annotated[
        int, typer.Option("--starts", help="Number of starts; 0 estimates from the nominal point.", metavar="N")
    ] = 10,
    seed: Annotated[int, typer.Option("--seed", help="Seed of the random starts.", metavar="N")] = 0,
    screened_from: Annotated[
        int | None,
        typer.Option(
            "--screened-from", help="Number of random starts to simulate, of which the best are taken.", metavar="N"
        ),
    ] = None,
    time_limit: Annotated[
        float | None, typer.Option("--time-limit", help="Time limit for all starts together, in s.", metavar="S")
    ] = None,
    time_limit_each: Annotated[
        float, typer.Option("--time-limit-each", help="Time limit for each start, in s.", metavar="S")
    ] = 120.0,
    jobs: Annotated[
        int | None, typer.Option("--jobs", help="Number of starts in parallel; default: number of cores.", metavar="N")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Write the best estimate as a PEtab parameter table.", metavar="FILE")
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            "--plot", help="Write the waterfall figure: how far below the best each start ended.", metavar="FILE"
        ),
    ] = None,
    *,
    json: JsonOption = False,
) -> int:
    """Estimate a problem in the PEtab format from many starts.

    The best optimum is compared with the log-likelihood at the nominal point.
    """
    if starts < 0:
        raise OptionError(f"--starts: a whole number from 0, not {starts}")
    if jobs is not None and jobs < 1:
        raise OptionError(f"--jobs: a whole number from 1, not {jobs}")
    check_targets([plot], [out])
    read = read_petab(problem)
    nominal = _nominal(read)
    count = max(starts, 1)
    points = read.starts(starts, seed=seed, screened_from=screened_from) if starts else [dict(read.nominal)]
    processes = min((os.cpu_count() or 1) if jobs is None else jobs, count)
    began = time.monotonic()

    def run(problem: PetabProblem, starts: list[dict[str, float]], pool: Executor | None) -> Multistart:
        return multistart(
            problem.model,
            list(problem.experiments),
            starts=starts,
            executor=pool,
            solver=Newton(time_limit=time_limit_each),
            progress=not json,
            time_limit=None if time_limit is None else max(time_limit - (time.monotonic() - began), 0.0),
        )

    with ProcessPoolExecutor(processes) if processes > 1 else nullcontext() as pool:
        many = run(read, points, pool)
        for _ in range(_LENGTHENED):
            longer = _at_rest(read, many)
            if longer is read:
                break
            # Steady states that were too short: from where the starts ended, with longer ones.
            read = longer
            points = [
                {n: v for n, v in o.parameters.items() if n in read.nominal} or dict(o.start) for o in many.outcomes
            ]
            many = run(read, points, pool)
    best = many.optima[0] if many.optima else None
    reached = max((o for o in many.outcomes if math.isfinite(o.log_likelihood)), key=_likelihood, default=None)
    written = []
    if out is not None and best is not None:
        read.write_parameters({n: v for n, v in best.parameters.items() if n in read.nominal}, out)
        written.append(out)
    if plot is not None:
        many.plot()[0].savefig(plot)
        written.append(plot)
    total = None if best is None else best.log_likelihood + read.constant
    integrated = None if best is None else _integrated(read, best.parameters)
    if json:
        facts = {
            "problem": read.name,
            "nominal_log_likelihood": nominal,
            "log_likelihood": total,
            "integrated_log_likelihood": integrated,
            "starts": count,
            "at_best": best.count if best else 0,
            "parameters": dict(best.parameters) if best else {},
            "statuses": many.counts,
            "finished": len(many.outcomes),
            "status": many.status,
        }
        emit_json("petab", facts, written)
    else:
        print(f"{read!r}")
        print(f"nominal point: log-likelihood {'none' if nominal is None else f'{nominal:.5f}'}")
        if total is not None:
            print(
                f"best found: log-likelihood {total:.5f}, in {best.count if best else 0} of {len(many.outcomes)} starts"
            )
        elif reached is not None:
            value = reached.log_likelihood + read.constant
            print(f"no start ended at an optimum; the best point that was reached has log-likelihood {value:.5f}")
        if total is not None and (integrated is None or abs(integrated - total) > _DIFFERENT):
            found = "cannot be integrated" if integrated is None else f"has the log-likelihood {integrated:.5f}"
            print(f"The model integrated with the best estimate {found}: the path is not a solution of the model.")
        if total is not None and nominal is not None and total < nominal - 0.1:
            print("The nominal point is better than all that was found: take more starts.")
        print(f"\n{many.summary()}")
        if read.constant:
            print(f"\nLog-likelihoods of the starts are without the constant of the problem, {read.constant:.5f}.")
        for path in written:
            print(f"\nWritten: {path}")
    if many.status == "interrupted":
        return INTERRUPTED
    return 0 if best is not None else NOT_CONVERGED


def _likelihood(outcome: Outcome) -> float:
    return outcome.log_likelihood


def _at_rest(problem: PetabProblem, many: Multistart) -> PetabProblem:
    """Return the problem with steady states that are long enough for the best estimate; the same where they are."""
    try:
        return problem.at_rest(many.optima[0].parameters) if many.optima else problem
    except EvaluationError:
        return problem


def _integrated(problem: PetabProblem, values: Mapping[str, float]) -> float | None:
    """Return the log-likelihood of the problem integrated with estimates; None where that cannot be."""
    try:
        return problem.log_likelihood({n: v for n, v in values.items() if n in problem.nominal})
    except EvaluationError:
        return None


def _nominal(problem: PetabProblem) -> float | None:
    """Return the log-likelihood at the nominal point; None where the solution does not exist there."""
    try:
        return problem.log_likelihood()
    except EvaluationError:
        return None
