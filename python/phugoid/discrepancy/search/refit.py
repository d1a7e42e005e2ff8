"""A model with candidates added, fitted, and its likelihood with coloured noise."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...data.experiment import Experiment
from ...errors import DataError, EvaluationError, ModelError, PhugoidError
from ...estimation import estimate
from ...fit_result import ENDED_WELL, FitResult, dataset, mean_square
from ...frozen_model import estimates_of, freed_by_default, freeze_model, freeze_noise, mesh_for
from ...initialisation import measured_states
from ...modelling.model import Model
from ...parameters import Estimates
from ...residual_noise.whitening import Filter, Whitening
from ...sensitivities import Points
from ...sensitivities.linearised import Linearised
from ...sensitivities.whitened import Whitened, joint_whitening, own_whitening
from ...simulation import simulate
from ...solvers import check_time
from ...solvers.newton import Newton
from ..candidates.candidate import Candidate

__all__ = [
    "BLOCKS",
    "HeldOut",
    "LeftOut",
    "Refit",
    "across_blocks",
    "blocks_of",
    "fitted_to",
    "gain_on_other_data",
    "is_structured",
    "on_other_data",
    "refit",
    "started_from",
]

# A refit goes on from a fit nearby: a quarter of these iterations leads near its optimum, or the rest go along paths
# that satisfy the equations. What a scan elsewhere proposed may be farther, and so may a term without a shape, such as
# strong friction, whose iterations are quick. With 200 and more the solver would try other ways to the optimum as well.
_ITERATIONS, _PATIENT, _FROM_MEASURED = 80, 150, 199
_SOLVER = Newton(max_iterations=_ITERATIONS)
# In s and in times of the base fit: where its iterations take so long, the mesh is refined again and again, or the path
# is lost and every step is tried many times.
_SECONDS, _TIMES = 12.0, 20.0
# The same for a fit to data held out, and times as large residuals as the fit's own with which another start is tried.
_ELSEWHERE, _FAR = 10.0, 3.0
# Seconds that a simulation may take which gives such a fit a start.
_SIMULATION = 2.0
# Delays are found to this part of their standard errors: to first order in what is left the rest is allowed for.
_SETTLED = 0.03
# Within so many passes, since the scan gives good start values: iterations beyond diverge, or alternate over a kink.
_PASSES = 8


@dataclass(frozen=True, eq=False)
class Refit:
    """Candidates, in the order in which they were found, and the fit of the model with all of them."""

    candidates: tuple[Candidate, ...]
    fit: FitResult

    @cached_property
    def linear(self) -> Linearised:
        """About this fit."""
        return Linearised(self.fit)

    @cached_property
    def own(self) -> Whitened:
        """Through the filter that is the likeliest with it."""
        return own_whitening(self.linear)

    @cached_property
    def together(self) -> Whitened | None:
        """Through the likeliest filter of all channels together, where that is the better model of the noise."""
        return joint_whitening(self.own)

    @property
    def merit(self) -> float:
        """Log-likelihood with the best noise model, less what that costs by Akaike's criterion."""
        return (self.together or self.own).lenient_merit

    def through(self, filter: Filter) -> Whitened:
        """Through another's filter."""
        return Whitened(self.linear, filter.on(self.linear.structure))

    @cached_property
    def rms(self) -> dict[str, float]:
        """Output -> RMS of the residuals over all records."""
        return {n: math.sqrt(mean_square(self.fit, n)) for n in self.fit.model.output_names}

    @property
    def names(self) -> tuple[str, ...]:
        """Of the candidates."""
        return tuple(c.name for c in self.candidates)

    def beside(self, others: Collection[Candidate]) -> list[Candidate]:
        """Return the candidates beside others; by name, for one candidate may be centred in several ways."""
        names = {c.name for c in others}
        return [c for c in self.candidates if c.name not in names]

    def inflation(self, candidate: Candidate) -> float:
        """Return the factor by which the evidence for a candidate is less than the filter has it."""
        return max(self.own.inflation(name) for name in candidate.parameters)

    def parameters(self, candidate: Candidate) -> dict[str, tuple[float, float]]:
        """Value and standard error, for coloured noise, of a candidate's parameters."""
        inflation = float(np.sqrt(self.linear.n_rows / max(self.linear.n_rows - self.own.basis.shape[1], 1)))
        found = {}
        for name in candidate.parameters:
            value, error = self.own.parameter(name)
            found[name] = float(value), float(error * inflation * np.sqrt(self.own.inflation(name)))
        return found


