"""``phugoid fit``: results, files, and exit codes."""

from __future__ import annotations

import hashlib
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from cli_case import TRUTH, run

import phugoid as ph
from phugoid.solvers import Progress


def test_fit_prints_what_the_library_says(here: Path) -> None:
    done = run("fit", "model.py", "run1.csv", "--save", "fit.json")
    assert done.exit_code == 0, done.output
    loaded = ph.load("fit.json")
    saved = {name: e.value for name, e in loaded.parameters.items()}
    assert all(abs(saved[n] - v) < 5 * loaded.parameters[n].std_error for n, v in TRUTH.items())
    assert loaded.summary().split("parameter")[1] in done.stdout
    assert "Written: fit.json" in done.stdout and "building" not in done.stdout


def test_json_alone_is_on_stdout(here: Path) -> None:
    done = run("fit", "model.py:lag", "run1.csv", "run2.csv", "--json", "--plot", "f.svg", "--fix", "c=0.1")
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found["converged"] and [e["name"] for e in found["experiments"]] == ["run1", "run2"]
    c = found["parameters"]["c"]
    assert (c["value"], c["std_error"], c["fixed"]) == (0.1, None, True)  # NaN is null
    assert found["parameters"]["a"]["unit"] == "1/s" and found["matches"]["x"]["r_squared"] > 0.9
    assert found["written"] == ["f-run1.svg", "f-run2.svg"] and all((here / f).exists() for f in found["written"])


def test_options_reach_the_estimation(here: Path) -> None:
    text = (here / "run1.csv").read_text().replace("t,u,x", "time,stick,x")
    (here / "other.csv").write_text(text)
    named = ["--time", "time", "--rename", "stick=u", "--inputs", "u", "--outputs", "x", "--window", "1,5"]
    done = run("fit", "model.py", "other.csv", *named, "--order", 3, "--start", "a=1,b=1", "--json")
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found["experiments"][0]["samples"] == 41 and "order 3" in found["transcription"]


def test_a_file_without_times_has_a_rate(here: Path) -> None:
    lines = (here / "run1.csv").read_text().splitlines()
    (here / "bare.csv").write_text("\n".join(line.partition(",")[2] for line in lines))
    times = [float(line.partition(",")[0]) for line in lines[1:3]]
    done = run("fit", "model.py", "bare.csv", "--rate", 1.0 / (times[1] - times[0]), "--json")
    assert done.exit_code == 0, done.output
    same = json.loads(run("fit", "model.py", "run1.csv", "--json").stdout)
    assert abs(json.loads(done.stdout)["log_likelihood"] - same["log_likelihood"]) < 1e-3
    assert run("fit", "model.py", "bare.csv", "--rate", 0).exit_code == 2


def test_not_converged_is_exit_code_1(here: Path) -> None:
    done = run("fit", "model.py", "run1.csv", "--iterations", 0)
    assert done.exit_code == 1 and "iteration limit" in done.stdout


def test_a_saved_fit_is_gone_on_from(here: Path) -> None:
    assert run("fit", "model.py", "run1.csv", "--order", 3, "--iterations", 2, "--save", "part.json").exit_code == 1
    before = ph.load("part.json")
    done = run("fit", "part.json", "run1.csv", "--json")
    found = json.loads(done.stdout)
    assert done.exit_code == 0 and "order 3" in found["transcription"]
    assert found["log_likelihood"] > before.log_likelihood
    refined = run("fit", "part.json", "run1.csv", "--refine").stdout
    assert "order 3" in refined and "mesh refinement: tolerance" in refined
    assert "order 5" in json.loads(run("fit", "part.json", "run1.csv", "--json", "--order", 5).stdout)["transcription"]


def test_a_fit_saved_as_hdf5_is_gone_on_from(here: Path) -> None:
    pytest.importorskip("h5py", reason="HDF5 needs h5py")
    assert run("fit", "model.py", "run1.csv", "--order", 3, "--save", "fit.h5").exit_code == 0
    done = run("fit", "fit.h5", "run1.csv", "--json")
    assert done.exit_code == 0 and "order 3" in json.loads(done.stdout)["transcription"]
    done = run("fit", "model.py", "run1.csv", "--save", "fit.mat")
    assert done.exit_code == 2 and "ends in .json, .h5 or .hdf5" in done.output


