"""How exactly a fit's state path solves its differential equations: the integration error of each segment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from . import _core
from ._core import Expr
from .data.interpolation import interpolated, kind_of
from .errors import EvaluationError, OptionError
from .figures.style import LIMIT, SERIES, plain
from .fit_result import FitResult
from .guess import measured_states
from .modelling.model import Model
from .records import Record
from .regression.equations import Equation, Evaluation
from .transcription.collocation import Collocation

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["IntegrationError", "coarse_mesh_warning", "integration_error"]

_Array: TypeAlias = NDArray[np.float64]

# Nodes of the finer rule beyond those of the segment; two more for every sample inside it, up to a limit.
_MORE, _MOST = 5, 24
# No scale is smaller than this part of how far the state moves; a state that is not measured counts as measured to so
# much of that.
_FLOOR, _UNMEASURED = 1e-6, 1e-2
# Errors of a segment below this, in units of the noise, are small beside it.
_COARSE = 0.1
# Most numbers of Jacobians that are held at a time.
_CHUNK = 4_000_000
# Most sweeps of Picard's iteration, and the change after which they end.
_SWEEPS, _SETTLED = 12, 1e-4


@dataclass(frozen=True, eq=False, repr=False)
class IntegrationError:
    """The error that each of S segments of one experiment adds to the path.

    name    the experiment's.
    edges   (S + 1,) ends of the segments, s.
    errors  state -> (S,): how far, at most, the collocation polynomial departs within the segment from the exact
            solution through its first point, in the state's unit.
    scales  state -> what is small for it: the standard deviation of the noise of its measurement; one hundredth of
            the standard deviation of its path where it is not measured; at least 1e-6 of that.
    """

    name: str
    edges: _Array
    errors: Mapping[str, _Array]
    scales: Mapping[str, float]

    @property
    def relative(self) -> dict[str, _Array]:
        """State -> (S,): errors over scales."""
        return {name: e / self.scales[name] for name, e in self.errors.items()}

    @property
    def worst(self) -> _Array:
        """(S,): the largest relative error of any state in each segment."""
        return np.asarray(np.max(list(self.relative.values()), axis=0))

    def plot(self, axes: Axes, tolerance: float | None = None) -> None:
        """Relative errors over time, on a logarithmic scale, into axes of your own."""
        for i, (name, e) in enumerate(self.relative.items()):
            colour = SERIES[i % len(SERIES)][0]
            axes.stairs(
                np.maximum(e, 1e-300), self.edges, label=plain(name), color=colour, linewidth=0.9, baseline=None
            )
        axes.set_yscale("log")
        largest = float(self.worst.max())
        axes.set_ylim(max(1e-8 * largest, 1e-14), 3.0 * max(largest, tolerance or 0.0))
        if tolerance is not None:
            axes.axhline(tolerance, color=LIMIT, linestyle="--", linewidth=0.8, label="tolerance")
        axes.set_xlabel("time, s")
        axes.set_ylabel("error of a segment / noise")
        axes.legend(fontsize="small", frameon=False, ncols=3)

    def __repr__(self) -> str:
        size = f"{self.edges.size - 1} segments, at most {self.worst.max():.1e} of the noise in one"
        return f"<IntegrationError of '{self.name}': {size}>"


def integration_error(fit: FitResult) -> tuple[IntegrationError, ...]:
    """Return the error that each segment of the mesh adds to the path, one for each experiment of a fit.

    Raises OptionError for a fit that was not transcribed by collocation, or has delays and no fit without them within,
    and EvaluationError where the state equations are not finite between the points of the mesh.
    """
    if not isinstance(fit.transcription, Collocation):
        raise OptionError("integration_error: only collocation has a mesh whose error can be estimated")
    if fit.model.delays:  # the mesh is that of the model without delays, on records moved by them
        if fit._moved is None:
            raise OptionError("integration_error: estimate this fit with delays again first, with start=fit")
        return integration_error(fit._moved)
    order = fit.transcription.order
    # A mesh for smoothed kinks resolves these, and no jumps.
    model = fit._moved.model if fit.smoothing and fit._moved else fit.model
    return tuple(_of_record(model, *_numbers(fit, r.name), r, order) for r in fit.records)


def _numbers(fit: FitResult, experiment: str) -> tuple[dict[str, float], dict[str, float]]:
    """Return the values of the parameters in an experiment, and the noise's standard deviations by output."""
    named = {n: f"sigma_{n}" for n in fit.model.output_names}
    sigmas = {n: fit.parameters[s].value for n, s in named.items() if s in fit.parameters} | fit.noise.known
    return fit._own(experiment), sigmas


