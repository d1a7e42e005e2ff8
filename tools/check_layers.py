"""Check that arrows never point back: a module imports only from modules left of it.

    python tools/check_layers.py [root of the repository]

Both orders are below. A new module is put into its order first; one that is in neither is an error. Within the folders
of the Python package no list is needed: what lies in a folder, files and folders in it, must not import in a circle.
"""

import ast
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

# fmt: off
RUST = [
    "math", "simd", "interrupt", "dense", "setters", "index", "lgl", "interpolate", "table", "error", "threads",
    "pairs", "expr", "tape", "transform", "parameter", "nlp", "noise", "condition", "constant", "model", "evaluator",
    "experiment", "gaps", "measured", "mesh", "integrate", "problem", "collocation", "shooting", "filter", "linalg",
    "solver", "initial", "diagnosis", "simulate", "estimate", "fleet", "online",
]

PYTHON = [
    "_core", "errors", "renamed", "time_unit", "progress", "notebook", "writing", "tabular", "functions", "parameters",
    "modelling", "data", "transcription", "filter_error", "initialisation", "solvers", "records", "fit_result",
    "goodness_of_fit", "figures", "regression", "estimation", "simulation", "online", "steady_state", "linear",
    "models", "export", "saving", "residual_noise", "sensitivities", "frozen_model", "validation", "design", "pages",
    "discrepancy", "uncertainty",
    "summary", "report", "diagnosis", "result", "fleet", "api", "diagnosing", "many_starts", "reconstruction", "petab",
    "results", "cli", "__init__", "__main__",
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
    """What the file imports from the package, within functions and for type checkers too.

    `from .. import name` is an import of the package itself, whatever the name is.
    """
    for line, module, name in absolute_imports(path, depth):
        top = (module or name).partition(".")[0]
        yield line, top if top in order and (module or not name) else "__init__"


def absolute_imports(path: Path, depth: int) -> Iterator[tuple[int, str, str]]:
    """Line, module without the package's name, and the name taken from it, of each import from the package."""
    parts = path.parts[-depth:]
    for node in ast.walk(ast.parse(path.read_text(), str(path))):
        if isinstance(node, ast.Import):
            for alias in node.names:
                package, _, module = alias.name.partition(".")
                if package == "phugoid":
                    yield node.lineno, module, ""
        elif isinstance(node, ast.ImportFrom):
            package, _, module = (node.module or "").partition(".")
            if node.level:
                module = ".".join([*parts[: depth - node.level], *filter(None, [node.module])])
            elif package != "phugoid":
                continue
            for alias in node.names:
                yield node.lineno, module, alias.name


def circles(root: Path, source: str) -> Iterator[str]:
    """Circles of imports among what lies in one folder, files and folders, for each folder of the package."""
    folder = root / source
    files = {path.relative_to(folder).with_suffix("").parts: path for path in sorted(folder.rglob("*.py"))}
    rooms: dict[tuple[str, ...], dict[str, dict[str, str]]] = {}  # folder -> importer -> imported -> an example
    for parts, path in files.items():
        if parts == ("__init__",):
            continue
        for line, module, name in absolute_imports(path, len(parts)):
            at = tuple(filter(None, module.split(".")))
            target = next(
                (t for t in ((*at, name), (*at, name, "__init__"), at, (*at, "__init__")) if t in files), None
            )
            if target is None or target == parts:
                continue
            shared = next(i for i, (a, b) in enumerate(zip(parts, target, strict=False)) if a != b)
            known = rooms.setdefault(parts[:shared], {}).setdefault(parts[shared], {})
            known.setdefault(target[shared], f"{path.relative_to(root)}:{line}")
    for place, arrows in rooms.items():
        for circle in _loops(arrows):
            steps = [f"{a} -> {b} ({arrows[a][b]})" for a, b in zip(circle, circle[1:] + circle[:1], strict=True)]
            yield f"{'/'.join([source, *place])}: circle of imports: {', '.join(steps)}"


def _loops(arrows: dict[str, dict[str, str]]) -> Iterator[list[str]]:
    """One loop for each set of rooms that import each other."""
    done: set[str] = set()
    for start in arrows:
        trail, seen = [[start]], {start}
        while trail and start not in done:
            way = trail.pop(0)
            for room in arrows.get(way[-1], {}):
                if room == start:
                    yield way
                    done.update(way)
                    trail = []
                    break
                if room not in seen:
                    seen.add(room)
                    trail.append([*way, room])


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
        *circles(root, "python/phugoid"),
    ]
    print(*problems, sep="\n", end="\n" if problems else "")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
