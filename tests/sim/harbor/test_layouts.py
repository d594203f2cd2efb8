"""Generated layouts: the same everywhere, feasible by brute force on a grid, and different for evaluation."""

from __future__ import annotations

import hashlib
import math
import os
from functools import cache
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.ndimage import distance_transform_edt, label

from dockctl.errors import InputError
from dockctl.geometry import Bools, Floats
from dockctl.scenarios.harbor import DEFAULT_MODELS, BerthPlace, Generated, Marina, berth_pose
from dockctl.scenarios.layouts import LONGEST_CM, generate, layouts
from dockctl.scenarios.loader import load, load_harbor
from dockctl.scenarios.vessel import Hull
from dockctl.sim.checks import check_poses, load_checked
from dockctl.sim.collision import collision_checker
from dockctl.sim.harbor.build import Harbor, build_harbor
from dockctl.sim.harbor.marina import SIDE_CLEARANCE_M
from dockctl.sim.harbor.mesh_files import moored_model
from dockctl.sim.harbor.solids import hull_outline
from dockctl.sim.starts import StartSampler, own_site, sites

HULL = Hull()
DEFAULT = Generated(kind="generated")
SMALL = Generated(
    kind="generated",
    berth_width_m=(2.4, 8),
    berths_between_fingers=(1, 6),
    fairway_m=(8, 9),
    basin_length_m=(40, 41),
    piers=(0, 4),
)
SIDE_BY_SIDE = Generated(kind="generated", without_fingers=0.5, fairway_m=(10, 14))
SEEDS = range(int(os.environ.get("DOCKCTL_LAYOUTS", "2")))
"""Layouts whose meshes are built and tested, in about 0.3 s each."""
CELL_M = 0.2
OUTSIDE_M = 20.0
HAND_DRAWN = ("t-head", "l-basin", "stern-to")
EACH = [*((DEFAULT, seed) for seed in SEEDS), *((SIDE_BY_SIDE, seed) for seed in SEEDS), *HAND_DRAWN]


@cache
def harbor(seed: int) -> Harbor:
    return build_harbor(generate(DEFAULT, seed), Path())


def extents(harbor: Harbor) -> dict[str, list[Floats]]:
    """Bounding boxes (2, 2) of everything a hull can touch: all bodies are parallel to the axes."""
    found: dict[str, list[Floats]] = {}
    for part in harbor.parts:
        for solid in part.solids:
            low, high = solid.mesh.bounds
            if low[2] < HULL.freeboard_m and high[2] > -HULL.draft_m:
                found.setdefault(part.name, []).append(np.array([low[:2], high[:2]]))
    return found


class Grid:
    """Distance of each cell from all bounding boxes, and the water that is connected with the open sea."""

    def __init__(self, boxes: list[Floats], origin: Floats, size: Floats) -> None:
        self.origin = origin - OUTSIDE_M
        free = np.ones(np.ceil((size + 2 * OUTSIDE_M) / CELL_M).astype(int), bool)
        for low, high in boxes:
            (x0, y0), (x1, y1) = (
                np.floor((low - self.origin) / CELL_M),
                np.ceil((high - self.origin) / CELL_M),
            )
            free[int(max(x0, 0)) : int(max(x1, 0)), int(max(y0, 0)) : int(max(y1, 0))] = False
        self.distance = distance_transform_edt(free) * CELL_M

    def at_sea(self, radius_m: float) -> Bools:
        """Cells that the center of a circle can reach from the corner of the map."""
        regions, _ = label(self.distance > radius_m + CELL_M)
        connected: Bools = regions == regions[0, 0]
        return connected

    def cell(self, xy: Floats) -> tuple[int, int]:
        x, y = np.floor((xy - self.origin) / CELL_M).astype(int)
        return int(x), int(y)


def free_berths(marina: Marina) -> list[tuple[float, float, float]]:
    places = [BerthPlace(row.side, at) for row in marina.rows for at in row.free]
    return [berth_pose(marina, place, 2.5) for place in places]


def marina_of(which: str | tuple[Generated, int]) -> Marina:
    if not isinstance(which, str):
        return generate(*which)
    spec = load_harbor(which)
    assert isinstance(spec, Marina)
    return spec


