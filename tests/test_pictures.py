"""The pictures of the README are current: drawn anew, they show the same numbers, and so do their captions."""

from __future__ import annotations

from pathlib import Path

import pages
import pictures
import pytest
from PIL import Image

NAMES = ("fit.png", "diagnosis.png")
TEXT = (pages.ROOT / "README.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pictures")
    pictures.draw(folder, folder)
    return folder


@pytest.mark.parametrize("name", NAMES)
def test_a_picture_is_the_one_that_the_script_draws(drawn: Path, name: str) -> None:
    there = pictures.FOLDER / name
    assert pictures.numbers_of(there) == pytest.approx(pictures.numbers_of(drawn / name), rel=1e-4)
    with Image.open(there) as old, Image.open(drawn / name) as new:
        assert old.size == pytest.approx(new.size, rel=0.02)  # fonts may differ


@pytest.mark.parametrize("name", NAMES)
def test_a_picture_is_small_and_shown(name: str) -> None:
    assert (pictures.FOLDER / name).stat().st_size < 120_000
    assert f"](docs/_static/{name})" in TEXT
    assert f"](_static/{name})" in (pages.ROOT / "docs" / "index.md").read_text(encoding="utf-8")


def test_the_caption_has_the_numbers_of_the_picture() -> None:
    numbers = pictures.numbers_of(pictures.FOLDER / "diagnosis.png")
    assert f"RMS {numbers['RMS before']:.3f} rad/s" in TEXT
    assert f"{numbers['RMS after']:.4f} rad/s" in TEXT
    assert f"noise is {pictures.SIGMA} rad/s" in TEXT
