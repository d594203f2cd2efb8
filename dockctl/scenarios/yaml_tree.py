"""YAML text as a tree in which every node knows its file, line and column.

Plain data only: no tags that build objects, ``true`` and ``false`` as the only booleans (YAML 1.2),
``1e-3`` is a number, NaN and infinity are refused, and so is whatever would exhaust the machine.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from dockctl.errors import Code, InputError, Problem

MAX_BYTES = 1_000_000
MAX_NODES = 100_000
MAX_DEPTH = 50

Scalar = str | int | float | bool | None


@dataclass(frozen=True, order=True)
class Place:
    """Where something stands in an input; line and column count from 1, 0 is unknown."""

    file: str
    line: int = 0
    column: int = 0

    def problem(self, message: str, path: str = "", code: Code = "invalid", suggestion: str = "") -> Problem:
        """Return a problem at this place; an override has its field as its file already."""
        path = "" if self.file == f"--set {path}" else path
        return Problem(self.file, self.line, self.column, path, message, code, suggestion)


def refusal(
    place: Place, message: str, path: str = "", code: Code = "invalid", suggestion: str = ""
) -> InputError:
    """Return an error with one problem."""
    return InputError([place.problem(message, path, code, suggestion)])


@dataclass(frozen=True)
class Node:
    """A scalar, mapping or list of YAML with its place; `keys` holds the places of a mapping's keys."""

    value: Scalar | dict[str, Node] | list[Node]
    place: Place
    keys: dict[str, Place] = field(default_factory=dict)

    def plain(self) -> Any:
        """Return the tree as ordinary dicts, lists and scalars."""
        if isinstance(self.value, dict):
            return {key: node.plain() for key, node in self.value.items()}
        if isinstance(self.value, list):
            return [node.plain() for node in self.value]
        return self.value

    def get(self, key: str) -> Node | None:
        """Return the value under `key` of a mapping, None where there is none."""
        return self.value.get(key) if isinstance(self.value, dict) else None

    def replaced(self, key: str, node: Node) -> Node:
        """Return this mapping with `node` under `key`."""
        assert isinstance(self.value, dict)
        return Node({**self.value, key: node}, self.place, {**self.keys, key: self.keys.get(key, node.place)})

    def without(self, *keys: str) -> Node:
        """Return this mapping without `keys`."""
        assert isinstance(self.value, dict)
        return Node({key: node for key, node in self.value.items() if key not in keys}, self.place, self.keys)


def read_file(path: Path, shown: str) -> Node:
    """Read the YAML file at `path`, called `shown` in messages.

    Raises:
        InputError: it cannot be read, is too large, is not UTF-8, or is not one YAML mapping.
    """
    if path.is_dir():
        raise refusal(Place(shown), "is a directory; name a YAML file", code="not_readable")
    if path.exists() and not path.is_file():
        raise refusal(Place(shown), "is not a regular file; name a YAML file", code="not_readable")
    try:
        with path.open("rb") as stream:
            data = stream.read(MAX_BYTES + 1)
    except OSError as error:
        code: Code = "not_found" if isinstance(error, FileNotFoundError) else "not_readable"
        raise refusal(Place(shown), f"cannot be read: {error.strerror or error}", code=code) from None
    if len(data) > MAX_BYTES:
        message = f"is larger than {MAX_BYTES / 1e6:.0f} MB, too large for a scenario file"
        raise refusal(Place(shown), message, code="out_of_range")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        place = _place_in(data[: error.start].decode("utf-8", "replace"), shown)
        raise refusal(
            place, f"is not UTF-8 text (byte 0x{data[error.start]:02x})", code="yaml_syntax"
        ) from None
    tree = read_text(text, shown)
    if tree.value is None:
        raise refusal(Place(shown, 1, 1), "is empty; expected keys and values", code="wrong_type")
    if not isinstance(tree.value, dict):
        message = f"expected a mapping of keys to values, found {described(tree.plain())}"
        raise refusal(tree.place, message, code="wrong_type")
    return tree


def read_text(text: str, shown: str) -> Node:
    """Read one YAML document; an empty text is a null node.

    Raises:
        InputError: a syntax error, several documents, or something that plain data does not need.
    """
    try:
        loader = _Loader(text)
        loader.name = shown
        root = loader.get_single_node()
    except yaml.reader.ReaderError as error:
        place = _place_in(text[: error.position], shown)
        message = f"is not text: character {_hex(error.character)}"
        raise refusal(place, message, code="yaml_syntax") from None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = _place(shown, mark) if mark else Place(shown)
        raise refusal(place, _syntax_message(error), code="yaml_syntax") from None
    if root is None:
        return Node(None, Place(shown, 1, 1))
    builder = _Builder(shown)
    tree = builder.build(root)
    if builder.problems:
        raise InputError(builder.problems)
    return tree


def described(value: object) -> str:
    """Say what a value is, for messages: ``the text 'abc'``, ``a list``, ``true``, ``3``."""
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f"the text '{value if len(value) <= 40 else value[:37] + '...'}'"
    if isinstance(value, dict):
        return "a mapping" if value else "an empty mapping"
    if isinstance(value, list | tuple):
        return "a list" if value else "an empty list"
    return f"{value:.6g}" if isinstance(value, float) and abs(value) >= 1e16 else str(value)[:40]


_RESOLVERS = {
    "null": (r"~|null|Null|NULL|", "~nN\0"),
    "bool": (r"true|True|TRUE|false|False|FALSE", "tTfF"),
    "int": (r"[-+]?[0-9][0-9_]*|0o[0-7]+|0x[0-9a-fA-F]+", "-+0123456789"),
    "float": (
        r"[-+]?(\.[0-9]+|[0-9][0-9_]*(\.[0-9_]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)",
        "-+.0123456789",
    ),
}


