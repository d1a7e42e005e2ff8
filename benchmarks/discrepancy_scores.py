"""What a diagnosis made of one case, and the counts over many that `discrepancy.py` prints."""

import sys
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from tables import median, seconds

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import hidden

NAMES = 4
"""A cause and its aliases count for no more names than this."""

STATUSES = ("named", "surrogate")

RATES = (1, 2, 4)
"""Keep one sample of the outputs in so many."""


@dataclass(frozen=True)
class Found:
    """A finding: its cause and aliases, the cause first; status; coefficient and 95 % interval."""

    names: tuple[str, ...]
    status: str
    coefficient: float
    interval: tuple[float, float]

    @property
    def claims(self) -> bool:
        """Whether it says what it is, be it under reserve."""
        return self.status != "unexplained"

    def __str__(self) -> str:
        aliases = f" or {', '.join(self.names[1:])}" if len(self.names) > 1 else ""
        return f"{self.names[0] or '?'}{aliases} ({self.status})"


@dataclass(frozen=True)
class Outcome:
    """One case diagnosed.

    again    the call that makes it.
    truth    effect -> kind.
    error    what was raised, or "".
    verdict  of the diagnosis.
    promise  where one cause is named, that of a case with one effect: the part of the misfit of a third record that it
             explains, and the interval that was promised for such a record.
    equal    whether, where what is hidden was left out of the library, the named causes explain as much of the held-out
             record in free simulation as what is hidden does: another name for the same.
    time     of the diagnosis, s; ``fit_time`` and ``make_time`` before it.
    """

    seed: int
    again: str
    system: str
    noise: str
    strength: str
    truth: dict[str, str]
    coefficients: dict[str, float]
    found: tuple[Found, ...] = ()
    error: str = ""
    verdict: str = ""
    equal: bool = False
    promise: tuple[float, tuple[float, float]] | None = None
    time: float = float("nan")
    fit_time: float = float("nan")
    make_time: float = float("nan")

    def hits(self, effect: str) -> list[Found]:
        """Findings that have the effect among their names."""
        return [f for f in self.found if f.claims and effect in f.names]

    @property
    def missed(self) -> list[str]:
        """Hidden effects that were not found."""
        return [effect for effect in self.truth if not self.hits(effect)]

    @property
    def false(self) -> list[Found]:
        """Claims of what is not there."""
        return [f for f in self.found if f.claims and not self.truth.keys() & {*f.names}]

    @property
    def failed(self) -> bool:
        """Whether anything is wrong with it."""
        return bool(self.error or self.missed or self.false)

    def __str__(self) -> str:
        found = "; ".join(map(str, self.found)) or "nothing found"
        return f"{self.seed}: {self.again}: {self.error or found}"


def diagnosed(
    seed: int, choice: dict, diagnose: Callable | None = None, leave_out: bool = False, every: int = 1
) -> Outcome:
    """Makes the case of a seed, fits it and diagnoses it (by `ph.diagnose`); with ``leave_out`` without the families of
    candidates that what is hidden belongs to. Of the outputs one sample in so many is kept, ``every``; the inputs stay,
    for with fewer samples of theirs they would be other inputs."""
    import phugoid as ph

    begin = time.perf_counter()
    try:
        case = hidden.draw(seed, **choice)
    except hidden.Unreachable as error:
        return Outcome(seed, f"draw({seed}, ...)", "", "", "", {}, {}, error=f"not made: {error}")
    made = time.perf_counter()
    about = (seed, case.again(), case.system, case.noise, str(case.strength), case.kinds, case.coefficients)
    try:
        fit = ph.estimate(case.model, thinned(case.data, every))
        fitted = time.perf_counter()
        known = {"candidates": _without(case)} if leave_out else {}
        d = (diagnose or ph.diagnose)(fit, validation=thinned(case.validation, every), **known)
        done = time.perf_counter()
    except Exception as error:
        text = str(error).strip().partition("\n")[0]
        return Outcome(*about, error=f"raised {type(error).__name__}: {text}")
    found = tuple(
        Found((f.cause, *f.aliases)[:NAMES], f.status, float(f.coefficient), tuple(map(float, f.interval)))
        for f in d.findings
    )
    promise = kept_promise(case, fit, d) if case.more else None
    equal = leave_out and d.verdict == "named" and explains_as_much(case, fit, d.extend().fit)
    times = {"time": done - fitted, "fit_time": fitted - made, "make_time": made - begin}
    return Outcome(*about, found, verdict=d.verdict, equal=equal, promise=promise, **times)


def kept_promise(case: hidden.Case, fit: Any, d: Any) -> tuple[float, tuple[float, float]] | None:
    """Return the part of the misfit of a third record that the only named cause explains in free simulation, and the
    interval that was promised for it; None where the case has not one effect, and that named."""
    from phugoid.discrepancy.search.refit import Refit

    named = [f for f in d.findings if f.status == "named"]
    if len(case.truth) != 1 or len(named) != 1 or case.truth[0] not in (named[0].cause, *named[0].aliases):
        return None
    if named[0].explained_in != "data held out" or not np.isfinite(named[0].explained_another).all():
        return None
    parts = explained_of(case.more, Refit((), fit), Refit((), d.extend().fit))
    return None if parts is None else (float(parts[0].part), tuple(map(float, named[0].explained_another)))


