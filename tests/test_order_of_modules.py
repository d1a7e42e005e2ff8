"""`tools/check_layers.py` finds an import against the order of the modules, wherever it stands."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


def checked(root: Path) -> tuple[int, str]:
    done = subprocess.run(
        [sys.executable, str(ROOT / "tools/check_layers.py"), str(root)], capture_output=True, text=True, check=False
    )
    return done.returncode, done.stdout


def test_no_module_imports_from_one_that_stands_right_of_it() -> None:
    assert checked(ROOT) == (0, "")


@pytest.mark.parametrize(
    "text",
    [
        "from .result import Fit\n",
        "def late():\n    from .result import Fit\n",
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from .result import Fit\n",
    ],
    ids=["at the top", "within a function", "for type checkers"],
)
def test_an_arrow_back_is_found(text: str, tmp_path: Path) -> None:
    for path in ("rust/core/Cargo.toml", "python/phugoid/fit_result.py"):
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(text if path.endswith(".py") else "")
    code, said = checked(tmp_path)
    assert code == 1 and "`fit_result` must not import from `result`" in said


def package(root: Path, files: dict[str, str]) -> Path:
    for path, text in {
        "rust/core/Cargo.toml": "",
        **{f"python/phugoid/{name}": text for name, text in files.items()},
    }.items():
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).write_text(text)
    return root


def test_an_import_of_the_package_itself_is_found(tmp_path: Path) -> None:
    code, said = checked(
        package(tmp_path, {"modelling/noise.py": "from .. import _core\n", "modelling/__init__.py": ""})
    )
    assert code == 1 and "`modelling` must not import from `__init__`" in said
    assert checked(package(tmp_path, {"modelling/noise.py": "import phugoid._core as _core\n"})) == (0, "")


@pytest.mark.parametrize(
    ("files", "words"),
    [
        (
            {"data/read.py": "from .units import a\n", "data/units.py": "def late():\n    from .read import b\n"},
            "data: circle of imports: read -> units (python/phugoid/data/read.py:1), units -> read (",
        ),
        (
            {
                "data/readers/a.py": "from ..checked.c import d\n",
                "data/checked/c.py": "",
                "data/checked/e.py": "from ..readers import b\n",
                "data/readers/b.py": "",
            },
            "data: circle of imports: checked -> readers (python/phugoid/data/checked/e.py:1), readers -> checked (",
        ),
    ],
    ids=["two files", "two folders, without a circle of files"],
)
def test_a_circle_within_a_folder_is_found(files: dict[str, str], words: str, tmp_path: Path) -> None:
    code, said = checked(package(tmp_path, files))
    assert code == 1 and words in said
