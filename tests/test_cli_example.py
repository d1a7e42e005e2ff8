"""``phugoid example``: what it writes can be fitted, and gives back the truth."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Annotated, Optional

import pytest
from cli_case import run

from phugoid.cli.example import EXAMPLES
from phugoid.cli.results import annotations_of


@pytest.mark.parametrize("name", EXAMPLES)
def test_its_commands_run(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    done = run("example", name, "--out", "try", "--json")
    assert done.exit_code == 0, done.output
    commands = [shlex.split(line)[1:] for line in json.loads(done.stdout)["commands"]]
    page = (tmp_path / "try" / f"{name}.md").read_text(encoding="utf-8")
    assert all(shlex.join(["phugoid", *c]) in page for c in commands) and "## What to look for" in page
    assert [c[0] for c in commands] == ["fit", "validate", "simulate", "diagnose"]
    fitted = run(*commands[0], "--json")
    assert fitted.exit_code == 0, fitted.output
    parameters = json.loads(fitted.stdout)["parameters"]
    for parameter, truth in EXAMPLES[name].parameters.items():
        assert abs(parameters[parameter]["value"] - truth) < 4 * parameters[parameter]["std_error"]
    for command in commands[1:3]:
        done = run(*command)
        assert done.exit_code == 0, done.output


def test_list_and_files_that_are_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for listed in (run("example"), run("example", "--list")):
        lines = listed.stdout.split("\n\n")[0].splitlines()
        assert listed.exit_code == 0 and [line.split()[0] for line in lines] == list(EXAMPLES)
    assert run("example", "unstable").exit_code == 0
    again = run("example", "unstable")
    assert again.exit_code == 2 and "would be overwritten; give --force" in again.stderr
    assert run("example", "unstable", "--force").exit_code == 0
    wrong = run("example", "hfb")
    assert wrong.exit_code == 2 and "there is no example 'hfb'. Did you mean 'hfb320'?" in wrong.stderr


def test_an_argument_stays_one_where_python_makes_it_optional() -> None:
    """Make it optional, as Python 3.10 does with the default None."""

    def example(name: Annotated[str | None, "argument"] = None, other: int = 0) -> None: ...

    plain = annotations_of(example)
    assert plain == {"name": Annotated[str | None, "argument"], "other": int, "return": type(None)}
    example.__annotations__["name"] = Optional[Annotated[str | None, "argument"]]  # noqa: UP045
    assert annotations_of(example) == plain
