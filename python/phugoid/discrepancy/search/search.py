"""The search for what is missing: scan, refit the best, accept, look again at what was accepted."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..candidates.candidate import Candidate
from .refit import HeldOut, Refit
from .scan import Scan, Statistics
from .trials import Trials

__all__ = ["MOST", "Found", "Search", "is_physical"]

_Array = NDArray[np.float64]

# Refits of a round: the best by ranking, by the base filter, and with residuals taken as white; and those that explain
# what the best ones leave.
_SHORT = (("clean", 6), ("base", 4), ("white", 2))
_DIFFERENT = 4
# What is this far below its threshold in the scan, by the base filter and by the clean one, is not refitted.
_HOPELESS = (0.4, 0.8)
# Rivals that are refitted when a term is looked at again, and those whose effect is nearly the same.
_AGAIN, _ALIKE = 4, 3
# Two effects on the outputs are the same beyond this cosine: one stands for both in a shortlist.
_SAME = 0.995
# Beyond this one they are aliases, whatever their refits say.
_ALIAS = 0.95
# Estimates with a correlation below this are taken as independent.
_APART = 0.3
# A rival is an alias unless Vuong's test tells them apart by this.
_VUONG = 2.0
# Twice the gain in log-likelihood by which a cause outside of what is physical must be ahead.
_UNPHYSICAL = 6.0
# The gain on held-out data must be above this, and above this part of its standard deviation.
_HELD_OUT, _SURE = 1.0, 0.5
# A misfit that no candidate explains is told of when twice the gain of the best is this often its threshold.
_CLEAR = 1.5
# Candidates that are refitted where residuals ring.
_RINGING = 2
# Next best candidates that are tried when the best gains nothing on held-out data.
_CHANCES = 3
# Findings at most: what is left then is for another diagnosis, of the extended model.
MOST = 4


@dataclass(frozen=True, eq=False)
class Found:
    """A candidate that was accepted, or a misfit that none explains (``candidate`` None).

    ringing   Hz, of modes of the model at which the residuals ring, where that is what none explains beyond doubt.
    gain      in log-likelihood over the model with the other candidates.
    threshold that it had to pass.
    rivals    those that the data do not tell from it: name -> gain they would have instead, the likeliest first.
    """

    candidate: Candidate | None
    gain: float
    threshold: float
    rivals: Mapping[str, float]
    held_out: HeldOut
    ringing: tuple[float, ...] = ()


class Search(Trials):
    """A search at a base fit, for `Trials` of candidates that it chooses."""

    def run(self) -> tuple[Refit, list[Found], bool]:
        """The model with all that was found, what that is, and whether the search was interrupted."""
        current, found, unexplained = self.base, [], None
        try:
            while len(current.candidates) < MOST:
                following, unexplained = self._step(current)
                if following is None:
                    break
                current = following
            unexplained = unexplained or self._ringing_by(current)
            left = self.ringing(current)
            if left and not (unexplained and unexplained.ringing):
                self.remarks.append(_rest_rings(left.frequencies))
            found = [self._found(current, c) for c in current.candidates]
        except KeyboardInterrupt:
            nothing = HeldOut(float("nan"), 0.0, float("nan"))
            found = [Found(c, float("nan"), self.threshold(c) / 2, {}, nothing) for c in current.candidates]
            return current, found, True
        return current, found + ([unexplained] if unexplained else []), False

    def _step(self, current: Refit) -> tuple[Refit | None, Found | None]:
        """The model with one more term, if one is accepted; else what remains unexplained, if anything does."""
        tries = self._tries(current)
        margins = {t.names: self.gain(current, t) - self.needed(t, t.candidates[-1]) for t in tries}
        self.log += [f"{'+'.join(names)}: {m:.1f} over its threshold" for names, m in margins.items()]

        def urgency(t: Refit) -> float:
            # What is outside of what is physical stands in for something else: that is tried first.
            last = t.candidates[-1]
            return margins[t.names] - (0.0 if is_physical(t, last) else self.needed(t, last))

        significant = sorted((t for t in tries if margins[t.names] > 0), key=lambda t: -urgency(t))
        unexplained, chances = None, _CHANCES
        rejected: set[str] = set()
        known: set[str] = set()
        for t in significant:
            if not chances:
                break
            if t.candidates[-1].name in rejected:
                continue
            settled = self._settled(t, rejected)
            new = settled.beside(current.candidates)
            kept = [c for c in settled.candidates if c.name in current.names]
            below = self.refit(kept, settled.fit)
            # With the new term an earlier one may have become needless: then the two sets compete.
            fewer = len(kept) < len(current.candidates) and settled.own.merit <= current.own.merit
            if not new or below is None or fewer:
                continue
            gain, threshold = self.gain(below, settled), self.needed(settled, new[0])
            if gain <= threshold:
                continue
            held = self.held_out(below, settled)
            numbers = f"{held.gain:.1f} +- {held.deviation:.1f}, {held.elsewhere:.1f}"
            self.log.append(f"{'+'.join(settled.names)}: held-out {numbers}")
            if _predicts(held) and not any(self.rings_too(settled, c) for c in new):
                return settled, None
            rejected |= {c.name for c in new}
            # What acts as another did is no further chance: of two that are alike one may still predict.
            chances -= not known.issuperset(c.name for c in new)
            scan = self.scan(current)
            statistics = scan.through(settled.own.filter)
            known |= {other.name for c in new for other in self._alike(scan, statistics, c)}
            if unexplained is None and gain > _CLEAR * threshold:
                unexplained = Found(None, gain / 2, threshold / 2, {c.name: gain / 2 for c in new}, held)
        return None, unexplained

    def _ringing_by(self, current: Refit) -> Found | None:
        """A misfit that noise as coloured as the residuals would swallow: they ring, and candidates that explain them
        by noise that does not halve them on validation data."""
        ringing = self.ringing(current)
        if ringing is None or not self.validation:
            return None
        scan = self.scan(current)
        # The phase of a disturbance is for no other data to tell.
        lasting = np.array([c.transferable for c, _ in scan.effects])
        chosen = self._best(scan, scan.through(ringing.filter), _RINGING, lasting)
        self.refits([[*current.candidates, c] for c in chosen], current.fit)
        margins = {}
        for t in [t for t in self._refits.values() if t and len(t.candidates) == len(current.candidates) + 1]:
            new, *others = t.beside(current.candidates)
            if new.transferable and not others:
                margins[t] = self.steady_gain(current, t) - self._cost(t, current.candidates)
        likely = [t for t in sorted(margins, key=lambda t: -margins[t])[:_CHANCES] if margins[t] > 0.0]
        better = [t for t in likely if self.halves(current, t) and _predicts(self.held_out(current, t))]
        if not better:
            return None
        gains = {t.beside(current.candidates)[0].name: self.steady_gain(current, t) / 2 for t in better}
        name, gain = next(iter(gains.items()))
        self.log.append(f"residuals ring at {ringing.frequencies} Hz: {name} gains {gain:.1f} by noise that does not")
        return Found(
            None, gain, self.threshold() / 2, gains, self.held_out(current, better[0]), ringing=ringing.frequencies
        )

    def _tries(self, at: Refit) -> list[Refit]:
        """Refits with one more candidate."""
        scan = self.scan(at)
        if not scan.effects:
            return []
        filters = {"white": scan.white.filter, "base": at.own.filter, "clean": scan.clean()}
        statistics = {which: scan.through(filter) for which, filter in filters.items()}
        thresholds = np.array([self.threshold(c) for c, _ in scan.effects])
        hopeless = (statistics["base"].values < _HOPELESS[0] * thresholds) & (
            statistics["clean"].values < _HOPELESS[1] * thresholds
        )
        names: dict[str, Candidate] = {}
        for which, count in reversed(_SHORT):
            for c in self._best(scan, statistics[which], count, ~hopeless):
                names[c.name] = c
        for i in scan.different(statistics["base"], _DIFFERENT):
            candidate, shape = scan.effects[i]
            if candidate.name not in names and not hopeless[i]:
                names[candidate.name] = candidate
                self._remember(candidate, shape, statistics["base"].amplitudes[i])
        tries = self.refits([[*at.candidates, c] for c in names.values()], at.fit)
        return [t for t in tries if t is not None]

    def _best(
        self, scan: Scan, statistics: Statistics, count: int, among: NDArray[np.bool_] | None = None
    ) -> list[Candidate]:
        """The best candidates, one of each group that has the same effect on the outputs."""
        chosen: list[tuple[Candidate, _Array]] = []
        # Of two that act alike that with fewer unknowns comes first.
        margins = statistics.values - np.array([self.threshold(c) for c, _ in scan.effects])
        for i in np.argsort(-margins):
            candidate, shape = scan.effects[i]
            if any(candidate.name == c.name for c, _ in chosen) or not (among is None or among[i]):
                continue
            q = scan.basis(statistics, int(i))
            if any(_cosine(q, other) > _SAME for _, other in chosen):
                continue
            chosen.append((candidate, q))
            if candidate.unit_amplitude:
                shape = scan.effects[_whole(scan, statistics, candidate)][1]
            self._remember(candidate, shape, statistics.amplitudes[i])
            if len(chosen) == count:
                break
        return [c for c, _ in chosen]

    def _settled(self, at: Refit, rejected: Collection[str] = ()) -> Refit:
        """With terms replaced by better ones where there are any, until nothing changes; without those that are no
        longer significant."""
        for _ in range(4):
            following = next((r for r in self._better(at, rejected) if r is not at), at)
            if following is at:
                break
            at = following
        return at

    def _better(self, at: Refit, rejected: Collection[str]) -> Iterator[Refit]:
        """For each term the best with another one, or with none, in its place; the last term first."""
        for candidate in reversed(at.candidates):
            others = [c for c in at.candidates if c is not candidate]
            if others and candidate is not at.candidates[-1] and self._apart(at, candidate, at.candidates[-1]):
                continue
            without = self.refit(others, at.fit)
            if others and without is not None and self.gain(without, at) < self.threshold(candidate):
                yield without
            for r, _ in self._rivals(at, candidate):
                if r is at:
                    break
                # Another must be significant itself, whatever the filter of the first makes of it.
                (new,) = r.beside(others)
                sure = without is None or self.gain(without, r) > self.needed(r, new)
                if sure and not any(n in rejected for n in r.names):
                    yield r
                    break

    def _apart(self, at: Refit, one: Candidate, other: Candidate) -> bool:
        """Whether the estimates of two candidates hardly depend on each other: neither casts doubt on the other."""
        return at.own.correlation(one.parameters, other.parameters) < _APART

    def _rivals(self, at: Refit, candidate: Candidate) -> list[tuple[Refit, float]]:
        """Refits with another in place of a candidate, and how much more likely they are through the same filter, less
        what the thresholds differ; the best first."""
        others = [c for c in at.candidates if c is not candidate]
        without = self.refit(others, at.fit)
        if without is None:
            return [(at, 0.0)]
        scan = self.scan(without)
        filter = at.own.filter
        statistics = scan.through(filter)
        wanted = [*self._best(scan, statistics, _AGAIN), *self._alike(scan, statistics, candidate)[:_ALIKE]]
        self.refits([[*others, c] for c in wanted], at.fit)
        base = frozenset(c.name for c in others)
        refits = [r for key, r in self._refits.items() if r and len(key) == len(base) + 1 and key > base]
        reference = at.through(filter).log_likelihood - self._cost(at, others) / 2

        def margin(r: Refit) -> float:
            return 2.0 * (r.through(filter).log_likelihood - reference) - self._cost(r, others)

        pairs = [(r, 0.0 if r.names == at.names else margin(r)) for r in refits]
        if not any(r is at for r, _ in pairs):
            pairs.append((at, 0.0))
        return sorted(pairs, key=lambda pair: (-pair[1], pair[0] is not at))

    def _cost(self, at: Refit, others: Sequence[Candidate]) -> float:
        """What counts against a refit's new term: the chances that it had, and to be out of what is physical."""
        (new,) = at.beside(others)
        return self.threshold(new) + (0.0 if is_physical(at, new) else _UNPHYSICAL)

    def _alike(self, scan: Scan, statistics: Statistics, candidate: Candidate) -> list[Candidate]:
        """Candidates whose effect on the outputs is nearly the same, the nearest first."""
        mine = [i for i, (c, _) in enumerate(scan.effects) if c.name == candidate.name]
        if not mine:
            return []
        best = max(mine, key=lambda i: statistics.values[i])
        found: dict[str, tuple[float, int]] = {}
        for i, cosine in enumerate(scan.cosines(statistics, scan.basis(statistics, best)).tolist()):
            name = scan.effects[i][0].name
            if name != candidate.name and cosine > max(_ALIAS, found.get(name, (0.0, 0))[0]):
                found[name] = cosine, i
        order = sorted(found, key=lambda n: -found[n][0])
        for name in order:
            if name not in self._starts:
                i = found[name][1]
                self._remember(scan.effects[i][0], scan.effects[i][1], statistics.amplitudes[i])
        return [scan.effects[found[n][1]][0] for n in order]

    def _found(self, at: Refit, candidate: Candidate) -> Found:
        """What is to be said of a term in the end."""
        others = [c for c in at.candidates if c is not candidate]
        without = self.refit(others, at.fit) or self.base
        filter = at.own.filter
        mine = at.through(filter).log_densities
        scan = self.scan(without)
        alike = {c.name for c in self._alike(scan, scan.through(filter), candidate)}
        rivals = {}
        for r, _ in self._rivals(at, candidate):
            if r.names == at.names:
                continue
            (other,) = r.beside(others)
            d = mine - r.through(filter).log_densities
            d = d[np.isfinite(d)]
            gain = self.gain(without, r) / 2
            like = other.name in alike and gain > 0.5 * self.gain(without, at) / 2
            if like or float(d.sum()) < _VUONG * float(np.sqrt(d.size) * d.std()):
                rivals[other.name] = gain
        return Found(
            candidate,
            self.gain(without, at) / 2,
            self.needed(at, candidate) / 2,
            rivals,
            self.held_out(without, at),
        )


