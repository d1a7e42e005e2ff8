"""The misfit that no candidate explains, as a disturbance, a noisy input, an event, or an unknown function.

The search explains a misfit by terms of the physics. What it leaves, and whether the terms that it found stand in for
something else, is decided here by one scale: the likelihood of the residuals, as coloured noise of the sensors, and
with a disturbance at each place of the model (`disturbance`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ...frozen_model import freed_by_default
from ...sensitivities import Place
from ...sensitivities.linearised import Linearised
from ...sensitivities.whitened import Whitened
from ..candidates.candidate import Candidate, Effect, is_function
from . import Search, SearchResult
from .disturbance import (
    Disturbance,
    Disturbances,
    components_of,
    disturbance_at,
    functions_of,
    functions_of_two,
    powers_of,
)
from .free_run import LEAST, Explained, Misfitting, Simulated
from .other_laws import UnknownFunction, formula, terms_of, unknown_function
from .process_noise import FilterErrorRefit, filtered, filtered_elsewhere, single_event
from .randomness import goes_with_motion, in_a_tenth, parts_predicted, past_inputs, products_of_motion
from .refit import Refit, fitted_to, is_structured
from .ringing import random_walk_gain

__all__ = ["Remainder", "RemainderSettings", "remainder_of"]

_Array = NDArray[np.float64]


@dataclass(frozen=True)
class RemainderSettings:
    """Set what a remainder must be.

    structure  part of the residuals' power that their past predicts, below which there is nothing to explain.
    margin     by how much its log-likelihood, less its number of parameters, must be ahead of that of coloured noise.
    alike      other places of the same kind are reported with it where their gain is less by no more than this.
    filtered   places that are asked by the filter-error method, the likeliest to first order, and ``near``: by how much
               others may be behind the first of them.
    seconds    that a fit by it may take.
    most       part of the misfit below which the terms of a search do not explain most of it.
    functions  unknown functions that are fitted, the likeliest to first order.
    motion     correlation with what neighbours in the motion have, beyond which a time history is no random one.
    predicted  part of its variance that the inputs and their past predict in time left out, beyond which it is none,
               either: with feedback they answer gusts.
    products   the same of it or its square by products of states and inputs, of which gusts know nothing.
    components part of the squares of its independent components in a tenth of them, beyond which it is none, either: an
               oscillation, say.
    elsewhere  part of the power of the residuals of data held out, for a fit to these, that their past predicts, beyond
               which an event in the records is not what the model lacks.
    beside_drift  part of the misfit that a disturbance must explain beside a parameter that drifts.
    bursts     part of the squares of a time history in a tenth of the time, beyond which it is no stationary random
               one: of normal values that is 0.44.
    """

    structure: float = 0.05
    margin: float = 8.0
    alike: float = 3.0
    filtered: int = 2
    near: float = 100.0
    seconds: float = 20.0
    most: float = 0.8
    functions: int = 2
    motion: float = 0.35
    predicted: float = 0.35
    products: float = 0.12
    bursts: float = 0.8
    components: float = 0.6
    elsewhere: float = 0.3
    beside_drift: float = 0.25


@dataclass(frozen=True, eq=False)
class Remainder:
    """What is left of a misfit.

    disturbance  the likeliest hypothesis.
    at           the refit beside whose terms it is.
    gain         in log-likelihood over coloured noise of the sensors.
    held_out     the same on data held out; NaN where there are none, or none that excite it.
    alternatives       others of its kind that the data do not distinguish from it: name -> gain.
    filtered     the fit by the filter-error method.
    moves        whether the time history, or its size, is correlated with the motion, as an unknown function of several
                 variables does.
    bursts       whether nearly all of the time history happens in a small part of the time.
    oscillates   whether most of it is in few of its independent components, as it is in a narrow band of frequencies.
    explained    of a function: the part of the misfit that it explains in free simulation of data held out.
    fitted       the fit with an unknown function.
    known        the fit with a candidate that explains as much as the function does; None where there is none.
    """

    disturbance: Disturbance
    at: Refit
    gain: float
    held_out: float
    alternatives: Mapping[str, float] = field(default_factory=dict)
    filtered: FilterErrorRefit | None = None
    moves: bool = False
    bursts: bool = False
    oscillates: bool = False
    explained: Explained | None = None
    fitted: Refit | None = None
    known: Refit | None = None

    @property
    def is_noise(self) -> bool:
        """Return whether it is a stationary random disturbance."""
        return self.disturbance.kind == "noise" and not self.is_unknown

    @property
    def is_unknown(self) -> bool:
        """Return whether it describes a misfit of unknown cause: a function, or what is no random disturbance."""
        return self.disturbance.kind == "function" or self.moves or self.bursts or self.oscillates


@dataclass(frozen=True, eq=False)
class _Option:
    """A hypothesis beside the terms of a refit; ``disturbance`` None for coloured noise alone. ``noise``: of an event,
    the random disturbance at the same place."""

    at: Refit
    merit: float
    disturbance: Disturbance | None = None
    filtered: FilterErrorRefit | None = None
    noise: Disturbance | None = None


def remainder_of(search: Search, result: SearchResult, settings: RemainderSettings | None = None) -> Remainder | None:
    """Return what is left beside the terms that a search found, or in place of them; None where that is coloured noise
    of the sensors or nothing."""
    s = settings or RemainderSettings()
    full, base = result.full, search.cache.base
    known = Disturbances(base.fit.model)
    search.cache.watch("looking for a disturbance in what is left")
    # Beside terms that explain next to nothing, all is as without them.
    at = full if result.final.names else base
    options = _options(at, known, s, not is_structured(full, s.structure), not _is_too_little(search, at, s))
    terms = result.final.candidates
    part = search.assessment.explained(base, result.final) if terms else None
    predicts = part is not None and part.part >= s.most and all(c.transferable for c in terms)
    if terms and not predicts:
        # Beside a disturbance terms must be worth their chances, too; but what predicts data held out in free
        # simulation, where a random disturbance says nothing, is not replaced by one. A tone or an event of these
        # records alone predicts no others.
        alone = _options(base, known, s, not is_structured(base, s.structure))
        if alone[0].disturbance is not None and alone[0].merit > options[0].merit - search.chances(full):
            options = alone
    elif terms and options[0].disturbance is not None and options[0].disturbance.kind == "event":
        event = _event_alone(search, base, known, s)
        if event is not None:
            return event
    first = options[0].disturbance
    # The path itself may change much with a function: it is fitted, and then compared with what is else likely.
    function = _function(search, result, options, known, s)
    if function is not None or first is None or first.kind == "function":
        return function
    # Where held-out data contradict the likeliest, those less likely are no better.
    likeliest = _acting(options, s)
    found = _confirmed(search, full, likeliest, options[-1].merit, s)
    if found is None:
        return None
    alternatives = _alternatives(likeliest, options, s)
    surface = _function_of_two(search, result, found, known, s) if found.moves else None
    if surface is not None:
        return surface
    if found.disturbance.kind == "event":  # whatever kind they were compared as
        alternatives = {f"{name.rpartition(':')[0]}:event": gain for name, gain in alternatives.items()}
    return replace(found, alternatives=alternatives)


def _event_alone(search: Search, base: Refit, known: Disturbances, s: RemainderSettings) -> Remainder | None:
    """Return an event without which the model that was diagnosed fits the records and those held out; None where it
    does not. Terms that simulate data held out better then undo what the event did to the parameters."""
    options = _options(base, known, s)
    likeliest = next((o for o in options if o.noise is not None), None)
    if likeliest is None or likeliest.noise is None:
        return None
    event, _ = single_event(search.cache, base, likeliest.noise, s.structure, s.margin)
    if event is None or _is_wrong_alone(search, base, s):
        return None
    return Remainder(event, base, likeliest.merit - options[-1].merit, float("nan"))


def _is_wrong_alone(search: Search, at: Refit, s: RemainderSettings) -> bool:
    """Return whether a model leaves more than noise of the data held out where it is estimated from these alone. One
    that lacks nothing but an event in the records leaves noise, unless it is wrong there, too."""
    alone = fitted_to(at, search.cache.validation) if search.cache.validation else None
    return alone is not None and is_structured(alone, s.elsewhere)


# Places of what acts beside the inputs: in an equation of motion, as coloured noise or as white noise of its state.
_EQUATIONS = ("equation", "state")


def _acting(options: Sequence[_Option], s: RemainderSettings) -> _Option:
    """Return the likeliest option; in place of noise of a recorded input a disturbance of an equation that the data do
    not distinguish from it: what acts beside the inputs is common, and noise of an input's record shows in the
    record."""
    first = options[0]
    assert first.disturbance is not None
    if first.disturbance.kind not in ("noise", "event") or first.disturbance.place.kind != "input":
        return first
    alike = _alternatives(first, options, s)
    others = [o for o in options if o.disturbance is not None and o.disturbance.name in alike]
    return next((o for o in others if o.disturbance and o.disturbance.place.kind in _EQUATIONS), first)


def _alternatives(of: _Option, options: Sequence[_Option], s: RemainderSettings) -> dict[str, float]:
    """Other places of the same kind that are about as likely, linearised as all are: name -> gain."""
    assert of.disturbance is not None
    mine, coloured = of.disturbance, options[-1].merit
    found = {}
    for o in options:
        d = o.disturbance
        if d is None or d.kind != mine.kind or d.name == mine.name:
            continue
        both = of.filtered is not None and o.filtered is not None
        behind = of.merit - o.merit if both else mine.merit - d.merit
        if behind < s.alike:
            found[d.name] = o.merit - coloured
    return found


def _function(
    search: Search, result: SearchResult, options: Sequence[_Option], known: Disturbances, s: RemainderSettings
) -> Remainder | None:
    """Return an unknown function in place of terms that are near to it, or several of which are needed to stand for
    it."""
    full, final = result.full, result.final
    others = [o.merit - full.merit for o in options if o.disturbance is not None and o.disturbance.kind != "function"]
    least = max([s.margin, *others])
    # Beside which terms, where, of what, and what it must gain.
    tried: list[tuple[Refit, Place, tuple[str, ...], float]] = []
    for o in [o for o in options if o.disturbance is not None and o.disturbance.kind == "function"][: s.functions]:
        assert o.disturbance is not None
        tried.append((o.at, o.disturbance.place, o.disturbance.variables, least))
    for c in final.candidates:
        if isinstance(c, Effect) and is_function(c):
            alike = [o for o in terms_of(full, c.place, c.variables) if is_function(o)]
            if len(alike) == 1:
                tried.append((full, c.place, c.variables, least))
                continue
            # Several stand for one function, which need not be where they are.
            places = dict.fromkeys([c.place, *_likeliest_place(search, full, alike, c.variables[0], known)])
            tried += [(full, place, c.variables, min(-s.margin, least)) for place in places]
    part = search.assessment.explained(search.cache.base, full) if final.names else None
    if part is not None and part.part < s.most:
        first = max(functions_of(search.cache.base, known.known), key=lambda h: h.merit, default=None)
        if first is not None and first.merit > search.cache.base.merit + s.margin:
            tried.append((search.cache.base, first.place, first.variables, least))
    seen: set[tuple[tuple[str, ...], Place, tuple[str, ...]]] = set()
    for at, place, variables, needed in tried:
        if (at.names, place, variables) in seen:
            continue
        seen.add((at.names, place, variables))
        found = unknown_function(search, at, result, place, variables)
        if found is not None and found.gain > needed:
            named = formula(search, found)
            if named is not None and {*named.names} <= {*full.names}:
                return None  # it has been found
            return _of_function(found, named)
    return None


def _of_function(found: UnknownFunction, known: Refit | None = None) -> Remainder:
    """Return a function as what is left; ``known``: the fit with a candidate that explains as much."""
    # Over the model with none of what it stands in the place of.
    gain, nan = found.fitted.merit - found.unknowns - found.without.merit, float("nan")
    return Remainder(found.curve, found.without, gain, nan, explained=found.explained, fitted=found.fitted, known=known)


def _function_of_two(
    search: Search, result: SearchResult, of: Remainder, known: Disturbances, s: RemainderSettings
) -> Remainder | None:
    """Return an unknown function of two variables in place of a time history that is correlated with the motion; None
    where none simulates data held out better, or is likelier than coloured noise."""
    at, where = of.at, of.disturbance.place
    equations = sorted((p for p in at.linear.places if p.kind == "equation"), key=lambda p: p.name)
    # Noise of an input, or of a state as the forces have it, acts in whichever equations these forces are.
    places = [p for p in equations if p.name in known.known and (where.kind != "equation" or p.name == where.name)]
    likeliest = max(functions_of_two(at, known.known, places), key=lambda h: h.merit, default=None)
    if likeliest is None or likeliest.merit < at.merit + s.margin:
        return None
    found = unknown_function(search, at, result, likeliest.place, likeliest.variables)
    return None if found is None or found.gain < s.margin else _of_function(found)


def _likeliest_place(
    search: Search, full: Refit, terms: Sequence[Candidate], variable: str, known: Disturbances
) -> list[Place]:
    """Return the likeliest place for a function of a variable that replaces terms; empty where these cannot be left
    out."""
    without = search.cache.refit([c for c in full.candidates if c not in terms], full.fit)
    found = functions_of(without, known.known, (variable,)) if without is not None else []
    return [max(found, key=lambda h: h.merit).place] if found else []


def _options(
    at: Refit, known: Disturbances, s: RemainderSettings, white: bool = False, ask: bool = True
) -> list[_Option]:
    """Hypotheses beside the terms of a refit, the likeliest of each name, the best first; coloured noise with them.
    ``ask``: whether the filter-error method is asked, which takes its time."""
    best: dict[str, Disturbance] = {}
    for d in known.ranked(at, white):
        best.setdefault(d.name, d)
    noise = {d.place: d for d in best.values() if d.kind == "noise"}
    options = [_Option(at, d.merit, d, noise=noise.get(d.place)) for d in best.values()]
    options.append(_Option(at, at.merit))
    options.sort(key=lambda o: -o.merit)
    noises = [o for o in options if o.disturbance is not None and o.disturbance.kind == "noise"]
    # Large disturbances move the vehicle far from the path of the fit, about which all else is linearised: there the
    # filter-error method itself is asked, where channels go together as disturbances make them.
    if ask and noises and (at.together is not None or noises[0] is options[0]):
        for o in [o for o in noises[: s.filtered] if o.merit > noises[0].merit - s.near]:
            assert o.disturbance is not None
            found = filtered(at, o.disturbance, s.seconds)
            if found is not None:
                options.remove(o)
                options.append(replace(o, merit=max(o.merit, found.merit), filtered=found))
        options.sort(key=lambda o: -o.merit)
    coloured = next(o for o in options if o.disturbance is None)
    likely = [o for o in options if o.disturbance is not None and o.merit > coloured.merit + s.margin]
    return [*likely, coloured]


def _confirmed(search: Search, full: Refit, option: _Option, coloured: float, s: RemainderSettings) -> Remainder | None:
    """Return a hypothesis that held-out data do not contradict, and that predicts them better than the terms in
    whose place it is; None else."""
    d = option.disturbance
    if d is None:
        return None
    gain = option.merit - coloured
    other = search.cache.on_validation(option.at)
    if _is_too_little(search, option.at, s, _share(search, option.at, d)):
        return None
    held_out = float("nan")
    if d.kind in ("noise", "event"):
        # What happened once other data cannot confirm.
        noise = option.noise
        event, sure = single_event(search.cache, option.at, noise, s.structure, s.margin) if noise else (None, False)
        if event is not None:
            # What is wrong in data held out, too, is so where the motion is excited most.
            return None if _is_wrong_alone(search, option.at, s) else Remainder(event, option.at, gain, held_out)
        if d.kind == "event" and noise is not None and sure:
            d = noise
    if d.kind == "noise" and gain < random_walk_gain(option.at, option.at.linear.model.output_names) + s.alike:
        return None  # random walks of sensors are as likely: behind an integration the two are alike
    if d.kind == "noise" and other is not None:
        held_out = _held_out(search, option, d, other, s)
        if held_out <= 0.0:
            return None
    moves = d.kind == "noise" and _moves(option.at.linear, d, s)
    bursts = d.kind == "noise" and in_a_tenth(d.values) > s.bursts
    oscillates = d.kind == "noise" and in_a_tenth(components_of(option.at.linear, d)) > s.components
    return Remainder(
        d,
        option.at,
        gain,
        held_out,
        filtered=option.filtered,
        moves=moves,
        bursts=bursts,
        oscillates=oscillates,
    )


def _is_too_little(search: Search, at: Refit, s: RemainderSettings, share: float = 1.0) -> bool:
    """Return whether a ``share`` of the misfit, or what the terms of a refit leave of it, is too little for a
    disturbance beside them."""
    # What the terms explain in free simulation is no disturbance.
    by_terms = search.assessment.explained(search.cache.base, at) if at.candidates else None
    left = 1.0 - by_terms.part if by_terms is not None else 1.0
    # A parameter that drifts seldom does so along a straight line, and what is left of that is no noise.
    drifts = any(getattr(c, "family", "") == "variation" for c in at.candidates)
    return min(share, left) < (s.beside_drift if drifts else search.assessment.settings.minor)


def _moves(linear: Linearised, d: Disturbance, s: RemainderSettings) -> bool:
    """Return whether a time history, or its size, is correlated with the motion or the inputs."""
    if goes_with_motion(linear, d) > s.motion:
        return True
    size = d.values**2 - np.mean(d.values**2)
    by_inputs, by_products = (
        max(parts_predicted(linear, d, signals, values))
        for signals, values in ((past_inputs, [d.values]), (products_of_motion, [d.values, size]))
    )
    return by_inputs > s.predicted or by_products > s.products


def _share(search: Search, at: Refit, of: Disturbance) -> float:
    """Return the part of the misfit of the model diagnosed that a disturbance takes up, in the records themselves.

    A random time history with hundreds of knots takes up noise of the sensors as well, and more of it the more samples
    there are: its effect on the outputs of one record follows from its variance. Where the model integrates, that is
    more than it did in these records. Thus the lesser of both.
    """
    base = search.cache.base.linear
    misfit = Misfitting.of(base)
    taken = Simulated.of(at.linear, of.marginal.residuals).explained(Simulated.of(at.linear), misfit).part
    if of.kind != "noise":
        return taken
    powers = powers_of(at.linear, of)
    expected = float(np.sum(powers / np.maximum(misfit.powers, 1e-300))) / max(float(misfit.parts.sum()), LEAST)
    return min(taken, expected)


def _held_out(search: Search, option: _Option, d: Disturbance, other: Linearised, s: RemainderSettings) -> float:
    """Return the gain in log-likelihood on data held out over coloured noise.

    A fit that knows of no disturbance has biased parameters, which no disturbance mends on other data. With the fit by
    the filter-error method its own are used there. Else, or where it fails there, and where the biases contradict
    the disturbance, both hypotheses are compared with parameters that are re-estimated from the other data: what is
    held out then is what the hypotheses are about, the variances and the colour of the noise.
    """
    filter = option.at.own.filter
    coloured = Whitened(other, filter.on(other.structure)).log_likelihood
    if option.filtered is not None:
        free = freed_by_default(option.at.fit.model) if search.cache.biases is None else search.cache.biases
        by_filter = filtered_elsewhere(option.filtered, search.cache.validation, free, s.seconds) - coloured
    else:
        by_filter = float("nan")
    if np.isnan(by_filter):
        gain = disturbance_at(other, d) - coloured
        again = fitted_to(option.at, search.cache.validation) if gain <= 0.0 else None
        if again is None:
            return gain
        linear = again.linear
        return disturbance_at(linear, d) - Whitened(linear, filter.on(linear.structure)).log_likelihood
    return by_filter
