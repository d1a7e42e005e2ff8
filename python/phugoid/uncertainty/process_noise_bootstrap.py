"""Resampled data with other process noise and other sensor noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..errors import OptionError
from ..fit_result import FitResult
from ..starts.starts import stream
from ..transcription.filter_error import FilterError
from .filtered import of_fit
from .resample import Resampler

__all__ = ["ProcessNoiseResampler"]

_Array: TypeAlias = NDArray[np.float64]

# Number of draws that are tried, and the largest range of their motion as a multiple of the recorded one.
_TRIED, _FAR = 5, 5.0


@dataclass(frozen=True, eq=False)
class ProcessNoiseResampler(Resampler):
    """Simulates the model with the recorded inputs and drawn process noise, and adds drawn sensor noise.

    First states are those of the fit, and drawn where they have a prior.
    """

    fit: FitResult | None = None

    @classmethod
    def of(cls, fit: FitResult) -> ProcessNoiseResampler:
        """Return the resampler of a fit; raise OptionError where other noise would carry the vehicle far away."""
        found = cls(**cls.parts(fit), fit=fit)
        far = float(np.median([found._reach(stream(0, i)) for i in range(_TRIED)]))
        if not far < _FAR:
            raise OptionError(
                f"bootstrap: with other process noise the motion goes {far:.2g} times as far as in the record: its "
                "inputs were responses of a pilot or a controller to the actual noise, and an unstable vehicle "
                "needs responses to the drawn noise. Use profile"
            )
        return found

    def draw(self, random: np.random.Generator) -> list[dict[str, _Array]]:
        """Return the outputs of all experiments."""
        assert self.fit is not None
        likelihood, _ = of_fit(self.fit)
        options, problem, names = likelihood.options, likelihood.problem, self.fit.model.output_names
        assert isinstance(options, FilterError)
        first = []
        for record in self.fit.records:
            for name in self.fit.model.state_names:
                prior = (options.initial or {}).get(name)
                first.append(random.normal(*prior) if prior else record.states[name][0])
        intervals = sum(t.size - 1 for t in self.times)
        noises = random.standard_normal(intervals * problem.noises)
        found = problem.simulate(likelihood.theta(likelihood.values), np.array(first), noises)
        known = self.fit.noise.known_sigmas(names)
        sigma = [known[n] if n in known else self.fit.parameters[f"sigma_{n}"].value for n in names]
        return [
            {
                n: np.where(there[n], y + s * random.standard_normal(y.size), np.nan)
                for n, y, s in zip(names, outputs, sigma, strict=True)
            }
            for (_, outputs), there in zip(found, self.there, strict=True)
        ]

    def _reach(self, random: np.random.Generator) -> float:
        """Return the range of a drawn motion as a multiple of the recorded one, in the output where it is greatest."""
        ratios = [0.0]
        for drawn, model, there in zip(self.draw(random), self.model, self.there, strict=True):
            for name, y in drawn.items():
                here = there[name]
                if here.any() and np.ptp(model[name][here]) > 0.0:
                    ratios.append(float(np.ptp(y[here]) / np.ptp(model[name][here])))
        return float(np.max(ratios))
