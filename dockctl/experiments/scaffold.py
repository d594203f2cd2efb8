"""Commented templates for everything that users add: scenarios, vessels, harbors, and code."""

from __future__ import annotations

import os
import re
import shlex
from dataclasses import dataclass
from importlib.util import find_spec
from keyword import iskeyword
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from dockctl.errors import DockctlError, nearest
from dockctl.plugins import HARBORS, OBSERVATION_PARTS, POLICIES, REWARD_TERMS, SCENARIOS, VESSELS
from dockctl.registry import Registry
from dockctl.runs.files import all_or_nothing, make_folder, require_writable, writing
from dockctl.scenarios import catalog
from dockctl.scenarios.base import NAME

TEMPLATES = Path(__file__).with_name("templates")
IDENTIFIER, PROJECT = r"[a-z][a-z0-9_]{0,63}", r"[a-z][a-z0-9_-]{0,63}"


@dataclass(frozen=True)
class Starter:
    """What a template writes.

    Attributes:
        files: path of each file by its template; ``{name}`` and ``{module}`` are replaced, as in `following`.
        following: commands to try next; ``{out}`` is the folder, with a slash.
        pattern: regular expression for the name.
        registry: the registry in which the name must be new.
    """

    files: dict[str, str]
    following: tuple[tuple[str, ...], ...]
    pattern: str = NAME
    registry: Registry[Any] | None = None


def _of_scenario(file: str, *also: tuple[str, ...]) -> tuple[tuple[str, ...], ...]:
    path = f"{{out}}{file}"
    return (("dockctl", "validate", path), *also, ("dockctl", "train", path))


def _of_part(key: str) -> tuple[tuple[str, ...], ...]:
    override = ("s1", "--set", f"{key}={{out}}{{name}}.yaml")
    return tuple(("dockctl", command, *override) for command in ("validate", "train"))


STARTERS: dict[str, Starter] = {
    "scenario": Starter(
        {"scenario.yaml.j2": "{name}.yaml"},
        _of_scenario("{name}.yaml", ("dockctl", "show", "{out}{name}.yaml")),
        registry=SCENARIOS,
    ),
    "reward": Starter(
        {"reward.py.j2": "{name}.py", "reward.yaml.j2": "s1-{name}.yaml"},
        _of_scenario("s1-{name}.yaml"),
        IDENTIFIER,
        REWARD_TERMS,
    ),
    "observation": Starter(
        {"observation.py.j2": "{name}.py", "observation.yaml.j2": "s1-{name}.yaml"},
        _of_scenario("s1-{name}.yaml"),
        IDENTIFIER,
        OBSERVATION_PARTS,
    ),
    "vessel": Starter({"vessel.yaml.j2": "{name}.yaml"}, _of_part("vessel"), registry=VESSELS),
    "harbor": Starter({"harbor.yaml.j2": "{name}.yaml"}, _of_part("harbor"), registry=HARBORS),
    "policy": Starter(
        {"policy.py.j2": "{name}.py"},
        tuple(
            ("dockctl", *words, "--scenario", "s1")
            for words in (
                ("evaluate", "{out}{name}.py:Controller"),
                ("compare", "s1", "{out}{name}.py:Controller"),
            )
        ),
        IDENTIFIER,
        POLICIES,
    ),
    "plugin": Starter(
        {
            "plugin/pyproject.toml.j2": "{name}/pyproject.toml",
            "plugin/init.py.j2": "{name}/{module}/__init__.py",
            "plugin/terms.py.j2": "{name}/{module}/terms.py",
            "plugin/scenario.yaml.j2": "{name}/{module}/s1-{name}.yaml",
            "plugin/test_contracts.py.j2": "{name}/tests/test_contracts.py",
        },
        (
            ("pip", "install", "--editable", "{out}{name}[test]"),
            ("dockctl", "list", "rewards"),
            ("dockctl", "validate", "s1-{name}"),
            ("pytest", "{out}{name}/tests"),
        ),
        PROJECT,
    ),
}
"""Template for each kind."""


def write_starter(kind: str, name: str, folder: Path) -> tuple[list[Path], list[str]]:
    """Write the files of a template and return their paths, and the commands to try next.

    Raises:
        DockctlError: there is no such kind, the name cannot be used or is taken, a file exists, or the folder
            cannot be written; then nothing is written.
    """
    if kind not in STARTERS:
        message = f"there is no template for a '{kind}' (known: {', '.join(STARTERS)})"
        raise DockctlError(message, code="unknown_name", suggestion=nearest(kind, STARTERS))
    starter, words = STARTERS[kind], {"name": name, "module": name.replace("-", "_")}
    _require_usable(kind, name, starter)
    targets = {folder / path.format(**words): source for source, path in starter.files.items()}
    require_writable(folder)
    for path in [folder / name, *targets] if kind == "plugin" else targets:
        if os.path.lexists(path):
            raise DockctlError(
                f"{path}: already exists and is not overwritten; choose another name", code="duplicate"
            )
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES), undefined=StrictUndefined, keep_trailing_newline=True
    )
    texts = {path: environment.get_template(source).render(words) for path, source in targets.items()}
    with all_or_nothing(*(path.parent for path in texts)) as new:
        for path, text in texts.items():
            with writing(path):
                make_folder(path.parent)
                with path.open("x", encoding="utf-8") as file:
                    new.append(path)
                    file.write(text)
    out = "" if folder == Path() else f"{folder}/"
    following = [shlex.join(word.format(out=out, **words) for word in line) for line in starter.following]
    return list(texts), following


def _require_usable(kind: str, name: str, starter: Starter) -> None:
    """Check a name.

    Raises:
        DockctlError: it does not match the pattern of its kind, or is taken.
    """
    wrong = not re.fullmatch(starter.pattern, name) or iskeyword(name)
    if wrong:
        letters = {
            NAME: "letters, digits, dots, dashes and underscores, a letter or digit first",
            IDENTIFIER: "a Python name: lowercase letters, digits and underscores, a letter first",
            PROJECT: "lowercase letters, digits, dashes and underscores, a letter first",
        }
        better = re.sub(r"\W+", "_", name.lower()).strip("_")
        suggestion = better if re.fullmatch(starter.pattern, better) and not iskeyword(better) else ""
        raise DockctlError(f"'{name}': expected {letters[starter.pattern]}", suggestion=suggestion)
    catalog.fill()
    if starter.registry is not None and name in starter.registry:
        origin = starter.registry.origin(name)
        message = f"the {starter.registry.noun} '{name}' already exists in {origin}; choose another name"
        raise DockctlError(message, code="duplicate")
    if kind == "plugin" and find_spec(name.replace("-", "_")) is not None:
        raise DockctlError(f"there is already a module '{name}'; choose another name", code="duplicate")
