"""The reference marina against its description, other layouts, mesh files, and the plan view."""

from __future__ import annotations

import hashlib
import json
import math
import re
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from pydantic import TypeAdapter, ValidationError

from dockctl.drawing.palette import SOLIDS
from dockctl.drawing.scene import Scene
from dockctl.errors import InputError
from dockctl.scenarios.base import Pose
from dockctl.scenarios.harbor import HarborSpec, Marina, MeshFile, MeshHarbor, berth_pose
from dockctl.scenarios.loader import load
from dockctl.scenarios.vessel import Hull
from dockctl.sim.checks import PoseCheck, load_checked
from dockctl.sim.collision import CollisionChecker
from dockctl.sim.harbor import build
from dockctl.sim.harbor.build import Harbor, build_harbor, build_scene
from dockctl.sim.harbor.solids import Part, box, hull_outline
from dockctl.sim.world import build_worlds
from tests.sim.harbor.harbors import reference_harbor, reference_spec
from tests.sim.meshes import peer

FINAL = np.array([36.0, 0.0, math.pi])
HULL = Hull()
EAST_FINGERS = [-2.5 + 9 * k for k in range(-3, 4)]
WEST_FINGERS = [0.5 + 9 * k for k in range(-3, 4)]
EAST_BERTHS = sorted([9 * k for k in range(-3, 4)] + [4 + 9 * k for k in range(-3, 4)])
WEST_BERTHS = sorted([-2 + 9 * k for k in range(-3, 4)] + [-6 + 9 * k for k in range(-3, 4)])


def marina(**changes: Any) -> Marina:
    data = {**reference_spec().model_dump(), **changes}
    spec = TypeAdapter(HarborSpec).validate_python(data)
    assert isinstance(spec, Marina)
    return spec


def parts(harbor: Harbor, kind: str) -> list[Part]:
    return [part for part in harbor.parts if part.kind == kind]


@pytest.fixture(scope="module")
def harbor() -> Harbor:
    return reference_harbor()


# The reference marina


def test_two_berths_between_neighboring_fingers(harbor: Harbor) -> None:
    reference = reference_spec()
    for side, x, heading, ys in (("east", 36.0, np.pi, EAST_BERTHS), ("west", 7.0, 0.0, WEST_BERTHS)):
        places = [berth.place for berth in harbor.berths if berth.place.side == side]
        poses = [berth_pose(reference, place, 2.5) for place in places]
        np.testing.assert_allclose(poses, [(x, y, heading) for y in ys], atol=1e-12)


def test_only_the_two_target_berths_are_free(harbor: Harbor) -> None:
    assert [berth.name for berth in harbor.berths if not berth.occupied] == [
        "east berth y=0",
        "west berth y=-2",
    ]
    moored = {part.name.split(", ")[1] for part in parts(harbor, "vessel")}
    assert moored == {berth.name for berth in harbor.berths if berth.occupied}


def test_fingers_are_one_meter_wide_and_eight_long(harbor: Harbor) -> None:
    decks = [part.solids[0].mesh.bounds for part in parts(harbor, "finger")]
    expected = [(30.5, y - 0.5, 38.5, y + 0.5) for y in EAST_FINGERS]
    expected += [(4.5, y - 0.5, 12.5, y + 0.5) for y in WEST_FINGERS]
    np.testing.assert_allclose([(*low[:2], *high[:2]) for low, high in decks], expected)
    assert all(high[2] == 0.5 for _, high in decks)


def test_piles_are_round_and_within_the_footprint_of_their_finger(harbor: Harbor) -> None:
    for deck, piles in zip(parts(harbor, "finger"), parts(harbor, "pile"), strict=True):
        (low, high), (foot, head) = deck.solids[0].mesh.bounds, piles.mesh.bounds
        assert (foot[:2] >= low[:2]).all()
        assert (head[:2] <= high[:2]).all()
        assert foot[2] < 0
        assert 1.5 <= head[2] <= 2.0


