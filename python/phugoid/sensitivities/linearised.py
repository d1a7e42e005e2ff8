"""A fit linearised: residuals, and the effects on the outputs of parameters, initial states and forces."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import phugoid._core as _core

from .._core import Expr
from ..data.experiment import Experiment
from ..data.filtering import interpolated
from ..errors import EvaluationError, OptionError
from ..fit_result import FitResult, dataset
from ..initialisation import spread
from ..residual_noise import WITHIN, resolution_of, uniform_segments
from ..residual_noise.whitening import RowStructure
from ..solvers import check_time, time_is_up
from ..transcription import Collocation
from . import AddedTerm, Derivatives, Place, Points

__all__ = ["Linearised"]

_Array = NDArray[np.float64]
_Indices = NDArray[np.intp]

# Signals are worked on together as long as they have no more numbers: that bounds the memory.
_NUMBERS = 1_000_000
# Tangents whose singular value, in units of the noise, is below this part of the greatest are rounding.
_NOTHING = 1e-9
_DEPENDENT = "diagnose: the fit cannot be linearised: its equations depend on each other"


class _AlongPaths(NamedTuple):
    """Hold what was evaluated along the path of each experiment.

    slopes         place -> (n_x, mesh points) derivatives of f by what is added there.
    direct         place -> (n_y, samples) derivatives of g by the same.
    by_state       (n_y, n_x, samples) derivatives of g.
    by_variable    (n_y, n_theta, samples) the same by the variables.
    sample_points  places of the samples among the points.
    places         places of the problem's points among them.
    """

    slopes: list[Mapping[Place, _Array]]
    direct: list[Mapping[Place, _Array]]
    by_state: list[_Array]
    by_variable: list[_Array]
    sample_points: list[_Indices]
    places: list[_Indices]


class Linearised:
    """The outputs of a collocation fit as a linear function of what may change in its model.

    Rows stand for samples that were measured, output by output, within these experiment by experiment:

    rows      (n_y, n_experiments) slices into them.
    times     (n_rows,) s.
    residuals (n_rows,) measured minus model.
    sigmas    (n_y,) standard deviations of the noise as fitted.
    tangents  (n_rows, k) changes of the outputs by the free parameters and initial states: an orthogonal basis in units
              of the noise, k their number (less where data or conditions leave less).
    points         the trajectory of each experiment at all points.
    sample_points  of each experiment, the places of its samples among them.
    places         where candidates can act.
    """

    def __init__(self, fit: FitResult) -> None:
        inner = fit._moved or fit
        assert inner.solution is not None and isinstance(inner.transcription, Collocation)
        self.fit, self.inner = fit, inner
        self.model, self.experiments = inner.model, inner.experiments
        names = self.model.output_names
        self._xi = inner._solution_of(self._problem).xi
        present = [[np.isfinite(e.output(name)) for e in self.experiments] for name in names]
        counts = np.array([[int(p.sum()) for p in line] for line in present])
        ends = np.cumsum(counts.ravel()).reshape(counts.shape)
        self.rows = [
            [slice(end - n, end) for end, n in zip(*line, strict=True)] for line in zip(ends, counts, strict=True)
        ]
        self._present = present
        self.n_rows = int(counts.sum())
        self.times = self._stacked(lambda _, e: self.experiments[e].t)
        self.residuals = self._stacked(lambda name, e: inner.records[e].residuals[name])
        self.sigmas = np.array([self._sigma(name) for name in names])
        self._along, self.points = self._evaluated_along()
        self.sample_points = self._along.sample_points
        self.places = {*self._along.slopes[0], *(Place("output", name) for name in names)}

    def _sigma(self, output: str) -> float:
        """Return the standard deviation of an output's noise; without one in the fit, that of its residuals."""
        label = f"sigma_{output}"
        if label in self.inner.parameters:
            return self.inner.parameters[label].value
        known = self.inner.noise.known_sigmas(self.model.output_names)
        if output in known:
            return float(known[output])
        if output in self.inner.noise.expressions:
            return self._evaluated(output, self.inner.noise.expressions[output])
        i = self.model.output_names.index(output)
        r = self.residuals[slice(self.rows[i][0].start, self.rows[i][-1].stop)]
        return float(np.sqrt(np.mean(r**2))) or 1.0

    def _evaluated(self, output: str, expression: Expr) -> float:
        """Return the standard deviation of noise that is an expression of parameters alone."""
        own = {n: e.value for n, e in self.inner.parameters.items()} | {
            n: p.start for n, p in self.model.declared_parameters.items() if p.fixed
        }
        if any(symbol not in own for symbol in expression.symbols):
            raise OptionError(
                f"the standard deviation of '{output}' changes along the record ({expression}): what is known of the "
                "correlation of residuals holds for constant ones"
            )
        return float(expression.evaluate({n: own[n] for n in expression.symbols}))

    def _stacked(self, channel: Callable[[str, int], _Array]) -> _Array:
        parts = [
            channel(name, e)[self._present[i][e]]
            for i, name in enumerate(self.model.output_names)
            for e in range(len(self.experiments))
        ]
        return np.concatenate(parts)

    def scale(self) -> _Array:
        """Return the standard deviation of the noise in each row, (n_rows,)."""
        scale = np.empty(self.n_rows)
        for sigma, line in zip(self.sigmas, self.rows, strict=True):
            scale[line[0].start : line[-1].stop] = sigma
        return scale

    @cached_property
    def rounding(self) -> dict[str, float]:
        """Output -> the RMS within which residuals are rounding of its measurements; 0 where these are not rounded."""
        return {n: WITHIN * resolution_of([e.output(n) for e in self.experiments]) for n in self.model.output_names}

    def _evaluated_along(self) -> tuple[_AlongPaths, list[Points]]:
        """Evaluate the derivatives of f and g along the trajectory, at all points, by symbols."""
        model, problem, record = self.model, self._problem, self.inner.records
        derivatives = Derivatives(model, self.fit.model)
        along, along_points = _AlongPaths([], [], [], [], [], []), []
        n_theta, xi = problem.n_theta, self._xi
        values = problem.values(xi[: len(problem.estimands)].tolist())
        first = problem.first_point
        late = {of: name for name, (of, _) in self.fit.model.delays.inputs.items()}
        for e, experiment in enumerate(self.experiments):
            theta = np.empty(len(model.parameter_names))
            for (_, p, own), (value, _) in zip(problem.estimands, values, strict=True):
                if own is None or own == e:
                    theta[p] = value
            t = problem.point_times(e)
            x = xi[n_theta + first[e] * problem.n_states : n_theta + first[e + 1] * problem.n_states]
            columns = np.vstack([t, *problem.point_inputs(e), x.reshape(t.size, -1).T])
            order = np.argsort(t, kind="stable")  # samples between mesh points stand after all mesh points
            columns, place_of = columns[:, order], np.argsort(order)
            found = derivatives(theta, columns)
            if not all(np.isfinite(part).all() for part in (found.f, found.g, found.by_state, found.by_parameter)):
                raise EvaluationError(f"diagnose: the model is not finite along the path of '{experiment.name}'")
            at = place_of[problem.sample_points(e)]
            seen = derivatives(theta, self._at_samples(experiment, columns[:, at]))
            for of, name in late.items():  # what acts on an input, acts on it late
                by_place, inputs = found.by_place, list(model.declared_inputs)
                for each in (by_place, seen.by_place):
                    (f, g), (more_f, more_g) = each[Place("input", of)], each[Place("input", name)]
                    each[Place("input", of)] = f + more_f, g + more_g
                columns[1 + inputs.index(of)] = columns[1 + inputs.index(name)]
            mesh = place_of[: record[e].mesh_t.size]
            along.sample_points.append(at)
            along.places.append(place_of)
            along.by_state.append(seen.by_state)
            by_variable = np.zeros((len(model.output_names), n_theta, at.size))
            for i, ((_, p, own), (_, slope)) in enumerate(zip(problem.estimands, values, strict=True)):
                if own is None or own == e:
                    by_variable[:, i] = slope * seen.by_parameter[:, p]
            along.by_variable.append(by_variable)
            along.slopes.append({place: f[:, mesh] for place, (f, _) in found.by_place.items()})
            along.direct.append({place: g for place, (_, g) in seen.by_place.items()})
            along_points.append(self._points(experiment.name, columns, found, theta))
        return along, along_points

    @cached_property
    def _along(self) -> _AlongPaths:
        return self._evaluated_along()[0]

    @cached_property
    def _problem(self) -> _core.Collocation:
        """Return the problem, which keeps its last factorisation."""
        inner, names = self.inner, self.model.output_names
        assert isinstance(inner.transcription, Collocation)
        spreads = {name: spread(self.experiments, name) for name in names}
        noise = inner.noise.resolve(names, spreads, inner.as_start(inner.noise))
        return inner.transcription.problem(self.model, self.experiments, noise)

    def forget(self) -> None:
        """Drop derivatives along the paths and factorisations: they take much space, and can be worked out again."""
        for name in ("_along", "_derivatives", "_problem"):
            self.__dict__.pop(name, None)

    def _at_samples(self, experiment: Experiment, columns: _Array) -> _Array:
        """Columns at the samples, with inputs that are held as the outputs see them: from the sample's time on."""
        columns = columns.copy()
        for row, name in enumerate(self.model.declared_inputs, start=1):
            own, values, delay, order = experiment.signal(name) or (experiment.t, experiment.input(name), 0.0, 0)
            if experiment.interpolation_of(name) == "hold" and order == 0:
                columns[row] = interpolated("hold", own, values, columns[0] - delay)
        return columns

    def _points(self, name: str, columns: _Array, found: Any, theta: _Array) -> Points:
        """Return the trajectory at all points; slopes of inputs and outputs come from differences over time."""
        model, t = self.model, columns[0]

        def rate(v: _Array) -> _Array:
            return np.gradient(v, t)

        inputs = list(model.declared_inputs)
        values = dict(zip([*inputs, *model.state_names], columns[1:], strict=True))
        rates = {n: rate(values[n]) for n in inputs} | dict(zip(model.state_names, found.f, strict=True))
        outputs = dict(zip(model.output_names, found.g, strict=True))
        values |= dict(zip(model.quantity_names, found.quantities, strict=True))
        parameters = dict(zip(model.parameter_names, theta.tolist(), strict=True))
        return Points(name, t, values, rates, outputs, {n: rate(v) for n, v in outputs.items()}, parameters)

    @property
    def n_unknowns(self) -> int:
        """Number of free parameters of the model and initial states, less the conditions on these."""
        problem = self._problem
        free = problem.n_theta - len(self._held())
        return free + problem.n_states * len(self.inner.records) - len(problem.boundary_states)

    @cached_property
    def moves(self) -> tuple[_Array, _Array]:
        """Tangents: changes of the outputs (n_rows, k) in units of the noise, orthonormal, and of variables (n, k)."""
        columns, answers = self.directions()
        basis, values, vt = np.linalg.svd(columns, full_matrices=False)
        kept = values > _NOTHING * values[:1]
        moves = basis[:, kept], answers[: self._problem.n_theta] @ (vt[kept].T / values[kept])
        self.forget()  # of most fits no more is asked
        return moves

    def directions(self) -> tuple[_Array, _Array]:
        """Return what `moves` does, with changes of variables and all sampled states, (n_theta + n_samples n_x, k)."""
        problem, held = self._problem, self._held()
        n_theta, n_x = problem.n_theta, problem.n_states
        wanted = [i for i in range(n_theta) if i not in held]
        for first, record in zip(problem.first_point[:-1], self.inner.records, strict=True):
            # The last states too: in an unstable motion all initial states but those on one line are out of reach.
            for point in (first, first + record.mesh_t.size - 1):
                wanted += range(n_theta + n_x * point, n_theta + n_x * (point + 1))
        found = _core.tangents(problem, self._xi, held, wanted, time_is_up)
        if found is None:
            raise EvaluationError(_DEPENDENT)
        answers, forward = found
        if forward and problem.boundary_states:
            answers = self._conditions(wanted) @ answers
        columns = self._outputs(answers).T / self.scale()[:, None]
        size = np.linalg.norm(columns, axis=0)
        kept = size > 0
        return columns[:, kept] / size[kept], answers[kept].T / size[kept]

    def _conditions(self, variables: Sequence[int]) -> _Array:
        """Return the combinations of variables (k, n) that keep the conditions on the initial states satisfied."""
        problem = self._problem
        conditions = np.zeros((len(problem.boundary_states), problem.n))
        rows, columns = problem.jacobian_structure()
        values = problem.jacobian(self._xi)
        assert values is not None  # the path was evaluated before
        there = rows >= problem.m - conditions.shape[0]
        np.add.at(conditions, (rows[there] - (problem.m - conditions.shape[0]), columns[there]), values[there])
        conditions = conditions[:, list(variables)]
        conditions /= np.linalg.norm(conditions, axis=1, keepdims=True)
        _, sizes, vt = np.linalg.svd(conditions)
        return np.asarray(vt[int((sizes > _NOTHING * sizes[0]).sum()) :])

    @property
    def tangents(self) -> _Array:
        """See the class."""
        return np.asarray(self.moves[0] * self.scale()[:, None])

    @cached_property
    def structure(self) -> RowStructure:
        """Which rows belong to one segment, and which to one time."""
        # What a late sensor measured together with others it measured at their time, not at its own.
        measured = np.concatenate(
            [e.t[np.isfinite(e.output(name))] for name in self.model.output_names for e in dataset(self.fit)]
        )[self.measured_rows]
        ends = tuple(tuple((r.start, r.stop) for r in line) for line in self.rows)
        return _structure(self.times.tobytes(), measured.tobytes(), ends)

    def over_time(self, rows: _Array) -> list[_Array]:
        """Return the sums of rows (n_rows,) of the same time, in the order of time, for each experiment."""
        found = []
        for e in range(len(self.experiments)):
            mine = np.concatenate([np.arange(line[e].start, line[e].stop) for line in self.rows])
            _, which = np.unique(self.times[mine], return_inverse=True)
            found.append(np.bincount(which.ravel(), weights=rows[mine]).astype(np.float64))
        return found

    def reaches(self, place: Place) -> bool:
        """Return whether candidates can act at a place, shown by outputs or not."""
        return replace(place, shown=True) in self.places

    @cached_property
    def counts(self) -> list[int]:
        """(n_y,) samples of each output that were measured."""
        data = dataset(self.fit)
        return [sum(int(np.isfinite(e.output(name)).sum()) for e in data) for name in self.model.output_names]

    @property
    def n_measured(self) -> int:
        """All samples that were measured."""
        return sum(self.counts)

    @cached_property
    def measured_rows(self) -> _Indices:
        """(n_rows,) places of the rows among all samples that were measured: a late sensor loses some."""
        delays = self.fit.model.delays.outputs
        all_rows, first = [], 0
        for name, line in zip(self.model.output_names, self.rows, strict=True):
            late = self.fit.parameters[delays[name]].value if name in delays else 0.0
            for e, rows in zip(dataset(self.fit), line, strict=True):
                t = e.t[np.isfinite(e.output(name))]
                at = np.searchsorted(t, self.times[rows] + late)
                before, after = np.clip(at - 1, 0, None), np.clip(at, None, t.size - 1)
                nearer = np.abs(t[after] - self.times[rows] - late) <= np.abs(t[before] - self.times[rows] - late)
                all_rows.append(first + np.where(nearer, after, before))
                first += t.size
        return np.concatenate(all_rows)

    def place(self, name: str) -> int:
        """Return the position of a parameter among the variables."""
        return [n for n, *_ in self._problem.estimands].index(name)

    def value(self, name: str, step: _Array, covariance: _Array) -> tuple[float, float]:
        """Return the value of a parameter after a step of the variables, and its standard error."""
        i = self.place(name)
        n = len(self._problem.estimands)
        _, slope = self._problem.values(self._xi[:n].tolist())[i]
        value, _ = self._problem.values((self._xi + np.pad(step, (0, self._xi.size - step.size)))[:n].tolist())[i]
        return value, float(abs(slope) * np.sqrt(covariance[i, i]))

    def without_states(self, columns: _Array, parameters: _Array) -> _Array:
        """Return what is left of responses (k, n_rows), in units of the noise, with only initial states free.

        ``parameters`` (k, n_theta) is how parameters took part.
        """
        outputs, moves = self.moves
        inverse, basis = self.beside_states(moves)
        columns = columns - parameters @ (outputs @ inverse).T
        return np.asarray(columns - (columns @ basis) @ basis.T)

    def beside_states(self, moves: _Array) -> tuple[_Array, _Array]:
        """Split tangents with changes ``moves`` (n, k) of n parameters into those of parameters and of initial states.

        (k, n) combinations of tangents in the least way for a change of each parameter, and (n_rows, m) an orthonormal
        basis of the outputs' changes, in units of the noise, that initial states make alone.
        """
        size = np.linalg.norm(moves, axis=1, keepdims=True)
        size[size == 0.0] = 1.0
        u, values, vt = np.linalg.svd(moves / size)
        rank = int((values > _NOTHING * values[:1]).sum())
        basis, sizes, _ = np.linalg.svd(self.moves[0] @ vt[rank:].T, full_matrices=False)
        inverse = (vt[:rank].T / values[:rank]) @ u[:, :rank].T
        return np.asarray(inverse / size.ravel()), np.asarray(basis[:, sizes > _NOTHING * sizes[:1]])

    def _held(self) -> list[int]:
        """Variables that do not move: the noise's, and parameters fixed or at a bound."""
        problem = self._problem
        lower, upper = problem.bounds()
        names = [name for name, *_ in problem.estimands]
        held = [i for i, name in enumerate(names) if lower[i] == upper[i] or self.inner.parameters[name].bounds_active]
        return held + list(range(len(names), problem.n_theta))

    @cached_property
    def _derivatives(self) -> tuple[_Array, _Array, _Indices]:
        """Of the outputs at all samples, by states (samples, n_y, n_x) and by variables (samples, n_y, n_theta); and
        which row each is (samples, n_y), -1 where nothing was measured."""
        rows = [np.full((p.size, len(self.rows)), -1) for p in self.sample_points]
        for i, line in enumerate(self.rows):
            for e, own in enumerate(line):
                rows[e][self._present[i][e], i] = np.arange(own.start, own.stop)
        by_state, by_variable = (
            np.ascontiguousarray(np.concatenate(parts, axis=2).transpose(2, 0, 1))
            for parts in (self._along.by_state, self._along.by_variable)
        )
        return by_state, by_variable, np.vstack(rows)

    def _outputs(self, answers: _Array) -> _Array:
        """Return the changes of the outputs (k, n_rows) that follow from those of variables and states."""
        by_state, by_variable, rows = self._derivatives
        k, n_theta = answers.shape[0], self._problem.n_theta
        states = answers[:, n_theta:].reshape(k, len(rows), -1).transpose(1, 2, 0)
        changes = by_state @ states + by_variable @ answers[:, :n_theta].T
        out = np.empty((k, self.n_rows))
        out[:, rows[rows >= 0]] = changes[rows >= 0].T
        return out

    def columns(self, effects: Sequence[tuple[AddedTerm, Mapping[str, float]]]) -> tuple[_Array, _Array, list[slice]]:
        """Return the responses of the outputs to the coefficients of candidates at a shape.

        (k, n_rows) answers, (k, n_theta) how parameters took part in them, and which of the k are each effect's. What
        differs by tangents is the same answer: parameters and initial states take part in the least way, or none.
        """
        ends = np.cumsum([0, *(1 if c.unit_amplitude else len(c.coefficients) for c, _ in effects)]).tolist()
        groups = [slice(a, b) for a, b in pairwise(ends)]
        answers = np.zeros((ends[-1], self.n_rows))
        parameters = np.zeros((ends[-1], self._problem.n_theta))
        by_place: dict[Place, list[int]] = {}
        for i, (c, _) in enumerate(effects):
            by_place.setdefault(c.place, []).append(i)
        most = max(1, _NUMBERS // sum(p.t.size for p in self.points))
        for place, members in by_place.items():
            for begin in range(0, len(members), most):
                some = members[begin : begin + most]
                signals = [np.vstack([_signals(*effects[i], p) for i in some]) for p in self.points]
                at = np.concatenate([np.arange(ends[i], ends[i + 1]) for i in some])
                answers[at], parameters[at] = self._answers(place, signals)
        return answers, parameters, groups

    def answers(self, place: Place, signals: Sequence[_Array]) -> _Array:
        """Return the responses (k, n_rows) of the outputs to signals (k, points of each experiment) at a place."""
        return self._answers(place, signals)[0]

    def _answers(self, place: Place, signals: Sequence[_Array]) -> tuple[_Array, _Array]:
        """Answers to signals at a place, (k, points) for each experiment."""
        if place.kind == "output":
            slopes = np.zeros((sum(r.mesh_t.size for r in self.inner.records), self._problem.n_states))
            direct = np.zeros(self._derivatives[2].shape)
            direct[:, self.model.output_names.index(place.name)] = 1.0
        else:
            at = replace(place, shown=True)
            slopes = np.vstack([by[at].T for by in self._along.slopes])
            direct = np.vstack([by[at].T for by in self._along.direct])
            if place.kind == "equation" and not place.shown:
                direct = np.zeros_like(direct)
        of_points = np.hstack([np.take(s, at, axis=1) for s, at in zip(signals, self._along.places, strict=True)])
        mine = (self._problem, self._xi, self._held(), *self._derivatives)
        slopes, direct, of_points = map(np.ascontiguousarray, (slopes, direct, of_points))
        found = _core.answers(*mine, slopes, direct, of_points, time_is_up)
        if found is None:
            raise EvaluationError(_DEPENDENT)
        return found


def _signals(candidate: AddedTerm, shape: Mapping[str, float], points: Points) -> _Array:
    """Return the signals of a candidate along the path, (k, points), within the limit in force."""
    check_time()
    return candidate.signals(points, shape)


@lru_cache(maxsize=8)  # all refits to the same records have the same
def _structure(own: bytes, clock: bytes, ends: tuple[tuple[tuple[int, int], ...], ...]) -> RowStructure:
    """Return which rows belong to one segment, and which to one time.

    The bytes are those of the times (n_rows,) of the rows, and of when they were measured; ``ends`` are the first row
    and the one after the last of each output in each experiment.
    """
    times, measured = np.frombuffer(own), np.frombuffer(clock)
    rows = [[slice(*r) for r in line] for line in ends]
    segments = [[s.from_row(r.start) for r in line for s in uniform_segments(times[r])] for line in rows]
    groups: dict[tuple[int, ...], list[_Indices]] = {}
    complete: list[_Indices] = []
    for e in range(len(rows[0])):
        lines = [line[e] for line in rows]
        instants = np.unique(np.concatenate([measured[r] for r in lines]))
        table = np.full((instants.size, len(lines)), -1)
        for i, r in enumerate(lines):
            table[np.searchsorted(instants, measured[r]), i] = np.arange(r.start, r.stop)
        whole = np.flatnonzero((table >= 0).all(axis=1))
        for segment in uniform_segments(instants[whole]):
            complete += [table[whole[segment.rows][run]] for run in segment.runs]
        patterns, which = np.unique(table >= 0, axis=0, return_inverse=True)
        for k, pattern in enumerate(patterns):
            there = np.flatnonzero(pattern)
            some = table[which.ravel() == k]
            groups.setdefault(tuple(there.tolist()), []).append(some[:, there])
    together = [(outputs, np.vstack(at)) for outputs, at in groups.items()]
    return RowStructure(segments, together, complete)
