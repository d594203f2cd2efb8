"""Scenario files with random faults, each determined by the number of its case."""

from __future__ import annotations

import copy
import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from dockctl.scenarios import loader

Data = Any
Steps = tuple[str | int, ...]

SMALL = {
    "sensors.lidar": "{kind: planar, rays: 36}",
    "harbor.rows": "[{side: east, finger_y_m: [-2.5, 2.5], berth_y_m: [-5, 0, 5], free_y_m: [0]}]",
}
"""Fewer rays and vessels, so that a case takes less time."""

NUMBERS = [0, -1, 1, 2, 7, 1e308, -1e308, 1e-308, 5e-324, 1e9, -1e9, 1e4, 1e-13, 10**17, 1e12, 0.5, 3.7]
NUMBERS += [float("nan"), float("inf"), -float("inf"), 10**30, 65, 1001, 90, 180, 359.9999]
TEXTS = [
    "",
    " ",
    "x" * 5000,
    "é",
    "\u202eabc",
    "😀",
    "~",
    "null",
    "true",
    "1e5",
    "0x1F",
    "s1",
    "marina",
    "planar",
]
TEXTS += [
    "../x.yaml",
    "/dev/zero",
    "/dev/zero.obj",
    "x.obj",
    "gone.stl",
    ".",
    "..",
    "*",
    "&a",
    "!!int",
    "a: b",
    "- 1",
]
TEXTS += [
    "kind",
    "east",
    "speed",
    "eilbrecht",
    "reference",
    "haven",
    "current",
    "thesis",
    "x.yaml",
    "\t",
    "a\nb",
]
OTHERS: list[Data] = [
    None,
    True,
    False,
    [],
    {},
    [[]],
    {"a": 1},
    [None],
    [1, "a"],
    {"": 1},
    {"kind": "planar"},
]
OTHERS += [
    {"kind": "meshes", "meshes": [{"path": "x.obj"}]},
    {"extends": "s1"},
    [[1, 2], [3]],
    {"1": {"2": []}},
]


def deep(levels: int) -> Data:
    value: Data = 1
    for level in range(levels):
        value = [value] if level % 2 else {"a": value}
    return value


def bases() -> dict[str, Data]:
    """Return complete scenarios, and one that extends a scenario."""
    found = {}
    for name in ("s1", "s3"):
        small = loader.load(name, overrides=[f"{key}={value}" for key, value in SMALL.items()])
        found[name] = yaml.safe_load(loader.dump(small.scenario))
    found["extended"] = {
        "extends": "s1",
        "sensors": {"lidar": {"kind": "planar", "rays": 36}},
        "conditions": {"current": {"speed_mps": [0, 0.1], "direction_deg": 90}},
        "harbor": {"rows": [{"side": "east", "finger_y_m": [-2, 2], "berth_y_m": [0, 6], "free_y_m": [0]}]},
        "task": {"berths": {"trained": {"east": [0]}, "held_out": {"east": [6]}}},
        "reward": {"terms": {"speed": -3, "progress": 1, "orientation": None}},
        "observation": ["distance", {"lidar": {"cap_m": 20}}, {"part": "velocity", "params": {"cap": 2}}],
    }
    return found


def places(data: Data, path: Steps = ()) -> Iterator[Steps]:
    """Yield the path of every value but the root."""
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in items:
        yield (*path, key)
        yield from places(value, (*path, key))


def at(data: Data, path: Steps) -> Data:
    for step in path:
        data = data[step]
    return data


def _odd(rng: random.Random) -> Data:
    kind = rng.random()
    if kind < 0.4:
        return rng.choice(NUMBERS)
    if kind < 0.6:
        return rng.choice(TEXTS)
    if kind < 0.9:
        return copy.deepcopy(rng.choice(OTHERS))
    return deep(rng.choice((3, 20, 45, 60)))


def _scaled(value: Data, rng: random.Random) -> Data:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return _odd(rng)
    factor = rng.choice((-1, 0.5, 0.99, 1.01, 1.5, 2, 10, 1000, 1e-3, 1e6))
    return int(value * factor) if isinstance(value, int) and rng.random() < 0.7 else value * factor