@pytest.mark.parametrize("which", EACH)
def test_every_free_berth_is_reached_from_the_sea_with_space_to_turn(
    which: str | tuple[Generated, int],
) -> None:
    """A circle as wide as the boat and 0.3 m on each side gets from the sea into the berth, and before the
    berth, at the most 16 m from the docked boat, the boat can turn around and leave."""
    marina = marina_of(which)
    built = build_harbor(marina, Path())
    water = marina.basin
    origin = np.array([water.x_min_m, water.y_min_m])
    size = np.array([water.x_max_m, water.y_max_m]) - origin
    grid = Grid([box for boxes in extents(built).values() for box in boxes], origin, size)
    narrow, turning = grid.at_sea(HULL.beam_m / 2 + 0.3), grid.at_sea(HULL.reach_m)
    checker = collision_checker(built, HULL)
    for x, y, heading in free_berths(marina):
        assert not checker.blocked(np.array([[x, y, heading]]))[0]
        assert narrow[grid.cell(np.array([x, y]))]
        ahead = [
            np.array([x + d * math.cos(heading), y + d * math.sin(heading)]) for d in np.arange(0, 16, 0.2)
        ]
        to_turn = next(i for i, xy in enumerate(ahead) if turning[grid.cell(xy)])
        assert all(narrow[grid.cell(xy)] for xy in ahead[:to_turn])


@pytest.mark.parametrize("which", EACH)
def test_moored_vessels_overlap_nothing(which: str | tuple[Generated, int]) -> None:
    boxes = extents(build_harbor(marina_of(which), Path()))
    for (name, mine), (other, theirs) in combinations(boxes.items(), 2):
        if name.startswith("moored") or other.startswith("moored"):
            for a in mine:
                for b in theirs:
                    overlap = np.minimum(a[1], b[1]) - np.maximum(a[0], b[0])
                    assert not (overlap > 0.03).all(), (name, other)  # fenders may touch


@pytest.mark.parametrize("seed", SEEDS)
def test_a_free_berth_is_wider_than_the_boat(seed: int) -> None:
    """Sideways from the boat's middle, nothing is within half the beam and 0.5 m."""
    boxes = [box for found in extents(harbor(seed)).values() for box in found]
    for x, y, heading in free_berths(generate(DEFAULT, seed)):
        half = np.array([HULL.length_m / 2, HULL.beam_m / 2 + 0.5])
        reach = half if abs(math.cos(heading)) > 0.5 else half[::-1]
        for low, high in boxes:
            assert (low >= (x, y) + reach).any() or (high <= (x, y) - reach).any()


@pytest.mark.parametrize("spec", [DEFAULT, SMALL, SIDE_BY_SIDE], ids=["default", "extreme", "side by side"])
def test_fingers_walkways_and_berths_of_many_layouts_do_not_overlap(spec: Generated) -> None:
    """Rectangles: every berth as long as its longest boat, every finger, and every walkway."""
    for seed in range(200):
        marina = generate(spec, seed)
        berths, decks = [], [np.array([[p.x_min_m, p.y_min_m], [p.x_max_m, p.y_max_m]]) for p in marina.piers]
        for row in marina.rows:
            inward = -1 if row.side in ("east", "north") else 1
            width = min(np.diff(row.berths), default=4.0) if len(row.berths) > 1 else 2.4
            longest = next(length for below, length in LONGEST_CM if 100 * width < below + 1e-6) / 100
            for places, breadth, depth, found in (
                (row.berths, min(width, 2.4), marina.fleet.stern_gap_m + longest, berths),
                (row.fingers, row.finger_width_m, row.finger_length_m, decks),
            ):
                for at in places:
                    across = sorted([marina.edge_of(row), marina.edge_of(row) + inward * depth])
                    along = [at - breadth / 2, at + breadth / 2]
                    corners = np.array([across, along] if row.axis == "y" else [along, across]).T
                    found.append(corners)
        water = marina.basin
        low, high = np.array([water.x_min_m, water.y_min_m]), np.array([water.x_max_m, water.y_max_m])
        everything = np.array(berths + decks)
        assert (everything[:, 0] >= low - 1e-6).all(), seed
        assert (everything[:, 1] <= high + 1e-6).all(), seed
        overlap = np.minimum(everything[:, None, 1], everything[None, : len(berths), 1])
        overlap = overlap - np.maximum(everything[:, None, 0], everything[None, : len(berths), 0])
        touching = (overlap > 1e-6).all(axis=2)
        np.fill_diagonal(touching, False)
        assert not touching.any(), seed
        free = {(row.side, at) for row in marina.rows for at in row.free}
        assert ("east", 0.0) in free
        assert water.x_max_m == 38.5
        assert spec.free_berths[0] <= len(free) <= spec.free_berths[1] or len(berths) < spec.free_berths[1]


