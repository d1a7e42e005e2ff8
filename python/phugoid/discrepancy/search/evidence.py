"""The decision whether a cause is named: its evidence, and the thresholds for it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...goodness_of_fit import chi_square_quantile
from ...residual_noise.whitening import Whitening
from ...sensitivities.whitened import Whitened
from ..candidates.candidate import Candidate, Effect
from ..candidates.terms import Periodic
from .admissibility import follows_noise, is_determined, is_physical, is_plausible
from .free_run import Explained, Misfitting, Simulated
from .refit import HeldOut, LeftOut, Refit, across_blocks, gain_on_other_data, is_structured
from .refit_cache import RefitCache
from .ringing import is_near, random_walk_gain
from .screen import RICH, complexity

__all__ = [
    "Assessment",
    "AssessmentSettings",
    "Evidence",
]

# Families of candidates that depend on the time in a record alone.
_DRIFTS = ("drift", "variation", "step")


@dataclass(frozen=True)
class AssessmentSettings:
    """Set what evidence must be.

    false_alarm  probability that anything at all is found where there is nothing.
    doubtful     factor of a threshold where channels go together, or measurements are rounded: simulated turbulence
                 passes less than one in twenty times.
    unphysical   twice the gain in log-likelihood by which a cause outside of what is physical must be ahead.
    held_out     what the gain on held-out data must be above, and ``sure`` the part of its standard deviation.
    clear        a misfit that no candidate explains is reported when twice the gain of the best is this often its
                 threshold.
    half         part of a mean square that is left where a candidate explains the better part of a misfit.
    fraction     of what a term leaves of a misfit, below which a drift is ahead of it by what that leaves.
    minor        part of the misfit's power: what explains less in free simulation is a minor finding.
    error        part of the residuals' power that their past predicts, from which on they are error of the model.
    most         part of such a misfit that free simulation of held-out data must be freed of.
    chance       probability that noise of a validation record passes for a disturbance of a known frequency.
    plainly      times its threshold beyond which a gain is no random walk of a sensor.
    far          times the RMS of residuals on data held out, of that in the fit, beyond which the model is wrong there.
    moved        what two models differ by on data held out, as a sum of squares in units of the noise, below which
                 these do not distinguish them: the gain of the better one is half of that.
    """

    false_alarm: float = 0.01
    doubtful: float = 1.5
    unphysical: float = 6.0
    held_out: float = 1.0
    sure: float = 0.5
    clear: float = 1.5
    half: float = 0.5
    fraction: float = 0.2
    minor: float = 0.05
    error: float = 0.6
    most: float = 0.5
    chance: float = 0.05
    plainly: float = 5.0
    far: float = 3.0
    moved: float = 9.0


@dataclass(frozen=True)
class Evidence:
    """The evidence for what one model has and another has not.

    gain       twice the gain in log-likelihood, with coloured noise.
    threshold  that it must pass.
    clear      that it must pass where nothing is named.
    held_out   the gain on held-out data; None where the other gain is no more than chance gives.
    predicts   whether that is a gain.
    explained  the part of the misfit that is explained in free simulation of held-out data; None like ``held_out``,
               and where the model cannot be fitted there.
    rings      whether it is a disturbance at a mode at which the residuals ring.
    random_walk  whether a random walk of the sensors is likelier.
    """

    gain: float
    threshold: float
    clear: float
    held_out: HeldOut | None = None
    predicts: bool = False
    explained: Explained | None = None
    rings: bool = False
    random_walk: bool = False

    @property
    def significant(self) -> bool:
        """Return whether the gain is more than chance gives."""
        return self.gain > self.threshold

    @property
    def accepted(self) -> bool:
        """Return whether it is a finding: significant, confirmed by the likelihood of held-out data, and the free
        simulation of these is not worse for it."""
        worse = self.explained is None or self.explained.worse
        return self.significant and self.predicts and not (self.rings or self.random_walk or worse)


class Assessment:
    """Assesses refits: their gains, in the records and in held-out data, and what these must be."""

    def __init__(self, cache: RefitCache, settings: AssessmentSettings) -> None:
        self._cache, self.settings = cache, settings
        self._tries = max(cache.tries, 1)
        # By the refits themselves: two fits of an unknown function may have the same name.
        self._held: dict[tuple[Refit, Refit], HeldOut] = {}
        self._blocks: dict[Refit, Simulated] = {}
        self._in_error: dict[tuple[Refit, Refit], float] = {}
        self._on_validation: dict[tuple[Refit, Refit], HeldOut | None] = {}
        self.not_excited: set[str] = set()
        """Names of candidates that the validation records do not excite."""
        self._follows: dict[tuple[str, Refit], bool] = {}
        self.fed_back: dict[str, None] = {}
        """Names of outputs whose noise an input follows, which a controller feeds back."""

    def weigh(self, base: Refit, more: Refit, candidate: Candidate) -> Evidence:
        """Return the evidence for what ``more`` has and ``base`` has not: a candidate, with others that came in its
        place."""
        gain, threshold = self.gain(base, more), self.needed(more, candidate)
        clear = self.settings.clear * threshold
        if threshold < gain <= clear and self._is_tone_of_these_records(base, more, candidate):
            threshold = clear
        if gain <= threshold:
            return Evidence(gain, threshold, clear)
        held = self.held_out(base, more)
        # Where the residuals are error of the model, free simulation of held-out data confirms it, and what is left is
        # no noise by whose likelihood it could be judged.
        predicts = self.predicts(held) or self._frees_of_error(base, more)
        rings = predicts and any(self._rings_too(more, c) for c in more.beside(base.candidates))
        random_walk = predicts and any(self.is_random_walk(base, more, c) for c in more.beside(base.candidates))
        return Evidence(gain, threshold, clear, held, predicts, self.explained(base, more), rings, random_walk)

    def is_admissible(self, base: Refit, more: Refit) -> bool:
        """Return whether the data determine what a refit has more than another, and it follows no noise."""
        return all(
            is_determined(more, c) and not self.follows_noise(base, more, c) for c in more.beside(base.candidates)
        )

    def follows_noise(self, base: Refit, more: Refit, candidate: Candidate) -> bool:
        """Return whether a candidate of an output follows the noise of that output, beside the terms of a base."""
        key = candidate.name, base
        if key not in self._follows:
            self._follows[key] = found = follows_noise(base, more, candidate)
            if found:
                self.fed_back[candidate.place.name] = None
        return self._follows[key]

    def threshold(self, candidate: Candidate | None = None) -> float:
        """Twice the gain in log-likelihood that chance reaches with none of all candidates; without a candidate that
        for those with one unknown."""
        unknowns = len(candidate.parameters) if candidate else 1
        return chi_square_quantile(max(unknowns, 1), self.settings.false_alarm / self._tries)

    def needed(self, more: Refit, candidate: Candidate) -> float:
        """Twice the gain that a candidate must have: its threshold, and more where the noise goes through the vehicle
        itself or is that of rounding, for then its model is no more than an approximation."""
        rounding = self._cache.base.linear.rounding
        rounded = any(0.0 < rounding[name] >= left for name, left in more.rms.items())
        return self.threshold(candidate) * (self.settings.doubtful if rounded or more.together is not None else 1.0)

    def margin(self, base: Refit, more: Refit) -> float:
        """Return how far the gain by the last candidate of a refit is above what it must be."""
        return self.gain(base, more) - self.needed(more, more.candidates[-1])

    def penalty(self, at: Refit, others: Sequence[Candidate]) -> float:
        """Return what counts against a refit's new term: the chances that it had, and to be out of what is physical."""
        (new,) = at.beside(others)
        return self.threshold(new) + (0.0 if is_physical(at, new) else self.settings.unphysical)

    def gain(self, base: Refit, more: Refit) -> float:
        """Twice the gain in log-likelihood: with coloured noise, or, where that is no more than chance gives and the
        residuals are error of the model, of the simulation's errors."""
        whitened = self._whitened_gain(base, more)
        if not self._is_plain(base, more) or whitened > max(self.needed(more, c) for c in more.beside(base.candidates)):
            return whitened
        return max(whitened, self._gain_in_error(base, more))

    def _is_plain(self, base: Refit, more: Refit) -> bool:
        """Return whether a model has terms beside a base that have one unknown and no state of their own: others follow
        much in residuals that are no noise."""
        new = more.beside(base.candidates)
        return bool(new) and all(c.transferable and complexity(c) < RICH for c in new)

    def _frees_of_error(self, base: Refit, more: Refit) -> bool:
        """Return whether the residuals are error of the model, and a plain term removes most of it in free simulation
        of held-out data."""
        return self._is_plain(base, more) and self._gain_in_error(base, more) > self.threshold()

    def _whitened_gain(self, base: Refit, more: Refit) -> float:
        """Twice the gain in log-likelihood, each with its likeliest noise and less what that costs.

        The less of two: with noise channel by channel, as much less as the estimates of the new terms are less certain
        than that noise has them; and with noise of all channels together, where that is the better model. One gust
        moves all channels, and is no evidence for each of them.
        """
        inflation = max((more.inflation(c) for c in more.beside(base.candidates)), default=1.0)
        return 2.0 * min((more.own.merit - base.own.merit) / inflation, more.merit - base.merit)

    def _gain_in_error(self, base: Refit, more: Refit) -> float:
        """Twice the gain in log-likelihood where the residuals are error of the model and hardly noise, and where free
        simulation of held-out data is freed of most of it; negative else.

        What the past of such residuals predicts is no property of a sensor. They are taken for as many independent ones
        as determine a mean equally well, so that the likelihood is that of the simulation's errors themselves.
        """
        key = base, more
        if key not in self._in_error:
            s = self.settings
            self._in_error[key] = gain = _gain_of_mean_squares(base, more, s.error) - 2.0 * len(
                more.beside(base.candidates)
            )
            if gain > self.threshold():
                explained = self._compared(base, base, more, base)
                if explained is None or explained.interval[0] < s.most:
                    self._in_error[key] = -np.inf
        return self._in_error[key]

    def held_out(self, base: Refit, more: Refit) -> HeldOut:
        """Gain on held-out data; none where the model cannot be fitted there."""
        key = base, more
        if key not in self._held:
            self._held[key] = self._gain_held_out(base, more)
        return self._held[key]

    def held_out_as_fitted(self, base: Refit, more: Refit) -> float:
        """Return the gain of a whole model, disturbances and drifts as fitted, on held-out data."""
        before = self._cache.on_validation(base)
        after = self._cache.as_fitted(more) if before is not None else None
        if before is None or after is None:
            return self.held_out(base, more).gain
        return gain_on_other_data(before, after).gain

    def _gain_held_out(self, base: Refit, more: Refit) -> HeldOut:
        elsewhere = self._elsewhere(base, more)
        return across_blocks(base, more) if elsewhere is None else elsewhere

    def _elsewhere(self, base: Refit, more: Refit) -> HeldOut | None:
        """Return the gain on the validation records; None where there are none, or these do not excite what a model has
        and another has not, and neither confirm nor contradict it."""
        key = base, more
        if key not in self._on_validation:
            new, others = more.beside(base.candidates), self._cache.on_validation(base)
            found: HeldOut | None = None
            if others is not None and all(c.transferable for c in new):
                mine = self._cache.on_validation(more, others)
                found = HeldOut(-np.inf, 0.0, -np.inf) if mine is None else gain_on_other_data(others, mine)
                if found.moved < self.settings.moved and not self._is_wrong_elsewhere(base):
                    self.not_excited |= {c.name for c in new}
                    found = None
            self._on_validation[key] = found
        return self._on_validation[key]

    def _is_wrong_elsewhere(self, at: Refit) -> bool:
        """Return whether a model is wrong on the validation records by much more than on those of the fit: what leaves
        that as it is has not been missed there."""
        return self.is_worse_elsewhere(at, self.settings.error, self.settings.far)

    def is_worse_elsewhere(self, at: Refit, least: float, times: float) -> bool:
        """Return whether the past of the residuals of a model on the validation records predicts more than the part
        ``least`` of their power, and their RMS is so many ``times`` that on the records of the fit."""
        linear = self._cache.on_validation(at)
        if linear is None or not is_structured(Refit((), linear.fit), least):
            return False
        before, after = at.rms, self.held_out_rms(at)
        return any(after[n] > times * before[n] for n in after)

    def explained(self, base: Refit, more: Refit) -> Explained | None:
        """Return the part of the misfit that a model explains more of than another, in free simulation of held-out
        data; None where it cannot be fitted to them."""
        return self.compared(base, base, more)

    def explains_what_is_left(self, current: Refit, more: Refit) -> bool:
        """Return whether a model explains most of the misfit that another one still has."""
        return self.of_what_is_left(current, more) > self.settings.most

    def of_what_is_left(self, current: Refit, more: Refit) -> float:
        """Return the part that a model explains of the misfit that another one still has, in free simulation of data
        held out; NaN where that is hardly more than noise, or the part no more than chance."""
        if not is_structured(current, self.settings.error):
            return math.nan
        found = self._compared(current, current, more, current)
        return found.part if found is not None and found.significant else math.nan

    def is_worse(self, base: Refit, one: Refit, other: Refit) -> bool:
        """Return whether, beside the terms of a base, free simulation of held-out data is clearly worse with those of
        one model than with those of another: by a part of the misfit of the base that is not minor."""
        found = self._compared(base, one, other, base)
        return found is not None and found.significant and found.part > self.settings.minor

    def is_named(
        self, at: Refit, candidate: Candidate, explained: Explained | None, of_the_rest: float = math.nan
    ) -> bool:
        """Return whether a finding names a cause: of a plausible size, and more than minor in free simulation."""
        return is_plausible(at, candidate, explained) and not self.is_minor(explained, of_the_rest)

    def is_minor(self, explained: Explained | None, of_the_rest: float = math.nan) -> bool:
        """Return whether a finding explains less of the misfit than is worth a name, or no more than by chance.

        Where one cause has a simulation drift far away, nothing else is a large part of that misfit. What explains most
        of what is left beside the others, ``of_the_rest``, is minor where it is less than that part in amplitude, too.
        """
        if explained is None:
            return False
        least = self.settings.minor ** (2 if of_the_rest > self.settings.most else 1)
        return not (explained.significant and explained.part >= least)

    def goes_before(self, base: Refit, term: Refit, other: Refit) -> bool:
        """Return whether a term is preferred to a drift or a disturbance of the records alone: other records confirm
        it, and it explains most of their misfit, or the other is likelier by no more than chance.

        A parameter that drifts can follow any motion that changes in the course of a record, and no other record can
        contradict it.
        """
        new, own = term.beside(base.candidates), other.beside(base.candidates)
        if not (new and own and self._cache.validation) or not all(c.transferable for c in new):
            return False
        if all(c.transferable for c in own):
            return False
        explained = self.explained(base, term)
        if explained is None or self.is_minor(explained):
            return False
        if self.gain(base, other) - self.gain(base, term) < self.needed(other, own[-1]):
            return True
        if explained.part <= self.settings.half:
            return False
        # What leaves next to nothing where the term leaves much is no mere follower.
        mine = self.explained(base, other)
        return mine is None or 1.0 - mine.interval[0] > self.settings.fraction * (1.0 - explained.part)

    def compared(self, base: Refit, one: Refit, other: Refit) -> Explained | None:
        """Return what another model explains of the misfit of the model that was diagnosed and one does not, by blocks
        of the records beside the terms of a base where there are no other data."""
        return self._compared(base, one, other)

    def _compared(self, base: Refit, one: Refit, other: Refit, misfitting: Refit | None = None) -> Explained | None:
        """Return the same of the misfit of a model, by default that which was diagnosed."""
        new = [*one.beside(base.candidates), *other.beside(base.candidates)]
        on = self._cache.on_validation
        if misfitting is not None:
            root, elsewhere = misfitting, on(misfitting)
        else:
            root, elsewhere = self._cache.diagnosed or (self._cache.base, on(self._cache.base))
        transferable = all(c.transferable for c in new)
        if transferable and any(self._elsewhere(base, r) is not None for r in (one, other) if r is not base):
            first, second = on(one, on(base)), on(other, on(base))
            if first is None or second is None:
                return None
            assert elsewhere is not None
            found = Simulated.of(second).explained(Simulated.of(first), Misfitting.of(elsewhere))
            # What is of the fitted records alone, such as a parameter that jumps, is left out on others. Where these
            # have the like, the error by that hides what a term does there.
            if found.significant or all(c.transferable for c in (*one.candidates, *other.candidates)):
                return found
        misfit = Misfitting.of(root.linear, self._from_blocks(root))
        return self._from_blocks(other).explained(self._from_blocks(one), misfit)

    def _from_blocks(self, at: Refit) -> Simulated:
        """Errors of the blocks of the records, each predicted by the others; what is estimated again on validation
        records is estimated again on each block."""
        if at not in self._blocks:
            errors = LeftOut(at, at.own.filter).simulated(self._cache.estimated_again(at))
            self._blocks[at] = Simulated.of(at.linear, errors)
        return self._blocks[at]

    def predicts(self, held: HeldOut) -> bool:
        """Return whether a gain on held-out data is one."""
        s = self.settings
        return held.gain > max(s.held_out, s.sure * held.deviation) and held.elsewhere > 0.0

    def held_out_rms(self, at: Refit, known: bool = False) -> dict[str, float]:
        """Output -> RMS on the validation data of the model as it was fitted, initial states and biases as they fit
        best; empty without such data. With ``known`` only of what was fitted to them before."""
        linear = self._cache.as_fitted(at, known=known)
        if linear is None:
            return {}
        found = {}
        for name, line in zip(linear.model.output_names, linear.rows, strict=True):
            r = linear.residuals[line[0].start : line[-1].stop]
            found[name] = float(np.sqrt(np.mean(r**2)))
        return found

    def halves(self, base: Refit, more: Refit) -> bool:
        """Return whether the mean square of the validation residuals is halved, in the mean of the outputs."""
        before, after = self.held_out_rms(base), self.held_out_rms(more)
        ratios = [(after[n] / before[n]) ** 2 for n in before] if after else []
        return bool(ratios) and float(np.mean(ratios)) < self.settings.half

    def _is_tone_of_these_records(self, base: Refit, more: Refit, candidate: Candidate) -> bool:
        """Return whether a candidate is a periodic disturbance of whose frequency no validation record has more than
        chance gives, whatever its phase there: among so many frequencies that is what noise looks like."""
        linear = self._cache.on_validation(base)
        if linear is None or not isinstance(candidate, Periodic):
            return False
        shape = {n: more.fit.parameters[n].value for n in candidate.shape_names}
        signals, count = [], 2 * len(linear.points)
        for e, points in enumerate(linear.points):
            signal = np.zeros((count, points.n))
            signal[2 * e : 2 * e + 2] = candidate.signals(points, shape)
            signals.append(signal)
        seen = Whitened(linear, more.own.filter.on(linear.structure))
        columns = seen.filter(linear.answers(candidate.place, signals)).T
        columns -= seen.basis @ (seen.basis.T @ columns)
        amplitudes = np.linalg.lstsq(columns, seen.errors, rcond=None)[0]
        gain = float(np.sum(seen.errors**2) - np.sum((seen.errors - columns @ amplitudes) ** 2))
        return gain < chi_square_quantile(count, self.settings.chance)

    def steady_gain(self, base: Refit, more: Refit) -> float:
        """Twice the gain in log-likelihood by noise as large as the residuals of the base, that does not ring."""
        ringing = self._cache.ringing(base)
        filter = ringing.filter if ringing else base.own.filter
        return 2.0 * (more.through(filter).log_likelihood - base.through(filter).log_likelihood)

    def is_random_walk(self, base: Refit, more: Refit, candidate: Candidate) -> bool:
        """Return whether a candidate is no likelier than a random walk of the sensor, or of all sensors where it acts
        on the vehicle: a random walk rises, falls and swings slowly by chance, as many slow motions do. A term that is
        a true cause leaves no random walk in the residuals; where it leaves one, it must be significant beside it."""
        if not isinstance(candidate, Effect):
            return False
        of_sensor = candidate.place.kind == "output"
        outputs = [candidate.place.name] if of_sensor else base.linear.model.output_names
        before, after = random_walk_gain(base, outputs), random_walk_gain(more, outputs)
        beyond = 2.0 * (after - before) + self.gain(base, more)
        return beyond < (self.needed(more, candidate) if after > 0.0 else 0.0)

    def _rings_too(self, at: Refit, candidate: Candidate) -> bool:
        """Return whether a candidate is a disturbance at the frequency of a mode at which the residuals of the base
        ring: a tone there cannot be distinguished from noise that excites the mode."""
        ringing = self._cache.ringing(self._cache.base)
        if candidate.transferable or ringing is None:
            return False
        tones = [at.fit.parameters[n].value / (2.0 * np.pi) for n in candidate.shape_names]
        return any(is_near(tone, f) for tone in tones for f in ringing.frequencies)


def _gain_of_mean_squares(base: Refit, more: Refit, error: float) -> float:
    """Twice the gain in log-likelihood of residuals as so many independent ones as determine a mean equally well; none
    where no output's past predicts the part ``error`` of their power."""
    filter = Whitening.of(base.linear.residuals, base.linear.structure)
    total, errors = 0.0, False
    for line, others, channel in zip(base.linear.rows, more.linear.rows, filter.channels, strict=True):
        before = base.linear.residuals[line[0].start : line[-1].stop]
        after = more.linear.residuals[others[0].start : others[-1].stop]
        power, left = float(np.mean(before**2)), float(np.mean(after**2))
        errors = errors or channel.power < (1.0 - error) * power
        rho = np.abs(channel.autocorrelation(max(rows.stop - rows.start for rows in line)))
        if power > 0.0 and left > 0.0:
            total += before.size / float(2.0 * rho.sum() - rho[0]) * float(np.log(power / left))
    return total if errors else -np.inf
