"""Findings in words and numbers: causes that a search found, what is left beside them, and faults of the data."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import joined
from ...fit_result import FitResult
from ...modelling.model import Model
from ...parameters import plus_minus
from ...time_unit import TimeUnit
from ..candidates.candidate import Candidate
from ..candidates.terms import where
from ..misfit.phrases import number, percent
from . import SearchResult
from .admissibility import is_plausible
from .confirmation import Found
from .finding import DiagnosisResult, ExtensionResult, Finding, Gain
from .free_run import Explained
from .record_change import RecordChange
from .recorded_input import RecordedInput
from .refit import Refit
from .remainder import Remainder
from .sensor_fault import SensorFault, UnsignedSensor

__all__ = [
    "finding_of",
    "finding_of_record_change",
    "finding_of_recorded_input",
    "finding_of_remainder",
    "finding_of_sensor_fault",
    "finding_of_unsigned_sensor",
    "no_optimum",
]

_INTERVAL = 1.959963984540054  # 95 % of a normal distribution
# Aliases that are named beside a cause.
_ALIASES = 3
# A scale error below this is an opposite sign.
_TURNED = -1.5
# Records that are listed with their values.
_LISTED = 6
_UNPHYSICAL = "; but its coefficient is outside the physical range"
_OTHER_UNITS = ", as with a wrong sign or other units"
_UNEXPLAINED = "the residuals are more than noise, but no candidate improves the prediction of held-out data"
_WORSE = "the residuals are more than noise, but no candidate improves the free simulation of held-out data"
_AGAIN = (
    "Repeat the same input: what repeats in the residuals is not noise. Then use a smaller and a larger input: they "
    "show what depends on amplitude."
)


def _why_unexplained(found: Found, time: TimeUnit) -> str:
    """Return in words why no candidate explains a misfit."""
    if found.ringing:
        return _rings(found.ringing, time)
    return _WORSE if found.held_out[0] > 0.0 else _UNEXPLAINED


def finding_of(result: SearchResult, found: Found, minor: bool, kept: Refit | None = None) -> Finding:
    """Return what a search found as a finding: with the estimate in the model that it is fitted in, the extended one
    (``kept``) where it is part of that."""
    aliases = tuple(found.alternatives)[:_ALIASES]
    if found.candidate is None:
        return Finding(
            cause="",
            aliases=aliases,
            status="unexplained",
            gain=found.gain,
            held_out_gain=found.held_out[0],
            threshold=found.threshold,
            explanation=_why_unexplained(found, result.final.fit.model.time_unit),
            advice=_AGAIN if found.ringing else "",
            alternatives=dict(found.alternatives),
            ringing=found.ringing,
        )
    c = found.candidate
    final = kept if kept is not None and c.name in kept.names else result.of(c)
    explained, stands_in = found.explained, result.surrogates.get(c.name, "")
    plausible = is_plausible(final, c, explained)
    parameters = final.parameters(c)
    name = next(iter(parameters))
    value, error = _amplitude(*list(parameters.values())[:2]) if c.has_phase else parameters[name]
    return Finding(
        cause=c.name,
        aliases=aliases,
        status="surrogate" if stands_in or not (plausible or minor) else "minor" if minor else "named",
        coefficient=value,
        std_error=error,
        interval=(value - _INTERVAL * error, value + _INTERVAL * error),
        unit=final.fit.parameters[name].unit,
        parameters=parameters,
        gain=found.gain,
        held_out_gain=found.held_out[0],
        threshold=found.threshold,
        explanation=c.explanation + (f"; but {stands_in}" if stands_in else _remark(c, parameters, plausible)),
        units={n: final.fit.parameters[n].unit for n in parameters},
        alternatives=dict(found.alternatives),
        **_simulated(explained),
        explained_of_the_rest=found.of_the_rest,
        alternatives_explained=dict(found.alternatives_explained),
    )


def _simulated(explained: Explained | None) -> dict[str, Any]:
    """Return the facts of a finding about the free simulation of data held out; nothing where there is none."""
    if explained is None:
        return {}
    return {
        "explained": explained.part,
        "explained_interval": explained.interval,
        "explained_another": explained.another,
        "explained_outputs": dict(explained.outputs),
    }


def _amplitude(sine: tuple[float, float], cosine: tuple[float, float]) -> tuple[float, float]:
    """Return the amplitude of a wave and its standard error, from the coefficients of a sine and a cosine with theirs;
    these are nearly independent about the middle of a record."""
    (a, of_a), (b, of_b) = sine, cosine
    size = math.hypot(a, b)
    return size, math.hypot(a * of_a, b * of_b) / size if size else math.hypot(of_a, of_b)


def _remark(c: Candidate, parameters: Mapping[str, tuple[float, float]], plausible: bool) -> str:
    """Return what is to be said of the values of a candidate's parameters."""
    if not plausible:
        return _UNPHYSICAL
    return _OTHER_UNITS if c.has_reason({n: value for n, (value, _) in parameters.items()}) else ""