def test_quays_enclose_the_basin(harbor: Harbor) -> None:
    assert harbor.basin == (4.5, -40.0, 38.5, 40.0)
    for part in parts(harbor, "quay"):
        for solid in part.solids:
            low, high = solid.mesh.bounds
            assert high[0] <= 4.5 or low[0] >= 38.5 or high[1] <= -40 or low[1] >= 40
    around = [(x, y) for x in (4.4, 38.6) for y in (-40.1, 0, 40.1)] + [(20, -40.1), (20, 40.1)]
    boat = CollisionChecker(harbor, HULL)
    assert boat.blocked(np.array([(*xy, 0.3) for xy in around])).all()


def test_vessels_are_centered_in_their_berths_with_the_stern_off_the_quay(harbor: Harbor) -> None:
    berths = {berth.name: berth for berth in harbor.berths}
    for part in parts(harbor, "vessel"):
        berth = berths[part.name.split(", ")[1]]
        low, high = part.mesh.bounds
        stern = 38.5 - high[0] if berth.place.side == "east" else low[0] - 4.5
        assert stern == pytest.approx(0.7)
        assert (low[1] + high[1]) / 2 == pytest.approx(berth.place.at_m, abs=1e-3)
        assert high[1] - low[1] <= 3.4


def test_all_classes_occur_and_each_solid_is_closed(harbor: Harbor) -> None:
    nouns = {part.name.split(", ")[0] for part in parts(harbor, "vessel")}
    classes = ("open boat", "sailing boat", "motor yacht", "inflatable boat", "catamaran")
    assert nouns == {f"moored {noun}" for noun in classes}
    assert all(solid.mesh.is_watertight for part in harbor.parts for solid in part.solids)


def test_triangles_belong_to_their_parts(harbor: Harbor) -> None:
    assert 30_000 < len(harbor.triangles) <= 60_500
    assert harbor.triangles.dtype == np.float64
    for index, part in enumerate(harbor.parts):
        mine = harbor.triangles[harbor.part_of_triangle == index]
        np.testing.assert_array_equal(mine, part.mesh.vertices[part.mesh.faces])


POSES = [  # Table 3.6, section 4.1, Tables 4.2-4.4
    *((20, y, psi) for y, psi in ((2, 150), (2, 160), (0, 180), (-2, 200), (3, 150), (1, 170), (-1, 190))),
    *((36, 0, 180), (23, -10, 90), (18, 3, 150), (21, -11, 90), (25, 0, 50), (7, -2, 0)),
]


@pytest.mark.parametrize("pose", POSES)
def test_poses_of_the_thesis_are_free(harbor: Harbor, pose: tuple[float, float, float]) -> None:
    check = PoseCheck(CollisionChecker(harbor, HULL), harbor.basin, hull_outline(HULL), FINAL)
    assert check.problem(Pose(x_m=pose[0], y_m=pose[1], heading_deg=pose[2])) == ""


@pytest.mark.parametrize(
    "poses",
    [
        [(20, 2, 160), (36, 0, 180)],
        [(23, -10, 90), (18, 3, 150), (36, 0, 180)],
        [(21, -11, 90), (25, 0, 50), (14, -2, 0), (7, -2, 0)],
    ],
)
def test_trajectories_of_the_thesis_are_free(harbor: Harbor, poses: list[tuple[float, float, float]]) -> None:
    legs = [np.linspace(a, b, 100) for a, b in pairwise(poses)]
    eta = np.concatenate(legs) * (1, 1, np.pi / 180)
    boat = CollisionChecker(harbor, HULL)
    assert not boat.blocked(eta).any()
    assert boat.clearance(eta[::20]).min() > 0.3


