"""Every template validates and runs as it is written, and nothing is overwritten."""

from __future__ import annotations

import os
import re
import resource
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import typer
import yaml

from dockctl.cli import app
from dockctl.commands.init import KINDS
from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import DockctlError
from dockctl.experiments.scaffold import STARTERS, TEMPLATES, write_starter
from dockctl.plugins import SCENARIOS, load_file
from dockctl.scenarios.loader import load
from dockctl.sim.checks import load_checked
from dockctl.testing import (
    check_harbor,
    check_observation_part,
    check_policy,
    check_reward_term,
    check_vessel,
)
from tests.commands.conftest import dockctl

ROOT = Path(__file__).parents[2]
STEPS = 10
SCENARIO_FILES = {
    "scenario": ("mine.yaml", ()),
    "reward": ("s1-mine.yaml", ()),
    "observation": ("s1-mine.yaml", ()),
    "vessel": ("s1", ("vessel=mine.yaml",)),
    "harbor": ("s1", ("harbor=mine.yaml",)),
}


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("kind", SCENARIO_FILES)
def test_a_template_validates_and_runs(kind: str) -> None:
    outcome = dockctl("init", kind, "mine")
    assert outcome.code == 0
    source, overrides = SCENARIO_FILES[kind]
    loaded = load_checked(source, overrides=overrides)
    env = DockingVectorEnv(loaded, 2)
    env.action_space.seed(1)
    env.reset(seed=1)
    for _ in range(STEPS):
        observation, reward, *_ = env.step(env.action_space.sample())
        assert np.isfinite(observation).all()
        assert np.isfinite(reward).all()
    written, following = outcome.out.split("Next:\n")
    assert sorted(written.split()) == sorted(path.name for path in Path().iterdir())
    commands = [shlex.split(line)[1:] for line in following.splitlines()]
    parsed = typer.main.get_command(app).commands
    for name, *arguments in commands:
        with parsed[name].make_context(name, list(arguments)):
            pass
    assert dockctl(*commands[0]).code == 0


def test_what_is_registered_keeps_the_contracts() -> None:
    write_starter("reward", "mine", Path())
    write_starter("observation", "other", Path())
    for name in ("mine", "other"):
        load_file(Path(f"{name}.py"))
    check_reward_term("mine", limit_radps=0.02)
    check_observation_part("other", cap_m=10.0)
    write_starter("vessel", "boat", Path())
    check_vessel("boat.yaml")
    write_starter("harbor", "basin", Path())
    check_harbor("basin.yaml")


@pytest.mark.thorough
def test_a_policy_runs_an_episode() -> None:
    outcome = dockctl("init", "policy", "mine")
    first, second = (shlex.split(line)[1:] for line in outcome.out.split("Next:\n")[1].splitlines())
    short = ("--set", f"task.max_steps={STEPS}")
    assert first[:1] == ["evaluate"]
    evaluated = dockctl(*first, *short, "--episodes", "0")
    assert evaluated.code == 0, evaluated.err
    assert dockctl(*second, "--episodes", "1").code == 0
    loaded = load_checked("s1")
    check_policy(load_file(Path("mine.py")).Controller(loaded.scenario), DockingVectorEnv(loaded, 3))


@pytest.mark.slow
@pytest.mark.thorough  # tests/plugins/test_examples.py installs the example package
def test_a_plugin_is_a_package_that_installs(folder: Path) -> None:
    outcome = dockctl("init", "plugin", "dockctl-mine", "--out", "work")
    assert outcome.code == 0
    pip, *others = (shlex.split(line) for line in outcome.out.split("Next:\n")[1].splitlines())
    assert pip == ["pip", "install", "--editable", "work/dockctl-mine[test]"]
    quiet = ("--quiet", "--disable-pip-version-check", "--no-index", "--no-deps", "--no-build-isolation")
    site = folder / "site"
    install = [sys.executable, "-m", "pip", "install", *quiet, "--target", str(site), pip[-1]]
    subprocess.run(install, check=True, timeout=120)
    (site / "run.py").write_text(
        "from dockctl.sim.checks import load_checked\nfrom dockctl.envs.vector import DockingVectorEnv\n"
        "env = DockingVectorEnv(load_checked('s1-dockctl-mine'), 2)\nenv.reset(seed=1)\n"
        f"for _ in range({STEPS}):\n    info = env.step(env.action_space.sample())[4]\n"
        "assert 'dockctl_mine_turning' in info['reward_terms']\n"
    )
    environment = {**os.environ, "PYTHONPATH": f"{site}:{ROOT}"}
    for words in (["dockctl", *others[1][1:]], ["pytest", "-q", *others[2][1:]], ["site/run.py"]):
        command = [sys.executable, *(["-m"] if words[0] != "site/run.py" else []), *words]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("kind", STARTERS)
