"""C code of a fit or a model: the part that is exported, names in C, and the text."""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .._core import Expr, __version__
from ..data.filtering import kind_of
from ..errors import DataError, ModelError, OptionError
from ..fit_result import FitResult
from ..linear.linearise import labels_of, numbers_of
from ..modelling.compiled import Jacobians
from ..modelling.model import Model
from ..writing import write
from .graph import HELPERS, LOOKUP, Graph, definition, number

__all__ = [
    "Code",
    "Contents",
    "checked_name",
    "contents_of",
    "export_c",
    "identifier",
    "source",
]


# Words that are not names in C or C++.
_RESERVED = {
    "auto", "bool", "break", "case", "catch", "char", "class", "const", "continue", "default", "delete", "do",
    "double", "else", "enum", "extern", "float", "for", "friend", "goto", "if", "inline", "int", "long", "main",
    "namespace", "new", "operator", "private", "protected", "public", "register", "restrict", "return", "short",
    "signed", "sizeof", "static", "struct", "switch", "template", "this", "throw", "try", "typedef", "union",
    "unsigned", "using", "virtual", "void", "volatile", "while",
}  # fmt: skip


@dataclass(frozen=True)
class Contents:
    """The content of an export: a model, values of its parameters, initial states and inputs, and the origin."""

    model: Model
    values: Mapping[str, float]
    states: Mapping[str, float]
    inputs: Mapping[str, float]
    held: frozenset[str]  # inputs that are held between their samples in the experiment
    facts: tuple[str, ...]


def renamed(caller: str, late_inputs: bool) -> bool:
    """Return the option of the former name, with a DeprecationWarning where it is given."""
    if late_inputs:
        warnings.warn(f"the option late_inputs of {caller} is now delayed_inputs", DeprecationWarning, stacklevel=3)
    return late_inputs


def contents_of(
    caller: str,
    fit: FitResult | Model,
    parameters: Mapping[str, Any] | None,
    experiment: str | None,
    delayed_inputs: bool = False,
) -> Contents:
    """Return what to export of a fit or a model; raise ModelError where values or choices are missing."""
    model, values = numbers_of(caller, fit, parameters, experiment)
    if model.delays and not delayed_inputs:
        late = ", ".join([*model.delays.inputs, *model.delays.outputs])
        raise ModelError(
            f"{caller}: the model has delays ({late}), which functions of the present state cannot represent; with "
            f"{caller}(..., delayed_inputs=True) each delayed input is one of its own, which the caller delays"
        )
    states = dict.fromkeys(model.state_names, 0.0)
    inputs = dict.fromkeys(model.declared_inputs, 0.0)
    held: list[str] = []
    facts = [f"model: {model.name}"]
    if isinstance(fit, FitResult):
        labels = labels_of(caller, fit, experiment)
        record = next(r for r in fit.records if experiment in (None, r.name))
        own = [n for n, label in labels.items() if label != n and n not in (parameters or {})]
        if own and experiment is None and len(fit.records) > 1:
            raise ModelError(
                f"{caller}: each experiment has its own {own[0]}: say which, experiment='{record.name}', or give its "
                f"value, parameters={{'{own[0]}': ...}}"
            )
        states = {n: float(fit.initial_states[record.name][n]) for n in model.state_names}
        first = {n: float(v[0]) for n, v in record.inputs.items()}
        of_late = {name: of for name, (of, _) in model.delays.inputs.items()}
        inputs = {n: first[of_late.get(n, n)] for n in inputs}
        held = [n for n in inputs if kind_of(record.interpolation, of_late.get(n, n)) == "hold"]
        facts.append(f"fit: {fit.status}, log-likelihood {fit.log_likelihood:.10g}, experiment '{record.name}'")
    if held:
        facts.append(f"inputs held between samples: {', '.join(held)}")
    return Contents(model, values, states, inputs, frozenset(held), tuple(facts))


def identifier(text: str) -> str:
    """Return a name in C made of any text.

    >>> identifier("HFB-320 longitudinal"), identifier("1st try"), identifier("int")
    ('hfb_320_longitudinal', 'm_1st_try', 'int_')
    """
    found = re.sub(r"[^0-9a-z]+", "_", text.lower()).strip("_") or "model"
    found = f"m_{found}" if found[0].isdigit() else found
    return f"{found}_" if found in _RESERVED else found


