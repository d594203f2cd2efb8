"""Places, plain data, and everything that is refused before it can do harm."""

from __future__ import annotations

import math
import os
from contextlib import suppress
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from dockctl.errors import InputError
from dockctl.scenarios.yaml_tree import PlainDumper, described, read_file, read_text

LAUGHS = "a: &a [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{name}: &{name} [{', '.join([f'*{before}'] * 10)}]\n"
    for before, name in zip("abcde", "bcdef", strict=True)
)

REFUSED = [
    ("", "1:1", "is empty"),
    ("# nothing but a comment\n", "1:1", "is empty"),
    ("- a\n- b\n", "1:1", "expected a mapping of keys to values, found a list"),
    ("only words\n", "1:1", "found the text 'only words'"),
    ("a: 1\nb: 2\na: 3\n", "3:1", "the key 'a' stands twice; first in line 1"),
    ("a:\n\tb: 1\n", "2:1", "a tab in the indentation; use spaces"),
    ("a: [1, 2\nb: 3\n", "2:2", "YAML: "),
    ("a: b: c\n", "1:5", "YAML: mapping values are not allowed here"),
    ("a: 1\n---\nb: 2\n", "2:1", "several documents in one file"),
    ("a: *nowhere\n", "1:4", "found undefined alias"),
    ("a: 1\n? [b, c]\n: 2\n", "2:3", "a key must be a plain name"),
    ("a: !!python/object/apply:os.system [ls]\n", "1:4", "is not allowed"),
    ("a: !!int x\n", "1:4", "does not fit the value 'x'"),
    ("a: {<<: {b: 1}}\n", "1:5", "merge keys (<<) are not supported"),
    ('a: "\\ud800"\n', "1:4", "is not text: character U+D800"),
    ('"a\\0": 1\n', "1:1", "is not text: character U+0000"),
    ("a: .nan\n", "1:4", "found .nan, expected a finite number"),
    ("a:\n  b: [1, -.inf]\n", "2:10", "found -.inf, expected a finite number"),
    ("a: 1e999\n", "1:4", "found 1e999, expected a finite number"),
    ("a: 12345678901234567890123\n", "1:4", "expected a finite number of ordinary size"),
    ("a: " + "[" * 100_000, "1:53", "more than 50 levels"),
    ("- 1\n" * 150_000, "100000:3", "more than 100000 values"),
    (LAUGHS, "1:35", "anchors and aliases expand to more than 100000 values"),
    ("a: &a [*a]\n", "1:4", "anchors and aliases expand"),
]


@pytest.mark.parametrize(("text", "place", "message"), REFUSED, ids=[row[2][:30] for row in REFUSED])
def test_refuses_with_the_place(tmp_path: Path, text: str, place: str, message: str) -> None:
    path = tmp_path / "x.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_file(path, "x.yaml")
    (problem,) = caught.value.problems
    assert f"{problem.line}:{problem.column}" == place
    assert message in problem.message


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"a: \xff\n", "x.yaml:1:4: is not UTF-8 text (byte 0xff)"),
        (b"a: 1\nb: \x00\n", "x.yaml:2:4: is not text: character U+0000"),
        (b"a: 1\n#" + b"x" * 50_000_000, "x.yaml: is larger than 1 MB"),
    ],
)
def test_refuses_what_is_not_a_small_text(tmp_path: Path, data: bytes, message: str) -> None:
    path = tmp_path / "x.yaml"
    path.write_bytes(data)
    with pytest.raises(InputError, match=message.replace("(", r"\(").replace(")", r"\)").replace("+", r"\+")):
        read_file(path, "x.yaml")


def test_refuses_a_directory(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is a directory; name a YAML file"):
        read_file(tmp_path, "here")


def test_refuses_a_pipe_without_waiting_for_it(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "x.yaml")
    with pytest.raises(InputError, match=r"x\.yaml: is no regular file"):
        read_file(tmp_path / "x.yaml", "x.yaml")


def test_refuses_what_cannot_be_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "x.yaml"
    path.write_text("a: 1")

    def refuse(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)  # file modes do not stop root
    with pytest.raises(InputError, match=r"x\.yaml: cannot be read: Permission denied"):
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
    found = read_text(f"a: {text}", "x").plain()["a"]
    assert found == value
    assert type(found) is type(value)


def test_places_count_from_one_and_keys_have_their_own() -> None:
    tree = read_text("a: 1\nb:\n  - {c: 2}\n", "x.yaml")
    inner = tree.value["b"].value[0]  # type: ignore[index, union-attr]  # the text above says so
    assert str(inner.keys["c"].problem("!")) == "x.yaml:3:6: !"
    assert str(inner.value["c"].place.problem("!", "b.0.c")) == "x.yaml:3:9: b.0.c: !"


def test_a_byte_order_mark_is_nothing(tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    path.write_bytes(b"\xef\xbb\xbfa: 1\n")
    assert read_file(path, "x").plain() == {"a": 1}


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
    assert read_text(text, "x").plain() == {"data": data}


@given(st.text(max_size=80) | st.text("[]{}:-#&*!|>'\"%@ \n\tab1.,?", max_size=80))
def test_any_text_is_a_tree_or_an_input_error(text: str) -> None:
    with suppress(InputError):
        assert read_text(text, "x").place.file == "x"


def test_described() -> None:
    values = [None, True, 3, math.pi, "abc", [], [1], {}, {"a": 1}, "x" * 50]
    assert [described(value) for value in values] == [
        "nothing",
        "true",
        "3",
        "3.141592653589793",
        "the text 'abc'",
        "an empty list",
        "a list",
        "an empty mapping",
        "a mapping",
        f"the text '{'x' * 37}...'",
    ]
