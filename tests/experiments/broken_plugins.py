"""Plugins of every registered part that work, and the same with one fault each."""

from __future__ import annotations

from pathlib import Path

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
    shared_bytes = {shared}
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
        "shared": "property(lambda self: 0)",
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
    ("actions", {"commands": "np.full((len(actions), 2), 51.0)"}, None),
    ("actions", {"commands": "np.stack([0.0 * actions, np.where(actions == 2, 30.0, 0.0)], axis=1)"}, None),
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
    ("sensor", {"shared": "property(lambda self: 'few')"}, None),
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
