"""The user's model: states, inputs, parameters, quantities, state equations and outputs."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from .. import _core
from .._core import Expr
from ..errors import DataError, ModelError, did_you_mean, refuse_attribute
from ..noise.kinds import PerOutput, noise_from_dict
from ..noise.noise import KINDS, Gaussian, Noise, Sigma
from ..parameters import Parameter
from ..writing import sealed, unsealed, write
from .declared import Declared
from .delayed import Delays, at_delays
from .rebuilt import rebuilt
from .state import State

__all__ = ["Model"]

_PACKAGE = os.path.join(os.path.dirname(os.path.dirname(os.path.abspath(__file__))), "")


def _source() -> str | None:
    """``file:line`` of the user's call: the innermost frame outside this package."""
    frame = sys._getframe(1)
    while frame is not None:
        if not os.path.abspath(frame.f_code.co_filename).startswith(_PACKAGE):
            return f"{os.path.basename(frame.f_code.co_filename)}:{frame.f_lineno}"
        if frame.f_back is None:
            break
        frame = frame.f_back
    return None


def _declared(kind: str, names: tuple[str, ...], units: Mapping[str, Any]) -> dict[str, Any]:
    """Names from ``"a b"`` or ``"a", "b"`` (without value) and from ``a=..., b=...``."""
    given: list[tuple[str, Any]] = []
    for text in names:
        if not isinstance(text, str):
            raise ModelError(f"{kind}: names are text, as in {kind}('a b') or {kind}(a='m/s'), not {text!r}")
        given += [(name, None) for name in text.replace(",", " ").split()]
    given += units.items()
    if not given:
        raise ModelError(f"{kind}: no names were given")
    found = dict(given)
    if len(found) < len(given):
        listed = [name for name, _ in given]
        raise ModelError(f"{kind}: '{next(n for n in listed if listed.count(n) > 1)}' is there twice")
    return found


def _with_units(kind: str, declared: Mapping[str, Any]) -> dict[str, str]:
    for name, unit in declared.items():
        if not isinstance(unit, (str, type(None))):
            raise ModelError(f"{kind}: the unit of '{name}' is text, not {unit!r}")
    return {name: unit or "" for name, unit in declared.items()}


