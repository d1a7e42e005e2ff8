"""What `ph.diagnose` says of records in situations that no term of the physics describes.

Records are drawn by tests/hidden/situation.py, which knows nothing of the method: gusts, noise on a recorded input, a
single event, a parameter that drifts or differs from record to record, backlash, a limited rate, a held input, an end
stop, a flexible part, displaced and clipped sensors, a term that no library has; terms where the state that they act on
is not measured, where a quantity has two sensors, and where there are several records; and nothing at all under several
kinds of noise. Each is fitted and diagnosed with one more record as held-out data.

right         all that is named is there.
partly        something that is there is named, and something else, too.
wrong         what is named is not there.
unexplained   nothing is named, and the residuals are said to have structure.
nothing       the model is said to miss nothing.

    python benchmarks/situations.py --seeds 3 --seed 0 --processes 2 --list
    python benchmarks/situations.py --situations gust event --systems uav

Writes nothing.
"""

import argparse
import os
import sys
import time
from collections import Counter
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # processes share the cores

from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context

from rich.markup import escape
from rich.progress import MofNCompleteColumn, Progress, TimeElapsedColumn
from tables import console, median, seconds, show

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from hidden import SYSTEMS, Unreachable
from hidden.situation import SITUATIONS, situation

ENDS = ("right", "partly", "wrong", "unexplained", "nothing", "raised", "not made")
ALIASES = 2
"""A cause counts for itself and so many aliases."""


def diagnosed(what, system, seed, limit):
    """How a diagnosis ends: (situation, system, seed, end, text, seconds)."""
    import phugoid as ph

    job = what, system, seed
    try:
        case = situation(what, system, seed)
    except Unreachable:
        return *job, "not made", "", 0.0
    begin = time.perf_counter()
    try:
        fit = ph.estimate(case.model, case.data)
        d = ph.diagnose(fit, validation=case.validation, time_limit=limit)
    except Exception as error:
        text = str(error).strip().partition("\n")[0]
        return *job, "raised", f"{type(error).__name__}: {text}", time.perf_counter() - begin
    names = [{f.cause, *f.aliases[:ALIASES]} for f in d.findings if f.status == "named"]
    hits = [bool(named & {*case.truth}) for named in names]
    if names:
        end = "right" if all(hits) else "partly" if any(hits) else "wrong"
    else:
        end = "nothing" if d.verdict == "nothing" else "unexplained"
    text = f"{', '.join(case.truth) or 'nothing'} -> " + ("; ".join(" or ".join(sorted(n)) for n in names) or d.verdict)
    return *job, end, text, time.perf_counter() - begin


def run(situations, systems, seed, seeds, processes, limit, listed):
    """Measure and print."""
    jobs = [(w, s, seed + 100 * k + i, limit) for k in range(seeds) for w in situations for i, s in enumerate(systems)]
    done = []
    # Fresh processes: threads of the numerical core do not live through a fork.
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as executor:
        tasks = [executor.submit(diagnosed, *job) for job in jobs]
        columns = (*Progress.get_default_columns()[:2], MofNCompleteColumn(), TimeElapsedColumn())
        try:
            with Progress(*columns, console=console, transient=True) as progress:
                bar = progress.add_task("records", total=len(jobs))
                for task in as_completed(tasks):
                    done.append(task.result())
                    progress.update(bar, advance=1)
        except KeyboardInterrupt:
            executor.shutdown(wait=False, cancel_futures=True)
            console.print(f"interrupted after {len(done)} of {len(jobs)} records")
    report(sorted(done), situations, listed)


def report(done, situations, listed):
    """Tables of the ends, and of the time."""
    rows = []
    for what in (*situations, "all"):
        counts = Counter(end for w, _, _, end, *_ in done if what in (w, "all"))
        rows.append([what, *(str(counts[end] or "-") for end in ENDS)])
    show("What is said, by situation", ["", *ENDS], rows)
    times = [t for *_, end, _, t in done if end != "not made"]
    if times:
        show(
            "Time of fit and diagnosis", ["", "median", "longest"], [["", seconds(median(times)), seconds(max(times))]]
        )
    if listed:
        for what, system, seed, end, text, t in done:
            console.print(escape(f"{what}, {system}, seed {seed}: {end} ({t:.1f} s): {text}"), soft_wrap=True)


def main():
    """From the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--situations", nargs="+", default=list(SITUATIONS), choices=SITUATIONS)
    parser.add_argument("--systems", nargs="+", default=list(SYSTEMS), choices=list(SYSTEMS))
    parser.add_argument("--seed", type=int, default=0, help="of the first; the others follow")
    parser.add_argument("--seeds", type=int, default=1, help="records of each situation and system")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--limit", type=float, default=120.0, help="seconds that a diagnosis may take")
    parser.add_argument("--list", action="store_true", help="print all of them")
    a = parser.parse_args()
    run(a.situations, a.systems, a.seed, a.seeds, a.processes, a.limit, a.list)


if __name__ == "__main__":
    main()
