"""Units of flight-test records: conversion to SI, and the check of a record against the units of a model."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import DataError, listing
from ..modelling.model import Model
from .experiment import Experiment, FloatArray

__all__ = ["check_units", "convert", "differ", "si", "target"]

_DEG = math.pi / 180.0
_FT = 0.3048
_LB = 0.45359237
_G0 = 9.80665  # standard gravity, exact by definition, as foot, pound and nautical mile are

# Unit -> (the unit in SI, factor). "g" is the acceleration of gravity, not the gram, which flight records do not use.
_TABLE: dict[str, tuple[str, float]] = {
    **{unit: (unit, 1.0) for unit in ("s", "m", "kg", "rad", "N", "Pa", "K", "W", "J", "Hz", "V", "A", "T")},
    "": ("", 1.0),
    "%": ("", 0.01),
    **{"min": ("s", 60.0), "h": ("s", 3600.0), "day": ("s", 86400.0)},
    **{"ms": ("s", 1e-3), "us": ("s", 1e-6), "ns": ("s", 1e-9)},
    **{"deg": ("rad", _DEG), "mrad": ("rad", 1e-3), "rev": ("rad", 2.0 * math.pi)},
    **{"km": ("m", 1e3), "cm": ("m", 1e-2), "mm": ("m", 1e-3)},
    **{"ft": ("m", _FT), "in": ("m", _FT / 12.0), "nmi": ("m", 1852.0)},
    **{"kt": ("m/s", 1852.0 / 3600.0), "mph": ("m/s", 5280.0 * _FT / 3600.0), "fpm": ("m/s", _FT / 60.0)},
    **{"rpm": ("rad/s", math.pi / 30.0)},
    **{"g": ("m/s^2", _G0), "mg": ("m/s^2", 1e-3 * _G0)},
    **{"t": ("kg", 1e3), "lb": ("kg", _LB), "slug": ("kg", _LB * _G0 / _FT)},
    **{"kN": ("N", 1e3), "lbf": ("N", _LB * _G0)},
    **{"kPa": ("Pa", 1e3), "hPa": ("Pa", 100.0), "mbar": ("Pa", 100.0), "bar": ("Pa", 1e5)},
    **{"psi": ("Pa", _LB * _G0 / (_FT / 12.0) ** 2), "psf": ("Pa", _LB * _G0 / _FT**2), "inHg": ("Pa", 3386.389)},
    **{"kW": ("W", 1e3), "hp": ("W", 550.0 * _FT * _LB * _G0)},
    **{"mV": ("V", 1e-3), "mA": ("A", 1e-3), "Gauss": ("T", 1e-4), "mGauss": ("T", 1e-7), "degR": ("K", 5.0 / 9.0)},
}
_ALSO = {
    **{"°": "deg", "degree": "deg", "degrees": "deg", "radian": "rad", "radians": "rad", "sec": "s", "second": "s"},
    **{"minute": "min", "minutes": "min", "hour": "h", "hours": "h", "d": "day", "days": "day"},
    **{"seconds": "s", "msec": "ms", "usec": "us", "hr": "h", "feet": "ft", "foot": "ft", "inch": "in", "meter": "m"},
    **{"meters": "m", "metre": "m", "metres": "m", "NM": "nmi", "kts": "kt", "knot": "kt", "knots": "kt"},
    **{"mbars": "mbar", "lbs": "lb", "slugs": "slug", "dps": "deg/s", "mps": "m/s", "fps": "ft/s", "kmh": "km/h"},
    **{"kph": "km/h", "g0": "g", "gn": "g", "-": "", "1": "", "none": "", "kelvin": "K", "°R": "degR", "/s": "1/s"},
    **{"U/min": "rpm", "n/a": ""},
}
# Temperatures whose zero is not that of K: (offset added first, factor).
_OFFSET = {"degC": (273.15, 1.0), "°C": (273.15, 1.0), "degF": (459.67, 5.0 / 9.0), "°F": (459.67, 5.0 / 9.0)}

# The base units of each SI unit, so that newtons are not converted to pascals.
_BASE: dict[str, dict[str, int]] = {
    **{unit: {unit: 1} for unit in ("s", "m", "kg", "rad", "K", "A")},
    "N": {"kg": 1, "m": 1, "s": -2},
    "Pa": {"kg": 1, "m": -1, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2},
    "W": {"kg": 1, "m": 2, "s": -3},
    "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
    "T": {"kg": 1, "s": -2, "A": -1},
    "Hz": {"s": -1},
}


@dataclass(frozen=True)
class _Scale:
    """A unit as ``si = factor * (value + offset)``: ``label`` is the unit in SI, ``dimensions`` its powers of base
    units."""

    label: str
    factor: float
    dimensions: tuple[tuple[str, int], ...]
    offset: float = 0.0


def si(unit: str) -> str | None:
    """Return the SI unit of the same kind, ``"rad/s"`` for ``"deg/s"``; None for an unknown unit.

    >>> si("ft/s^2"), si("kt"), si("furlong")
    ('m/s^2', 'm/s', None)
    """
    scale = _scale(unit)
    return None if scale is None else scale.label


def convert(values: FloatArray, unit: str, into: str, where: str) -> FloatArray:
    """Return values in ``unit`` converted to ``into``; raise DataError, with ``where``, for unknown or incompatible
    units.

    >>> convert(np.array([180.0, 90.0]), "deg", "rad", "alpha")
    array([3.14159265, 1.57079633])
    """
    scales = []
    for text in (unit, into):
        scale = _scale(text)
        if scale is None:
            raise DataError(
                f"{where}: the unit '{text}' is not known.{listing(text, [*filter(None, _TABLE), *_OFFSET])}"
            )
        scales.append(scale)
    source, target = scales
    if source.dimensions != target.dimensions:
        raise DataError(f"{where}: '{unit}' cannot become '{into}': they are units of different kinds")
    if source == target:
        return values
    return np.asarray((values + source.offset) * (source.factor / target.factor) - target.offset)


def differ(unit: str, other: str) -> bool:
    """Return whether a number in one unit means something else in the other; False where either is not known.

    Radians are no dimension here: who writes ``1/s`` for an angular rate means ``rad/s``. Hertz count cycles, of which
    each has 2π rad.

    >>> differ("deg", "rad"), differ("1/s", "rad/s"), differ("m", "m/s"), differ("furlong", "m"), differ("Hz", "rad/s")
    (True, False, True, False, True)
    """
    scales = [_scale(text) for text in (unit, other)]
    one, two = scales
    if one is None or two is None:
        return False
    if any("Hz" in a.label and "rad" in b.label for a, b in ((one, two), (two, one))):
        return True
    kinds = [{(d, p) for d, p in scale.dimensions if d != "rad"} for scale in (one, two)]
    return kinds[0] != kinds[1] or one.offset != two.offset or not math.isclose(one.factor, two.factor, rel_tol=1e-9)


def target(unit: str, wanted: str = "") -> str | None:
    """Return the unit to convert to: the one ``wanted`` where it is of the same kind, else that of SI; None for an
    unknown unit.

    A number per minute or hour becomes one in Hz: it may count revolutions, and ``1/s`` might be taken for ``rad/s``.

    >>> target("deg"), target("rpm", "rad/min"), target("m", "kW"), target("1/min"), target("1/min", "1/h")
    ('rad', 'rad/min', 'm', 'Hz', '1/h')
    """
    scale, into = _scale(unit), _scale(wanted) if wanted else None
    if scale is None:
        return None
    if into is not None and scale.dimensions == into.dimensions:
        return wanted
    return "Hz" if scale.dimensions == (("s", -1),) and scale.factor != 1.0 else scale.label


def _scale(unit: str) -> _Scale | None:
    """Parse a unit as people write it: ``deg/s``, ``m/s**2``, ``m s^-2``, ``kg*m²``; None where a part is not known."""
    text = unit.strip().replace("²", "^2").replace("³", "^3").replace("**", "^").replace("µ", "u").replace("μ", "u")
    text = text.replace("·", "*")
    if text in _OFFSET:
        offset, factor = _OFFSET[text]
        return _Scale("K", factor, (("K", 1),), offset)
    text = _ALSO.get(text, _ALSO.get(text.lower(), text))
    factor, label = 1.0, ""
    dimensions: dict[str, int] = {}
    if not re.fullmatch(r"([^*/ ]+([*/ ]|\s*[*/]\s*))*[^*/ ]*", text) or text.endswith(("/", "*")):
        return None
    # "m/s/s": each division holds for the one factor after it.
    for sign, atom in re.findall(r"([*/ ]?)\s*([^*/ ]+)\s*", text):
        match = re.fullmatch(r"([A-Za-z°%]+?)\^?(-?\d+)?", atom)
        if atom == "1" and not label:
            label = "1"
            continue
        known = _atom(match[1]) if match else None
        if match is None or known is None:
            return None
        base, size = known
        power = int(match[2] or 1)
        if "/" in base and (sign == "/" or power != 1):
            return None  # per knot, or knots squared: no one writes these, and no label would be right
        label += (sign.strip() or ("*" if label else "")) + (base if power == 1 else f"{base}^{power}")
        signed = -power if sign == "/" else power
        factor *= size**signed
        for part, p in _parts(base):
            dimensions[part] = dimensions.get(part, 0) + p * signed
    return _Scale(label, factor, tuple(sorted((d, p) for d, p in dimensions.items() if p)))


def _atom(text: str) -> tuple[str, float] | None:
    """Look a unit up in the table, also in capitals where these are unambiguous: DEG, FT, KTS."""
    text = _ALSO.get(text, text)
    if text not in _TABLE and text.lower() != "kn":  # KN is knots to one and kilonewtons to another
        lowered = {key.lower(): key for key in _TABLE}
        text = _ALSO.get(text.lower(), lowered.get(text.lower(), text))
    return _TABLE.get(text)


def _parts(base: str) -> list[tuple[str, int]]:
    """Return the dimensions of a unit in SI as the table writes it: for ``m/s^2`` metre 1, second -2."""
    parts: list[tuple[str, int]] = []
    for i, piece in enumerate(filter(None, base.split("/"))):
        name, _, power = piece.partition("^")
        signed = int(power or 1) * (-1 if i else 1)
        parts += [(d, p * signed) for d, p in _BASE[name].items()]
    return parts


def check_units(model: Model, runs: Sequence[Experiment], caller: str) -> None:
    """Raise DataError, in the caller's name, for a channel in degrees that the model has in radians, and the like.

    Estimates from such data would be wrong without any sign of it. Units that are not given or not known are not
    checked.
    """
    declared, unit = model.units, model.time_unit
    for run in runs:
        if run.time_unit and differ(run.time_unit, unit):
            raise DataError(
                f"{caller}: the times of experiment '{run.name}' are in '{run.time_unit}', but the model has time in "
                f"'{unit}'; read it with time_unit='{unit}', or declare Model(..., time_unit='{run.time_unit}')"
            )
        for side, names in (("input", model.input_names), ("output", model.output_names)):
            for name in names:
                kind = "condition" if side == "input" and model.is_condition(name) else side
                recorded, expected = run.units.get(name, ""), declared.get(name, "")
                if recorded and expected and differ(recorded, expected):
                    raise DataError(
                        f"{caller}: {kind} '{name}' of experiment '{run.name}' is in '{recorded}', but the model has "
                        f"it in '{expected}'; {_remedy(run, name, recorded, expected)}"
                    )


def _remedy(run: Experiment, name: str, recorded: str, expected: str) -> str:
    """Return what to do about a unit that is not that of the model."""
    steps = re.findall(rf"(?:converted |, ){re.escape(name)} from (.+?) to ", " ".join(run.history))
    stated = steps[-1] if steps else recorded  # in the file
    wrong = f"if the stated unit is wrong, correct it with units={{'{name}': '{expected}'}}"
    if target(stated, expected) == expected:
        return (
            f"convert its values, or let ph.read do it: all channels with convert=m.units, or this one with "
            f"units={{'{name}': ('{stated}', '{expected}')}}; or, {wrong}"
        )
    scale = _scale(stated)
    if scale is not None and scale.dimensions == (("s", -1),) and "rad" in expected:
        turns = "rpm" if math.isclose(scale.factor, 1.0 / 60.0) else "rev/s"
        return f"if it counts revolutions, give units={{'{name}': ('{turns}', '{expected}')}}; {wrong}"
    return f"these are units of different kinds; {wrong}"
