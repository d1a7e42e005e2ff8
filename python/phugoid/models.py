"""Ready models of linear systems: the modal form, for structural dynamics, and general state spaces.

What a record of inputs and outputs tells of a linear system is its transfer function; states may be transformed at will
(x -> T x), so of the n^2 + n (m + p) numbers in A, B and C (n states, m inputs, p outputs) n^2 are arbitrary. Each form
here fixes as many of them, or says that it does not. Start values come from numbers, say of `phugoid.subspace`:

    fit = ph.estimate(ph.models.modal(start=ph.subspace(run, order=8)), run)

A parameter that is fixed by a form can be told in the fit by ``fixed``; all others are estimated.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from numbers import Integral
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from ._core import Expr
from .canonical import chains, observer_form
from .errors import ModelError, OptionError, did_you_mean, listing
from .model import Model
from .parameters import Parameter
from .state_space import ModalParts, StateSpace, as_state_space, modal_parts

__all__ = ["modal", "state_space"]

_Array = NDArray[np.float64]
Scale = Literal["fixed", "free"]
Structure = Literal["observer", "companion", "full"]

# Without start values a mode has this damping ratio, so that it neither grows nor hides.
_DAMPING = 0.02


def modal(
    n_modes: int | None = None,
    inputs: str | Sequence[str] | None = None,
    outputs: str | Sequence[str] | None = None,
    *,
    n_real: int | None = None,
    start: StateSpace | Sequence[Any] | None = None,
    frequencies_hz: Sequence[float] | None = None,
    feedthrough: bool | Collection[str] | None = None,
    scale: Scale = "fixed",
    bias: bool = False,
    name: str = "modal form",
) -> Model:
    """A sum of ``n_modes`` oscillators (and ``n_real`` lags), in the real modal form of the paper's ground vibration
    test:

        x_1a' =  sigma_1 x_1a + omega_1 x_1b + b_1 u        y = c_1a x_1a + c_1b x_1b + ... + d u
        x_1b' = -omega_1 x_1a + sigma_1 x_1b                poles sigma_1 ± j omega_1

    Parameters are ``sigma_1`` (1/s), ``omega_1`` (rad/s), ``b_1``, ``c_1a``, ``c_1b``, and so on; with several outputs
    ``c_<output>_1a``; with several inputs, which may each act with a phase of its own, ``b_1a_<input>`` and
    ``b_1b_<input>``. A lag x_r1' = sigma_r1 x_r1 + b_r1 u adds c_r1 x_r1. States of the first sample are free.

    ``inputs``, ``outputs``  names of the channels, in one text or several; ``"u"`` and ``"y"``, or those of ``start``.
    ``start``        a numeric system with distinct eigenvalues, a `StateSpace` or (A, B, C[, D]): all parameters start
                     where their values give its transfer function, and n_modes and n_real are counted.
    ``frequencies_hz``  without ``start``: where the modes start, with a damping ratio of 0.02; else at 1, 2, ... Hz.
    ``feedthrough``  adds ``d`` (``d_<output>_<input>``) to all outputs, or to those named: an accelerometer on a
                     structure that a force acts on directly. None: where ``start`` has it.
    ``scale``        b and c of a mode come as products only: b may double where c halves, and with several inputs the
                     phase of a mode is free too. ``"fixed"`` holds b of one input at 1 (and 0 in the second equation),
                     so that c_1a and c_1b are the residue itself, by which the mode shows in the outputs: nothing is
                     redundant, and standard errors of all parameters exist. The input held is that which excites the
                     mode most at ``start``, else the first; a mode that this input does not excite has no such form.
                     ``"free"`` is the paper's: b is a parameter, the fit warns that b and c cannot be told apart and
                     has no standard errors of theirs, and has the same of all that does not depend on the scale.
    ``bias``         adds ``bias_<output>``, a constant of each experiment.

    Two modes that swap give the same model, so starts must differ: equal ones would stay equal.

    Raises ModelError for a ``start`` that does not fit, OptionError for other options.

    >>> m = modal(2, "force", "accelerometer", feedthrough=True)
    >>> print(m)
    modal form
      x_1a' = sigma_1*x_1a + omega_1*x_1b + b_1*force
      x_1b' = sigma_1*x_1b - omega_1*x_1a
      x_2a' = sigma_2*x_2a + omega_2*x_2b + b_2*force
      x_2b' = sigma_2*x_2b - omega_2*x_2a
      accelerometer (measured) = c_1a*x_1a + c_1b*x_1b + c_2a*x_2a + c_2b*x_2b + d*force
    """
    if scale not in get_args(Scale):
        raise OptionError(f'modal: scale is "fixed" or "free", not {scale!r}')
    system = None if start is None else as_state_space("modal", start)
    u, y = _channels("modal", inputs, outputs, system)
    counted = _Start(system, scale) if system is not None else None
    modes = _count("n_modes", n_modes, counted.pairs if counted else None)
    reals = _count("n_real", n_real, counted.reals if counted else None, unless=0)
    if not modes + reals:
        raise OptionError("modal: n_modes says how many modes there are: at least 1, or n_real")
    if counted is None:
        counted = _Default(modes, reals, len(u), len(y), frequencies_hz)
    elif frequencies_hz is not None:
        raise OptionError("modal: give start or frequencies_hz, not both")

    labels = [f"{k + 1}" if k < modes else f"r{k - modes + 1}" for k in range(modes + reals)]
    for output in {*y}.intersection(labels):
        raise OptionError(f"modal: an output cannot be called '{output}': sigma_{output} is the damping of a mode")
    m = Model(name)
    for k, label in enumerate(labels):
        m.states(*([f"x_{label}a", f"x_{label}b"] if k < modes else [f"x_{label}"]))
    force = m.inputs(*u)
    parts: list[list[Expr | float]] = [[] for _ in y]
    for k, label in enumerate(labels):
        if k < modes:
            _oscillator(m, label, counted, k, force, y, scale, parts)
        else:
            _lag(m, label, counted, k, force, y, scale, parts)
    _direct(m, "modal", feedthrough, system, force, y, parts)
    _outputs(m, y, parts, bias)
    return m


class _Start:
    """Start values of the modal form from a numeric system: of each mode the pole, b (m,) and c (p,), complex.

    With xi = x_a + j x_b the two equations of a mode are xi' = (sigma - j omega) xi + b u, and its part of the output
    is Re((c_a - j c_b) xi).
    """

    def __init__(self, system: StateSpace, scale: Scale) -> None:
        parts: ModalParts = modal_parts(system.A, system.B, system.C)
        order = np.argsort(~parts.paired, kind="stable")  # oscillators first
        self.pairs, self.reals = int(parts.paired.sum()), int((~parts.paired).sum())
        # The pole with the negative imaginary part is the conjugate one.
        self.pole = parts.values[order]
        self.b = parts.inputs[order].conj()
        self.c = parts.outputs.T[order].conj()
        self.held = [int(np.argmax(np.abs(b))) for b in self.b]
        for k, b in enumerate(self.b):
            by = b[self.held[k]]
            if by == 0.0:  # no input moves it, so that it does not show
                self.b[k, self.held[k]] = by = 1.0
                self.c[k] = 0.0
            factor = 1.0 / by
            if scale == "free":  # b and c as large as each other
                size = np.sqrt(np.abs(self.c[k]).max() * np.abs(by))
                factor *= size or 1.0
            self.b[k] *= factor
            self.c[k] /= factor


class _Default(_Start):
    """Poles one after another; b and c are 1, as in the paper."""

    def __init__(self, modes: int, reals: int, m: int, p: int, frequencies_hz: Sequence[float] | None) -> None:
        if frequencies_hz is None:
            frequencies_hz = range(1, modes + 1)
        f = np.asarray(frequencies_hz, dtype=np.float64)
        if f.shape != (modes,) or not np.all(f > 0) or not np.isfinite(f).all():
            raise OptionError(
                f"modal: frequencies_hz holds a positive number for each of {modes} modes, not {frequencies_hz!r}"
            )
        omega = 2.0 * np.pi * f
        lags = -np.arange(1.0, reals + 1.0)
        self.pairs, self.reals = modes, reals
        self.pole = np.concatenate([(-_DAMPING + 1j * np.sqrt(1 - _DAMPING**2)) * omega, lags])
        self.b = np.ones((modes + reals, m), dtype=np.complex128)
        self.c = (
            np.ones((modes + reals, p), dtype=np.complex128)
            * np.where(np.arange(modes + reals) < modes, 1 - 1j, 1)[:, None]
        )
        self.held = [0] * (modes + reals)


def _oscillator(
    m: Model,
    label: str,
    start: _Start,
    k: int,
    force: Sequence[Expr],
    outputs: Sequence[str],
    scale: Scale,
    parts: list[list[Expr | float]],
) -> None:
    xa, xb = Expr.symbol(f"x_{label}a"), Expr.symbol(f"x_{label}b")
    sigma, omega = m.parameters(
        **{
            f"sigma_{label}": Parameter(start.pole[k].real, unit="1/s"),
            f"omega_{label}": Parameter(start.pole[k].imag, unit="rad/s"),
        }
    )
    a, b = sigma * xa + omega * xb, sigma * xb - omega * xa
    for i, u in enumerate(force):
        held = scale == "fixed" and i == start.held[k]
        value = start.b[k, i]
        if len(force) == 1:
            a += m.parameters(**{f"b_{label}": Parameter(value.real, fixed=held)})[0] * u
            continue
        a += m.parameters(**{f"b_{label}a_{u}": Parameter(value.real, fixed=held)})[0] * u
        if not held:
            b += m.parameters(**{f"b_{label}b_{u}": Parameter(value.imag)})[0] * u
    m.dynamics(**{f"x_{label}a": a, f"x_{label}b": b})
    for j, output in enumerate(outputs):
        prefix = f"c_{output}_" if len(outputs) > 1 else "c_"
        ca, cb = m.parameters(
            **{f"{prefix}{label}a": float(start.c[k, j].real), f"{prefix}{label}b": float(-start.c[k, j].imag)}
        )
        parts[j] += [ca * xa, cb * xb]


def _lag(
    m: Model,
    label: str,
    start: _Start,
    k: int,
    force: Sequence[Expr],
    outputs: Sequence[str],
    scale: Scale,
    parts: list[list[Expr | float]],
) -> None:
    x = Expr.symbol(f"x_{label}")
    right = m.parameters(**{f"sigma_{label}": Parameter(start.pole[k].real, unit="1/s")})[0] * x
    for i, u in enumerate(force):
        held = scale == "fixed" and i == start.held[k]
        named = f"b_{label}_{u}" if len(force) > 1 else f"b_{label}"
        right += m.parameters(**{named: Parameter(start.b[k, i].real, fixed=held)})[0] * u
    m.dynamics(**{f"x_{label}": right})
    for j, output in enumerate(outputs):
        named = f"c_{output}_{label}" if len(outputs) > 1 else f"c_{label}"
        parts[j].append(m.parameters(**{named: float(start.c[k, j].real)})[0] * x)


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
    """A general linear system, x' = A x + B u, y = C x + D u, with ``n`` states x_1 ... x_n.

    Free elements are the parameters ``a_<row>_<column>``, ``b_<row>_<input>``, ``c_<output>_<column>`` and
    ``d_<output>_<input>``. ``structure`` says which elements are free:

    ``"observer"``   observer canonical form: C holds zeros and ones; the states are outputs and their derivatives, over
                     powers of ``rate``. Each output has a chain of n/p states (the first ones one more): the last row
                     of A of each chain is free, and B. n p + n m parameters, and nothing is redundant. Fits any system
                     but those that cannot be observed in just these chains.
    ``"companion"``  its dual: B holds zeros and ones, one column of A of each input's chain is free, and C. For one
                     input, with the numerator's coefficients in C.
    ``"full"``       A, B and C are all free: n^2 directions are redundant. The fit says so; modes and responses are
                     determined, standard errors of the elements are not. For starts that a canonical form cannot hold.

    ``rate`` (rad/s) makes the coefficients of a canonical form be of the same size: about the frequency of the modes.
    Where it is not given it is the geometric mean of those of ``start``, or 1.
    High orders suffer all the same, as polynomials do: above 8 or so take `modal`.
    Without ``start`` the free elements start at 0, but for A of "full", which is -1, -2, ... on the diagonal, and C
    there, 1. ``start``, ``feedthrough`` and ``bias`` are those of `modal`; eigenvalues of ``start`` may coincide.

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
    u, y = _channels("state_space", inputs, outputs, system)
    n = _count("n", n, None if system is None else system.order, caller="state_space")
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
        m.dynamics(**{f"x_{i + 1}": _sum(_products(row))})
    parts: list[list[Expr | float]] = [
        _products((element("C", i, j, f"c_{each}_{j + 1}"), x) for j, x in enumerate(states))
        for i, each in enumerate(y)
    ]
    _direct(m, "state_space", feedthrough, system, force, y, parts, always=True)
    _outputs(m, y, parts, bias)
    return m


