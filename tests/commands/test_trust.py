"""No code of a received checkpoint or run folder runs unless the user allows it."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import stat
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from dockctl import plugins, trust
from dockctl.errors import DockctlError
from dockctl.evaluation import load_policy
from dockctl.trust import UntrustedError
from tests.commands.conftest import Outcome, dockctl, only_run, quick_train

PLUGIN = """
from pathlib import Path
from dockctl.rewards.terms import reward_term

Path({marker!r}).touch()

@reward_term("gentle", kind="dense")
def gentle(status):
    return 0.0 * status.nu[:, 2]
"""
SCENARIO = "extends: s1\nplugins: [gentle.py]\nreward: {terms: {gentle: -1}}\n"
COMMANDS = {
    "evaluate": ("evaluate", "--episodes", 0, "--ckpt", "RUN"),
    "evaluate a checkpoint": ("evaluate", "--episodes", 0, "--ckpt", "RUN/checkpoints/best"),
    "evaluate any policy": ("evaluate", "--episodes", 0, "--policy", "RUN"),
    "evaluate another policy there": ("evaluate", "--ckpt", "s1", "--scenario", "RUN/scenario.yaml"),
    "map": ("map", "--reach-m", 0, "--headings", 0, "--ckpt", "RUN"),
    "record": ("evaluate", "RUN", "--episodes", 0, "--record"),
    "returns": ("returns", "--ckpt", "RUN"),
    "latency": ("latency", "--decisions", 10, "--ckpt", "RUN"),
    "compare": ("compare", "RUN", "s1", "--episodes", 0, "--out", "OUT"),
    "compare with": ("compare", "s1", "RUN", "--scenario", "RUN/scenario.yaml", "--out", "OUT"),
    "export": ("export", "RUN", "--out", "OUT"),
    "show": ("show", "RUN/scenario.yaml", "--out", "OUT"),
    "validate": ("validate", "RUN/scenario.yaml"),
    "train": ("train", "RUN/scenario.yaml", "--out", "OUT", "--steps", 10),
    "verify": ("verify", "RUN", "--steps", 50),
    "resume": ("train", "--resume", "RUN", "--steps", 400),
    "validate a scenario that extends it": ("validate", "mine.yaml"),
}


def unload(marker: Path) -> None:
    """Forget that the plugin ran in this process."""
    for registry in plugins.GROUPS.values():
        for origin in {known.origin for known in registry.save().values()}:
            if origin.startswith("file "):
                registry.unregister(origin)
    plugins._loaded.clear()
    marker.unlink(missing_ok=True)


@pytest.fixture(scope="module")
def marker(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file that the plugin writes when it runs."""
    return tmp_path_factory.mktemp("marker") / "ran"


@pytest.fixture(scope="module")
def made_here(tmp_path_factory: pytest.TempPathFactory, marker: Path) -> Path:
    """A run of a scenario with a local plugin, trained on this machine."""
    folder = tmp_path_factory.mktemp("mine")
    (folder / "gentle.py").write_text(PLUGIN.format(marker=str(marker)))
    (folder / "s1.yaml").write_text(SCENARIO)
    outcome = quick_train(folder / "runs", folder / "s1.yaml", "--steps", 200)
    assert outcome.code == 0, outcome.err
    outcome = dockctl("evaluate", "--ckpt", only_run(folder / "runs"), "--episodes", 0)
    assert outcome.code == 0, outcome.err
    unload(marker)
    return only_run(folder / "runs")


