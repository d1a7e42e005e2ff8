"""Estimates from many starts, and their journal: one line of JSON for each finished start, so that a run can go on.

The first line is a header that says which problem the journal belongs to. A line is written whole and at once; what a
crash leaves of the last one is cut off when the journal is opened again. A journal serves one run at a time.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, nullcontext, suppress
from dataclasses import fields, replace
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import phugoid._core as _core

from ..data.experiment import Experiment, as_experiments, completed
from ..errors import DataError, ModelError, OptionError, check_progress, whole
from ..estimation.starts import Draw, Given, Outcome, Problem, Range, Uniform, given, plain, uniform
from ..estimation.workers import Crew, Watch, collect
from ..filter_error import FilterError
from ..fit_result import FitResult
from ..modelling.model import Model
from ..modelling.noise import Noise, not_noise
from ..saving import files as io
from ..solvers import limited
from ..transcription import Collocation, MultipleShooting, SingleShooting, Transcription
from ..writing import sealed, unsealed
from . import Multistart

if TYPE_CHECKING:
    from concurrent.futures import Executor

__all__ = [
    "FORMAT",
    "VERSION",
    "Journal",
    "Multistart",
    "fingerprint",
    "multistart",
]


FORMAT = "phugoid-multistart"
VERSION = 1

Starts = Uniform | Given


def fingerprint(problem: Problem, starts: Starts) -> dict[str, Any]:
    """Return all that determines an outcome, in parts that a message can name.

    Texts and numbers stand as they are, the model and the data as hashes. The number of threads, where equations stand
    in the user's files, and data that the model does not use are left out.
    """
    document = json.loads(problem.model._equations_to_json())
    for group in document.values():
        for entry in group if isinstance(group, list) else ():
            entry.pop("source", None)
    mesh = problem.transcription
    drawn = starts.ranges if isinstance(starts, Uniform) else None
    parts = {
        "model": _hash(json.dumps(document, sort_keys=True).encode()),
        "data": {e.name: _data_hash(problem, e) for e in problem.experiments},
        "transcription": repr(mesh if isinstance(mesh, FilterError) else replace(mesh, threads=0)),
        "noise": problem.noise.to_dict(),
        "solver": "default" if problem.solver is None else repr(problem.solver),
        "start": {name: _brief(value) for name, value in problem.start.items()},
        "ranges": {name: list(pair) for name, pair in drawn.items()} if drawn else "none: starts were given",
        "seed": starts.seed if isinstance(starts, Uniform) else "none: starts were given",
    }
    return dict(json.loads(_line(parts)))


class Journal:
    """Finished starts in a file, read when it is opened and appended to from then on.

    outcomes  number of the start -> what came of it, as read.
    warnings  why starts finished since are not in the file, in words; empty where all are.

    Raises DataError where the file cannot be used: it is not a journal, it is that of another problem (the message says
    what differs), a line within is damaged, or it cannot be read or written.
    """

    def __init__(self, path: str | os.PathLike[str], problem: Problem, starts: Starts) -> None:
        self.path = Path(path)
        self.warnings: tuple[str, ...] = ()
        header = {"format": FORMAT, "version": VERSION, "phugoid": _core.__version__, **fingerprint(problem, starts)}
        first = _line(header)
        try:
            text = self.path.read_bytes() if self.path.exists() else b""
            lines, sound = self._whole_lines(text, first)
            self.outcomes = self._read(lines, header, starts)
            # Without a buffer, which would be written once more when the file is closed.
            self._file = open(self.path, "ab", buffering=0)  # noqa: SIM115
            self._file.truncate(sound)
            self._sound = sound
            if not lines:
                self._write(first)
        except OSError as error:
            raise DataError(f"journal {self.path}: cannot be read and written ({error.strerror})") from error

    def append(self, outcome: Outcome) -> None:
        """Write one finished start; it is in the file when this returns.

        Where the file cannot be written, as on a full disk, the run goes on without it, and ``warnings`` says so.
        """
        if self.warnings:
            return
        entry = {f.name: getattr(outcome, f.name) for f in fields(outcome)}
        # Arrays (paths of states) are identified by their hash, as all of the start is.
        entry["start"] = {name: value for name, value in outcome.start.items() if np.ndim(value) == 0}
        line = _line(sealed(io._plain({**entry, "start_hash": _start_hash(outcome.start)})))
        try:
            self._write(line)
        except OSError as error:
            self.warnings = (
                f"journal {self.path}: cannot be written ({error.strerror}); the starts from number {outcome.index} on "
                "are in this result alone",
            )
            with suppress(OSError):
                self._file.truncate(self._sound)  # half a line

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _write(self, line: bytes) -> None:
        left = memoryview(line)
        while left:
            left = left[self._file.write(left) :]
        self._sound += len(line)

    def _whole_lines(self, text: bytes, first: bytes) -> tuple[list[bytes], int]:
        """Return the lines that are complete, and their number of bytes."""
        sound = text.rfind(b"\n") + 1
        if not sound and not first.startswith(text):
            raise self._foreign("its first line is not a header")
        return text[:sound].splitlines(), sound

    def _read(self, lines: list[bytes], header: Mapping[str, Any], starts: Starts) -> dict[int, Outcome]:
        if not lines:
            return {}
        there = self._parsed(lines[0])
        if not isinstance(there, dict) or there.get("format") != FORMAT:
            raise self._foreign("its first line is not a header")
        if there.get("version") != VERSION:
            raise self._foreign(f"it has version {there.get('version')!r} of the format instead of {VERSION}")
        parts = [key for key in header if key not in ("format", "version", "phugoid")]
        differing = [text for key in parts for text in _differences(key, there.get(key), header[key])]
        if differing:
            raise DataError(
                f"journal {self.path}: belongs to another problem: {'; '.join(differing)}. "
                "Name another file, or delete this one"
            )
        outcomes: dict[int, Outcome] = {}
        names: set[str] = set()
        for number, line in enumerate(lines[1:], 2):
            try:
                entry = self._parsed(line)
                entry = unsealed(entry, "")
                mark = entry.pop("start_hash")
                outcome = _outcome(entry)
                start = _start(starts, outcome.index)
                if outcome.parameters and {*outcome.parameters} != names:
                    if names:
                        raise ValueError("parameters are the same in all outcomes")
                    names = {*outcome.parameters}
            except (ArithmeticError, AttributeError, KeyError, TypeError, ValueError):
                raise DataError(f"journal {self.path}: line {number} is damaged; delete the line") from None
            if start is None:
                continue  # beyond the starts given now
            if _start_hash(start) != mark:
                raise DataError(
                    f"journal {self.path}: belongs to another problem: start {outcome.index} differs. "
                    "Name another file, or delete this one"
                )
            outcomes.setdefault(outcome.index, replace(outcome, start=start))
        return outcomes

    def _parsed(self, line: bytes) -> Any:
        try:
            return json.loads(line)
        except (RecursionError, ValueError):
            return None

    def _foreign(self, why: str) -> DataError:
        return DataError(f"{self.path}: is not a journal of a multistart ({why}); name another file")


def _outcome(entry: Mapping[str, Any]) -> Outcome:
    """Return the outcome of a line's entries; TypeError or ValueError where one is not of its kind."""
    known = {f.name for f in fields(Outcome)}
    if not known.issuperset(entry) or not {"index", "start", "status"}.issubset(entry):
        raise TypeError("other entries than an outcome has")

    def numbers(name: str) -> dict[str, float]:
        return {str(key): io.to_float(value) for key, value in dict(entry.get(name, {})).items()}

    def whole(name: str) -> int:
        value = entry.get(name, 0)
        if type(value) is not int or value < 0:
            raise ValueError(f"{name} is not a whole number")
        return value

    texts = [entry["status"], entry.get("message", "")]
    if not all(isinstance(text, str) for text in texts):
        raise TypeError("status and message are texts")
    parameters, std_errors = numbers("parameters"), numbers("std_errors")
    if {*parameters} != {*std_errors}:
        raise ValueError("each parameter has a standard error")
    return Outcome(
        whole("index"),
        numbers("start"),
        texts[0],
        texts[1],
        io.to_float(entry.get("log_likelihood")),
        parameters,
        std_errors,
        whole("iterations"),
        io.to_float(entry.get("time", 0.0)),
    )