def explained_of(records: Sequence[Any], base: Any, *refits: Any) -> list[Any] | None:
    """Return what each of some refits explains in free simulation of the misfit of records that a base leaves; None
    where one of them cannot be fitted there."""
    from phugoid.discrepancy.search.free_run import Misfitting, Simulated
    from phugoid.discrepancy.search.refit import on_other_data
    from phugoid.errors import PhugoidError

    try:
        before, *after = (on_other_data(r, records) for r in (base, *refits))
    except PhugoidError:
        return None
    without, misfit = Simulated.of(before), Misfitting.of(before)
    return [Simulated.of(linear).explained(without, misfit) for linear in after]


def promises(outcomes: Iterable[Outcome]) -> list[list[str]]:
    """Rows: strength, and the share of named causes that explain as much of a third record as was promised."""
    counts: dict[str, Counter] = defaultdict(Counter)
    for o in outcomes:
        for group in (o.strength, "all") if o.promise is not None else ():
            part, promised = o.promise
            side = "below" if part < promised[0] else "above"
            counts[group]["all"] += 1
            counts[group]["within" if within(part, promised) else side] += 1
    order = sorted(counts.items(), key=lambda item: (item[0] == "all", item[0]))
    return [[name, *(share(c[key], c["all"]) for key in ("within", "below", "above"))] for name, c in order]


def at_rates(seed: int, choice: dict) -> tuple[Outcome, ...]:
    """The case of a seed, diagnosed with each sample of the outputs, every second and every fourth."""
    return tuple(diagnosed(seed, choice, every=k) for k in RATES)


def thinned(record: Any, every: int) -> Any:
    """Return a record, a sequence of records or None with one sample in so many of the outputs."""
    import phugoid as ph

    if record is None or every == 1:
        return record
    if not isinstance(record, ph.Experiment):
        return [thinned(one, every) for one in record]
    kept = np.arange(record.t.size) % every == 0
    return record.with_channels({n: np.where(kept, record.output(n), np.nan) for n in record.outputs})


def explains_as_much(case: hidden.Case, fit: Any, named: Any) -> bool:
    """Return whether a fit with other causes explains as much of the held-out record in free simulation as one with the
    hidden effect: whether the explained part of each lies in the interval of the other.

    Many effects act alike in a band of frequencies and a range of motion: a lag and a delay, a rate's cube and its
    square with the sign. Then it is right to name either.
    """
    from phugoid.discrepancy.search.refit import Refit

    truth = _with_truth(case, fit)
    parts = explained_of([case.validation], Refit((), fit), Refit((), named), truth) if truth is not None else None
    if parts is None:
        return False
    mine, its = parts
    return within(mine.part, its.interval) and within(its.part, mine.interval)


def _with_truth(case: hidden.Case, fit: Any) -> Any:
    """Return the likeliest fit with what is hidden, about any of the centres that the record suggests, begun from the
    true values and others: about another centre than the trim it ends elsewhere. None where none converges."""
    import phugoid as ph
    from phugoid.discrepancy.search.refit import Refit, refit
    from phugoid.sensitivities.linearised import Linearised

    points = Linearised(fit).points
    library = {c.name: c for c in ph.candidates(fit.model, points=points)}
    found = []
    for terms in product(*([library[n], *library[n].variants(points)] for n in case.truth)):
        values = {}
        for c in terms:
            values |= dict(zip(c.parameters, [case.coefficients[c.name], *case.shapes[c.name].values()], strict=False))
        found += [refit(fit, terms, values), refit(fit, terms, {**case.parameters, **values})]
        model = fit.model
        for c in terms:
            model = c.extended(model, {n: values[n] for n in c.parameters if n in values})
        started = ph.estimate(
            model, case.data, start={n: v for n, v in case.parameters.items() if n in model.parameter_names}
        )
        found.append(Refit((), started) if started.converged else None)
    return max((r for r in found if r is not None), key=lambda r: r.merit, default=None)


def within(part: float, interval: tuple[float, float]) -> bool:
    """Return whether a number lies in an interval, or no further off than a part of 0.01."""
    return interval[0] - 0.01 <= part <= interval[1] + 0.01


def _without(case: hidden.Case) -> Any:
    """The library without the families of what a case hides."""
    import phugoid as ph

    families = {c.name: c.family for c in ph.candidates(case.model)}
    return ph.candidates(case.model, leave_out=sorted({families[name] for name in case.truth}))