def test_triangles_are_the_same_in_another_process(harbor: Harbor) -> None:
    code = (
        "import hashlib; from tests.sim.harbor.harbors import reference_harbor;"
        " print(hashlib.sha256(reference_harbor().triangles.tobytes()).hexdigest())"
    )
    root = Path(__file__).parents[3]
    other = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True)
    assert other.stdout.strip() == hashlib.sha256(harbor.triangles.tobytes()).hexdigest()


def test_the_moored_vessels_depend_on_the_seed_of_the_fleet(harbor: Harbor) -> None:
    other = build_harbor(marina(fleet={"seed": 8}), Path())
    assert {part.name for part in other.parts} != {part.name for part in harbor.parts}


# Other layouts


def test_freeing_a_berth_does_not_change_the_other_vessels(harbor: Harbor) -> None:
    rows = reference_spec().model_dump()["rows"]
    rows[0]["free_y_m"] = (4.0, 9.0)
    moved = {part.name: part for part in parts(build_harbor(marina(rows=rows), Path()), "vessel")}
    before = {part.name: part for part in parts(harbor, "vessel")}
    assert {name.split(", ")[1] for name in before.keys() - moved.keys()} == {
        "east berth y=4",
        "east berth y=9",
    }
    assert {name.split(", ")[1] for name in moved.keys() - before.keys()} == {"east berth y=0"}
    for name in before.keys() & moved.keys():
        np.testing.assert_array_equal(before[name].mesh.vertices, moved[name].mesh.vertices)


def test_fleet_of_chosen_models() -> None:
    fleet = build_harbor(marina(fleet={"models": ("inflatable", "catamaran")}), Path())
    names = [part.name.split(", ")[0] for part in parts(fleet, "vessel")]
    assert set(names) == {"moored inflatable boat", "moored catamaran"}
    assert abs(names.count("moored catamaran") - len(names) / 2) <= 1


def test_rows_on_all_four_sides_point_into_the_basin() -> None:
    basin = {"x_min_m": 0.0, "x_max_m": 60.0, "y_min_m": 0.0, "y_max_m": 50.0}
    rows = [
        {"side": "east", "finger_y_m": (25.0,), "berth_y_m": (22.0, 28.0), "free_y_m": (22.0,)},
        {"side": "west", "berth_y_m": (25.0,), "free_y_m": (25.0,)},
        {"side": "north", "finger_x_m": (30.0,), "berth_x_m": (27.0, 33.0), "free_x_m": (27.0,)},
        {"side": "south", "berth_x_m": (30.0,), "free_x_m": (30.0,), "finger_x_m": (27.0, 33.0)},
    ]
    spec = marina(basin=basin, rows=rows)
    harbor = build_harbor(spec, Path())
    docked = {berth.name: berth_pose(spec, berth.place, 2.5) for berth in harbor.berths}
    poses = {berth.name: docked[berth.name] for berth in harbor.berths if not berth.occupied}
    assert poses == {
        "east berth y=22": pytest.approx((57.5, 22, np.pi)),
        "west berth y=25": pytest.approx((2.5, 25, 0)),
        "north berth x=27": pytest.approx((27, 47.5, -np.pi / 2)),
        "south berth x=30": pytest.approx((30, 2.5, np.pi / 2)),
    }
    boat = CollisionChecker(harbor, HULL)
    for berth in harbor.berths:
        assert boat.blocked(np.array([docked[berth.name]]))[0] == berth.occupied
    (north,) = [part for part in parts(harbor, "vessel") if "north" in part.name]
    assert north.mesh.bounds[1, 1] == pytest.approx(50 - 0.7)
    assert north.mesh.bounds[:, 0].mean() == pytest.approx(33, abs=1e-3)


def test_a_narrow_berth_gets_a_narrow_vessel() -> None:
    rows = [{"side": "east", "finger_y_m": (-1.6, 1.6), "berth_y_m": (0.0,)}]
    (vessel,) = parts(build_harbor(marina(rows=rows), Path()), "vessel")
    assert vessel.mesh.extents[1] <= 2.2 - 0.3


