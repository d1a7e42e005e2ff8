"""Refits of a set of candidates from several starts, and the likeliest of their ends."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence

import numpy as np

from ...fit_result import FitResult, mean_square
from ...residual_noise.whitening import Whitening
from ..candidates.candidate import Candidate
from .refit import Refit, is_structured, refit

__all__ = ["SAME", "SeveralStarts"]

# Parts of a start at which candidates begin, too, that may end at several optima: where they explain this part of the
# power of the base's residuals or more to first order, for small effects are nearly linear.
# Where it is so evident, they begin at all of them, be the first ends alike.
_STARTS, _LARGE, _EVIDENT = (0.4, 1.6, 0.25, 0.65), 0.1, 0.3
# Parts of a value of first order at which a shape is held in turn.
_PROFILE = (0.4, 0.6, 0.8, 1.0, 1.3, 1.7)
# Part of an output's variance that a fit leaves with which next to nothing about it is true.
_USELESS = 0.5
# Part of the residuals' power of an output beside noise that is a misfit; part of a misfit that is next to nothing.
_STRUCTURED, _NEXT_TO_NOTHING = 0.2, 0.01
# Two ends at the likeliest optimum so far, alike to this in log-likelihood, or so many starts that come to no end,
# leave little to be found.
SAME, _FAILED = 0.5, 3
# An end that gains less than this part of what the scan promises is none; so many shapes are tried then.
_LITTLE, _OTHERS = 0.1, 4


class SeveralStarts:
    """Refit sets of candidates at a base from several starts.

    ``share`` gives the part of the residuals' power that a candidate explains to first order beside the others of a
    set; ``one_more`` the refits that are known of some candidates and one more.
    """

    def __init__(
        self,
        base: Refit,
        share: Callable[[Candidate, Sequence[Candidate]], float],
        one_more: Callable[[Sequence[Candidate]], list[Refit]],
    ) -> None:
        self.base, self._share, self._one_more = base, share, one_more
        # Outputs of which the base leaves most, and not since they are mostly noise.
        structured = is_structured(base, _USELESS)
        self._unexplained = _unexplained(base.fit, base.fit.model.output_names) if structured else []

    def likeliest(
        self,
        candidates: Sequence[Candidate],
        starts: Mapping[str, float],
        near: FitResult | None,
        elsewhere: Mapping[str, float] | None,
    ) -> Refit | None:
        """Return the likeliest refit of a set from several starts of candidates that need them and are new;
        ``elsewhere`` is where the last one was proposed to start, if it was."""
        known = near.parameters if near else {}
        points = self.base.linear.points
        left = self._left(near)
        shares = {c.name: left * self._share(c, candidates) for c in candidates}
        # Of friction that rests, first order about a motion that never does says little.
        much = {c.name for c in candidates if shares[c.name] > _LARGE or (c.jumps and c.coefficients)}
        new = [c for c in candidates if c.several_starts and c.shape_names[0] not in known and c.name in much]
        best = refit(self.base.fit, candidates, starts, near, points)
        if elsewhere is not None:
            other = refit(self.base.fit, candidates, {**starts, **elsewhere}, near, points, patient=best is None)
            if other is not None and (best is None or other.fit.log_likelihood > best.fit.log_likelihood):
                best = other
        if self._is_explained(candidates):
            return best
        if best is None:
            # About a start far off the linearisation that gave it says little: two others, or from nothing.
            last = candidates[-1] if candidates else None
            if last is not None and last.coefficients and (last.jumps or not last.shape_names):
                nothing = dict.fromkeys(last.coefficients, 0.0)
                best = refit(self.base.fit, candidates, {**starts, **nothing}, near, points)
            elif last is not None and last.unit_amplitude and not last.several_starts and len(last.shapes) > 2:
                for k in (0, len(last.shapes) // 2):
                    best = best or refit(self.base.fit, candidates, {**starts, **last.shapes[k]}, near, points)
        ends = [best, *self._profiled(candidates, starts, near, much)]
        # About a path that has little to do with the measured one a refit may end where the base did.
        lost = self._unexplained and (best is None or _unexplained(best.fit, self._unexplained))
        jumping = left > _LARGE and any(c.begins_measured and c.shape_names[0] not in known for c in candidates)
        # A candidate that contradicts the path of the fit may fit the measured one.
        ended_nowhere = best is None and bool(candidates) and candidates[-1].name in much
        if lost or jumping or ended_nowhere:
            # What is proposed is proposed about the measured motion.
            ends.append(refit(self.base.fit, candidates, {**starts, **(elsewhere or {})}, near, measured=True))
        for c in new:
            name = c.shape_names[0]
            # Ends from one and the same value, on two paths, say nothing of other values.
            begun_here = _best(ends)
            ends = ends if begun_here is None else [begun_here]
            for factor in _STARTS if name in starts else ():
                if _enough(ends, often=shares[c.name] > _EVIDENT):
                    break
                ends.append(refit(self.base.fit, candidates, {**starts, name: factor * starts[name]}, near, points))
        begun = (near or self.base.fit).log_likelihood
        for c in new:
            # Far from the base the linearisation may ask for a shape that does nothing, such as a limit never reached.
            asked = begun + _LITTLE * 0.5 * shares[c.name] * self.base.linear.n_rows
            failed = sum(r is None for r in ends)
            for shape in c.shapes[:: max(len(c.shapes) // _OTHERS, 1)]:
                if failed >= _FAILED or any(r is not None and r.fit.log_likelihood > asked for r in ends):
                    break
                ends.append(refit(self.base.fit, candidates, {**starts, **shape}, near, points))
                failed += ends[-1] is None
        return _best(ends)

    def _is_explained(self, candidates: Sequence[Candidate]) -> bool:
        """Return whether another candidate in the place of the last of a set explains next to all of the misfit: then
        few starts will do."""
        others = self._one_more(candidates[:-1]) if candidates else []
        return any(self._left(r.fit) < _NEXT_TO_NOTHING for r in others)

    def _profiled(
        self,
        candidates: Sequence[Candidate],
        starts: Mapping[str, float],
        near: FitResult | None,
        much: Collection[str],
    ) -> list[Refit]:
        """Return the refit of a set that begins at the likeliest of several values at which the shape of its last
        candidate is held, where this is to be asked and the candidate explains much; empty else."""
        last = candidates[-1] if candidates else None
        if last is None or not last.is_profiled or last.name not in much:
            return []
        (name,) = last.shape_names
        if name not in starts or (near is not None and name in near.parameters):
            return []
        points, base = self.base.linear.points, self.base.fit
        values = [{**starts, name: part * starts[name]} for part in _PROFILE]
        along = _best([refit(base, candidates, each, near, points, held=[name]) for each in values])
        if along is None:
            return []
        begin = float(along.fit.model.declared_parameters[name].start)
        found = refit(base, candidates, {**starts, name: begin}, along.fit, points)
        return [found] if found is not None else []

    def _left(self, near: FitResult | None) -> float:
        """Return the part of the misfit of the base that a fit leaves in the output in which it leaves most of it."""
        if near is None:
            return 1.0
        left = []
        filter = self.base.own.filter
        assert isinstance(filter, Whitening)  # channel by channel
        for name, channel in zip(self.base.fit.model.output_names, filter.channels, strict=True):
            # What the past of the residuals does not predict is noise: of an output without a misfit that is left.
            power = mean_square(self.base.fit, name)
            if (misfit := power - channel.power) > _STRUCTURED * power:
                left.append((mean_square(near, name) - channel.power) / misfit)
        return min(max(left, default=1.0), 1.0)


def _unexplained(fit: FitResult, names: Sequence[str]) -> list[str]:
    """Return the outputs of which a fit leaves most of what they do."""
    found = []
    for name in names:
        measured = [y for y in (r.measured[name] for r in fit.records) if np.isfinite(y).any()]
        moved = np.concatenate([np.zeros(0), *(y - np.nanmean(y) for y in measured)])
        if moved.size and mean_square(fit, name) > _USELESS * float(np.nanmean(moved**2)):
            found.append(name)
    return found


def _best(ends: Sequence[Refit | None]) -> Refit | None:
    """Return the likeliest of the refits that came to an end."""
    return max((r for r in ends if r is not None), key=lambda r: r.fit.log_likelihood, default=None)


def _enough(ends: Sequence[Refit | None], often: bool) -> bool:
    """Return whether refits from several starts have shown what there is to find; ``often``: though some are alike."""
    found = sorted((r.fit.log_likelihood for r in ends if r is not None), reverse=True)
    alike = len(found) > 1 and found[0] - found[1] < SAME
    return (alike and not often) or (not found and len(ends) >= _FAILED)
