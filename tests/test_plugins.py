"""Plugins: local files and installed packages, and how they fail."""

from __future__ import annotations

import importlib
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from dockctl import plugins
from dockctl.errors import DockctlError, DuplicateNameError, InputError, PluginError
from dockctl.plugins import HARBORS, REWARD_TERMS, VESSELS
from dockctl.scenarios import loader
from dockctl.sim.harbor.build import build_harbor
from tests.commands.conftest import dockctl, only_run, quick_train

ROOT = Path(__file__).parent.parent
TERM = """
from dockctl.rewards.terms import reward_term

@reward_term("{name}", kind="dense", source="here")
def term(status, *, floor: float = 0.1, sizes: tuple[int, ...] = (), needed: bool):
    return status.distance_m
"""


@pytest.fixture
def write(tmp_path: Path) -> Callable[[str, str], Path]:
    def write(name: str, text: str) -> Path:
        path = tmp_path / name
        path.write_text(text)
        return path

    return write


Write = Callable[[str, str], Path]


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


class FakePoint(EntryPoint):
    """An entry point of a package that need not be installed."""

    dist = None


def declare(monkeypatch: pytest.MonkeyPatch, *points: tuple[str, str, str]) -> None:
    """Declare entry points (group, name, value) as if a package were installed."""
    listed = [FakePoint(name, value, group) for group, name, value in points]
    monkeypatch.setattr(plugins, "entry_points", lambda: EntryPoints(listed))
    plugins.discover.__wrapped__()


