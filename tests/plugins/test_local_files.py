"""Plugins in local files, and how they fail."""

from __future__ import annotations

from pathlib import Path

import pytest

from dockctl import plugins
from dockctl.errors import DuplicateNameError, InputError, PluginError
from dockctl.plugins import HARBORS, REWARD_TERMS
from dockctl.scenarios import loader
from tests.commands.conftest import quick_train
from tests.plugins.conftest import TERM, Write


def test_a_local_file_registers_a_term_with_its_origin(write: Write) -> None:
    path = write("mine.py", TERM.format(name="mine"))
    plugins.load_file(path)
    plugins.load_file(path)
    assert REWARD_TERMS.get("mine").origin == f"file {path}"
    assert REWARD_TERMS.get("mine").value.__module__.startswith("_dockctl_plugin_")


def test_the_same_content_at_another_path_is_the_same_plugin(write: Write) -> None:
    plugins.load_file(write("mine.py", TERM.format(name="mine")))
    plugins.load_file(write("copy.py", TERM.format(name="mine")))
    assert REWARD_TERMS.origin("mine").endswith("mine.py")


def test_an_edited_file_replaces_its_earlier_registrations(write: Write) -> None:
    first = TERM.format(name="mine")
    for text, names in ((first, {"mine"}), (TERM.format(name="other"), {"other"}), (first, {"mine"})):
        plugins.load_file(write("mine.py", text))
        assert {"mine", "other"} & set(REWARD_TERMS.names()) == names


def test_a_local_file_may_not_take_a_known_name(write: Write) -> None:
    path = write("mine.py", TERM.format(name="first") + TERM.format(name="distance"))
    with pytest.raises(DuplicateNameError) as caught:
        plugins.load_file(path)
    assert caught.value.origins == ("dockctl", f"file {path}")
    assert "first" not in REWARD_TERMS
    assert REWARD_TERMS.get("distance").origin == "dockctl"


@pytest.mark.parametrize(
    ("name", "text", "location"),
    [
        ("mine.py", "import nothing_of_this_name\n", r"mine\.py:1"),
        ("mine.py", "x = 1\ny = 1 / 0\n", r"mine\.py:2"),
        ("mine.py", "def f(:\n", r"mine\.py:1"),
        ("mine.py", "raise ValueError('one\\n two')\n", r"one two \(.*mine\.py:1"),
        ("mine.py", "x = 1\nraise SystemExit(3)\n", r"mine\.py:2"),
        ("mine.txt", "x = 1\n", r"mine\.txt"),
    ],
)
def test_a_broken_file_is_an_error_with_its_line(write: Write, name: str, text: str, location: str) -> None:
    path = write(name, text)
    for _ in range(2):
        with pytest.raises(PluginError, match=location):
            plugins.load_file(path)


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(PluginError, match=r"gone\.py"):
        plugins.load_file(tmp_path / "gone.py")


def test_a_scenario_names_its_files_and_every_failure_is_located(write: Write) -> None:
    write("mine.py", TERM.format(name="mine"))
    write("bad.py", "1 / 0\n")
    scenario = write(
        "x.yaml",
        "extends: s1\nplugins:\n  - mine.py\n  - bad.py\n  - gone.py\n"
        "reward:\n  terms:\n    mine: {weight: 1, params: {floor: high, sizes: [1, 2.5]}}\n",
    )
    with pytest.raises(InputError) as caught:
        loader.load(scenario)
    assert [(p.line, p.column, p.field, p.code) for p in caught.value.problems] == [
        (4, 5, "plugins.1", "plugin"),
        (5, 5, "plugins.2", "plugin"),
        (8, 5, "reward.terms.mine", "missing_key"),
        (8, 39, "reward.terms.mine.params.floor", "wrong_type"),
        (8, 52, "reward.terms.mine.params.sizes", "wrong_type"),
    ]


def test_the_files_of_scenario_and_command_line_are_recorded(write: Write) -> None:
    mine, more = write("mine.py", TERM.format(name="mine")), write("more.py", TERM.format(name="more"))
    params = "{weight: 1, params: {needed: true}}"
    scenario = write(
        "x.yaml", f"extends: s1\nplugins: [mine.py]\nreward: {{terms: {{more: {params}, mine: {params}}}}}"
    )
    loaded = loader.load(scenario, plugin_files=[more])
    assert loaded.plugin_files == (more, mine)
    assert loaded.scenario.plugins == (str(more), str(mine))
    assert loader.load(write("y.yaml", loader.dump(loaded.scenario))).scenario == loaded.scenario.model_copy(
        update={"name": loaded.scenario.name}
    )


def test_two_functions_of_a_module_may_not_share_a_name(write: Write) -> None:
    other = TERM.format(name="twice").replace("def term", "def another")
    with pytest.raises(DuplicateNameError):
        plugins.load_file(write("twice.py", TERM.format(name="twice") + other))


def test_a_local_file_may_register_a_harbor(write: Write) -> None:
    write("canal.yaml", "extends: reference\nname: canal\n")
    path = write(
        "mine.py",
        "from pathlib import Path\nfrom dockctl.plugins import HARBORS\n"
        "HARBORS.register('canal', Path(__file__).parent / 'canal.yaml')\n",
    )
    scenario = write("x.yaml", "extends: s1\nharbor: canal\n")
    assert loader.load(scenario, plugin_files=[path]).scenario.harbor.name == "canal"
    assert HARBORS.origin("canal") == f"file {path}"


