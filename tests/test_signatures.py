"""Signatures of the Rust crate: no tuple of more than two unnamed parts; clippy holds the number of arguments."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
CRATE = ROOT / "rust" / "core" / "src"


def headers(text: str) -> Iterator[str]:
    """What stands from each `fn` to its body."""
    for match in re.finditer(r"\bfn \w+", text):
        depth, end = 0, match.end()
        while end < len(text) and (depth or text[end] not in "{;"):
            depth += (text[end] in "([") - (text[end] in ")]")
            end += 1
        yield text[match.start() : end]


def tuples(header: str) -> Iterator[str]:
    """Types in parentheses that are not arguments, and hold more than two types."""
    for match in re.finditer(r"(?<![\w>])\(", header):
        depth, commas, at = 0, 0, match.start()
        while True:
            depth += (header[at] in "([{<") - (header[at] in ")]}") - (header[at] == ">" and header[at - 1] != "-")
            commas += header[at] == "," and depth == 1
            at += 1
            if depth == 0:
                break
        inside = header[match.start() : at]
        if commas - inside.rstrip(")").rstrip().endswith(",") > 1 and ":" not in inside.replace("::", ""):
            yield inside


def test_the_search_finds_them() -> None:
    found = [
        t for h in headers("fn a(x: usize) -> Vec<(u32, u32, f64)> {}\nfn b((x, y): (u8, u8)) {}") for t in tuples(h)
    ]
    assert found == ["(u32, u32, f64)"]


def test_no_signature_has_more_than_two_unnamed_parts() -> None:
    files = sorted(CRATE.rglob("*.rs"))
    assert len(files) > 100
    found = [f"{f.relative_to(ROOT)}: {t}" for f in files for h in headers(f.read_text()) for t in tuples(h)]
    named = [line for line in found if not re.search(r": \(\w+(, \w+)+\)$", line)]
    assert not named, "\n".join(named)


def test_clippy_allows_seven_arguments_at_most() -> None:
    assert "too-many-arguments-threshold = 7" in (ROOT / "clippy.toml").read_text()
    allowed = [f.name for f in CRATE.rglob("*.rs") if "too_many_arguments" in f.read_text()]
    assert not allowed
