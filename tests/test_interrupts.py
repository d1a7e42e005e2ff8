"""Ctrl-C, and Ctrl-C once more while what is known is put together: signals, in a process of their own."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals as POSIX has them")

# Of every script: a fit of the lag of `cli_case`, and Ctrl-C.
HEAD = """
import json, math, os, signal, sys, time
import phugoid as ph
from phugoid.cli.model_file import load_model

model, data = load_model("model.py"), ph.read("run1.csv")

def press():
    os.kill(os.getpid(), signal.SIGINT)

def at(number):
    def watch(line):
        if line.number == number:
            press()
    return watch

class Pressing(ph.Newton):
    # After the last iteration, before standard errors are computed, Ctrl-C is pressed.

    def solve(self, *rest, **named):
        found = super().solve(*rest, **named)
        press()
        return found

def tell(fit):
    values = {n: e.value for n, e in fit.parameters.items()}
    known = [math.isfinite(e.std_error) for e in fit.parameters.values()]
    print(json.dumps({"status": fit.status, "values": values, "known": known, "warnings": list(fit.warnings)}))
"""


def run(script: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", HEAD + textwrap.dedent(script), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=300)


def told(script: str) -> Any:
    done = run(script)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_a_second_ctrl_c_leaves_out_the_standard_errors(here: Path) -> None:
    once = told("tell(ph.estimate(model, data, progress=at(2)))")
    twice = told("tell(ph.estimate(model, data, progress=at(2), solver=Pressing()))")
    assert once["status"] == twice["status"] == "interrupted"
    assert all(once["known"]) and not any(twice["known"])
    assert twice["values"] == once["values"]
    assert "interrupted: there are no standard errors" in twice["warnings"][0]
    assert not any("standard errors" in w for w in once["warnings"])


def test_signals_of_another_process_do_the_same(here: Path) -> None:
    script = """
    def watch(line):
        print("iteration", line.number, flush=True)
        if line.number == 2:
            until = time.time() + 60
            while not stop and time.time() < until:
                time.sleep(0.01)
    class Waiting(ph.Newton):
        def solve(self, *rest, **named):
            found = super().solve(*rest, **named)
            print("errors", flush=True)
            until = time.time() + 60
            while signal.getsignal(signal.SIGINT) is not signal.default_int_handler and time.time() < until:
                time.sleep(0.01)
            return found
    stop = []
    import threading
    threading.Thread(target=lambda: stop.append(sys.stdin.readline()), daemon=True).start()
    tell(ph.estimate(model, data, progress=watch, solver=Waiting()))
    """
    command = [sys.executable, "-c", HEAD + textwrap.dedent(script)]
    child = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert child.stdin is not None and child.stdout is not None
    last = ""
    for line in child.stdout:
        last = line
        if line == "iteration 2\n":
            os.kill(child.pid, signal.SIGINT)
            child.stdin.write("go on\n")
            child.stdin.flush()
        if line == "errors\n":
            os.kill(child.pid, signal.SIGINT)
    assert child.wait(60) == 0
    found = json.loads(last)
    assert found["status"] == "interrupted" and not any(found["known"])


def test_ctrl_c_while_standard_errors_are_computed_keeps_the_optimum(here: Path) -> None:
    whole = told("tell(ph.estimate(model, data))")
    found = told("tell(ph.estimate(model, data, solver=Pressing()))")
    assert whole["status"] == "converged" and all(whole["known"])
    # Interrupted: whoever runs many must not go on.
    assert found["status"] == "interrupted" and not any(found["known"]) and found["values"] == whole["values"]


def test_a_third_is_as_ever_and_so_is_one_afterwards(here: Path) -> None:
    third = """
    from phugoid.estimation import core
    def record(*rest):
        press()
        press()
    core._record = record
    ph.estimate(model, data, progress=at(2))
    """
    done = run(third)
    assert done.returncode != 0 and "KeyboardInterrupt" in done.stderr
    after = """
    ph.estimate(model, data, progress=at(2), solver=Pressing())
    try:
        press()
        time.sleep(5)
    except KeyboardInterrupt:
        print(json.dumps(signal.getsignal(signal.SIGINT) is signal.default_int_handler))
    """
    assert told(after) is True


def test_a_handler_of_the_users_own_is_left_alone(here: Path) -> None:
    script = """
    seen = []
    def mine(number, frame):
        seen.append(number)
        raise KeyboardInterrupt
    signal.signal(signal.SIGINT, mine)
    fit = ph.estimate(model, data, progress=at(2))
    print(json.dumps([fit.status, len(seen), signal.getsignal(signal.SIGINT) is mine]))
    """
    assert told(script) == ["interrupted", 1, True]


@pytest.mark.parametrize(
    ("call", "count"),
    [
        ('ph.multistart(model, data, {"a": (0.5, 3)}, n=6, progress=watch)', "len(r.outcomes)"),
        ("ph.estimate(model, data).bootstrap(6, progress=watch)", "len(r.estimates)"),
        ('ph.estimate(model, data).profile(["a", "b"], progress=watch)', "sum(p.values.size > 1 for p in r.values())"),
    ],
)
def test_many_runs_keep_what_is_done(here: Path, call: str, count: str) -> None:
    script = f"""
    from phugoid.estimation.workers import Crew
    seen = []
    def watch(outcome):
        seen.append(outcome)
        if len(seen) == 2:
            press()
            time.sleep(5)
    dismiss = Crew._dismiss
    def dismissed(self, wait):
        press()
        return dismiss(self, wait)
    Crew._dismiss = dismissed
    r = {call}
    print(json.dumps([r.status, int({count})]))
    """
    status, there = told(script)
    assert status == "interrupted" and there == (1 if "profile" in call else 2)


def test_a_diagnosis_tells_what_is_known(here: Path) -> None:
    script = """
    from phugoid.discrepancy.search import refit_cache
    fit = ph.estimate(model, data)
    real = refit_cache.Scan
    def scan(*rest):
        press()
        return real(*rest)
    refit_cache.Scan = scan
    d = ph.diagnose(fit)
    d.report("missing.html")
    channels = list(d.misfit.channels)
    print(json.dumps([d.interrupted, len(d.ranking), d.found, channels, d.summary(), len(d.figures())]))
    """
    interrupted, ranked, found, channels, summary, figures = told(script)
    assert interrupted and not ranked and not found and channels == ["x"] and figures == 1
    assert "The search was interrupted before it had a result" in summary and "candidates were scanned" in summary
    assert "interrupted before" in (here / "missing.html").read_text(encoding="utf-8")


COMMAND = """
from phugoid.cli import commands
from phugoid.result import Fit
from phugoid.cli import app
def report(self, *rest, **more):
    press()
    time.sleep(5)
