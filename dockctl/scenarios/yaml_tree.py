"""Read YAML into a tree in which every node has its file, line and column.

Only plain data is accepted: no tags that construct objects, no NaN or infinity, limited size and depth. As in
YAML 1.2, ``true`` and ``false`` are the only booleans, and ``1e-3`` is a number.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml

from dockctl.errors import Code, DockctlError, InputError, Problem
from dockctl.reading import read_limited

MAX_BYTES = 1_000_000
MAX_NODES = 100_000
MAX_DEPTH = 50

Scalar = str | int | float | bool | None


@dataclass(frozen=True, order=True)
class Location:
    """Location in an input; line and column are counted from 1, 0 if unknown."""

    file: str
    line: int = 0
    column: int = 0

    def problem(self, message: str, path: str = "", code: Code = "invalid", suggestion: str = "") -> Problem:
        """Return a problem at this location; the field is omitted if the file, ``--set field``, names it."""
        path = "" if self.file == f"--set {path}" else path
        return Problem(self.file, self.line, self.column, path, message, code, suggestion)


def input_error(
    location: Location, message: str, path: str = "", code: Code = "invalid", suggestion: str = ""
) -> InputError:
    """Return an error with one problem."""
    return InputError([location.problem(message, path, code, suggestion)])


@dataclass(frozen=True)
class Node:
    """A YAML scalar, mapping or list.

    Attributes:
        keys: locations of the keys of a mapping.
        problems: why the value cannot be used or is incomplete.
    """

    value: Scalar | dict[str, Node] | list[Node]
    location: Location
    keys: dict[str, Location] = field(default_factory=dict)
    problems: tuple[Problem, ...] = ()

    def all_problems(self) -> Iterator[Problem]:
        """Yield the problems of this node and of everything in it."""
        yield from self.problems
        value = self.value
        for child in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
            yield from child.all_problems()

    def to_python(self) -> Any:
        """Return the tree as dicts, lists and scalars."""
        if isinstance(self.value, dict):
            return {key: node.to_python() for key, node in self.value.items()}
        if isinstance(self.value, list):
            return [node.to_python() for node in self.value]
        return self.value

    def get(self, key: str) -> Node | None:
        """Return the value of `key`; None if this is not a mapping or lacks the key."""
        return self.value.get(key) if isinstance(self.value, dict) else None

    def with_value(self, key: str, node: Node) -> Node:
        """Return this mapping with `node` as the value of `key`."""
        assert isinstance(self.value, dict)
        keys = {**self.keys, key: self.keys.get(key, node.location)}
        return replace(self, value={**self.value, key: node}, keys=keys)

    def without(self, *keys: str) -> Node:
        """Return this mapping without `keys`."""
        assert isinstance(self.value, dict)
        return replace(self, value={key: node for key, node in self.value.items() if key not in keys})


def read_file(path: Path, display: str) -> Node:
    """Read a YAML file that contains one mapping.

    Args:
        display: path for messages.

    Raises:
        InputError: the file cannot be read, is too large, is not UTF-8, or is not one YAML mapping.
    """
    try:
        data = read_limited(path, MAX_BYTES)
    except DockctlError as error:
        raise input_error(Location(display), error.message, code=error.code) from None
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        location = _location_at(data[: error.start].decode("utf-8", "replace"), display)
        raise input_error(
            location, f"is not UTF-8 text (byte 0x{data[error.start]:02x})", code="yaml_syntax"
        ) from None
    tree = read_text(text, display)
    if tree.value is None:
        raise input_error(Location(display, 1, 1), "is empty; expected keys and values", code="wrong_type")
    if not isinstance(tree.value, dict):
        message = f"expected a mapping of keys to values, found {describe(tree.to_python())}"
        raise input_error(tree.location, message, code="wrong_type")
    return tree


def read_text(text: str, display: str) -> Node:
    """Read one YAML document; empty text gives a null node, an invalid scalar a node with a problem.

    Args:
        display: name of the input for messages.

    Raises:
        InputError: a syntax error, several documents, or more than plain data.
    """
    try:
        loader = _Loader(text)
        loader.name = display
        root = loader.get_single_node()
    except yaml.reader.ReaderError as error:
        location = _location_at(text[: error.position], display)
        message = f"is not text: character {_hex(error.character)}"
        raise input_error(location, message, code="yaml_syntax") from None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        location = _location(display, mark) if mark else Location(display)
        raise input_error(location, _syntax_message(error), code="yaml_syntax") from None
    except (OverflowError, ValueError):
        message = "the number of a character or of a YAML version is out of range"
        raise input_error(_location(display, loader.get_mark()), message, code="yaml_syntax") from None
    if root is None:
        return Node(None, Location(display, 1, 1))
    return _Builder(display).build(root)


def describe(value: object) -> str:
    """Describe a value for messages: ``the text 'abc'``, ``a list``, ``true``, ``3``."""
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
    """PyYAML's loader up to the node graph, with limits on depth and size."""

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
    """Writes YAML that `read_text` reads back: quotes every string that would be read as a different type."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


_use_resolvers(_Loader)
_use_resolvers(PlainDumper)


class _Builder:
    """Converts PyYAML's node graph to a tree; expands aliases up to a limit."""

    def __init__(self, display: str) -> None:
        self.display = display
        self.count = 0

    def build(self, node: yaml.Node, path: tuple[str, ...] = ()) -> Node:
        location = _location(self.display, node.start_mark)
        self.count += 1
        if self.count > MAX_NODES or len(path) > MAX_DEPTH:
            limit = f"{MAX_NODES} values or {MAX_DEPTH} levels"
            message = f"anchors and aliases expand to more than {limit}"
            raise input_error(location, message, code="out_of_range")
        if isinstance(node, yaml.MappingNode) and node.tag == "tag:yaml.org,2002:map":
            return self._mapping(node, location, path)
        if isinstance(node, yaml.SequenceNode) and node.tag == "tag:yaml.org,2002:seq":
            return Node([self.build(item, (*path, str(i))) for i, item in enumerate(node.value)], location)
        try:
            if isinstance(node, yaml.ScalarNode):
                return Node(_scalar(node, location, ".".join(path)), location)
            message = f"the tag {node.tag} is not allowed; write plain values"
            raise input_error(location, message, ".".join(path), "yaml_syntax")
        except InputError as error:
            return Node(None, location, problems=error.problems)

    def _mapping(self, node: yaml.MappingNode, location: Location, path: tuple[str, ...]) -> Node:
        values: dict[str, Node] = {}
        keys: dict[str, Location] = {}
        problems: list[Problem] = []
        for key_node, value_node in node.value:
            try:
                key = _key(key_node, _location(self.display, key_node.start_mark), keys)
            except InputError as error:
                problems += error.problems
                continue
            keys[key] = _location(self.display, key_node.start_mark)
            values[key] = self.build(value_node, (*path, key))
        return Node(values, location, keys, tuple(problems))