def _use_resolvers(cls: type[yaml.SafeLoader] | type[yaml.SafeDumper]) -> None:
    cls.yaml_implicit_resolvers = {}
    for tag, (pattern, first) in _RESOLVERS.items():
        letters = ["" if letter == "\0" else letter for letter in first]
        cls.add_implicit_resolver(f"tag:yaml.org,2002:{tag}", re.compile(rf"(?:{pattern})\Z"), letters)


class _Loader(yaml.SafeLoader):
    """PyYAML's reader up to its node graph, with a bound on depth and size."""

    depth = 0
    count = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        self.depth += 1
        self.count += 1
        if self.depth > MAX_DEPTH or self.count > MAX_NODES:
            limit = f"{MAX_DEPTH} levels deep" if self.depth > MAX_DEPTH else f"{MAX_NODES} values"
            mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]  # PyYAML's stubs lack it
            raise yaml.composer.ComposerError(None, None, f"more than {limit}", mark)
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node


class PlainDumper(yaml.SafeDumper):
    """Writes what `read_text` reads back: it quotes every text that would be read as something else."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


_use_resolvers(_Loader)
_use_resolvers(PlainDumper)


class _Builder:
    """Turns PyYAML's node graph into a tree, expanding aliases up to a limit; gathers unfit scalars."""

    def __init__(self, shown: str) -> None:
        self.shown = shown
        self.count = 0
        self.problems: list[Problem] = []

    def build(self, node: yaml.Node, path: tuple[str, ...] = ()) -> Node:
        place = _place(self.shown, node.start_mark)
        self.count += 1
        if self.count > MAX_NODES or len(path) > MAX_DEPTH:
            limit = f"{MAX_NODES} values or {MAX_DEPTH} levels"
            message = f"anchors and aliases expand to more than {limit}"
            raise refusal(place, message, code="out_of_range")
        if isinstance(node, yaml.MappingNode) and node.tag == "tag:yaml.org,2002:map":
            return self._mapping(node, place, path)
        if isinstance(node, yaml.SequenceNode) and node.tag == "tag:yaml.org,2002:seq":
            return Node([self.build(item, (*path, str(i))) for i, item in enumerate(node.value)], place)
        try:
            if isinstance(node, yaml.ScalarNode):
                return Node(_scalar(node, place, ".".join(path)), place)
            message = f"the tag {node.tag} is not allowed; write plain values"
            raise refusal(place, message, ".".join(path), "yaml_syntax")
        except InputError as error:
            self.problems += error.problems
            return Node(None, place)

    def _mapping(self, node: yaml.MappingNode, place: Place, path: tuple[str, ...]) -> Node:
        values: dict[str, Node] = {}
        keys: dict[str, Place] = {}
        for key_node, value_node in node.value:
            key_place = _place(self.shown, key_node.start_mark)
            if not isinstance(key_node, yaml.ScalarNode):
                raise refusal(key_place, "a key must be a plain name", code="yaml_syntax")
            key = _text(key_node, key_place)
            if key == "<<":
                message = "merge keys (<<) are not supported; use extends"
                raise refusal(key_place, message, code="yaml_syntax")
            if key in values:
                message = f"duplicate key '{key}'; the first one is in line {keys[key].line}"
                raise refusal(key_place, message, code="duplicate")
            values[key] = self.build(value_node, (*path, key))
            keys[key] = key_place
        return Node(values, place, keys)


def _text(node: yaml.ScalarNode, place: Place, path: str = "") -> str:
    """Return the text of a scalar; escapes may name characters that no file name or terminal takes."""
    text = str(node.value)
    if bad := re.search("[\0\ud800-\udfff]", text):
        raise refusal(place, f"is not text: character {_hex(bad[0])}", path, "yaml_syntax")
    return text


def _scalar(node: yaml.ScalarNode, place: Place, path: str) -> Scalar:
    text = _text(node, place, path)
    kind = node.tag.removeprefix("tag:yaml.org,2002:")
    if kind == "str":
        return text
    if kind in _RESOLVERS and re.fullmatch(_RESOLVERS[kind][0], text):
        digits = text.replace("_", "")
        if kind == "null":
            return None
        if kind == "bool":
            return text.lower() == "true"
        if kind == "int" and len(digits) <= 18:
            return int(digits, 0 if digits[:2] in ("0o", "0x") else 10)
        if kind == "float" and "n" not in digits.lower() and math.isfinite(float(digits)):
            return float(digits)
        message = f"found {text[:40]}, expected a finite number of ordinary size"
        raise refusal(place, message, path, "out_of_range")
    raise refusal(place, f"the tag {node.tag} does not fit the value '{text[:40]}'", path, "yaml_syntax")


def _syntax_message(error: yaml.MarkedYAMLError) -> str:
    problem = error.problem or "syntax error"
    if "'\\t'" in problem:
        return "YAML: a tab in the indentation; use spaces"
    if "expected a single document" in f"{error.context} {problem}":
        return "YAML: several documents in one file; expected one"
    return f"YAML: {problem} {error.context}" if error.context else f"YAML: {problem}"


def _hex(character: object) -> str:
    code = ord(character) if isinstance(character, str) else character
    return f"U+{code:04X}" if isinstance(code, int) else str(code)


def _place(shown: str, mark: yaml.Mark) -> Place:
    return Place(shown, mark.line + 1, mark.column + 1)


def _place_in(before: str, shown: str) -> Place:
    return Place(shown, before.count("\n") + 1, len(before) - (before.rfind("\n") + 1) + 1)