def refit(
    base: FitResult,
    candidates: Sequence[Candidate],
    starts: Mapping[str, float],
    near: FitResult | None = None,
    points: Sequence[Points] = (),
    patient: bool = False,
    measured: bool = False,
    held: Collection[str] = (),
) -> Refit | None:
    """Return the base model with candidates, fitted from the values in ``starts`` and a fit nearby; new states from
    what the candidates say of them at ``points``. ``measured``: the path begins at the measurements instead, which
    takes many iterations. ``held``: parameters that stay as in ``starts``.

    None where there is no such model or the solver does not come to an end.
    """
    model = base.model
    try:
        for candidate in sorted(candidates, key=lambda c: c.stage):
            own = {n: starts[n] for n in candidate.parameters if n in starts}
            model = candidate.extended(model, own)
        if held:
            declared = model.declared_parameters
            model = model.with_parameters({n: replace(declared[n], start=starts[n], fixed=True) for n in held})
        if model.delays:
            model = model._changed(delays=replace(model.delays, settled=_SETTLED, passes=_PASSES))
        from_fit = started_from(near or base, model.parameter_names)
        patient = patient or any(c.jumps for c in candidates) or not any(c.shape_names for c in candidates)
        iterations = _FROM_MEASURED if measured else _PATIENT if patient else _ITERATIONS
        fit = estimate(
            model,
            dataset(base),
            transcription=base.transcription,
            noise=base.noise,
            start=values_of(from_fit) if measured else _with_paths(from_fit, candidates, points, starts),
            solver=Newton(max_iterations=iterations, time_limit=max(_SECONDS, _TIMES * base.time)),
        )
    except PhugoidError:
        return None
    if fit.status == "time limit":
        check_time()  # that of the diagnosis
    if fit.status == "interrupted":
        raise KeyboardInterrupt
    return Refit(tuple(candidates), fit) if fit.status in ENDED_WELL else None


def fitted_to(
    at: Refit,
    data: Sequence[Experiment],
    *,
    model: Model | None = None,
    start: FitResult | Mapping[str, float] | None = None,
    solver: Newton | None = _SOLVER,
) -> Refit | None:
    """Return the model of a refit, or another ``model``, estimated from other records, such as those with inputs that
    are held; None where the solver does not come to an end. It starts from the refit, or from values in ``start``."""
    fit = at.fit
    try:
        found = estimate(
            fit.model if model is None else model,
            data,
            transcription=mesh_for(fit, data),
            noise=fit.noise,
            start=fit if start is None else start,
            solver=solver,
        )
    except (PhugoidError, np.linalg.LinAlgError):
        return None
    return Refit(at.candidates, found) if found.status in ENDED_WELL else None


def values_of(fit: FitResult) -> FitResult | dict[str, float]:
    """Return the estimates of the model's parameters that all experiments share, without those of the noise, as a start
    without the path of the fit; with the widths over which kinks were smoothed, which need not be found again."""
    values = {n: fit.parameters[n].value for n in fit.model.parameter_names if n in fit.parameters}
    return replace(started_from(fit, values), records=[]) if fit.smoothing else values


def _with_paths(
    near: FitResult, candidates: Sequence[Candidate], points: Sequence[Points], starts: Mapping[str, float]
) -> FitResult:
    """Return a start with paths of the states that candidates add, where it has none of them, and of others as they let
    them be."""
    records = []
    for record, p in zip(near.records, points, strict=False):
        states = dict(record.mesh_states)
        for c in candidates:
            added = {n: z for n, z in c.paths(p, starts).items() if n not in states}
            states |= {n: np.interp(record.mesh_t, p.t, z) for n, z in added.items()}
            states |= c.reachable(states, starts)
        records.append(replace(record, mesh_states=states))
    return replace(near, records=records) if records else near


def started_from(near: FitResult, names: Collection[str]) -> FitResult:
    """Return a fit as a start: its path, and of its parameters those of the noise and those in ``names``."""
    kept = {*names} | near.noise_parameters
    return replace(near, parameters=Estimates(e for n, e in near.parameters.items() if n.partition("[")[0] in kept))


_Array = NDArray[np.float64]

# Blocks of each record that are left out in turn.
BLOCKS = 4
# Of what a block says of a parameter: the precision that all data together have is 1.
_LOOSE = 0.01
# Directions of the parameters that a block says less of, in parts of the clearest, stay as they are there.
_RANK = 1e-6


class HeldOut(NamedTuple):
    """A gain on held-out data.

    gain       in whitened log-likelihood.
    deviation  its standard deviation.
    elsewhere  the gain without the block of the records that gains most: one block alone is no confirmation, for
               whatever is wrong there would look like a gain. On other records the gain itself.
    moved      what the two models differ by, as a sum of squares in units of the noise; of blocks not asked.
    """

    gain: float
    deviation: float
    elsewhere: float
    moved: float = math.inf


