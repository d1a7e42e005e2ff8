"""``phugoid petab``: a problem in the PEtab format, estimated from many starts."""

from __future__ import annotations

import os
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated

import typer

from ..errors import EvaluationError, OptionError
from ..many_starts.multistart import multistart
from ..petab.problem import PetabProblem, read_petab
from ..solvers.newton import Newton
from .options import JsonOption
from .results import INTERRUPTED, NOT_CONVERGED, check_targets, emit_json

__all__ = ["petab"]


def petab(
    problem: Annotated[Path, typer.Argument(help="The YAML file of the problem.", metavar="PROBLEM.yaml")],
    starts: Annotated[int, typer.Option("--starts", help="Number of starts; 0 estimates from the nominal point.")] = 10,
    seed: Annotated[int, typer.Option("--seed", help="Seed of the random starts.")] = 0,
    screened_from: Annotated[
        int | None,
        typer.Option("--screened-from", help="Number of random starts to simulate, of which the best are taken."),
    ] = None,
    time_limit: Annotated[
        float | None, typer.Option("--time-limit", help="Time limit for all starts together, in s.")
    ] = None,
    time_limit_each: Annotated[
        float, typer.Option("--time-limit-each", help="Time limit for each start, in s.")
    ] = 120.0,
    jobs: Annotated[
        int | None, typer.Option("--jobs", help="Number of starts in parallel; default: number of cores.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Write the best estimate as a PEtab parameter table.")
    ] = None,
    plot: Annotated[Path | None, typer.Option("--plot", help="Write the waterfall figure.")] = None,
    *,
    json: JsonOption = False,
) -> int:
    """Estimate a problem in the PEtab format from many starts, beside its nominal point."""
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
    with ProcessPoolExecutor(processes) if processes > 1 else nullcontext() as pool:
        many = multistart(
            read.model,
            list(read.experiments),
            starts=points,
            executor=pool,
            solver=Newton(time_limit=time_limit_each),
            progress=not json,
            time_limit=time_limit,
        )
    best = many.optima[0] if many.optima else None
    written = []
    if out is not None and best is not None:
        read.write_parameters({n: v for n, v in best.parameters.items() if n in read.nominal}, out)
        written.append(out)
    if plot is not None:
        many.plot()[0].savefig(plot)
        written.append(plot)
    total = None if best is None else best.log_likelihood + read.constant
    if json:
        facts = {
            "problem": read.name,
            "nominal_log_likelihood": nominal,
            "log_likelihood": total,
            "starts": count,
            "at_best": best.count if best else 0,
            "parameters": dict(best.parameters) if best else {},
            "statuses": many.counts,
        }
        emit_json("petab", facts, written)
    else:
        print(f"{read!r}")
        print(f"nominal point: log-likelihood {'none' if nominal is None else f'{nominal:.5f}'}")
        if total is not None:
            print(f"best found: log-likelihood {total:.5f}, in {best.count if best else 0} of {count} starts")
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


def _nominal(problem: PetabProblem) -> float | None:
    """Return the log-likelihood at the nominal point; None where the solution does not exist there."""
    try:
        return problem.log_likelihood()
    except EvaluationError:
        return None
