"""Check the words of the Python package and of the documentation: docstrings of functions begin with a verb, and
phrases that CONTRIBUTING.md replaces do not come back.

    python tools/check_words.py [root of the repository]

Ruff's D401 finds verbs in the wrong mood, but not docstrings that begin with "What is ..." or "Of a ...".
"""

from __future__ import annotations

import ast
import re
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

NO_VERBS = {
    *("A", "All", "An", "As", "Both", "But", "By", "Each", "For", "From", "How", "In", "Its", "Itself", "Nothing"),
    *("Of", "On", "One", "Same", "That", "The", "These", "This", "Those", "To", "Up", "What", "When", "Where"),
    *("Whether", "Which", "With", "Without"),
}
PHRASES = re.compile(
    r"pass(es)?\s+for\s+white|(found|estimated)\s+anew|holds?\s+zero\b|told\s+of|not\s+told|tells?\s+nothing|"
    r"as\s+coloured\s+as\s+(they\s+are|the\s+residuals)|what\s+to\s+beware\s+of|all\s+else\s+was\s+sought|did\s+not\s+prove\s+itself|"
    r"in\s+place\s+of\s+something\s+else|as\s+much\s+as\s+its\s+noise|reads\s+(much\s+)?like|hardly\s+held|speaks?\s+against|"
    r"\bwander(s|ing)?\b|(?<![\"'])\brivals?\b|"
    r"all\s+else\s+is\s+sought|to\s+be\s+believed|tells?\s+whether|first\s+states?\b|(tells?|told)(\s+\w+){0,2}\s+(apart|from)\b",
    re.IGNORECASE,
)
TEXTS = {tokenize.COMMENT, tokenize.STRING, getattr(tokenize, "FSTRING_MIDDLE", tokenize.STRING)}


def functions(tree: ast.AST) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    """Yield the functions of a module that are no properties, whose docstrings may be noun phrases."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and not any(
            "property" in ast.unparse(decorator) for decorator in node.decorator_list
        ):
            yield node


def faults(path: Path) -> Iterator[str]:
    """Yield what is wrong in a file, with its line."""
    for node in functions(ast.parse(path.read_text(encoding="utf-8"))):
        first = (ast.get_docstring(node) or "Return").split(maxsplit=1)[0]
        if first in NO_VERBS or not first[0].isupper():
            yield f"{node.lineno}: the docstring of {node.name} begins with '{first}', not with a verb"
    with path.open("rb") as file:
        for token in tokenize.tokenize(file.readline):
            if token.type in TEXTS and (found := PHRASES.search(token.string)):
                line = token.start[0] + token.string[: found.start()].count("\n")
                yield f"{line}: '{' '.join(found[0].split())}': see the words in CONTRIBUTING.md"


def pages(root: Path) -> Iterator[Path]:
    """Yield the pages of the documentation, and the templates of reports."""
    yield from (page for page in [root / "README.md"] if page.is_file())
    yield from (page for page in sorted((root / "docs").rglob("*.md")) if page.name != "words.md")  # it lists them
    yield from sorted((root / "python" / "phugoid" / "templates").glob("*.html"))


def faults_of_page(path: Path) -> Iterator[str]:
    """Yield the phrases in a page that are to be replaced, with their lines."""
    text = path.read_text(encoding="utf-8")
    for found in PHRASES.finditer(text):
        line = text.count("\n", 0, found.start()) + 1
        yield f"{line}: '{' '.join(found[0].split())}': see the words in CONTRIBUTING.md"


def main() -> int:
    """Print all faults; return 1 where there are any."""
    root = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parents[1]
    package = root / "python" / "phugoid"
    found = [
        f"{path.relative_to(root).as_posix()}:{fault}"
        for path in sorted(package.rglob("*.py"))
        for fault in faults(path)
    ]
    found += [f"{page.relative_to(root).as_posix()}:{fault}" for page in pages(root) for fault in faults_of_page(page)]
    print("\n".join(found), end="\n" if found else "")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
