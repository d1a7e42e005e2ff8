"""`tools/check_words.py` finds docstrings that do not begin with a verb, and phrases that the glossary replaces."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


def checked(root: Path) -> tuple[int, str]:
    done = subprocess.run(
        [sys.executable, str(ROOT / "tools/check_words.py"), str(root)], capture_output=True, text=True, check=False
    )
    return done.returncode, done.stdout


def test_the_package_is_written_as_the_glossary_says() -> None:
    assert checked(ROOT) == (0, "")


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ('def f():\n    """What is left."""\n', "1: the docstring of f begins with 'What', not with a verb"),
        ('x = 1\ny = f"{x} was found anew"\n', "2: 'found anew'"),
        ("x = 1  # residuals pass for white\n", "1: 'pass for white'"),
        ('"""Text.\n\nThat an interval holds\nzero."""\n', "3: 'holds zero'"),
    ],
)
def test_a_fault_is_found_with_its_line(text: str, found: str, tmp_path: Path) -> None:
    package = tmp_path / "python" / "phugoid"
    package.mkdir(parents=True)
    (package / "match.py").write_text(text)
    code, said = checked(tmp_path)
    assert code == 1 and f"python/phugoid/match.py:{found}" in said


def test_a_property_may_be_a_noun_phrase(tmp_path: Path) -> None:
    package = tmp_path / "python" / "phugoid"
    package.mkdir(parents=True)
    (package / "match.py").write_text(
        'class A:\n    @property\n    def f(self):\n        """The ratio, which holds zeros and ones."""\n'
    )
    assert checked(tmp_path) == (0, "")


def test_a_phrase_on_a_page_is_found(tmp_path: Path) -> None:
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "page.md").write_text("A vane\nahead reads\nlike one that is delayed.\n")
    assert checked(tmp_path) == (1, "docs/page.md:2: 'reads like': see the words in CONTRIBUTING.md\n")
