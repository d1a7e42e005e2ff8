"""The search for what is missing: scan, refit the best, accept, look again at what was accepted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from ..experiment import Experiment
from ..result import Fit
from .candidate import Candidate
from .held_out import across_blocks, gain_on_other_data, on_other_data
from .refit import Refit, refit
from .scan import Scan, Statistics
from .whitening import Whitening

__all__ = ["Found", "Search"]

_Array = NDArray[np.float64]

# Probability that something is found by any candidate where there is nothing.
_FALSE = 0.01
# Refits of a round: the best by ranking, by the base filter, and with residuals taken as white.
_SHORT = (("clean", 6), ("base", 4), ("white", 3))
# Rivals that are refitted when a term is looked at again.
_AGAIN = 6
# Two effects on the outputs are the same beyond this cosine: one stands for both in refits.
_SAME = 0.995
_ALIAS = 0.95
_VUONG = 2.0
_MOST = 6


@dataclass(frozen=True, eq=False)
class Found:
    """A candidate that was accepted.

    gain      in log-likelihood over the model with the other candidates.
    rivals    those that the data do not tell from it: name -> gain they would have instead.
    held_out  gain on held-out data, and its standard deviation.
    """

    candidate: Candidate
    gain: float
    threshold: float
    rivals: Mapping[str, float]
    held_out: tuple[float, float]


@dataclass
class Search:
    """A search at a base fit.

    ``validation`` is data for held-out gains; without it blocks of the records are left out in turn.
    """

    base: Refit
    candidates: Sequence[Candidate]
    validation: Sequence[Experiment] = ()
    log: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._refits: dict[frozenset[str], Refit | None] = {frozenset(): self.base}
        self._scans: dict[frozenset[str], Scan] = {}
        self._by_name = {c.name: c for c in self.candidates}
        self._starts: dict[str, Mapping[str, float]] = {}

    # What is known of sets of candidates, each worked out once.

    def refit(self, candidates: Sequence[Candidate], near: Fit | None = None) -> Refit | None:
        """The refit of a set."""
        key = frozenset(c.name for c in candidates)
        if key not in self._refits:
            starts: dict[str, float] = {}
            for c in candidates:
                starts |= self._starts.get(c.name, {})
            self._refits[key] = refit(self.base.fit, candidates, starts, near)
        return self._refits[key]

    def scan(self, at: Refit) -> Scan:
        """The scan of all others at a set."""
        key = frozenset(at.names)
        if key not in self._scans:
            self._scans[key] = Scan(at.linear, [c for c in self.candidates if c.name not in key])
        return self._scans[key]

    def threshold(self, candidate: Candidate) -> float:
        """Twice the gain in log-likelihood that chance reaches with none of all candidates."""
        unknowns = max(len(candidate.coefficients) + len(candidate.shape_names), 1)
        tries = sum(len(c.shapes) for c in self.candidates)
        return float(chi2.isf(_FALSE / max(tries, 1), unknowns))

    def _best(self, scan: Scan, statistics: Statistics, count: int) -> list[Candidate]:
        """The best candidates, one of each group that has the same effect on the outputs."""
        beside = statistics.beside
        chosen: list[tuple[Candidate, _Array]] = []
        for i in np.argsort(-statistics.values):
            candidate, shape = scan.effects[i]
            if any(candidate is c for c, _ in chosen):
                continue
            q = _unit(beside[scan.groups[i]].T)
            if any(_cosine(q, other) > _SAME for _, other in chosen):
                continue
            chosen.append((candidate, q))
            amplitude = statistics.amplitudes[i]
            start = dict(zip(candidate.coefficients, amplitude.tolist(), strict=False))
            self._starts[candidate.name] = {**start, **shape}
            if len(chosen) == count:
                break
        return [c for c, _ in chosen]

    def _tries(self, at: Refit) -> list[Refit]:
        """Refits with one more candidate."""
        scan = self.scan(at)
        if not scan.effects:
            return []
        clean = scan.clean()
        filters = {"white": scan.white.filter, "base": at.own.filter, "clean": clean}
        names: dict[str, Candidate] = {}
        for which, count in reversed(_SHORT):
            for c in self._best(scan, scan.through(filters[which]), count):
                names[c.name] = c
        tries = [self.refit([*at.candidates, c], at.fit) for c in names.values()]
        return [t for t in tries if t is not None]

    def _own(self, at: Refit) -> float:
        return at.own.log_likelihood

    def _gain(self, base: Refit, more: Refit, filter: Whitening | None = None) -> float:
        """Twice the gain in log-likelihood, each with the likeliest filter, or both through one."""
        if filter is None:
            return 2.0 * (self._own(more) - self._own(base))
        return 2.0 * (more.through(filter).log_likelihood - base.through(filter).log_likelihood)

    def run(self) -> tuple[Refit, list[Found]]:
        """The model with all that was found."""
        current = self.base
        accepted: dict[frozenset[str], list[Found]] = {frozenset(): []}
        while len(current.candidates) < _MOST:
            following = self._step(current)
            if following is None:
                break
            current = following
        founds = [self._found(current, c) for c in current.candidates]
        del accepted
        return current, founds

    def _step(self, current: Refit) -> Refit | None:
        """One more term, or None where none is significant."""
        tries = self._tries(current)
        margins = {t.names: self._gain(current, t) - self.threshold(t.candidates[-1]) for t in tries}
        for t in tries:
            self.log.append(f"{'+'.join(t.names)}: {margins[t.names]:.1f} over its threshold")
        significant = [t for t in tries if margins[t.names] > 0]
        if not significant:
            return None
        best = max(significant, key=lambda t: margins[t.names])
        return self._settled(best, current)

    def _settled(self, at: Refit, before: Refit) -> Refit | None:
        """With each term replaced by a better one where there is one, until nothing changes."""
        for _ in range(4):
            changed = False
            for candidate in reversed(at.candidates):
                ranked = self._rivals(at, candidate)
                if ranked and ranked[0][0].names != at.names and ranked[0][1] > 0:
                    at, changed = ranked[0][0], True
                    break
            if not changed:
                break
        return at if self._gain(before, at) > 0 else None

    def _rivals(self, at: Refit, candidate: Candidate) -> list[tuple[Refit, float]]:
        """Refits with another in place of a candidate, and how much more likely they are through the same filter, less
        what the thresholds differ; the best first."""
        others = [c for c in at.candidates if c is not candidate]
        without = self.refit(others, at.fit)
        if without is None:
            return [(at, 0.0)]
        scan = self.scan(without)
        filter = at.own.filter
        tries = [self.refit([*others, c], at.fit) for c in self._best(scan, scan.through(filter), _AGAIN)]
        known = [
            r
            for key, r in self._refits.items()
            if r is not None and len(key) == len(at.candidates) and key > frozenset(c.name for c in others)
        ]
        found = {t.names: t for t in [*tries, *known, at] if t is not None}
        reference = at.through(filter).log_likelihood
        q = self.threshold(candidate)

        def margin(r: Refit) -> float:
            new = [c for c in r.candidates if c not in others]
            own = self.threshold(new[0])
            return 2.0 * (r.through(filter).log_likelihood - reference) - (own - q)

        return sorted(((r, margin(r)) for r in found.values()), key=lambda pair: -pair[1])

    def _found(self, at: Refit, candidate: Candidate) -> Found:
        others = [c for c in at.candidates if c is not candidate]
        without = self.refit(others, at.fit)
        assert without is not None
        filter = at.own.filter
        mine = at.through(filter).log_densities
        rivals = {}
        for r, _ in self._rivals(at, candidate):
            if r.names == at.names:
                continue
            (other,) = [c for c in r.candidates if c not in others]
            d = mine - r.through(filter).log_densities
            d = d[np.isfinite(d)]
            spread = float(np.sqrt(d.size) * d.std())
            if float(d.sum()) < _VUONG * spread:
                rivals[other.name] = self._gain(without, r) / 2
        for name in self._alike(without, candidate, filter):
            rivals.setdefault(name, float("nan"))
        return Found(
            candidate,
            self._gain(without, at) / 2,
            self.threshold(candidate) / 2,
            rivals,
            self.held_out(without, at),
        )

    def _alike(self, without: Refit, candidate: Candidate, filter: Whitening) -> list[str]:
        """Names of candidates whose effect on the outputs is nearly the same."""
        scan = self.scan(without)
        beside = scan.through(filter).beside
        mine = [i for i, (c, _) in enumerate(scan.effects) if c.name == candidate.name]
        if not mine:
            return []
        q = [_unit(beside[scan.groups[i]].T) for i in mine]
        found = {}
        for i, (c, _) in enumerate(scan.effects):
            if c.name != candidate.name and c.name in self._by_name:
                other = _unit(beside[scan.groups[i]].T)
                cosine = max(_cosine(a, other) for a in q)
                if cosine > _ALIAS:
                    found[c.name] = max(found.get(c.name, 0.0), cosine)
        return sorted(found, key=lambda n: -found[n])

    def held_out(self, base: Refit, more: Refit) -> tuple[float, float]:
        """Gain on held-out data and its standard deviation."""
        if self.validation:
            others = on_other_data(base, self.validation)
            return gain_on_other_data(others, on_other_data(more, self.validation, others))
        return across_blocks(base, more)


def _unit(columns: _Array) -> _Array:
    """An orthonormal basis of columns."""
    if columns.shape[1] == 1:
        return np.asarray(columns / max(float(np.linalg.norm(columns)), 1e-300))
    return np.asarray(np.linalg.qr(columns)[0])


def _cosine(a: _Array, b: _Array) -> float:
    """Of the angle between the spaces of two bases: the smaller within the other."""
    return float(np.linalg.svd(a.T @ b, compute_uv=False).min())

