"""The dry run finds broken plugins in every registered part, at the line that failed, before a run folder."""

from __future__ import annotations

from pathlib import Path

import pytest
from gymnasium.spaces import Box, Discrete

from dockctl.agents.interface import Spaces
from dockctl.errors import InputError, PluginError
from dockctl.experiments.dry_run import build_algorithm, dry_run
from dockctl.scenarios.loader import load
from tests.commands.conftest import dockctl, quick_train

TERM = "from dockctl.rewards.terms import reward_term\nimport numpy as np\n"
PART = "from dockctl.envs.observation import Columns, observation_part\nimport numpy as np\n"
KIND = """
from typing import Literal
import numpy as np
from gymnasium.spaces import Discrete
from dockctl.agents.algorithms import AlgorithmSpec, Dqn, MemoryUse
from dockctl.plugins import ACTIONS, ALGORITHMS, CONDITIONS, RANGE_SENSORS
from dockctl.scenarios.extensions import ActionType, Condition, Disturbance, RangeSensorSpec, register
"""
WORKING = {
    "term": TERM + "@reward_term('mine', kind='{kind}')\ndef mine(status):\n    return {value}\n",
    "part": PART
    + "@observation_part('mine')\ndef mine(view):\n    return Columns(['x'], {value}, {bounds})\n",
    "actions": KIND
    + """
@register(ACTIONS)
class Mine(ActionType):
    kind: Literal['mine'] = 'mine'
    def describe(self): return {describe}
    def space(self, vessel): return {space}
    def commands(self, actions, vessel): return {commands}
""",
    "condition": KIND
    + """
class Water(Disturbance):
    def reset(self, rows, rngs): {reset}
    def water_velocity(self): return {velocity}
    def coefficient_factors(self): return {factors}
    def range_noise(self): return {noise}
    def restore(self, state): {restore}
@register(CONDITIONS, group='water')
class Mine(Condition):
    kind: Literal['mine'] = 'mine'
    def build(self, num_boats): return {build}
    def notes(self, vessel): return {notes}
    def side_force_n(self, vessel): return {force}
""",
    "sensor": KIND
    + """
class Sensor:
    table_bytes = {bytes}
    def points(self, pose, every=1): return {points}
    def sector_ranges(self, eta): return {ranges}
@register(RANGE_SENSORS)
class Mine(RangeSensorSpec):
    kind: Literal['mine'] = 'mine'
    def build(self, triangles): return {build}
""",
    "algorithm": KIND
    + """
class Learner:
    epsilon, updates = None, 0
    @property
    def policy(self): return {policy}
    def reset(self, rows, info): pass
    def act(self, observation, now): return {act} if isinstance(now, int) else {greedy}
    def store(self, step): pass
    def learn(self, env_steps): {learn}
    def policy_tensors(self): return {tensors}
    def state(self): return {state}
@register(ALGORITHMS)
class Mine(AlgorithmSpec):
    kind: Literal['mine'] = 'mine'
    def describe(self): return {describe}
    def memory(self, spaces, training): return {memory}
    def build(self, spaces, training, device): return {build}
    def load_policy(self, tensors, spaces, hidden_sizes): return None
""",
}
GOOD = {
    "term": {"kind": "dense", "value": "np.zeros(len(status.phase))"},
    "part": {"value": "np.zeros((len(view.phase), 1))", "bounds": "0, 1"},
    "actions": {"describe": "''", "space": "Discrete(3)", "commands": "np.zeros((len(actions), 2))"},
    "condition": {
        "reset": "pass",
        "velocity": "0.0",
        "factors": "{}",
        "noise": "None",
        "restore": "pass",
        "build": "Water()",
        "notes": "[]",
        "force": "0.0",
    },
    "sensor": {
        "ranges": "np.ones((len(eta), 8))",
        "points": "np.empty((0, 3))",
        "build": "Sensor()",
        "bytes": "0",
    },
    "algorithm": {
        "act": "np.zeros(len(observation), int)",
        "greedy": "np.zeros(len(observation), int)",
        "policy": "self",
        "learn": "yield {'loss': 1.0}",
        "tensors": "{'w': np.zeros(3)}",
        "state": "{'w': np.zeros(3)}, {'updates': 0}",
        "build": "Learner()",
        "describe": "''",
        "memory": "()",
    },
}
SELECTED = {
    "term": "reward.terms.mine=-1",
    "part": "observation=[distance, mine]",
    "actions": "actions={kind: mine}",
    "condition": "conditions.mine={kind: mine}",
    "sensor": "sensors.lidar={kind: mine}",
    "algorithm": "training.algorithm={kind: mine}",
}
DEFINITION = {"term": "@reward_term", "part": "@observation_part"}
FAULTS = [
    ("term", {"value": "1 / 0"}, "1 / 0"),
    (
        "term",
        {"kind": "collision", "value": "1 / 0 if status.collided.any() else np.zeros(4)"},
        "1 / 0",
    ),
    (
        "term",
        {"kind": "final", "value": "1 / 0 if status.reached_final.any() else np.zeros(4)"},
        "1 / 0",
    ),
    ("term", {"value": "None"}, None),
    ("term", {"value": "np.zeros(len(status.phase), complex)"}, None),
    ("term", {"value": "__import__('sys').exit(7)"}, "exit(7)"),
    ("term", {"value": "np.full(len(status.phase), np.nan)"}, None),
    ("term", {"value": "np.zeros((2, 2))"}, None),
    ("part", {"value": "1 / 0"}, "1 / 0"),
    ("part", {"value": "np.full((len(view.phase), 1), np.nan)"}, None),
    ("part", {"value": "np.zeros((len(view.phase), 1 + (len(view.phase) > 2)))"}, None),
    ("part", {"value": "view.eta.__imul__(0)[:, :1]"}, "view.eta.__imul__(0)"),
    ("part", {"bounds": "1, 0"}, None),
    ("part", {"bounds": "-np.inf, 0"}, None),
    ("part", {"bounds": "0, 1e300"}, None),
    ("actions", {"space": "1 / 0"}, "1 / 0"),
    ("actions", {"commands": "1 / 0"}, "1 / 0"),
    ("actions", {"commands": "np.full((len(actions), 2), np.nan)"}, None),
    ("actions", {"commands": "np.zeros(2)"}, None),
    ("actions", {"commands": "None"}, None),
    ("actions", {"space": "None"}, None),
    ("actions", {"describe": "1 / 0"}, "1 / 0"),
    ("actions", {"describe": "None"}, None),
    ("condition", {"build": "1 / 0"}, "1 / 0"),
    ("condition", {"reset": "1 / 0"}, "1 / 0"),
    ("condition", {"velocity": "1 / 0"}, "1 / 0"),
    ("condition", {"restore": "1 / 0"}, "1 / 0"),
    ("condition", {"notes": "1 / 0"}, "1 / 0"),
    ("condition", {"notes": "None"}, None),
    ("condition", {"notes": "'strong'"}, None),
    ("condition", {"notes": "[('speed_mps', 3)]"}, None),
    ("condition", {"force": "None"}, None),
    ("condition", {"force": "float('nan')"}, None),
    ("condition", {"velocity": "float('nan')"}, None),
    ("condition", {"velocity": "np.zeros((1, 1))"}, None),
    ("condition", {"velocity": "None"}, None),
    ("condition", {"build": "None"}, None),
    ("condition", {"factors": "{'mass': np.ones(4)}"}, None),
    ("condition", {"factors": "{'mass_kg': 1.0}"}, None),
    ("condition", {"factors": "{'mass_kg': np.ones(3)}"}, None),
    ("condition", {"factors": "{'mass_kg': np.zeros(4)}"}, None),
    ("condition", {"noise": "0.1"}, None),
    ("sensor", {"build": "1 / 0"}, "1 / 0"),
    ("sensor", {"ranges": "1 / 0"}, "1 / 0"),
    ("sensor", {"ranges": "np.full((len(eta), 8), np.nan)"}, None),
    ("sensor", {"points": "np.empty((5, 2))"}, None),
    ("sensor", {"points": "1 / 0"}, "1 / 0"),
    ("sensor", {"ranges": "-np.ones((len(eta), 8))"}, None),
    ("sensor", {"ranges": "np.full((len(eta), 8), 101.0)"}, None),
    ("sensor", {"bytes": "'few'"}, None),
    ("sensor", {"bytes": "-1"}, None),
    ("sensor", {"build": "triangles.__iadd__(1)"}, "triangles.__iadd__(1)"),
    ("algorithm", {"build": "1 / 0"}, "1 / 0"),
    ("algorithm", {"describe": "1 / 0"}, "1 / 0"),
    ("algorithm", {"describe": "3"}, None),
    ("algorithm", {"memory": "1 / 0"}, "1 / 0"),
    ("algorithm", {"memory": "None"}, None),
    ("algorithm", {"memory": "(1000,)"}, None),
    ("algorithm", {"memory": "(MemoryUse('replay', None, ''),)"}, None),
    ("algorithm", {"act": "1 / 0"}, "1 / 0"),
    ("algorithm", {"act": "np.zeros(len(observation))"}, None),
    ("algorithm", {"act": "np.full(len(observation), 77)"}, None),
    ("algorithm", {"act": "0"}, None),
    ("algorithm", {"greedy": "np.zeros((len(observation), 1), int)"}, None),
    ("algorithm", {"policy": "None"}, None),
    ("algorithm", {"learn": "return None"}, None),
    ("algorithm", {"learn": "yield {'error': 1.0}"}, None),
    ("algorithm", {"learn": "yield {'loss': 'small'}"}, None),
    ("algorithm", {"learn": "yield 1.0"}, None),
    ("algorithm", {"tensors": "{'w': np.array(['a'])}"}, None),
    ("algorithm", {"state": "{}"}, None),
    ("algorithm", {"state": "{}, {'updates': np.float32(1)}"}, None),
]


