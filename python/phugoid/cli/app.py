"""The application that the command ``phugoid`` runs."""

from __future__ import annotations

from typing import Annotated

import typer

import phugoid._core as _core

from .example import example
from .fit import diagnose, fit, validate
from .petab import petab
from .results import command
from .simulate import simulate

__all__ = ["app", "main"]

app = typer.Typer(
    name="phugoid",
    help="Finds the parameters of flight vehicles, and of any system of ODEs, from measured data.",
    epilog="Exit codes: 0 converged; 1 not converged, or nothing to conclude; 2 bad input; 130 interrupted.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
    rich_markup_mode=None,
)
for each in (fit, diagnose, simulate, validate, petab, example):
    app.command()(command(each))


def _version(asked: bool) -> None:
    if asked:
        print(f"phugoid {_core.__version__}")
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool, typer.Option("--version", help="Shows the version.", is_eager=True, callback=_version)
    ] = False,
) -> None:
    pass


def main() -> None:
    """Run the application; the entry point of the installed command."""
    app(prog_name="phugoid")
