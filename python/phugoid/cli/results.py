"""Output of the commands: JSON on stdout, and the figures and files that were asked for."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from .. import _core
from ..errors import OptionError, PhugoidError
from ..match import Match, match
from ..parameters import Estimates
from ..result import Fit
from ..saving.json_file import SUFFIXES
from ..summary import corrected
from ..writing import PAGES, check_suffix, drawn, write
from .guard import printed_summary

__all__ = ["check_saved", "check_targets", "emit_json", "finish", "fit_facts", "match_facts", "save_figures", "saved"]


def check_saved(path: Path | None, what: str) -> None:
    """Raise OptionError, before any work is done, for a suffix that ``--save`` does not support."""
    if path is not None and path.suffix.lower() not in (".json", *SUFFIXES):
        raise OptionError(f"--save {path}: a saved {what} ends in .json, {' or '.join(SUFFIXES)}")


def check_targets(
    figures: Sequence[Path | None] = (), others: Sequence[Path | None] = (), report: Path | None = None
) -> None:
    """Raise OptionError, before any work is done, for a file that could not be written, or a report that is no page."""
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
        found[name]["coloured_std_error"] = e.std_error
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