def plugin(path: Path, part: str, **changes: str) -> list[str]:
    """Write a plugin that adds one part to scenario 1, and return its source by line."""
    text = WORKING[part].format(**GOOD[part] | changes)
    path.write_text(text)
    return text.splitlines()


@pytest.mark.parametrize("part", WORKING)
def test_a_plugin_that_works_passes(part: str, tmp_path: Path) -> None:
    plugin(tmp_path / "mine.py", part)
    dry_run(load("s1", overrides=[SELECTED[part]], plugin_files=[tmp_path / "mine.py"]))


@pytest.mark.parametrize(("part", "changes", "fault"), FAULTS)
def test_a_fault_is_located(part: str, changes: dict[str, str], fault: str | None, tmp_path: Path) -> None:
    """At the line that failed, or where the part is defined if its result cannot be used."""
    path = tmp_path / "mine.py"
    lines = plugin(path, part, **changes)
    wanted = fault or DEFINITION.get(part, "@register")
    (number,) = [i for i, line in enumerate(lines, start=1) if wanted in line]
    loaded = load("s1", overrides=[SELECTED[part]], plugin_files=[path])
    with pytest.raises(PluginError) as caught:
        dry_run(loaded)
    assert f"({path}:{number})" in str(caught.value)


@pytest.mark.parametrize(("method", "result"), [("describe", "1 / 0"), ("build", "None")])
def test_a_fault_of_an_algorithm_that_extends_dqn_is_located(
    method: str, result: str, tmp_path: Path
) -> None:
    path, fault = tmp_path / "mine.py", f"    def {method}(self, *given): return {result}"
    text = f"{KIND}@register(ALGORITHMS)\nclass Mine(Dqn):\n    kind: Literal['mine'] = 'mine'\n{fault}\n"
    path.write_text(text)
    wanted = fault if "/" in result else "@register(ALGORITHMS)"
    number = 1 + text.splitlines().index(wanted)
    loaded = load("s1", overrides=[SELECTED["algorithm"]], plugin_files=[path])
    with pytest.raises(PluginError, match=rf"mine\.py:{number}\)"):
        dry_run(loaded)