def across_blocks(base: Refit, more: Refit) -> HeldOut:
    """Gain in whitened log-likelihood of the blocks of the records, each predicted by what the others say of all
    parameters (`LeftOut`), with the candidates that a refit has more."""
    squares = np.full((2, base.linear.n_measured), np.nan)  # a late sensor leaves some samples out
    block = np.zeros(base.linear.n_measured, dtype=np.intp)
    block[base.linear.measured_rows] = blocks_of(base.linear)
    for own, at in zip(squares, (base, more), strict=True):
        own[at.linear.measured_rows] = LeftOut(at, more.own.filter).whitened ** 2
    gain = 0.5 * (squares[0] - squares[1])
    gain, block = gain[there := np.isfinite(gain)], block[there]
    total = float(gain.sum())
    best = max(float(gain[block == b].sum()) for b in range(BLOCKS))
    return HeldOut(total, float(np.sqrt(gain.size) * gain.std()), total - best)


class LeftOut:
    """Errors of the blocks of the records, each predicted by the others, to first order about the fit to all: the step
    that takes out what a block says of the parameters. They may follow by ten standard errors."""

    def __init__(self, at: Refit, filter: Filter) -> None:
        self._seen = at.own if filter is at.own.filter else at.through(filter)
        self._scale, self._block = at.linear.scale(), blocks_of(at.linear)
        self._names = [n for n in at.fit.parameters if n not in at.fit.noise_parameters]

    @cached_property
    def _steps(self) -> list[tuple[NDArray[np.bool_], _Array]]:
        """Return the rows (n_rows,) of each block, and the step along the basis that the others ask for."""
        basis, errors, found = self._seen.basis, self._seen.errors, []
        for b in range(BLOCKS):
            inside = self._block == b
            others = basis[~inside]
            normal = others.T @ others + _LOOSE * np.eye(basis.shape[1])
            found.append((inside, np.linalg.solve(normal, others.T @ errors[~inside])))
        return found

    @property
    def whitened(self) -> _Array:
        """Return the errors (n_rows,), whitened, with all parameters as the others have them."""
        return self._without(self._seen.errors, self._seen.basis)

    def _without(self, errors: _Array, basis: _Array) -> _Array:
        """Return errors (n_rows,) after the step that the other blocks ask for, along a basis (n_rows, k)."""
        out = errors.copy()
        for inside, step in self._steps:
            out[inside] -= basis[inside] @ step
        return out

    def simulated(self, free: Collection[str]) -> _Array:
        """Return the errors (n_rows,) of a free simulation, in the units of the outputs: with parameters as the others
        have them, but initial states and those in ``free`` as they fit the block best, as on validation records."""
        seen, scale = self._seen, self._scale
        out = self._without(seen.residuals, seen.plain_basis)
        known = [seen.direction(n) for n in self._names if n.partition("[")[0] not in free]
        # Each in units of its own, of which the rank must not depend.
        fixed = np.array([d / np.linalg.norm(d) for d in known if d.any()]).reshape(-1, seen.basis.shape[1])
        # Directions of the parameters in which the known ones stay.
        own_ways = np.linalg.svd(fixed)[2][np.linalg.matrix_rank(fixed) if fixed.size else 0 :].T
        for inside, _ in self._steps:
            rest, own = out[inside] / scale[inside], seen.plain_basis[inside] @ own_ways / scale[inside, None]
            out[inside] = scale[inside] * (rest - own @ np.linalg.lstsq(own, rest, rcond=_RANK)[0])
        return out


def blocks_of(linear: Linearised) -> NDArray[np.intp]:
    """Return the block of each row."""
    block = np.empty(linear.n_rows, dtype=np.intp)
    for line in linear.rows:
        for e, rows in enumerate(line):
            t = linear.experiments[e].t
            share = (linear.times[rows] - t[0]) / (t[-1] - t[0])
            block[rows] = np.minimum((share * BLOCKS).astype(np.intp), BLOCKS - 1)
    return block


