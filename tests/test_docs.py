"""The commands and the Python examples of all documents run, shortened, in a folder like a user's."""

from __future__ import annotations

import ast
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from urllib.request import urlopen

import pytest
import typer

from dockctl.cli import app
from dockctl.experiments import runner
from dockctl.experiments.study import load_study
from dockctl.reports import style
from tests.commands.conftest import dockctl
from tests.conftest import own_registries
from tests.test_packaging import DOCUMENTS

ROOT = Path(__file__).parent.parent
RUN = Path("runs/s3/20260101-120000-seed0")
QUICK = (
    "training.boats=2", "training.warmup_steps=10", "training.batch_size=8", "training.steps_per_update=2",
    "training.replay_capacity=1000", "training.validation.starts=2", "training.hidden_sizes=[16, 8]",
)  # fmt: skip
SHORTER = {
    "train": ("--steps", "40", *(word for setting in QUICK for word in ("--set", setting))),
    "evaluate": ("--episodes", "1"),
    "compare": ("--episodes", "2"),
    "map": ("--reach-m", "0", "--headings", "0"),
    "envelope": ("--episodes", "1"),
    "latency": ("--decisions", "10"),
    "view": ("--pose", "34,0.5,180"),
}
"""Options that make a command quick."""
INSTALLED = "s1-smooth"
"""A scenario of an installed package; its commands run in the fresh checkout, after `CHECKOUT`."""


CHECKOUT = (
    "make dock",
    "python3 -m venv .venv",
    ".venv/bin/pip install --constraint constraints.txt --editable .",
    "source .venv/bin/activate",
    "pip install examples/dockctl-smooth",
    "pip install pytest examples/dockctl-smooth",
    "pytest examples/dockctl-smooth/tests",
)
"""Lines of the documents that run in a fresh checkout, in this order."""
BOAT = "pip install numpy && pip install --no-deps path/to/dockctl"
TENSORBOARD = "tensorboard --logdir runs"
PARITY = "python benchmarks/pilot.py"
WHOLE = {"make test", "make check"}
"""Run all tests, this one among them."""


