"""Which model a file gives, and what is said of a file that gives none."""

from __future__ import annotations

from pathlib import Path

import pytest
from cli_case import MODEL, run

import phugoid as ph
from phugoid.cli.model_file import load_model, load_source

TWO = MODEL + "\n\nfirst, second = lag(), lag()\n"


def test_a_model_comes_before_what_makes_it(here: Path) -> None:
    (here / "one.py").write_text(MODEL + "\n\nm = lag()\nm.initial(x=0.5)\nalias = m\n")
    assert "x (initial) = 0.5" in str(load_model("one.py"))
    assert "initial" not in str(load_model("one.py:lag"))


def test_functions_that_do_not_say_so_are_not_called(here: Path) -> None:
    (here / "main.py").write_text(MODEL + "\n\ndef main():\n    raise SystemExit('ran')\n")
    assert load_model("main.py").name == "lag"


def test_neighbours_can_be_imported(here: Path) -> None:
    (here / "neighbour_of_model.py").write_text(MODEL)
    (here / "uses.py").write_text("from neighbour_of_model import lag\nm = lag()\n")
    assert load_model("uses.py").name == "lag"


def test_saved_models_and_fits(here: Path) -> None:
    load_model("model.py").save("model.json")
    assert str(load_model("model.json")) == str(load_model("model.py"))
    ph.estimate(load_model("model.py"), ph.read("run1.csv")).save("fit.json")
    assert isinstance(load_source("fit.json"), ph.Fit) and load_model("fit.json").name == "lag"


@pytest.mark.parametrize(
    ("file", "text", "words"),
    [
        ("a.py", "import phugoid as ph\n\nx = 1 / 0\n", "a.py, line 3: ZeroDivisionError: division by zero"),
        ("a.py", "x = (\n", "a.py, line 1: '(' was never closed"),
        ("a.py", "import nothing_of_the_kind\n", "line 1: ModuleNotFoundError"),
        ("a.py", "import sys\nsys.exit(3)\n", "a.py, line 2: SystemExit: 3"),
        ("a.py", "def model():\n    return missing\n", "a.py, line 2: NameError: name 'missing'"),
        ("a.py", "def model():\n    return 3\n", "model() returns a int"),
        ("a.py", "x = 3\n", "defines no phugoid.Model"),
        ("a.py", TWO, "has several models (first, second); choose one, as in a.py:"),
        ("a.py", MODEL.replace("x=-a * x", "z=-a * x"), "a.py, line 10: "),
        ("a.json", "{", "is not complete JSON"),
        ("a.json", "[]", "is not a model saved by phugoid"),
        ("a.json", '{"format": "phugoid-fit", "version": 99}', "version 99"),
        ("a.txt", "x", "a model is a Python file"),
    ],
)
def test_what_is_wrong_with_a_file(here: Path, file: str, text: str, words: str) -> None:
    (here / file).write_text(text)
    done = run("fit", file, "run1.csv")
    assert done.exit_code == 2 and words in done.stderr, done.output
    assert len(done.stderr.splitlines()) <= 3 and "Traceback" not in done.stderr