def test_berths_too_narrow_for_every_vessel_are_rejected(tmp_path: Path) -> None:
    """Each in its place, together with a mesh that does not exist."""
    file = tmp_path / "x.yaml"
    file.write_text(
        "extends: s1\n"
        "harbor:\n"
        "  meshes: [{path: gone.stl}]\n"
        "  rows:\n"
        "    - {side: east, finger_y_m: [-1, 1, 9, 11], berth_y_m: [0, 5, 10]}\n"
    )
    with pytest.raises(InputError) as caught:
        load_checked(file)
    found = sorted((p.line, p.column, p.field, p.code) for p in caught.value.problems)
    assert found == [
        (3, 19, "harbor.meshes.0.path", "not_found"),
        (5, 60, "harbor.rows.0.berth_y_m.0", "mismatch"),
        (5, 66, "harbor.rows.0.berth_y_m.2", "mismatch"),
    ]
    rows = [{"side": "east", "finger_y_m": (-1.0, 1.0), "berth_y_m": (0.0,), "free_y_m": (0.0,)}]
    assert parts(build_harbor(marina(rows=rows), Path()), "vessel") == []


def test_a_harbor_fits_into_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    triangles = len(build_harbor(reference_spec(), Path()).triangles)
    file = tmp_path / "x.yaml"
    file.write_text("extends: s1\n\nharbor: {name: small}\n")
    monkeypatch.setattr(build, "MAX_TRIANGLES", triangles)
    load_checked(file)
    monkeypatch.setattr(build, "MAX_TRIANGLES", triangles - 1)
    file.write_text("extends: s1\n\nharbor: {name: large}\n")
    with pytest.raises(InputError) as caught:
        load_checked(file)
    assert [(p.line, p.field, p.code) for p in caught.value.problems] == [(3, "harbor", "out_of_range")]


def test_an_unknown_free_berth_is_rejected() -> None:
    rows = [{"side": "east", "berth_y_m": (0.0, 4.0), "free_y_m": (3.0,)}]
    with pytest.raises(ValidationError) as caught:
        marina(rows=rows)
    error = caught.value.errors()[0]["ctx"]["error"]
    assert (error.field, error.code, error.suggestion) == ("free_y_m", "unknown_name", "4")


@pytest.mark.parametrize(
    ("row", "field", "reason"),
    [
        (
            {"berth_y_m": (0.0, 31.0)},
            "berth_y_m.1",
            "beyond the end of the edge of the row, which is -30 to 30",
        ),
        ({"berth_y_m": (0.0,), "finger_y_m": (-31.0,)}, "finger_y_m.0", "beyond"),
        ({"berth_y_m": (0.0, 5.0, 0.0)}, "berth_y_m", "this east row also has a berth at 0"),
        ({"berth_y_m": (0.0, 12.0)}, "berth_y_m.1", "in the entrance, 10 to 20"),
        ({"berth_y_m": (0.0, 9.0), "edge_m": 10.0}, "berth_y_m.1", "which is -5 to 5"),
    ],
)
def test_a_place_beyond_the_edge_of_its_row_is_rejected(row: dict[str, Any], field: str, reason: str) -> None:
    box = {"x_min_m": 0.0, "x_max_m": 40.0, "y_min_m": -30.0, "y_max_m": 30.0}
    pier = {"x_min_m": 10.0, "x_max_m": 12.0, "y_min_m": -5.0, "y_max_m": 5.0}
    entrance = {"side": "east", "from_m": 10.0, "to_m": 20.0}
    with pytest.raises(ValidationError) as caught:
        marina(basin=box, piers=(pier,), entrance=entrance, rows=[{"side": "east", **row}])
    error = caught.value.errors()[0]["ctx"]["error"]
    assert error.field == f"rows.0.{field}"
    assert reason in error.message


def test_basin_without_water_is_rejected() -> None:
    with pytest.raises(ValidationError, match="x_min_m"):
        marina(basin={"x_min_m": 5.0, "x_max_m": 5.0, "y_min_m": 0.0, "y_max_m": 1.0})


