"""Tables in terminals of any width."""

from __future__ import annotations

import io
import logging
from contextlib import redirect_stderr

import pytest
from rich.console import Console
from rich.table import Column
from rich.text import Text

from dockctl import cli
from dockctl.console import SafeStream, make_table, numeric, print_table, print_text

HEADER = ("first", "second", "difference", "95 % interval", "pairs")
CELLS = ("12.54", "4.17", "−8.37", "−9.22 to −7.56", "1,000")


def test_characters_that_the_encoding_lacks_are_escaped() -> None:
    content = io.BytesIO()
    stream = SafeStream.wrap(io.TextIOWrapper(content, encoding="ascii"))
    print("1.5 m … é", file=stream, flush=True)
    assert content.getvalue() == rb"1.5 m \u2026 \xe9" + b"\n"


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


def test_narrow_columns_break_between_words() -> None:
    """Columns of 24, 25 and 12 characters at most; their longest words need 10, 12 and 12."""
    table = make_table(*(Column(name, overflow="fold") for name in ("first", "second", "third")))
    table.add_row("one two three four seven", "lateral_area frontal_area", "incremental_")
    stream = io.StringIO()
    print_table(Console(file=stream, width=40), table)
    text = stream.getvalue()
    assert all(
        word in text.split() for word in ("three", "seven", "lateral_area", "frontal_area", "incremental_")
    )
    assert max(map(len, text.splitlines())) <= 40


def test_paths_stay_whole() -> None:
    path = "/home/somebody/a-long-folder/scenarios/marina.yaml"
    table = make_table("name", Column("source", overflow="fold"), "kind")
    table.add_row("marina", path, "two phases")
    stream = io.StringIO()
    print_table(Console(file=stream, width=40), table)
    lines = stream.getvalue().splitlines()
    assert any(path in line for line in lines)
    assert all(len(line) <= 40 for line in lines if "marina" in line and path not in line)


def test_a_column_that_does_not_fit_beside_the_first_is_printed_below_its_cells() -> None:
    table = make_table("name", "kind", "source", "parameters", title="vessels")
    table.add_row("workboat-of-a-yard", "3-DOF", "vessels/workboat-of-a-yard.yaml", "one=1, two=2")
    table.add_row("launch", "", "vessels/launch.yaml", "")
    stream = io.StringIO()
    print_table(Console(file=stream, width=40), table)
    lines = stream.getvalue().splitlines()
    assert max(map(len, lines)) <= 40
    assert [line.split() for line in lines if "source" in line or ".yaml" in line] == [
        ["source", "vessels/workboat-of-a-yard.yaml"],
        ["source", "vessels/launch.yaml"],
    ]
    for name in ("workboat-of-a-yard", "launch"):
        assert lines[lines.index(name) + 1].split() == ["source", f"vessels/{name}.yaml"]
    assert "3-DOF" in stream.getvalue() and "two=2" in stream.getvalue()


def test_a_table_of_columns_that_do_not_fit_keeps_its_title_and_breaks_what_may_break() -> None:
    table = make_table("run", Column("name", min_width=10), title="runs")
    table.add_row("r" * 36, "n" * 50)
    stream = io.StringIO()
    print_table(Console(file=stream, width=40), table)
    lines = stream.getvalue().splitlines()
    assert lines[:2] == ["runs", "r" * 36]
    assert max(map(len, lines)) <= 40
    assert "".join("".join(lines[2:]).split()) == "name" + "n" * 50


def test_a_table_without_rows_is_not_printed() -> None:
    stream = io.StringIO()
    print_table(Console(file=stream), make_table(title="policies"))
    assert stream.getvalue() == ""


def test_notes_go_through_what_replaces_standard_error() -> None:
    handler = cli._Notes()
    with redirect_stderr(io.StringIO()) as stream:  # as a spinner does as long as it turns
        handler.handle(logging.makeLogRecord({"msg": "building the table"}))
    assert stream.getvalue() == "building the table\n"


@pytest.mark.parametrize("width", [40, 60, 80])
def test_lines_break_between_words_on_a_terminal_only(width: int) -> None:
    path = "/home/somebody/a-long-folder/runs/s3/20260101-120000-seed0/checkpoints/best/policy.safetensors"
    memory = "memory: 0.9 GB at its peak (libraries and harbor 0.47, replay 0.31)"
    text = f"{memory}\nrun folder: {path}\n  dockctl {path}"

    def printed(*, terminal: bool) -> list[str]:
        stream = io.StringIO()
        print_text(Console(file=stream, width=width, force_terminal=terminal, color_system=None), text)
        return stream.getvalue().splitlines()

    assert printed(terminal=False) == text.splitlines()
    lines = printed(terminal=True)
    assert all(len(line) <= width for line in lines if path not in line)
    assert " ".join(line.rstrip() for line in lines).split() == text.split()
    assert lines[-1] == f"  dockctl {path}"


def test_texts_of_others_send_no_commands_to_the_terminal() -> None:
    hostile, stream = "\x1b]0;title\x1b[2J\x9b2J\u202eb [/red]", io.StringIO()
    console = Console(file=stream, width=200)
    table = make_table("name")
    table.add_row(Text(hostile))
    print_text(console, hostile)
    print_table(console, table)
    shown = stream.getvalue()
    assert shown.count(r"\x1b]0;title\x1b[2J\x9b2J\x202eb [/red]") == 2
    assert all(character.isprintable() for character in shown.replace("\n", ""))
