"""The commands and the Python examples of all documents run, shortened, in a folder like a user's."""

from __future__ import annotations

import ast
import re
import shlex
import shutil
from collections.abc import Sequence
from pathlib import Path

import pytest

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
    "latency": ("--decisions", "10"),
    "view": ("--pose", "34,0.5,180"),
}
"""Options that make a command quick."""
INSTALLED = "s1-smooth"  # of an installed package, which tests/test_plugins.py tests


def blocks(document: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", document.read_text(encoding="utf-8"), re.M | re.S)


def commands(document: Path) -> list[list[str]]:
    """Return the commands of dockctl in the blocks of a document."""
    lines = [line for block in blocks(document, "sh") for line in block.replace("\\\n", " ").splitlines()]
    words = [shlex.split(line, comments=True) for line in lines]
    return [line[1:] for line in words if line[:1] == ["dockctl"] and INSTALLED not in line]


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
    (folder / "examples").symlink_to(ROOT / "examples")
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
    monkeypatch.setattr(
        runner, "run_study", lambda study, names, *_: load_study(study).chosen(names) and "done"
    )
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
            outcome = dockctl(*words, *SHORTER.get(words[0], ()))  # the last value of an option counts
        assert outcome.code == 0, (words, outcome.err)
        if words[:2] == ["train", "s3"]:
            give_policy(max(Path("runs").glob("s3/*")))


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