@pytest.mark.parametrize("part", ["actions", "condition", "sensor", "algorithm"])
@pytest.mark.parametrize("field", ["kind: Literal['mine']", "kind: str", "name: str = 'mine'"])
def test_a_class_without_a_default_of_kind_is_located(field: str, part: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    plugin(path, part)
    path.write_text(path.read_text().replace("kind: Literal['mine'] = 'mine'", field))
    (decorator,) = [line for line in path.read_text().splitlines() if line.startswith("@register")]
    number = 1 + path.read_text().splitlines().index(decorator)
    with pytest.raises(PluginError, match=rf"mine\.py:{number}\)"):
        load("s1", overrides=[SELECTED[part]], plugin_files=[path])


@pytest.mark.parametrize(
    ("part", "after"), [("condition", "= 'mine'\n"), ("actions", "def describe(self): return ''\n")]
)
def test_fitted_that_returns_something_else_is_located(part: str, after: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    plugin(path, part)
    path.write_text(path.read_text().replace(after, f"{after}    def fitted(self, vessel): pass\n"))
    (decorator,) = [line for line in path.read_text().splitlines() if line.startswith("@register")]
    number = 1 + path.read_text().splitlines().index(decorator)
    with pytest.raises(PluginError, match=rf"mine\.py:{number}\)"):
        load("s1", overrides=[SELECTED[part]], plugin_files=[path])


@pytest.mark.parametrize("error", ["ValueError", "AssertionError"])
@pytest.mark.parametrize(
    ("part", "after"), [("condition", "= 'mine'\n"), ("actions", "def describe(self): return ''\n")]
)
def test_an_exception_while_a_part_is_fitted_is_not_one_of_the_user(
    part: str, after: str, error: str, tmp_path: Path
) -> None:
    path = tmp_path / "mine.py"
    plugin(path, part)
    text = path.read_text()
    path.write_text(text.replace(after, f"{after}    def fitted(self, vessel): raise {error}\n"))
    number = 1 + path.read_text().splitlines().index(f"    def fitted(self, vessel): raise {error}")
    with pytest.raises(PluginError, match=rf"mine\.py:{number}\)"):
        load("s1", overrides=[SELECTED[part]], plugin_files=[path])


@pytest.mark.parametrize("algorithm", ["dqn", "mine"])
@pytest.mark.parametrize("space", ["Discrete(7, start=-3)", "Box(-1, 1, (2,), np.float64)"])
def test_actions_of_which_no_policy_can_be_saved_are_located(
    space: str, algorithm: str, tmp_path: Path
) -> None:
    own = [tmp_path / "space.py", tmp_path / "learner.py"]
    plugin(own[0], "actions", space=space)
    own[0].write_text(own[0].read_text().replace("import Discrete", "import Box, Discrete"))
    plugin(own[1], "algorithm", act="np.zeros(len(observation), int) - 2")
    overrides = [SELECTED["actions"], f"training.algorithm={{kind: {algorithm}}}"]
    with pytest.raises(InputError) as caught:
        dry_run(load("s1", overrides=overrides, plugin_files=own))
    (problem,) = caught.value.problems
    assert (problem.file, problem.code) == ("--set actions", "mismatch")


def test_the_unit_of_distances_is_that_of_the_reward(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    plugin(path, "term", value="status.distance_m / distance_unit_m")
    path.write_text(path.read_text().replace("mine(status)", "mine(status, *, distance_unit_m: float)"))
    dry_run(load("s1", overrides=[SELECTED["term"]], plugin_files=[path]))


def test_an_exception_of_several_lines_is_one_error(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    plugin(path, "term", value="exec(\"raise AssertionError('one' + chr(10) + 'two')\")")
    loaded = load("s1", overrides=[SELECTED["term"]], plugin_files=[path])
    with pytest.raises(PluginError, match="one two"):
        dry_run(loaded)


@pytest.mark.filterwarnings("error")
def test_conditions_in_which_the_integration_diverges_are_located(tmp_path: Path) -> None:
    scenario = tmp_path / "storm.yaml"
    wind = "{speed_mps: 50, direction_deg: 90, length_m: 1e9}"
    scenario.write_text(f"extends: s1\nconditions:\n  wind: {wind}\n")
    with pytest.raises(InputError) as caught:
        dry_run(load(str(scenario)))
    (problem,) = caught.value.problems
    assert (problem.line, problem.field, problem.code) == (3, "conditions", "out_of_range")


def test_draws_of_a_condition_in_which_the_integration_diverges_are_located(tmp_path: Path) -> None:
    """Hardly one boat in ten meets a current with which it diverges."""
    scenario = tmp_path / "stream.yaml"
    current = "{speed_mps: [0, 10], direction_deg: [0, 360], variation_mps: 3}"
    scenario.write_text(f"extends: s1\nconditions:\n  current: {current}\n")
    with pytest.raises(InputError) as caught:
        dry_run(load(str(scenario)))
    (problem,) = caught.value.problems
    assert (problem.line, problem.field, problem.code) == (3, "conditions", "out_of_range")


def test_validate_and_train_report_the_fault_and_leave_no_run_folder(tmp_path: Path) -> None:
    path, runs = tmp_path / "mine.py", tmp_path / "runs"
    plugin(path, "term", value="1 / 0")
    selected = ("s1", "--set", SELECTED["term"], "--plugin", path)
    for outcome in (dockctl("validate", *selected), quick_train(runs, *selected)):
        assert outcome.code == 2
        assert f"({path}:5)" in outcome.err
        assert len(outcome.err.splitlines()) == 1
    assert not runs.exists()


@pytest.mark.parametrize(
    "fault",
    [
        {"points": "np.empty((5, 2))"},
        {"points": "None"},
        {"points": "np.full((5, 3), np.nan)"},
        {"ranges": "None"},
        {"ranges": "np.ones((len(eta), 3))"},
        {"ranges": "np.full((len(eta), 8), np.nan)"},
    ],
)
def test_a_sensor_whose_scan_cannot_be_drawn(fault: dict[str, str], tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    lines = plugin(path, "sensor", **fault)
    outcome = dockctl("show", "s1", "--set", SELECTED["sensor"], "--plugin", path, "--out", tmp_path / "out")
    assert outcome.code == 2
    assert f"({path}:{1 + lines.index('@register(RANGE_SENSORS)')})" in outcome.err
    assert not (tmp_path / "out").exists()


def test_a_condition_may_report_more_than_the_range_of_the_sensor(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    plugin(path, "condition")
    bias = "    def reported_ranges(self, ranges, rows, range_m): return ranges + 0.1\n"
    path.write_text(
        path.read_text().replace("class Water(Disturbance):\n", f"class Water(Disturbance):\n{bias}")
    )
    dry_run(load("s1", overrides=[SELECTED["condition"]], plugin_files=[path]))


def test_an_algorithm_that_fails_later_is_one_error_that_names_it(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    lines = plugin(path, "algorithm", learn="yield {'loss': 1.0} if env_steps < 40 else {}")
    outcome = quick_train(tmp_path / "runs", "s1", "--set", SELECTED["algorithm"], "--plugin", path)
    assert outcome.code == 2
    assert f"({path}:{1 + lines.index('@register(ALGORITHMS)')})" in outcome.err
    assert len(outcome.err.splitlines()) == 1


@pytest.mark.parametrize(
    ("algorithm", "actions", "field", "suggestion"),
    [
        ("{kind: dqn}", "continuous", "actions", None),
        ("{kind: sb3, model: SAC}", "grid", "training.algorithm", None),
        ("{kind: sb3, model: DQM}", "grid", "training.algorithm.model", "DQN"),
        (
            "{kind: sb3, hyperparameters: {lerning_starts: 1}}",
            "grid",
            "training.algorithm.hyperparameters.lerning_starts",
            "learning_starts",
        ),
    ],
)
def test_an_algorithm_that_does_not_fit_is_located(
    tmp_path: Path, algorithm: str, actions: str, field: str, suggestion: str | None
) -> None:
    if "sb3" in algorithm:
        pytest.importorskip("stable_baselines3")
    scenario = tmp_path / "mine.yaml"
    scenario.write_text(f"extends: s1\nactions: {actions}\ntraining:\n  algorithm: {algorithm}\n")
    with pytest.raises(InputError) as caught:
        dry_run(load(str(scenario)))
    (problem,) = caught.value.problems
    assert (problem.line, problem.field) == (2 if field == "actions" else 4, field)
    assert suggestion in (None, problem.suggestion)


def test_an_algorithm_that_cannot_learn_from_mirror_images() -> None:
    changes = ["training.algorithm.kind=sb3", "training.mirrored=true", "training.replay_capacity=1000"]
    loaded = load("s1", overrides=changes)
    spaces = Spaces(Box(-1, 1, (15,)), Discrete(77))
    with pytest.raises(InputError) as caught:
        build_algorithm(loaded, spaces, 1, "cpu")
    assert caught.value.problems[0].file == "--set training.mirrored"


def test_a_replay_that_cannot_be_allocated_is_located(monkeypatch: pytest.MonkeyPatch) -> None:
    def allocate(*_: object) -> None:
        raise MemoryError("Unable to allocate 127 GiB")

    monkeypatch.setattr("dockctl.agents.dqn.algorithm.Replay", allocate)
    loaded = load("s1", overrides=["training.replay_capacity=999999999"])
    spaces = Spaces(Box(-1, 1, (2,)), Discrete(3))
    with pytest.raises(InputError) as caught:
        build_algorithm(loaded, spaces, 2, "cpu")
    (problem,) = caught.value.problems
    assert (problem.file, problem.code) == ("--set training.replay_capacity", "unavailable")
