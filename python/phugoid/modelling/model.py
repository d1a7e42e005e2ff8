"""The user's model: states, inputs, parameters, constants, quantities, state equations and outputs."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from typing import Any

import phugoid._core as _core

from .._core import Expr
from ..errors import ModelError, did_you_mean, refuse_attribute
from ..parameters import Parameter
from ..time_unit import SECONDS, TimeUnit
from ..writing import read_text, sealed, unsealed, write
from .constant import Constant, declared_constant
from .declared import (
    Declared,
    Delays,
    Key,
    State,
    added_parameters,
    changed,
    changed_parameters,
    check_units,
    declare_each,
    declare_parameter,
    declared_symbol,
    equations_of,
    model_html,
    model_latex,
    model_text,
    named_equations,
    parameters_of,
    read_names,
    saved_conditions,
    separated,
    source_line,
    terms_added,
    time_note,
)
from .densities import noise_from_dict, stated_noise
from .noise import Gaussian, Noise, Sigma

__all__ = ["Model"]

# Characters of LaTeX: notebooks show longer models as text.
_LONGEST = 20_000


class Model:
    """A model of ordinary differential equations: x' = f(x, u, theta), y = g(x, u, theta).

    Declare states, inputs and parameters, then give the dynamics and the outputs:

    >>> m = Model("first-order lag")
    >>> x, = m.states(x="m")
    >>> u, = m.inputs(u="m")
    >>> T, = m.parameters(T=Parameter(1.0, bounds=(0.01, 100), unit="s"))
    >>> m.dynamics(x=(u - x)/T)
    >>> m.outputs(x=x)

    ``time_unit`` is the unit of time, of the data as of rates and time constants: ``Model("house", time_unit="h")``.
    Results, figures and pages use it. Nothing is converted.
    """

    # Parameters of the core, and the same as declared.
    _made: tuple[list[Any], dict[str, Parameter]] = ([], {})
    # Inputs that are measured conditions, in order; the core takes all inputs alike.
    _condition_names: tuple[str, ...] = ()
    _time_unit = SECONDS

    def __init__(self, name: str = "model", *, time_unit: str = "s") -> None:
        self._time_unit = TimeUnit.checked(time_unit, f"model '{name}'")
        self._core = _core.Model(str(name))
        self._noise: Noise = Gaussian()
        self._delays = Delays()

    def __setattr__(self, name: str, value: Any) -> None:
        refuse_attribute(self, Model, name, value)
        object.__setattr__(self, name, value)

    @property
    def name(self) -> str:
        """Name of the model."""
        return self._core.name

    def states(self, *names: str, **states: str | State) -> tuple[Expr, ...]:
        """Declare states, ``name="unit"``, ``"a b c"``, or ``name=State("unit", start=..., bounds=...)``; return their
        symbols in order."""
        declared = read_names("states", names, states)
        plain = {name: value for name, value in declared.items() if not isinstance(value, State)}
        whole = {name: State(unit) for name, unit in check_units("states", plain).items()}
        each = {name: whole.get(name, value) for name, value in declared.items()}
        return Declared(self._core.state(name, s.unit, s.start, *s.bounds) for name, s in each.items())

    def inputs(self, *names: str, **units: str) -> tuple[Expr, ...]:
        """Declare inputs, ``name="unit"`` or ``"a b c"``; return their symbols in order.

        They are controls: what a pilot, a test engineer or an actuator moves. What is only measured is declared by
        `conditions`.
        """
        declared = check_units("inputs", read_names("inputs", names, units))
        return Declared(self._core.input(n, u) for n, u in declared.items())

    def conditions(self, *names: str, **units: str) -> tuple[Expr, ...]:
        """Declare measured conditions: airspeed, dynamic pressure, mass, a wind; return their symbols in order.

        They are inputs, which records must have, as those of `inputs` are, but they are not commanded. So `candidates`
        offers a scale, a bias and a delay of their measurement, but no dead-band, saturation, backlash, limited rate or
        lag; no manoeuvre is advised on them; and `plan` keeps them where they are unless they are given.

        >>> m = Model("roll")
        >>> p, = m.states(p="rad/s")
        >>> da, = m.inputs(da="rad")
        >>> V, = m.conditions(V="m/s")
        >>> m.input_names, m.condition_names
        (('da', 'V'), ('V',))
        """
        symbols = []
        for name, unit in check_units("conditions", read_names("conditions", names, units)).items():
            symbols.append(self._core.input(name, unit))
            self._condition_names = (*self._condition_names, name)
        return Declared(symbols)

    def parameters(self, *names: str, **parameters: Parameter | float) -> tuple[Expr, ...]:
        """Declare unknown parameters: ``"a b"`` (start 0), ``a=start`` or ``a=Parameter(...)``.

        Return their symbols in order.
        """
        declared = read_names("parameters", names, parameters)
        symbols = []
        for name, value in declared.items():
            try:
                p = value if isinstance(value, Parameter) else Parameter(0.0 if value is None else value)
            except (ModelError, TypeError) as error:
                raise ModelError(f"parameter '{name}': {error}") from None
            symbols.append(declare_parameter(self._core, name, p))
        return Declared(symbols)

    def constants(self, *names: str, **constants: Constant | float) -> tuple[Expr, ...]:
        """Declare known constants, ``g=9.80665`` or ``S=Constant(30.1, "m²", "wing area")``; return them in order.

        Equations show them by name, and tables list value, unit and meaning. In all else they are their values: they
        take no time, and they are not estimated. A number that is to be changed later, or to be estimated on other
        data, is a parameter: ``Parameter(30.1, fixed=True)``.

        >>> m = Model("fall")
        >>> v, = m.states(v="m/s")
        >>> k, = m.parameters("k")
        >>> g, = m.constants(g=Constant(9.80665, "m/s²", "acceleration of gravity"))
        >>> m.dynamics(v=g - k*v**2)
        >>> m.equations["v'"]
        g - k*v**2
        >>> m.declared_constants["g"].unit
        'm/s²'
        """
        each = {n: declared_constant(n, c) for n, c in read_names("constants", names, constants).items()}
        return Declared(self._core.constant(name, c.value, c.unit, c.meaning) for name, c in each.items())

    def delay(self, input: Expr, by: Expr, name: str | None = None) -> Expr:
        """Return the symbol of the delayed input u(t - tau), with ``by`` the parameter tau, which is estimated.

        ``name`` names the symbol, ``<input>_delayed`` unless given. Before the first sample the input is taken as
        constant. A delay below zero is a lead.
        """
        u = declared_symbol(input, self.input_names, "delay", "an input")
        tau = declared_symbol(by, self.parameter_names, f"delay of {u}", "a parameter")
        late = name or f"{u}_delayed"
        symbol = self._core.input(late, self.units.get(u, ""))
        self._delays = self._delays.with_input(late, u, tau)
        return symbol

    def sensor_delay(self, **by: Expr) -> None:
        """Declare that outputs are measured with a delay, z(t) = y(t - tau): ``sensor_delay(alpha=tau)``, tau a
        parameter."""
        for output, tau in by.items():
            if output not in self.output_names:
                hint = did_you_mean(output, self.output_names)
                raise ModelError(f"sensor_delay: '{output}' is not an output.{hint}")
            parameter = declared_symbol(tau, self.parameter_names, f"sensor_delay of {output}", "a parameter")
            self._delays = self._delays.with_output(output, parameter)

    @property
    def delays(self) -> Delays:
        """Inputs and outputs that are delayed."""
        return self._delays

    @property
    def time(self) -> Expr:
        """The symbol of time, in `time_unit`."""
        return Expr.symbol("time")

    @property
    def time_unit(self) -> TimeUnit:
        """The unit of time, "s" unless given."""
        return self._time_unit

    def quantities(self, **expressions: Any) -> tuple[Expr, ...]:
        """Declare intermediate quantities; return their symbols in order. A term that is added to a quantity later
        enters wherever the quantity is used."""
        source = source_line()
        return Declared(declare_each("quantity", expressions, lambda n, e: self._core.quantity(n, e, source)))

    def dynamics(self, **expressions: Any) -> None:
        """Declare state equations: ``dynamics(x=...)`` is x' = ... (per unit of time)."""
        source = source_line()
        declare_each("dynamics", expressions, lambda n, e: self._core.equation(n, e, source))

    def initial(self, **expressions: Any) -> None:
        """Declare states at the first sample, which are free otherwise: ``initial(q=0.0)``, ``initial(h=h0)``.

        An expression may hold parameters, and inputs, time and other states at that sample: a trim condition.
        """
        self._end_conditions("initial", expressions)

    def final(self, **expressions: Any) -> None:
        """Declare states at the last sample, as `initial` does at the first."""
        self._end_conditions("final", expressions)

    def periodic(self, *states: str, **differences: Any) -> None:
        """Declare that states end as they began: ``periodic("q")``; or with a difference, ``periodic(psi=2*math.pi)``,
        which may depend on parameters."""
        self._end_conditions("periodic", {**dict.fromkeys(states, 0.0), **differences})

    def _end_conditions(self, end: str, expressions: Mapping[str, Any]) -> None:
        source = source_line()
        declare_each(f"{end} condition", expressions, lambda n, e: self._core.condition(end, n, e, source))

    def outputs(self, *args: Any, **expressions: Any) -> None:
        """Declare what is measured: ``outputs(name=expression)`` or ``name=(expression, "unit")``."""
        if args:
            raise ModelError("outputs: give each output a name, as in outputs(q=q)")
        source = source_line()

        def declare(name: str, value: Any) -> None:
            expression, unit = value if isinstance(value, tuple) and len(value) == 2 else (value, "")
            self._core.output(name, expression, unit, source)

        declare_each("outputs", expressions, declare)

    def noise(self, *args: Noise, **sigma: float | Sigma | Expr | Noise) -> None:
        """Declare what is known of the noise: ``noise(alpha=0.002)`` for a known standard deviation of an output,
        ``noise(alpha=Sigma(...))`` for an unknown one with start and bounds, ``noise(az=StudentT())`` for the density
        of an output, ``noise(q=a + b*abs(q))`` for a standard deviation that depends on states, inputs and parameters
        of the model, or a whole noise model, ``noise(Gaussian(correlated=True))``."""
        self._with_noise(stated_noise(self._noise, args, sigma))

    def _with_noise(self, noise: Noise) -> Model:
        """Set the noise, whose expressions the core needs too; return the model."""
        self._noise = noise
        self._core.noise_expressions(list(noise.expressions.items()))
        return self

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
        """Names of the inputs that data must have, in order: controls and conditions."""
        return tuple(name for name, _ in self._core.inputs if name not in self._delays.inputs)

    @property
    def condition_names(self) -> tuple[str, ...]:
        """Names of the inputs that `conditions` declared, in order."""
        return self._condition_names

    def is_condition(self, name: str) -> bool:
        """Return whether an input is a measured condition, also a delayed one."""
        of, _ = self._delays.inputs.get(name, (name, ""))
        return of in self._condition_names

    @property
    def quantity_names(self) -> tuple[str, ...]:
        """Names of the quantities, in order."""
        return tuple(name for name, *_ in self._core.quantities)

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of the outputs, in order."""
        return tuple(name for name, *_ in self._core.outputs)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters, in order."""
        return tuple(name for name, *_ in self._core.parameters)

    @property
    def constant_names(self) -> tuple[str, ...]:
        """Names of the constants, in order."""
        return tuple(name for name, *_ in self._core.constants)

    @property
    def declared_constants(self) -> dict[str, Constant]:
        """The constants as declared."""
        return {name: Constant(value, unit, meaning) for name, value, unit, meaning in self._core.constants}

    @property
    def declared_parameters(self) -> dict[str, Parameter]:
        """The parameters as declared."""
        rows = self._core.parameters
        if rows != self._made[0]:  # a thousand of them take long to make
            self._made = rows, parameters_of(rows)
        return dict(self._made[1])

    @property
    def declared_states(self) -> dict[str, State]:
        """The states as declared."""
        return {name: State(unit, start, (low, high)) for name, unit, start, low, high in self._core.declared_states}

    @property
    def declared_inputs(self) -> dict[str, str]:
        """Units of the inputs by name, as declared: delayed inputs of `delay` among them, "" where none was given."""
        return dict(self._core.inputs)

    @property
    def units(self) -> dict[str, str]:
        """Units of states, inputs, parameters, constants and outputs by name, where known; that of ``time`` where it is
        not s.

        Where an output has the name of a state, the unit is that of the output, in which it was measured.
        """
        return self.variable_units | self._output_units

    @property
    def variable_units(self) -> dict[str, str]:
        """Units of what stands in equations: the same, with that of the state where an output has its name."""
        pairs = [*self._core.states, *self._core.inputs]
        pairs += [(name, unit) for name, unit, *_ in self._core.parameters]
        pairs += [(name, unit) for name, _, unit, _ in self._core.constants]
        pairs += [("time", str(self._time_unit))] if self._time_unit != SECONDS else []
        named = {name: unit for name, unit in pairs if unit}
        found = self._output_units | dict(self._core.states) | named
        return {name: unit for name, unit in found.items() if unit}

    @property
    def _output_units(self) -> dict[str, str]:
        return {name: unit for name, _, unit, _ in self._core.outputs if unit}

    @property
    def equations(self) -> dict[str, Expr]:
        """Right-hand sides by name: quantities, state equations (with a prime: ``q'``) and outputs (``y:q``)."""
        return {name: e for name, (_, e) in named_equations(self._core).items()}

    @property
    def end_conditions(self) -> tuple[tuple[str, str, Expr], ...]:
        """Conditions on the ends of records: the end ("initial", "final" or "periodic"), the state, the expression."""
        return tuple((end, state, e) for end, state, e, _ in self._core.conditions)

    @property
    def unused_quantities(self) -> tuple[str, ...]:
        """Names of the quantities whose symbols stand in no other expression of the model."""
        expressions = [*self.equations.values(), *self._noise.expressions.values()]
        used = {s for e in (*expressions, *(e for *_, e in self.end_conditions)) for s in e.symbols}
        return tuple(name for name in self.quantity_names if name not in used)

    def quantity_expressions(self) -> dict[str, Expr]:
        """Return the quantities by name, with the preceding ones substituted into each."""
        known: dict[str, Any] = {}
        for name, e, *_ in self._core.quantities:
            known[name] = Expr(e.substitute(known))
        return known

    def state_expressions(self) -> dict[str, Expr]:
        """Return the right-hand sides of the state equations, in the order of `dynamics`, with all quantities
        substituted."""
        known: dict[str, Any] = {**self.quantity_expressions()}
        return {name: Expr(e.substitute(known)) for name, e, *_ in self._core.dynamics}

    def output_expressions(self) -> dict[str, Expr]:
        """Return the outputs by name, with all quantities substituted."""
        known: dict[str, Any] = {**self.quantity_expressions()}
        return {name: e.substitute(known) for name, e, *_ in self._core.outputs}

    def check(self) -> None:
        """Raise ModelError where the model is incomplete: a state without equation, an unknown symbol, ..."""
        if not self.state_names:
            raise ModelError(
                f"model '{self.name}': it has no states; declare at least one. A model of outputs alone is for "
                "equation_error"
            )
        if self._delays:
            base = [(name, self.declared_parameters[name].start) for name in self._delays.parameters]
            self._core.at_delays(self._delays.spec, base).check()
        else:
            self._core.check()

    def latex(self) -> str:
        """Return the equations as a LaTeX ``aligned`` block."""
        return model_latex(self._core, self.condition_names)

    def _repr_latex_(self) -> str | None:
        text = self.latex()
        return f"$$\n{text}\n$$" if len(text) <= _LONGEST else None  # a notebook shows its text then

    def _repr_html_(self) -> str:
        controls = [n for n in self.input_names if not self.is_condition(n)]
        symbols = {"state": self.state_names, "input": controls, "condition": self.condition_names}
        return model_html(
            self._core, self._counts(), symbols, self.units, self.declared_parameters, self.declared_constants
        )

    def to_json(self) -> str:
        """Return the model as text that `from_json`, and the Rust crate, read back exactly."""
        text = self._equations_to_json()
        more: dict[str, Any] = {"noise": self._noise.to_dict(), "delays": self._delays.to_dict()}
        # Under its own key: "conditions" are those at the ends of records.
        more |= {"measured_conditions": list(self._condition_names), "time_unit": self.units.get("time")}
        more = {key: value for key, value in more.items() if value}
        return json.dumps({**json.loads(text), **more}) if more else text

    def _equations_to_json(self) -> str:
        """Return the model without noise and delays, as the Rust crate reads it."""
        return self._core.to_json()

    @classmethod
    def from_json(cls, text: str) -> Model:
        """Read the text of `to_json`. Raises ModelError for other text."""
        model = cls.__new__(cls)
        model._core = _core.Model.from_json(text)
        try:
            saved = json.loads(text)
            model._with_noise(noise_from_dict(saved.get("noise", {})))
            model._delays = Delays.from_dict(saved.get("delays", {}))
            model._condition_names = saved_conditions(saved.get("measured_conditions", []), model.input_names)
            model._time_unit = TimeUnit.checked(saved.get("time_unit", "s"), "saved model")
        except ModelError:
            raise
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            raise ModelError(f"saved model: noise or delays are damaged ({type(error).__name__}: {error})") from error
        return model

    def with_parameters(
        self, changes: Mapping[str, Parameter | float] | None = None, /, **parameters: Parameter | float
    ) -> Model:
        """Return a model with other parameters; this one stays as it is.

        A number moves the start, or the value of a fixed parameter; a `Parameter` takes the place of the declaration.
        Names may be given in a mapping too. Raises ModelError for a name that is not a parameter, and for a start
        outside of the bounds.

        >>> import phugoid as ph
        >>> m = ph.Model("lag")
        >>> x, = m.states(x="m")
        >>> T, = m.parameters(T=ph.Parameter(1.0, bounds=(0.1, 10), unit="s"))
        >>> m.dynamics(x=-x/T)
        >>> m.outputs(x=x)
        >>> m.with_parameters(T=2.0).declared_parameters["T"].bounds
        (0.1, 10.0)
        """
        changes = {**(changes or {}), **parameters}
        if constant := next((name for name in changes if name in self.constant_names), None):
            raise ModelError(
                f"with_parameters: '{constant}' is a constant, whose value is in the equations; to change it, declare "
                f"it as a parameter: {constant}=Parameter(..., fixed=True)"
            )
        return self._changed(parameters=changed_parameters(self.declared_parameters, changes))

    def with_terms(self, terms: Mapping[str, Any], parameters: Mapping[str, Parameter | float] | None = None) -> Model:
        """Return a model with terms added to its equations; this one stays as it is.

        terms       by what each is added to, named as in `equations`: a quantity (``"Cm"``), a state equation
                    (``"q'"``) or an output (``"y:q"``).
        parameters  new ones that the terms hold, declared as by `Model.parameters`.

        Raises ModelError for an unknown equation, an existing parameter, and a term that is not an expression.

        >>> import phugoid as ph
        >>> m = ph.Model("pendulum")
        >>> a, q = m.states(a="rad", q="rad/s")
        >>> m.dynamics(a=q, q=-9.81*ph.sin(a))
        >>> m.outputs(a=a)
        >>> damped = m.with_terms({"q'": -Expr.symbol("d")*q}, {"d": ph.Parameter(0.1, unit="1/s")})
        >>> "d" in damped.equations["q'"].symbols
        True
        """
        equations = terms_added(self._core, terms)
        new = added_parameters(self.declared_parameters, parameters or {})
        return self._changed(parameters=new, equations=equations)

    def with_noise(self, *args: Noise, **sigma: float | Sigma | Expr | Noise) -> Model:
        """Return a model with other noise, stated as by `noise`; this one stays as it is."""
        model = self._changed()
        model.noise(*args, **sigma)
        return model

    def copy(self) -> Model:
        """Return a model that is equal to this one, and that later declarations here do not change."""
        return self._around(self._core.copy(), self._delays)

    def _changed(
        self,
        *,
        parameters: Mapping[str, Parameter] = {},
        equations: Mapping[Key, Expr] = {},
        inputs: Mapping[str, str] = {},
        outputs: Mapping[str, Expr] = {},
        states: Mapping[str, tuple[str, Expr, Expr | None]] = {},
        delays: Delays | None = None,
        quantities: Mapping[str, Expr] = {},
    ) -> Model:
        """Return the model with parameters and equations replaced or added, and other delays.

        ``equations`` are keyed as in `equations_of`; new ``states`` are unit, right-hand side and initial value, None
        for any; ``inputs`` are units; ``quantities`` are new ones of states and inputs.
        """
        core = changed(self._core, parameters, equations, inputs, outputs, states, quantities)
        return self._around(core, self._delays if delays is None else delays)

    def _right_hand_sides(self) -> dict[Key, Expr]:
        """Return all right-hand sides by kind ("quantity", "equation", "output", or the end of a condition) and
        name."""
        return dict(equations_of(self._core))

    def _around(self, core: _core.Model, delays: Delays) -> Model:
        """Return a model with another core, and the noise, the conditions and the unit of time of this one."""
        model = type(self).__new__(type(self))
        model._core, model._delays = core, delays
        model._condition_names, model._time_unit = self._condition_names, self._time_unit
        return model._with_noise(self._noise)

    def _separated(self, local: Sequence[str], count: int) -> Model:
        """Return the model with parameters of single experiments as quantities; see `separated`."""
        return self._around(separated(self._core, local, count), self._delays)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write `to_json` to a file; raise DataError where that is impossible."""
        write(path, json.dumps(sealed(json.loads(self.to_json())), ensure_ascii=False), "the model")

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Model:
        """Read a file that `save` wrote; raise DataError where it cannot be read, ModelError where it holds no
        model."""
        text = read_text(path)
        model = cls.from_json(text)
        unsealed(json.loads(text), str(path))
        return model

    def __reduce__(self) -> Any:
        return Model.from_json, (self.to_json(),)

    def __repr__(self) -> str:
        return f"<Model '{self.name}': {self._counts()}>"

    def _counts(self) -> str:
        symbols = {"states": self.state_names, "inputs": [n for n in self.input_names if not self.is_condition(n)]}
        symbols |= {"conditions": self.condition_names} if self.condition_names else {}
        symbols |= {"outputs": self.output_names, "parameters": self.parameter_names}
        symbols |= {"constants": self.constant_names} if self.constant_names else {}
        counts = [f"{len(names)} {kind[:-1] if len(names) == 1 else kind}" for kind, names in symbols.items()]
        return ", ".join([*counts, *time_note(self._time_unit)])

    def __str__(self) -> str:
        return model_text(self._core, self.condition_names, self._time_unit)