# Poses that are not free


@pytest.mark.parametrize(
    ("pose", "part"),
    [((36, 4, 180), r"moored .*, east berth y=4"), ((45, 0, 0), "east quay")],
)
def test_a_blocked_pose_is_reported_with_a_free_one(
    harbor: Harbor, pose: tuple[float, float, float], part: str
) -> None:
    check = PoseCheck(CollisionChecker(harbor, HULL), harbor.basin, hull_outline(HULL), FINAL)
    message = check.problem(Pose(x_m=pose[0], y_m=pose[1], heading_deg=pose[2]))
    assert re.search(part, message)
    x, y = map(float, re.findall(r"\((-?[\d.]+), (-?[\d.]+)\)", message)[-1])
    assert check.free(np.array([x, y, np.radians(pose[2])]))


def test_a_pose_far_outside_the_basin_is_reported(harbor: Harbor) -> None:
    check = PoseCheck(CollisionChecker(harbor, HULL), harbor.basin, hull_outline(HULL), FINAL)
    assert check.problem(Pose(x_m=200.0, y_m=0.0, heading_deg=0.0))
    assert not check.free(np.array([200.0, 0.0, 0.0]))


# Mesh files


def meshes(*names: str, **options: Any) -> MeshHarbor:
    return MeshHarbor(kind="meshes", meshes=tuple(MeshFile(path=name, **options) for name in names))


@pytest.mark.parametrize("suffix", ["glb", "obj", "stl", "ply"])
def test_mesh_formats_give_the_same_closed_bodies(tmp_path: Path, suffix: str) -> None:
    two = trimesh.util.concatenate([peer(box((0, 0, -1), (4, 2, 1))), peer(box((10, 10, -1), (11, 11, 3)))])
    two.export(tmp_path / f"pier.{suffix}")
    (part,) = build_harbor(meshes(f"pier.{suffix}"), tmp_path).parts
    assert [peer(solid.mesh).volume for solid in part.solids] == pytest.approx([16.0, 4.0])
    assert all(solid.mesh.is_watertight for solid in part.solids)


def test_meshes_are_rotated_scaled_and_shifted(tmp_path: Path) -> None:
    peer(box((1000, 0, -3000), (2000, 500, -1000))).export(tmp_path / "up.obj")  # y up, millimeters
    spec = meshes("up.obj", up="y", scale=0.001, shift_m=(5.0, 0.0, -0.2))
    (part,) = build_harbor(spec, tmp_path).parts
    np.testing.assert_allclose(part.mesh.bounds, [(6, 1, -0.2), (7, 3, 0.3)], atol=1e-9)
    assert peer(part.mesh).volume > 0


def test_meshes_added_to_a_marina(harbor: Harbor, tmp_path: Path) -> None:
    peer(box((20, 20, -1), (22, 22, 2))).export(tmp_path / "rock.stl")
    more = build_harbor(marina(meshes=({"path": "rock.stl"},)), tmp_path)
    assert len(more.triangles) == len(harbor.triangles) + 12
    assert CollisionChecker(more, HULL).collided_part(np.array([21.0, 21.0, 0.0])) == "rock.stl"


DAMAGED = {
    "empty.stl": b"",
    "harbor.step": b"ISO-10303-21;",
    "nan.obj": b"v 0 0 0\nv 1 nan 0\nv 0 1 0\nf 1 2 3\n",
    "points.obj": b"v 0 0 0\nv 1 0 0\n",
    "flat.obj": b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n",
    "index.obj": b"v 0 0 0\nv 1 0 0\nf 1 2 9\n",
    "text.glb": b"not a binary glTF file",
    "short.ply": b"ply\nformat ascii 1.0\nelement vertex 3\n",
}


