"""Loads mutated files, and uses what loads: nothing but errors of phugoid may come of it.

    python tests/fuzzing/saved_files.py [number of mutations] [seed] [first]

A mutation is made of seed and number alone, so each can be run again by itself: ``... 1 SEED NUMBER``. Each runs in a
process that may have 1 GB of memory; where it dies, or hangs, the next goes on. Prints counts, and every failure.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1])]

from mutations import mutated_bytes, mutated_json  # noqa: E402

import phugoid as ph  # noqa: E402
from phugoid.writing import sealed  # noqa: E402

MEMORY = 1 << 30
# Kinds of files, and how often each is mutated. `PHUGOID_FUZZ` names one of them, or the ending of a record, such as
# .bin: then no other is.
KINDS = {"model": 28, "fit": 23, "hdf5 fit": 5, "diagnosis": 5, "record": 33, "px4 tables": 3, "journal": 3}
SLOW = 30.0  # s, of a single mutation; a page with its figures takes a second or two

T = 0.1 * np.arange(48)


class Hung(BaseException):
    """A mutation that takes too long."""


# ---------------------------------------------------------------- the files


def lag(late: bool = False, free: bool = False) -> ph.Model:
    m = ph.Model("lag")
    x, v = m.states(x="m", v="m/s")
    (u,) = m.inputs(u="N")
    a, b, tau = m.parameters(
        a=ph.Parameter(1.0, bounds=(0.1, 5.0), unit="1/s", prior=(1.0, 3.0)),
        b=ph.Parameter(0.0, unit="m", per_experiment=True),
        tau=ph.Parameter(0.05, bounds=(0.0, 0.3), unit="s", fixed=not late),
    )
    (c,) = m.constants(c=ph.Constant(0.8, "1/s", "damping"))
    m.dynamics(x=v, v=a * ((m.delay(u, tau) if late else u + 0 * tau) - x) - c * v + 0.01 * ph.sin(x) ** 2)
    m.outputs(x=(x + b, "m"))
    if not (late or free):
        m.initial(v=0.0)
    return m


def record(name: str = "run", late: bool = False) -> ph.Experiment:
    truth = {"a": 1.5, "b": 0.1, "tau": 0.1 if late else 0.0}
    e = ph.Experiment(T, {"u": np.sin(2 * T)}, name=name, units={"u": "N"})
    x = ph.simulate(lag(late), truth, e).outputs["x"] + 0.02 * np.random.default_rng(1).standard_normal(T.size)
    x[3] = np.nan
    return e.with_outputs({"x": x})


def documents(folder: Path) -> dict[str, list[bytes]]:
    """Files to mutate, by kind."""
    found: dict[str, list[bytes]] = {"model": [], "fit": [], "hdf5 fit": [], "diagnosis": []}

    def saved(thing: Any, name: str) -> bytes:
        thing.save(folder / name)
        return (folder / name).read_bytes()

    ways = ph.Collocation(order=3, refine=True), ph.MultipleShooting(3), ph.SingleShooting()
    fits = [ph.estimate(lag(), record(), transcription=way) for way in ways]
    fits.append(ph.estimate(lag(), [record("one"), record("two")], noise=ph.PerExperiment(ph.StudentT())))
    fits.append(ph.estimate(lag(late=True), record(late=True)))
    fits.append(
        ph.estimate(
            lag(free=True), record(), transcription=ph.FilterError("v", terms=2, substeps=1), start={"q_v": 0.1}
        )
    )
    found["fit"] = [saved(fit, "fit.json") for fit in fits]
    found["hdf5 fit"] = [saved(fit, "fit.h5") for fit in fits[:1]]
    found["diagnosis"] = [saved(ph.diagnose(fits[0], list(ph.candidates(lag()))[:4]), "diagnosis.json")]
    late = lag(late=True)
    late.noise(x=ph.StudentT())
    table = ph.Model("table")
    (x,) = table.states("x")
    table.conditions(V="m/s")
    (k,) = table.parameters(k=ph.Parameter(0.5, bounds=(0, 9), transform="log"))
    table.quantities(lift=ph.Table("lift", [0.0, 1.0, 2.0, 4.0], [0.0, 1.0, 1.5, 1.0])(x))
    table.dynamics(x=-k * x**3 + ph.where(x > 1, ph.exp(-x), ph.cos(x)))
    table.outputs(x=x)
    found["model"] = [saved(m, "model.json") for m in (lag(), late, table)]
    return found


def tables(folder: Path) -> dict[str, list[bytes]]:
    """Records as files of every kind that can be written here, by ending."""
    rows = np.column_stack([T, np.sin(2 * T), np.cos(T)])
    text = "t [s],u [N],x [m]\n" + "\n".join(",".join(f"{v:.6g}" for v in row) for row in rows)
    found = {".csv": [text.encode(), text.replace(",", "\t").encode(), text.replace(",", "  ").encode()]}
    import gzip

    found[".csv.gz"] = [gzip.compress(text.encode(), mtime=0)]
    columns = {"t": T, "u": np.sin(2 * T), "x": np.cos(T)}
    with contextlib.suppress(ImportError):
        from scipy.io import savemat

        found[".mat"] = []
        for content in (columns, {"data": columns}, {"m": rows}):
            for compressed in (False, True):
                savemat(folder / "a.mat", content, do_compression=compressed)
                found[".mat"].append((folder / "a.mat").read_bytes())
    with contextlib.suppress(ImportError):
        import h5py

        with h5py.File(folder / "a.h5", "w") as file:
            for name, values in columns.items():
                file[f"run/{name}"] = values
        found[".h5"] = [(folder / "a.h5").read_bytes()]
    with contextlib.suppress(ImportError):
        from pyarrow import parquet, table

        parquet.write_table(table(columns), folder / "a.parquet")
        found[".parquet"] = [(folder / "a.parquet").read_bytes()]
    with contextlib.suppress(BaseException):
        import test_read_ulog

        found[".ulg"] = [test_read_ulog.log()]
    with contextlib.suppress(BaseException):
        import test_read_ardupilot

        found[".bin"] = [test_read_ardupilot.log()]
    return found


def px4_tables() -> dict[str, bytes]:
    """The tables of a PX4 log, by the name of the file."""
    import gzip

    times = [",".join(("timestamp", "timestamp_sample", "x[0]", "x[1]"))]
    times += [f"{1_000_000 + 20_000 * k},{999_000 + 20_000 * k},{0.1 * k:g},{-k}" for k in range(20)]
    text = "\n".join(times).encode()
    servo = b"timestamp,u\n" + b"\n".join(b"%d,%d" % (1_000_000 + 50_000 * k, k) for k in range(9))
    return {
        "log_7_vehicle_gyro_0.csv": text,
        "log_7_vehicle_gyro_1.csv": text[: len(text) // 2].rpartition(b"\n")[0],
        "log_7_vehicle_servo_0.csv.gz": gzip.compress(servo, mtime=0),
    }


def multistart(journal: Path) -> ph.Multistart:
    """A small search for starts whose outcomes are written to a journal; those in it are not run again."""
    m = ph.Model("decay")
    (x,) = m.states("x")
    (k,) = m.parameters(k=ph.Parameter(1.0, bounds=(0.1, 5.0)))
    m.dynamics(x=-k * x)
    m.outputs(x=x)
    e = ph.Experiment(T, {}, {"x": np.exp(-0.7 * T) + 0.01 * np.sin(40 * T)}, name="run")
    with ThreadPoolExecutor(1) as executor:
        return ph.multistart(m, e, starts=[{"k": 0.5}, {"k": 1.0}, {"k": 2.0}], executor=executor, journal=journal)


# ---------------------------------------------------------------- what is done with them


def use_fit(fit: ph.Fit, thorough: bool, folder: Path) -> None:
    for ask in (fit.summary, lambda: repr(fit), lambda: repr(fit.records), lambda: str(fit.parameters)):
        ask()
    _ = fit.as_start(), fit.noise_parameters, fit.converged, fit.model.latex(), str(fit.model)
    attempted(lambda: (fit.correlation.notes, fit.correlation.pairs(0.5)))
    attempted(lambda: fit.derived(twice=2.0 * ph.Expr.symbol(fit.parameters.names[0])))
    attempted(fit.integration_error)
    [r.rms() for r in fit.records]
    fit.save(folder / "again.json")
    ph.load(folder / "again.json")
    if thorough:
        attempted(lambda: fit.report(folder / "page.html"))
        attempted(lambda: ph.estimate(fit.model, fit.experiments, start=fit, transcription=fit.transcription))


def use_model(model: ph.Model, thorough: bool, folder: Path) -> None:
    _ = repr(model), str(model), model.latex(), model.to_json(), model.declared_parameters
    ph.Model.from_json(model.to_json())
    model.check()
    t = np.array([0.0, 1e-3, 2e-3])
    e = ph.Experiment(t, {n: np.zeros(3) for n in model.input_names})
    ph.simulate(model, {n: p.start for n, p in model.declared_parameters.items()}, e)


def use_record(path: Path, random: Random) -> None:
    name = random.choice((None, None, "t", "time"))
    attempted(lambda: repr(ph.read(path, time=name)))
    attempted(lambda: ph.read(path, inputs=["u"], outputs=["x"]).check_for(["u"], ["x"]))


def use_px4_tables(folder: Path, random: Random) -> None:
    name = random.choice((None, None, "timestamp_sample"))
    attempted(lambda: repr(ph.read(folder, time=name)))
    attempted(lambda: ph.read(folder, inputs=["vehicle_servo.u"], outputs=["vehicle_gyro.x[0]"]))


def attempted(ask: Callable[[], Any]) -> None:
    with contextlib.suppress(ph.PhugoidError):
        ask()


class Cases:
    """Mutations by number."""

    def __init__(self, seed: int, folder: Path) -> None:
        self.seed, self.folder, self.only = seed, folder, os.environ.get("PHUGOID_FUZZ", "")
        saved, self.records = documents(folder), tables(folder)
        self.px4 = px4_tables()
        journal = folder / "journal"
        multistart(journal)
        self.journal = journal.read_bytes()
        self.saved = {
            kind: [(raw, json.loads(raw) if raw[:1] == b"{" else None) for raw in raws] for kind, raws in saved.items()
        }

    def run(self, number: int) -> tuple[str, str]:
        """The kind of file, and what came of it: "refused", "used", or "refused when used"."""
        random = Random(self.seed * 1_000_003 + number)
        kind = self.only or random.choices(list(KINDS), list(KINDS.values()))[0]
        if kind == "px4 tables":
            return kind, self._px4_tables(random)
        if kind == "journal":
            return kind, self._journal(random)
        if kind == "record" or kind in self.records:
            ending = random.choice(list(self.records)) if kind == "record" else kind
            path = self.folder / f"record{ending}"
            path.write_bytes(mutated_bytes(random.choice(self.records[ending]), random))
            use_record(path, random)
            return ending, "used"
        raw, document = random.choice(self.saved[kind])
        if document is None or random.random() < 0.15:
            content = mutated_bytes(raw, random)
        else:
            document = mutated_json(document, random)
            # As an earlier release wrote it, without a checksum; with the right one; or with one that is wrong by now.
            way = random.random()
            if way < 0.5 and isinstance(document, dict):
                document.pop("checksum", None)
            elif way < 0.9:
                document = sealed(document)
            content = json.dumps(document).encode("utf-8", "surrogatepass")
        path = self.folder / ("saved.h5" if kind.startswith("hdf5") else "saved.json")
        path.write_bytes(content)
        try:
            found = ph.Model.load(path) if kind == "model" else ph.load(path)
        except ph.PhugoidError as error:
            assert len(str(error)) <= 2000, "a message of more than 2,000 characters"
            return kind, "refused"
        thorough = random.random() < 0.02
        try:
            if kind == "model":
                use_model(found, thorough, self.folder)
            elif kind == "diagnosis":
                _ = found.summary(), repr(found), found.misfit.summary()
                use_fit(found.fit, False, self.folder)
                if thorough:
                    found.report(self.folder / "page.html")
            else:
                use_fit(found, thorough, self.folder)
        except ph.PhugoidError:
            return kind, "refused when used"
        return kind, "used"

    def _px4_tables(self, random: Random) -> str:
        folder = self.folder / "px4"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        wrong = random.choice(list(self.px4))
        for name, content in self.px4.items():
            file = f"{name}{random.choice(('', '', '.gz', '_0.csv'))}" if name == wrong else name
            (folder / file).write_bytes(mutated_bytes(content, random) if name == wrong else content)
        use_px4_tables(folder, random)
        return "used"

    def _journal(self, random: Random) -> str:
        path = self.folder / "journal"
        lines = self.journal.splitlines()
        at = random.randrange(len(lines))
        if random.random() < 0.3:
            content = mutated_bytes(self.journal, random)
        else:
            entry = mutated_json(json.loads(lines[at]), random)
            if at and random.random() < 0.7:
                entry = sealed(entry) if isinstance(entry, dict) else entry
            lines[at] = json.dumps(entry).encode("utf-8", "surrogatepass")
            content = b"\n".join(lines) + b"\n"
        path.write_bytes(content)
        try:
            found = multistart(path)
        except ph.PhugoidError as error:
            assert len(str(error)) <= 2000, "a message of more than 2,000 characters"
            return "refused"
        _ = found.summary(), repr(found)
        return "used"


# ---------------------------------------------------------------- the run


def worker(count: int, seed: int, first: int, state: Path) -> None:
    """Runs mutations, and writes after each what came of it."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    warnings.simplefilter("ignore")
    np.seterr(all="ignore")

    def hung(*_: object) -> None:
        raise Hung

    signal.signal(signal.SIGALRM, hung)
    with tempfile.TemporaryDirectory() as name, open(state, "a", buffering=1) as out:
        cases = Cases(seed, Path(name))
        for number in range(first, first + count):
            out.write(f"{number}\n")
            signal.setitimer(signal.ITIMER_REAL, SLOW)
            try:
                with contextlib.redirect_stdout(io.StringIO()):
                    kind, end = cases.run(number)
            except KeyboardInterrupt:
                raise
            except BaseException as error:
                import traceback

                where = traceback.extract_tb(error.__traceback__)[-1]
                kind, end = (
                    "FAILED",
                    f"{type(error).__name__} at {Path(where.filename).name}:{where.lineno}: {error}"[:300],
                )
            finally:
                signal.setitimer(signal.ITIMER_REAL, 0)
            out.write(f"{json.dumps([kind, end])}\n")
        out.write("done\n")