def test_the_longest_models_of_each_berth_are_known() -> None:
    for below, length in LONGEST_CM:
        beam = below / 100 - SIDE_CLEARANCE_M
        fitting = [
            moored_model(name).mesh.extents[0] for name in DEFAULT_MODELS if moored_model(name).beam_m < beam
        ]
        assert length / 100 - 0.2 < max(fitting) <= length / 100


def test_a_seed_gives_the_same_layout_everywhere_whatever_the_number_of_layouts() -> None:
    text = "".join(generate(DEFAULT, seed).model_dump_json() for seed in range(50))
    assert hashlib.sha256(text.encode()).hexdigest()[:16] == "42cf727ad15341d2"
    few, many = (load("marinas", overrides=[f"harbor.layouts={n}"]).scenario for n in (3, 20))
    assert layouts(few.harbor, few.task.berths)[:3] == tuple(
        layout._replace(harbor=layout.harbor) for layout in layouts(many.harbor, many.task.berths)[:3]
    )


def test_rows_without_fingers() -> None:
    rows = [row for seed in range(200) for row in generate(SIDE_BY_SIDE, seed).rows]
    without = sum(not row.fingers for row in rows)
    assert abs(without / len(rows) - 0.5) < 4 * math.sqrt(0.25 / len(rows))
    assert all(row.fingers for seed in range(200) for row in generate(DEFAULT, seed).rows)


def test_layouts_differ() -> None:
    basins = {generate(DEFAULT, seed).basin for seed in range(100)}
    assert len(basins) == 100
    rows = {tuple(sorted(row.side for row in generate(DEFAULT, seed).rows)) for seed in range(100)}
    assert len(rows) >= 5


def test_training_and_evaluation_have_different_layouts() -> None:
    scenario = load("marinas").scenario
    every = layouts(scenario.harbor, scenario.task.berths)
    assert [layout.kind for layout in every] == ["trained"] * 64 + ["held_out"] * 16
    harbors = [layout.harbor for layout in every]
    assert all(isinstance(marina, Marina) for marina in harbors)
    assert len({marina.model_copy(update={"name": ""}) for marina in harbors}) == 80
    for site in sites(scenario):
        assert site.kind == every[site.harbor].kind
        assert site.berth.startswith(f"{every[site.harbor].harbor.name} ")
    assert own_site(scenario).harbor == 0


@pytest.mark.slow
def test_the_task_itself_is_in_the_first_layout_with_space_for_it() -> None:
    scenario = load("marinas", overrides=["harbor.seed=16", "harbor.layouts=3"]).scenario
    assert isinstance(scenario.harbor, Generated) and scenario.task.intermediate is not None
    narrow, wide = (generate(scenario.harbor, seed).basin.x_min_m for seed in (16, 17))
    x_m, reach_m = scenario.task.intermediate.x_m, HULL.reach_m
    assert wide < x_m - reach_m < narrow  # the intermediate pose reaches into the west quay of the first
    assert own_site(scenario).harbor == 1
    assert not check_poses(scenario, Path()).problems


@pytest.mark.slow
@pytest.mark.parametrize("key", ["layouts", "held_out_layouts"])
def test_layouts_without_space_for_the_task_are_an_error(key: str) -> None:
    seeds = {"layouts": (16, 1000), "held_out_layouts": (17, 16)}[key]
    counts = ("harbor.layouts=1", "harbor.held_out_layouts=1")
    overrides = [f"harbor.seed={seeds[0]}", f"harbor.held_out_seed={seeds[1]}", *counts]
    with pytest.raises(InputError) as caught:
        load_checked("marinas", overrides=overrides)
    (problem,) = caught.value.problems
    assert f"harbor.{key}" in str(problem) and "wider fairways" in problem.message


