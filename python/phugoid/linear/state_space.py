"""Linear systems, and the table of their modes with standard errors."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import MissingDependency, ModelError, counted, listing
from ..notebook import Rows, overview
from ..parameters import Estimate, plus_minus, text_table
from ..time_unit import SECONDS, TimeUnit
from .response import FrequencyResponse

__all__ = ["ModalParts", "Mode", "Modes", "StateSpace", "as_state_space", "modal_parts", "response_of", "table_of"]

# An eigenvalue this near the real axis, beside its size, is real: a pair would be twice as far apart as rounding makes
# it.
_REAL = 1e-12


@dataclass(frozen=True)
class Mode:
    """One real eigenvalue, or a complex pair by the eigenvalue with the positive imaginary part.

    eigenvalue     lambda, 1/s, or 1 over the unit of time that the model has; likewise below.
    frequency      |lambda| / 2 pi in Hz: the natural frequency, which is not the damped one, |Im lambda| / 2 pi.
    damping        damping ratio -Re(lambda) / |lambda|; 1 or -1 for a real eigenvalue, NaN for one at zero.
    time_constant  -1 / Re(lambda) in s: of the decay, or for a pair of its envelope; negative where it grows.

    Each is an `Estimate`: ``float(mode.frequency)``, ``mode.frequency.std_error`` (NaN where it is not known).
    """

    eigenvalue: complex
    frequency: Estimate
    damping: Estimate
    time_constant: Estimate

    @property
    def oscillates(self) -> bool:
        """Whether it is a complex pair."""
        return self.eigenvalue.imag != 0.0

    @property
    def stable(self) -> bool:
        """Whether it decays."""
        return self.eigenvalue.real < 0.0


@dataclass(frozen=True, repr=False)
class Modes(Sequence[Mode]):
    """Modes in the order of their natural frequencies; printed, a table.

    >>> print(table_of(np.array([-0.1 + 2j, -0.1 - 2j, -0.5])))
    frequency, Hz  damping ratio  time constant, s  eigenvalue, 1/s
    -------------  -------------  ----------------  ---------------
                                  2                            -0.5
    0.318708       0.0499376      10                      -0.1 ± 2j
    """

    modes: tuple[Mode, ...]
    time_unit: TimeUnit = SECONDS

    @property
    def eigenvalues(self) -> NDArray[np.complex128]:
        """One a mode, 1/s: of a pair the one with the positive imaginary part."""
        return np.array([m.eigenvalue for m in self.modes], dtype=np.complex128)

    @property
    def frequencies_hz(self) -> NDArray[np.float64]:
        """Natural frequencies, Hz."""
        return np.array([m.frequency.value for m in self.modes])

    @property
    def damping_ratios(self) -> NDArray[np.float64]:
        """Damping ratios."""
        return np.array([m.damping.value for m in self.modes])

    @overload
    def __getitem__(self, i: int) -> Mode: ...
    @overload
    def __getitem__(self, i: slice) -> tuple[Mode, ...]: ...
    def __getitem__(self, i: int | slice) -> Mode | tuple[Mode, ...]:
        return self.modes[i]

    def __len__(self) -> int:
        return len(self.modes)

    def __iter__(self) -> Iterator[Mode]:
        return iter(self.modes)

    def summary(self) -> str:
        """Return a table: natural frequency, damping ratio, time constant and eigenvalue of each mode."""
        return text_table(*self._rows())

    def _repr_html_(self) -> str:
        return overview("Modes", self._rows(), note=self._counts())

    def _rows(self) -> Rows:
        rows = [
            [
                _cell(m.frequency) if m.oscillates else "",
                _cell(m.damping) if m.oscillates else "",
                _cell(m.time_constant),
                f"{m.eigenvalue.real:.6g}" + (f" ± {m.eigenvalue.imag:.6g}j" if m.oscillates else ""),
            ]
            for m in self.modes
        ]
        heads = [f"frequency, {self.time_unit.frequency}", "damping ratio", self.time_unit.axis("time constant")]
        return [*heads, f"eigenvalue, 1/{self.time_unit}"], rows, "lllr"

    def __str__(self) -> str:
        return self.summary()

    def __repr__(self) -> str:
        return f"<Modes: {self._counts()}>"

    def _counts(self) -> str:
        pairs = sum(m.oscillates for m in self.modes)
        return f"{pairs} oscillating, {len(self.modes) - pairs} not"


def table_of(
    eigenvalues: NDArray[np.complex128], covariances: NDArray[np.float64] | None = None, time: TimeUnit = SECONDS
) -> Modes:
    """Return the table of all eigenvalues (n,) of a real matrix, in 1 over the unit of ``time``.

    ``covariances`` (n, 2, 2): of real and imaginary part of each; NaN where it is not known.
    """
    found = []
    for k, value in enumerate(np.asarray(eigenvalues, dtype=np.complex128)):
        eigenvalue = complex(value)
        if abs(eigenvalue.imag) <= _REAL * abs(eigenvalue):
            eigenvalue = complex(eigenvalue.real)
        if eigenvalue.imag >= 0.0:
            found.append(_mode(eigenvalue, np.full((2, 2), np.nan) if covariances is None else covariances[k], time))
    return Modes(tuple(sorted(found, key=lambda m: (abs(m.eigenvalue), m.eigenvalue.real))), time)


def _mode(eigenvalue: complex, covariance: NDArray[np.float64], time: TimeUnit) -> Mode:
    """Return a mode with standard errors by the delta method."""
    size, (re, im) = abs(eigenvalue), (eigenvalue.real, eigenvalue.imag)
    if im == 0.0:  # real for small changes of the parameters too
        covariance = covariance * np.array([[1.0, 0.0], [0.0, 0.0]]) if np.isfinite(covariance).all() else covariance

    def error(slope: tuple[float, float]) -> float:
        d = np.array(slope)
        return float(np.sqrt(d @ covariance @ d))

    nan = math.nan
    frequency = Estimate(
        "frequency",
        size / (2.0 * math.pi),
        error((re / size / (2.0 * math.pi), im / size / (2.0 * math.pi))) if size else nan,
        time.frequency,
    )
    ratio = 0.0 - re / size if size else nan  # 0, not -0, of a mode without damping
    damping = Estimate("damping ratio", ratio, error((-(im**2) / size**3, re * im / size**3)) if im else nan)
    constant = -1.0 / re if re else math.inf
    time_constant = Estimate("time constant", constant, error((1.0 / re**2, 0.0)) if re else nan, time)
    return Mode(eigenvalue, frequency, damping, time_constant)


def _cell(e: Estimate) -> str:
    return plus_minus(e.value, e.std_error or math.nan)  # a parameter at a bound has no error


_Array: TypeAlias = NDArray[np.float64]
_Complex: TypeAlias = NDArray[np.complex128]

# Beyond this condition of the (normalised) eigenvectors, the modes carry no digits worth having.
_DISTINCT = 1e10
_WIDE = 12  # columns of matrices that a notebook shows


@dataclass(frozen=True, eq=False, repr=False)
class StateSpace:
    """A linear system in continuous time, x' = A x + B u, y = C x + D u (+ offset), with n states, m inputs, p outputs.

    A, B, C, D        (n, n) in 1/s, (n, m), (p, n), (p, m). D may be left out: 0.
    inputs, outputs   names of the channels; u, or u1, u2, ..., and y, or y1, y2, ..., unless given.
    x0                experiment -> (n,): states at its first sample.
    offsets           experiment -> (p,): what is added to each output there.
    rate              of the samples it was identified from, Hz.
    singular_values   of the subspace method, the greatest first: the order is where they fall to the noise level.
    suggested_order   the order that these values suggest.
    residual_rms      output -> root mean square of measured minus simulated, over all experiments.
    log_likelihood    of the outputs, each with white noise of the size of its residuals, without the constant
                      -N n_y/2 ln 2 pi: of `fit_linear`.
    warnings          in words.
    states            names of the states; x, or x1, x2, ..., unless given.
    time_unit         unit of time, s unless given.

    Raises ModelError for shapes that do not fit each other, and numbers that are not finite.

    >>> lag = StateSpace([[-2.0]], [[2.0]], [[1.0]])
    >>> lag.frequency_response([0.0]).response
    array([1.+0.j])
    """

    A: _Array
    B: _Array
    C: _Array
    D: _Array = field(default_factory=lambda: np.empty((0, 0)))
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    x0: Mapping[str, _Array] = field(default_factory=dict)
    offsets: Mapping[str, _Array] = field(default_factory=dict)
    rate: float | None = None
    singular_values: _Array | None = None
    suggested_order: int | None = None
    residual_rms: Mapping[str, float] = field(default_factory=dict)
    log_likelihood: float | None = None
    warnings: tuple[str, ...] = ()
    states: tuple[str, ...] = ()
    time_unit: str = SECONDS

    def __post_init__(self) -> None:
        a, b, c = (_matrix(name, getattr(self, name)) for name in "ABC")
        n, m, p = a.shape[0], b.shape[1], c.shape[0]
        d = np.zeros((p, m)) if np.size(self.D) == 0 else _matrix("D", self.D)
        for name, value, shape in (("A", a, (n, n)), ("B", b, (n, m)), ("C", c, (p, n)), ("D", d, (p, m))):
            if value.shape != shape:
                raise ModelError(
                    f"state space: {name} has shape {value.shape}; with {n} states, {m} inputs and {p} outputs (from "
                    f"A, B and C) it must be {shape}"
                )
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        for kind, count, letter in (("states", n, "x"), ("inputs", m, "u"), ("outputs", p, "y")):
            names = tuple(getattr(self, kind)) or tuple(
                [letter] if count == 1 else [f"{letter}{k + 1}" for k in range(count)]
            )
            if len(names) != count:
                raise ModelError(f"state space: {len(names)} {kind} are named, but the matrices have {count}")
            object.__setattr__(self, kind, names)

    def _repr_html_(self) -> str:
        rows = np.vstack([np.hstack([self.A, self.B]), np.hstack([self.C, self.D])])
        left = [f"{name}'" for name in self.states] + list(self.outputs)
        cells = [[name, *(f"{x:.4g}" for x in row)] for name, row in zip(left, rows, strict=True)]
        matrices = ["", *self.states, *self.inputs], cells, "l" + "r" * rows.shape[1]
        note = ", ".join(
            [counted(self.order, "state"), counted(len(self.inputs), "input"), counted(len(self.outputs), "output")]
        )
        shown = (matrices, self.modes._rows()) if rows.shape[1] <= _WIDE else (self.modes._rows(),)
        return overview("State space", *shown, remarks=self.warnings, note=note)

    @property
    def order(self) -> int:
        """Number of states, n."""
        return int(self.A.shape[0])

    @property
    def modes(self) -> Modes:
        """Natural frequencies, damping ratios and time constants."""
        return table_of(np.linalg.eigvals(self.A).astype(np.complex128), time=TimeUnit(self.time_unit))

    def frequency_response(
        self, frequencies_hz: ArrayLike, input: str | None = None, output: str | None = None
    ) -> FrequencyResponse:
        """Return C (j 2 pi f - A)^-1 B + D at F frequencies in Hz; ``input`` and ``output`` may be left out where there
        is only one.

        Raises ModelError for unknown names, DataError for frequencies out of order.
        """
        u = only("frequency_response", "input", input, self.inputs)
        y = only("frequency_response", "output", output, self.outputs)
        i, k = self.outputs.index(y), self.inputs.index(u)
        frequencies = np.atleast_1d(np.asarray(frequencies_hz, dtype=np.float64))
        response = response_of(
            self.A, self.B[:, k : k + 1], self.C[i : i + 1], self.D[i : i + 1, k : k + 1], frequencies
        )
        return FrequencyResponse(frequencies, response[:, 0, 0], u, y, time_unit=self.time_unit)

    def to_control(self, name: str | None = None) -> Any:
        """Return the system as a `control.StateSpace` of python-control, with the names of states, inputs and outputs.

        A dot in a name becomes an underscore, since python-control takes none. Offsets and initial states are left
        behind. Raises MissingDependency without python-control.
        """
        try:
            import control
        except ImportError as error:
            raise MissingDependency(
                f'to_control needs python-control ({error}): pip install "phugoid[control]"'
            ) from error
        kinds = {"states": self.states, "inputs": self.inputs, "outputs": self.outputs}
        names = {kind: [one.replace(".", "_") for one in group] for kind, group in kinds.items()}
        more = {} if name is None else {"name": name}
        return control.StateSpace(self.A, self.B, self.C, self.D, **names, **more)

    def __repr__(self) -> str:
        inputs, outputs = " ".join(self.inputs), " ".join(self.outputs)
        return f"<StateSpace: {counted(self.order, 'state')}, inputs: {inputs}, outputs: {outputs}>"

    def __str__(self) -> str:
        return f"{self!r}\n\n{self.modes}" + "".join(f"\n\nWarning: {w}" for w in self.warnings)


@dataclass(frozen=True)
class ModalParts:
    """A system as the sum of its modes: y = sum over eigenvalues of c_i b_i u / (s - lambda_i), plus D u.

    values (r,), complex: the real eigenvalues and of each pair the one with the positive imaginary part, 1/s.
    inputs (r, m), outputs (p, r): b_i, and c_i, which is doubled for a pair, so that it adds the real part.
    states (r, n): the modal coordinates are ``states @ x``.
    """

    values: _Complex
    inputs: _Complex
    outputs: _Complex
    states: _Complex

    @property
    def paired(self) -> NDArray[np.bool_]:
        """Which eigenvalues stand for pairs."""
        return np.asarray(self.values.imag > 0.0)


def modal_parts(A: _Array, B: _Array, C: _Array) -> ModalParts:
    """Return the modes of a system with distinct eigenvalues, in the order of natural frequencies; ModelError for
    others."""
    values, right = np.linalg.eig(A)
    condition = np.linalg.cond(right) if values.size else 1.0
    if not condition < _DISTINCT:
        k, other = _nearest(values)
        raise ModelError(
            f"modal form: the eigenvalues {values[k]:.6g} and {values[other]:.6g} cannot be distinguished; "
            "the modal form is for distinct ones: take models.state_space"
        )
    left = np.linalg.inv(right)
    chosen = [int(k) for k in np.lexsort((values.real, np.abs(values))) if values[k].imag >= 0.0]
    double = np.where(values[chosen].imag > 0.0, 2.0, 1.0)
    return ModalParts(
        values=np.asarray(values[chosen], dtype=np.complex128),
        inputs=np.asarray(left[chosen] @ B, dtype=np.complex128),
        outputs=np.asarray(C @ right[:, chosen] * double, dtype=np.complex128),
        states=np.asarray(left[chosen], dtype=np.complex128),
    )


def _nearest(values: _Complex) -> tuple[int, int]:
    apart = np.abs(values[:, None] - values[None, :]) + np.diag(np.full(values.size, np.inf))
    k, other = np.unravel_index(int(np.argmin(apart)), apart.shape)
    return int(k), int(other)


def response_of(A: _Array, B: Any, C: Any, D: Any, frequencies_hz: _Array) -> _Complex:
    """Return C (j 2 pi f - A)^-1 B + D, (F, p, m), at frequencies in Hz. B, C and D may be complex, and differ with
    frequency.

    ModelError at a frequency where the system has an undamped mode.
    """
    s = 2j * np.pi * frequencies_hz
    pencil = s[:, None, None] * np.eye(A.shape[0]) - A
    try:
        inner = np.linalg.solve(pencil, np.broadcast_to(B, (s.size, *np.shape(B)[-2:])))
    except np.linalg.LinAlgError:
        raise ModelError(
            "frequency_response: the model has an undamped mode, or an integrator, at one of the frequencies, where "
            "its response is infinite: leave that frequency out"
        ) from None
    return np.asarray(C @ inner + D, dtype=np.complex128)


def only(caller: str, kind: str, name: str | None, names: Sequence[str]) -> str:
    """Return the channel asked for, or the only one."""
    if name is None:
        if len(names) != 1:
            raise ModelError(
                f"{caller}: there are several {kind}s: say which, {kind}=... There are: {', '.join(names)}."
            )
        return names[0]
    if name not in names:
        raise ModelError(f"{caller}: '{name}' is not an {kind}.{listing(str(name), names)}")
    return name


def as_state_space(caller: str, system: Any) -> StateSpace:
    """Return a `StateSpace`, also of the matrices (A, B, C) or (A, B, C, D)."""
    if isinstance(system, StateSpace):
        return system
    if isinstance(system, (tuple, list)) and len(system) in (3, 4):
        return StateSpace(*system)
    raise ModelError(f"{caller}: start is a StateSpace, or the matrices (A, B, C) or (A, B, C, D), not {system!r:.60}")


def _matrix(name: str, value: Any) -> _Array:
    try:
        matrix = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ModelError(f"state space: {name} is not a matrix of real numbers") from None
    if matrix.ndim != 2:
        raise ModelError(f"state space: {name} has shape {matrix.shape}; give a matrix")
    if not np.isfinite(matrix).all():
        raise ModelError(f"state space: {name} holds numbers that are not finite")
    return matrix
