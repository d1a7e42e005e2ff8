"""Parameters that change in the course of a record: slowly, with the integral of an input, or at one time; and zeros
of sensors that jump."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ..._core import Expr
from ...errors import joined
from ...functions import smooth_step
from ...modelling.model import Model
from ...sensitivities import Place, Points
from .candidate import Effect, ExtensionBuilder
from .scales import evaluated, integral, of

__all__ = ["CommonJump", "FallingMass", "Jump", "ParameterDrift", "ParameterWithIntegral"]

_Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class ParameterDrift(Effect):
    """The parameter p becomes p + d (t - tm) / T, with the middle tm of the record and its length T: d is its change
    over the record. That is another in another record."""

    transferable = False

    def _share(self, t: Expr) -> Expr:
        return Expr((t - (self.scales.begin + 0.5 * self.scales.duration)) / self.scales.duration)

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        middle = self.scales.begin + 0.5 * self.scales.duration
        return ((points.t - middle) / self.scales.duration)[np.newaxis]

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        d = extension.parameter(self.coefficients[0], unit=model.variable_units.get(self.place.name, ""))
        extension.replace_parameter(
            self.place.name, Expr.symbol(self.place.name) + d * self._share(Expr.symbol("time"))
        )
        return extension.model()

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        return {self.coefficients[0]: (-np.inf, np.inf)}


@dataclass(frozen=True, eq=False, repr=False)
class _WithIntegral(Effect):
    """An effect of the integral of an input, the ``variables``' only one, since the first sample: z, in parts of the
    largest of all records."""

    def worthwhile(self) -> bool:
        return self.variables[0] in self.scales.integrals

    def _integral(self, points: Points) -> _Array:
        (name,) = self.variables
        u = of(points.values, name, points, "input")
        return integral(points.t, u) / self.scales.integrals.get(name, 1.0)

    def paths(self, points: Points, start: Mapping[str, float]) -> Mapping[str, _Array]:
        return {f"integral_{self.variables[0]}": self._integral(points)}

    def _state(self, extension: ExtensionBuilder) -> Expr:
        """Return the integral, which becomes a state of the model under extension."""
        (name,) = self.variables
        largest = self.scales.integrals.get(name, 1.0)
        return extension.state(f"integral_{name}", "", lambda _: Expr.symbol(name) / largest, 0.0)


@dataclass(frozen=True, eq=False, repr=False)
class ParameterWithIntegral(_WithIntegral):
    """The parameter p becomes p + d z: thrust falls as charge is drawn from a battery, say. d is the change over the
    record with the largest integral."""

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        return self._integral(points)[np.newaxis]

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        d = extension.parameter(self.coefficients[0], unit=model.variable_units.get(self.place.name, ""))
        changed = Expr.symbol(self.place.name) + d * self._state(extension)
        extension.replace_parameter(self.place.name, changed)
        return extension.model()

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        return {self.coefficients[0]: (-np.inf, np.inf)}


# Least and greatest part of a mass that is used over a record.
_USED = (-0.5, 0.9)


@dataclass(frozen=True, eq=False, repr=False)
class FallingMass(_WithIntegral):
    """The forces in a state equation, and what of them outputs show, act on a mass that falls: they become
    1 / (1 - k z) times as large, and k is the part of the mass that is used over the record with the largest integral.
    The part of the equation that is ``motion`` without forces, such as gravity, stays as it is."""

    motion: Expr = field(default_factory=lambda: Expr(0.0))
    stage: int = 1  # of terms that were added, too

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        known = evaluated(self.motion, points)
        return ((points.rates[self.place.name] - known) * self._integral(points))[np.newaxis]

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        k = extension.parameter(self.coefficients[0], bounds=_USED)
        used = k * self._state(extension)
        extension.add(self.place, (extension.at(self.place) - self.motion) * used / (1 - used))
        return extension.model()

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        return {self.coefficients[0]: _USED}


# Times at which a parameter may jump, and the width of the jump in samples.
_TIMES, _WIDE = 24, 2.0


@dataclass(frozen=True, eq=False, repr=False)
class Jump(Effect):
    """A parameter p becomes p + d from a time on: a load that is dropped, a flap that is set, a part that fails. Or an
    output does: an altimeter that is set again, an encoder that slips."""

    transferable = False

    @property
    def several_starts(self) -> bool:
        return True

    def grid(self) -> Iterable[float]:
        shares = np.arange(1, _TIMES + 1) / (_TIMES + 1)
        return np.asarray(self.scales.begin + self.scales.duration * shares)

    @property
    def _width(self) -> float:
        return _WIDE * self.scales.interval

    @property
    def _changed(self) -> tuple[str, ...]:
        """Names of what changes, in the order of the coefficients."""
        return (self.place.name,)

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        late = (points.t - shape[self.shape_names[0]]) / self._width
        return (0.5 * (1.0 + np.tanh(late)))[np.newaxis]

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        sizes = [
            extension.parameter(c, unit=model.variable_units.get(name, ""))
            for c, name in zip(self.coefficients, self._changed, strict=True)
        ]
        step = self._step(extension)
        for name, size in zip(self._changed, sizes, strict=True):
            if self.place.kind == "output":
                extension.add(self.place, size * step)
            else:
                extension.replace_parameter(name, Expr.symbol(name) + size * step)
        return extension.model()

    def _step(self, extension: ExtensionBuilder) -> Expr:
        """Return a step from 0 to 1 at the time, which becomes a parameter of the model under extension."""
        (name,) = self.shape_names
        span = self.scales.begin, self.scales.begin + self.scales.duration
        first = self.shapes[len(self.shapes) // 2][name]
        at = extension.parameter(name, first, bounds=span, unit=extension.old.time_unit)
        return Expr(smooth_step(Expr.symbol("time") - at, self._width))

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        times = [shape[self.shape_names[0]] for shape in self.shapes]
        sizes = dict.fromkeys(self.coefficients, (-np.inf, np.inf))
        return {**sizes, self.shape_names[0]: (min(times), max(times))}


@dataclass(frozen=True, eq=False, repr=False)
class CommonJump(Jump):
    """Several parameters change at one time: ice on a wing, a flap that is set, damage. ``changed`` are their names;
    the coefficients are the changes, in the same order."""

    changed: tuple[str, ...] = ()

    @property
    def _changed(self) -> tuple[str, ...]:
        return self.changed

    @staticmethod
    def of(jumps: Sequence[Jump]) -> CommonJump:
        """Return the candidate for a common time of several jumps, each of one parameter."""
        first, names = jumps[0], tuple(j.place.name for j in jumps)
        coefficients = tuple(j.coefficients[0] for j in jumps)
        found = CommonJump("", first.place, "", first.family, first.scales, coefficients, first.shape_names)
        return found._with(coefficients, names)

    def only(self, coefficients: Collection[str]) -> CommonJump:
        """Return the candidate with some of its coefficients."""
        kept = [k for k, c in enumerate(self.coefficients) if c in coefficients]
        return self._with([self.coefficients[k] for k in kept], [self.changed[k] for k in kept])

    def _with(self, coefficients: Sequence[str], changed: Sequence[str]) -> CommonJump:
        words = f"{joined(changed)} change abruptly at one time during the record (a load, a setting, a failure)"
        return replace(
            self,
            name=f"{','.join(changed)}:step",
            place=Place("parameter", changed[0]),
            explanation=words,
            coefficients=tuple(coefficients),
            changed=tuple(changed),
        )

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        return np.repeat(super().signals(points, shape), len(self.changed), axis=0)
