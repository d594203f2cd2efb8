"""Locations, plain data, and refused input."""

from __future__ import annotations

import math
import os
from contextlib import suppress
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from dockctl.errors import InputError, Problem
from dockctl.scenarios import yaml_tree
from dockctl.scenarios.yaml_tree import PlainDumper, describe, read_file, read_text

LAUGHS = "a: &a [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{name}: &{name} [{', '.join([f'*{before}'] * 10)}]\n"
    for before, name in zip("abcde", "bcdef", strict=True)
)

REFUSED = [
    ("", "1:1", "wrong_type"),
    ("# nothing but a comment\n", "1:1", "wrong_type"),
    ("- a\n- b\n", "1:1", "wrong_type"),
    ("only words\n", "1:1", "wrong_type"),
    ("a: 1\nb: 2\na: 3\n", "3:1", "duplicate"),
    ("a:\n\tb: 1\n", "2:1", "yaml_syntax"),
    ("a: [1, 2\nb: 3\n", "2:2", "yaml_syntax"),
    ("a: b: c\n", "1:5", "yaml_syntax"),
    ("a: 1\n---\nb: 2\n", "2:1", "yaml_syntax"),
    ("a: *nowhere\n", "1:4", "yaml_syntax"),
    ("a: 1\n? [b, c]\n: 2\n", "2:3", "yaml_syntax"),
    ("a: !!python/object/apply:os.system [ls]\n", "1:4", "yaml_syntax"),
    ("a: !!int x\n", "1:4", "yaml_syntax"),
    ("a: {<<: {b: 1}}\n", "1:5", "yaml_syntax"),
    ('a: "\\ud800"\n', "1:4", "yaml_syntax"),
    ('a: "\\U00110000"\n', "1:7", "yaml_syntax"),
    ('a: "\\UFFFFFFFF"\n', "1:7", "yaml_syntax"),
    (f"%YAML 1.{'1' * 5000}\n---\na: 1\n", "1:9", "yaml_syntax"),
    ('"a\\0": 1\n', "1:1", "yaml_syntax"),
    ("a: .nan\n", "1:4", "out_of_range"),
    ("a:\n  b: [1, -.inf]\n", "2:10", "out_of_range"),
    ("a: 1e999\n", "1:4", "out_of_range"),
    ("a: 12345678901234567890123\n", "1:4", "out_of_range"),
    ("a: " + "[" * 100_000, "1:53", "yaml_syntax"),
    ("- 1\n" * 1500, "1000:3", "yaml_syntax"),
    (LAUGHS, "1:35", "out_of_range"),
    ("a: &a [*a]\n", "1:4", "out_of_range"),
]


@pytest.mark.parametrize(("text", "place", "code"), REFUSED, ids=[row[0][:20] for row in REFUSED])
def test_rejects_with_the_location(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, place: str, code: str
) -> None:
    monkeypatch.setattr(yaml_tree, "MAX_NODES", 1000)
    path = tmp_path / "x.yaml"
    path.write_text(text)
    (problem,) = problems(path)
    assert (f"{problem.line}:{problem.column}", problem.code) == (place, code)


def problems(path: Path) -> list[Problem]:
    try:
        return [*read_file(path, "x.yaml").all_problems()]
    except InputError as error:
        return [*error.problems]


def test_every_key_and_value_that_is_not_valid_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    path.write_text("a: .nan\nb: [1e999, {c: !!int x, c: 1}]\na: 2\n")
    found = sorted(f"{problem.line}:{problem.column} {problem.code}" for problem in problems(path))
    assert found == [
        "1:4 out_of_range",
        "2:16 yaml_syntax",
        "2:25 duplicate",
        "2:5 out_of_range",
        "3:1 duplicate",
    ]


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (b"a: \xff\n", (1, 4, "yaml_syntax")),
        (b"a: 1\nb: \x00\n", (2, 4, "yaml_syntax")),
        (b"a: 1\n#" + b"x" * 50_000_000, (0, 0, "out_of_range")),
    ],
    ids=["not UTF-8", "null byte", "too large"],
)
def test_rejects_what_is_not_a_small_text(
    tmp_path: Path, data: bytes, expected: tuple[int, int, str]
) -> None:
    path = tmp_path / "x.yaml"
    path.write_bytes(data)
    with pytest.raises(InputError) as caught:
        read_file(path, "x.yaml")
    (problem,) = caught.value.problems
    assert (problem.file, problem.line, problem.column, problem.code) == ("x.yaml", *expected)


