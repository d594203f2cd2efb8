"""One test for each thing that a user can get wrong in a scenario: the exact place and what is said."""

from __future__ import annotations

from pathlib import Path

import pytest

from dockctl.errors import InputError
from dockctl.scenarios import loader

# What follows `extends: s1` in line 1, the places, and the messages; one problem a line.
WRONG: dict[str, tuple[str, list[str]]] = {
    "unknown key": (
        "tolerence: 3\ntask: {final_tolerence: {}}\n",
        [
            "2:1: tolerence: unknown key 'tolerence'",
            "3:8: task.final_tolerence: unknown key 'final_tolerence'; did you mean 'final_tolerance'?",
        ],
    ),
    "unknown key of a list's item": (
        "task:\n  initial:\n    - {x_m: 1, y_m: 2, heading: 3}\n",
        [
            "4:7: task.initial.0.heading_deg: missing; add 'heading_deg: ...'",
            "4:24: task.initial.0.heading: unknown key 'heading'; did you mean 'heading_deg'?",
        ],
    ),
    "a text for a number": (
        "task: {max_steps: many}\n",
        ["2:19: task.max_steps: found the text 'many', expected a whole number"],
    ),
    "a number for a text": ("title: 3\n", ["2:8: title: found 3, expected text"]),
    "a broken number": (
        "task: {max_steps: 2.5}\n",
        ["2:19: task.max_steps: found 2.5, expected a whole number"],
    ),
    "a boolean for a number": (
        "vessel: {mass_kg: true}\n",
        ["2:19: vessel.mass_kg: found true, expected a number"],
    ),
    "a list for a mapping": ("task: [1]\n", ["2:7: task: found a list, expected a mapping"]),
    "a mapping for a list": (
        "observation: {lidar: {}}\n",
        ["2:14: observation: found a mapping, expected a list"],
    ),
    "too small": (
        "vessel: {substeps: 0}\n",
        ["2:20: vessel.substeps: found 0, expected a number of at least 1"],
    ),
    "too large": (
        "vessel: {max_rudder_deg: 91}\n",
        ["2:26: vessel.max_rudder_deg: found 91, expected a number of at most 90"],
    ),
    "not a fraction": (
        "training: {gamma: 1.5}\n",
        ["2:19: training.gamma: found 1.5, expected a number of at most 1"],
    ),
    "no item": (
        "task: {initial: []}\n",
        ["2:17: task.initial: found an empty list, expected at least 1 item"],
    ),
    "unreachable tolerance": (
        "task:\n  final_tolerance: {distance_m: 0}\n",
        [
            "3:33: task.final_tolerance.distance_m: found 0, expected a number greater than 0; "
            "a tolerance of zero or less can never be reached"
        ],
    ),
    "two headings in one tolerance": (
        "task:\n  final_tolerance: {heading_deg: 4}\n",
        ["3:20: task.final_tolerance: give exactly one of heading_deg and heading_rad"],
    ),
    "no final pose": (
        "task: {final: null}\n",
        ["2:15: task.final: missing; add 'final: {x_m: ..., y_m: ..., heading_deg: ...}'"],
    ),
    "half a pose": (
        "task: {intermediate: {x_m: 1}}\n",
        [
            "2:8: task.intermediate.y_m: missing; add 'y_m: ...'",
            "2:8: task.intermediate.heading_deg: missing; add 'heading_deg: ...'",
        ],
    ),
    "not numbers": (
        "task: {final: {x_m: .nan, y_m: 1e999}}\ntraining: {gamma: -.inf}\n",
        [
            "2:21: task.final.x_m: found .nan, expected a finite number",
            "2:32: task.final.y_m: found 1e999, expected a finite number",
            "3:19: training.gamma: found -.inf, expected a finite number",
        ],
    ),
    "too few substeps to be stable": (
        "vessel: {substeps: 1}\n",
        [
            "2:20: vessel.substeps: substeps: 1 in 0.5 s diverge, since this vessel's fastest motion decays "
            "at 9.81 1/s; expected at least 2"
        ],
    ),
    "more boats than fit anywhere": (
        "training: {boats: 1_000_000_000}\n",
        ["2:19: training.boats: found 1000000000, expected a number of at most 4096"],
    ),
    "no known choice": (
        "training: {optimizer: adma}\n",
        [
            "2:23: training.optimizer: found the text 'adma', "
            "expected 'adam' or 'rmsprop'; did you mean 'adam'?"
        ],
    ),
    "no known preset": (
        "training: {preset: theses}\n",
        [
            "2:20: training.preset: found the text 'theses', "
            "expected 'default' or 'thesis'; did you mean 'thesis'?"
        ],
    ),
    "no known vessel": (
        "vessel: eilbrect\n",
        ["2:9: vessel: unknown vessel 'eilbrect'; did you mean 'eilbrecht'? (known: eilbrecht"],
    ),
    "no known harbor": (
        "harbor: refrence\n",
        ["2:9: harbor: unknown harbor 'refrence'; did you mean 'reference'?"],
    ),
    "no such harbor file": ("harbor: gone.yaml\n", ["2:9: harbor: there is no file "]),
    "unknown kind of harbor": (
        "harbor: {kind: mesh}\n",
        ["2:9: harbor: found the text 'mesh' as kind, expected 'marina', 'meshes'; did you mean 'meshes'?"],
    ),
    "unknown side of a row": (
        "harbor: {rows: [{side: esat, berth_y_m: [0]}]}\n",
        ["2:17: harbor.rows.0: found the text 'esat' as side, expected 'east', 'west', 'north', 'south'"],
    ),
    "a row without a side": (
        "harbor: {rows: [{berth_y_m: [0]}]}\n",
        ["2:17: harbor.rows.0: the key 'side' is missing (one of: east, west, north, south)"],
    ),
    "a key of another kind of row": (
        "harbor:\n  rows:\n    - {side: east, berth_y_m: [0], berth_x_m: [1]}\n",
        ["4:36: harbor.rows.0.berth_x_m: unknown key 'berth_x_m'; did you mean 'berth_y_m'?"],
    ),
    "a basin inside out": (
        "harbor:\n  basin: {x_min_m: 90}\n",
        ["3:20: harbor.basin.x_min_m: x_min_m (90) must be less than x_max_m (38.5)"],
    ),
    "commands beyond the vessel": (
        "actions: {propeller_n: [-60, 60]}\n",
        ["2:24: actions.propeller_n: actions.propeller_n exceeds the vessel's max_propeller_n, 50"],
    ),
    "an impossible vessel": (
        "vessel: {X_udot_kg: 200}\n",
        ["2:9: vessel: the inertia matrix (eq. 2.17) is not positive definite"],
    ),
    "unknown reward term": (
        "reward:\n  terms:\n    distence: -1\n",
        ["4:5: reward.terms.distence: unknown reward term 'distence'; did you mean 'distance'? (known: "],
    ),
    "removing an unknown reward term": (
        "reward: {terms: {sped: null}}\n",
        ["2:18: reward.terms.sped: unknown reward term 'sped'; did you mean 'speed'?"],
    ),
    "unknown parameter of a term": (
        "reward: {terms: {speed: {params: {flor: 1}}}}\n",
        ["2:35: reward.terms.speed.params.flor: unknown parameter 'flor'; did you mean 'floor'?"],
    ),
    "wrong type of a parameter": (
        "reward: {terms: {speed: {params: {floor: low}}}}\n",
        ["2:42: reward.terms.speed.params.floor: found the text 'low', expected a number"],
    ),
    "a parameter out of range": (
        "reward: {terms: {speed: {weight: -1, params: {floor: 0}}}}\nobservation: [{lidar: {cap_m: -5}}]\n",
        [
            "2:54: reward.terms.speed.params.floor: found 0, expected a number greater than 0",
            "3:31: observation.0.lidar.cap_m: found -5, expected a number greater than 0",
        ],
    ),
    "a vessel that is a folder": (
        "vessel: .\n",
        ["2:9: vessel: '.' is a directory; name a YAML file"],
    ),
    "a term without weight": (
        "reward: {terms: {progress: {params: {}}}}\n",
        ["2:18: reward.terms.progress.weight: missing; add 'weight: ...'"],
    ),
    "a weight that is no number": (
        "reward: {terms: {speed: fast}}\n",
        ["2:25: reward.terms.speed: found the text 'fast', expected a number"],
    ),
    "a term twice": (
        "reward: {terms: {mine: {term: speed, weight: -1}}}\n",
        ["2:24: reward.terms.mine: the reward term 'speed' stands twice; first in reward.terms.speed"],
    ),
    "unknown observation part": (
        "observation:\n  - distance\n  - ladar\n",
        ["4:5: observation.1: unknown observation part 'ladar'; did you mean 'lidar'?"],
    ),
    "unknown parameter of a part": (
        "observation: [{lidar: {cap: 3}}]\n",
        ["2:24: observation.0.lidar.cap: unknown parameter 'cap'; did you mean 'cap_m'?"],
    ),
    "a part with a wrong parameter": (
        "observation:\n  - {part: lidar, params: {cap_m: [3]}}\n",
        ["3:35: observation.0.params.cap_m: found a list, expected a number"],
    ),
    "a name that is no folder's": (
        "name: ../up\n",
        ["2:7: name: found the text '../up', expected letters, digits, dots, dashes and underscores"],
    ),
    "more docked than episodes": (
        "training: {stop: {docked: 20, episodes: 10}}\n",
        ["2:27: training.stop.docked: docked (20) must not exceed episodes (10)"],
    ),
    "all at once, in order": (
        "training: {seed: -1, boats: 0}\ntask: {max_steps: x}\nobservation: [nothing_like_it]\n",
        [
            "2:18: training.seed: found -1, expected a number of at least 0",
            "2:29: training.boats: found 0, expected a number of at least 1",
            "3:19: task.max_steps: found the text 'x'",
            "4:15: observation.0: unknown observation part 'nothing_like_it' (known: ",
        ],
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_says_what_and_where(tmp_path: Path, case: str) -> None:
    text, expected = WRONG[case]
    path = tmp_path / "x.yaml"
    path.write_text(f"extends: s1\n{text}")
    with pytest.raises(InputError) as caught:
        loader.load(path)
    found = [str(problem).removeprefix(f"{path}:") for problem in caught.value.problems]
    assert [line[: len(start)] for line, start in zip(found, expected, strict=False)] == expected, found
    assert len(found) == len(expected), found


def test_a_file_that_says_nothing_is_told_what_a_scenario_needs(tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    path.write_text("title: nothing else\n")
    with pytest.raises(InputError) as caught:
        loader.load(path)
    found = {problem.field: problem.message for problem in caught.value.problems}
    assert set(found) == {"vessel", "harbor", "observation", "task", "reward"}
    assert found["vessel"].startswith("missing; name one (eilbrecht")
    assert found["task"] == "missing; add 'task: {initial: ..., final: ...}'"
    assert found["observation"] == "missing; add 'observation: [{part: ...}]'"


def test_an_error_in_a_vessel_file_names_that_file(tmp_path: Path) -> None:
    (tmp_path / "boat.yaml").write_text("extends: eilbrecht\nmass: 3\n")
    (tmp_path / "x.yaml").write_text("extends: s1\nvessel: boat.yaml\n")
    with pytest.raises(InputError) as caught:
        loader.load(tmp_path / "x.yaml")
    assert str(caught.value).startswith(
        f"{tmp_path}/boat.yaml:2:1: vessel.mass: unknown key 'mass'; did you mean 'mass_kg'?"
    )
    with pytest.raises(InputError, match=r"boat\.yaml:2:1: vessel\.mass: unknown key"):
        loader.load_vessel(tmp_path / "boat.yaml")
