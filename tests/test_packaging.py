"""The wheel, pinned versions, and the commands, links and files in the documents."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
import tomllib
import zipfile
from dataclasses import fields
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from packaging.requirements import Requirement
from pydantic import BaseModel

import dockctl
from dockctl import plugins
from dockctl.cli import app
from dockctl.envs.observation import View
from dockctl.experiments.dry_run import WALL
from dockctl.plugins import ACTIONS, ALGORITHMS, CONDITIONS, RANGE_SENSORS
from dockctl.runs.directory import SHIPPED
from dockctl.scenarios.harbor import DEFAULT_MODELS, Marina
from dockctl.scenarios.loader import load
from dockctl.scenarios.schema import Scenario
from dockctl.scenarios.training import THESIS
from dockctl.sim.checks import load_checked
from dockctl.sim.goal import StepStatus
from dockctl.sim.simulator import Simulator
from dockctl.sim.starts import given_start, own_site
from dockctl.sim.world import in_open_water

ROOT = Path(__file__).parents[1]
DOCUMENTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("examples/**/*.md")])
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
DEPENDENCIES = [*PROJECT["dependencies"], *chain(*PROJECT["optional-dependencies"].values())]


def run(*command: str | Path, cwd: Path) -> str:
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def pip(*arguments: str | Path) -> str:
    quiet = ("--quiet", "--disable-pip-version-check", "--no-index", "--no-deps")
    return run(sys.executable, "-m", "pip", *arguments, *quiet, cwd=ROOT)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    pip("wheel", "--no-build-isolation", "--wheel-dir", folder, ROOT)
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def contents(wheel: Path) -> set[str]:
    with zipfile.ZipFile(wheel) as archive:
        return set(archive.namelist())


class TestWheel:
    def test_it_contains_every_module_and_the_type_marker(self, contents: set[str]) -> None:
        modules = {str(path.relative_to(ROOT)) for path in (ROOT / "dockctl").rglob("*.py")}
        assert modules <= contents
        assert "dockctl/py.typed" in contents

    def test_it_contains_every_scenario_vessel_and_harbor(self, contents: set[str]) -> None:
        files = {
            path.relative_to(ROOT / "scenarios").as_posix() for path in (ROOT / "scenarios").rglob("*.yaml")
        }
        assert {"s1.yaml", "s2.yaml", "s3.yaml"} <= files
        assert {f"dockctl/scenarios/data/{file}" for file in files} <= contents
        studies = {path.relative_to(ROOT / "studies") for path in (ROOT / "studies").glob("*/study.yaml")}
        assert studies
        assert {f"dockctl/scenarios/studies/{file}" for file in studies} <= contents

    def test_it_contains_every_vessel_model(self, contents: set[str]) -> None:
        assert {f"dockctl/sim/harbor/vessels/{name}.obj" for name in DEFAULT_MODELS} <= contents

    def test_it_contains_every_checkpoint(self, contents: set[str]) -> None:
        files = {path.relative_to(ROOT).as_posix() for path in SHIPPED.rglob("*") if path.is_file()}
        assert files <= contents

    def test_it_contains_nothing_else(self, contents: set[str]) -> None:
        stem = f"dockctl-{dockctl.__version__}.dist-info/"
        assert all(name.startswith(("dockctl/", stem)) for name in contents)
        assert not [name for name in contents if "__pycache__" in name or name.endswith(".pyc")]

    def test_it_works_from_any_folder(self, wheel: Path, tmp_path: Path) -> None:
        pip("install", "--target", tmp_path / "site", wheel)
        script = (
            f"import sys; sys.path.insert(0, {str(tmp_path / 'site')!r});"
            "import dockctl; print(dockctl.__file__);"
            "from dockctl.scenarios.loader import load; print(load('s3').scenario.name)"
        )
        place, name = run(sys.executable, "-c", script, cwd=tmp_path).splitlines()
        assert Path(place).is_relative_to(tmp_path)
        assert name == "s3"


class TestVersion:
    def test_the_wheel_takes_it_from_the_package(self, wheel: Path) -> None:
        assert wheel.name.split("-")[1] == dockctl.__version__

    def test_the_citation_and_the_changelog_have_it(self) -> None:
        assert f"\nversion: {dockctl.__version__}\n" in (ROOT / "CITATION.cff").read_text()
        assert f"\n## {dockctl.__version__}" in (ROOT / "CHANGELOG.md").read_text()


class TestPins:
    PINS = dict(
        line.split("==")
        for line in (ROOT / "constraints.txt").read_text().splitlines()
        if line and not line.startswith("#")
    )

    def test_they_are_versions_and_nothing_else(self) -> None:
        assert all(re.fullmatch(r"[\w.]+", version) for version in self.PINS.values())
        assert all(re.fullmatch(r"[A-Za-z0-9._-]+", name) for name in self.PINS)

    @pytest.mark.parametrize("declared", sorted(set(DEPENDENCIES)))
    def test_every_dependency_is_pinned_within_its_range(self, declared: str) -> None:
        requirement = Requirement(declared)
        if requirement.name == "dockctl":
            return
        pins = {re.sub(r"[-_.]+", "-", name).lower(): version for name, version in self.PINS.items()}
        assert requirement.specifier.contains(pins[re.sub(r"[-_.]+", "-", requirement.name).lower()])


def models(root: type[BaseModel]) -> set[type[BaseModel]]:
    """Return `root` and all models that it contains."""
    found: set[type[BaseModel]] = set()
    waiting: list[object] = [root]
    while waiting:
        kind = waiting.pop()
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            if kind not in found:
                found.add(kind)
                waiting += [field.annotation for field in kind.model_fields.values()]
        else:
            waiting += getattr(kind, "__args__", ())
    return found


plugins.load_builtins()
KINDS = (ACTIONS, ALGORITHMS, CONDITIONS, RANGE_SENSORS)
MODELS = sorted(
    models(Scenario) | {kind.value for registry in KINDS for kind in registry},
    key=str,
)


def documented_defaults(page: str) -> set[tuple[str, str]]:
    """Return the keys in the tables of a page with their defaults; a row may have several of both."""
    found = set()
    for row in re.findall(r"^\| (.*) \|$", page, re.M):
        for keys, value in pairwise(cell.strip() for cell in row.split("|")):
            names = re.findall(r"`(\w+)`", keys)
            values = value.split(", ") if ", " in value else [value] * len(names)
            if len(names) == len(values) and keys == ", ".join(f"`{name}`" for name in names):
                found |= {*zip(names, values, strict=True)}
    return found


def shell_lines(program: str) -> list[Any]:
    """Return the commands of `program` in text and shell blocks of all documents, as test parameters."""
    found = []
    for document in DOCUMENTS:
        text = document.read_text()
        in_text = re.findall(rf"(?<!`)`({program} [a-z][^`]*)`(?!`)", text)
        for block in [*re.findall(r"^```sh\n(.*?)^```", text, re.M | re.S), *in_text]:
            for line in block.replace("\\\n", " ").splitlines():
                words = shlex.split(line, comments=True)
                if words and words[0] == program:
                    found.append(pytest.param(words, id=f"{document.name}: {' '.join(words)}"))
    return found


class TestDocuments:
    @pytest.mark.parametrize("words", shell_lines("dockctl"))
    def test_commands_and_their_options_exist(self, words: list[str]) -> None:
        commands = vars(typer.main.get_command(app))["commands"]
        given = [word.partition("=")[0] for word in words[1:] if word.startswith("--")]
        command = commands[words[1]]
        known = {
            option for parameter in command.params for option in parameter.opts + parameter.secondary_opts
        }
        assert set(given) <= known | {"--help"}

    @pytest.mark.parametrize("words", shell_lines("make"))
    def test_make_targets_exist(self, words: list[str]) -> None:
        targets = [word for word in words[1:] if "=" not in word]
        run("make", "--dry-run", *targets, cwd=ROOT)

    @pytest.mark.parametrize("document", ["plugins.md", "scenario.md"])
    def test_the_scenario_files_in_them_are_valid(self, document: str, tmp_path: Path) -> None:
        text = (ROOT / "docs" / document).read_text()
        files = dict(re.findall(r"^```\w+\n# (\S+)\n(.*?)^```", text, re.M | re.S))
        for name, content in files.items():
            (tmp_path / name).write_text(content)
        scenarios = [name for name, content in files.items() if re.search(r"^extends: s\d", content, re.M)]
        assert scenarios
        for name in scenarios:
            assert load_checked(tmp_path / name).scenario.name == Path(name).stem

    def test_a_berth_can_be_freed_as_the_page_says(self) -> None:
        (override,) = re.findall(
            r"`--set '(harbor\.rows[^']*)'`", (ROOT / "docs" / "scenario.md").read_text()
        )
        before, after = load("s3").scenario.harbor, load_checked("s3", overrides=[override]).scenario.harbor
        assert isinstance(before, Marina) and isinstance(after, Marina)
        free = [{*harbor.rows[0].free_y_m} for harbor in (before, after)]
        assert len(free[1] - free[0]) == 1 and free[0] < free[1]

    @pytest.mark.parametrize(
        ("record", "heading"), [(StepStatus, "A reward term"), (View, "An observation part")]
    )
    def test_every_field_that_plugins_read_is_listed_with_its_shape(self, record: Any, heading: str) -> None:
        text = (ROOT / "docs" / "plugins.md").read_text()
        section = text.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]
        rows = re.findall(r"^\| `(\w+)` \| (\(.*?\).*?|tuple) \| (.*?) ?\| (.+) \|$", section, re.M)
        listed = {name: shape for name, shape, _, _ in rows}
        derived = {"speed_mps"} if record is StepStatus else set()
        methods = {"clearance_below"} if record is StepStatus else set()
        assert {*listed} == {field.name for field in fields(record)} - methods | derived
        assert all(f"| `{name}(" in section for name in methods)
        scenario = load("s1").scenario
        simulator = Simulator(scenario, [in_open_water(scenario.sensors.lidar.build(WALL))], 3)
        site = own_site(scenario)
        start = given_start(site, scenario.task, site.initial[0], 0)
        simulator.reset(np.arange(3), [start] * 3, [np.random.default_rng(0)] * 3)
        status = simulator.step(np.zeros((3, 2)))
        found = status if record is StepStatus else View.of(simulator, status.sector_ranges_m)
        for name, shape in listed.items():
            numbers = shape.replace("sectors", str(simulator.sector_ranges_m.shape[1])).replace("n", "3", 1)
            array = getattr(found, name)
            if shape == "tuple":
                assert isinstance(array, tuple)
                continue
            kind = {"b": " bool", "i": " int", "f": ""}[array.dtype.kind]
            assert f"{array.shape}{kind}" == numbers, name

    @pytest.mark.parametrize("document", ["choices.md", "conditions.md", "scenario.md"])
    def test_every_yaml_block_about_scenarios_is_valid(self, document: str, tmp_path: Path) -> None:
        blocks = re.findall(r"^```yaml\n(.*?)^```", (ROOT / "docs" / document).read_text(), re.M | re.S)
        assert blocks
        for number, block in enumerate(blocks):
            path = tmp_path / f"block-{number}.yaml"
            path.write_text(block if "extends:" in block else f"extends: s3\n{block}")
            load_checked(path)

    @pytest.mark.parametrize("model", MODELS, ids=lambda model: model.__name__)
    def test_every_key_of_a_scenario_is_documented_with_its_default(self, model: type[BaseModel]) -> None:
        page = (ROOT / "docs" / "scenario.md").read_text()
        defaults = documented_defaults(page)
        for name, field in model.model_fields.items():
            assert f"`{name}`" in page
            if isinstance(field.default, int | float | None):
                words = {None: "null", True: "true", False: "false"}
                is_word = field.default is None or isinstance(field.default, bool)
                default = words[field.default] if is_word else f"{field.default:.10g}"
                assert (name, default) in defaults

    def test_one_row_may_document_several_keys(self) -> None:
        rows = "| `sonar` | `beams`, `opening_deg` | 24, 120 | beams |\n| `a`, `b` | 0 | both |\n"
        expected = {("beams", "24"), ("opening_deg", "120"), ("a", "0"), ("b", "0")}
        assert expected <= documented_defaults(rows)
        assert documented_defaults("| `a`, `b` | 1, 2, 3 | |\n") == set()

    def test_the_numbers_of_the_thesis_are_those_of_its_preset(self) -> None:
        training = (ROOT / "docs" / "scenario.md").read_text().partition("## Training")[2]
        for name, value in THESIS.items():
            if isinstance(value, int | float):
                assert re.search(rf"^\| `{name}` \|.*\| {value:.10g} \|$", training, re.M)
