"""What is known of sets of candidates: their refits, scans beside them, gains and what these must be."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextvars import copy_context
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from numpy.typing import NDArray

from ...data.experiment import Experiment
from ...errors import PhugoidError
from ...fit_result import FitResult
from ...residual_noise.whitening import Whitening
from ...sensitivities.linearised import Linearised
from ...solvers.limits import check_time
from ...validation.biases import freed_by_default
from ..candidates.candidate import Candidate, with_other_centres
from .refit import HeldOut, Refit, across_blocks, gain_on_other_data, on_other_data, refit
from .ringing import Ringing, is_near, light_modes, ringing_of
from .scan import Scan

__all__ = ["Trials"]

_Array = NDArray[np.float64]


# Probability that anything at all is found where there is nothing.
_FALSE = 0.01
# Factor of a threshold where channels go together: simulated turbulence passes less than one in twenty times.
_DOUBTFUL = 1.5
# Part of a mean square that is left where a candidate explains the better part of a misfit.
_HALF = 0.5
# Refits side by side: the solver works without the interpreter's lock.
_WORKERS = 4


@dataclass
class Trials:
    """Trials of candidates at a base fit, each worked out once.

    ``validation`` is data for held-out gains; without it blocks of the records are left out in turn. ``biases`` are the
    parameters of the base that are estimated anew there; None: those of sensors. ``watch`` is called with what is done.
    """

    base: Refit
    candidates: Sequence[Candidate]
    validation: Sequence[Experiment] = ()
    watch: Callable[[str], None] = lambda _: None
    biases: Sequence[str] | None = None
    log: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._refits: dict[frozenset[str], Refit | None] = {frozenset(): self.base}
        self._scans: dict[frozenset[str], Scan] = {}
        self._others: dict[frozenset[str], Linearised | None] = {}
        self._starts: dict[str, Mapping[str, float]] = {}
        self._modes = light_modes(self.base.fit)
        self._ringing: dict[frozenset[str], Ringing | None] = {}
        self.candidates = with_other_centres(self.candidates, self.base.linear.points)
        self._tries_in_all = sum(len(c.shapes) for c in self.candidates)

    def refit(self, candidates: Sequence[Candidate], near: FitResult | None = None) -> Refit | None:
        """The refit of a set."""
        return self.refits([candidates], near)[0]

    def refits(self, sets: Sequence[Sequence[Candidate]], near: FitResult | None = None) -> list[Refit | None]:
        """The refits of several sets, side by side."""
        check_time()
        keys = [frozenset(c.name for c in candidates) for candidates in sets]
        new = {key: candidates for key, candidates in zip(keys, sets, strict=True) if key not in self._refits}

        def one(candidates: Sequence[Candidate]) -> Refit | None:
            starts: dict[str, float] = {}
            for c in candidates:
                starts |= self._starts.get(c.name, {})
            found = refit(self.base.fit, candidates, starts, near)
            if found is not None:
                _ = found.merit  # here, for it takes as long
            return found

        for candidates in new.values():
            self.watch("fitting with " + ", ".join(c.name for c in candidates))
        if len(new) == 1:
            self._refits |= {key: one(candidates) for key, candidates in new.items()}
        elif new:
            from concurrent.futures import ThreadPoolExecutor  # not at import

            executor = ThreadPoolExecutor(min(len(new), _WORKERS))
            try:
                # Each thread works within the limit in force here.
                tasks = [executor.submit(copy_context().run, one, candidates) for candidates in new.values()]
                self._refits |= {key: task.result() for key, task in zip(new, tasks, strict=True)}
            finally:
                executor.shutdown(cancel_futures=True)
        return [self._refits[key] for key in keys]

    def scan(self, at: Refit) -> Scan:
        """The scan of all others at a set."""
        key = frozenset(at.names)
        for other, scan in self._scans.items():
            if other != key:
                scan.forget()
        if key not in self._scans:
            self.watch("scanning all candidates" + (" beside " + ", ".join(at.names) if at.names else ""))
            self._scans[key] = Scan(at.linear, [c for c in self.candidates if c.name not in key])
        return self._scans[key]

    def threshold(self, candidate: Candidate | None = None) -> float:
        """Twice the gain in log-likelihood that chance reaches with none of all candidates; without a candidate that
        for those with one unknown."""
        unknowns = len(candidate.parameters) if candidate else 1
        return _quantile(max(unknowns, 1), _FALSE / max(self._tries_in_all, 1))

    def needed(self, more: Refit, candidate: Candidate) -> float:
        """Twice the gain that a candidate must have: its threshold, and more where the noise goes through the vehicle
        itself, for then its model is no more than an approximation."""
        return self.threshold(candidate) * (1.0 if more.together is None else _DOUBTFUL)

    def gain(self, base: Refit, more: Refit) -> float:
        """Twice the gain in log-likelihood, each with its likeliest noise and less what that costs.

        The less of two: with noise channel by channel, as much less as the estimates of the new terms are less certain
        than that noise has them; and with noise of all channels together, where that is the better model. One gust
        moves all channels, and is no evidence for each of them.
        """
        inflation = max((more.inflation(c) for c in more.beside(base.candidates)), default=1.0)
        return 2.0 * min((more.own.merit - base.own.merit) / inflation, more.merit - base.merit)

    def try_validation(self) -> None:
        """Fits the base to the validation data, where there are any. Raises ModelError or DataError where they cannot
        serve: the user is to know before the search."""
        if self.validation:
            self.watch("fitting the validation data")
            self._on_other_data(self.base, None)

    def held_out(self, base: Refit, more: Refit) -> HeldOut:
        """Gain on held-out data; none where the model cannot be fitted there."""
        new = more.beside(base.candidates)
        others = self._on_other_data(base, None) if self.validation else None
        if others is None or not all(c.transferable for c in new):
            return across_blocks(base, more, new)
        mine = self._on_other_data(more, others)
        return HeldOut(-np.inf, 0.0, -np.inf) if mine is None else gain_on_other_data(others, mine)

    def held_out_rms(self, at: Refit) -> dict[str, float]:
        """Output -> RMS on the validation data, first states and biases as they fit best; empty without such data."""
        linear = self._on_other_data(at, None) if self.validation else None
        if linear is None:
            return {}
        found = {}
        for name, line in zip(linear.model.output_names, linear.rows, strict=True):
            r = linear.residuals[line[0].start : line[-1].stop]
            found[name] = float(np.sqrt(np.mean(r**2)))
        return found

    def ringing(self, at: Refit) -> Ringing | None:
        """What rings in the residuals of a set at lightly damped modes of the base; None where nothing does."""
        key = frozenset(at.names)
        if key not in self._ringing:
            filter = at.own.filter
            assert isinstance(filter, Whitening)  # channel by channel
            found = ringing_of(filter, at.own.residuals, at.linear, self._modes) if self._modes.size else None
            self._ringing[key] = found
        return self._ringing[key]

    def rings_too(self, at: Refit, candidate: Candidate) -> bool:
        """Whether a candidate is a disturbance at the frequency of a mode at which the residuals of the base ring: a
        tone there, and noise that came through the mode, are too much alike."""
        ringing = self.ringing(self.base)
        if candidate.transferable or ringing is None:
            return False
        tones = [at.fit.parameters[n].value / (2.0 * np.pi) for n in candidate.shape_names]
        return any(is_near(tone, f) for tone in tones for f in ringing.frequencies)

    def steady_gain(self, base: Refit, more: Refit) -> float:
        """Twice the gain in log-likelihood by noise as large as the residuals of the base, that does not ring."""
        ringing = self.ringing(base)
        filter = ringing.filter if ringing else base.own.filter
        return 2.0 * (more.through(filter).log_likelihood - base.through(filter).log_likelihood)

    def halves(self, base: Refit, more: Refit) -> bool:
        """Whether the mean square of the residuals on the validation data is halved, in the mean of the outputs."""
        before, after = self.held_out_rms(base), self.held_out_rms(more)
        return bool(before and after) and float(np.mean([(after[n] / before[n]) ** 2 for n in before])) < _HALF

    def _on_other_data(self, at: Refit, near: Linearised | None) -> Linearised | None:
        key = frozenset(at.names)
        if key not in self._others:
            try:
                self._others[key] = on_other_data(at, self.validation, near, self._free(at))
            except PhugoidError:
                if not key:
                    raise
                self._others[key] = None
        return self._others[key]

    def _free(self, at: Refit) -> Sequence[str] | None:
        """What is estimated anew on other data: of the base what was asked for, and biases that were found."""
        if self.biases is None:
            return None
        base = self.base.fit.model.parameter_names
        return [*self.biases, *(n for n in freed_by_default(at.fit.model) if n not in base)]

    def _remember(self, candidate: Candidate, shape: Mapping[str, float], amplitude: _Array) -> None:
        """Where a refit starts."""
        self._starts[candidate.name] = {
            **dict(zip(candidate.coefficients, amplitude.tolist(), strict=False)),
            **shape,
        }


@cache
def _quantile(freedom: int, probability: float) -> float:
    """Of chi-square, from above."""
    from scipy.special import chdtri  # not at import: it takes its time

    return float(chdtri(freedom, probability))
