"""What several files share: figures without a window, a folder with a model and data files, published records."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

os.environ["MPLBACKEND"] = "Agg"


@pytest.fixture(autouse=True)
def _close() -> Iterator[None]:
    """Closes the figures of each test."""
    yield
    if "matplotlib.pyplot" in sys.modules:
        sys.modules["matplotlib.pyplot"].close("all")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder, with the files of `cli_case`."""
    from cli_case import write

    write(tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def published() -> Callable[[str], Path]:
    """Returns the path of a published record of a name; without it the test is skipped."""
    folder = Path(os.environ.get("PHUGOID_DATA", Path(__file__).parents[2] / "shared" / "data"))

    def path(name: str) -> Path:
        if not (folder / name).exists():
            pytest.skip(f"no {name}: put the published data into ../shared/data or name a folder in PHUGOID_DATA")
        return folder / name

    return path