def blocks(document: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", document.read_text(encoding="utf-8"), re.M | re.S)


def lines(document: Path) -> list[list[str]]:
    """Return the words of each line in the shell blocks of a document."""
    shell = [line for block in blocks(document, "sh") for line in block.replace("\\\n", " ").splitlines()]
    return [words for line in shell if (words := shlex.split(line, comments=True))]


def commands(document: Path) -> list[list[str]]:
    """Return the commands of dockctl in the blocks of a document."""
    return [words[1:] for words in lines(document) if words[0] == "dockctl" and INSTALLED not in words]


def examples(document: Path) -> list[str]:
    """Return the Python examples of a document; those that begin with a file name are plugins."""
    return [block for block in blocks(document, "python") if not block.startswith("# ")]


def give_policy(run: Path) -> None:
    """Replace the policy of a run by one that docks."""
    for file in ("policy.json", "policy.safetensors"):
        shutil.copy(ROOT / "dockctl" / "checkpoints" / "s3" / file, run / "checkpoints" / "best" / file)


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with everything that the documents presuppose."""
    folder = tmp_path_factory.mktemp("user")
    for name in ("examples", "scenarios"):
        (folder / name).symlink_to(ROOT / name)
    (folder / "my-scenario.yaml").write_text(blocks(ROOT / "README.md", "yaml")[0])
    (folder / "my-harbor.yaml").write_text("extends: reference\nname: mine\n")
    (folder / "my-boat.yaml").write_text("extends: eilbrecht\nname: mine\n")
    (folder / "mine.yaml").write_text(blocks(ROOT / "docs" / "studies.md", "yaml")[0])
    for content in blocks(ROOT / "docs" / "plugins.md", "python"):
        if name := re.match(r"# (\w+\.py)\n", content):
            (folder / name[1]).write_text(content)
    (folder / "my").mkdir()
    shutil.copy(ROOT / "examples" / "local-term" / "gentle.py", folder / "my")
    assert dockctl("train", "s3", "--out", folder / "new", *SHORTER["train"]).code == 0
    (run,) = (folder / "new").glob("*/*")
    (folder / RUN).parent.mkdir(parents=True)
    run.rename(folder / RUN)
    give_policy(folder / RUN)
    assert dockctl("evaluate", "--ckpt", folder / RUN, *SHORTER["evaluate"]).code == 0
    assert dockctl("export", "s3", "--pilot", folder / "s3.npz").code == 0
    return folder


def load_only(study: str, names: Sequence[str], *_: object) -> str:
    """Select the experiments of a study without running them."""
    assert load_study(study).chosen(names)
    return "done"


@pytest.fixture
def workplace(prepared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of that folder as the working directory; figures are small and studies only loaded."""
    folder = shutil.copytree(prepared, tmp_path / "user", symlinks=True)
    monkeypatch.chdir(folder)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setitem(style.STYLE, "savefig.dpi", 20)
    monkeypatch.delitem(style.METADATA, "svg")
    monkeypatch.setattr(runner, "run_study", load_only)
    return folder


@pytest.mark.slow
@pytest.mark.thorough  # tests/test_packaging.py looks their options up, and each command has its own tests
@pytest.mark.parametrize("document", [d for d in DOCUMENTS if commands(d)], ids=lambda path: path.name)
def test_the_commands_run(document: Path, workplace: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if any("received" in words for words in commands(document)):
        source = "examples/local-term/s1-gentle.yaml"
        with own_registries():
            assert dockctl("train", source, "--out", "new", *SHORTER["train"]).code == 0
        next(Path("new").glob("*/*")).rename("received")
        monkeypatch.setenv("XDG_STATE_HOME", str(workplace / "another machine"))
    for words in commands(document):
        with own_registries():  # each command is a process of its own
            options = SHORTER.get(words[0], ())  # the last value of an option counts
            if "--from" in words:
                options = options[:-2]  # without the small network
            outcome = dockctl(*words, *options)
        assert outcome.code == 0, (words, outcome.err)
        if words[:2] == ["train", "s3"]:
            give_policy(max(Path("runs").glob("s3/*")))


HELP = {name: command.help or "" for name, command in typer.main.get_command(app).commands.items()}


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("command", HELP)
def test_the_examples_in_the_help_run(command: str, workplace: Path) -> None:
    (example,) = re.findall(rf"Example: dockctl ({command} .*(?:\n.+)*)", HELP[command])
    with own_registries():
        outcome = dockctl(*shlex.split(example), *SHORTER.get(command, ()))
    assert outcome.code == 0, outcome.err


@pytest.mark.parametrize(
    ("document", "example"),
    [
        pytest.param(document, example, id=f"{document.name} {number}")
        for document in DOCUMENTS
        for number, example in enumerate(examples(document))
    ],
)
def test_the_examples_run(
    document: Path, example: str, workplace: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if "stable_baselines3" in example:
        pytest.importorskip("stable_baselines3")
    small = 'overrides = ["training.hidden_sizes=[16, 8]", "training.validation.starts=2", '
    shorter = example.replace("learn(100_000)", "learn(100)").replace("reach_m=2", "reach_m=0")
    shorter = shorter.replace("overrides = [", small)
    exec(compile(shorter, "<example>", "exec"), {})
    assert ("print(" in example) <= bool(capsys.readouterr().out.strip())


def test_every_block_has_a_language_that_is_tested() -> None:
    """Scenario files are tested in tests/test_packaging.py, the blocks with a layout of files are text."""
    found: Counter[str] = Counter()
    for document in DOCUMENTS:
        fences = re.findall(r"^(.*?(?:`{3,}|~{3,}).*)$", document.read_text(encoding="utf-8"), re.M)
        assert {*fences[::2]} <= {f"```{kind}" for kind in ("sh", "python", "yaml", "json", "toml", "text")}
        assert {*fences[1::2]} <= {"```"}, document
        found.update(f"{document.name} {fence[3:]}" for fence in fences[::2])
    data = {name: count for name, count in found.items() if name.endswith(("yaml", "json", "toml"))}
    whole = {f"{name}.md yaml" for name in ("choices", "conditions", "gallery", "plugins", "scenario")}
    once = {"README.md yaml", "studies.md yaml", "scenario.md json", "plugins.md toml"}  # only the first
    assert data.keys() == whole | once and all(data[name] == 1 for name in once)


def test_every_python_block_is_an_example_or_a_plugin_that_a_command_or_a_scenario_uses() -> None:
    for document in DOCUMENTS:
        plugins = [block for block in blocks(document, "python") if block.startswith("# ")]
        assert not plugins or document.name == "plugins.md"
        for block in plugins:
            name = re.match(r"# (\w+\.py)\n", block)
            assert name, block
            files = "".join([*blocks(document, "yaml"), *map(shlex.join, lines(document))])
            assert name[1] in files


def test_every_shell_line_is_run() -> None:
    others = {
        shlex.join(words) for document in DOCUMENTS for words in lines(document) if words[0] != "dockctl"
    }
    node = {line for line in others if "docking_node.py" in line}  # tests/test_ros2.py
    run = {shlex.join(shlex.split(line)) for line in (*CHECKOUT, *WHOLE, BOAT, TENSORBOARD, PARITY)}
    assert others - node == run


def shell(script: str, folder: Path, **environment: str | Path) -> str:
    """Run a script as in a new shell of a user and return what it prints."""
    clean = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "VIRTUAL"))}
    settings = {name: str(value) for name, value in environment.items()}
    done = subprocess.run(
        ["bash", "-euc", script],
        cwd=folder,
        env=clean | {"PIP_DISABLE_PIP_VERSION_CHECK": "1", "PIP_QUIET": "1"} | settings,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
@pytest.mark.thorough  # installs dockctl and its dependencies
def test_the_installation_works_in_a_fresh_checkout(tmp_path: Path) -> None:
    (checkout := tmp_path / "dockctl").mkdir()
    for name in ("Makefile", "constraints.txt", "pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, checkout)
    for name in ("dockctl", "examples", "scenarios", "studies"):
        shutil.copytree(ROOT / name, checkout / name, ignore=shutil.ignore_patterns("__pycache__"))
    installed = [words for document in DOCUMENTS for words in lines(document) if INSTALLED in words]
    commands = [shlex.join([*words, *SHORTER.get(words[1], ())]) for words in installed]
    shell(
        "\n".join([*CHECKOUT, *commands]),
        checkout,
        SCENARIO=shlex.join(["scenarios/s3.yaml", *SHORTER["train"]]),
        PIP_CONSTRAINT=checkout / "constraints.txt",
    )
    for scenario, files in (("s3", {"evaluation.json", "figures"}), (INSTALLED, {"checkpoints"})):
        (run,) = (checkout / "runs" / scenario).iterdir()
        assert files <= {file.name for file in run.iterdir()}


@pytest.mark.slow
@pytest.mark.thorough  # installs NumPy
def test_the_installation_on_a_boat(prepared: Path, tmp_path: Path) -> None:
    alone = "from dockctl.pilot import Pilot; print(Pilot.load('s3.npz').description['scenario'])"
    shutil.copy(prepared / "s3.npz", tmp_path)
    script = ["python3 -m venv boat", "source boat/bin/activate", BOAT.replace("path/to/dockctl", str(ROOT))]
    shell("\n".join([*script, f'python -c "{alone}"', "! python -c 'import torch'"]), tmp_path)


@pytest.mark.slow
@pytest.mark.thorough  # starts a server
def test_tensorboard_shows_the_runs(tmp_path: Path) -> None:
    pytest.importorskip("tensorboard")
    assert (
        dockctl("train", "s1", "--log", "tensorboard", "--out", tmp_path / "runs", *SHORTER["train"]).code
        == 0
    )
    command = [*shlex.split(TENSORBOARD), "--port", "0"]
    with subprocess.Popen(
        [sys.executable, "-m", "tensorboard.main", *command[1:]],
        cwd=tmp_path,
        stderr=subprocess.PIPE,
        text=True,
    ) as server:
        assert server.stderr is not None
        try:
            addresses = (re.search(r" at (http://\S+)/ ", line) for line in server.stderr)
            address = next(found[1] for found in addresses if found)
            with urlopen(f"{address}/data/runs") as answer:
                assert [Path(name).parts[0] for name in json.load(answer)] == ["s1"]
        finally:
            server.terminate()


@pytest.mark.slow
@pytest.mark.thorough
def test_the_parity_of_the_pilot_is_measured() -> None:
    printed = shell(f"{sys.executable}{PARITY.removeprefix('python')} --decisions 60", ROOT)
    assert re.search(r"^all: 60 decisions, 0 other actions$", printed, re.M)


def test_the_settings_of_the_editor_name_the_files_that_the_page_writes() -> None:
    page = ROOT / "docs" / "scenario.md"
    written = {words[words.index("--out") + 1] for words in commands(page) if words[0] == "schema"}
    (settings,) = map(json.loads, blocks(page, "json"))
    assert {Path(file).name for file in settings["yaml.schemas"]} <= written
    (first,) = re.findall(r"\$schema=(\S+)", page.read_text(encoding="utf-8"))
    assert first in written


def test_the_names_of_a_package_are_those_of_the_example() -> None:
    (shown,) = map(tomllib.loads, blocks(ROOT / "docs" / "plugins.md", "toml"))
    example = tomllib.loads((ROOT / "examples/dockctl-smooth/pyproject.toml").read_text(encoding="utf-8"))
    for group, names in shown["project"]["entry-points"].items():
        assert names.items() <= example["project"]["entry-points"][group].items()


def test_every_test_that_holds_a_promise_exists() -> None:
    page = (ROOT / "docs" / "reliability.md").read_text(encoding="utf-8")
    rows = [line for line in page.splitlines() if line.startswith("| ")]
    promises = [row for row in rows if row not in ("| promise | test |", "| --- | --- |")]
    assert promises
    for row in promises:
        found = re.findall(r"`(tests/[\w/]+\.py|(?=::))((?:::\w+)*)`", row)
        assert found, row
        file = ""
        for place, names in found:
            file = place or file  # a name alone is in the file before it
            node: ast.AST = ast.parse((ROOT / file).read_text(encoding="utf-8"))
            for name in names.split("::")[1:]:
                inside = {getattr(child, "name", ""): child for child in ast.iter_child_nodes(node)}
                assert name in inside, f"{file}{names}"
                node = inside[name]