def no_optimum(fit: FitResult, words: str, likelier: Sequence[Refit], seconds: float) -> DiagnosisResult:
    """Return the diagnosis of a fit that ended at no optimum, and could not be brought to one: a misfit that is
    unexplained, with what the status means, and ``likelier`` fits with a term more that have an optimum."""
    likeliest = joined([f"{r.names[0]} ({r.fit.log_likelihood - fit.log_likelihood:+.0f})" for r in likelier], "or")
    advice = (
        f"With one term more the estimation has an optimum: {likeliest} in log-likelihood. Add the one that the "
        "physics suggests, and diagnose that fit."
    )
    finding = Finding(cause="", status="unexplained", explanation=words, advice=advice if likelier else "")
    rms = Refit((), fit).rms
    nothing = ExtensionResult(fit.model, fit, (), Gain(0.0, 0.0, 0.0, math.nan, rms, rms))
    compared = "Only constants and linear terms were" if likelier else "No candidate was"
    notes = (f"{compared} compared with the records, because no optimum was found to compare at.",)
    return DiagnosisResult(fit, (finding,), (), math.nan, notes, False, seconds, _extension=nothing)


def _rings(frequencies: Sequence[float], time: TimeUnit) -> str:
    at = time.per(", ".join(f"{f:.3g}" for f in frequencies))
    return (
        f"the residuals ring at {at}, a lightly damped mode of the model: a term is missing, or disturbances "
        "excited the mode. Candidates halve the mean square on held-out data, but with noise at this frequency "
        "that does not prove any of them"
    )


def finding_of_remainder(r: Remainder, fit: FitResult, threshold: float) -> Finding:
    """Return a disturbance, an event or an unknown function as a finding; ``threshold`` is what its gain had to be."""
    d, nan = r.disturbance, float("nan")
    named = not r.is_unknown
    coefficient, error, unit = _size(r, fit) if named and d.kind == "noise" else (nan, nan, "")
    half = _INTERVAL * error
    label = "".join(c if c.isalnum() else "_" for c in d.name)
    of_function = (d.name, *tuple(r.alternatives)[: _ALIASES - 1]) if d.kind == "function" else ()
    aliases = tuple(r.alternatives)[:_ALIASES] if named else of_function
    return Finding(
        cause=d.name if named else "",
        aliases=aliases,
        status="named" if named else "unexplained",
        coefficient=coefficient,
        std_error=error,
        interval=(coefficient - half, coefficient + half),
        unit=unit,
        parameters={label: (coefficient, error)} if named and d.kind == "noise" else {},
        gain=r.gain,
        held_out_gain=r.held_out,
        threshold=threshold,
        explanation=_explanation(r, fit.model.time_unit),
        advice=_advice(r),
        alternatives=dict(r.alternatives),
        units={label: unit} if named and d.kind == "noise" else {},
        **_simulated(r.explained),
        curve=_drawn(r) if len(d.axes) < 2 else {},
        surface=_drawn(r) if len(d.axes) > 1 else {},
    )