def test_installed_names_are_known_before_their_code_is_imported(
    write: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(write("lazy_terms.py", TERM.format(name="lazy")).parent)
    declare(monkeypatch, ("dockctl.rewards", "lazy", "lazy_terms:term"))
    assert "lazy" in REWARD_TERMS.names()
    assert "lazy_terms" not in sys.modules
    assert REWARD_TERMS.get("lazy").origin == "entry point lazy_terms:term"
    monkeypatch.delitem(sys.modules, "lazy_terms")


def test_a_module_imported_before_is_not_a_duplicate(write: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(write("eager_terms.py", TERM.format(name="eager")).parent)
    __import__("eager_terms")
    declare(monkeypatch, ("dockctl.rewards", "eager", "eager_terms:term"))
    assert REWARD_TERMS.get("eager").origin == "module eager_terms"
    monkeypatch.delitem(sys.modules, "eager_terms")


def test_a_module_and_the_same_file_as_a_plugin_are_one(
    write: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write("both_terms.py", TERM.format(name="both"))
    monkeypatch.syspath_prepend(path.parent)
    module = importlib.import_module("both_terms")
    importlib.reload(module)
    assert REWARD_TERMS.get("both").origin == "module both_terms"
    plugins.load_file(path)
    assert REWARD_TERMS.get("both").origin == f"file {path}"
    importlib.reload(module)
    assert REWARD_TERMS.get("both").origin == "module both_terms"
    monkeypatch.delitem(sys.modules, "both_terms")


def test_two_functions_of_a_module_may_not_share_a_name(write: Write) -> None:
    other = TERM.format(name="twice").replace("def term", "def another")
    with pytest.raises(DuplicateNameError):
        plugins.load_file(write("twice.py", TERM.format(name="twice") + other))


def test_a_broken_package_does_not_break_the_others(write: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(write("good_terms.py", TERM.format(name="good")).parent)
    write("broken_terms.py", TERM.format(name="half") + "\nraise RuntimeError('no luck')\n")
    declare(
        monkeypatch,
        ("dockctl.rewards", "half", "broken_terms:term"),
        ("dockctl.rewards", "good", "good_terms:term"),
        ("dockctl.rewards", "absent", "good_terms:nothing"),
        ("dockctl.rewards", "other", "good_terms:term"),
        ("dockctl.rewards", "garbled", "good terms"),
    )
    assert REWARD_TERMS.get("good").kind == "dense"
    for name, location in {
        "half": r"broken_terms\.py:8",
        "absent": "good_terms:nothing",
        "other": "good_terms:term",
        "garbled": "good terms",
    }.items():
        for _ in range(2):
            with pytest.raises(PluginError, match=location):
                REWARD_TERMS.get(name)
    assert loader.load("s1").scenario.name == "s1"
    monkeypatch.delitem(sys.modules, "good_terms")


def test_two_packages_with_the_same_name(monkeypatch: pytest.MonkeyPatch) -> None:
    declare(monkeypatch, ("dockctl.rewards", "same", "a:f"), ("dockctl.rewards", "same", "b:f"))
    with pytest.raises(DuplicateNameError) as caught:
        REWARD_TERMS.get("same")
    assert caught.value.origins == ("entry point a:f", "entry point b:f")


def test_data_is_a_path_a_function_or_a_package(write: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = write("boat.yaml", "extends: eilbrecht\nmass_kg: 200\n").parent
    (folder / "boats").mkdir()
    write(
        "boats/__init__.py",
        "FILE = __file__.replace('__init__.py', 'tug.yaml')\ndef path():\n    return FILE\nTEN = 10\n",
    )
    write("boats/tug.yaml", "extends: eilbrecht\nmass_kg: 300\n")
    monkeypatch.syspath_prepend(folder)
    declare(
        monkeypatch,
        ("dockctl.vessels", "tug", "boats"),
        ("dockctl.vessels", "tug-path", "boats:FILE"),
        ("dockctl.vessels", "tug-function", "boats:path"),
        ("dockctl.vessels", "tug-number", "boats:TEN"),
        ("dockctl.vessels", "gone", "boats"),
    )
    for name in ("tug", "tug-path", "tug-function"):
        assert loader.load_vessel(name).mass_kg == 300
        assert VESSELS.get(name).origin.startswith("entry point boats")
    with pytest.raises(PluginError, match="boats:TEN"):
        loader.load_vessel("tug-number")
    with pytest.raises(InputError, match=r"gone\.yaml"):
        loader.load_vessel("gone")
    monkeypatch.delitem(sys.modules, "boats")


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


def test_the_local_example() -> None:
    loaded = loader.load(ROOT / "examples/local-term/s1-gentle.yaml")
    assert loaded.plugin_files == (ROOT / "examples/local-term/gentle.py",)
    with pytest.raises(DockctlError, check=lambda error: error.suggestion == "gentle_turns"):
        loader.load(ROOT / "examples/local-term/s1-gentle.yaml", overrides=["reward.terms.gentle_turn=1"])


@pytest.mark.thorough  # installs it; other tests declare entry points without a package
def test_the_example_package_is_installed_and_used(tmp_path: Path) -> None:
    """As a third party does, in separate processes: install, list, load, one reward, contract tests."""
    source = tmp_path / "source"
    shutil.copytree(ROOT / "examples/dockctl-smooth", source)
    site = tmp_path / "site"
    pip = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "--quiet",
        "--no-index",
        "--no-deps",
        "--no-build-isolation",
    ]
    subprocess.run(
        [*pip, "--disable-pip-version-check", "--target", str(site), str(source)], check=True, timeout=120
    )
    script = """
import sys
from dockctl.plugins import REWARD_TERMS
from dockctl.scenarios import catalog, loader
catalog.fill()
assert {"smooth_rudder", "smooth_propeller"} <= set(REWARD_TERMS.names())
assert not any(name.startswith("dockctl_smooth") for name in sys.modules)
scenario = loader.load("s1-smooth").scenario
assert scenario.vessel.mass_kg == 300
assert scenario.observation[-1].part == "nearest_obstacle"
from types import SimpleNamespace
import numpy as np
status = SimpleNamespace(command=np.radians([[0, 30.0]]), previous_command=np.radians([[0, -30.0]]))
assert np.allclose(REWARD_TERMS.get("smooth_rudder").value(status), 1.0)
print(REWARD_TERMS.get("smooth_rudder").origin)
"""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(site), str(ROOT)])}
    done = subprocess.run(
        [sys.executable, "-c", script],
        env=environment,
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "package dockctl-smooth 1.0"
    contracts = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests"]
    done = subprocess.run(contracts, env=environment, cwd=source, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout


@pytest.fixture
def documented(tmp_path: Path) -> Path:
    """The files in docs/plugins.md."""
    text = (ROOT / "docs/plugins.md").read_text()
    for name, content in re.findall(r"^```\w+\n# (\S+)\n(.*?)^```", text, re.M | re.S):
        (tmp_path / name).write_text(content)
    return tmp_path


def test_the_documented_contract_tests_pass(documented: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("gentle", "nearest", "astern", "river", "bow", "softmax"):
        plugins.load_file(documented / f"{name}.py")
    section = (ROOT / "docs/plugins.md").read_text().partition("\n## Contract tests\n")[2]
    block = re.search(r"^```python\n(.*?)^```", section, re.M | re.S)
    assert block
    monkeypatch.chdir(documented)
    exec(compile(block[1], "<contract tests>", "exec"), content := dict[str, Any]())
    tests = [function for name, function in content.items() if name.startswith("test_")]
    assert len(tests) >= 3
    for test in tests:
        test()


def test_the_documented_harbor_is_built(documented: Path) -> None:
    trimesh.creation.box((4.0, 2.0, 1.0)).export(documented / "pontoon.obj")
    trimesh.creation.box((2.0, 3.0, 8.0)).export(documented / "quay.glb")  # y up, so 8 m along y
    (documented / "x.yaml").write_text("extends: s1\nharbor: pontoon.yaml\n")
    loaded = loader.load(documented / "x.yaml")
    pontoon, quay = build_harbor(loaded.scenario.harbor, loaded.base_dir).parts
    np.testing.assert_allclose(pontoon.mesh.bounds, [[-2, -1, -0.5], [2, 1, 0.5]])
    np.testing.assert_allclose(quay.mesh.bounds, [[11, -4, -1.5], [13, 4, 1.5]])


def test_a_run_is_evaluated_with_its_own_copies_of_local_plugins(
    documented: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One of each kind in a scenario; the files are gone when the run is evaluated."""
    scenario = documented / "all.yaml"
    scenario.write_text(
        "extends: s1\nplugins: [astern.py, river.py, bow.py, softmax.py]\nactions: astern\n"
        "conditions: {river: {speed_mps: [0, 0.1]}}\nsensors: {lidar: {kind: bow, sectors: 4}}\n"
        "training: {algorithm: softmax}\n",
    )
    trained = quick_train(documented / "runs", scenario, "--steps", 100)
    assert trained.code == 0, trained.err
    run = only_run(documented / "runs")
    for path in documented.glob("*.py"):
        for registry in plugins.GROUPS.values():
            registry.unregister(f"file {path}")
        path.unlink()
    monkeypatch.setattr(plugins, "_loaded", {})
    outcome = dockctl("evaluate", "--ckpt", run)
    assert outcome.code == 0, outcome.err
    assert plugins.ACTIONS.origin("astern").startswith(f"file {run}")


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
