"""Plain lines and tables on the terminal."""

from __future__ import annotations

import io
import os
import re
import shlex
import textwrap
from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import replace
from typing import Self

from rich import box
from rich.console import Console, RenderableType
from rich.measure import Measurement
from rich.table import Column, Table
from rich.text import Text

WIDE = Console(width=10_000)
"""Console for measuring widths."""
CONTROLS = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
"""Characters in untrusted text that control a terminal or reverse the text direction."""


class SafeStream(io.TextIOWrapper):
    """A standard stream that does not end the command when it fails, on a full disk or a closed pipe.

    Attributes:
        failure: the first error; what follows it is discarded.
    """

    failure: OSError | None = None

    @classmethod
    def wrap(cls, stream: io.TextIOWrapper) -> Self:
        """Return a replacement for `stream` that escapes characters that its encoding does not have."""
        errors, buffered = "backslashreplace", stream.line_buffering
        return cls(stream.detach(), stream.encoding, errors, line_buffering=buffered)

    def write(self, text: str) -> int:
        try:
            return super().write(text)
        except OSError as error:
            self._discard(error)
            return len(text)

    def flush(self) -> None:
        try:
            super().flush()
        except OSError as error:
            self._discard(error)

    def _discard(self, error: OSError) -> None:
        self.failure = self.failure or error
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, self.fileno())
        os.close(null)


def count(number: int, noun: str) -> str:
    """Return ``1 episode``, ``2 episodes``."""
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def command_line(*words: object) -> str:
    """Return a command of dockctl that can be pasted into a shell."""
    return shlex.join(["dockctl", *map(str, words)])


def printable(text: str) -> str:
    """Return the text with control characters shown as their codes."""
    return CONTROLS.sub(lambda found: f"\\x{ord(found[0]):02x}", text)


def print_text(console: Console, text: str, style: str = "") -> None:
    """Print `text` literally, without markup or highlighting; on a terminal, lines wrap between words.

    Words longer than a line, such as paths, and indented lines, which are commands, are not broken. Control
    characters are shown as their codes.
    """
    for line in text.splitlines():
        if console.is_terminal and not line.startswith(" "):
            line = textwrap.fill(line, console.width, break_long_words=False, break_on_hyphens=False)
        console.print(Text(printable(line), style=style), soft_wrap=True)


def print_notes(notes: Iterable[str]) -> None:
    """Print what the user should know, each note once, on standard error."""
    for note in dict.fromkeys(notes):
        print_text(Console(stderr=True), f"note: {note}", "yellow")


def print_table(console: Console, table: Table) -> None:
    """Print a table if it has rows; one that is too wide is printed in parts, each with the first column.

    Columns that do not fit beside the first are printed last, as lines below its cells. As in `print_text`,
    words longer than a line, such as paths, are left for the terminal to break.
    Cells of type `str` are markup; untrusted text has type `Text`, with control characters as codes.
    """
    for cell in (cell for column in table.columns for cell in column.cells if isinstance(cell, Text)):
        cell.plain = printable(cell.plain)
    if not table.rows:
        return
    first, *others = table.columns
    parts: list[list[Column]] = []
    below: list[Column] = []
    for column in others:
        if _least_width(_part(table, [first, column])) > console.width:
            below.append(column)
        elif parts and _least_width(_part(table, [first, *parts[-1], column])) <= console.width:
            parts[-1].append(column)
        else:
            parts.append([column])
    for number, columns in enumerate(parts if others else [[]]):
        part = _part(table, [first, *columns])
        if number:
            part.title = None
        console.print(_fitted(part, console.width), crop=False)
    if below:
        if not parts and table.title:
            console.print(table.title, style="table.title")
        _print_below(console, first, below)


def _print_below(console: Console, first: Column, others: Sequence[Column]) -> None:
    """Print each cell of the first column, and below it the cells of the others with their names."""
    indent = 2 + max(len(str(column.header)) for column in others)
    for title, *cells in zip(*(column.cells for column in (first, *others)), strict=True):
        console.print(_text(title), soft_wrap=True)
        for column, cell in zip(others, map(_text, cells), strict=True):
            width, breaking = max(1, console.width - indent), column.min_width is not None
            lines = textwrap.wrap(cell.plain, width, break_long_words=breaking, break_on_hyphens=False)
            for name, line in zip((str(column.header), *[""] * len(lines)), lines, strict=False):
                console.print(Text(f" {name}".ljust(indent)).append(line, cell.style), soft_wrap=True)
    console.print()


def _text(cell: RenderableType) -> Text:
    return cell if isinstance(cell, Text) else Text.from_markup(str(cell))


def _part(table: Table, columns: Sequence[Column]) -> Table:
    part = copy(table)
    part.columns = [replace(column, _index=index) for index, column in enumerate(columns)]
    return part


def _least_width(table: Table) -> int:
    """Return the width below which Rich cuts cells; Rich's own measure also shrinks unwrappable columns."""
    return _width(table, [low for low, _ in _widths(table)])


def _fitted(table: Table, width: int) -> Table:
    """Return the table with the widest columns narrowed to `width`, but none below its longest word.

    Rich itself would narrow columns regardless of their words, and break them.
    """
    spans = _widths(table)
    for limit in range(width, 0, -1):
        chosen = [max(low, min(high, limit)) for low, high in spans]
        if _width(table, chosen) <= width:
            break
    fitted = _with_widths(table, chosen)
    fitted.width = _width(table, chosen)
    return fitted


def _widths(table: Table) -> list[tuple[int, int]]:
    """Return the width of the longest word and line of each column; both of the line if it cannot wrap.

    A column with `min_width` may break longer words.
    """
    spans = []
    for column in table.columns:
        cells = [Measurement.get(WIDE, WIDE.options, cell) for cell in (column.header, *column.cells)]
        high = max(cell.maximum for cell in cells)
        low = high if column.no_wrap else max(cell.minimum for cell in cells)
        spans.append((min(low, column.min_width or low), high))
    return spans


def _width(table: Table, widths: Sequence[int]) -> int:
    return Measurement.get(WIDE, WIDE.options, _with_widths(table, widths)).maximum


def _with_widths(table: Table, widths: Sequence[int]) -> Table:
    columns = zip(table.columns, widths, strict=True)
    return _part(table, [replace(column, width=width) for column, width in columns])


def make_table(*columns: str | Column, title: str | Text | None = None) -> Table:
    """Return an empty table in the style of all commands."""
    return Table(*columns, title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))


def numeric(*names: str) -> list[Column]:
    """Return right-aligned columns that do not wrap."""
    return [Column(name, justify="right", no_wrap=True) for name in names]
