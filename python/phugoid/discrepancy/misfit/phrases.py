"""What is found in the residuals of a channel, in plain words."""

from __future__ import annotations

import math
from typing import Any

from ...time_unit import time_unit_of
from .regimes import Bin, Dependence, Regime

__all__ = [
    "channel_phrases",
    "number",
    "percent",
    "regime_phrase",
    "time_phrase",
    "what_stands_out",
    "with_unit",
]


_SLOW = 0.3  # of the Nyquist frequency
_MUCH = 0.3  # of the power of the residuals


def channel_phrases(c: Any) -> str:
    """Return one sentence on a `ChannelMisfit`: its size, and what stands out, or that nothing does."""
    if c.rms == 0.0:
        return f"{c.name}: {what_stands_out(c)}"
    size = f"{c.name}: residual {with_unit(c.rms, c.unit)}"
    return f"{size}{_times(c)}; {what_stands_out(c)}"


def what_stands_out(c: Any) -> str:
    """Return the same without name and size."""
    if c.rms == 0.0:
        return "no residual, matched exactly"
    if math.isnan(c.ratio):
        return "too few samples to say more"
    if not c.structured:
        return "no structure found"
    parts = [f"mean off by {with_unit(c.mean, c.unit)}"] if c.biased else []
    if c.spans:
        parts.append(time_phrase(c))
    followed = None if c.follows is None else c.follows.variable
    if c.regime is not None and (c.regime.variable != followed or any(b.stands_out for b in c.regime.bins)):
        parts.append(regime_phrase(c.regime, c.unit, c.units))
    parts += _frequencies(c)
    if c.follows is not None:
        parts.append(_follows(c.follows))
    if c.regime is None and c.follows is None:
        parts += _perhaps(c)
    return "; ".join(parts) or "coloured, without a distinct time, regime or frequency"


def _follows(found: Dependence) -> str:
    if found.variable == "time":
        return f"drifts {'up' if found.r > 0.0 else 'down'} during the record (r = {found.r:.2f})"
    return f"correlated with {found.variable} (r = {found.r:.2f})"


def _times(c: Any) -> str:
    if math.isnan(c.ratio):
        return ""
    if c.ratio > 1000.0:
        return ", without measurable noise"
    if c.ratio < 1.05:
        return ", equal to its noise"
    return f", {c.ratio:.2g} times its noise ({percent(c.predictable)} of its power predictable)"


def _perhaps(c: Any) -> list[str]:
    """Return the regime with the most of the residuals' power, where that is much, but slow noise might have it too."""
    most = c.main_regime
    if most is None or most.share < _MUCH:
        return []
    share = percent(most.share)
    return [f"possibly changes with {most.variable} ({share} of its power, which slow noise could explain as well)"]


def time_phrase(c: Any) -> str:
    """Return when the residuals are strongest."""
    several = len(c.running) > 1
    first = c.spans[0]
    where = f" of '{first.experiment}'" if several else ""
    begin, end = _interval(first.start, first.end)
    text = f"strongest from {begin} to {end} {time_unit_of(c.units)}{where} ({first.times:.2g} times the usual)"
    more = len(c.spans) - 1
    return text + (f" and in {more} more span{'s' if more > 1 else ''}" if more else "")


def regime_phrase(regime: Regime, unit: str, units: Any) -> str:
    """Where, over a variable, the mean of the residuals is farthest off; the variable only, if no bin stands out."""
    chosen = [b for b in regime.bins if b.stands_out]
    if not chosen:
        return f"changes with {regime.variable}"
    b = max(chosen, key=lambda b: abs(b.mean) / b.std_error)
    return f"biased where {_range(regime, b, units)} (mean {with_unit(b.mean, unit)})"


def _range(regime: Regime, b: Bin, units: Any) -> str:
    name = regime.variable
    bare = name.removesuffix("'")
    unit = units.get(bare, "")
    if name.endswith("'"):
        unit = time_unit_of(units).rate(unit)
    unit = f" {unit}" if unit else ""
    if b is regime.bins[0]:
        return f"{name} < {number(b.high)}{unit}"
    if b is regime.bins[-1]:
        return f"{name} > {number(b.low)}{unit}"
    return f"{number(b.low)} < {name} < {number(b.high)}{unit}"


def _frequencies(c: Any) -> list[str]:
    parts, hz = [], time_unit_of(c.units).frequency
    for tone in c.tones[:1]:
        parts.append(f"a tone at {number(tone.frequency)} {hz} (amplitude {with_unit(tone.amplitude, c.unit)})")
    if c.spectrum is None or not c.spectrum.bands or not c.coloured:
        return parts
    band = c.spectrum.bands[0]
    if any(band.low <= tone.frequency <= band.high for tone in c.tones):
        return parts
    nyquist = float(c.spectrum.frequency[-1])
    if band.low == 0.0 and c.spectrum.most_below < _SLOW * nyquist:
        parts.append(f"slow, 80 % of its power below {number(c.spectrum.most_below)} {hz}")
    elif band.low == 0.0:
        parts.append(f"{percent(band.share)} of its power below {number(band.high)} {hz}")
    else:
        parts.append(f"{percent(band.share)} of its power between {number(band.low)} and {number(band.high)} {hz}")
    return parts


def number(value: float, digits: int = 2) -> str:
    """Return a number as an engineer writes it: 0.28, 3.1, 120, 2.3e-05."""
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g}"
    if 10.0**digits - 0.5 <= abs(value) < 1e5:  # 99.7 is 100, not 1e+02
        return f"{value:.0f}"
    return f"{value:.{digits}g}"


def percent(share: float) -> str:
    """Return a share of 0 to 1; 100 % is said of a whole only."""
    return "over 99 %" if 0.995 <= share < 1.0 else f"{100.0 * share:.0f} %"


def _interval(begin: float, end: float) -> tuple[str, str]:
    """Return both ends with as many decimals as distinguish them."""
    digits = max(0, 1 - math.floor(math.log10(max(end - begin, 1e-9))))
    return f"{begin:.{digits}f}", f"{end:.{digits}f}"


def with_unit(value: float, unit: str) -> str:
    return f"{number(value)} {unit}" if unit not in ("", "1", "-") else number(value)
