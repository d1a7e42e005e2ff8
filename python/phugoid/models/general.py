"""Models of any linear system, what ready models have in common, and those of the packaged examples."""

from __future__ import annotations

import linecache
from collections.abc import Collection, Iterable, Sequence
from importlib.resources import files
from numbers import Integral
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from .._core import Expr
from ..errors import ModelError, OptionError, did_you_mean, listing
from ..linear.state_space import StateSpace, as_state_space
from ..modelling.model import Model
from ..parameters import Parameter

__all__ = [
    "READY",
    "add_feedthrough",
    "add_outputs",
    "car",
    "channels_of",
    "counted",
    "hfb320",
    "model_text",
    "quadrotor",
    "servo",
    "state_space",
    "summed",
    "tank",
    "uav",
    "unstable",
]


def channels_of(
    caller: str, inputs: str | Sequence[str] | None, outputs: str | Sequence[str] | None, system: StateSpace | None
) -> tuple[list[str], list[str]]:
    found = []
    for kind, given, there, letter in (
        ("inputs", inputs, None if system is None else system.inputs, "u"),
        ("outputs", outputs, None if system is None else system.outputs, "y"),
    ):
        names = given if given is not None else there or letter
        listed = names.replace(",", " ").split() if isinstance(names, str) else list(names)
        if not listed or not all(isinstance(name, str) for name in listed):
            raise OptionError(f"{caller}: {kind} holds names of channels, not {given!r}")
        if there is not None and len(listed) != len(there):
            raise ModelError(
                f"{caller}: {len(listed)} {kind} are named, but start has {len(there)}: {', '.join(there)}"
            )
        found.append(listed)
    return found[0], found[1]


def counted(what: str, given: int | None, there: int | None, unless: int | None = None, caller: str = "modal") -> int:
    if given is None:
        if there is None and unless is None:
            raise OptionError(f"{caller}: give {what}, or start")
        return int(there if there is not None else unless or 0)
    if not isinstance(given, Integral) or isinstance(given, bool) or given < 0:
        raise OptionError(f"{caller}: {what} is a whole number, not {given!r}")
    if there is not None and given != there:
        raise ModelError(f"{caller}: {what} is {given}, but start has {there}: leave it out, or give another start")
    return int(given)


def add_feedthrough(
    m: Model,
    caller: str,
    feedthrough: bool | Collection[str] | None,
    system: StateSpace | None,
    force: Sequence[Expr],
    outputs: Sequence[str],
    parts: list[list[Expr | float]],
    always: bool = False,
) -> None:
    """Add D u: ``d``, with names where there are several inputs or outputs, or ``always``."""
    if feedthrough is None:
        chosen = [] if system is None else [y for y, row in zip(outputs, system.D, strict=True) if np.any(row != 0.0)]
    elif isinstance(feedthrough, bool):
        chosen = list(outputs) if feedthrough else []
    else:
        chosen = [feedthrough] if isinstance(feedthrough, str) else list(feedthrough)
    for name in chosen:
        if name not in outputs:
            raise OptionError(f"{caller}: feedthrough: '{name}' is not an output.{listing(str(name), outputs)}")
    for j, y in enumerate(outputs):
        for i, u in enumerate(force if y in chosen else ()):
            label = ["d"] + ([y] if always or len(outputs) > 1 else []) + ([str(u)] if always or len(force) > 1 else [])
            value = 0.0 if system is None else float(system.D[j, i])
            parts[j].append(m.parameters(**{"_".join(label): value})[0] * u)


def add_outputs(m: Model, outputs: Sequence[str], parts: list[list[Expr | float]], bias: bool) -> None:
    for y, terms in zip(outputs, parts, strict=True):
        if bias:
            terms.append(m.parameters(**{f"bias_{y}": Parameter(per_experiment=True)})[0])
        m.outputs(**{y: summed(terms)})


def summed(terms: Sequence[Expr | float]) -> Expr | float:
    return sum(terms[1:], terms[0]) if terms else 0.0


