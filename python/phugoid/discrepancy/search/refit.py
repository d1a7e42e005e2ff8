"""A model with candidates added, fitted, and what its likelihood is with coloured noise."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...errors import PhugoidError
from ...estimation.estimate import estimate
from ...parameters import Estimates
from ...result import Fit
from ...solvers import Newton
from ...solvers.limits import TimeUp
from ..candidates.candidate import Candidate
from ..colour.joint import Filter
from .least_squares import Whitened, joint_whitening, own_whitening
from .linearised import Linearised, dataset

__all__ = ["Refit", "refit", "started_from"]

# A refit goes on from a fit nearby: one that needs more goes nowhere.
_ITERATIONS = 40
# Delays are found to this part of their standard errors: to first order in what is left the rest is allowed for.
_SETTLED = 0.03
# Within so many passes, for the scan knows them well: what goes on then wanders off, or back and forth over a kink.
_PASSES = 8


@dataclass(frozen=True, eq=False)
class Refit:
    """Candidates, in the order in which they were found, and the fit of the model with all of them."""

    candidates: tuple[Candidate, ...]
    fit: Fit

    @cached_property
    def linear(self) -> Linearised:
        """About this fit."""
        return Linearised(self.fit)

    @cached_property
    def own(self) -> Whitened:
        """Through the filter that is the likeliest with it."""
        return own_whitening(self.linear)

    @cached_property
    def together(self) -> Whitened | None:
        """Through the likeliest filter of all channels together, where that is the better model of the noise."""
        return joint_whitening(self.own)

    @property
    def merit(self) -> float:
        """Log-likelihood with the best noise model, less what that costs by Akaike's criterion."""
        return (self.together or self.own).lenient_merit

    def through(self, filter: Filter) -> Whitened:
        """Through another's filter."""
        return Whitened(self.linear, filter.on(self.linear.structure))

    @property
    def names(self) -> tuple[str, ...]:
        """Of the candidates."""
        return tuple(c.name for c in self.candidates)

    def beside(self, others: Collection[Candidate]) -> list[Candidate]:
        """Its candidates beside others; by name, for one candidate may be centred in several ways."""
        names = {c.name for c in others}
        return [c for c in self.candidates if c.name not in names]

    def inflation(self, candidate: Candidate) -> float:
        """By how much the evidence for a candidate is less than the filter has it."""
        return max(self.own.inflation(name) for name in candidate.parameters)

    def parameters(self, candidate: Candidate) -> dict[str, tuple[float, float]]:
        """Value and standard error, for coloured noise, of a candidate's parameters."""
        inflation = float(np.sqrt(self.linear.n_rows / max(self.linear.n_rows - self.own.basis.shape[1], 1)))
        found = {}
        for name in candidate.parameters:
            value, error = self.own.parameter(name)
            found[name] = float(value), float(error * inflation * np.sqrt(self.own.inflation(name)))
        return found


def refit(
    base: Fit, candidates: Sequence[Candidate], starts: Mapping[str, float], near: Fit | None = None
) -> Refit | None:
    """The base model with candidates, fitted from the values in ``starts`` and a fit nearby.

    None where there is no such model or the solver does not come to an end.
    """
    model = base.model
    try:
        for candidate in sorted(candidates, key=lambda c: c.stage):
            own = {n: starts[n] for n in candidate.parameters if n in starts}
            model = candidate.extended(model, own)
        if model.delays:
            model = model._around(model._core, replace(model.delays, settled=_SETTLED, passes=_PASSES))
        fit = estimate(
            model,
            dataset(base),
            transcription=base.transcription,
            noise=base.noise,
            start=started_from(near or base, model.parameter_names),
            solver=Newton(max_iterations=_ITERATIONS),
        )
    except PhugoidError:
        return None
    if fit.status == "time limit":
        raise TimeUp
    if fit.status == "interrupted":
        raise KeyboardInterrupt
    return Refit(tuple(candidates), fit) if fit.status in ("converged", "acceptable") else None


def started_from(near: Fit, names: Collection[str]) -> Fit:
    """A fit as a start: its path, and of its parameters those of the noise and those in ``names``."""
    kept = {*names} | near.noise_parameters
    return replace(near, parameters=Estimates(e for n, e in near.parameters.items() if n.partition("[")[0] in kept))
