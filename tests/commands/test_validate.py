"""`dockctl validate`: all files, all problems, and poses that are not free of obstacles."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from dockctl.cli import app
from dockctl.sim.harbor.solids import box
from tests.sim.meshes import peer

PLACES = ("2:19: task.max_steps", "3:1: titel")
ROOT = Path(__file__).parent.parent.parent
runner = CliRunner()


def validate(*arguments: object) -> tuple[int, list[str], list[str]]:
    result = runner.invoke(app, ["validate", *map(str, arguments)])
    return result.exit_code, result.stdout.splitlines(), result.stderr.splitlines()


@pytest.mark.slow
@pytest.mark.thorough  # tests/envs/test_scenarios.py checks each of them
def test_every_registered_scenario_is_valid() -> None:
    code, out, err = validate()
    assert code == 0
    assert all(line.startswith("note: ") for line in err)
    weather = [line for line in err if "-weather.yaml" in line]
    # Wind and current exceed what the boat can hold, in both scenarios, and so does a current in training.
    assert len(weather) == 5
    (drawn_again,) = [line for line in err if line not in weather]
    assert "exploring_starts" in drawn_again  # s3-direct: moored vessels are between its start and the berth
    assert {line.split(":")[0] for line in out} >= {
        "ok s1",
        "ok s2",
        "ok s3",
        "ok s3-opposite",
        "ok s3-appendix-b",
        "ok marina",
        "ok marina-fleet",
        "ok marina-unseen",
    }
    words = "ok s1: one phase, 1 start, 5 observation parts, 5 reward terms; eilbrecht in reference"
    assert any(line.startswith(words) for line in out)


def test_vessels_that_overlap_are_noted(tmp_path: Path) -> None:
    """In the corner of two quays: each of the two pairs is less than 4 m apart along both quays."""
    file = tmp_path / "corner.yaml"
    file.write_text(
        "extends: s1\nharbor:\n  rows:\n    - {side: east, berth_y_m: [-4, 0, 4, 36.5], free_y_m: [0]}\n"
        "    - {side: north, berth_x_m: [25, 36]}\n"
    )
    code, out, (note,) = validate(file)
    assert (code, len(out)) == (0, 1)
    assert note.startswith(f"note: {file}:4:5: harbor.rows: overlapping: the moored ")
    berths = {"north berth x=36", "east berth y=36.5"}
    assert set(re.findall(r"[a-z]+ berth [xy]=-?[\d.]*\d", note)) == berths


def test_the_examples_are_valid() -> None:
    files = [
        ROOT / "examples" / name for name in ("local-term/s1-gentle.yaml", "custom-harbor/s1-pontoon.yaml")
    ]
    code, out, err = validate(*files)
    assert (code, err, len(out)) == (0, [], 2)


def test_all_errors_of_all_files(tmp_path: Path) -> None:
    for name in "ab":
        (tmp_path / f"{name}.yaml").write_text("extends: s1\ntask: {max_steps: 0}\ntitel: x\n")
    code, out, err = validate(tmp_path / "a.yaml", "s1", tmp_path / "b.yaml")
    assert code == 2
    assert [line.split()[0] for line in out] == ["failed", "ok", "failed"]
    places = [f"error: {tmp_path}/{file}:{at}: " for file in ("a.yaml", "b.yaml") for at in PLACES]
    assert [line[: len(place)] for line, place in zip(err, places, strict=True)] == places
    assert ["'title'" in line for line in err] == [False, True] * 2


def test_blocked_poses_are_located(tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    path.write_text(
        "extends: s2\ntask:\n  initial:\n    - {x_m: 20, y_m: 0, heading_deg: 0}\n"
        "    - {x_m: 34, y_m: -2.5, heading_deg: 0}\n  final: {x_m: 60, y_m: 0, heading_deg: 0}\n"
    )
    code, _, err = validate(path)
    assert code == 2
    assert len(err) == 2
    assert err[0].startswith(f"error: {path}:5:7: task.initial.1: ")
    assert "finger" in err[0]
    assert err[1].startswith(f"error: {path}:6:10: task.final: ")


def test_a_missing_mesh_is_located(tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    path.write_text("extends: s1\nharbor: {kind: meshes, meshes: [{path: gone.stl}]}\n")
    code, _, err = validate(path)
    assert code == 2
    (line,) = err
    assert line.startswith(f"error: {path}:2:40: harbor.meshes.0.path: {tmp_path}/gone.stl")


def test_overrides_and_plugins(tmp_path: Path) -> None:
    plugin = ROOT / "examples/local-term/gentle.py"
    assert validate("s1", "--set", "reward.terms.gentle_turns=-1", "--plugin", plugin)[0] == 0
    code, _, err = validate("s1", "--set", "task.final.x_m=60")
    assert code == 2
    assert err[0].startswith("error: --set task.final.x_m: task.final: ")
    assert validate("s1", "--plugin", tmp_path / "gone.py")[0] == 2


@pytest.mark.parametrize("source", ["nothing", "nothing.yaml", "scenarios"])
def test_a_missing_scenario(source: str) -> None:
    assert validate(source)[0] == 2


def test_open_meshes_are_named(tmp_path: Path) -> None:
    """A closed box, and two without a side: one of the harbor, one of the fleet."""
    closed, opened = peer(box((60, 60, -1), (61, 61, 1))), peer(box((0, -1, -1), (5, 1, 1)))
    opened.update_faces(np.arange(len(opened.faces)) > 0)
    closed.export(tmp_path / "closed.ply")
    opened.export(tmp_path / "opened.ply")
    corners = "".join(f"v {x} {y} {z}\n" for x, y, z in opened.vertices)
    faces = "".join("f " + " ".join(str(i + 1) for i in face) + "\n" for face in opened.faces)
    (tmp_path / "raft.obj").write_text(f"o 00-hull\n{corners}{faces}")
    meshes = "[{path: closed.ply}, {path: opened.ply, shift_m: [50, 50, 0]}]"
    fleet = f"{{models: [skiff, {tmp_path / 'raft.obj'}]}}"
    path = tmp_path / "x.yaml"
    path.write_text(f"extends: s1\nharbor:\n  meshes: {meshes}\n  fleet: {fleet}\n")
    code, out, err = validate(path)
    assert (code, len(out)) == (0, 1)
    assert [line.split()[:3] for line in err] == [
        ["note:", f"{path}:3:39:", "harbor.meshes.1.path:"],
        ["note:", f"{path}:4:27:", "harbor.fleet.models.1:"],
    ]