def outside(outcomes: Iterable[Outcome], by: Callable[[Outcome, str], str]) -> list[list[str]]:
    """Rows: group, number of cases, and how diagnoses of effects that the library has not end: the shares of those in
    which a cause is named that acts alike, in which another is, in which the misfit is unexplained, and in which little
    (a minor finding or a surrogate) or nothing is said to be missing."""
    counts: dict[str, Counter] = defaultdict(Counter)
    for o in outcomes:
        for group in {by(o, effect) for effect in o.truth} | ({"all"} if o.truth else set()):
            counts[group]["equal" if o.equal else o.verdict] += 1
    rows = []
    for group, c in sorted(counts.items(), key=lambda item: (item[0] == "all", item[0])):
        n, little = c.total(), c["minor"] + c["surrogate"]
        ends = c["equal"], c["named"], c["unexplained"], little, c["nothing"]
        rows.append([group, str(n), *(share(k, n) for k in ends)])
    return rows


def alike(groups: Iterable[tuple[Outcome, ...]]) -> list[list[str]]:
    """Rows: what is the same at all rates, and in what share of the cases: the verdict; the causes that are named; and
    these, or one of their aliases."""
    counts: Counter = Counter()
    for group in groups:
        named = [[f.names for f in o.found if f.status == "named"] for o in group]
        counts["cases"] += 1
        counts["verdict"] += len({o.verdict for o in group}) == 1
        counts["causes"] += len({frozenset(names[0] for names in each) for each in named}) == 1
        first, *others = named
        counts["aliases"] += all(
            len(first) == len(each) and all(any({*a} & {*b} for b in each) for a in first) for each in others
        )
    words = {"verdict": "verdict", "causes": "named causes", "aliases": "named causes or their aliases"}
    return [[word, share(counts[key], counts["cases"])] for key, word in words.items()]


def share(part: int, whole: int) -> str:
    """Text of a share and its counts."""
    return f"{part / whole:.3f}  ({part} of {whole})" if whole else "-"


def recall(outcomes: Iterable[Outcome], by: Callable[[Outcome, str], str]) -> list[list[str]]:
    """Rows: group, share of hidden effects found, share named first; the groups as ``by`` has them."""
    counts: dict[str, list[int]] = defaultdict(lambda: [0, 0, 0])
    for o in outcomes:
        for effect in o.truth:
            count = counts[by(o, effect)]
            count[0] += 1
            count[1] += bool(o.hits(effect))
            count[2] += any(f.names[0] == effect for f in o.hits(effect))
    return [[group, share(c[1], c[0]), share(c[2], c[0])] for group, c in sorted(counts.items())]


def honesty(outcomes: list[Outcome]) -> list[list[str]]:
    """Rows on claims of what is not there."""
    empty = [o for o in outcomes if not o.truth]
    claims = [f for o in outcomes for f in o.found if f.claims]
    false = [f for o in outcomes for f in o.false]
    statuses = {status: [[f.status for f in fs].count(status) for fs in (false, claims)] for status in STATUSES}
    unexplained = [o for o in outcomes if any(not f.claims for f in o.found)]
    rows = [["false alarms, of cases with nothing hidden", share(sum(bool(o.false) for o in empty), len(empty))]]
    for noise in sorted({o.noise for o in empty}):
        of = [o for o in empty if o.noise == noise]
        rows.append([f"  {noise} noise", share(sum(bool(o.false) for o in of), len(of))])
    silent = [o for o in empty if not o.found]
    return [
        *rows,
        ["  nothing said at all", share(len(silent), len(empty))],
        ["false discoveries, of all claims", share(len(false), len(claims))],
        *([f"  of claims '{status}'", share(*counts)] for status, counts in statuses.items()),
        ["'unexplained' said, of cases", share(len(unexplained), len(outcomes))],
        ["names in a claim, mean", f"{np.mean([len(f.names) for f in claims]):.2f}" if claims else "-"],
    ]


def accuracy(outcomes: Iterable[Outcome]) -> list[list[str]]:
    """Rows on coefficients, of effects named first: relative error and coverage, by strength."""
    counts: dict[str, list[tuple[float, bool]]] = defaultdict(list)
    for o in outcomes:
        for effect, signed in o.coefficients.items():
            c = abs(signed) if effect.endswith(":periodic") else signed  # of a wave the amplitude is found
            for f in o.hits(effect):
                if f.names[0] == effect:
                    low, high = f.interval
                    counts[o.strength].append((abs(f.coefficient / c - 1), low <= c <= high))
                    break
    every = [each for group in counts.values() for each in group]
    groups = {**dict(sorted(counts.items())), "all": every} if every else {}
    return [
        [name, f"{100 * median([e for e, _ in g]):.1f} %", share(sum(inside for _, inside in g), len(g))]
        for name, g in groups.items()
    ]


def costs(outcomes: Iterable[Outcome]) -> list[list[str]]:
    """Rows on time: diagnosis, fit, making the case."""
    done = [o for o in outcomes if np.isfinite(o.time)]
    kinds = {
        "diagnosis": [o.time for o in done],
        "fit": [o.fit_time for o in done],
        "case": [o.make_time for o in done],
    }
    return [[name, seconds(median(t)), seconds(max(t))] for name, t in kinds.items() if t]
