"""No two classes of the package have one name: whoever reads it knows which is meant."""

from __future__ import annotations

import ast
from collections import Counter
from pathlib import Path

import phugoid

PACKAGE = Path(phugoid.__file__).parent


def test_classes_have_names_of_their_own() -> None:
    names = Counter(
        node.name
        for path in PACKAGE.rglob("*.py")
        for node in ast.parse(path.read_text(encoding="utf-8")).body
        if isinstance(node, ast.ClassDef)
    )
    assert len(names) > 200
    assert [name for name, count in names.items() if count > 1] == []