def _drawn(r: Remainder) -> dict[str, tuple[float, ...]]:
    """Return what is drawn of a disturbance or a function, its curve or its surface."""
    d = r.disturbance
    at = {"at": d.knots} if len(d.axes) < 2 else dict(zip(("first", "second"), d.axes, strict=True))
    drawn = {**at, "value": d.values, "error": d.marginal.deviations}
    if d.axes:
        drawn["samples"] = _samples(r)
    return {name: tuple(map(float, each)) for name, each in drawn.items()}


def _samples(r: Remainder) -> NDArray[np.float64]:
    """Return how many samples there are nearest to each node of a function."""
    d, linear = r.disturbance, r.at.linear
    edges = [np.r_[-np.inf, 0.5 * (nodes[1:] + nodes[:-1]), np.inf] for nodes in d.axes]
    seen = [*zip(linear.points, linear.sample_points, strict=True)]
    columns = [np.concatenate([p.values[name][i] for p, i in seen]) for name in d.variables]
    return np.histogramdd(np.column_stack(columns), edges)[0].ravel()


def finding_of_recorded_input(h: RecordedInput, threshold: float, model: Model) -> Finding:
    """Return an input that acts otherwise than it is recorded, as a finding."""
    nan, unit, time = float("nan"), model.units.get(h.name, ""), model.time_unit
    if h.kind == "noise":
        size = f"{number(h.noise, 3)}{f' {unit}' if unit else ''}"
        explanation = f"the record of {h.name} has noise of about {size} RMS, which does not act on the vehicle"
        advice = (
            f"Measure {h.name} better, or filter it without a phase shift before the estimation; the rest of the "
            "search used the filtered input."
        )
    elif h.clock is not None:
        c = h.clock
        which = " and ".join(c.names)
        were = "were" if len(c.names) > 1 else "was"
        rest = "outputs" if c.kind == "input" else "other channels"
        begin, end = (f"{number(abs(x), 2)} {time} {'behind' if x > 0.0 else 'ahead'}" for x in (c.late, c.until))
        explanation = (
            f"{which} {were} recorded with another clock than the {rest}, {begin} at the beginning of a record and "
            f"{end} at the end of the longest one"
        )
        advice = (
            f"Record on one time base, or correct the times of the {c.kind}s; the rest of the search used corrected "
            "ones."
        )
    else:
        explanation = (
            f"{h.name} is held between its samples, as commands of a computer are, and not linear (zero-order hold)"
        )
        advice = f"Give the records with interpolation={{'{h.name}': 'hold'}}; the rest of the search used this."
    label = h.cause.replace(":", "_")
    parameters = {label: (h.clock.rate, h.clock.error)} if h.clock is not None else {}
    units = dict.fromkeys(parameters, f"{time}/{time}")
    rate, error = parameters.get(label, (nan, nan))
    half = _INTERVAL * error
    return Finding(
        cause=h.cause,
        status="named",
        aliases=tuple(h.alternatives)[:_ALIASES],
        alternatives=h.alternatives,
        coefficient=rate,
        std_error=error,
        interval=(rate - half, rate + half),
        unit=units.get(label, ""),
        parameters=parameters,
        units=units,
        gain=h.gain,
        held_out_gain=h.held_out.gain if h.held_out else nan,
        threshold=threshold,
        explanation=explanation,
        advice=advice,
        **_simulated(h.explained),
    )


def finding_of_unsigned_sensor(s: UnsignedSensor) -> Finding:
    """Return a sensor that measures magnitudes, as a finding."""
    return Finding(
        cause=s.cause,
        status="named",
        explanation=(
            f"{s.name} measures a magnitude, without the sign; this explains {percent(s.part)} of the "
            "misfit of these records"
        ),
        advice=(
            f"Write the output {s.name} as the absolute value (smooth_abs); the rest of the search, and "
            "the residuals shown, are those of that model."
        ),
    )