Fit.report = report
if sys.argv[2] == "twice":
    def summary(self):
        press()
        time.sleep(5)
    Fit.summary = summary
app(["fit", "model.py", "run1.csv", "--save", "fit.json", "--report", "fit.html", *sys.argv[3:]])
"""


@pytest.mark.parametrize("times", ["once", "twice"])
def test_the_command_line_prints_and_saves_the_point(here: Path, times: str) -> None:
    done = run(COMMAND, "command", times)
    assert done.returncode == 130 and "phugoid: interrupted" in done.stderr
    assert not (here / "fit.html").exists() and (here / "fit.json").exists()
    saved = told('tell(ph.load("fit.json"))')
    lines = [line.split() for line in done.stdout.splitlines() if line.strip().startswith("a ")]
    number = lines[0][2 if times == "twice" else 1]
    assert float(number) == pytest.approx(saved["values"]["a"], rel=1e-3)


def test_the_command_line_gives_json_too(here: Path) -> None:
    done = run(COMMAND, "command", "once", "--json")
    assert done.returncode == 130
    document = json.loads(done.stdout[done.stdout.index("{") :])
    assert document["status"] == "converged" and document["written"] == ["fit.json"]


def test_a_validation_and_bands(here: Path) -> None:
    script = """
    fit, other = ph.estimate(model, data), ph.read("run2.csv")
    done = []
    check = fit.validate(other, progress=lambda line: (done.append(line.number), press()))
    bands = "none"
    try:
        bands = fit.prediction_bands(other, progress=lambda line: press())
    except KeyboardInterrupt:
        bands = "interrupted"
    again = []
    there = fit.prediction_bands(other, progress=again.append)
    print(json.dumps({"status": check.status, "warnings": list(check.warnings), "iterations": len(done),
                      "bands": bands, "again": len(again), "named": list(there.model)}))
    """
    found = told(script)
    assert found["status"] == "interrupted" and "(interrupted)" in found["warnings"][0]
    assert found["bands"] == "interrupted" and 0 < found["iterations"] < found["again"]
    assert found["named"]