def checked_name(name: str) -> str:
    """Return a name that is valid in C; raise OptionError for any other."""
    if not (isinstance(name, str) and re.fullmatch(r"[A-Za-z]\w*", name, flags=re.ASCII)) or name in _RESERVED:
        raise OptionError(f"export: {name!r} is not a name in C: letters, digits and underscores, a letter first")
    return name


_BREAK = "\n        "


@dataclass(frozen=True)
class Code:
    """The text of a header and of its source, and the prefix of all their names."""

    name: str
    header: str
    source: str


def source(contents: Contents, name: str) -> Code:
    """Return the header and the source of what is exported."""
    return _Writer(contents, name).code()


class _Writer:
    def __init__(self, contents: Contents, name: str) -> None:
        model = contents.model
        self.contents, self.model, self.name, self.big = contents, model, name, name.upper()
        units = model.units
        # Letter -> name and unit of each place.
        self.vectors: dict[str, dict[str, str]] = {
            "x": {n: state.unit for n, state in model.declared_states.items()},
            "u": model.declared_inputs,
            "p": {n: units.get(n, "") for n in model.parameter_names},
            "y": {n: units.get(n, "") for n in model.output_names},
        }
        self.places: dict[str, tuple[str, int]] = {}
        for letter in "xup":
            self.places |= {n: (letter, k) for k, n in enumerate(self.vectors[letter])}
        self.labels = {letter: _unique(group) for letter, group in self.vectors.items()}
        self.graph = Graph()
        self.quantities: dict[int, str] = {}
        known = model.quantity_expressions()
        for e, label in zip(known.values(), _unique(known), strict=True):
            self.quantities.setdefault(self.graph.add(Expr(e)), f"q_{label}")
        by_state = model.state_expressions()
        self.f = [by_state[n] for n in model.state_names]
        self.g = [Expr(e) for e in model.output_expressions().values()]

    def code(self) -> Code:
        jacobians = Jacobians(self.model, "export")
        entries = []
        for block in "ABCD":
            columns = jacobians.shapes[block][1]
            for (i, k), e in jacobians.blocks[block].items():
                entries.append((f"{block}[{i * columns + k}]", self.graph.add(Expr(e).simplify())))
        functions = [
            self._function("dynamics", ["dx"], [(f"dx[{i}]", self.graph.add(e)) for i, e in enumerate(self.f)]),
            self._function("outputs", ["y"], [(f"y[{i}]", self.graph.add(e)) for i, e in enumerate(self.g)]),
            self._function("jacobians", list("ABCD"), entries, {b: s[0] * s[1] for b, s in jacobians.shapes.items()}),
            self._step(),
        ]
        title = "\n".join(f" * {_comment(line)}" for line in self._facts())
        head = f"/*\n{title}\n */"
        body = [head, f'#include "{self.name}.h"\n\n#include <math.h>', *self._data(), *self._shared(), *functions]
        return Code(self.name, f"{head}\n{self._header()}", "\n\n".join(body) + "\n")

    def _facts(self) -> list[str]:
        return [
            f"{self.name}: written by phugoid {__version__}",
            *self.contents.facts,
            *self._constants(),
            *self._late(),
        ]

    def _constants(self) -> list[str]:
        constants = self.model.declared_constants
        return [f"constant {n} = {c.value!r} {c.unit}".rstrip() for n, c in constants.items()]

    def _late(self) -> list[str]:
        delays = self.model.delays
        lines = [f"{n} is {of}(t - {tau}): the caller delays it" for n, (of, tau) in delays.inputs.items()]
        return lines + [
            f"{n} is measured with the delay {tau}, which this code does not have" for n, tau in delays.outputs.items()
        ]

    def _shared(self) -> list[str]:
        used = self.graph.used
        found = [HELPERS[name] for name in HELPERS if name in used]
        tables = [k for k in range(len(self.graph.tables)) if f"table {k}" in used]
        if tables:
            found += [LOOKUP, *(definition(k, self.graph.tables[k]) for k in tables)]
        return found

    def _function(
        self,
        what: str,
        targets: Sequence[str],
        roots: Sequence[tuple[str, int]],
        zeros: Mapping[str, int] | None = None,
    ) -> str:
        used = self.graph.symbols(node for _, node in roots)
        symbols, lines = {"time": "t"}, []
        for name, (letter, k) in self.places.items():
            if name in used:
                symbols[name] = f"{letter}_{self.labels[letter][k]}"
                unit = self.vectors[letter][name]
                lines.append(
                    f"const double {symbols[name]} = {letter}[{k}];" + (f" /* {_comment(unit)} */" if unit else "")
                )
        for block, size in (zeros or {}).items():
            if size:
                lines.append(f"for (k = 0; k < {size}; ++k) {block}[k] = 0.0;")
        if any((zeros or {}).values()):
            lines.insert(0, "int k;")
        lines += self.graph.statements(roots, symbols, self.quantities)
        unused = [a for a in ("t", "x", "u", "p") if not _uses(lines, a)]
        set_here = {line.partition("[")[0] for line in lines} | {b for b, size in (zeros or {}).items() if size}
        unused += [a for a in targets if a not in set_here]
        lines += [f"(void){name};" for name in unused]
        return f"{self._signature(what, targets)} {{\n" + "\n".join(f"    {line}" for line in lines) + "\n}"

    def _signature(self, what: str, targets: Sequence[str]) -> str:
        given = "double t, const double *x, const double *u, const double *p"
        line = f"void {self.name}_{what}({given},"
        return f"{line}{_BREAK if len(targets) > 1 else ' '}{', '.join(f'double *{t}' for t in targets)})"

    def _step_signature(self) -> str:
        given = "double t, double h, const double *u0, const double *u1"
        return f"void {self.name}_step({given},{_BREAK}const double *p, double *x)"

    def _step(self) -> str:
        n_x, n_u = (max(len(self.vectors[letter]), 1) for letter in "xu")
        move = f"for (i = 0; i < {self.big}_N_X; ++i)"
        call = f"{self.name}_dynamics"
        return f"""{self._step_signature()} {{
    double a[{n_x}], b[{n_x}], c[{n_x}], d[{n_x}], at[{n_x}], u[{n_u}] = {{0.0}};
    int i;
    for (i = 0; i < {self.big}_N_U; ++i) u[i] = 0.5 * (u0[i] + u1[i]);
    {call}(t, x, u0, p, a);
    {move} at[i] = x[i] + 0.5 * h * a[i];
    {call}(t + 0.5 * h, at, u, p, b);
    {move} at[i] = x[i] + 0.5 * h * b[i];
    {call}(t + 0.5 * h, at, u, p, c);
    {move} at[i] = x[i] + h * c[i];
    {call}(t + h, at, u1, p, d);
    {move} x[i] += h / 6.0 * (a[i] + 2.0 * b[i] + 2.0 * c[i] + d[i]);
}}"""

    def _data(self) -> list[str]:
        found = [self._numbers("p", self.contents.values), self._numbers("x0", self.contents.states)]
        for letter, group in self.vectors.items():
            for what, words in (("names", list(group)), ("units", list(group.values()))):
                rows = ",\n".join(f"    {_string(word)}" for word in words) or "    0"
                found.append(f"const char *const {self.name}_{letter}_{what}[{max(len(words), 1)}] = {{\n{rows}\n}};")
        return found

    def _numbers(self, what: str, values: Mapping[str, float]) -> str:
        units = self.vectors["p" if what == "p" else "x"]
        last = len(units) - 1
        rows = "\n".join(
            f"    {number(values[n])}{',' if k < last else ''} /* {_comment(f'{n}, {unit}' if unit else n)} */"
            for k, (n, unit) in enumerate(units.items())
        )
        return f"const double {self.name}_{what}[{max(len(units), 1)}] = {{\n{rows or '    0.0'}\n}};"

    def _header(self) -> str:
        counts = "\n".join(f"#define {self.big}_N_{k.upper()} {len(group)}" for k, group in self.vectors.items())
        places = []
        for letter, group in self.vectors.items():
            lines = [
                f"#define {self.big}_{letter.upper()}_{label} {k}" + (f" /* {_comment(unit)} */" if unit else "")
                for k, (label, unit) in enumerate(zip(self.labels[letter], group.values(), strict=True))
            ]
            if lines:
                places.append("\n".join(lines))
        sizes = {"p": "p", "x0": "x"}
        data = [f"extern const double {self.name}_{k}[{max(len(self.vectors[v]), 1)}];" for k, v in sizes.items()]
        for letter, group in self.vectors.items():
            for what in ("names", "units"):
                data.append(f"extern const char *const {self.name}_{letter}_{what}[{max(len(group), 1)}];")
        functions = [
            "/* dx = f(t, x, u, p), per s */",
            f"{self._signature('dynamics', ['dx'])};",
            "/* y = g(t, x, u, p) */",
            f"{self._signature('outputs', ['y'])};",
            "/* A = df/dx, B = df/du, C = dg/dx, D = dg/du, row by row */",
            f"{self._signature('jacobians', list('ABCD'))};",
            "/* x from t to t + h by one Runge-Kutta step of order 4; "
            "inputs run\n   from u0 to u1, and one that is held between samples has the same value in both */",
            f"{self._step_signature()};",
        ]
        parts = [
            f"#ifndef {self.big}_H\n#define {self.big}_H",
            '#ifdef __cplusplus\nextern "C" {\n#endif',
            f"/* Numbers of states, inputs, parameters and outputs */\n{counts}",
            "/* The place of each, and its unit */\n" + "\n\n".join(places),
            "/* Parameters, states to begin with, names and units */\n" + "\n".join(data),
            "\n".join(functions),
            "#ifdef __cplusplus\n}\n#endif",
            f"#endif /* {self.big}_H */",
        ]
        return "\n\n".join(parts) + "\n"


