"""Docstrings as reStructuredText.

Those of the package are set to be read in a terminal: names in one column and what they mean in the next, indented
formulas, and signs such as ``|x|`` and ``*`` that stand for themselves. Here they become definition lists, literal
blocks and escaped text.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from sphinx.application import Sphinx
from sphinx.util import inspect

# A row of a table: a term, at least two blanks, and its meaning.
_ROW = re.compile(r"(?P<term>\S(?:.*?\S)?) {2,}(?P<text>\S.*)")
_LITERAL = re.compile(r"(``.+?``|`[^`]+`)", re.S)
# *Words in italics*: a title, a term; not a product.
_EMPHASIS = re.compile(r"(?<![\w*)])\*(?=[A-Za-z])([^*|=]{3,120}?[A-Za-z])\*(?![\w*])", re.S)


def escaped(text: str) -> str:
    """Text in which only literals, references and words in italics are marked up."""
    parts = []
    for i, part in enumerate(_LITERAL.split(text)):
        if i % 2:
            parts.append(part)
            continue
        last = 0
        for m in _EMPHASIS.finditer(part):
            parts += [_plain(part[last : m.start()]), m[0]]
            last = m.end()
        parts.append(_plain(part[last:]))
    return "".join(parts)


def _plain(text: str) -> str:
    text = re.sub(r"([\\*|])", r"\\\1", text)
    return re.sub(r"_(?!\w)", r"\\_", text)  # a name that ends with _ would be a reference


def paragraphs(lines: Sequence[str]) -> Iterator[list[str]]:
    """The runs of lines between blank ones."""
    run: list[str] = []
    for line in [*lines, ""]:
        if line.strip():
            run.append(line.rstrip())
        elif run:
            yield run
            run = []


def _term(text: str) -> str:
    return text if "`" in text or '"' in text else f"``{text}``"


# Names of arguments before what they mean: ``inputs``, ``outputs``: ...
_NAMED = re.compile(r"(?P<term>``[^`]+``(?:, ``[^`]+``)*)(?::| {2,}|(?= ))\s*(?P<text>\S.*)")
Row = tuple[str, list[str]]


def rows(run: Sequence[str]) -> list[Row] | None:
    """Terms and their meanings where a paragraph is a table of these, else None."""
    first = run[0]
    if first.startswith((">>>", "- ", " ")):
        return None
    if m := _ROW.fullmatch(first):
        at = m.start("text")

        def begins(line: str) -> tuple[str, str] | None:
            if line[0] == " ":
                return None
            # A long term has one blank before the column.
            if line[at - 1 : at] == " " and line[at : at + 1].strip() and line[:at].strip():
                return line[:at].strip(), line[at:]
            row = _ROW.fullmatch(line)
            return (row["term"], row["text"]) if row else None

        if not all(line[0] == " " or begins(line) for line in run):
            return None
    elif re.match(r"``[^`]+``(, ``[^`]+``)*:", first):

        def begins(line: str) -> tuple[str, str] | None:
            named = re.match(r"``[^`]+``(, ``[^`]+``)*:", line) and _NAMED.fullmatch(line)
            return (named["term"], named["text"]) if named else None

    else:
        return None
    found: list[Row] = []
    for line in run:
        if row := begins(line):
            found.append((row[0], [row[1]]))
        else:
            found[-1][1].append(line.strip())
    return found


def converted(lines: Sequence[str]) -> list[str]:
    """A docstring in reStructuredText."""
    out: list[str] = []
    for run in paragraphs(lines):
        if run[0].lstrip().startswith(">>>"):
            out += [*run, ""]
        elif all(line.startswith("  ") for line in run):
            out += ["::", "", *run, ""]
        elif table := rows(run):
            for term, text in table:
                out += [_term(term), *(f"    {line}" for line in escaped("\n".join(text)).splitlines()), ""]
        else:
            # Within a paragraph indentation means nothing, but where each line begins with a name in ``quotes``.
            out += [*escaped("\n".join(line.strip() for line in run)).splitlines(), ""]
    return out


def process(app: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]) -> None:
    """For autodoc: changes the lines in place."""
    lines[:] = converted(lines)


# What the package makes and users only read: how it is constructed is of no interest.
RESULTS = {
    "Bands", "Bootstrap", "CorrectedErrors", "Correlation", "Diagnosis", "EquationError", "Estimate", "Excursion",
    "Extension", "Finding", "Fit", "FitResult", "Gain", "IntegrationError", "Iteration", "Manoeuvre", "Manoeuvres",
    "Match", "Misfit", "Mode", "Modes", "Multistart", "Optimum", "Outcome", "Plan", "Plans", "Profile", "Profiles",
    "Reconstruction", "Record", "Refinement", "Scored", "SelectedTerms", "SelectionStep", "Trim", "Validation",
    "VanePositions", "WeakDirection",
}  # fmt: skip
_SHORT = [
    (
        re.compile(r"~?(?:numpy\.)?ndarray\[tuple\[~?(?:typing\.)?Any, \.\.\.\], ~?(?:numpy\.)?dtype\[[^\]]*\]\]"),
        "ndarray",
    ),
    (re.compile(r"_Buffer \| _SupportsArray\[.*?bytes \| str\]"), "ArrayLike"),
    (re.compile(r"~(?:\w+\.)+"), ""),
    (re.compile(r"TypeAliasForwardRef\('(\w+)'\)"), r"\1"),
    (re.compile(r"\b_Array\b"), "ndarray"),
    (re.compile("<factory>"), "{}"),
]


def _short(text: str | None) -> str | None:
    for pattern, name in _SHORT if text else []:
        text = pattern.sub(name, text or "")
    return text


def signature(
    app: Sphinx, what: str, name: str, thing: object, options: object, arguments: str | None, returns: str | None
) -> tuple[str | None, str | None]:
    """For autodoc: arrays by their names; none for results."""
    if what == "class" and name.rpartition(".")[2] in RESULTS:
        return "", None
    return _short(arguments), _short(returns)


def setup(app: Sphinx) -> dict[str, bool]:
    """Has autodoc call `process` and `signature`."""
    # The names of arrays in `autodoc_type_aliases` are printed so within other types, as in Mapping[str, ndarray].
    if alias := getattr(inspect, "TypeAliasForwardRef", None):
        alias.__repr__ = lambda self: self.name
    app.connect("autodoc-process-docstring", process)
    app.connect("autodoc-process-signature", signature)
    return {"parallel_read_safe": True}
