"""Effects that a model is missing in most records of a fleet."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..discrepancy.candidates.candidate import Candidate, with_variants
from ..discrepancy.candidates.library import candidates as library
from ..errors import DataError, EvaluationError, OptionError, counted
from ..estimation import estimate
from ..fit_result import ENDED_WELL
from ..modelling.model import Model
from ..parameters import text_table
from ..sensitivities import Points
from ..sensitivities.linearised import Linearised
from ..solvers import interrupts
from .crew import FleetCrew, Stopped, of_executors, workers_of
from .estimation import divided, estimate_fleet
from .result import FleetFit
from .runs import Run, as_runs, checked
from .sums import Sums
from .worker import Spec, Trial

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["MissingEffect", "MissingEffects", "missing_effects"]

_Array = NDArray[np.float64]

# Scores of fewer records do not show how they scatter.
_FEWEST = 20
# Candidates that one extended model holds.
_AT_ONCE = 40
# Records whose motion gives the scales of the candidates.
_SHOWN = 4
# Records and candidates with which the leading ones are estimated; those whose log-likelihood is within this of the
# best are not distinguished from it.
_REFITTED, _LEADING, _CLOSE = 100, 8, 2.0


@dataclass(frozen=True)
class MissingEffect:
    """An effect whose scores agree over the records of a fleet.

    name, explanation  as of the candidate.
    coefficient        estimate to first order, in the coefficient's unit, and its ``std_error``, from the scatter of
                       the records' scores: noise that is correlated in time, or other than assumed, is in it.
    z                  the sum of the scores in its standard deviations.
    gain               in log-likelihood, to first order, if the noise is as assumed.
    agreeing           part of the records whose scores have the sign of the sum.
    of_records         record -> coefficient that it would have alone, to first order; NaN where it does not tell.
    alike              other candidates with which the records are as likely.
    """

    name: str
    explanation: str
    coefficient: float
    std_error: float
    z: float
    gain: float
    agreeing: float
    of_records: dict[str, float] = field(repr=False)
    alike: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False, repr=False)
class MissingEffects:
    """What the model is missing in most records of a fleet, the strongest effect first.

    effects    those that are significant, each given the ones before it.
    tested     number of candidates.
    threshold  of ``z``: passed by one of all candidates in 5 % of fleets in which nothing is missing.
    gains      candidate -> gain in log-likelihood to first order, before any effect was added; 0 where ``z`` is not
               significant.
    """

    effects: tuple[MissingEffect, ...]
    tested: int
    threshold: float
    gains: dict[str, float]
    records: int

    def summary(self) -> str:
        """Return the effects as a plain-text table."""
        head = (
            f"{counted(self.records, 'record')}, {counted(self.tested, 'candidate')}: "
            f"{counted(len(self.effects), 'effect')} beyond |z| = {self.threshold:.1f}"
        )
        if not self.effects:
            return f"{head}; no effect of the library is missing in most records"
        rows = [
            [
                e.name,
                f"{e.z:+.1f}",
                f"{e.coefficient:.4g}",
                f"{e.std_error:.2g}",
                f"{100 * e.agreeing:.0f} %",
                ", ".join(e.alike[:3]),
            ]
            for e in self.effects
        ]
        table = text_table(["effect", "z", "coefficient", "std error", "records agreeing", "alike"], rows, "srrrrs")
        return "\n".join([head, table, *(f"{e.name}: {e.explanation}" for e in self.effects)])

    def plot(self) -> Figure:
        """Draw the gains of the candidates, and the coefficient of the strongest effect in each record."""
        from matplotlib.figure import Figure

        figure = Figure(figsize=(10, 4.5), layout="constrained")
        left, right = figure.subplots(1, 2)
        order = sorted(self.gains, key=lambda name: -self.gains[name])[:12][::-1]
        found = {e.name for e in self.effects}
        left.barh(order, [self.gains[n] for n in order], color=["C3" if n in found else "0.75" for n in order])
        left.set_xlabel("gain in log-likelihood, to first order")
        left.set_title("Which effect is missing in most records", fontsize="medium", loc="left")
        if self.effects:
            effect = self.effects[0]
            values = np.array([v for v in effect.of_records.values() if math.isfinite(v)])
            low, high = np.quantile(values, [0.02, 0.98])
            right.hist(np.clip(values, low, high), bins=30, color="0.75")
            right.axvline(effect.coefficient, color="C3", label="the fleet")
            right.axvline(0.0, color="0.3", linewidth=0.8)
            right.set_xlabel(f"coefficient of {effect.name}, each record alone")
            right.set_ylabel("records")
            right.set_title("Does it agree from record to record?", fontsize="medium", loc="left")
            right.legend(frameon=False)
        else:
            right.axis("off")
            right.text(0.0, 0.9, "No effect of the library is missing in most records.", transform=right.transAxes)
        return figure


def missing_effects(
    fleet: FleetFit,
    runs: Sequence[Any],
    executor: Any,
    *,
    candidates: Iterable[Candidate] | None = None,
    most: int = 3,
    memory: float = 1e9,
) -> MissingEffects:
    """Return effects that the model of a fleet is missing in most records, by score tests over the records.

    The model is extended by all candidates at once, with coefficients of zero, and evaluated once where the fleet was
    estimated. Each record gives the derivative of its log-likelihood with respect to each coefficient. What is missing
    in the model pulls all records the same way; noise, gusts and faults of single sensors do not. The test is that of
    the mean of the records' efficient scores by their scatter (score test with a robust variance: White, Econometrica
    50, 1982), so that it needs no model of the noise. The model is estimated with each of the leading candidates, from
    at most 100 records, and extended by the likeliest; then all is done again, until nothing is significant.

    runs        the records, as `phugoid.estimate` took them.
    candidates  effects that enter with one coefficient, of `phugoid.candidates`; None: those of the library for the
                first record. Others, such as delays, are left out: they need an estimation each.
    most        most effects to be named; 0 tests alone.

    Raises OptionError where there are fewer than 20 records, EvaluationError where records have no likelihood.
    """
    named = [r for r in as_runs(runs) if r.name not in fleet.left_out]
    if len(named) < _FEWEST:
        raise OptionError(
            f"missing_effects: {counted(len(named), 'record')} do not show how scores scatter; {_FEWEST} do"
        )
    points = _points(fleet, named[:_SHOWN])
    given = library(fleet.model, points=points) if candidates is None else candidates
    # Which centre a power has, a record does not say: the fleet does.
    linear = [c for c in with_variants(list(given), points, fleet.model) if _is_linear(c)]
    if not linear:
        raise OptionError("missing_effects: no candidate enters with one coefficient")
    executors = of_executors(executor)
    some_of = named[:: max(len(named) // _REFITTED, 1)][:_REFITTED]
    step, effects, gains, threshold = fleet, list[MissingEffect](), dict[str, float](), math.inf
    tested = len({c.name for c in linear})
    while True:
        left = [c for c in linear if c.name not in {e.name for e in effects}]
        with interrupts() as pressed:
            try:
                blocks = _blocks(left)
                found = [t for b in blocks for t in _tests(step, named, b, executors, int(memory), pressed)]
            except Stopped:
                raise KeyboardInterrupt("missing_effects: stopped") from None
        if not effects:
            threshold = _threshold(len(found), len(named))
            shown = ((t.name, t.gain if abs(t.z) > threshold else 0.0) for t in found)
            gains = dict(sorted(shown, key=lambda pair: pair[1]))  # of several centres the best
        significant = [t for t in found if abs(t.z) > threshold]
        leading = sorted(significant, key=lambda t: -t.gain)[:_LEADING]
        if not leading or len(effects) == most:
            return MissingEffects(tuple(effects), tested, threshold, gains, len(named))
        # To first order much looks alike: which one it is, an estimate with each says.
        tried = [(t, f) for t in leading if (f := _extended(step, t.candidate, some_of, executors)) is not None]
        best = max(tried, key=lambda pair: pair[1].log_likelihood, default=None)
        extended = None if best is None else _extended(step, best[0].candidate, named, executors)
        if best is None or extended is None:
            return MissingEffects(tuple(effects), tested, threshold, gains, len(named))
        test, likeliest = best[0], best[1].log_likelihood
        close = {t.name: None for t, f in tried if f.log_likelihood > likeliest - _CLOSE and t.name != test.name}
        coefficient = extended.parameters[test.candidate.coefficients[0]]
        effects.append(
            MissingEffect(
                name=test.name,
                explanation=test.candidate.explanation,
                coefficient=coefficient.value,
                std_error=coefficient.std_error,
                z=test.z,
                gain=extended.log_likelihood - step.log_likelihood,
                agreeing=test.agreeing,
                of_records=test.of_records,
                alike=tuple(close),
            )
        )
        step = extended


def _extended(fleet: FleetFit, candidate: Candidate, runs: Sequence[Any], executors: Sequence[Any]) -> FleetFit | None:
    """Return the estimate of the model extended by a candidate; None where it has not converged."""
    start = {**fleet.start(), candidate.coefficients[0]: 0.0}
    try:
        found = estimate_fleet(
            candidate.extended(fleet.model),
            runs,
            list(executors),
            transcription=fleet.transcription,
            noise=fleet.noise,
            start=start,
            leave_out=True,
            first=1,
        )
    except (DataError, EvaluationError):
        return None
    return found if found.status in ENDED_WELL else None


def _blocks(candidates: Sequence[Candidate]) -> list[list[Candidate]]:
    """Return the candidates in groups that one model can hold: those of one name, about other centres, in several."""
    blocks: list[list[Candidate]] = []
    for candidate in candidates:
        fits = (b for b in blocks if len(b) < _AT_ONCE and all(candidate.coefficients != c.coefficients for c in b))
        block = next(fits, None)
        if block is None:
            blocks.append(block := [])
        block.append(candidate)
    return blocks


def _threshold(tests: int, records: int) -> float:
    from scipy.stats import t as student  # not at import: it takes a quarter of a second

    return float(student.isf(0.025 / tests, records - 1))


def _points(fleet: FleetFit, runs: Sequence[Any]) -> Sequence[Points]:
    """Return the motion in a few records, which shows the scales of the candidates."""
    records = [run.load(fleet.model) if isinstance(run, Run) else checked(run, fleet.model) for run in runs]
    return Linearised(estimate(fleet.model_of(runs[0].name), records)).points


def _is_linear(candidate: Candidate) -> bool:
    return (
        len(candidate.coefficients) == 1
        and not candidate.shape_names
        and not candidate.unit_amplitude
        and candidate.transferable
        and not candidate.beside
        and not candidate.jumps
    )


@dataclass(frozen=True)
class _Test:
    """The score test of one candidate."""

    candidate: Candidate
    z: float
    gain: float
    agreeing: float
    of_records: dict[str, float]

    @property
    def name(self) -> str:
        """Return the name of the candidate."""
        return self.candidate.name


def _tests(
    fleet: FleetFit,
    named: Sequence[Any],
    block: Sequence[Candidate],
    executors: Sequence[Any],
    memory: int,
    pressed: Callable[[], int],
) -> list[_Test]:
    """Return the tests of candidates, of a model that is extended by all of them."""
    model: Model = fleet.model
    for candidate in block:
        model = candidate.extended(model)
    added = [name for name in model.parameter_names if name not in fleet.model.parameter_names]
    workers = workers_of(executors)
    start = {**fleet.start(), **dict.fromkeys(added, 0.0)}
    spec = Spec(model, fleet.noise, replace(fleet.transcription), start, (), memory // max(workers, 1))
    parts = divided(named, workers)
    crew = FleetCrew(executors, spec, parts, pressed)
    try:
        spreads = crew.first(named[:: max(len(named) // 8, 1)][:8], start)["spreads"]
        crew.close()
        crew = FleetCrew(executors, replace(spec, spreads=spreads), parts, pressed)
        ((_, variables),) = [(a["part"], a["variables"]) for a in crew.evaluate(Trial(), [0])]
        at = np.array([value for _, value, _ in variables])
        answers = sorted(crew.evaluate(Trial(at, detailed=True, gauss_newton=True)), key=lambda answer: answer["part"])
    finally:
        crew.close()
    sums = Sums.of(at, answers)
    if not sums.results:
        reason = next((text for text, _ in sums.failures.values()), "")
        raise EvaluationError(f"missing_effects: no record has a likelihood with the candidates: {reason}")
    shared = [name for name, *_ in variables]
    of_candidates = [shared.index(name) for name in added]
    fixed = {i for i, (_, _, (low, high)) in enumerate(variables) if low == high}
    others = [i for i in range(len(shared)) if i not in of_candidates and i not in fixed]
    gradients = -np.array([r["gradient"] for r in sums.results])
    h = sums.hessian
    through = np.linalg.solve(h[np.ix_(others, others)], h[np.ix_(others, of_candidates)])
    scores = gradients[:, of_candidates] - gradients[:, others] @ through
    information = h[np.ix_(of_candidates, of_candidates)] - h[np.ix_(of_candidates, others)] @ through
    total, n = scores.sum(axis=0), len(scores)
    spread = np.sqrt(n / (n - 1) * ((scores - scores.mean(axis=0)) ** 2).sum(axis=0))
    size = np.diag(information)
    typical = np.median(np.abs(size))
    names = [r["name"] for r in sums.results]
    tests = []
    for k, candidate in enumerate(block):
        if not (size[k] > 1e-9 * typical and spread[k] > 0.0):
            continue  # the shared parameters do what it does
        alone = scores[:, k] * n / size[k]
        agreeing = float(np.mean(np.sign(scores[:, k]) == np.sign(total[k])))
        z, gain = float(total[k] / spread[k]), float(0.5 * total[k] ** 2 / size[k])
        tests.append(_Test(candidate, z, gain, agreeing, dict(zip(names, alone.tolist(), strict=True))))
    return tests