def on_other_data(
    refit: Refit,
    data: Sequence[Experiment],
    near: Linearised | None = None,
    free: Sequence[str] | None = None,
    as_fitted: bool = False,
) -> Linearised:
    """Return a refit's model on other data, linearised: initial states and ``free`` parameters (biases unless given)
    are estimated, all else is as fitted.

    ``near`` is another model's, whose path is a start. Disturbances and drifts, which another record does not share,
    are zero there, or ``as_fitted``, as in `Fit.validate`.

    Raises ModelError where parameters have a value for each experiment and are not free, DataError where there is no
    such fit.
    """
    fit = refit.fit
    free = freed_by_default(fit.model) if free is None else free
    values = {n: e.value for n, e in fit.parameters.items()}
    if not as_fitted:  # a disturbance has another phase there: what is known of it is nothing
        values |= {n: 0.0 for c in refit.candidates if not c.transferable for n in c.coefficients}
    declared = fit.model.declared_parameters.items()
    own = [n for n, p in declared if p.per_experiment and not p.fixed and n not in free]
    if own:
        names = [repr(n) for n in own]
        listed = ", ".join(names)
        raise ModelError(
            f"diagnose: each experiment of the fit has its own {listed}, and which value the validation record has is "
            f"not known: name what is to be estimated there, biases=[{listed}], or leave validation out"
        )
    model, noise = freeze_model(fit.model, values, free), freeze_noise(fit)[0]
    known = {n: [e.value for e in estimates_of(fit.parameters, [n]).values()] for n in free}
    mesh = mesh_for(fit, data)
    first = {n: float(np.mean(v)) for n, v in known.items() if v}

    def starts() -> Iterator[tuple[FitResult | dict[str, float], bool]]:
        """Yield starts, and whether each is the last, when it is needed."""
        if near is not None:  # its path may be out of reach of this model: then the measured one
            yield _with_paths(started_from(near.fit, ()), refit.candidates, near.points, values), False
            # Another model's path says little of one whose forces jump, or change with the position many times a turn.
            simulated = _simulated(model, near.fit, data)
            if simulated is not None:
                yield simulated, False
        yield replace(started_from(fit, first), records=[]) if fit.smoothing else first, True

    # A model that is as far off with another path as it is near it has no better branch.
    before = {} if near is None else Refit((), near.fit).rms
    usual = {n: max(rms, before.get(n, 0.0)) for n, rms in refit.rms.items()}
    best: FitResult | None = None
    reason = ""
    limit = max(_ELSEWHERE, _TIMES * fit.time)
    for start, last in starts():
        # From another model's path, or where only initial states are wrong, few iterations lead to this model's.
        few = best is not None or not last
        # Only the model that is diagnosed must be fitted there at any price.
        most = _ITERATIONS if few else _PATIENT if near is not None else None
        solver = Newton(time_limit=limit) if most is None else Newton(max_iterations=most, time_limit=limit)
        try:
            found = estimate(model, list(data), transcription=mesh, noise=noise, start=start, solver=solver)
        except EvaluationError as error:  # a root of a level that noise takes below zero, say
            reason = str(error)
            continue
        if found.status == "time limit":
            check_time()  # that of the diagnosis
        if found.status == "interrupted":
            raise KeyboardInterrupt
        if found.status not in (*ENDED_WELL, "unidentifiable"):
            reason = found.message
            continue
        if best is None or found.log_likelihood > best.log_likelihood:
            best = found
        # A motion may have several branches, and another model's path may lie near the wrong one.
        if all(rms <= _FAR * usual[n] for n, rms in Refit((), best).rms.items()):
            break
    if best is None:
        raise DataError(f"diagnose: the model cannot be fitted to the validation record: {reason}")
    return Linearised(best)


def _simulated(model: Model, near: FitResult, data: Sequence[Experiment]) -> FitResult | None:
    """Return a start with the paths of a model as simulated from its initial states as measured, else as a fit nearby
    has them; None where they cannot be."""
    values = {n: p.start for n, p in model.declared_parameters.items()}
    measured = measured_states(model, values)
    hidden = [n for n in model.state_names if n not in measured]
    records = []
    try:
        for record, e in zip(near.records, data, strict=True):
            begun = {n: float(record.mesh_states[n][0]) for n in hidden if n in record.mesh_states}
            run = simulate(model, values, e, initial=begun, time_limit=_SIMULATION)
            paths = {n: np.interp(record.mesh_t, e.t, z) for n, z in run.states.items()}
            records.append(replace(record, mesh_states=paths))
    except PhugoidError:
        return None
    return replace(started_from(near, ()), records=records)


def gain_on_other_data(base: Linearised, more: Linearised) -> HeldOut:
    """Gain on other data, through the likeliest filter of ``more``."""
    own = own_whitening(more)
    other = Whitened(base, own.filter.on(base.structure))
    d = own.log_densities - other.log_densities
    d = d[np.isfinite(d)]
    errors = np.full((2, more.n_measured), np.nan)  # a late sensor leaves some samples out
    errors[0, more.measured_rows], errors[1, base.measured_rows] = own.errors, other.errors
    moved = float(np.nansum((errors[0] - errors[1]) ** 2))
    return HeldOut(float(d.sum()), float(np.sqrt(d.size) * d.std()), float(d.sum()), moved)


def is_structured(at: Refit, least: float) -> bool:
    """Return whether the past of any output's residuals predicts more than this part of their power."""
    linear = at.linear
    filter = Whitening.of(linear.residuals, linear.structure)
    for name, line, channel in zip(linear.model.output_names, linear.rows, filter.channels, strict=True):
        power = float(np.mean(linear.residuals[line[0].start : line[-1].stop] ** 2))
        if channel.power < (1.0 - least) * power and power > linear.rounding[name] ** 2:
            return True
    return False
