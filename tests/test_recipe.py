"""The recipe for conda-forge and the citation say what the package's own metadata say."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

import pages
import pytest
import try_wheel

RECIPE, CITATION, CARGO, PYPROJECT = (
    (pages.ROOT / name).read_text(encoding="utf-8")
    for name in ("recipe/meta.yaml", "CITATION.cff", "Cargo.toml", "pyproject.toml")
)


def section(name: str) -> list[str]:
    """The items of a list in the recipe, without comments."""
    (block,) = re.findall(rf"^  {name}:\n((?:    - .*\n)+)", RECIPE, flags=re.M)
    return [line.strip("- ").split("#")[0].strip() for line in block.splitlines()]


def test_versions_are_one() -> None:
    (version,) = re.findall(r'^version = "(.*)"', CARGO, flags=re.M)
    assert re.findall(r'set version = "(.*)"', RECIPE) == [version]
    assert re.findall(r"^version: (.*)", CITATION, flags=re.M) == [version]
    assert re.findall(r'^phugoid = .*version = "([^"]*)"', CARGO, flags=re.M) == [version]


def test_what_is_needed_is_the_same() -> None:
    (listed,) = re.findall(r"^dependencies = \[(.*)\]", PYPROJECT, flags=re.M)
    needed = {re.sub(r">=", " >=", item) for item in re.findall(r'"([^"]+)"', listed)}
    assert {item.replace("matplotlib-base", "matplotlib") for item in section("run")} - {"python"} == needed
    (maturin,) = re.findall(r'^requires = \["(.*)"\]', PYPROJECT, flags=re.M)
    builder = maturin.replace("maturin", "maturin ")
    assert builder in section("host") and builder in section("build")
    (summary,) = re.findall(r'^description = "(.*)"', PYPROJECT, flags=re.M)
    assert f"summary: {summary}\n" in RECIPE


def test_a_wheel_is_tried_at_the_lowest_versions_that_it_accepts() -> None:
    metadata = "Name: x\nRequires-Dist: numpy>=1.24\nRequires-Dist: h5py>=3.7 ; extra == 'hdf5'\n"
    metadata += "Requires-Dist: rich>=13\n"
    assert try_wheel.requirements(metadata, lowest=True) == ["numpy==1.24", "rich==13"]
    assert try_wheel.requirements(metadata, lowest=False) == ["numpy>=1.24", "rich>=13"]


@pytest.mark.skipif(os.name == "nt", reason="a script of a shell stands for a Python")
def test_a_python_is_found_on_the_path_of_the_user(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The environment itself sees the folders of the system alone."""
    python = tmp_path / "bin" / "a-python"
    python.parent.mkdir()
    python.write_text(f'#!/bin/sh\nexec "{sys.executable}" "$@"\n', encoding="utf-8")
    python.chmod(0o755)
    monkeypatch.setenv("PATH", str(python.parent), prepend=os.pathsep)
    environment = try_wheel.Environment(tmp_path, "a-python")
    assert environment.run("python", "-c", "import sys; print(sys.prefix)").strip() == str(tmp_path / "env")