@pytest.fixture
def run(made_here: Path, tmp_path: Path, marker: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A copy of the run; the working directory is its parent."""
    shutil.copytree(made_here, tmp_path / "run")
    (tmp_path / "mine.yaml").write_text("extends: run/scenario.yaml\nname: mine\n")
    monkeypatch.chdir(tmp_path)
    yield tmp_path / "run"
    unload(marker)


@pytest.fixture
def received(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The run on a machine that does not know it."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return run


def call(name: str, *more: object) -> Outcome:
    return dockctl(*(str(word).replace("RUN", "run").replace("OUT", "out") for word in COMMANDS[name]), *more)


def digest(run: Path) -> str:
    return hashlib.sha256((run / "plugins" / "00-gentle.py").read_bytes()).hexdigest()


@pytest.mark.parametrize("name", COMMANDS)
def test_no_command_runs_code_of_a_received_run(received: Path, marker: Path, name: str) -> None:
    outcome = call(name)
    assert outcome.code == 2, outcome.out
    assert outcome.error_code == "untrusted" or name.startswith("validate")  # which prints all errors itself
    assert not marker.exists()
    assert str(received / "plugins" / "00-gentle.py") in outcome.err
    assert digest(received) in outcome.err


@pytest.mark.parametrize("name", ["evaluate", "validate", "compare"])
def test_trust_allows_it(received: Path, marker: Path, name: str) -> None:
    outcome = call(name, "--trust")
    assert outcome.code == 0, outcome.err
    assert marker.exists()
    unload(marker)
    assert call(name).code == 2  # that time only
    assert not marker.exists()


def test_a_run_made_here_needs_no_trust(run: Path, marker: Path) -> None:
    assert call("evaluate").code == 0
    assert marker.exists()


def test_a_received_run_that_was_resumed_here_is_known(received: Path) -> None:
    assert call("resume", "--trust").code == 0
    unload(Path("none"))
    assert call("evaluate").code == 0


def test_a_changed_plugin_is_untrusted_again_and_both_hashes_are_shown(run: Path, marker: Path) -> None:
    before = digest(run)
    with (run / "plugins" / "00-gentle.py").open("a") as file:
        file.write("# changed\n")
    outcome = call("evaluate")
    assert (outcome.code, outcome.error_code, marker.exists()) == (2, "untrusted", False)
    assert before in outcome.err and digest(run) in outcome.err
    trust.remember([digest(run)])  # from another training: still not the code of this run
    assert call("evaluate").error_code == "untrusted"


def test_the_users_own_copy_runs_instead(
    received: Path, made_here: Path, marker: Path, tmp_path: Path
) -> None:
    own = made_here.parents[2] / "gentle.py"
    loaded = load_policy(received, plugin_files=[str(own)]).scenario()
    assert loaded.plugin_files == (own,)
    assert marker.exists()
    unload(marker)
    edited = tmp_path / "gentle.py"  # another content, but the same name
    edited.write_text(own.read_text() + "# mine\n")
    outcome = call("evaluate", "--plugin", edited)
    assert outcome.code == 0, outcome.err


def test_the_python_api_refuses_untrusted_code(received: Path, marker: Path) -> None:
    with pytest.raises(UntrustedError):
        load_policy(received).scenario()
    assert not marker.exists()
    assert load_policy(received, trust=True).scenario().scenario.reward.terms
    assert marker.exists()


@pytest.mark.parametrize("scenario", ["../scenario.yaml", "bad.yaml", "/bad"])
def test_the_scenario_in_a_policys_card_brings_no_code(
    received: Path, marker: Path, scenario: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    best = received / "checkpoints" / "best"
    shutil.copy(received / "plugins" / "00-gentle.py", "bad.py")
    (received.parent / "bad.yaml").write_text(SCENARIO.replace("gentle.py", "bad.py"))
    shutil.copytree(best, "policy")
    facts = json.loads(Path("policy/policy.json").read_text())
    Path("policy/policy.json").write_text(json.dumps({**facts, "scenario": scenario}))
    with pytest.raises(DockctlError):
        load_policy("policy").scenario()
    assert not marker.exists()


def as_a_link(run: Path) -> None:
    (run.parent / "outside").mkdir()
    (run / "scenario.yaml").rename(run.parent / "outside" / "scenario.yaml")
    (run / "scenario.yaml").symlink_to("../outside/scenario.yaml")


def as_a_file_to_extend(run: Path) -> None:
    (run.parent / "outside").mkdir()
    for name in ("scenario.yaml", "plugins"):
        (run / name).rename(run.parent / "outside" / name)
    (run / "scenario.yaml").write_text("extends: ../outside/scenario.yaml\n")


def under_the_name_of_an_option(run: Path) -> None:
    (run / "scenario.yaml").rename(run.parent / "--set plugins.yaml")
    (run / "plugins").rename(run.parent / "plugins")
    (run / "provenance.json").rename(run.parent / "provenance.json")
    (run / "scenario.yaml").write_text('extends: "../--set plugins.yaml"\n')


def without_provenance(run: Path) -> None:
    (run / "provenance.json").unlink()


def with_an_older_policy_alone(run: Path) -> None:
    without_provenance(run)
    (run / "checkpoints" / "best").rename(run / "checkpoints" / "best-1")
    shutil.rmtree(run / "checkpoints" / "last", ignore_errors=True)


def with_tensors_alone(run: Path) -> None:
    without_provenance(run)
    for card in run.glob("checkpoints/*/policy.json"):
        card.unlink()


@pytest.mark.parametrize(
    "hide",
    [
        as_a_link,
        as_a_file_to_extend,
        under_the_name_of_an_option,
        without_provenance,
        with_an_older_policy_alone,
        with_tensors_alone,
    ],
)
@pytest.mark.parametrize("name", ["show", "validate a scenario that extends it"])
def test_plugins_that_hide_do_not_run(
    received: Path, marker: Path, hide: Callable[[Path], None], name: str
) -> None:
    hide(received)
    outcome = call(name)
    assert outcome.code == 2, outcome.out
    assert re.search(r"\b[0-9a-f]{64}\b", outcome.err)  # the hash of the plugin
    assert not marker.exists()


@pytest.mark.parametrize("file", ["run/scenario.yaml", "mine.yaml"])
def test_an_algorithm_of_others_is_not_imported(
    received: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, file: str
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    Path("theirs.py").write_text("from pathlib import Path\nPath('imported').touch()\n")
    (received / "scenario.yaml").write_text(
        "extends: s1\ntraining: {algorithm: {kind: sb3, model: 'theirs:Model'}}\n"
    )
    outcome = dockctl("train", file, "--out", "out")
    assert outcome.error_code == "untrusted"
    assert not Path("imported").exists()


def test_a_scenario_that_the_user_names_loads_its_plugins(
    received: Path, made_here: Path, marker: Path
) -> None:
    outcome = dockctl("validate", made_here.parents[2] / "s1.yaml")
    assert outcome.code == 0, outcome.err
    assert marker.exists()


def test_the_known_hashes_are_private(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    trust.remember(["a" * 64])
    trust.remember(["a" * 64, "b" * 64])
    folder = trust.state_folder()
    assert sorted(path.name for path in folder.iterdir()) == ["a" * 64, "b" * 64]
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert {stat.S_IMODE(path.stat().st_mode) for path in folder.iterdir()} == {0o600}
