"""How often `ph.diagnose` finds what was hidden, how often it sees what is not there, and how long it takes.

Cases are drawn by tests/hidden, which knows nothing of the method: data of a system with one or two effects that its
model has not, or with none, white or coloured noise, each effect so strong that it is expected to gain 60 (weak), 250
(medium) or 1,000 (strong) in 2 log L. Each is fitted and diagnosed with a second manoeuvre as held-out data.

An effect is found where its name is the cause of a finding or among its aliases, of at most four names together.

    python benchmarks/discrepancy.py --n 200 --seed 0 --processes 2 --list
    python benchmarks/discrepancy.py --only 17
    python benchmarks/discrepancy.py --n 40 --leave-out --nothing 0 --doubles 0
    python benchmarks/discrepancy.py --n 20 --rates
    python benchmarks/discrepancy.py --n 100 --promised

With --leave-out the library lacks the families of candidates that a case's effects belong to: whatever is named then is
not what was hidden. Where it explains as much of the held-out record in free simulation as what was hidden does, each
within the interval of the other, it acts alike, and is counted apart.

With --rates each case is diagnosed three times: with all samples of the outputs, with every second and every fourth;
what is said should be the same.

With --promised a third record of each case is simulated: what a named cause explains of it should lie in the interval
that its finding gives for another record, within 0.01.

Draws depend on --systems, --strengths, --noise, --doubles and --nothing too: give them again with --only, or make the
case by the call that --list prints. Writes nothing.
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # processes share the cores

from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import partial
from multiprocessing import get_context

from discrepancy_scores import (
    accuracy,
    alike,
    at_rates,
    costs,
    diagnosed,
    hidden,
    honesty,
    outside,
    promises,
    recall,
    share,
)
from rich.markup import escape
from rich.progress import MofNCompleteColumn, Progress, TimeElapsedColumn, TimeRemainingColumn
from tables import console, show

GROUPS = {
    "strength": lambda o, effect: f"{len(o.truth)} hidden, {o.strength}",
    "system": lambda o, effect: o.system,
    "noise": lambda o, effect: o.noise,
    "kind": lambda o, effect: o.truth[effect],
}


def outcomes(seeds, processes, work):
    """Yield what ``work`` makes of each seed, as they come."""
    if processes == 1:
        yield from map(work, seeds)
        return
    # Fresh processes: threads of the numerical core do not live through a fork.
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as executor:
        jobs = [executor.submit(work, seed) for seed in seeds]
        try:
            for job in as_completed(jobs):
                yield job.result()
        except BaseException:
            executor.shutdown(wait=False, cancel_futures=True)
            raise


def run(n=200, seed=0, processes=2, only=(), listed=False, leave_out=False, rates=False, **choice):
    """Measure and print."""
    seeds = list(only) or range(seed, seed + n)
    work = partial(at_rates, choice=choice) if rates else partial(diagnosed, choice=choice, leave_out=leave_out)
    groups = []
    columns = (*Progress.get_default_columns()[:2], MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    try:
        with Progress(*columns, "{task.fields[failed]} failed", console=console, transient=True) as progress:
            task = progress.add_task("cases", total=len(seeds), failed=0)
            for found in outcomes(seeds, processes, work):
                groups.append(found if rates else (found,))
                progress.update(task, advance=1, failed=sum(group[0].failed for group in groups))
                for outcome in groups[-1] if only else ():
                    progress.console.print(escape(str(outcome)))
    except KeyboardInterrupt:
        console.print(f"interrupted after {len(groups)} of {len(seeds)} cases")
    groups.sort(key=lambda group: group[0].seed)
    done = [group[0] for group in groups]
    report(done, leave_out)
    made = [group for group in groups if not any(o.error for o in group)]
    if rates and made:
        show("The same at full, half and quarter rate", ["", "share"], alike(made))
        different = [group for group in made if len({(o.verdict, str(o)) for o in group}) > 1]
        for outcome in [o for group in different for o in group] if listed else ():
            console.print(escape(f"{outcome.verdict}: {outcome}"), soft_wrap=True)
    if listed:
        failed = done if leave_out else [o for o in done if o.failed]
        console.print(f"{'All' if leave_out else 'Failed'}: {len(failed) or 'none'}")
        for o in failed:
            console.print(escape(str(o)), soft_wrap=True)


def report(done, leave_out=False):
    """Tables of the counts."""
    # A case in which something was raised counts as one in which nothing was found.
    tried = [o for o in done if not o.error.startswith("not made")]
    if leave_out:
        for title in ("strength", "kind"):
            heads = [title, "cases", "acts alike", "named", "unexplained", "minor or surrogate", "nothing"]
            show(f"Effects that the library has not, by {title}", heads, outside(tried, GROUPS[title]))
    for title, by in () if leave_out else GROUPS.items():
        rows = recall(tried, by)
        if rows:
            show(f"Recall by {title}", [title, "found", "named first"], rows)
    if not leave_out:
        show("What is not there", ["", "share"], honesty(tried))
    rows = [] if leave_out else accuracy(tried)
    if rows:
        show(
            "Coefficients, where the effect is named first",
            ["strength", "relative error, median", "in the 95 % interval"],
            rows,
            "without periodic disturbances, whose amplitudes depend on a choice of phase",
        )
    rows = promises(tried)
    if rows:
        show("Part explained of a third record", ["strength", "as promised", "less", "more"], rows)
    rows = costs(tried)
    if rows:
        show("Time of a case", ["", "median", "longest"], rows)
    raised = [o for o in tried if o.error]
    console.print(f"raised: {share(len(raised), len(tried))}; not made: {len(done) - len(tried)}")


def main():
    """From the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--n", type=int, default=200, help="number of cases")
    parser.add_argument("--seed", type=int, default=0, help="of the first; the others follow")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--systems", nargs="+", default=list(hidden.SYSTEMS), choices=list(hidden.SYSTEMS))
    parser.add_argument("--strengths", nargs="+", default=list(hidden.STRENGTHS), choices=list(hidden.STRENGTHS))
    parser.add_argument("--noise", nargs="+", default=["white", "coloured"], choices=["white", "coloured"])
    parser.add_argument("--doubles", type=float, default=0.15, help="part of the cases that hide two effects")
    parser.add_argument("--nothing", type=float, default=0.25, help="part of the cases that hide none")
    parser.add_argument("--no-validation", action="store_true", help="no second manoeuvre")
    parser.add_argument("--only", type=int, nargs="+", default=(), metavar="SEED", help="these cases")
    parser.add_argument("--list", action="store_true", help="print the failed cases")
    parser.add_argument("--rates", action="store_true", help="at half and a quarter of the outputs' rate, too")
    parser.add_argument("--leave-out", action="store_true", help="the library has not what is hidden")
    parser.add_argument("--promised", action="store_true", help="compare with what is explained of a third record")
    a = parser.parse_args()
    choice = {"systems": a.systems, "strengths": a.strengths, "noises": a.noise}
    choice |= {"doubles": a.doubles, "empty": a.nothing, "validation": not a.no_validation, "more": int(a.promised)}
    run(a.n, a.seed, a.processes, a.only, a.list, a.leave_out, a.rates, **choice)


if __name__ == "__main__":
    main()
