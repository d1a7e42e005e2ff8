"""The README is short, its code runs as it stands, and it can be shown where only absolute links work."""

from __future__ import annotations

import re
from pathlib import Path

import pages
import pictures
import pypi_readme
import pytest

import phugoid as ph

README = pages.ROOT / "README.md"
TEXT = README.read_text(encoding="utf-8")


def test_it_is_read_in_three_minutes() -> None:
    assert len(TEXT.split()) <= 700


def test_code_fits_arrays_and_finds_what_the_model_misses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The arrays are those of the picture: damping that grows with the rate, which the model has not."""
    monkeypatch.chdir(tmp_path)
    first, second = pictures.flights()
    names: dict[str, object] = {}
    for run, number in ((first, ""), (second, "2")):
        arrays = {"t": run.t, "elevator": run.input("de"), "rate": run.output("q"), "attitude": run.output("theta")}
        names |= {f"{name}{number}": array for name, array in arrays.items()}
    fitting, diagnosing = pages.blocks(README, "python")
    pages.run(fitting, README, names)
    fit = names["fit"]
    assert isinstance(fit, ph.Fit) and fit.converged
    assert (tmp_path / "fit.html").exists() and "Mtheta" in capsys.readouterr().out
    pages.run(diagnosing, README, names)
    extended = names["extended"]
    assert isinstance(extended, ph.results.Extension) and extended.added == ("q':q|q|",)
    assert (tmp_path / "missing.html").exists()
    printed = capsys.readouterr().out
    (said,) = re.findall(r'# "(.*)"', diagnosing.code)
    assert said in printed and extended.gain.held_out > 1000
    for name, true in pictures.TRUTH.items():
        estimate = extended.fit.parameters[name]
        assert abs(estimate.value - true) < 4 * estimate.std_error, name


def test_what_it_names_is_there() -> None:
    for target in re.findall(r"\]\(([^)\s:#]+)\)", TEXT):
        assert (pages.ROOT / target).exists(), target
    makefile = (pages.ROOT / "Makefile").read_text(encoding="utf-8")
    for command in ("demo", "test"):
        assert f"make {command} " in TEXT and re.search(rf"^{command}:", makefile, re.M)
    for needed in ("Python 3.10", "Rust 1.89", "tools/ipopt.py", "PHUGOID_DATA", "hfb320_1_10.asc"):
        assert needed in TEXT, needed
    assert 'rust-version = "1.89"' in (pages.ROOT / "Cargo.toml").read_text(encoding="utf-8")


@pytest.mark.parametrize("number", ["7.8 ms", "468 ms", "6.5 s", "1000 of 1000", "600,000", "565 of 585"])
def test_its_numbers_are_those_of_the_benchmarks(number: str) -> None:
    sources = [pages.ROOT / "docs" / "comparison.md", pages.ROOT / "benchmarks" / "README.md"]
    assert number in TEXT and any(number in page.read_text(encoding="utf-8") for page in sources)


def test_its_counts_of_diagnoses_are_those_of_the_judges() -> None:
    table = (pages.ROOT / "docs" / "comparison.md").read_text(encoding="utf-8")
    judges = [list(map(int, row.split("|"))) for row in re.findall(r"^\| \w+ judge \|(.*)\|$", table, flags=re.M)]
    hidden, first, *_, wrong, _, _, nothing, alarms = map(sum, zip(*judges, strict=True))
    said = f"In {hidden} systems by eight judges who had not seen its code it named the hidden effect "
    said += f"first in {first}, a wrong one in {wrong}"
    assert len(judges) == 8 and said in " ".join(TEXT.split())
    assert f"Where nothing was hidden it named something in {alarms} of their {nothing}," in TEXT


def test_links_become_absolute_where_relative_ones_do_not_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "README.md"
    page.write_text(TEXT, encoding="utf-8")
    metadata, crate = tmp_path / "pyproject.toml", tmp_path / "rust" / "core" / "Cargo.toml"
    crate.parent.mkdir(parents=True)
    for file in (metadata, crate):
        file.write_text((pages.ROOT / file.relative_to(tmp_path)).read_text(encoding="utf-8"), encoding="utf-8")
    monkeypatch.setattr(pypi_readme, "ROOT", tmp_path)
    assert pypi_readme.main(["no address", "v1"]) == 2 and page.read_text(encoding="utf-8") == TEXT
    assert pypi_readme.main(["https://host/owner/project/", "v1"]) == 0
    once = metadata.read_text(encoding="utf-8")
    assert once.count("[project.urls]") == 1 and 'Repository = "https://host/owner/project"\n' in once
    assert '\nrepository = "https://host/owner/project"\n' in crate.read_text(encoding="utf-8")
    assert pypi_readme.with_addresses(once, "https://host/owner/project", "v1") == once
    text = page.read_text(encoding="utf-8")
    targets = re.findall(r"\]\(([^)\s]+)\)", text)
    assert targets and all(t.startswith("https://") for t in targets)
    assert "![" in text and "(https://host/owner/project/raw/v1/docs/_static/fit.png)" in text
    assert "(https://host/owner/project/blob/v1/CONTRIBUTING.md)" in text
    assert [b.code for b in pages.blocks(page)] == [b.code for b in pages.blocks(README)]