@pytest.mark.slow
def test_starts_in_any_direction_are_free_and_rejected_draws_are_counted() -> None:
    overrides = [
        "harbor.layouts=2",
        "harbor.held_out_layouts=1",
        "task.initial.0.position_offset_m=10",
        "task.initial.0.heading_offset_deg=180",
        "training.exploring_starts=null",
    ]
    scenario = load("marinas", overrides=overrides).scenario
    checkers = [
        collision_checker(build_harbor(layout.harbor, Path()), HULL)
        for layout in layouts(scenario.harbor, scenario.task.berths)
    ]
    trained = [site for site in sites(scenario) if site.kind == "trained"]
    sampler = StartSampler(scenario, trained, [checker.unreachable for checker in checkers])
    rng = np.random.default_rng(0)
    starts = [sampler.draw(rng) for _ in range(100)]
    assert sum(start.rejected for start in starts) > 0
    headings = np.array([start.eta[2] for start in starts])
    assert np.hypot(np.cos(headings).mean(), np.sin(headings).mean()) < 0.3
    built = [  # the boat may be beside the bow of a vessel, inside the bounding box
        [box for name, found in extents(checker.harbor).items() if "moored" not in name for box in found]
        for checker in checkers
    ]
    outline = hull_outline(HULL)
    for start in starts:
        cosine, sine = math.cos(start.eta[2]), math.sin(start.eta[2])
        corners = outline @ np.array([[cosine, sine], [-sine, cosine]]) + start.eta[:2]
        for low, high in built[start.harbor]:
            assert not ((corners > low) & (corners < high)).all(axis=1).any()


@pytest.mark.parametrize(
    ("override", "code"),
    [
        ("harbor.berth_width_m=[3, 2.5]", "invalid"),
        ("harbor.fairway_m=[2, 20]", "out_of_range"),
        ("harbor.held_out_seed=63", "duplicate"),
        ("task.berths=null", "missing_key"),
        ("task.berths.trained={east: [0]}", "mismatch"),
        ("harbor.layouts=0", "out_of_range"),
    ],
)
def test_what_is_wrong_is_located(override: str, code: str) -> None:
    with pytest.raises(InputError) as refusal:
        load("marinas", overrides=[override])
    (problem,) = refusal.value.problems
    assert (problem.file, problem.code) == (f"--set {override.partition('=')[0]}", code)


def test_several_layouts_without_berths_are_an_error_where_they_are_given(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    for key in ("layouts", "held_out_layouts"):
        path.write_text(f"extends: s3\nharbor:\n  kind: generated\n  {key}: 3\n")
        with pytest.raises(InputError) as refusal:
            load(path)
        (problem,) = refusal.value.problems
        assert (problem.file, problem.line, problem.field) == (str(path), 4, f"harbor.{key}")


def test_berths_that_are_too_narrow_for_the_vessel() -> None:
    with pytest.raises(InputError) as refusal:
        load("marinas", overrides=["vessel.hull.beam_m=1.7"])
    (problem,) = refusal.value.problems
    assert (problem.file, problem.code) == ("scenarios/marinas.yaml", "out_of_range")


def test_a_row_needs_the_edge_of_a_pier_or_of_land() -> None:
    spec = load_harbor("t-head")
    assert isinstance(spec, Marina)
    data = spec.model_dump()
    data["rows"][1]["edge_m"] = 2.5
    assert field_error(data) == ("rows.1.edge_m", "mismatch")
    data = spec.model_dump()
    data["rows"][4]["berth_y_m"] = (7.1,)
    data["rows"][4]["free_y_m"] = ()
    assert field_error(data) == ("rows.4.berth_y_m", "duplicate")


def field_error(marina: dict[str, Any]) -> tuple[str, str]:
    """Return field and code of the error that a validator of the marina raises."""
    with pytest.raises(ValidationError) as refusal:
        Marina.model_validate(marina)
    (found,) = (each["ctx"]["error"] for each in refusal.value.errors())
    return found.field, found.code


def test_the_entrance_is_open_water_between_a_red_and_a_green_light() -> None:
    """A boat that enters has the red light to port."""
    for seed in range(3):
        marina, built = generate(DEFAULT, seed), harbor(seed)
        assert marina.entrance is not None
        gap, y = (
            marina.entrance,
            getattr(marina.basin, "y_min_m" if marina.entrance.side == "south" else "y_max_m"),
        )
        middle, outward = (gap.from_m + gap.to_m) / 2, -1 if gap.side == "south" else 1
        channel = np.array([[middle, y + outward * d, math.pi / 2] for d in range(-3, 20)])
        checker = collision_checker(built, HULL)
        assert not checker.blocked(channel).any()
        assert checker.blocked(channel + [gap.to_m - middle + 2, 0, 0])[5]
        red, green = (
            next(part.mesh.bounds.mean(axis=0)[0] for part in built.parts if part.name.startswith(color))
            for color in ("red", "green")
        )
        assert (red < middle < green) == (gap.side == "south")
