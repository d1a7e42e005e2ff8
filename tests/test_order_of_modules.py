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
