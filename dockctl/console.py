"""Plain lines and tables on the terminal."""

from __future__ import annotations

import io
import os
import shlex
from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from typing import Self

from rich import box
from rich.console import Console
from rich.measure import Measurement
from rich.table import Column, Table
from rich.text import Text


class SafeStream(io.TextIOWrapper):
    """A standard stream that does not end the command when it fails, on a full disk or a closed pipe.

    Attributes:
        failure: the first error; what follows it is discarded.
    """

    failure: OSError | None = None

    @classmethod
    def wrap(cls, stream: io.TextIOWrapper) -> Self:
        """Return a replacement for `stream`."""
        return cls(stream.detach(), stream.encoding, stream.errors, line_buffering=stream.line_buffering)

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


def print_text(console: Console, text: str, style: str = "") -> None:
    """Print `text` literally: without markup, highlighting or wrapping, so that paths stay intact."""
    console.print(Text(text, style=style), soft_wrap=True)


def print_table(console: Console, table: Table) -> None:
    """Print a table; one that is too wide is printed in parts, each with the first column."""
    first, *others = table.columns
    parts: list[list[Column]] = [[]]
    for column in others:
        if parts[-1] and _least_width(_part(table, [first, *parts[-1], column])) > console.width:
            parts.append([])
        parts[-1].append(column)
    for number, columns in enumerate(parts):
        part = _part(table, [first, *columns])
        if number:
            part.title = None
        console.print(part)


def _part(table: Table, columns: Sequence[Column]) -> Table:
    part = copy(table)
    part.columns = [replace(column, _index=index) for index, column in enumerate(columns)]
    return part


def _least_width(table: Table) -> int:
    """Return the width below which Rich cuts cells; its own measure lets columns shrink that do not wrap."""
    wide = Console(width=10_000)

    def needed(column: Column) -> int:
        cells = [Measurement.get(wide, wide.options, cell) for cell in (column.header, *column.cells)]
        return max(cell.maximum if column.no_wrap else cell.minimum for cell in cells)

    cut = _part(table, [replace(column, min_width=needed(column)) for column in table.columns])
    return Measurement.get(wide, wide.options, cut).minimum


def make_table(*columns: str | Column, title: str | Text | None = None) -> Table:
    """Return an empty table in the style of all commands."""
    return Table(*columns, title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))


def numeric(*names: str) -> list[Column]:
    """Return right-aligned columns that do not wrap."""
    return [Column(name, justify="right", no_wrap=True) for name in names]
