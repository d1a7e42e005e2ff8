"""What to beware of in a fit, in plain words."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from ..match import match

__all__ = ["remarks"]

_WHITE = 0.01  # p-value below which residuals are not white
_MUCH = 0.3  # autocorrelation from one sample to the next that standard errors feel
_SIDE = 1.96  # standard errors of a 95 % interval
_TOGETHER = 0.95  # correlation of estimates
_MOST = 6  # names or pairs listed
_OFFSET = 0.5  # part of the mean square that is an offset


def remarks(fit: Any) -> list[str]:
    """The warnings of a `Fit`, and what its numbers give reason to doubt: a sentence each, none where all is well.

    A coarse mesh, outputs that a constant would match better or that are all matched poorly, coloured residuals
    (p < 0.01 in the test of Ljung and Box, lag-1 correlation beyond 0.3), residuals with an offset, parameters whose
    95 % interval holds zero, pairs of estimates with a correlation beyond 0.95, combinations that are hardly
    determined, estimates at a bound.
    """
    weak = [f"Weakly identified: {direction}." for direction in fit.correlation.weak]
    return [*map(_sentence, fit.warnings), *_of_residuals(fit), *_of_estimates(fit), *_of_pairs(fit), *weak]


def _sentence(text: str) -> str:
    """As a sentence; names at the beginning stay as they are."""
    return text if text.endswith((".", "!", "?")) else f"{text}."


def _of_residuals(fit: Any) -> list[str]:
    filtered = any(record.innovations for record in fit.records)
    found = []
    coloured, off = [], []
    matches = {name: match(fit.records, name) for name in fit.model.output_names}
    for name, m in matches.items():
        if m.whiteness < _WHITE and abs(m.lag_one) > _MUCH:
            coloured.append(f"{name} ({m.lag_one:.2f})")
        if m.bias > _OFFSET:
            off.append(name)
    if coloured and filtered:
        found.append(
            "Innovations are not white: each follows from the one before, with a correlation of "
            f"{_listed(coloured)}. They are white where the model and its process noise are right: ph.misfit tells "
            "where they are not."
        )
    elif coloured:
        found.append(
            f"Residuals are not white: each follows from the one before, with a correlation of {_listed(coloured)}. "
            "The plain standard errors take them for white, and are too small. Either the model misses something "
            "(ph.diagnose tells what), or the noise is filtered."
        )
    if off:
        what = "Innovations" if filtered else "Residuals"
        found.append(f"{what} of {_listed(off)} are mostly a constant offset: a bias is missing, or off.")
    return found


def _of_estimates(fit: Any) -> list[str]:
    found = []
    noise = fit.noise_parameters
    own = [e for e in fit.parameters.values() if e.name not in noise]
    weak = [e.name for e in own if e.std_error > 0.0 and abs(e.value) < _SIDE * e.std_error]
    if weak:
        hold = "interval of {} holds" if len(weak) == 1 else "intervals of {} hold"
        found.append(f"The 95 % {hold.format(_listed(weak))} zero: these data do not even tell the sign.")
    found += [
        f"{e.name} lies at its {e.bounds_active} bound, and so has no standard error: the optimum may be beyond it."
        for e in own
        if e.bounds_active and not e.fixed
    ]
    return found


def _of_pairs(fit: Any) -> list[str]:
    pairs = [f"{a} with {b} ({_signed(rho)})" for a, b, rho in fit.correlation.pairs(_TOGETHER)]
    if not pairs:
        return []
    return [
        f"Estimates that go together: {_listed(pairs)}. The data tell a combination of them better than each alone."
    ]


def _signed(value: float) -> str:
    # Rounding must not make it ±1.
    digits = 2 if abs(value) < 0.995 else 4
    return f"{value:.{digits}f}".replace("-", "−")


def _listed(texts: Sequence[str]) -> str:
    shown: Iterable[str] = texts if len(texts) <= _MOST else [*texts[: _MOST - 1], f"{len(texts) - _MOST + 1} more"]
    *others, last = shown
    return f"{', '.join(others)} and {last}" if others else last