def _start(starts: Starts, index: int) -> dict[str, Any] | None:
    if isinstance(starts, Given) and not 0 <= index < len(starts.starts):
        return None
    return starts(index)


def _line(obj: Mapping[str, Any]) -> bytes:
    return json.dumps(io._plain(obj), ensure_ascii=False, allow_nan=False).encode() + b"\n"


def _hash(data: bytes) -> str:
    return sha256(data).hexdigest()[:16]


def _brief(value: Any) -> Any:
    return _hash(np.asarray(value, dtype="<f8").tobytes()) if np.ndim(value) else float(value)


def _start_hash(start: Mapping[str, Any]) -> str:
    return _hash(json.dumps({name: _brief(value) for name, value in start.items()}, sort_keys=True).encode())


def _data_hash(problem: Problem, experiment: Any) -> str:
    channel: list[tuple[str, Callable[[str], Any]]] = []
    channel += [(name, experiment.input) for name in problem.model.input_names]
    channel += [(name, experiment.output) for name in problem.model.output_names]
    whole = sha256(f"{experiment.interpolation} {[name for name, _ in channel]}".encode())
    own = [part for pair in experiment.own_samples(problem.model.input_names).values() for part in pair]
    for values in (experiment.t, *(get(name) for name, get in channel), *own):
        # Any NaN is as good as another.
        whole.update(np.where(np.isnan(values), np.nan, values).astype("<f8").tobytes())
    return whole.hexdigest()[:16]


