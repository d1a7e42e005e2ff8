"""Run a command and print its results: exit codes, errors as one clear line, JSON, figures and saved files."""

from __future__ import annotations

import json
import math
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from functools import wraps
from inspect import Parameter, Signature
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import typer

import phugoid._core as _core

from ..errors import OptionError, PhugoidError
from ..goodness_of_fit import Match, match
from ..parameters import Estimates
from ..result import Fit
from ..saving.files import SUFFIXES
from ..solvers import interrupts
from ..summary import corrected
from ..writing import PAGES, check_suffix, drawn, write
from .options import as_options

__all__ = [
    "INTERRUPTED",
    "NOT_CONVERGED",
    "annotations_of",
    "check_saved",
    "check_targets",
    "command",
    "emit_json",
    "finish",
    "fit_facts",
    "match_facts",
    "printed_summary",
    "save_figures",
    "saved",
]

NOT_CONVERGED = 1
BAD_INPUT = 2
INTERRUPTED = 130  # 128 + SIGINT, as shells have it


_DEBUG = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")]


def annotations_of(declared: Any) -> dict[str, Any]:
    """Return the annotations of a function or a class by name, with what typer reads of them.

    Python 3.10 makes a type with the default None optional, which would hide that it is an argument or an option.
    """
    hints = get_type_hints(declared, include_extras=True)
    return {n: next((a for a in get_args(kind) if get_origin(a) is Annotated), kind) for n, kind in hints.items()}


def command(function: Callable[..., int | None]) -> Callable[..., None]:
    """Return the function that typer runs, made of a function that returns an exit code (None: 0).

    A parameter of a dataclass stands for the options that the fields of the class are; ``--debug`` is added.
    """
    hints = annotations_of(function)
    groups: dict[str, Any] = {name: kind for name, kind in hints.items() if is_dataclass(kind)}
    parameters: list[Parameter] = []
    for p in Signature.from_callable(function).parameters.values():
        if p.name in groups:
            of = annotations_of(groups[p.name])
            options = [(field.name, field.default, of[field.name]) for field in fields(groups[p.name])]
        else:
            options = [(p.name, p.default, hints[p.name])]
        parameters += [Parameter(n, Parameter.KEYWORD_ONLY, default=d, annotation=kind) for n, d, kind in options]
    parameters.append(Parameter("debug", Parameter.KEYWORD_ONLY, default=False, annotation=_DEBUG))

    @wraps(function)
    def called(debug: bool, **given: Any) -> None:
        with guard(debug):
            made = {n: kind(**{f.name: given.pop(f.name) for f in fields(kind)}) for n, kind in groups.items()}
            code = function(**made, **given)
        raise typer.Exit(code or 0)

    called.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    called.__annotations__ = {p.name: p.annotation for p in parameters}
    return called


@contextmanager
def guard(debug: bool) -> Iterator[None]:
    """Turn errors of phugoid and of the file system into a line on stderr and exit code 2, and Ctrl-C into 130.

    ``debug`` shows the traceback too. Other errors are faults of phugoid itself, and pass.
    """
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _warn  # type: ignore[assignment]
            yield
    except BrokenPipeError:  # the reader of stdout, such as `head`, has closed it; typer ends quietly
        raise
    except (PhugoidError, OSError) as error:
        if debug:
            traceback.print_exc()
        # A message of several lines, as of an equation with its place, is printed whole.
        print(f"phugoid: {_text(error)}", file=sys.stderr)
        raise typer.Exit(BAD_INPUT) from None
    except KeyboardInterrupt:
        print("phugoid: interrupted", file=sys.stderr)
        raise typer.Exit(INTERRUPTED) from None


def _warn(message: Warning | str, *_: Any) -> None:
    """Print a warning of the package as a line on stderr, without the source code that raised it."""
    print(f"phugoid: warning: {as_options(str(message))}", file=sys.stderr)


def printed_summary(result: Any) -> str:
    """Return the summary of a result; where Ctrl-C interrupts it, a short listing of the parameters."""
    try:
        return str(result.summary())
    except KeyboardInterrupt:
        with interrupts():
            parameters = getattr(result, "parameters", {})
            return "\n".join(
                [repr(result), *(f"  {e.name} = {e.value:.6g} {e.unit}".rstrip() for e in parameters.values())]
            )