@pytest.mark.parametrize("postponed", [False, True])
def test_an_unknown_name_in_an_annotation_is_an_error_of_the_plugin(write: Write, postponed: bool) -> None:
    path = write(
        "swirl.py",
        "from __future__ import annotations\n"
        * postponed
        + "from typing import Literal\nfrom dockctl.plugins import CONDITIONS\n"
        "from dockctl.scenarios.extensions import Condition, register\n"
        "@register(CONDITIONS, group='water')\nclass Swirl(Condition):\n"
        "    kind: Literal['swirl'] = 'swirl'\n    speed_mps: Drwn[float]\n"
        "    def build(self, num_boats): ...\n",
    )
    with pytest.raises(PluginError, match="name 'Drwn' is not defined") as caught:
        plugins.load_file(path)
    assert f"{path}:" in str(caught.value) and "pydantic.dev" not in str(caught.value)
    assert "swirl" not in plugins.CONDITIONS


def test_postponed_annotations_may_name_what_is_defined_later(write: Write) -> None:
    """With any name, also one that the loading itself uses."""
    path = write(
        "later.py",
        "from __future__ import annotations\n"
        "from typing import Literal\nfrom dockctl.plugins import CONDITIONS\n"
        "from dockctl.scenarios.extensions import Condition, register\n"
        "@register(CONDITIONS, group='water')\nclass Later(Condition):\n"
        "    kind: Literal['later'] = 'later'\n    first: path = 2.0\n    second: entry = 3.0\n"
        "    def build(self, num_boats): ...\n"
        "path, entry = float, float\n",
    )
    later = plugins.load_file(path).Later(first=1.0)
    assert (later.first, later.second) == (1, 3)


@pytest.mark.parametrize(("base", "missing"), [("ActionType", "commands"), ("Kind", "ActionType")])
def test_an_incomplete_class_is_rejected_where_it_is_selected(write: Write, base: str, missing: str) -> None:
    write(
        "half.py",
        "from typing import Literal\nfrom dockctl.plugins import ACTIONS\n"
        "from dockctl.scenarios.extensions import ActionType, Kind, register\n"
        f"@register(ACTIONS)\nclass Half({base}):\n    kind: Literal['half'] = 'half'\n",
    )
    with pytest.raises(InputError, match=missing) as caught:
        loader.load(write("x.yaml", "extends: s1\nplugins: [half.py]\nactions: {kind: half}\n"))
    (problem,) = caught.value.problems
    assert (problem.line, problem.field, problem.code) == (3, "actions.kind", "plugin")


@pytest.mark.parametrize("faulty", ["import nothing_of_this_name", "def (", None])
def test_a_name_of_a_plugin_that_does_not_load_is_no_second_error(write: Write, faulty: str | None) -> None:
    if faulty is not None:
        write("mine.py", faulty)
    text = "extends: s1\nplugins: [mine.py]\nconditions: {mine: {}}\nreward: {terms: {mine: 1}}\nname: [1]\n"
    with pytest.raises(InputError) as caught:
        loader.load(write("x.yaml", text))
    assert [problem.field for problem in caught.value.problems] == ["plugins.0", "name"]


FAILING = """from typing import Literal
from gymnasium.spaces import Discrete
from dockctl import plugins
from dockctl.envs.observation import observation_part
from dockctl.rewards.terms import reward_term
from dockctl.scenarios.extensions import ActionType, Condition, Disturbance, RangeSensorSpec, register
reward_term("bad", kind="dense")(lambda status: 1 / 0)  # line 7
@observation_part("bad")
def bad(view): raise KeyError("x")  # line 9
@register(plugins.ACTIONS)
class Actions(ActionType):
    kind: Literal["bad"] = "bad"
    def describe(self): return ""
    def space(self, vessel): return Discrete(2)
    def commands(self, actions, vessel): return [] + 1  # line 15
class Water(Disturbance):
    def water_velocity(self): return None.x  # line 17
@register(plugins.CONDITIONS, group="water")
class Bad(Condition):
    kind: Literal["bad"] = "bad"
    def build(self, num_boats): return Water()
@register(plugins.RANGE_SENSORS)
class Sensor(RangeSensorSpec):
    kind: Literal["bad"] = "bad"
    def build(self, triangles): return {}[0]  # line 25
"""


@pytest.mark.parametrize(
    ("setting", "line"),
    [
        ("reward: {terms: {bad: 1}}", 7),
        ("observation: [bad]", 9),
        ("actions: bad", 15),
        ("conditions: {bad: {}}", 17),
        ("sensors: {lidar: {kind: bad}}", 25),
    ],
)
def test_code_that_fails_at_run_time_is_reported_with_its_line(
    write: Write, tmp_path: Path, setting: str, line: int
) -> None:
    write("bad.py", FAILING)
    scenario = write("x.yaml", f"extends: s1\nplugins: [bad.py]\n{setting}\n")
    outcome = quick_train(tmp_path / "runs", scenario, "--steps", 30)
    assert (outcome.code, outcome.error_code) == (2, "plugin")
    assert outcome.err.count("\n") == 1
    assert outcome.err.strip().endswith(f"({tmp_path / 'bad.py'}:{line})")
