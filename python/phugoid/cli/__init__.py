"""The application that the command ``phugoid`` runs."""

from __future__ import annotations

from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

import phugoid._core as _core

__all__ = [
    "COMMANDS",
    "app",
    "main",
]


# Command -> its module, and the line on it in the list. Modules are imported for the command that is run, since all of
# them take half a second.
COMMANDS = {
    "fit": ("commands", "Estimate the parameters of a model from one or more data files."),
    "diagnose": ("commands", "Find physical effects that a fitted model misses."),
    "simulate": ("commands", "Simulate a model with the inputs of a data file."),
    "validate": ("commands", "Validate a fitted model on other records."),
    "petab": ("petab", "Estimate a problem in the PEtab format from many starts."),
    "example": ("example", "Write an example: a model file, two simulated records and a page."),
}


class _Commands(TyperGroup):
    """The commands, of which only the one that is run is imported."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the name of the command, the command itself in place of its line in the list, and its arguments."""
        name, _, rest = super().resolve_command(ctx, args)
        return name, None if name is None else _imported(name), rest


def _imported(name: str) -> Any:
    from .results import command

    one = typer.Typer(add_completion=False, rich_markup_mode=None)
    one.command(name)(command(getattr(import_module(f".{COMMANDS[name][0]}", __package__), name)))
    made: Any = typer.main.get_command(one)
    for parameter in made.params:  # typer would write "<list[Path]>" beside the name of an argument
        if parameter.param_type_name == "argument":
            parameter.display_type = lambda ctx: None
    return made


def _listed() -> None:
    """Stand for a command in the list."""


app = typer.Typer(
    name="phugoid",
    help="Estimate the parameters of flight vehicles, and of any system of ODEs, from measured data.",
    epilog="Exit codes: 0 converged; 1 not converged, or nothing to conclude; 2 bad input; 130 interrupted.",
    cls=_Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
    rich_markup_mode=None,
)
for _name, (_, _line) in COMMANDS.items():
    app.command(_name, help=_line)(_listed)


def _version(asked: bool) -> None:
    if asked:
        print(f"phugoid {_core.__version__}")
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool, typer.Option("--version", help="Show the version and exit.", is_eager=True, callback=_version)
    ] = False,
) -> None:
    pass


def main() -> None:
    """Run the application; the entry point of the installed command."""
    app(prog_name="phugoid")