def finding_of_sensor_fault(f: SensorFault, time: str) -> Finding:
    """Return a fault of an output's samples as a finding."""
    gone = f"{percent(f.part)} less mean square of its residuals without that"
    if f.kind == "stuck":
        listed = [f"from {number(a, 4)} to {number(b, 4)} {time} of '{record}'" for record, a, b in f.spans]
        words = f"{f.name} stays at one value {_first(listed, 'spans')}, though its noise changes it elsewhere; {gone}"
        advice = "Mark these samples as missing (NaN); the rest of the search excluded them."
    elif f.kind == "held":
        words = (
            f"{f.name} is renewed every {number(f.size, 3)} {time}, and each value is repeated until the next; {gone}"
        )
        advice = "Mark the repeated values as missing (NaN); the rest of the search excluded them."
    else:
        listed = [f"at {number(a, 4)} {time} of '{record}'" for record, a, _ in f.spans]
        turn = "360" if f.size > 10.0 else "2π"
        words = f"{f.name} jumps by a turn ({turn}) {_first(listed, 'places')}; {gone}"
        advice = f"Remove the jumps (numpy.unwrap with a period of {turn}); the rest of the search did so."
    return Finding(cause=f.cause, status="named", explanation=words, advice=advice)


def _first(listed: Sequence[str], noun: str) -> str:
    """Return the first of a list in words, and how many there are more."""
    more = f" and in {len(listed) - _LISTED} more {noun}" if len(listed) > _LISTED else ""
    return ", ".join(listed[:_LISTED]) + more


def finding_of_record_change(c: RecordChange) -> Finding:
    """Return a difference between records as a finding."""
    unit = f" {c.unit}" if c.unit else ""
    listed = [f"{plus_minus(v, e)}{unit} in '{record}'" for record, (v, e) in c.values.items()]
    more = f" and {len(listed) - _LISTED} more" if len(listed) > _LISTED else ""
    if c.is_scale:
        turned = [f"'{record}'" for record, (v, _) in c.values.items() if v < _TURNED]
        advice = (
            f"{c.place.name} has the opposite sign in {joined(turned)}: compare its wiring and sign convention."
            if turned
            else f"Compare units and calibration of {c.place.name} in these records: the values are scale errors."
        )
    elif c.place.kind == "output":
        advice = f"Declare a bias of {c.place.name} with per_experiment=True, or readjust the sensor."
    elif c.place.kind == "parameter":
        advice = (
            f"Declare {c.place.name} with per_experiment=True, or find what was changed between the records: mass, "
            "centre of gravity, configuration, trim."
        )
    else:
        advice = "Declare such a constant with per_experiment=True, or find what was changed between the records: trim."
    return Finding(
        cause=c.name,
        aliases=c.aliases[:_ALIASES],
        status="named",
        parameters={f"{c.place.name}[{record}]": value for record, value in c.values.items()},
        gain=c.gain,
        threshold=c.threshold,
        explanation=f"{c.explanation}: {', '.join(listed[:_LISTED])}{more}",
        advice=advice,
        units={f"{c.place.name}[{record}]": c.unit for record in c.values},
        explained=c.explained.part,
        explained_in="the fitted records",
        explained_interval=c.explained.interval,
        explained_outputs=dict(c.explained.outputs),
    )


def _size(r: Remainder, fit: FitResult) -> tuple[float, float, str]:
    """Intensity of a disturbance, standard error and unit."""
    d = r.disturbance
    unit, time = fit.model.units.get(d.place.name, ""), fit.model.time_unit
    if r.filtered is not None:
        per = f"{unit}/√{time}" if not r.filtered.tau else time.rate(unit) if d.place.kind == "equation" else unit
        return *r.filtered.intensity, (per if unit else "")
    # What the data say of each knot counts; the standard deviation of n values is known to 1 part in sqrt(2 n).
    known = float(np.sum(np.maximum(1.0 - d.marginal.deviations**2 / d.marginal.variance, 0.0)))
    value = d.intensity
    white = d.kind == "noise" and not d.correlation and d.place.kind == "equation"
    return value, value / float(np.sqrt(2.0 * max(known, 1.0))), (f"{unit}/√{time}" if unit and white else unit)