def _uses(lines: Sequence[str], name: str) -> bool:
    pattern = re.compile(rf"\b{name}\b(?!\w)")
    return any(pattern.search(re.sub(r"/\*.*?\*/", "", line)) for line in lines)


def _unique(names: Any) -> list[str]:
    """Return names as parts of identifiers in C, all different."""
    found: list[str] = []
    for name in names:
        label = re.sub(r"\W+", "_", str(name), flags=re.ASCII) or "_"
        while label in found:
            label += "_"
        found.append(label)
    return found


def _string(text: str) -> str:
    """Return a literal in C; characters beyond ASCII become the bytes of UTF-8 in octal."""
    shown = "".join(chr(b) if 32 <= b < 127 and chr(b) not in '"\\?' else f"\\{b:03o}" for b in text.encode("utf-8"))
    return f'"{shown}"'


def _comment(text: str) -> str:
    return text.replace("*/", "* /").replace("/*", "/ *").replace("\n", " ")


def export_c(
    fit: FitResult | Model,
    folder: str | os.PathLike[str],
    parameters: Mapping[str, Any] | None = None,
    *,
    name: str | None = None,
    experiment: str | None = None,
    delayed_inputs: bool = False,
    late_inputs: bool = False,
) -> tuple[Path, Path]:
    """Write ``<name>.h`` and ``<name>.c``; return their paths. The folder is created where it does not exist.

    There are, for n_x states, n_u inputs, n_y outputs and n_p parameters (``<NAME>_N_X``, ...; ``<NAME>_X_<state>`` is
    the place of a state):

    ``<name>_dynamics(t, x, u, p, dx)``      dx = f, per s
    ``<name>_outputs(t, x, u, p, y)``        y = g
    ``<name>_jacobians(t, x, u, p, A, B, C, D)``  df/dx, df/du, dg/dx, dg/du, exact, row by row
    ``<name>_step(t, h, u0, u1, p, x)``      one classical Runge-Kutta step of x from t to t + h (order 4), over which
                                             inputs run linearly from u0 to u1; one that is held has one value in both
    ``<name>_p``, ``<name>_x0``              values of the parameters, and states to begin with
    ``<name>_x_names``, ``<name>_x_units``   and of u, y, p likewise

    All arrays are double; no memory is allocated, and no state is kept between calls. Sub-expressions that are used
    more than once are computed once. Values are those of phugoid up to rounding: math.h is the platform's.

    ``parameters``, ``experiment``  as in `linearise`; ``x0`` is the initial state of that experiment, 0 without a fit.
    ``name``         prefix of files and functions; made from the model's name unless given.
    ``delayed_inputs``  of a model with delays: take each delayed input, u(t - tau), as an input of its own, which the
                     caller delays, and leave delays of sensors to the caller too.

    Raises ModelError for a model with delays otherwise, and where values are missing or each experiment has its own;
    OptionError for a name that is invalid in C; DataError where the files cannot be written.
    """
    contents = contents_of("export_c", fit, parameters, experiment, delayed_inputs or renamed("export_c", late_inputs))
    code = source(contents, identifier(contents.model.name) if name is None else checked_name(name))
    target = Path(folder)
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"{folder}: the source cannot be written ({error.strerror})") from error
    paths = target / f"{code.name}.h", target / f"{code.name}.c"
    for path, text in zip(paths, (code.header, code.source), strict=True):
        write(path, text, "the source")
    return paths
