"""The plugins of the examples and of docs/plugins.md."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from dockctl import plugins
from dockctl.errors import DockctlError
from dockctl.scenarios import loader
from dockctl.sim.harbor.build import build_harbor
from tests.commands.conftest import dockctl, only_run, quick_train

ROOT = Path(__file__).parents[2]


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
