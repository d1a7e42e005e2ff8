"""What runs on a worker: the sums over one part of a fleet, with its records and the paths of their states."""

from __future__ import annotations

import pickle
import socket
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

import phugoid._core as _core

from ..data.experiment import Experiment
from ..errors import PhugoidError
from ..estimation import estimate
from ..initialisation import spread
from ..modelling.model import Model
from ..modelling.noise import Noise
from ..transcription import Collocation, records_of
from .runs import Run, checked

__all__ = ["Part", "Spec", "Trial", "first_estimate", "work"]

_Array = NDArray[np.float64]

# Records that are evaluated side by side by the threads of a worker.
_BATCH = 32


@dataclass(frozen=True)
class Spec:
    """What all workers need to know: model, noise, transcription, start, spreads of the outputs, and the bytes that the
    records of one process may take."""

    model: Model
    noise: Noise
    transcription: Collocation
    start: Mapping[str, float]
    spreads: Sequence[float]
    memory: int


@dataclass(frozen=True)
class Part:
    """Some records of the fleet, which one task evaluates; the first part counts the priors of shared parameters."""

    index: int
    runs: Sequence[Run | Experiment]


@dataclass(frozen=True)
class Trial:
    """Values of the shared variables, None to ask for their names; names of records that are left out; whether each
    record is to be described; the covariance of the variables, to ask for estimates instead; and mean and standard
    deviation of the populations that records' own parameters are drawn from; and whether the Hessian is to be that of
    Gauss and Newton."""

    at: _Array | None = None
    without: frozenset[str] = frozenset()
    detailed: bool = False
    covariance: _Array | None = None
    populations: tuple[tuple[str, float, float], ...] = ()
    gauss_newton: bool = False


@dataclass
class _Held:
    """A part that this process knows."""

    spec: Spec
    part: Part
    share: Any
    lock: threading.Lock = field(default_factory=threading.Lock)
    records: dict[str, Any] = field(default_factory=dict)
    first: Any = None  # the first record that could be read
    variables: list[Any] = field(default_factory=list)


_HELD: dict[tuple[str, int], _Held] = {}
_LOCK = threading.Lock()
_KEPT_BYTES = [0]  # of records, of all parts


def work(
    key: str, payload: bytes | None, index: int, part: bytes | None, trial: Trial, version: str, ticket: int
) -> Mapping[str, Any] | None:
    """Do a task; return None where this process does not know the part and was not sent it.

    ``ticket`` makes every task differ: Dask takes equal ones for the same, and answers from memory.
    """
    if version != _core.__version__:
        return {"wrong": f"has version {_core.__version__} of phugoid, not {version}", "worker": _here()}
    with _LOCK:
        held = _HELD.get((key, index))
        if held is None:
            if payload is None or part is None:
                return None
            for other in [k for k in _HELD if k[0] != key]:
                _forget(_HELD.pop(other))
            held = _HELD[key, index] = _made(pickle.loads(payload), pickle.loads(part))
    with held.lock:
        return {**_answer(held, trial), "worker": _here()}


def _here() -> str:
    return socket.gethostname()


def _made(spec: Spec, part: Part) -> _Held:
    mesh = spec.transcription
    noise = spec.noise.saved(spec.model.output_names)
    grid = ("uniform", int(mesh.segments), None) if isinstance(mesh.segments, int) else ("samples", mesh.substeps, None)
    share = _core.Share(spec.model._core, noise, (mesh.order, grid), mesh.threads, list(spec.spreads), part.index == 0)
    return _Held(spec, part, share)


def _forget(held: _Held) -> None:
    _KEPT_BYTES[0] -= sum(_size(r) for r in held.records.values())


def _size(record: Any) -> int:
    _, t, inputs, outputs, *_ = record
    return sum(a.nbytes for a in (t, *inputs, *outputs))


def _answer(held: _Held, trial: Trial) -> Mapping[str, Any]:
    unread: dict[str, str] = {}
    total: dict[str, Any] = {}
    if held.first is not None:
        for population in trial.populations:
            held.share.population(*population)
    batch: list[Any] = []

    def evaluate() -> None:
        assert trial.at is not None
        found = held.share.evaluate(batch, trial.at, trial.detailed, trial.gauss_newton)
        for name, value in found.items():
            total[name] = total[name] + value if name in total else value
        batch.clear()

    for run in held.part.runs:
        if run.name in trial.without:
            continue
        try:
            record = _record(held, run)
            if held.first is None:
                held.variables = held.share.variables(record, list(held.spec.start.items()))
                held.first = record
                for population in trial.populations:
                    held.share.population(*population)
        except PhugoidError as error:
            unread[run.name] = str(error)
            continue
        if trial.at is None or trial.covariance is not None:
            break
        batch.append(record)
        if len(batch) == _BATCH:
            evaluate()
    if trial.at is not None and trial.covariance is None and (batch or not total) and held.first is not None:
        evaluate()
    if trial.covariance is not None and held.first is not None:
        return {"report": held.share.report(held.first, trial.at, trial.covariance.ravel())}
    failures = {name: (text, of_data) for name, text, of_data in total.pop("failures", [])}
    failures |= {name: (text, True) for name, text in unread.items()}
    return {**total, "failures": failures, "variables": held.variables}


def _record(held: _Held, run: Run | Experiment) -> Any:
    """Return a record as the core takes it; it is kept as long as all that are kept take no more than their share of
    memory."""
    if run.name in held.records:
        return held.records[run.name]
    model = held.spec.model
    experiment = run.load(model) if isinstance(run, Run) else checked(run, model)
    (record,) = records_of(model, [experiment])
    record = (run.name, *record[1:])
    size = _size(record)
    if _KEPT_BYTES[0] + size <= held.spec.memory:
        _KEPT_BYTES[0] += size
        held.records[run.name] = record
    return record


def first_estimate(
    payload: bytes, runs: Sequence[Run | Experiment], start: Mapping[str, float] | None, version: str, ticket: int
) -> Mapping[str, Any]:
    """Estimate from a few records, where all others are to start: values by name, and the spreads of the outputs.

    With a ``start`` only the spreads are computed.
    """
    if version != _core.__version__:
        return {"wrong": f"has version {_core.__version__} of phugoid, not {version}", "worker": _here()}
    spec: Spec = pickle.loads(payload)
    experiments, unread = [], {}
    for run in runs:
        try:
            experiments.append(run.load(spec.model) if isinstance(run, Run) else checked(run, spec.model))
        except PhugoidError as error:
            unread[run.name] = str(error)
    found: dict[str, Any] = {"unread": unread, "status": "given", "message": "", "worker": _here()}
    if not experiments:
        return found
    found["spreads"] = [spread(experiments, name) for name in spec.model.output_names]
    if start is None:
        fit = estimate(
            spec.model, experiments, transcription=spec.transcription, noise=spec.noise, start=dict(spec.start)
        )
        names = {*spec.model.parameter_names, *spec.noise.names(spec.model.output_names)}
        names |= {f"sigma_{n}" for n in spec.model.output_names}
        fixed = {name for name, e in fit.parameters.items() if e.fixed}
        values = fit.as_start(spec.noise)
        start = {name: value for name, value in values.items() if name in names - fixed}
        found |= {"status": fit.status, "message": fit.message}
        own = [n for n, p in spec.model.declared_parameters.items() if p.per_experiment]
        found["own"] = {n: [e.value for e in fit.parameters.values() if e.name.startswith(f"{n}[")] for n in own}
    return {**found, "start": dict(start)}