def _mutate_data(data: Data, rng: random.Random) -> None:
    """Change one place of a tree of dicts and lists."""
    found = list(places(data))
    if not found:
        return
    path = rng.choice(found)
    parent, key = at(data, path[:-1]), path[-1]
    action = rng.choice(
        ("replace", "replace", "scale", "scale", "scale", "delete", "rename", "swap", "move", "add")
    )
    if action == "replace":
        parent[key] = _odd(rng)
    elif action == "scale":
        parent[key] = _scaled(parent[key], rng)
    elif action == "delete":
        del parent[key]
    elif action == "swap":
        other = rng.choice(found)
        parent[key] = copy.deepcopy(at(data, other))
    elif action == "add" and isinstance(parent, dict):
        parent[rng.choice((*TEXTS[:8], "kind", "params", "extends", "plugins", "<<", str(key) + "_m"))] = (
            _odd(rng)
        )
    elif isinstance(parent, list):
        parent.insert(rng.randrange(len(parent) + 1), copy.deepcopy(parent[key]))
    else:
        name = rng.choice((str(key)[1:], str(key) + "s", str(key).upper(), rng.choice(TEXTS)))
        parent[name] = parent.pop(key)


def _mutate_text(text: str, rng: random.Random) -> str:
    """Change one place of a YAML text."""
    lines = text.splitlines(keepends=True) or [""]
    row = rng.randrange(len(lines))
    place = rng.randrange(len(text) + 1)
    marks = (
        "&a ",
        "*a",
        "!!int ",
        "!!str ",
        "!foo ",
        "!!python/object:os.system ",
        "<<: ",
        "? ",
        "- ",
        "{",
        "}",
        "[",
    )
    marks += (
        "]",
        ":",
        ": ",
        ",",
        "'",
        '"',
        "#",
        "|",
        ">",
        "%",
        "@",
        "`",
        "\t",
        "\n",
        "---\n",
        "...\n",
        "\0",
        "\u2028",
        "\ufeff",
        "\r",
    )
    action = rng.randrange(8)
    if action == 0:
        lines.insert(row, lines[row])
    elif action == 1:
        del lines[row]
    elif action == 2:
        lines[row] = " " * rng.randrange(1, 4) + lines[row]
    elif action == 3:
        other = rng.randrange(len(lines))
        lines[row], lines[other] = lines[other], lines[row]
    elif action == 4:
        return text[:place] + rng.choice(marks) + text[place:]
    elif action == 5:
        return text[:place] + text[place + rng.randrange(1, 30) :]
    elif action == 6:
        colon = lines[row].find(": ")
        lines[row] = lines[row][: colon + 2] + rng.choice(marks) + lines[row][colon + 2 :]
    else:
        return (
            text[:place]
            + chr(rng.choice((rng.randrange(32, 127), rng.randrange(0x110000))))
            + text[place + 1 :]
        )
    return "".join(lines)


def write_case(case: int, folder: Path, given: dict[str, Data]) -> Path:
    """Write the files of a case, and return the scenario's."""
    rng = random.Random(case)
    data = copy.deepcopy(given[rng.choice(list(given))])
    for _ in range(rng.choice((0, 1, 1, 1, 2, 3))):
        _mutate_data(data, rng)
    text = yaml.safe_dump(
        data, sort_keys=False, allow_unicode=True, default_flow_style=rng.choice((None, False, True))
    )
    for _ in range(rng.choice((0, 0, 1, 3))):
        text = _mutate_text(text, rng)
    path = folder / "x.yaml"
    content = text.encode("utf-8", "surrogatepass")
    if rng.random() < 0.05:
        place = rng.randrange(len(content) + 1)
        content = content[:place] + bytes([rng.randrange(256)]) + content[place:]
    path.write_bytes(content)
    if rng.random() < 0.1:  # in a chain, a circle, or as a vessel or a harbor
        path.rename(folder / "y.yaml")
        extended = rng.choice(
            (
                "extends: y.yaml\n",
                "extends: x.yaml\n",
                "extends: s1\nharbor: y.yaml\n",
                "extends: s1\nvessel: y.yaml\n",
            )
        )
        path.write_text(extended, encoding="utf-8")
    return path