def test_rejects_a_directory(tmp_path: Path) -> None:
    with pytest.raises(InputError, check=lambda error: error.code == "not_readable"):
        read_file(tmp_path, "here")


def test_rejects_a_pipe_without_waiting_for_it(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "x.yaml")
    with pytest.raises(InputError, check=lambda error: error.code == "not_readable"):
        read_file(tmp_path / "x.yaml", "x.yaml")


def test_rejects_what_cannot_be_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "x.yaml"
    path.write_text("a: 1")

    def refuse(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "open", refuse)  # file modes do not stop root
    with pytest.raises(InputError, check=lambda error: error.code == "not_readable"):
        read_file(path, "x.yaml")


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 1e-3),
        ("-1.5E+2", -150.0),
        (".5", 0.5),
        ("30_000", 30_000),
        ("010", 10),
        ("0x1F", 31),
        ("0o17", 15),
        ("yes", "yes"),
        ("on", "on"),
        ("y", "y"),
        ("true", True),
        ("False", False),
        ("~", None),
        ("null", None),
        ("2024-01-01", "2024-01-01"),
        ("12:30:45", "12:30:45"),
        ("'1'", "1"),
        ("!!str 1", "1"),
        ("!!float 1", 1.0),
    ],
)
def test_scalars(text: str, value: object) -> None:
    found = read_text(f"a: {text}", "x").to_python()["a"]
    assert found == value
    assert type(found) is type(value)


def test_locations_count_from_one_and_keys_have_their_own() -> None:
    tree = read_text("a: 1\nb:\n  - {c: 2}\n", "x.yaml")
    inner = tree.value["b"].value[0]  # type: ignore[index, union-attr]  # the text above says so
    assert str(inner.keys["c"].problem("!")) == "x.yaml:3:6: !"
    assert str(inner.value["c"].location.problem("!", "b.0.c")) == "x.yaml:3:9: b.0.c: !"


def test_a_byte_order_mark_is_ignored(tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    path.write_bytes(b"\xef\xbb\xbfa: 1\n")
    assert read_file(path, "x").to_python() == {"a": 1}


PLAIN = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(10**15), 10**15)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(st.characters(exclude_categories=["Cs", "Cc"]), max_size=20)
    | st.sampled_from(["1e5", "on", "~", "null", "true", "0x1", "1_0", ".5", "<<", "=", "-", "", "1."]),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text("abcyn1_", max_size=5), inner, max_size=4)
    ),
    max_leaves=20,
)


@given(PLAIN)
def test_what_the_dumper_writes_is_read_back(data: object) -> None:
    text = yaml.dump({"data": data}, Dumper=PlainDumper, allow_unicode=True)
    assert read_text(text, "x").to_python() == {"data": data}


@given(st.text(max_size=80) | st.text("[]{}:-#&*!|>'\"%@ \n\tab1.,?", max_size=80))
def test_any_text_is_a_tree_or_an_input_error(text: str) -> None:
    with suppress(InputError):
        assert read_text(text, "x").location.file == "x"


def test_described() -> None:
    assert [describe(value) for value in (True, 3, math.pi)] == ["true", "3", "3.141592653589793"]
    assert "'abc'" in describe("abc")
    assert f"'{'x' * 37}...'" in describe("x" * 50)
    others: list[object] = [None, [], [1], {}, {"a": 1}]
    assert len({describe(value) for value in others}) == len(others)