def _text(error: Exception) -> str:
    if isinstance(error, OSError) and not isinstance(error, PhugoidError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return as_options(str(error)) or type(error).__name__


def check_saved(path: Path | None, what: str) -> None:
    """Raise OptionError, before any work is done, for a suffix that ``--save`` does not support."""
    if path is not None and path.suffix.lower() not in (".json", *SUFFIXES):
        raise OptionError(f"--save {path}: a saved {what} ends in .json, {' or '.join(SUFFIXES)}")


def check_targets(
    figures: Sequence[Path | None] = (), others: Sequence[Path | None] = (), report: Path | None = None
) -> None:
    """Raise OptionError, before any work is done, for a file that could not be written, or a report not HTML."""
    for path in (p for p in (*figures, *others, report) if p is not None):
        if not path.resolve().parent.is_dir():
            raise OptionError(f"{path}: cannot be written, since there is no folder {path.resolve().parent}")
        if path.is_dir():
            raise OptionError(f"{path}: is a folder, not a file to write")
    if report is not None:
        check_suffix(report, PAGES, "a report")
    paths = [p for p in figures if p is not None]
    if paths:
        import matplotlib

        matplotlib.use("Agg")  # no window: figures go to files
        from matplotlib.figure import Figure

        known = Figure().canvas.get_supported_filetypes()
        for path in paths:
            if path.suffix[1:].lower() not in known:
                raise OptionError(f"{path}: a figure's file ends in one of {', '.join('.' + k for k in sorted(known))}")


def save_figures(result: Any, path: Path | None) -> list[Path]:
    """Write the proof of match of each experiment to ``path``, or to ``path`` with the name of each; return the
    paths."""
    if path is None:
        return []
    import matplotlib.pyplot as plt

    written = []
    for i, record in enumerate(result.records):
        name = "".join(c if c.isalnum() or c in "-_." else "_" for c in record.name)
        target = path if len(result.records) == 1 else path.with_stem(f"{path.stem}-{name}")
        figure, _ = result.plot(i)
        write(target, drawn(figure, target, dpi=150), "the figure")
        plt.close(figure)
        written.append(target)
    return written


def emit_json(command: str, facts: Mapping[str, Any], written: Sequence[Path] = ()) -> None:
    """Print one JSON document to stdout; NaN and infinities, which JSON does not have, become null."""
    document = {"command": command, "phugoid": _core.__version__, **facts, "written": [str(p) for p in written]}
    print(json.dumps(_plain(document), ensure_ascii=False, indent=1, allow_nan=False))


def finish(
    command: str,
    result: Any,
    facts: Callable[[], Mapping[str, Any]] | None,
    writers: Sequence[Callable[[], list[Path]]],
) -> None:
    """Write the files asked for, then print the result: as JSON where there are ``facts``, else as its summary.

    Files come first, since the reader of stdout may stop before its end. Where one cannot be written, or Ctrl-C is
    pressed, the result is printed all the same: the work is done.
    """
    written: list[Path] = []

    def print_result() -> None:
        if facts is not None:
            emit_json(command, facts(), written)
            return
        print(printed_summary(result))
        if written:
            print(f"\nWritten: {', '.join(map(str, written))}")

    try:
        for write_files in writers:
            written += write_files()
    except (PhugoidError, OSError, KeyboardInterrupt):
        print_result()
        raise
    print_result()


def saved(save: Callable[[Path], object], path: Path | None) -> Callable[[], list[Path]]:
    """Return a function that writes one file with ``save``; it does nothing without a path."""

    def write_file() -> list[Path]:
        if path is None:
            return []
        save(path)
        return [path]

    return write_file


def fit_facts(fit: Fit) -> dict[str, Any]:
    """Return a fit as plain values for JSON."""
    return {
        "model": fit.model.name,
        "status": fit.status,
        "converged": fit.converged,
        "message": fit.message,
        "iterations": fit.iterations,
        "seconds": fit.time,
        "log_likelihood": fit.log_likelihood,
        "transcription": str(fit.transcription),
        "parameters": _estimates(fit.parameters, corrected(fit)),
        "initial_states": {name: _estimates(group) for name, group in fit.initial_states.items()},
        "matches": match_facts({name: match(fit.records, name) for name in fit.model.output_names}),
        "experiments": [{"name": r.name, "samples": r.n} for r in fit.records],
        "warnings": list(fit.warnings),
    }


def match_facts(matches: Mapping[str, Match]) -> dict[str, Any]:
    """Return the goodness of fit of each output as plain values for JSON."""
    kept = ("unit", "samples", "rms", "r_squared", "theil", "lag_one", "whiteness")
    return {name: {key: getattr(m, key) for key in kept} for name, m in matches.items()}


def _estimates(group: Estimates, coloured: Estimates | None = None) -> dict[str, Any]:
    kept = ("value", "std_error", "unit", "fixed", "bounds_active")
    found = {name: {key: getattr(e, key) for key in kept} for name, e in group.items()}
    for name, e in (coloured or {}).items():
        found[name]["corrected_std_error"] = e.std_error
        found[name]["coloured_std_error"] = e.std_error  # its name until 0.2
    return found


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    return value