@pytest.mark.parametrize("name", DAMAGED)
def test_damaged_mesh_files_are_reported(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(DAMAGED[name])
    with pytest.raises(InputError) as error:
        build_harbor(meshes(name), tmp_path)
    (problem,) = error.value.problems
    assert problem.file == str(tmp_path / name)
    assert (problem.field, problem.code) == ("harbor.meshes.0.path", "not_readable")


def test_all_damaged_mesh_files_are_reported_together(tmp_path: Path) -> None:
    (tmp_path / "folder.obj").mkdir()
    with pytest.raises(InputError) as error:
        build_harbor(meshes("missing.obj", "folder.obj"), tmp_path)
    assert [(problem.field, problem.code) for problem in error.value.problems] == [
        ("harbor.meshes.0.path", "not_found"),
        ("harbor.meshes.1.path", "not_readable"),
    ]


# Plan view


def test_a_scene_is_read_back_from_json(harbor: Harbor) -> None:
    scene = build_scene(harbor, HULL)
    again = Scene.from_json(json.loads(json.dumps(scene.to_json())))
    assert (again.name, again.bounds) == (scene.name, scene.bounds)
    assert len(again.polygons) == len(scene.polygons)
    for one, other in zip(scene.polygons, again.polygons, strict=True):
        assert (one.kind, one.name) == (other.kind, other.name)
        np.testing.assert_allclose(one.xy, other.xy, atol=6e-4)
        assert one.height_m == pytest.approx(other.height_m, abs=6e-4)
    np.testing.assert_allclose(again.hull, hull_outline(HULL), atol=6e-4)


def test_a_scene_shows_every_part_with_known_kinds(harbor: Harbor) -> None:
    scene = build_scene(harbor, HULL)
    other = {"mesh", "own", "red light", "green light"}
    assert {polygon.kind for polygon in scene.polygons} == set(SOLIDS) - other
    assert {polygon.name for polygon in scene.polygons} == {part.name for part in harbor.parts}


def test_the_outline_of_a_vessel_covers_it_from_stern_to_bow(harbor: Harbor) -> None:
    scene = build_scene(harbor, HULL)
    for part in parts(harbor, "vessel"):
        xy = np.concatenate([polygon.xy for polygon in scene.polygons if polygon.name == part.name])
        np.testing.assert_allclose([xy.min(axis=0), xy.max(axis=0)], part.mesh.bounds[:, :2], atol=0.12)


def test_a_mesh_file_that_is_rewritten_is_read_again(tmp_path: Path) -> None:
    """Also by the worlds of a scenario and in a fleet; the same process may load it any number of times."""
    pier, boat, scenario = tmp_path / "pier.obj", tmp_path / "boat.obj", tmp_path / "own.yaml"
    scenario.write_text(
        "extends: s1\nharbor:\n  fleet: {models: [boat.obj]}\n  meshes: [{path: pier.obj, up: z}]\n", "utf-8"
    )
    harbors = []
    for length in (2.0, 3.0):
        pier.write_text(trimesh.creation.box((length, 1, 1)).export(file_type="obj"), "utf-8")
        hull = trimesh.creation.box((4 + length, 2, 1)).export(file_type="obj")
        boat.write_text(f"o 00-hull\n{hull.partition(chr(10))[2]}", "utf-8")
        loaded = load(scenario)
        (world,) = build_worlds(loaded.scenario, loaded.base_dir)
        assert isinstance(world.obstacles, CollisionChecker)
        harbors.append(world.obstacles.harbor)
    grown = {"mesh": 0.0, "vessel": 0.0}
    for before, after in zip(*(harbor.parts for harbor in harbors), strict=True):
        if before.kind in grown:
            first, second = (
                np.concatenate([solid.mesh.vertices for solid in part.solids]) for part in (before, after)
            )
            grown[before.kind] = float(np.hypot(*(np.ptp(second, axis=0) - np.ptp(first, axis=0))[:2]))
    assert grown == pytest.approx({"mesh": 1.0, "vessel": 1.0})
