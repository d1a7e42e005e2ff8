"""Time per mesh point of the NLP callbacks on HFB-320, for us and for peers, in one process on one machine.

What is evaluated, for the trapezoid (LGL order 2) on N points, 4 states, the paper's 22 parameters:

* defects: all 4 (N - 1) of them;
* defects and Jacobian: the defects and every nonzero of their Jacobian, 35 per segment (12 and 12 for the
  states at its two ends, 11 for the parameters);
* Hessian: every nonzero of the lower triangle of the Hessian of the Lagrangian, objective included (the
  negative log-likelihood with its seven noise parameters as variables): per point 9 among states and 46
  between states and parameters, and 85 among parameters, which are sums over the points.

Every peer starts from the decision variables and the multipliers.  CasADi writes into arrays allocated
before; ours and opty's go through their Python bindings and return new numpy arrays, with what that costs.
Ours has 1/sigma for sigma.  Peers take turns, each long enough to be warm; times are those of the fastest
round, which other work on the machine disturbs least, divided by N.  What the peers return is compared entry
by entry before, see kernel_check.py.

    python benchmarks/kernels.py [--points 601 100000] [--only phugoid]
"""

import argparse
import time

from kernel_peers import KINDS, OURS, PEERS, VM, C, make_mesh, ours
from tables import attempt, console, show, times

TOLERANCE = 1e-9
"""Above this the values of two peers are said to differ."""


def prepare(mesh, only=""):
    """{(peer, kind): callable}; prints which peers are skipped and how far values differ from the first's."""
    from kernel_check import difference, matrices

    callables, first = {}, None
    for name, factory in PEERS.items():
        found = attempt(name, factory, mesh) if only.lower() in name.lower() else None
        if found is None:
            continue
        callbacks, places = found
        callables |= {(name, kind): call for kind, call in zip(KINDS, callbacks, strict=True) if call}
        if places is not None:
            values = matrices(callbacks, places, mesh)
            apart = difference(values, first := first or values)
            if max(apart) > TOLERANCE:
                console.print(f"{name}: differs from the first: {apart} (defects, Jacobian, Hessian)")
    return callables


def measure(callables, rounds=9, target=0.05):
    """{key: seconds per call}: the fastest of rounds in each of which every callable fills about `target` s."""
    found = {key: [] for key in callables}
    calls = dict.fromkeys(callables, 1)
    for _ in range(rounds + 1):
        for key, callback in callables.items():
            begin = time.perf_counter()
            for _ in range(calls[key]):
                callback()
            found[key].append((time.perf_counter() - begin) / calls[key])
            calls[key] = max(1, int(target / found[key][-1]))
    return {key: min(values[1:]) for key, values in found.items()}


def show_peers(found, n):
    """Table of ns per point, and how many times faster than CasADi's C and its virtual machine."""
    rows = []
    for name in dict.fromkeys(peer for peer, _ in found):
        row = [name]
        for kind in KINDS:
            mine = found.get((name, kind))
            ratios = [times(found.get((base, kind)), mine) for base in (C, VM)]
            row += [f"{1e9 * mine / n:.1f}", *ratios] if mine else ["-"] * 3
        rows.append(row)
    columns = [column for kind in KINDS for column in (kind, "vs C", "vs VM")]
    show(
        f"Callbacks on HFB-320, trapezoid, N = {n:,}: ns per mesh point", ["", *columns], rows,
        f"vs C, vs VM: how many times faster than '{C}' and '{VM}'",
    )  # fmt: skip


def show_ours(n, rounds, target):
    """Table of our callbacks one by one, and how many instructions a mesh point costs."""
    calls = {(k, what): call for k in OURS for what, call in ours(n, k).apart().items()}
    found = measure(calls, rounds, target)
    rows = []
    for what in dict.fromkeys(what for _, what in calls):
        both = [found[k, what] for k in OURS]
        rows.append([what, *(f"{1e6 * t:.1f}" for t in both), *(f"{1e9 * t / n:.1f}" for t in both)])
    columns = [f"{unit}, {k} thread{'s' * (k > 1)}" for unit in ("µs/call", "ns/point") for k in OURS]
    counts = ", ".join(f"{count} for {tape}" for tape, count in ours(n, 1).instructions().items())
    show(f"Our callbacks apart, N = {n:,}", ["", *columns], rows, f"Instructions a mesh point: {counts}")


def run(points=(601, 100_000), only="", rounds=9, target=0.05):
    """Measure and print."""
    for n in points:
        show_peers(measure(prepare(make_mesh(n), only), rounds, target), n)
        if any(only.lower() in name.lower() for name in OURS.values()):
            attempt("our callbacks apart", show_ours, n, rounds, target)


def main():
    """From the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, nargs="+", default=[601, 100_000])
    parser.add_argument("--only", default="", help="only the peers whose name contains this")
    arguments = parser.parse_args()
    run(arguments.points, arguments.only)


if __name__ == "__main__":
    main()
