"""Tables in terminals of any width."""

from __future__ import annotations

import io
import logging
from contextlib import redirect_stderr

import pytest
from rich.console import Console
from rich.table import Column

from dockctl import cli
from dockctl.console import make_table, numeric, print_table

HEADER = ("first", "second", "difference", "95 % interval", "pairs")
CELLS = ("12.54", "4.17", "−8.37", "−9.22 to −7.56", "1,000")


@pytest.mark.parametrize("width", [48, 60, 80, 120])
@pytest.mark.parametrize("no_wrap", [False, True])
def test_no_cell_is_cut_off_in_a_narrow_terminal(width: int, no_wrap: bool) -> None:
    table = make_table(Column("", no_wrap=no_wrap), *numeric(*HEADER))
    table.add_row("propeller change per step [N]", *CELLS)
    stream = io.StringIO()
    print_table(Console(file=stream, width=width), table)
    text = stream.getvalue()
    assert all(cell in text for cell in (*HEADER, *CELLS)), text
    assert max(map(len, text.splitlines())) <= width


def test_notes_go_through_what_replaces_standard_error() -> None:
    handler = cli._Notes()
    with redirect_stderr(io.StringIO()) as stream:  # as a spinner does as long as it turns
        handler.handle(logging.makeLogRecord({"msg": "building the table"}))
    assert stream.getvalue() == "building the table\n"