_Array: TypeAlias = NDArray[np.float64]

# Beyond this condition of the transformation the form is taken not to hold the system.
_SINGULAR = 1e12


def lengths(n: int, p: int) -> list[int]:
    """Return the lengths of the chains: n states for p outputs, as equal as possible. Almost any system has
    this form."""
    return [n // p + (j < n % p) for j in range(p)]


def chains(n: int, p: int, rate: float) -> tuple[_Array, _Array]:
    """Return A (n, n) and C (p, n) of the form, NaN where an element is free.

    Within the chain of output j (s_j states, x_0 = y_j) x_k' = rate x_k+1, and the last row of each is free. An output
    without a chain has a free row of C. (J. M. Maciejowski, Multivariable Feedback Design, 1989, sec. 8.3.)
    """
    A, C = np.zeros((n, n)), np.zeros((p, n))
    first = 0
    for j, length in enumerate(lengths(n, p)):
        if length:
            C[j, first] = 1.0
            A[range(first, first + length - 1), range(first + 1, first + length)] = rate
            A[first + length - 1] = np.nan
        else:
            C[j] = np.nan
        first += length
    return A, C


def observer_form(
    A: _Array, B: _Array, C: _Array, rate: float, names: Sequence[str], kind: str
) -> tuple[_Array, _Array, _Array]:
    """Return a system in the coordinates c_j A^k x / rate^k of the chains; ModelError where these do not span the
    states."""
    rows = []
    for j, length in enumerate(lengths(A.shape[0], C.shape[0])):
        row = C[j]
        for _ in range(length):
            rows.append(row)
            row = row @ A / rate
    T = np.array(rows)
    # The sizes of the coordinates are no matter.
    size = np.linalg.norm(T, axis=1, keepdims=True)
    if not size.all() or not np.linalg.cond(T / size) < _SINGULAR:
        seen, share = ("seen in", "an output") if kind == "output" else ("moved by", "an input")
        raise ModelError(
            f"state_space: start has states that are not {seen} {', '.join(names)} as its canonical form needs, with "
            f"as many states for each {kind} (or {share} stands for another): take structure='full', or modal"
        )
    back = np.linalg.inv(T)
    return T @ A @ back, T @ B, C @ back


Structure: TypeAlias = Literal["observer", "companion", "full"]


def state_space(
    n: int | None = None,
    inputs: str | Sequence[str] | None = None,
    outputs: str | Sequence[str] | None = None,
    *,
    structure: Structure = "observer",
    start: StateSpace | Sequence[Any] | None = None,
    rate: float | None = None,
    feedthrough: bool | Collection[str] | None = None,
    bias: bool = False,
    name: str = "state space",
) -> Model:
    """Return a general linear system, x' = A x + B u, y = C x + D u, with ``n`` states x_1 ... x_n.

    Free elements are the parameters ``a_<row>_<column>``, ``b_<row>_<input>``, ``c_<output>_<column>`` and
    ``d_<output>_<input>``. ``structure`` says which elements are free:

    ``"observer"``   observer canonical form: C holds zeros and ones; the states are outputs and their derivatives, over
                     powers of ``rate``. Each output has a chain of n/p states (the first ones one more): the last row
                     of A of each chain is free, and B. n p + n m parameters, and nothing is redundant. Fits any system
                     but those that cannot be observed in just these chains.
    ``"companion"``  its dual: B holds zeros and ones, one column of A of each input's chain is free, and C. For one
                     input, with the numerator's coefficients in C.
    ``"full"``       A, B and C are all free: n^2 directions are redundant, which the fit reports; modes and responses
                     are determined, standard errors of the elements are not. For starts that have no canonical form.

    ``rate`` (rad/s) scales the coefficients of a canonical form to similar sizes: about the frequency of the modes.
    Where it is not given it is the geometric mean of those of ``start``, or 1. High orders are ill-conditioned all the
    same, as polynomials are: above 8 or so use `modal`. Without ``start`` the free elements start at 0, but for A of
    "full", which is -1, -2, ... on the diagonal, and C there, 1. ``start``, ``feedthrough`` and ``bias`` are those of
    `modal`; eigenvalues of ``start`` may coincide.

    >>> print(state_space(2, "force", "y", rate=10))
    state space
      x_1' = 10*x_2 + b_1_force*force
      x_2' = a_2_1*x_1 + a_2_2*x_2 + b_2_force*force
      y (measured) = x_1
    """
    if structure not in get_args(Structure):
        hint = did_you_mean(str(structure), get_args(Structure))
        raise OptionError(
            f"state_space: structure is one of {', '.join(get_args(Structure))}, not {structure!r}.{hint}"
        )
    system = None if start is None else as_state_space("state_space", start)
    u, y = channels_of("state_space", inputs, outputs, system)
    n = counted("n", n, None if system is None else system.order, caller="state_space")
    if not n:
        raise OptionError("state_space: n says how many states there are: at least 1")
    if rate is None:
        rate = 1.0 if system is None else _typical(system)
    if not 0.0 < rate < np.inf:
        raise OptionError(f"state_space: rate is a positive number in rad/s, not {rate!r}")
    fixed, values = _elements(structure, n, len(u), len(y), system, float(rate))

    m = Model(name)
    states = m.states(*(f"x_{i + 1}" for i in range(n)))
    force = m.inputs(*u)

    def element(kind: str, i: int, j: int, label: str) -> Expr | float:
        known = fixed[kind][i, j]
        return float(known) if np.isfinite(known) else m.parameters(**{label: float(values[kind][i, j])})[0]

    for i in range(n):
        row = [(element("A", i, j, f"a_{i + 1}_{j + 1}"), x) for j, x in enumerate(states)]
        row += [(element("B", i, j, f"b_{i + 1}_{each}"), f) for j, (each, f) in enumerate(zip(u, force, strict=True))]
        m.dynamics(**{f"x_{i + 1}": summed(_products(row))})
    parts: list[list[Expr | float]] = [
        _products((element("C", i, j, f"c_{each}_{j + 1}"), x) for j, x in enumerate(states))
        for i, each in enumerate(y)
    ]
    add_feedthrough(m, "state_space", feedthrough, system, force, y, parts, always=True)
    add_outputs(m, y, parts, bias)
    return m


def _products(pairs: Iterable[tuple[Expr | float, Expr]]) -> list[Expr | float]:
    """Return factor times symbol for each pair, simplified for the factors 0 and 1."""
    return [
        x if isinstance(a, float) and a == 1.0 else a * x for a, x in pairs if not (isinstance(a, float) and a == 0.0)
    ]


def _elements(
    structure: Structure, n: int, m: int, p: int, system: StateSpace | None, rate: float
) -> tuple[dict[str, _Array], dict[str, _Array]]:
    """Return the fixed elements of A, B and C, NaN where free, and the start values of the free elements."""
    if structure == "full":
        fixed = {"A": np.full((n, n), np.nan), "B": np.full((n, m), np.nan), "C": np.full((p, n), np.nan)}
        if system is not None:
            return fixed, {"A": system.A, "B": system.B, "C": system.C}
        return fixed, {"A": -np.diag(np.arange(1.0, n + 1)), "B": np.zeros((n, m)), "C": np.ones((p, n))}
    dual = structure == "companion"
    A, C = chains(n, m if dual else p, rate)
    if dual:
        fixed = {"A": A.T, "B": C.T, "C": np.full((p, n), np.nan)}
    else:
        fixed = {"A": A, "B": np.full((n, m), np.nan), "C": C}
    if system is None:
        return fixed, {"A": np.zeros((n, n)), "B": np.zeros((n, m)), "C": np.zeros((p, n))}
    if dual:
        a, b, c = observer_form(system.A.T, system.C.T, system.B.T, rate, system.inputs, "input")
        return fixed, {"A": a.T, "B": c.T, "C": b.T}
    a, b, c = observer_form(system.A, system.B, system.C, rate, system.outputs, "output")
    return fixed, {"A": a, "B": b, "C": c}


def _typical(system: StateSpace) -> float:
    sizes = np.abs(np.linalg.eigvals(system.A))
    sizes = sizes[sizes > 1e-6 * sizes.max(initial=0.0)]
    return float(np.exp(np.log(sizes).mean())) if sizes.size else 1.0


READY = ("hfb320", "unstable", "quadrotor", "car", "uav", "servo", "tank")
"""Names of the packaged models."""


def model_text(name: str) -> str:
    """Return the Python code of a packaged model, which defines ``m``; raise OptionError for an unknown name."""
    if name not in READY:
        raise OptionError(f"there is no example '{name}'.{listing(name, READY)}")
    return files("phugoid").joinpath("cli", "examples", f"{name}.txt").read_text(encoding="utf-8")


def _made(name: str) -> Model:
    text = model_text(name)
    place = f"<phugoid example {name}>"
    # The line of an equation is found in messages though there is no such file.
    linecache.cache[place] = (len(text), None, text.splitlines(keepends=True), place)
    names: dict[str, Any] = {"__name__": f"phugoid_example_{name}"}
    exec(compile(text, place, "exec"), names)
    model: Model = names["m"]
    return model


def hfb320() -> Model:
    """Return the longitudinal motion of the HFB-320: states V, alpha, theta, q; inputs de (rad), T (N); 7 outputs.

    15 parameters: derivatives of lift, drag and pitching moment, and biases of sensors. (D. A. A. Dutra, AIAA Aviation
    2019.) Each call gives a new model; ``phugoid example hfb320`` writes its code.

    >>> hfb320().state_names
    ('V', 'alpha', 'theta', 'q')
    """
    return _made("hfb320")


def unstable() -> Model:
    """Return the short period of an aircraft that is unstable: states w, q; input de (rad); outputs w, q, az.

    6 parameters: the derivatives. (R. V. Jategaonkar, Flight Vehicle System Identification, ch. 9.)
    """
    return _made("unstable")


def quadrotor() -> Model:
    """Return the pitch axis of a quadrotor near hover: states u, theta, q, n (rotors); input command; outputs u, theta,
    q, ax.

    8 parameters, among them the time constant of the rotors, the delay of the command, and the drag of the rotors,
    which the accelerometer measures.
    """
    return _made("quadrotor")


def car() -> Model:
    """Return the single-track model of a car with tyres that saturate: states v, r; input delta (rad), condition V
    (m/s); outputs r, ay, beta.

    4 parameters: stiffness and greatest force of the tyres of each axle, by the magic formula (H. B. Pacejka, Tire and
    Vehicle Dynamics). The slip angles af, ar and the forces Ff, Fr are quantities.
    """
    return _made("car")


def uav() -> Model:
    """Return the longitudinal motion of a small fixed-wing aircraft: states V, alpha, theta, q; inputs de (rad), T (N);
    outputs V, alpha, theta, q, ax, az.

    10 parameters: the derivatives of lift, drag and pitching moment, and the bias of the gyro. Mass, inertia and areas
    are those of the example: write it with ``phugoid example uav`` and change them.
    """
    return _made("uav")


def servo() -> Model:
    """Return a servo with dry friction: states angle, rate; input volts; output angle.

    3 parameters: gain, time constant, dry friction over inertia.
    """
    return _made("servo")


def tank() -> Model:
    """Return two tanks, one above the other: states upper, lower (cm); input pump (V); output lower.

    3 parameters, of the pump and of the outflows, by Torricelli's law. (M. Schoukens and J. P. Noël, Three Benchmarks
    Addressing Open Challenges in Nonlinear System Identification, IFAC 2017.)
    """
    return _made("tank")
