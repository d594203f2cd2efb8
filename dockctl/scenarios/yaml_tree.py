"""Read YAML into a tree in which every node has its file, line and column.

Only plain data is accepted: no tags that construct objects, no NaN or infinity, limited size and depth. As in
YAML 1.2, ``true`` and ``false`` are the only booleans, and ``1e-3`` is a number.
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
class Location:
    """Location in an input; line and column are counted from 1, 0 if unknown."""

    file: str
    line: int = 0
    column: int = 0

    def problem(self, message: str, path: str = "", code: Code = "invalid", suggestion: str = "") -> Problem:
        """Return a problem here; the field is omitted where the file, ``--set field``, already names it."""
        path = "" if self.file == f"--set {path}" else path
        return Problem(self.file, self.line, self.column, path, message, code, suggestion)


def input_error(
    location: Location, message: str, path: str = "", code: Code = "invalid", suggestion: str = ""
) -> InputError:
    """Return an error with one problem."""
    return InputError([location.problem(message, path, code, suggestion)])


@dataclass(frozen=True)
class Node:
    """A YAML scalar, mapping or list; `keys` has the locations of a mapping's keys."""

    value: Scalar | dict[str, Node] | list[Node]
    location: Location
    keys: dict[str, Location] = field(default_factory=dict)

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
        return Node(
            {**self.value, key: node}, self.location, {**self.keys, key: self.keys.get(key, node.location)}
        )

    def without(self, *keys: str) -> Node:
        """Return this mapping without `keys`."""
        assert isinstance(self.value, dict)
        return Node(
            {key: node for key, node in self.value.items() if key not in keys}, self.location, self.keys
        )


def read_file(path: Path, display: str) -> Node:
    """Read a YAML file that contains one mapping.

    Args:
        display: path for messages.

    Raises:
        InputError: the file cannot be read, is too large, is not UTF-8, or is not one YAML mapping.
    """
    if path.is_dir():
        raise input_error(Location(display), "is a directory, expected a YAML file", code="not_readable")
    if path.exists() and not path.is_file():
        raise input_error(
            Location(display), "is not a regular file, expected a YAML file", code="not_readable"
        )
    try:
        with path.open("rb") as stream:
            data = stream.read(MAX_BYTES + 1)
    except OSError as error:
        code: Code = "not_found" if isinstance(error, FileNotFoundError) else "not_readable"
        raise input_error(
            Location(display), f"cannot be read: {error.strerror or error}", code=code
        ) from None
    if len(data) > MAX_BYTES:
        message = f"is larger than {MAX_BYTES / 1e6:.0f} MB, too large for a scenario file"
        raise input_error(Location(display), message, code="out_of_range")
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
    """Read one YAML document; empty text gives a null node.

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
    if root is None:
        return Node(None, Location(display, 1, 1))
    builder = _Builder(display)
    tree = builder.build(root)
    if builder.problems:
        raise InputError(builder.problems)
    return tree


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
    """Writes YAML that `read_text` reads back: quotes every string that would be read as another type."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


_use_resolvers(_Loader)
_use_resolvers(PlainDumper)


class _Builder:
    """Converts PyYAML's node graph to a tree; expands aliases up to a limit and collects invalid scalars."""

    def __init__(self, display: str) -> None:
        self.display = display
        self.count = 0
        self.problems: list[Problem] = []

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
            self.problems += error.problems
            return Node(None, location)

    def _mapping(self, node: yaml.MappingNode, location: Location, path: tuple[str, ...]) -> Node:
        values: dict[str, Node] = {}
        keys: dict[str, Location] = {}
        for key_node, value_node in node.value:
            key_location = _location(self.display, key_node.start_mark)
            if not isinstance(key_node, yaml.ScalarNode):
                raise input_error(key_location, "a key must be a plain name", code="yaml_syntax")
            key = _text(key_node, key_location)
            if key == "<<":
                message = "merge keys (<<) are not supported; use extends"
                raise input_error(key_location, message, code="yaml_syntax")
            if key in values:
                message = f"duplicate key '{key}'; the first one is in line {keys[key].line}"
                raise input_error(key_location, message, code="duplicate")
            values[key] = self.build(value_node, (*path, key))
            keys[key] = key_location
        return Node(values, location, keys)


def _text(node: yaml.ScalarNode, location: Location, path: str = "") -> str:
    """Return the text of a scalar; refuse characters that file names and terminals cannot represent."""
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
        message = f"found {text[:40]}, expected a finite number of ordinary size"
        raise input_error(location, message, path, "out_of_range")
    raise input_error(
        location, f"the tag {node.tag} does not fit the value '{text[:40]}'", path, "yaml_syntax"
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
