"""Code in pages of Markdown: the README and the documentation run as they stand."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

_FENCE = re.compile(
    r"^(?P<fence>```+|:::+)\{?(?P<language>[\w-]*)\}?[^\n]*\n(?P<code>.*?)^(?P=fence)[ ]*$", re.M | re.S
)


@dataclass(frozen=True)
class Block:
    """A block of code: its language, its text, and the line of the page on which it begins."""

    language: str
    code: str
    line: int


def blocks(page: Path, language: str | None = None) -> list[Block]:
    """The blocks of a page in order, of one language if asked."""
    text = page.read_text(encoding="utf-8")
    found = [Block(m["language"], m["code"], text.count("\n", 0, m.start()) + 2) for m in _FENCE.finditer(text)]
    return [b for b in found if language in (None, b.language)]


def run(block: Block, page: Path, names: dict[str, object]) -> None:
    """Runs a block of Python; a traceback tells the page and the line."""
    code = compile("\n" * (block.line - 1) + block.code, str(page), "exec")
    exec(code, names)