def test_interruption_prints_the_best_point(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Interrupting(Progress):
        def __call__(self, line: ph.results.Iteration) -> None:
            if line.number == 1:
                raise KeyboardInterrupt

    monkeypatch.setattr("phugoid.solvers.Progress.__call__", Interrupting.__call__)
    done = run("fit", "model.py", "run1.csv", "--save", "fit.json")
    assert done.exit_code == 130 and "interrupted" in done.stdout and ph.load("fit.json").status == "interrupted"


def test_a_result_that_cannot_be_saved_is_shown(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(self: ph.Fit, path: object) -> None:
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(ph.Fit, "save", full)
    done = run("fit", "model.py", "run1.csv", "--save", "fit.json")
    assert done.exit_code == 2 and "fit.json: No space left on device" in done.stderr and "sigma_x" in done.stdout


def test_report_is_one_page_with_everything(here: Path) -> None:
    done = run("fit", "model.py", "run1.csv", "--report", "fit.html")
    assert done.exit_code == 0, done.output
    page = (here / "fit.html").read_text()
    for words in ("<h1>lag</h1>", "Parameters", "Match", "Equations", "run1", "data:image/png;base64", "<math", "1/s"):
        assert words in page
    assert page.count("<section>") == page.count("</section>") and "http" not in re.sub("base64,[^']*", "", page)
    for name in ("model.py", "run1.csv"):
        assert hashlib.sha256((here / name).read_bytes()).hexdigest() in page


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["nothing.py", "run1.csv"], "nothing.py: there is no such file"),
        (["model.py", "nothing.csv"], "nothing.csv"),
        (["model.py:leg", "run1.csv"], "there is no 'leg'. Did you mean 'lag'?"),
        (["model.py", "run1.csv", "--start", "aa=1"], "'aa'"),
        (["model.py", "run1.csv", "--start", "a=x"], "--start a=x: 'x' is not a finite number"),
        (["model.py", "run1.csv", "--start", "a"], "--start: 'a' is not of the form A=B"),
        (["model.py", "run1.csv", "--fix", "d"], "--fix: 'd' is not a parameter"),
        (["model.py", "run1.csv", "--solver", "newtn"], "Did you mean 'newton'?"),
        (["model.py", "run1.csv", "--plot", "f.xyz"], "f.xyz: a figure's file ends in one of"),
        (["model.py", "run1.csv", "--report", "no/f.html"], "there is no folder"),
        (["model.py", "run1.csv", "--window", "3"], "--window: '3' is not of the form T0,T1"),
        (["model.py", "run1.csv", "--order", "1"], "order is a whole number from 2"),
        (["model.py", "run1.csv", "run1.csv"], "run1.csv is given twice"),
    ],
)
def test_bad_input_is_a_line_and_exit_code_2(here: Path, args: list[str], words: str) -> None:
    done = run("fit", *args)
    assert done.exit_code == 2 and words in done.stderr, done.output
    assert "Traceback" not in done.output and done.stdout == ""


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (
            ["--time", "zz"],
            "has no time column 'zz'. There are: t, u, x. Give the name of the one with times, such as --time t, "
            "or --rate RATE",
        ),
        (["--inputs", "zz"], "has no column 'zz' (--inputs)."),
        (["--outputs", "zz"], "has no column 'zz' (--outputs)."),
        (["--rename", "zz=u"], "--rename: there is no column 'zz'"),
        (["word.csv"], "leave the column out by naming --inputs A,B and --outputs A,B"),
    ],
)
def test_errors_of_the_data_name_the_options_of_the_command(here: Path, args: list[str], words: str) -> None:
    (here / "word.csv").write_text("t,u,x\n0,1,2\n1,one,2\n2,1,2\n")
    result = run("fit", "model.py", "run1.csv", *args)
    assert result.exit_code == 2
    assert (
        words in result.stderr
        and "=[" not in result.stderr
        and "=..." not in result.stderr
        and "='" not in result.stderr
    )


def test_debug_shows_the_traceback(here: Path) -> None:
    done = run("fit", "nothing.py", "run1.csv", "--debug")
    assert done.exit_code == 2 and "Traceback" in done.stderr


def test_the_command_in_a_process_of_its_own(here: Path) -> None:
    command = [sys.executable, "-m", "phugoid", "fit", "model.py", "run1.csv", "--json"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["status"] == "converged" and "iteration" in done.stderr
    done = subprocess.run([*command, "--fix", "d"], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (2, "") and done.stderr.splitlines()[-1].startswith("phugoid: --fix")


def test_warnings_are_lines_that_name_options(here: Path) -> None:
    text = (here / "run1.csv").read_text().replace("x", "x [ft]", 1)
    (here / "feet.csv").write_text(text)
    done = run("fit", "model.py", "feet.csv", "--units", "x=m")
    lines = [line for line in done.stderr.splitlines() if "the file states the unit 'ft'" in line]
    assert len(lines) == 1 and lines[0].startswith("phugoid: warning: feet.csv, column 'x'")
    assert "--units x=m replaces it without converting the numbers; to convert them give --convert" in lines[0]
    assert "UserWarning" not in done.stderr


def test_help_names_values_and_fits_the_line(here: Path) -> None:
    for command in ("fit", "validate", "diagnose", "simulate", "petab", "example"):
        text = run(command, "--help").stdout
        assert "<" not in text.replace("<=", "") and "list[" not in text, command
    listed = run("--help").stdout
    assert "..." not in listed.partition("Commands:")[2]
