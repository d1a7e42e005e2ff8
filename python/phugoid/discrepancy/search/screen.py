"""The first stage of the search: which candidates are worth a refit, by one linearisation of a fit; and the simplest of
several terms that explain the same data equally well.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..._core import Expr
from ...initialisation import measured_states
from ...modelling.model import Model
from ...residual_noise.whitening import Filter, Whitening
from ..candidates.candidate import Candidate, Effect, is_function
from ..candidates.model_structure import ANGLES
from ..candidates.variation import CommonJump, Jump
from .refit import Refit, is_structured
from .refit_cache import RefitCache
from .scan import Scan, Statistics

__all__ = [
    "RICH",
    "Screen",
    "ScreenSettings",
    "complexity",
    "is_as_good",
    "is_equal",
    "is_late",
    "plausibility",
]


# A constant before a linear term before any other, and those with states of their own or two unknowns last.
RICH = 3
_ORDER = {"bias": 0, "linear": 1, "scale": 1, "factor": 1}
_ORDER |= dict.fromkeys(("stribeck", "hysteresis", "stall", "mode", "ripple", "saturating"), RICH)
_OTHER = 2
# Twice the difference in log-likelihood, of as many samples as coloured residuals are worth, below which two refits are
# equally good: chance exceeds it once in a hundred times with two parameters that differ.
_EQUAL = 9.2
# Where samples are worth less than this part of their number, the residuals are model error rather than noise, and
# their likelihood says little; equally good terms have this part of the gain elsewhere.
_MODEL_ERROR, _SIMILAR = 0.2, 0.8
# Log-likelihood by which two refits differ that are one and the same but for rounding.
_SAME = 1.0
# A term that explains most of a misfit leaves an error of the model that is small beside it: others that explain this
# part of what it does are as good, unless they leave several times what it leaves, and more than a negligible part.
_MOST, _AS_MUCH, _LEAVES, _NEGLIGIBLE = 0.5, 0.95, 3.0, 0.01
# Functions of one variable that are fitted in place of another one.
_FUNCTIONS = 8
# Times as many candidates are looked at again where the misfit is evident.
_MORE = 3
# Singular values of changes of several parameters, in parts of the largest, below which they are the same.
_RANK = 1e-4


def complexity(candidate: Candidate) -> int:
    """Return the rank of a candidate: 0 for constants, 1 for linear terms, 3 for those with more unknowns or
    states, 2 for others."""
    return _ORDER.get(getattr(candidate, "family", ""), _OTHER)


def plausibility(candidate: Candidate, model: Model) -> tuple[int, int, str]:
    """Return the rank of a candidate among others that say the same, the most plausible first: a lever arm of a sensor,
    which every vane and accelerometer away from the centre of gravity has; then what acts on the motion; the size of
    an input, which mass and actuators change; a sensor, which was calibrated; a whole equation; and what belongs to one
    record alone.
    Among equals fewer unknowns come first, then the name."""
    place = candidate.place
    angular = model.time_unit.angular_rates
    rates = [n for n in getattr(candidate, "variables", ()) if model.variable_units.get(n, "") in angular]
    family = getattr(candidate, "family", "")
    lever = place.kind == "output" and family in ("linear", "rate") and len(rates) == 1
    lever = lever and not is_late(candidate, model)
    order = 0 if lever else {"quantity": 1, "equation": 1, "parameter": 1, "input": 2}.get(place.kind, 3)
    if lever and model.units.get(place.name, "") not in ("", *ANGLES) and family == "linear":
        order = 3  # no lever arm gives the measurement of a rate a part in proportion to a rate
    if family == "factor":
        order = 4  # all that stands there would be wrong by the same factor
    if not candidate.transferable:
        order = 5
    return order, len(candidate.parameters) + (complexity(candidate) == RICH), candidate.name


def is_late(candidate: Candidate, model: Model) -> bool:
    """Return whether a linear term in an output is one in the rate of the state that it measures: to first order that
    is a lag or a delay, and no cause of its own."""
    place = candidate.place
    if place.kind != "output" or getattr(candidate, "family", "") != "linear":
        return False
    right, rates = model._right_hand_sides(), [Expr.symbol(n) for n in getattr(candidate, "variables", ())]
    return any(n in right["output", place.name].symbols for n in model.state_names if right["equation", n] in rates)


def is_equal(one: Refit, other: Refit) -> bool:
    """Return whether two refits are one and the same but for rounding: by the likelihood of white noise, and by that of
    noise with the autocorrelation of the residuals of the first."""
    if abs(one.fit.log_likelihood - other.fit.log_likelihood) > _SAME:
        return False
    filter = one.own.filter
    return abs(one.through(filter).log_likelihood - other.through(filter).log_likelihood) < _SAME


def is_as_good(best: Refit, other: Refit, gain: float, parts: tuple[float, float]) -> bool:
    """Return whether another refit explains the data as well as the best one. ``gain`` is its gain in likelihood with
    coloured noise, as a part of that of the best; ``parts`` are the parts of the misfit that the two explain.

    Where residuals are noise, a test compares the mean squares of each output. With autocorrelation rho the mean square
    of n residuals is as uncertain as that of n / (1 + 2 sum rho_k^2) independent ones (Bartlett 1946). Where they are
    error of the model, what each explains is compared.
    """
    filter = Whitening.of(best.linear.residuals, best.linear.structure)
    statistic, worth = 0.0, []
    for line, other_line, colour in zip(best.linear.rows, other.linear.rows, filter.channels, strict=True):
        mine = best.linear.residuals[line[0].start : line[-1].stop]
        theirs = other.linear.residuals[other_line[0].start : other_line[-1].stop]
        longest = max(rows.stop - rows.start for rows in line)
        rho = colour.autocorrelation(max(longest, 2))[1:]
        worth.append(1.0 / (1.0 + 2.0 * float(rho @ rho)))
        before, after = float(np.mean(mine**2)), float(np.mean(theirs**2))
        if before > 0.0 and after > 0.0:
            statistic += mine.size * worth[-1] * float(np.log(after / before))
    if max(worth) < _MODEL_ERROR and parts[0] > _MOST:
        left = max(_LEAVES * (1.0 - parts[0]), _NEGLIGIBLE)
        return parts[1] > _AS_MUCH * parts[0] and 1.0 - parts[1] < left
    return statistic < _EQUAL and gain > _SIMILAR


_Array = NDArray[np.float64]


@dataclass(frozen=True)
class ScreenSettings:
    """What is refitted.

    clean, base, white  how many of the best by ranking, by the filter of the fit, and with residuals taken as white.
    different           those that explain what the best ones leave.
    explains, share     how many of the best with residuals taken as white that explain this share of the residuals'
                        power to first order, or more, whatever coloured noise makes of them.
    hopeless            what is this far below its threshold, by the filter of the fit and by the clean one, is not
                        refitted.
    evident             part of the residuals' power that is predictable from which on large effects are searched for: a
                        parameter that jumps, which no other record confirms; and, of what acts alike to first order,
                        terms at other places and other functions of a variable.
    same                two effects on the outputs are the same beyond this cosine: one stands for both.
    alias               beyond this one they are aliases, whatever their refits say.
    """

    clean: int = 6
    base: int = 4
    white: int = 2
    different: int = 4
    explains: int = 4
    share: float = 0.1
    hopeless: tuple[float, float] = (0.4, 0.8)
    evident: float = 0.5
    same: float = 0.995
    alias: float = 0.95


class Screen:
    """Screens candidates at a fit. ``threshold`` gives what twice their gain must be."""

    def __init__(self, cache: RefitCache, threshold: Callable[[Candidate], float], settings: ScreenSettings) -> None:
        self._cache, self._threshold, self.settings = cache, threshold, settings

    def shortlist(self, at: Refit, times: int = 1) -> list[Candidate]:
        """Candidates that are worth a refit with those of ``at``, and those that the measurements suggest; ``times`` as
        many as usual."""
        scan, s = self._cache.scan(at), self.settings
        if not scan.effects:
            return []
        filters = {"white": scan.white.filter, "base": at.own.filter, "clean": scan.clean()}
        statistics = {which: scan.through(filter) for which, filter in filters.items()}
        thresholds = self._thresholds(scan)
        hopeless = (statistics["base"].values < s.hopeless[0] * thresholds) & (
            statistics["clean"].values < s.hopeless[1] * thresholds
        )
        names: dict[str, Candidate] = {}
        for which, count in (("white", s.white), ("base", s.base), ("clean", s.clean)):
            for c in self._best(scan, statistics[which], times * count, ~hopeless):
                names[c.name] = c
        power = statistics["white"].values / max(at.linear.n_rows, 1)
        for c in self._best(scan, statistics["white"], s.explains, power > s.share):
            names[c.name] = c
        for i in scan.different(statistics["base"], s.different):
            candidate, shape = scan.effects[i]
            if candidate.name not in names and not hopeless[i]:
                names[candidate.name] = candidate
                self._cache.remember(candidate, shape, statistics["base"].amplitudes[i])
        if self._is_evident:
            for c in self._beyond_first_order(scan, statistics["clean"], at.names):
                names[c.name] = c
            jump = self._common_jump(scan, statistics["clean"])
            if jump is not None and jump.name not in at.names:
                names[jump.name] = jump
        measured = self._measured(at)
        for c in self._cache.candidates:
            suggested = c.suggested(measured) if c.name not in {*names, *at.names} else None
            if suggested is not None:
                names[c.name] = c
                self._cache.remember(c, suggested, np.empty(0))
        for c in self._cache.candidates:
            # Of those centred in several ways that which the scan takes, or the first.
            if c.name in self._cache.proposed and c.name not in {*names, *at.names}:
                names[c.name] = c
                self._cache.start_as_proposed(c.name)
        return list(names.values())

    def _beyond_first_order(self, scan: Scan, statistics: Statistics, names: Collection[str]) -> list[Candidate]:
        """Return limits of stores, and friction that is larger at rest beside that of the model, whatever they gain to
        first order: in a fit that does not know of them a state goes far beyond its limit, or never rests, so that it
        says little."""
        best: dict[str, tuple[Candidate, int]] = {}
        for i in np.argsort(-statistics.values):
            candidate = scan.effects[i][0]
            family = candidate.family if isinstance(candidate, Effect) else ""
            limit = family == "limit" and candidate.place.kind == "equation"
            if candidate.name not in names and (limit or (family == "stribeck" and not candidate.beside)):
                best.setdefault(candidate.name, (candidate, int(i)))
        for candidate, i in best.values():
            self._cache.remember(candidate, scan.effects[i][1], statistics.amplitudes[i])
        return [c for c, _ in best.values()]

    def _common_jump(self, scan: Scan, statistics: Statistics) -> CommonJump | None:
        """Return the change of several parameters at one time that gains most to first order, without those that gain
        less than chance gives; None where one parameter alone does as well."""
        seen = statistics.seen
        by_time: dict[float, list[tuple[Jump, _Array]]] = {}
        for i, (c, shape) in enumerate(scan.effects):
            if isinstance(c, Jump) and c.place.kind == "parameter":
                (time,) = shape.values()
                by_time.setdefault(time, []).append((c, scan.basis(statistics, i)[:, 0]))
        best: tuple[float, float, list[Jump]] = 0.0, 0.0, []
        for time, jumps in by_time.items():
            single = self._threshold(jumps[0][0])
            columns, kept = np.column_stack([column for _, column in jumps]), list(range(len(jumps)))
            while kept:
                part, gains = _gains_beside(columns[:, kept], seen.errors)
                least = int(np.argmin(gains))
                if gains[least] > single:
                    break
                del kept[least]
            if kept and part - single * len(kept) > best[0]:
                best = part - single * len(kept), time, [jumps[k][0] for k in kept]
        if len(best[2]) < 2:
            return None
        found = CommonJump.of(best[2])
        self._cache.remember(found, {found.shape_names[0]: best[1]}, np.zeros(len(found.coefficients)))
        return found

    @staticmethod
    def _measured(at: Refit) -> dict[str, list[_Array]]:
        """Return samples of each experiment by output, and by the state that an output shows alone."""
        model = at.linear.model
        measured = {n: [r.measured[n] for r in at.fit.records] for n in model.output_names}
        states = {*model.state_names}
        for (kind, output), e in model._right_hand_sides().items():
            if kind == "output" and e.operation[0] == "symbol" and states.issuperset(e.symbols):
                measured.setdefault(str(e), measured[output])
        return measured

    def plainest(self, at: Refit) -> list[Candidate]:
        """Return those that explain most with residuals taken as white, of those that other data have, too, and that
        need no more than one start."""
        scan = self._cache.scan(at)
        among = np.array([c.transferable and not c.several_starts for c, _ in scan.effects])
        return self._best(scan, scan.through(scan.white.filter), self.settings.explains, among) if scan.effects else []

    def simple(self, at: Refit) -> list[Candidate]:
        """Return constants and linear terms, whatever they gain to first order, which says little where it is far."""
        found = {c.name: c for c, _ in self._cache.scan(at).effects if c.transferable and complexity(c) <= 1}
        return list(found.values())

    def alternatives(self, at: Refit, candidate: Candidate, filter: Filter, best: int, alike: int) -> list[Candidate]:
        """Return candidates that may stand in a candidate's place beside those of ``at``: ``best`` through a filter,
        and ``alike`` whose effect is nearly the same, with as many again that act in the path of an input; where the
        misfit is evident, other functions of the same variable."""
        scan = self._cache.scan(at)
        statistics = scan.through(filter)
        near = self._alike(scan, statistics, candidate)
        # What a large effect gains is not what it gains to first order.
        found = [*self._best(scan, statistics, _MORE * best if self._is_evident else best), *near[:alike]]
        # Powers of an input act like its limits, and are many.
        found += [c for c in near[alike:] if c.place.kind == "input"][:alike]
        if isinstance(candidate, Effect) and is_function(candidate) and self._is_evident:
            # What a large term does is not what it does to first order: functions of one variable part there.
            (variable,) = candidate.variables
            found += [c for c in self.functions(at, variable, filter, _FUNCTIONS) if c.place == candidate.place]
        if candidate.place.kind in ("equation", "quantity") and self._is_hidden:
            found += self._lever_arms(scan, statistics)
        return list({c.name: c for c in found}.values())

    @cached_property
    def _is_hidden(self) -> bool:
        """Return whether no output measures some of the states."""
        model, known = self._cache.base.fit.model, self._cache.base.fit.parameters
        values = {n: known[n].value if n in known else p.start for n, p in model.declared_parameters.items()}
        return len(measured_states(model, values)) < len(model.state_names)

    def _lever_arms(self, scan: Scan, statistics: Statistics) -> list[Candidate]:
        """Return sensors at a distance from the centre of gravity. With another state in place of one that is not
        measured, w + l q in place of w, they are the same as terms in the equations, at parameters that are far off."""
        model = self._cache.base.fit.model
        found = {c.name: i for i, (c, _) in enumerate(scan.effects) if plausibility(c, model)[0] == 0}
        return self._with_starts(scan, statistics, found.values())

    def alike(self, at: Refit, candidate: Candidate, filter: Filter) -> list[Candidate]:
        """Candidates whose effect on the outputs through a filter is nearly the same, the nearest first."""
        scan = self._cache.scan(at)
        return self._alike(scan, scan.through(filter), candidate)

    def functions(self, at: Refit, variable: str, filter: Filter, count: int) -> list[Candidate]:
        """Return the best candidates through a filter that are functions of a variable, however alike they act."""
        scan = self._cache.scan(at)
        statistics = scan.through(filter)
        found: dict[str, Candidate] = {}
        for i in np.argsort(-(statistics.values - self._thresholds(scan))):
            candidate, shape = scan.effects[i]
            if candidate.name in found or not is_function(candidate, variable):
                continue
            found[candidate.name] = candidate
            if candidate.unit_amplitude:
                shape = scan.effects[_whole(scan, statistics, candidate)][1]
            self._cache.remember(candidate, shape, statistics.amplitudes[i])
            if len(found) == count:
                break
        return list(found.values())

    def lasting(self, at: Refit, filter: Filter, count: int) -> list[Candidate]:
        """Return the best candidates through a filter, of those that another record has too: the phase of a disturbance
        has no meaning in other data."""
        scan = self._cache.scan(at)
        lasting = np.array([c.transferable for c, _ in scan.effects])
        return self._best(scan, scan.through(filter), count, lasting)

    def _thresholds(self, scan: Scan) -> _Array:
        """Return the thresholds (effects,); infinite for what is not to be thought of."""
        left_out = ("step",) if not self._is_evident else ()
        return np.array(
            [np.inf if getattr(c, "family", "") in left_out else self._threshold(c) for c, _ in scan.effects]
        )

    @cached_property
    def _is_evident(self) -> bool:
        return is_structured(self._cache.base, self.settings.evident)

    def _best(
        self, scan: Scan, statistics: Statistics, count: int, among: NDArray[np.bool_] | None = None
    ) -> list[Candidate]:
        """Return the best candidates, one of each group that has the same effect on the outputs, or two at different
        places where the misfit is evident."""
        chosen: list[tuple[Candidate, _Array]] = []
        groups = 0
        # Of two that act alike that with fewer unknowns comes first.
        margins = statistics.values - self._thresholds(scan)
        for i in np.argsort(-margins):
            if margins[i] == -np.inf or groups == count:
                break
            candidate, shape = scan.effects[i]
            if any(candidate.name == c.name for c, _ in chosen) or not (among is None or among[i]):
                continue
            q = scan.basis(statistics, int(i))
            alike = [c for c, other in chosen if _cosine(q, other) > self.settings.same]
            # What acts alike to first order at another place need not do so where it does much.
            if alike and (len(alike) > 1 or not self._is_evident or alike[0].place == candidate.place):
                continue
            groups += not alike
            chosen.append((candidate, q))
            if candidate.unit_amplitude:
                shape = scan.effects[_whole(scan, statistics, candidate)][1]
            self._cache.remember(candidate, shape, statistics.amplitudes[i])
        return [c for c, _ in chosen]

    def _alike(self, scan: Scan, statistics: Statistics, candidate: Candidate) -> list[Candidate]:
        mine = [i for i, (c, _) in enumerate(scan.effects) if c.name == candidate.name]
        if not mine:
            return []
        best = max(mine, key=lambda i: statistics.values[i])
        found: dict[str, tuple[float, int]] = {}
        for i, cosine in enumerate(scan.cosines(statistics, scan.basis(statistics, best)).tolist()):
            name = scan.effects[i][0].name
            if name != candidate.name and cosine > max(self.settings.alias, found.get(name, (0.0, 0))[0]):
                found[name] = cosine, i
        thresholds = self._thresholds(scan)
        found = {n: (cosine, i) for n, (cosine, i) in found.items() if thresholds[i] < np.inf}
        order = sorted(found, key=lambda n: -found[n][0])
        return self._with_starts(scan, statistics, [found[n][1] for n in order])

    def _with_starts(self, scan: Scan, statistics: Statistics, effects: Iterable[int]) -> list[Candidate]:
        """Return the candidates of some effects, and have their refits start there unless another start is known."""
        found = [(scan.effects[i], statistics.amplitudes[i]) for i in effects]
        for (candidate, shape), amplitudes in found:
            if not self._cache.has_start(candidate.name):
                self._cache.remember(candidate, shape, amplitudes)
        return [candidate for (candidate, _), _ in found]


def _gains_beside(columns: _Array, errors: _Array) -> tuple[float, _Array]:
    """Return twice the gain in log-likelihood by all columns (n, k), and by each beside the others (k,)."""
    u, sizes, vt = np.linalg.svd(columns, full_matrices=False)
    kept = sizes > _RANK * sizes[0]
    along = u[:, kept].T @ errors
    coefficients = vt[kept].T @ (along / sizes[kept])
    precision = np.sum((vt[kept] / sizes[kept, None]) ** 2, axis=0)
    return float(along @ along), coefficients**2 / np.maximum(precision, 1e-300)


def _whole(scan: Scan, statistics: Statistics, candidate: Candidate) -> int:
    """Return, of a candidate whose shape is all that is unknown, the effect that gains most as it stands.

    With an amplitude c a delay of 0.2 s may pass for one of 0.2 c s. At c the gain is v, at 1 it is v (2 c - 1) / c^2.
    """

    def gain(i: int) -> float:
        c = float(statistics.amplitudes[i][0])
        return float(statistics.values[i]) * (2.0 * c - 1.0) / c**2 if c else 0.0

    return max((i for i, (c, _) in enumerate(scan.effects) if c is candidate), key=gain)


def _cosine(a: _Array, b: _Array) -> float:
    """Return the cosine of the angle between the spaces of two bases: the smaller within the other."""
    if a.shape[1] == b.shape[1] == 1:
        return abs(float(a[:, 0] @ b[:, 0]))
    return float(np.linalg.svd(a.T @ b, compute_uv=False).min())