def _differences(key: str, there: Any, here: Any) -> list[str]:
    """Describe which parts differ; hashes are not shown."""
    if there == here:
        return []
    if key == "model":
        return ["the model differs"]
    if isinstance(there, dict) and isinstance(here, dict):
        names = [*here, *(name for name in there if name not in here)]
        changed = [name for name in names if there.get(name) != here.get(name)]
        if key == "data":
            return [f"the data of experiment '{name}' differ" for name in changed]
        shown = [f"'{name}' is {_shown(there, name)} there and {_shown(here, name)} here" for name in changed]
        return [f"{key}: {text}" for text in shown]
    return [f"{key} is {there} there and {here} here"]


def _shown(group: Mapping[str, Any], name: str) -> str:
    return str(group[name]) if name in group else "absent"


def multistart(
    model: Model,
    data: Experiment | Sequence[Experiment],
    ranges: Mapping[str, Range] | None = None,
    *,
    n: int | None = None,
    seed: int = 0,
    starts: Sequence[Mapping[str, Any]] | Draw | None = None,
    executor: Executor | None = None,
    journal: str | os.PathLike[str] | None = None,
    progress: bool | Watch = False,
    transcription: Transcription | None = None,
    noise: Noise | None = None,
    start: Mapping[str, Any] | FitResult | None = None,
    solver: Any = None,
    time_limit: float | None = None,
) -> Multistart:
    """Estimate from many starts, to find the optima and how many starts reach the best one.

    ``ranges``: name -> (low, high) of parameters, of ``sigma_<output>`` and of states, in their units; each start
    draws from all of them, uniformly; of a parameter with ``transform="log"`` it draws the logarithm. A state drawn is
    constant in time; a standard deviation above the spread of the measurements starts there, as in `estimate`.
    ``n``: how many starts, 1000 by default. Start i has random numbers of its own, from ``seed`` and i: neither n,
    nor the order, nor the executor changes it.
    ``starts``: instead of ranges, the starts themselves, name -> value each (all of them unless ``n`` says fewer), or
    a function (i, random) -> start, of the start's number and its own `numpy.random.Generator`.
    ``start``: values for all starts, of what they do not give themselves; as in `estimate`, but of a fit only the
    parameters.
    ``transcription``, ``noise``, ``solver``: as in `estimate`, but that the default solver makes no regression on
    the measured states first: it would lead all starts of a model linear in its parameters to one point.
    ``executor``: None runs in this process. Otherwise any `concurrent.futures.Executor`, such as a
    ProcessPoolExecutor, or ``client.get_executor()`` of a Dask client; a start runs on one thread there, unless
    the transcription says how many. Take processes rather than threads: Python's lock is held for part of the work.
    ``journal``: a file to which each finished start is written. The same call with the same journal runs only what
    is missing (also after ``n`` was raised). One run at a time. Where it can no longer be written, as on a full disk,
    the run goes on without it, and a warning of the result says so.
    ``progress``: True shows a bar; a function is called with each `Outcome` as it comes in.
    ``time_limit``: in seconds, of all starts together; that of a ``solver`` is of each.

    What goes wrong in a run is an outcome, not an error of the whole. If a worker dies, its starts run again, in a
    fresh pool where the old one is broken, or in this process where there can be none (a warning of the result says
    so). A start that loses its worker time and again (three times in a pool), at last running alone, is given up with
    status "killed".
    Ctrl-C returns the outcomes so far, with status "interrupted", and the time limit with status "time limit"; runs
    under way in an executor are not waited for.

    Raises ModelError, DataError or OptionError for what cannot be right, whatever the start, and DataError for a
    journal of another problem.

    >>> import numpy as np
    >>> m = Model("known by its square")
    >>> (x,) = m.states("x")
    >>> (a,) = m.parameters("a")
    >>> m.dynamics(x=1 - x)
    >>> m.outputs(y=a**2 * x)
    >>> t = np.linspace(0, 5, 30)
    >>> e = Experiment(t, outputs={"y": 4 * (1 - np.exp(-t)) + 0.01 * np.sin(40 * t)})
    >>> result = multistart(m, e, {"a": (-5, 5)}, n=8)
    >>> sorted(round(o.parameters["a"]) for o in result.optima)
    [-2, 2]
    """
    begin = time.perf_counter()
    deadline = limited("multistart", time_limit)
    problem = _problem(model, data, transcription, noise, start, solver)
    if n is not None:
        whole("multistart: n", n, 1)
    whole("multistart: seed", seed, 0)
    check_progress("multistart", progress)
    if (ranges is None) == (starts is None):
        raise OptionError("multistart: give either ranges to draw from, or starts")
    if starts is None:
        total = 1000 if n is None else int(n)
        plan: Any = uniform(problem, ranges, int(seed))
    else:
        plan = given(problem, starts, n, int(seed))
        total = len(plan.starts)

    crew = Crew(executor, problem)
    with nullcontext() if journal is None else closing(Journal(journal, problem, plan)) as book:
        known = book.outcomes if book else {}
        done = {index: outcome for index, outcome in known.items() if index < total}
        missing = ((i, plan(i)) for i in range(total) if i not in known)
        keep = book.append if book else None
        with deadline.in_force():
            found = collect(crew, missing, progress, problem.model.name, total, known=done, keep=keep, best=True)
    return Multistart(
        outcomes=tuple(found.values()),
        n=total,
        status="complete" if len(found) == total else deadline.ended(),
        problem=problem,
        warnings=crew.warnings + (book.warnings if book else ()),
        time=time.perf_counter() - begin,
    )


def _problem(model: Any, data: Any, transcription: Any, noise: Any, start: Any, solver: Any) -> Problem:
    """Return what all starts share, as far as it can be checked before the first run."""
    if not isinstance(model, Model):
        raise ModelError(f"multistart: the first argument is a Model, not a {type(model).__name__}")
    model.check()
    experiments = tuple(completed(as_experiments(data, "estimate"), model.output_names))
    transcription = transcription or Collocation()
    if not isinstance(transcription, (Collocation, MultipleShooting, SingleShooting)):
        raise OptionError(
            f"multistart: transcription is a Collocation, MultipleShooting or SingleShooting, not {transcription!r}"
        )
    noise = noise or model.noise_model
    if not isinstance(noise, Noise):
        raise OptionError(f"multistart: {not_noise(noise)}")
    if not isinstance(start, (Mapping, FitResult, type(None))):
        raise OptionError(f"multistart: start holds values by name, or is a fit, not {start!r}")
    common = start.as_start() if isinstance(start, FitResult) else start or {}
    return Problem(model, experiments, transcription, noise, solver, {n: plain(v) for n, v in common.items()})
