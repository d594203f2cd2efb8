"""Plain lines and tables on the terminal."""

from __future__ import annotations

from rich import box
from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

MIN_WIDTH = 80
"""Columns that the tables need. On a narrower terminal lines wrap, and no number is truncated."""


def print_text(console: Console, text: str, style: str = "") -> None:
    """Print `text` literally: without markup, highlighting or wrapping, so that paths stay intact."""
    console.print(Text(text, style=style), soft_wrap=True)


def table_console() -> Console:
    """Return a console that is wide enough for the tables."""
    console = Console()
    console.width = max(console.width, MIN_WIDTH)
    return console


def make_table(*columns: str | Column, title: str | Text | None = None) -> Table:
    """Return an empty table in the style of all commands."""
    return Table(*columns, title=title, title_justify="left", box=box.SIMPLE_HEAD)


def numeric(*names: str) -> list[Column]:
    """Return right-aligned columns that do not wrap."""
    return [Column(name, justify="right", no_wrap=True) for name in names]