def _of_record(
    model: Model, values: Mapping[str, float], sigmas: Mapping[str, float], record: Record, order: int
) -> IntegrationError:
    """The errors of a path that collocation of an order left in ``record.mesh_t`` and ``mesh_states``.

    On a segment, collocation replaces f along the path by its polynomial through the segment's points (Eq. fhat_interp
    of the paper). What f is in truth between the points, at those of a finer Lobatto rule, leaves a defect d; the error
    follows from the linearised state equations e' = f_x e + d, e = 0 at the start of the segment, solved on the finer
    rule. ``values`` and ``sigmas`` are those of the parameters and of the noise by output.

    Raises EvaluationError where f is not finite between the points.
    """
    rough = np.array(_core.lgl(order)[0])
    edges = record.mesh_t[:: order - 1]
    bends = record.input_times
    inside = np.searchsorted(bends, edges[1:] - 1e-9) - np.searchsorted(bends, edges[:-1] + 1e-9)
    fine = np.array(_core.lgl(min(order + _MORE + 2 * max(int(inside.max()), 0), max(_MOST, order + _MORE)))[0])
    s, m, n = edges.size - 1, fine.size, len(model.state_names)
    h = np.diff(edges)

    flow = _Flow(model, values, record)
    mesh = np.array([record.mesh_states[name] for name in model.state_names])
    to, rise, there = _integrals(fine, fine), _integrals(rough, fine), _lagrange(rough, fine)
    points = (order - 1) * np.arange(s)[:, None] + np.arange(order)  # of each segment
    errors = np.empty((n, s))
    step = max(1, _CHUNK // (m * n * n))
    for first in range(0, s, step):
        part = slice(first, first + step)
        ends = edges[:-1][part, None], edges[1:][part, None]
        # Of each segment by itself: where an input jumps, f has another value in the next.
        f = flow.slopes(record.mesh_t[points[part]], mesh[:, points[part]], ends)  # (n, s, order)
        path = mesh[:, points[part, :1]] + h[part, None] * (f @ rise)  # (n, s, m)
        t = edges[:-1][part, None] + h[part, None] * fine
        true, jacobian = flow.slopes_and_jacobian(t, path, ends)
        e = _departure(jacobian, true - f @ there, h[part], to)
        errors[:, part] = np.abs(e).max(axis=2)
    return IntegrationError(
        name=record.name,
        edges=edges,
        errors=dict(zip(model.state_names, errors, strict=True)),
        scales=_scales(model, values, sigmas, mesh),
    )


def coarse_mesh_warning(fit: FitResult) -> str:
    """Return a sentence on the segment of a fit by collocation whose integration error is largest, where that is not
    small beside the noise, else "".

    The error itself is computed only where the path's last Legendre coefficients show that it may be as large: of a
    path that the mesh resolves they fall off fast, and to see that takes microseconds.
    """
    if not isinstance(fit.transcription, Collocation):
        return ""
    order = fit.transcription.order
    if not any(_unresolved(record, fit, order) for record in fit.records):
        return ""
    try:
        errors = integration_error(fit)
    except EvaluationError:  # equations that are not finite between the points of the mesh
        return ""
    found = max(errors, key=lambda e: float(e.worst.max()))
    k = int(np.argmax(found.worst))
    if not found.worst[k] > _COARSE:
        return ""
    where = f" of '{found.name}'" if len(errors) > 1 else ""
    return (
        f"the mesh is coarse: from {found.edges[k]:.4g} to {found.edges[k + 1]:.4g} s{where} integration is wrong by "
        f"{found.worst[k]:.1g} times the noise, and estimates may be wrong with it: "
        "transcription=ph.Collocation(refine=True) divides the mesh as needed"
    )


def _unresolved(record: Record, fit: FitResult, order: int) -> bool:
    """Whether the collocation polynomials of a record may lack terms that are not small beside the noise: the next
    coefficient, extrapolated from the last two as of a geometric series. The trapezoid has but two: its error in a
    segment is h³/12 times the third derivative, which third differences show."""
    mesh = np.array([record.mesh_states[name] for name in fit.model.state_names])
    scales = np.array(list(_scales(fit.model, *_numbers(fit, record.name), mesh).values()))
    if order == 2 and mesh.shape[1] > 3:
        return bool((np.abs(np.diff(mesh, 3)) > 12 * _COARSE * scales[:, None]).any())
    points = (order - 1) * np.arange((mesh.shape[1] - 1) // (order - 1))[:, None] + np.arange(order)
    last_two = np.linalg.inv(_legendre(np.array(_core.lgl(order)[0]), order))[-2:]
    before, last = np.moveaxis(np.abs(mesh[:, points] @ last_two.T), -1, 0) / scales[:, None]
    return bool((last * np.minimum(last, before) > _COARSE * before).any())


def _departure(jacobian: _Array, defect: _Array, h: _Array, to: _Array) -> _Array:
    """e, (n, s, m), of e' = J e + d, e = 0 at the first node: J (n, s, m, n), d (n, s, m), integrals ``to`` (m, m)."""
    forced = h[:, None] * (defect @ to)
    e = forced
    # Picard's iterations are enough where segments are short beside the time constants.
    left = np.arange(h.size)
    with np.errstate(all="ignore"):  # of stiff ones they diverge
        for _ in range(_SWEEPS):
            before, e = e, forced + h[:, None] * (np.einsum("aslb,bsl->asl", jacobian, e, optimize=True) @ to)
            moved, size = np.abs(e - before).max(axis=(0, 2)), np.abs(e).max(axis=(0, 2))
            left = np.flatnonzero(~(moved <= _SETTLED * size))
            if not left.size:
                break
    n, _, m = defect.shape
    for k in left:  # the others: all nodes but the first at once
        # Row (j, a), column (l, b): what e_b at node l adds to e_a at node j.
        coupling = h[k] * np.einsum("lj,alb->jalb", to[1:, 1:], jacobian[:, k, 1:])
        system = np.eye((m - 1) * n) - coupling.reshape((m - 1) * n, -1)
        e[:, k, 1:] = np.linalg.solve(system, forced[:, k, 1:].T.ravel()).reshape(m - 1, n).T
    return np.asarray(e)


class _Flow:
    """The state equations of a model with numbers put in, along a record's inputs."""

    def __init__(self, model: Model, values: Mapping[str, float], record: Record) -> None:
        self.values, self.record = values, record
        known: dict[str, Expr | float] = {}
        for name, e, *_ in model._core.quantities:
            known[name] = e.substitute(known)
        sides = {name: e.substitute(known) for name, e, *_ in model._core.dynamics}
        listed = [Equation(f"{name}'", sides[name], None) for name in model.state_names]
        self.listed = listed
        self.plain = Evaluation(model, listed, [])
        self.full = Evaluation(model, listed, model.state_names)

    def _columns(self, t: _Array, x: _Array, ends: tuple[_Array, _Array]) -> _Array:
        r = self.record
        u = []
        for name, values in r.inputs.items():
            kind, own = kind_of(r.interpolation, name), r.input_samples.get(name, (r.t, values))
            # What is held does not jump within a segment.
            at = np.broadcast_to(0.5 * (ends[0] + ends[1]), t.shape) if kind == "hold" else t
            u.append(interpolated(kind, *own, at).ravel())
        return np.vstack([t.ravel(), *u, x.reshape(x.shape[0], -1)])

    def slopes(self, t: _Array, x: _Array, ends: tuple[_Array, _Array]) -> _Array:
        """f, (n, s, m), at the times t (s, m) and states x (n, s, m) of s segments, whose ends are (s, 1)."""
        f = self.plain(self.values, self._columns(t, x, ends))[0]
        return self._checked(t.ravel(), f).reshape(x.shape)

    def slopes_and_jacobian(self, t: _Array, x: _Array, ends: tuple[_Array, _Array]) -> tuple[_Array, _Array]:
        """The same with its derivatives by the states, (n, s, m, n)."""
        f, jacobian = self.full(self.values, self._columns(t, x, ends))
        return self._checked(t.ravel(), f).reshape(x.shape), jacobian.reshape(*x.shape, x.shape[0])

    def _checked(self, t: _Array, f: _Array) -> _Array:
        if not np.isfinite(f).all():
            k, i = np.argwhere(~np.isfinite(f.T))[0]
            raise EvaluationError(
                f"experiment '{self.record.name}': the equation of {self.listed[i].name} is not finite at "
                f"t = {t[k]:g} s on the collocation polynomial: the mesh is too coarse there"
            )
        return f


def _legendre(x: _Array, n: int) -> _Array:
    return np.asarray(np.polynomial.legendre.legvander(2.0 * x - 1.0, n - 1), dtype=np.float64)


def _lagrange(nodes: _Array, at: _Array) -> _Array:
    """Values of the nodes' Lagrange polynomials, (nodes, at), on the unit interval."""
    return np.asarray(np.linalg.solve(_legendre(nodes, nodes.size).T, _legendre(at, nodes.size).T))


def _integrals(nodes: _Array, at: _Array) -> _Array:
    """Their integrals from 0, (nodes, at)."""
    n = nodes.size
    x = 2.0 * at - 1.0
    high = np.polynomial.legendre.legvander(x, n)
    # Of P_0 it is x + 1, of P_k (P_{k+1} - P_{k-1})/(2 k + 1); half of that on the unit interval.
    columns = [x + 1.0] + [(high[:, k + 1] - high[:, k - 1]) / (2 * k + 1) for k in range(1, n)]
    return np.asarray(np.linalg.solve(_legendre(nodes, n).T, 0.5 * np.array(columns)))


def _scales(model: Model, values: Mapping[str, float], sigmas: Mapping[str, float], mesh: _Array) -> dict[str, float]:
    measured = measured_states(model, values)
    scales = {}
    for name, path in zip(model.state_names, mesh, strict=True):
        moves = float(path.std()) or float(np.abs(path).max()) or 1.0
        scales[name] = _UNMEASURED * moves
        if name in measured and measured[name][0] in sigmas:
            output, _, slope = measured[name]
            scales[name] = max(sigmas[output] / abs(slope), _FLOOR * moves)
    return scales
