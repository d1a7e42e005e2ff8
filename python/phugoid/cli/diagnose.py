"""``phugoid diagnose``: finds what the model of a fit misses."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from ..api import diagnose as find_missing
from ..api import load_fit
from ..errors import OptionError
from ..result import Diagnosis, Fit
from .estimation import Estimation
from .fit import code_of
from .guard import INTERRUPTED, NOT_CONVERGED
from .model_file import load_source
from .options import JsonOption, ModelArgument, Reading, ReportOption
from .results import check_saved, check_targets, emit_json, finish, fit_facts, saved

__all__ = ["diagnose"]


def diagnose(
    model: ModelArgument,
    data: Annotated[
        list[Path] | None, typer.Argument(help="Data files; none where MODEL is a saved fit.", metavar="DATA...")
    ] = None,
    fit: Annotated[Path | None, typer.Option("--fit", help="A saved fit of the model to start from.")] = None,
    validation: Annotated[
        list[Path] | None, typer.Option("--validation", help="Another record, to measure the gain on.")
    ] = None,
    *,
    how: Estimation,
    reading: Reading,
    save: Annotated[
        Path | None, typer.Option("--save", help="Writes the diagnosis, for phugoid.load: .json, or .h5 (HDF5).")
    ] = None,
    report: ReportOption = None,
    json: JsonOption = False,
) -> int:
    """Name what a model misses: shows the misfit, its cause among some 250 candidates, and the gain.

    Exit code 1: the fit has not converged, or the residuals have structure and no cause is named.
    """
    check_saved(save, "diagnosis")
    check_targets((), [save], report)
    base = _base(model, reading, data or [], fit, how)
    others = reading.read(validation) if validation else None
    if base.status not in ("converged", "acceptable"):
        if json:
            emit_json("diagnose", {"fit": fit_facts(base), "findings": None})
        else:
            print(f"{base.summary()}\n\nThere is nothing to diagnose: a diagnosis needs a converged fit.")
        return code_of(base) or NOT_CONVERGED
    with _steps() as watch:
        found = find_missing(base, validation=others, progress=watch)
    writers = [saved(found.save, save), saved(found.report, report)]
    finish("diagnose", found, partial(_facts, found) if json else None, writers)
    return _code(found)


def _base(model: str, reading: Reading, data: list[Path], saved: Path | None, how: Estimation) -> Fit:
    """Return the fit to diagnose: the saved one where no data are given, else one estimated from the data, with a saved
    fit as start."""
    source = load_source(model)
    before = load_fit(saved) if saved is not None else source if isinstance(source, Fit) else None
    if not data:
        if isinstance(source, Fit) and saved is None:
            how.check_unused(model)
            return source
        raise OptionError(f"{model} is a model: give data files to fit it to")
    described = source.model if isinstance(source, Fit) else source
    return how.run(described, reading.read(data), before)


@contextmanager
def _steps() -> Iterator[Callable[[str], None]]:
    """Yield a function to call with each step: it updates a status line on a terminal, or prints a line to stderr
    elsewhere."""
    if not sys.stderr.isatty():
        yield lambda text: print(f"diagnose: {text}", file=sys.stderr)
        return
    from rich.console import Console

    with Console(stderr=True).status("diagnose") as status:
        yield status.update


def _code(found: Diagnosis) -> int:
    if found.interrupted:
        return INTERRUPTED
    return NOT_CONVERGED if found.verdict == "unexplained" else 0


def _facts(found: Diagnosis) -> dict[str, Any]:
    kept = (
        "cause",
        "aliases",
        "status",
        "coefficient",
        "std_error",
        "interval",
        "unit",
        "parameters",
        "gain",
        "held_out_gain",
        "explained",
        "explained_interval",
        "explained_outputs",
        "rivals_explained",
        "threshold",
        "explanation",
        "advice",
        "ringing",
    )
    ranking = [{"name": s.name, "statistic": s.statistic, "ranking": s.ranking} for s in found.ranking[:20]]
    return {
        "fit": fit_facts(found.fit),
        "found": found.found,
        "verdict": found.verdict,
        "findings": [{key: getattr(f, key) for key in kept} for f in found.findings],
        "ranking": ranking,
        "threshold": found.threshold,
        "interrupted": found.interrupted,
        "notes": list(found.notes),
        "seconds": found.seconds,
    }