def _key(node: yaml.Node, location: Location, known: dict[str, Location]) -> str:
    """Return the text of a key; `known` are the locations of the previous keys."""
    if not isinstance(node, yaml.ScalarNode):
        raise input_error(location, "a key must be a plain name", code="yaml_syntax")
    key = _text(node, location)
    if key == "<<":
        message = "merge keys (<<) are not supported; use extends"
        raise input_error(location, message, code="yaml_syntax")
    if key in known:
        message = f"duplicate key '{key}'; the first one is on line {known[key].line}"
        raise input_error(location, message, code="duplicate")
    return key


def _text(node: yaml.ScalarNode, location: Location, path: str = "") -> str:
    """Return the text of a scalar; reject characters that file names and terminals cannot represent."""
    text = str(node.value)
    if bad := re.search("[\0\ud800-\udfff]", text):
        raise input_error(location, f"is not text: character {_hex(bad[0])}", path, "yaml_syntax")
    return text


def _scalar(node: yaml.ScalarNode, location: Location, path: str) -> Scalar:
    text = _text(node, location, path)
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
        shown = text if len(text) <= 40 else f"{text[:37]}..."
        message = f"found {shown}, expected a finite number with at most 18 digits"
        raise input_error(location, message, path, "out_of_range")
    raise input_error(
        location, f"the tag {node.tag} does not match the value '{text[:40]}'", path, "yaml_syntax"
    )


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


def _location(display: str, mark: yaml.Mark) -> Location:
    return Location(display, mark.line + 1, mark.column + 1)


def _location_at(before: str, display: str) -> Location:
    return Location(display, before.count("\n") + 1, len(before) - (before.rfind("\n") + 1) + 1)