def _whole(scan: Scan, statistics: Statistics, candidate: Candidate) -> int:
    """Of a candidate whose shape is all that is unknown: the one that gains most as it stands.

    With an amplitude c a delay of 0.2 s may pass for one of 0.2 c s. At c the gain is v, at 1 it is v (2 c - 1) / c^2.
    """

    def gain(i: int) -> float:
        c = float(statistics.amplitudes[i][0])
        return float(statistics.values[i]) * (2.0 * c - 1.0) / c**2 if c else 0.0

    return max((i for i, (c, _) in enumerate(scan.effects) if c is candidate), key=gain)


def is_physical(at: Refit, candidate: Candidate) -> bool:
    """Whether all parameters of a candidate lie within what is physical."""
    limits = candidate.physical(at.linear.points)
    return all(low <= at.own.parameter(n)[0] <= high for n, (low, high) in limits.items())


def _rest_rings(frequencies: Sequence[float]) -> str:
    at = ", ".join(f"{f:.3g}" for f in frequencies)
    return (
        f"What is left of the residuals rings at {at} Hz, a lightly damped mode of the model: disturbances that come "
        "through the vehicle do that, and so does a term that the model lacks. Noise as coloured as that hides either."
    )


def _predicts(held: HeldOut) -> bool:
    """Whether a gain on held-out data is one."""
    return held.gain > max(_HELD_OUT, _SURE * held.deviation) and held.elsewhere > 0.0


def _cosine(a: _Array, b: _Array) -> float:
    """Of the angle between the spaces of two bases: the smaller within the other."""
    if a.shape[1] == b.shape[1] == 1:
        return abs(float(a[:, 0] @ b[:, 0]))
    return float(np.linalg.svd(a.T @ b, compute_uv=False).min())
