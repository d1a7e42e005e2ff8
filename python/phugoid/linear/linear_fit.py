"""The maximum-likelihood estimate of a linear system, by variable projection."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..data.experiment import Experiment
from ..errors import DataError, check_progress, whole
from ..solvers import Iteration, Progress, check_time, limited
from .modal_blocks import ModalBlocks, best_places
from .modal_regression import Layout, ModalRegression, identified, path, regression, rows, samples_of
from .sampled import Answers, Sampled, chosen_outputs, triangle
from .state_space import StateSpace, as_state_space, modal_parts

__all__ = ["fit_linear"]

_Array: TypeAlias = NDArray[np.float64]

# An iteration that gains less log-likelihood than this is the last; and, while modes are moved, than this.
_GAIN, _ROUGH = 1e-7, 1e-3
# Rise of the log-likelihood from which on a place is better for a mode; number of places that are tried.
_BETTER, _PLACES = 0.5, 4
# A search is stopped where a step gains less than this part of its distance from the known optimum.
_REACH = 0.02
# Distance from a known optimum, in squared standard deviations of the outputs, below which a search leads there.
_BACK = 1.0
# Directions that change the outputs by less than this part of the first one's effect are ignored.
_NOTHING = 1e-10
# Damping of the first step, as a part of the greatest singular value squared; and how often a step is damped more.
_DAMPING, _TRIALS = 1e-9, 15
# Eigenvalues stay below so many Nyquist frequencies. A mode that grows with a damping ratio up to this is reflected.
_FASTEST, _REFLECTED = 20.0, 0.1


def fit_linear(
    system: StateSpace | Sequence[Any],
    data: Experiment | Sequence[Experiment],
    *,
    feedthrough: bool | Collection[str] | None = None,
    offset: bool = True,
    moves: int | None = None,
    max_iterations: int = 200,
    progress: bool | Callable[[Iteration], None] = False,
    time_limit: float | None = None,
) -> StateSpace:
    """Return the linear system of the same order that fits evenly sampled records best: maximum likelihood of the
    outputs.

    Output error as in `estimate`, with white noise and a variance for each output, but for linear systems, where part
    of the problem is linear: given A and C, the outputs are linear in B, D, the initial states and offsets, which are
    found by least squares for each A and C that is tried (variable projection: Golub and Pereyra, SIAM J. Numer. Anal.
    10(2), 1973; the approximation of Kaufman, BIT 15, 1975). The other unknowns, two numbers for each mode and C, are
    found by Levenberg-Marquardt steps with orthogonal factorisations, so that modes which a record hardly determines
    (heavily damped ones, or ones near each other) do no harm. A mode is represented by the two coefficients of s^2 + a
    s + b: a pair becomes two real eigenvalues, or the other way round, where that fits better. Responses to inputs are
    exact.

    Local optima are escaped by moving modes: one after another, the one whose loss costs the fit least first, is
    removed and put to the places where it fits best; where a search from there has a greater likelihood, the moves
    begin again.

    ``system``      the start: a system from `subspace`, (A, B, C), or `linearise` of a model. Only its eigenvalues,
                    which must be distinct, and its C are used. Names of inputs and outputs are those of the data.
    ``data``        one experiment or several, of one sampling rate. Samples of outputs may be missing.
    ``feedthrough`` whether inputs act on outputs directly: on all, or on those named. None: where ``system`` has
                    feedthrough.
    ``offset``      a constant in each output of each experiment, such as a sensor's bias or the trim.
    ``moves``       greatest number of modes that are tried: None for all, 0 for none.
    ``max_iterations``  in each search.
    ``progress``    True prints the iterations; a function is called with each (its ``defect`` is 0, ``dual`` the gain).
    ``time_limit``  in seconds, of the whole.

    Ctrl-C, and the time limit, end the search; the result is the best system so far, with a warning. Modes may grow
    with time only if a mode of ``system`` does.

    For parameters with standard errors: ``ph.estimate(ph.models.modal(start=ph.linear.fit_linear(...)), data)``, which
    then is a few steps away from its optimum.

    Raises DataError for missing channels and uneven sampling, ModelError for an invalid system or one with eigenvalues
    that cannot be distinguished, OptionError for options out of range.
    """
    deadline = limited("fit_linear", time_limit)
    most = np.iinfo(np.int64).max if moves is None else moves
    for name, value, least in (("moves", most, 0), ("max_iterations", max_iterations, 1)):
        whole(f"fit_linear: {name}", value, least)
    check_progress("fit_linear", progress)
    start = as_state_space("fit_linear", system)
    records = Sampled.of(data, start.inputs, start.outputs, "fit_linear", complete=False)
    parts = modal_parts(start.A, start.B, start.C)
    task = _Task(records, _direct(feedthrough, start), offset, bool(np.any(parts.values.real > 0.0)), max_iterations)
    if min(samples_of(records.runs, records.outputs)) <= 2 * start.order + len(records.inputs) + 1:
        raise DataError(f"fit_linear: the records are too short for {start.order} states")
    found = task.point(ModalBlocks.of(parts.values, parts.outputs, records.y_size))
    warnings: tuple[str, ...] = ()
    with Progress.of(progress, "linear system") as watch:
        task.watch = watch
        try:
            with deadline.in_force():
                task.moved(task.search(found, _ROUGH), most)
                task.search(task.best or found, _GAIN)
        except KeyboardInterrupt:
            warnings = (f"{deadline.ended()}: this is the best system so far, not the optimum",)
    found = task.best or found
    values, C, _ = found.blocks.modal()
    return identified(
        records,
        values,
        C,
        found.regression,
        log_likelihood=found.log_likelihood,
        warnings=warnings,
    )


@dataclass(frozen=True, eq=False)
class _Point:
    """A point of the search: A and C, the modal responses there, the least-squares solution, and the log-likelihood."""

    blocks: ModalBlocks
    answers: Sequence[Answers]
    regression: ModalRegression
    log_likelihood: float


@dataclass(frozen=True, eq=False)
class _Known:
    """A known optimum: outputs (p, N) of each experiment, the least-squares solution, and the log-likelihood."""

    paths: Sequence[_Array]
    regression: ModalRegression
    log_likelihood: float

    @classmethod
    def of(cls, point: _Point) -> _Known:
        C = point.blocks.modal()[1]
        paths = [path(answers, C, point.regression) for answers in point.answers]
        return cls(paths, point.regression, point.log_likelihood)


@dataclass(frozen=True, eq=False)
class _Linearised:
    """About a point: derivatives J (k, k) of the residuals by the numbers of the blocks, and residuals q (k,), over the
    noise, both without what B, D, initial states and offsets can do, and turned to as many rows as there are numbers.

    U, s, Vt  of J times the sizes of the numbers (k,).
    apart     where the linearised outputs fit best, their squared distance from those of the known optimum, in
              units of the noise; infinite without one.
    """

    J: _Array
    q: _Array
    U: _Array
    s: _Array
    Vt: _Array
    apart: float


class _Task:
    """The data and options of a search, and the searches."""

    def __init__(
        self, records: Sampled, direct: tuple[bool, ...], offset: bool, growing: bool, max_iterations: int
    ) -> None:
        self.records, self.direct, self.offset = records, direct, offset
        self.growing, self.max_iterations = growing, max_iterations
        self.samples = samples_of(records.runs, records.outputs)
        self.watch: Callable[[Iteration], None] | None = None
        self.number = 0
        self.best: _Point | None = None

    def point(self, blocks: ModalBlocks) -> _Point:
        check_time()
        values, C, _ = blocks.modal()
        answers = [driven.answers(values) for driven in self.records.driven]
        found = regression(answers, C, self.records.outputs, self.direct, self.offset)
        rms = np.maximum(found.rms, np.finfo(np.float64).tiny)
        return _Point(blocks, answers, found, -float(self.samples @ (np.log(rms) + 0.5)))

    def search(self, point: _Point, least: float, known: _Known | None = None) -> _Point:
        """Take Levenberg-Marquardt steps, each an improvement, until one gains less than ``least``, or until they lead
        to a known optimum, or to none as good."""
        damping = _DAMPING
        goal = -np.inf if known is None else known.log_likelihood
        for _ in range(self.max_iterations):
            near = self._linearised(point, known)
            if near.apart < _BACK:
                break
            J, q, s, sizes = near.J, near.q, near.s, point.blocks.sizes
            q_in = near.U.T @ q
            better, factor, trials = None, 2.0, 0
            while better is None and trials < _TRIALS and s[0] > 0.0:
                trials += 1
                step = sizes * (near.Vt.T @ (s * q_in / (s * s + damping * s[0] ** 2)))
                tried = self._tried(point.blocks.moved(step))
                if tried is not None and tried.log_likelihood > point.log_likelihood:
                    better = tried
                else:
                    damping, factor = damping * factor, min(2.0 * factor, 16.0)
            if better is None:
                break
            gain = better.log_likelihood - point.log_likelihood
            if gain > 0.375 * (q @ q - np.sum((q - J @ step) ** 2)):  # three quarters of the predicted gain
                damping /= 5.0
            point = better
            if self.best is None or point.log_likelihood > self.best.log_likelihood:
                self.best = point
            self.number += 1
            if self.watch:
                self.watch(Iteration(self.number, point.log_likelihood, 0.0, gain, 1.0, trials))
            if gain < max(least, _REACH * (goal - point.log_likelihood)):
                break
        return point

    def moved(self, point: _Point, moves: int) -> _Point:
        """Move pairs whose loss costs the fit least to the places where they fit best, as long as that improves it."""
        better = moves > 0 and len(point.blocks) > 1
        while better:
            better, known = False, _Known.of(point)
            missed = [self.point(point.blocks.without(k)).log_likelihood for k in range(len(point.blocks.pairs))]
            for k in np.argsort(missed)[::-1][:moves]:
                rest = self.point(point.blocks.without(int(k)))
                places = best_places(self.records, rest.blocks, rest.regression, self.direct, self.offset)
                for block in places[:_PLACES]:
                    there = self.search(self.point(rest.blocks.joined(block)), _ROUGH, known)
                    if there.log_likelihood > point.log_likelihood + _BETTER:
                        point, better = there, True
                        break
                if better:
                    break
        return point

    def _tried(self, blocks: ModalBlocks) -> _Point | None:
        """Return the point of these modes; None where there is none, modes are too fast, or grow though they must not.

        Modes that grow a little are reflected: a mode without damping would be stuck at the edge.
        """
        values = blocks.modal()[0]
        if not np.all(np.abs(values) < _FASTEST * np.pi * self.records.rate):
            return None
        if not self.growing and np.any(values.real > 0.0):
            if np.any(values.real > _REFLECTED * np.abs(values)):
                return None
            blocks = blocks.reflected()
        try:
            found = self.point(blocks)
        except (ValueError, np.linalg.LinAlgError):
            return None
        return found if np.isfinite(found.log_likelihood) else None

    def _linearised(self, point: _Point, known: _Known | None) -> _Linearised:
        r, found = self.records, point.regression
        values, C, _ = point.blocks.modal()
        layout = Layout(values.imag != 0.0, len(r.inputs), self.direct, self.offset, len(r.runs))
        count = point.blocks.sizes.size
        last = layout.total + count  # where outputs of the known optimum are, then those measured
        blocks = []
        for e, answers in enumerate(point.answers):
            for j, (which, slopes) in enumerate(point.blocks.slopes(answers, found)):
                z = answers.driven.run.output(r.outputs[j])
                more = slopes if known is None else np.vstack([slopes, known.paths[e][j]])
                R = triangle(rows(C[j], answers, self.direct[j], z, self.offset, more))
                wide = np.zeros((R.shape[0], last + 2))
                own = [*layout.columns(e, j), *(layout.total + i for i in which)]
                wide[:, [*own, *([] if known is None else [last]), last + 1]] = R / (found.rms[j] or 1.0)
                blocks.append(wide)
        whole = triangle(blocks)[layout.total :, layout.total :]
        J, q = whole[:count, :count], whole[:count, -1]
        U, s, Vt = np.linalg.svd(J * point.blocks.sizes)
        if known is None:
            return _Linearised(J, q, U, s, Vt, np.inf)
        # The parts of the known optimum's outputs and residuals outside of the linearised outputs. Numbers
        # without effect, such as the size of a column of C, have an arbitrary direction and are left out.
        paths, left = whole[:, count], whole[:, -1] - whole[:, count]
        there = U[:, s > _NOTHING * s[0]]
        outside = float(paths @ paths - np.sum((there.T @ paths[:count]) ** 2))
        ratio = known.regression.rms / np.where(found.rms > 0.0, found.rms, 1.0)
        inside = float(self.samples @ ratio**2) - float(left @ left - np.sum((there.T @ left[:count]) ** 2))
        return _Linearised(J, q, U, s, Vt, (max(outside, 0.0) + max(inside, 0.0)) / float(ratio.min()) ** 2)


def _direct(feedthrough: bool | Collection[str] | None, start: StateSpace) -> tuple[bool, ...]:
    if feedthrough is None:
        return tuple(bool(np.any(row)) for row in start.D)
    return tuple(chosen_outputs("fit_linear", feedthrough, start.outputs))