def run(count: int, seed: int = 0, first: int = 0) -> tuple[Counter[str], dict[int, str]]:
    """Counts by kind and end, and failures by number."""
    failures: dict[int, str] = {}
    counts: Counter[str] = Counter()
    at, end = first, first + count
    while at < end:
        with tempfile.TemporaryDirectory() as name:
            state = Path(name) / "state"
            state.touch()
            process = subprocess.Popen(
                [sys.executable, __file__, "--worker", str(end - at), str(seed), str(at), str(state)],
                env={**os.environ, "RAYON_NUM_THREADS": "2", "MALLOC_ARENA_MAX": "2", "MPLBACKEND": "Agg"},
                stderr=subprocess.PIPE if count > 1 else None,
            )
            said, stalled = b"", False
            size, since = 0, time.monotonic()
            while True:
                try:
                    _, said = process.communicate(timeout=5.0)
                    break
                except subprocess.TimeoutExpired:
                    if state.stat().st_size != size:
                        size, since = state.stat().st_size, time.monotonic()
                    elif time.monotonic() - since > 6 * SLOW:
                        stalled = True
                        process.kill()
            for kind, result in ends(state):
                if kind == "FAILED":
                    failures[at] = result
                counts[f"{kind}: {'failed' if kind == 'FAILED' else result}"] += 1
                at += 1
            if at < end:
                if not state.stat().st_size:
                    raise RuntimeError(f"the worker did not begin: {(said or b'').decode()[-2000:]}")
                failures[at] = "hung" if stalled else f"died ({process.returncode}): {(said or b'').decode()[-300:]}"
                counts["FAILED: died"] += 1
                at += 1
    return counts, failures


def ends(state: Path) -> Iterator[tuple[str, str]]:
    for line in state.read_text().splitlines():
        if line.startswith("["):
            kind, result = json.loads(line)
            yield kind, result


if __name__ == "__main__":
    if sys.argv[1:2] == ["--worker"]:
        worker(*map(int, sys.argv[2:5]), Path(sys.argv[5]))
    else:
        given = [int(a) for a in sys.argv[1:4]] + [10_000, 0, 0][len(sys.argv) - 1 :]
        began = time.monotonic()
        found, failed = run(*given)
        for key in sorted(found):
            print(f"{found[key]:8d}  {key}")
        for number, text in failed.items():
            print(f"{number}: {text}")
        print(f"{given[0]} mutations, seed {given[1]}: {len(failed)} failures in {time.monotonic() - began:.0f} s")
        sys.exit(bool(failed))
