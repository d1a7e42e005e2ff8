"""``phugoid validate``: of a saved fit, and of a model that is fitted first."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from cli_case import run

import phugoid as ph
from phugoid.cli.model_file import load_model


def test_fit_first_or_saved_gives_the_same(here: Path) -> None:
    fit = ph.estimate(load_model("model.py"), ph.read("run1.csv"))
    fit.save("fit.json")
    saved = run("validate", "fit.json", "run2.csv", "--tolerance", "x=0.05", "--plot", "v.png")
    assert saved.exit_code == 0 and (here / "v.png").exists(), saved.output
    expected = fit.validate(ph.read("run2.csv"), tolerances={"x": 0.05})
    assert saved.stdout == expected.summary() + "\n\nWritten: v.png\n"
    first = run("validate", "model.py", "run1.csv", "run2.csv", "--json", "--tolerance", "x=0.05")
    assert first.exit_code == 0, first.output
    found = json.loads(first.stdout)
    assert found["log_likelihood"] == pytest.approx(expected.log_likelihood, rel=1e-6)
    assert found["inside_tolerance"]["x"] > 0.9 and list(found["re_estimated"]) == ["c"]
    assert found["tolerances"] == {"x": {"absolute": 0.05, "relative": 0.0}}
    assert found["fit"]["experiments"][0]["name"] == "run1"


def test_a_tolerance_may_be_a_part_of_what_is_measured(here: Path) -> None:
    fit = ph.estimate(load_model("model.py"), ph.read("run1.csv"))
    fit.save("fit.json")
    done = run("validate", "fit.json", "run2.csv", "--tolerance", "x=0.005/3%")
    expected = fit.validate(ph.read("run2.csv"), tolerances={"x": ph.Tolerance(0.005, 0.03)})
    assert done.exit_code == 0 and done.stdout == expected.summary() + "\n"
    assert 0.0 < expected.matches["x"].inside < 1.0 and "of the samples lie within ±0.005" in done.stdout
    bad = run("validate", "fit.json", "run2.csv", "--tolerance", "x=3%/0.005")
    assert bad.exit_code == 2 and "OUTPUT=VALUE/PART%" in bad.stderr


def test_the_report_of_the_fit_holds_the_validation(here: Path) -> None:
    ph.estimate(load_model("model.py"), ph.read("run1.csv")).save("fit.json")
    done = run("validate", "fit.json", "run2.csv", "--tolerance", "x=0.05", "--report", "page.html")
    assert done.exit_code == 0 and done.stdout.endswith("Written: page.html\n"), done.output
    page = (here / "page.html").read_text(encoding="utf-8")
    assert "Validation</h2>" in page and "run2.csv" in page and "within ±0.05" in page


def test_a_fit_that_has_not_converged_is_not_validated(here: Path) -> None:
    done = run("validate", "model.py", "run1.csv", "run2.csv", "--iterations", 0)
    assert done.exit_code == 1 and "There is nothing to validate" in done.stdout
    done = run("validate", "model.py", "run1.csv", "run2.csv", "--iterations", 0, "--json")
    assert done.exit_code == 1 and json.loads(done.stdout)["validation"] is None


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["model.py", "run1.csv"], "is a model: give a data file to fit it to, and others"),
        (["fit.json", "run2.csv", "--fix", "a"], "fit.json holds a fit"),
        (["fit.json", "run2.csv", "--tolerance", "z=1"], "'z', which is not an output"),
    ],
)
def test_bad_input(here: Path, args: list[str], words: str) -> None:
    ph.estimate(load_model("model.py"), ph.read("run1.csv")).save("fit.json")
    done = run("validate", *args)
    assert done.exit_code == 2 and words in done.stderr, done.output