class Model:
    """A model of ordinary differential equations: x' = f(x, u, theta), y = g(x, u, theta).

    (Eqs. state_dynamics and output_equations of the paper.) Declare states, inputs and parameters, then give the
    dynamics and the outputs:

    >>> m = Model("first-order lag")
    >>> x, = m.states(x="m")
    >>> u, = m.inputs(u="m")
    >>> T, = m.parameters(T=Parameter(1.0, bounds=(0.01, 100), unit="s"))
    >>> m.dynamics(x=(u - x)/T)
    >>> m.outputs(x=x)
    """

    # Parameters of the core, and the same as declared.
    _made: tuple[list[Any], dict[str, Parameter]] = ([], {})

    def __init__(self, name: str = "model") -> None:
        self._core = _core.Model(str(name))
        self._noise: Noise = Gaussian()
        self._delays = Delays()

    def __setattr__(self, name: str, value: Any) -> None:
        refuse_attribute(self, Model, name, value)
        object.__setattr__(self, name, value)

    @property
    def name(self) -> str:
        """Title."""
        return self._core.name

    def states(self, *names: str, **states: str | State) -> tuple[Expr, ...]:
        """Declares states, ``name="unit"``, ``"a b c"``, or ``name=State("unit", start=..., bounds=...)``; returns
        their symbols in order."""
        declared = _declared("states", names, states)
        plain = {name: value for name, value in declared.items() if not isinstance(value, State)}
        whole = {name: State(unit) for name, unit in _with_units("states", plain).items()}
        each = {name: whole.get(name, value) for name, value in declared.items()}
        return Declared(self._core.state(name, s.unit, s.start, *s.bounds) for name, s in each.items())

    def inputs(self, *names: str, **units: str) -> tuple[Expr, ...]:
        """Declares inputs, ``name="unit"`` or ``"a b c"``; returns their symbols in order."""
        declared = _with_units("inputs", _declared("inputs", names, units))
        return Declared(self._core.input(n, u) for n, u in declared.items())

    def parameters(self, *names: str, **parameters: Parameter | float) -> tuple[Expr, ...]:
        """Declares unknown parameters: ``"a b"`` (start 0), ``a=start`` or ``a=Parameter(...)``.

        Returns their symbols in order.
        """
        declared = _declared("parameters", names, parameters)
        symbols = []
        for name, value in declared.items():
            try:
                p = value if isinstance(value, Parameter) else Parameter(0.0 if value is None else value)
            except (ModelError, TypeError) as error:
                raise ModelError(f"parameter '{name}': {error}") from None
            low, high = p.bounds
            log = p.transform == "log"
            symbols.append(
                self._core.parameter(name, p.unit, p.start, low, high, p.prior, p.fixed, p.per_experiment, log, p.scale)
            )
        return Declared(symbols)

    def delay(self, input: Expr, by: Expr, name: str | None = None) -> Expr:
        """The symbol of an input that acts late, u(t - tau), with ``by`` the parameter tau (s), which is estimated.

        ``name`` is what to call it, ``<input>_delayed`` unless given. Before the first sample the input is taken as
        constant. A delay below zero is a lead.
        """
        u = self._declared(input, self.input_names, "delay", "an input")
        tau = self._declared(by, self.parameter_names, f"delay of {u}", "a parameter")
        late = name or f"{u}_delayed"
        symbol = self._core.input(late, self.units.get(u, ""))
        self._delays = self._delays.with_input(late, u, tau)
        return symbol

    def sensor_delay(self, **by: Expr) -> None:
        """Says that outputs are measured late, z(t) = y(t - tau): ``sensor_delay(alpha=tau)``, tau a parameter (s)."""
        for output, tau in by.items():
            if output not in self.output_names:
                hint = did_you_mean(output, self.output_names)
                raise ModelError(f"sensor_delay: '{output}' is not an output.{hint}")
            parameter = self._declared(tau, self.parameter_names, f"sensor_delay of {output}", "a parameter")
            self._delays = self._delays.with_output(output, parameter)

    def _declared(self, symbol: Any, names: tuple[str, ...], where: str, what: str) -> str:
        found = Expr(symbol).symbols if isinstance(symbol, Expr) else []
        if len(found) != 1 or str(symbol) != next(iter(found)) or str(symbol) not in names:
            raise ModelError(f"{where}: give the symbol of {what} of this model, not {symbol!r}")
        return str(symbol)

    @property
    def delays(self) -> Delays:
        """Inputs and outputs that are late."""
        return self._delays

    @property
    def time(self) -> Expr:
        """The symbol of time, s."""
        return Expr.symbol("time")

    def quantities(self, **expressions: Any) -> tuple[Expr, ...]:
        """Names intermediate quantities; returns their symbols in order.

        A term that is added to a quantity later enters wherever the quantity is used.
        """
        source = _source()
        return Declared(self._each("quantity", expressions, lambda n, e: self._core.quantity(n, e, source)))

    def dynamics(self, **expressions: Any) -> None:
        """Gives state equations: ``dynamics(x=...)`` is x' = ... (per second)."""
        source = _source()
        self._each("dynamics", expressions, lambda n, e: self._core.equation(n, e, source))

    def initial(self, **expressions: Any) -> None:
        """Gives states at the first sample, which are else free: ``initial(q=0.0)``, ``initial(h=h0)``.

        An expression may hold parameters, and inputs, time and other states at that sample: a trim condition.
        """
        self._conditions("initial", expressions)

    def final(self, **expressions: Any) -> None:
        """Gives states at the last sample, as `initial` does at the first."""
        self._conditions("final", expressions)

    def periodic(self, *states: str, **differences: Any) -> None:
        """Lets states end as they began: ``periodic("q")``; ``periodic(psi=2*math.pi)`` but for a difference, which may
        depend on parameters."""
        self._conditions("periodic", {**dict.fromkeys(states, 0.0), **differences})

    def _conditions(self, end: str, expressions: Mapping[str, Any]) -> None:
        source = _source()
        self._each(f"{end} condition", expressions, lambda n, e: self._core.condition(end, n, e, source))

    def outputs(self, *args: Any, **expressions: Any) -> None:
        """Declares what is measured: ``outputs(name=expression)`` or ``name=(expression, "unit")``."""
        if args:
            raise ModelError("outputs: give each output a name, as in outputs(q=q)")
        source = _source()

        def declare(name: str, value: Any) -> None:
            expression, unit = value if isinstance(value, tuple) and len(value) == 2 else (value, "")
            self._core.output(name, expression, unit, source)

        self._each("outputs", expressions, declare)

    def _each(self, kind: str, expressions: Mapping[str, Any], act: Callable[[str, Any], Any]) -> list[Any]:
        if not expressions:
            raise ModelError(f"{kind}: no equations were given")
        results = []
        for name, expression in expressions.items():
            if isinstance(expression, Declared):
                expression.no_expression()
            try:
                results.append(act(name, expression))
            except TypeError as error:
                raise ModelError(f"{kind} of '{name}' ({_source()}): {error}") from None
        return results

    def noise(self, *args: Noise, **sigma: float | Sigma | Noise) -> None:
        """States what is known of the noise: ``noise(alpha=0.002)`` for a known standard deviation of an output,
        ``noise(alpha=Sigma(...))`` for an unknown one with start and bounds, ``noise(az=StudentT())`` for the
        density of an output, or a whole noise model, ``noise(Gaussian(correlated=True))``."""
        if (args and sigma) or len(args) > 1:
            raise ModelError("noise: give a noise model or standard deviations by output, not both")
        if args and not isinstance(args[0], Noise):
            raise ModelError(f"noise: a noise model is {KINDS}, not {args[0]!r}; name outputs, as in noise(q=0.01)")
        if args:
            self._noise = args[0]
            return
        before = self._noise
        densities = dict(before.outputs) if isinstance(before, PerOutput) else {}
        densities |= {name: noise for name, noise in sigma.items() if isinstance(noise, Noise)}
        scales = {name: s for name, s in sigma.items() if not isinstance(s, Noise)}
        joint = isinstance(before, Gaussian) and (before.correlated or before.covariance is not None)
        if joint or not isinstance(before, (Gaussian, PerOutput)):
            raise ModelError(
                f"noise: the model has {before.kind} noise for all outputs; give the whole noise model anew, with sigma"
            )
        scales = {**before.sigma, **scales}
        self._noise = PerOutput(densities, scales) if densities else Gaussian(scales)

    @property
    def noise_model(self) -> Noise:
        """The noise model, unless `estimate` is given another."""
        return self._noise

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states, in order."""
        return tuple(name for name, _ in self._core.states)

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs that data must have, in order."""
        return tuple(name for name, _ in self._core.inputs if name not in self._delays.inputs)

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of the outputs, in order."""
        return tuple(name for name, *_ in self._core.outputs)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters, in order."""
        return tuple(name for name, *_ in self._core.parameters)

    @property
    def declared_parameters(self) -> dict[str, Parameter]:
        """The parameters as declared."""
        rows = self._core.parameters
        if rows != self._made[0]:  # of a thousand parameters they take long to make
            made = {
                name: Parameter(start, (low, high), unit, prior, fixed, local, "log" if log else None, scale)
                for name, unit, start, low, high, prior, fixed, local, log, scale in rows
            }
            self._made = rows, made
        return dict(self._made[1])

    @property
    def declared_states(self) -> dict[str, State]:
        """The states as declared."""
        return {name: State(unit, start, (low, high)) for name, unit, start, low, high in self._core.declared_states}

    @property
    def units(self) -> dict[str, str]:
        """Units of states, inputs, parameters and outputs by name, where known."""
        pairs = [*self._core.states, *self._core.inputs]
        pairs += [(name, unit) for name, unit, *_ in self._core.parameters]
        pairs += [(name, unit) for name, _, unit, _ in self._core.outputs]
        return {name: unit for name, unit in pairs if unit}

    @property
    def equations(self) -> dict[str, Expr]:
        """Right-hand sides by name: quantities, state equations (with a prime: ``q'``) and outputs (``y:q``)."""
        found = {name: e for name, e, *_ in self._core.quantities}
        found |= {f"{name}'": e for name, e, *_ in self._core.dynamics}
        return found | {f"y:{name}": e for name, e, *_ in self._core.outputs}

    def output_expressions(self) -> dict[str, Expr]:
        """Outputs with all quantities put in."""
        known: dict[str, Any] = {}
        for name, e, *_ in self._core.quantities:
            known[name] = e.substitute(known)
        return {name: e.substitute(known) for name, e, *_ in self._core.outputs}

    def check(self) -> None:
        """Raises ModelError where the model is incomplete: a state without equation, an unknown symbol, ..."""
        if self._delays:
            at_delays(self, {name: self.declared_parameters[name].start for name in self._delays.parameters}).check()
        else:
            self._core.check()

    def latex(self) -> str:
        """The equations as a LaTeX ``aligned`` block."""
        lines = [f"{Expr.symbol(n).latex()} &= {e.latex()}" for n, e, *_ in self._core.quantities]
        lines += [rf"\dot{{{Expr.symbol(n).latex()}}} &= {e.latex()}" for n, e, *_ in self._core.dynamics]
        lines += [rf"\tilde{{{Expr.symbol(n).latex()}}} &= {e.latex()}" for n, e, *_ in self._core.outputs]
        return "\\begin{aligned}\n" + " \\\\\n".join(lines) + "\n\\end{aligned}"

    def to_json(self) -> str:
        """The model as text that `from_json`, and the Rust crate, read back exactly."""
        text = self._core.to_json()
        more = {"noise": self._noise.to_dict(), "delays": self._delays.to_dict()}
        more = {key: value for key, value in more.items() if value}
        return json.dumps({**json.loads(text), **more}) if more else text

    @classmethod
    def from_json(cls, text: str) -> Model:
        """Reads `to_json`. Raises ModelError for other text."""
        model = cls.__new__(cls)
        model._core = _core.Model.from_json(text)
        try:
            saved = json.loads(text)
            model._noise = noise_from_dict(saved.get("noise", {}))
            model._delays = Delays.from_dict(saved.get("delays", {}))
        except ModelError:
            raise
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            raise ModelError(
                f"saved model: its noise or delays are damaged ({type(error).__name__}: {error})"
            ) from error
        return model

    def _holding(self, values: Mapping[str, float]) -> Model:
        """The model with some parameters fixed at these values."""
        if not values:
            return self

        def declare(core: _core.Model, declared: Any) -> None:
            name, unit, start, low, high, prior, fixed, *others = declared
            core.parameter(name, unit, values.get(name, start), low, high, prior, fixed or name in values, *others)

        return self._around(rebuilt(self._core, self._core.inputs, declare), self._delays)

    def _smoothed(self, widths: Sequence[float]) -> Model:
        """The model with each kink of its state equations made smooth over a width."""
        return self._around(self._core.smoothed(widths), self._delays)

    def _around(self, core: _core.Model, delays: Delays) -> Model:
        """A model with another core and the noise of this one."""
        model = type(self).__new__(type(self))
        model._core, model._noise, model._delays = core, self._noise, delays
        return model

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes `to_json` to a file; DataError where that cannot be done."""
        write(path, json.dumps(sealed(json.loads(self.to_json())), ensure_ascii=False), "the model")

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Model:
        """Reads a file that `save` wrote; DataError where it cannot be read, ModelError where it holds no model."""
        try:
            text = Path(path).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise DataError(
                f"{path}: cannot be read ({getattr(error, 'strerror', None) or 'it is no text'})"
            ) from error
        model = cls.from_json(text)
        unsealed(json.loads(text), str(path))
        return model

    def __reduce__(self) -> Any:
        return Model.from_json, (self.to_json(),)

    def __repr__(self) -> str:
        counts = f"{len(self.state_names)} states, {len(self.input_names)} inputs, {len(self.output_names)} outputs"
        return f"<Model '{self.name}': {counts}, {len(self.parameter_names)} parameters>"

    def __str__(self) -> str:
        lines = [f"{name} = {e}" for name, e, *_ in self._core.quantities]
        lines += [f"{name}' = {e}" for name, e, *_ in self._core.dynamics]
        lines += [f"{name} (measured) = {e}" for name, e, *_ in self._core.outputs]
        lines += [f"{state} ({end}) = {e}" for end, state, e, _ in self._core.conditions]
        return "\n".join([self.name, *(f"  {line}" for line in lines)])