def _explanation(r: Remainder, time: TimeUnit) -> str:
    d = r.disturbance
    at = f"{d.place.name}'" if d.place.kind == "equation" else d.place.name
    if d.place.kind == "state":
        at = f"{at} as the forces have it"
    if d.kind == "function":
        of = joined([*d.variables])
        return f"no candidate describes it, but a smooth function of {of} in {where(d.place)} does: {_shape(r)}"
    if r.moves:
        return (
            f"what is missing in {at} is not a random disturbance: it recurs or grows with the motion, or follows past "
            "inputs, as a function of several variables or of their past, which no candidate describes"
        )
    if r.bursts:
        return (
            f"what is missing in {at} is not a random disturbance such as gusts: nearly all of it occurs in bursts, "
            "in less than a tenth of the time, and no candidate describes it"
        )
    if r.oscillates:
        return (
            f"what is missing in {at} is not a random disturbance such as gusts: most of it is in a narrow band of "
            "frequencies, as of an oscillation, and no candidate describes it"
        )
    if d.kind == "event":
        assert d.span is not None
        record, begin, end = d.span
        name = r.at.linear.experiments[record].name
        return f"a single disturbance acts on {at} from {number(begin, 4)} to {number(end, 4)} {time} of '{name}'"
    if d.place.kind == "input":
        return f"the acting input differs at random from the recorded {at} (noise on a recorded input)"
    lasting = r.filtered.correlation if r.filtered is not None else d.correlation
    slow = f", with a correlation time of about {number(lasting, 2)} {time}" if lasting else ""
    return f"a random disturbance acts on {at} (process noise, such as gusts or turbulence){slow}"


def _shape(r: Remainder) -> str:
    """Return values of a function in words: at its ends and in the middle, or of two variables the extremes where there
    are samples."""
    d = r.disturbance
    if len(d.axes) == 1:
        picked = [0, d.knots.size // 4, d.knots.size // 2, 3 * d.knots.size // 4, d.knots.size - 1]
        return joined([f"{number(float(d.values[i]), 3)} at {number(float(d.knots[i]), 3)}" for i in picked])
    there = np.flatnonzero(_samples(r))
    nodes = np.stack([each.ravel() for each in np.meshgrid(*d.axes, indexing="ij")], axis=1)

    def at(i: int) -> str:
        each = zip(d.variables, nodes[i].tolist(), strict=True)
        return f"{number(float(d.values[i]), 3)} at {joined([f'{n} = {number(v, 3)}' for n, v in each])}"

    return f"between {' and '.join(at(int(there[pick(d.values[there])])) for pick in (np.argmin, np.argmax))}"


def _advice(r: Remainder) -> str:
    d = r.disturbance
    if r.is_unknown:
        if d.kind != "function":
            return "Try a term of your own there, by candidates=."
        what = "surface" if len(d.axes) > 1 else "curve"
        return f"Try a term of your own with the shape of this {what}, by candidates=."
    if d.kind == "event":
        return "Exclude this span from the record, or give the disturbance as an input."
    if d.place.kind == "input":
        return (
            f"With a noisy input the estimates are biased. Measure {d.place.name} better, smooth it, or estimate by "
            "FilterError with process noise on the states that it drives."
        )
    if r.filtered is not None and r.filtered.tau and d.place.kind == "equation":
        return (
            f"Estimate with an additional state w, w' = -w/tau, added to {d.place.name}', and "
            "transcription=FilterError('w'): it takes such noise into account."
        )
    if d.place.kind == "state":
        return (
            f"It acts in every equation that {d.place.name} is in, as wind does on a vehicle. What can be measured of "
            "it can be an input of the model. "
            f"Estimation with transcription=FilterError('{d.place.name}') is an approximation."
        )
    return f"Estimate with transcription=FilterError('{d.place.name}'): it takes such noise into account."