def _products(pairs: Iterable[tuple[Expr | float, Expr]]) -> list[Expr | float]:
    """Factor times symbol, but for factors 0 and 1."""
    return [
        x if isinstance(a, float) and a == 1.0 else a * x for a, x in pairs if not (isinstance(a, float) and a == 0.0)
    ]


def _sum(terms: Sequence[Expr | float]) -> Expr | float:
    return sum(terms[1:], terms[0]) if terms else 0.0


def _elements(
    structure: Structure, n: int, m: int, p: int, system: StateSpace | None, rate: float
) -> tuple[dict[str, _Array], dict[str, _Array]]:
    """What is fixed of A, B and C, NaN where free, and where the free elements start."""
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


def _channels(
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


def _count(what: str, given: int | None, there: int | None, unless: int | None = None, caller: str = "modal") -> int:
    if given is None:
        if there is None and unless is None:
            raise OptionError(f"{caller}: give {what}, or start")
        return int(there if there is not None else unless or 0)
    if not isinstance(given, Integral) or isinstance(given, bool) or given < 0:
        raise OptionError(f"{caller}: {what} is a whole number, not {given!r}")
    if there is not None and given != there:
        raise ModelError(f"{caller}: {what} is {given}, but start has {there}: leave it out, or give another start")
    return int(given)


def _direct(
    m: Model,
    caller: str,
    feedthrough: bool | Collection[str] | None,
    system: StateSpace | None,
    force: Sequence[Expr],
    outputs: Sequence[str],
    parts: list[list[Expr | float]],
    always: bool = False,
) -> None:
    """Adds D u: ``d``, with names where there are several inputs or outputs, or ``always``."""
    if feedthrough is None:
        chosen = [] if system is None else [y for y, row in zip(outputs, system.D, strict=True) if np.any(row != 0.0)]
    elif isinstance(feedthrough, bool):
        chosen = list(outputs) if feedthrough else []
    else:
        chosen = [feedthrough] if isinstance(feedthrough, str) else list(feedthrough)
    for name in chosen:
        if name not in outputs:
            raise OptionError(f"{caller}: feedthrough: '{name}' is no output.{listing(str(name), outputs)}")
    for j, y in enumerate(outputs):
        for i, u in enumerate(force if y in chosen else ()):
            label = ["d"] + ([y] if always or len(outputs) > 1 else []) + ([str(u)] if always or len(force) > 1 else [])
            value = 0.0 if system is None else float(system.D[j, i])
            parts[j].append(m.parameters(**{"_".join(label): value})[0] * u)


def _outputs(m: Model, outputs: Sequence[str], parts: list[list[Expr | float]], bias: bool) -> None:
    for y, terms in zip(outputs, parts, strict=True):
        if bias:
            terms.append(m.parameters(**{f"bias_{y}": Parameter(per_experiment=True)})[0])
        m.outputs(**{y: _sum(terms)})
