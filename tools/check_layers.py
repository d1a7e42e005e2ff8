"""Check that arrows never point back: a module imports only from modules left of it.

    python tools/check_layers.py [root of the repository]

Both orders are below. A new module is put into its order first; one that is in neither is an error.
"""

import ast
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

# fmt: off
RUST = [
    "math", "simd", "interrupt", "dense", "setters", "lgl", "interpolate", "table", "error", "threads", "pairs",
    "expr", "tape", "transform", "parameter", "nlp", "noise", "condition", "model", "evaluator", "experiment",
    "gaps", "measured", "mesh", "integrate", "problem", "collocation", "shooting", "filter", "linalg", "solver",
    "initial", "diagnosis", "simulate", "estimate",
]

PYTHON = [
    "_core", "errors", "notebook", "writing", "tabular", "functions", "parameters", "noise", "modelling", "data",
    "transcription", "initialisation", "solvers", "records", "refinement", "smoothing",
    "fit_result", "match", "figures", "regression", "integration", "process_noise",
    "estimation", "simulate", "linear", "manoeuvres", "models", "export", "saving", "residual_noise", "sensitivities",
    "validation", "pages", "discrepancy", "planning", "starts", "uncertainty", "summary", "report", "result",
    "api", "multistart", "reconstruction", "petab", "results", "design", "cli", "__init__", "__main__",
]
DISCREPANCY = [
    "misfit", "candidates", "search", "discrimination", "page", "saved", "arguments", "diagnose", "improve",
]
# fmt: on

Import = tuple[int, str]  # line, top-level module
Finder = Callable[[Path, int, list[str]], Iterator[Import]]  # of a file so many levels below the root


def flatten(tree: str) -> Iterator[str]:
    """First segments of a `use` tree: `{a, b::{c, d}}` gives a and b."""
    if not tree.startswith("{"):
        yield re.match(r"\w*", tree)[0]
        return
    depth, name = 0, ""
    for char in tree:
        depth += (char == "{") - (char == "}")
        if depth == 0 or (depth == 1 and char == ","):
            yield re.match(r"\w*", name.strip("{ \t\n"))[0]
            name = ""
            if depth == 0:
                return
        else:
            name += char


def rust_imports(path: Path, depth: int, order: list[str]) -> Iterator[Import]:
    """What `crate::` leads to, or as many `super::` as the file is deep. Comments do not count."""
    text = re.sub(r"//[^\n]*", "", path.read_text())
    text = re.sub(r"/\*.*?\*/", lambda m: "\n" * m[0].count("\n"), text, flags=re.S)
    for match in re.finditer(rf"\bcrate::\s*|(?<!:)\b(?:super::\s*){{{depth}}}(?!super)", text):
        line = text.count("\n", 0, match.start()) + 1
        rest = text[match.end() :]
        if rest.startswith("*") and match[0].startswith("crate"):
            yield line, "*"
        for name in flatten(rest):
            macro = re.match(r"\w+!", rest)
            inside = match[0].startswith("super") and name not in order  # `super` within an inline `mod tests`
            if name and name != "self" and not macro and not inside:
                yield line, name


def python_imports(path: Path, depth: int, order: list[str]) -> Iterator[Import]:
    """What the file imports from the package, within functions and for type checkers too."""
    for node in ast.walk(ast.parse(path.read_text(), str(path))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level in (0, depth):
            base = ["phugoid"] if node.level else []
            base += [node.module] if node.module else []
            names = [".".join([*base, alias.name]) for alias in node.names]
        else:
            continue
        for name in names:
            package, _, inner = name.partition(".")
            if package == "phugoid":
                top = inner.partition(".")[0]
                yield node.lineno, top if top in order else "__init__"


def check(root: Path, source: str, order: list[str], imports: Finder, facade: str = "__init__") -> Iterator[str]:
    """Problems in the files below `source`; `facade` may import from all of them."""
    folder = root / source
    for path in sorted(p for p in folder.rglob("*") if p.suffix in {".rs", ".py", ".pyi"}):
        parts = path.relative_to(folder).with_suffix("").parts
        module, name = parts[0], path.relative_to(root)
        if module == facade:
            continue
        if module not in order:
            yield f"{name}:1: module `{module}` stands in no order: put it into tools/check_layers.py"
            continue
        depth = len(parts) - (parts[-1] == "mod")  # how many `super::` or leading dots reach the root
        for line, target in imports(path, depth, order):
            if target not in order:
                yield f"{name}:{line}: `{target}` stands in no order: import it from its own module"
            elif order.index(target) > order.index(module):
                yield f"{name}:{line}: `{module}` must not import from `{target}`, which stands right of it"


def check_manifest(root: Path) -> Iterator[str]:
    name = Path("rust/core/Cargo.toml")
    for number, line in enumerate((root / name).read_text().splitlines(), 1):
        if "pyo3" in line.partition("#")[0]:
            yield f"{name}:{number}: the core crate knows no Python"


def main() -> int:
    root = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parent.parent
    problems = [
        *check(root, "rust/core/src", RUST, rust_imports, facade="lib"),
        *check_manifest(root),
        *check(root, "python/phugoid", PYTHON, python_imports),
        *check(root, "python/phugoid/discrepancy", DISCREPANCY, python_imports),
    ]
    print(*problems, sep="\n", end="\n" if problems else "")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