def test_nothing_is_overwritten(kind: str, folder: Path) -> None:
    """Neither one of the files alone, nor a link to nothing."""
    write_starter(kind, "mine", Path())
    files = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    for path in [*files]:
        for other in files:
            other.unlink()
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("mine")
        outcome = dockctl("init", kind, "mine")
        assert (outcome.code, outcome.error_code) == (2, "duplicate")
        assert [file for file in folder.rglob("*") if file.is_file()] == [path]
        assert path.read_text() == "mine"
        for other, content in files.items():
            other.write_bytes(content)
    if kind == "scenario":
        (folder / "link.yaml").symlink_to("gone")
        with pytest.raises(DockctlError):
            write_starter(kind, "link", Path())


@pytest.mark.parametrize(
    ("kind", "name", "code", "suggestion"),
    [
        ("scenarios", "x", "unknown_name", "scenario"),
        ("scenario", "two words", "invalid", "two_words"),
        ("scenario", "../x", "invalid", "x"),
        ("scenario", "s1", "duplicate", ""),
        ("reward", "speed", "duplicate", ""),
        ("reward", "My-Term", "invalid", "my_term"),
        ("reward", "lambda", "invalid", ""),
        ("observation", "lidar", "duplicate", ""),
        ("vessel", "eilbrecht", "duplicate", ""),
        ("harbor", "haven", "duplicate", ""),
        ("policy", "1st", "invalid", ""),
        ("plugin", "numpy", "duplicate", ""),
        ("plugin", "a/b", "invalid", "a_b"),
    ],
)
def test_names_that_cannot_be_used(kind: str, name: str, code: str, suggestion: str, folder: Path) -> None:
    outcome = dockctl("init", kind, name)
    assert outcome.error
    assert (outcome.code, outcome.error.code, outcome.error.suggestion) == (2, code, suggestion)
    assert [*folder.iterdir()] == []


def test_a_folder_that_cannot_be_written(folder: Path) -> None:
    Path("file").touch()
    assert dockctl("init", "scenario", "mine", "--out", "file").error_code == "not_writable"
    assert dockctl("init", "scenario", "mine", "--out", "new/folder").code == 0
    assert load(folder / "new/folder/mine.yaml").scenario.name == "mine"


@pytest.mark.parametrize("kind", ["scenario", "reward", "plugin"])
def test_what_cannot_be_completed_is_removed(kind: str, tmp_path: Path) -> None:
    largest = max(path.stat().st_size for path in write_starter(kind, "mine", tmp_path / "whole")[0])
    folder = tmp_path / "full"
    folder.mkdir()
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (largest - 1, hard))
    try:
        with pytest.raises(DockctlError) as caught:
            write_starter(kind, "mine", folder)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert caught.value.code == "not_writable"
    assert not list(folder.iterdir())
    assert write_starter(kind, "mine", folder)[0]


def test_the_vessel_is_the_packaged_one() -> None:
    write_starter("vessel", "mine", Path())
    packaged = yaml.safe_load(
        SCENARIOS.get("s1").value.with_name("vessels").joinpath("eilbrecht.yaml").read_text()
    )
    mine = yaml.safe_load(Path("mine.yaml").read_text())
    assert {**packaged, "name": "mine", "hull": {**packaged["hull"], "freeboard_m": 0.5}} == mine


def test_the_kinds_are_documented() -> None:
    assert tuple(STARTERS) == KINDS
    used = {source for starter in STARTERS.values() for source in starter.files}
    assert used == {path.relative_to(TEMPLATES).as_posix() for path in TEMPLATES.rglob("*.j2")}
    assert not [path for path in TEMPLATES.rglob("*.j2") if re.search(r"\t| $", path.read_text(), re.M)]
