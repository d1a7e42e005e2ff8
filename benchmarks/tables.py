"""Tables on the terminal, and peers that may be missing."""

import statistics
import sys

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

console = Console(width=None if sys.stdout.isatty() else 110, highlight=False)


def show(title, columns, rows, note=""):
    """Print a table of text: the first column to the left, the others to the right; a note below."""
    table = Table(
        title=title, title_justify="left", title_style="bold", caption=note, caption_justify="left",
        box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0),
    )  # fmt: skip
    for i, column in enumerate(columns):
        table.add_column(column, justify="right" if i else "left", no_wrap=not i)
    for row in rows:
        table.add_row(*(escape(str(cell)) for cell in row))
    console.print(table)
    console.print()


def attempt(name, function, *arguments):
    """What `function` returns; where it fails the reason is printed, and None returned: a peer is skipped."""
    try:
        return function(*arguments)
    except Exception as error:
        reason = str(error).strip().split("\n")[0]
        console.print(escape(f"skipped {name}: {type(error).__name__}: {reason}"))
        return None


def seconds(value):
    """Text of a time in s, three digits; milliseconds below 1 s."""
    return "-" if value is None else f"{value:.3g} s" if value >= 0.9995 else f"{1e3 * value:.3g} ms"


def times(base, mine):
    """Text of how many times faster `mine` is than `base`."""
    return "-" if not base or not mine else f"{base / mine:.2f}"


def median(values):
    """Median as a plain float."""
    return float(statistics.median(values))
